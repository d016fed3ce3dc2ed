//! Submaps, nodes and measurements copied from their files, as far as the draft has them.

use std::collections::{BTreeMap, BTreeSet};

use prost::Message as _;

use super::EditError;
use super::draft::{Estimate, Source};
use crate::message::{MessageKind, RawMessage};
use crate::pose::{IdInFile, pose_from_proto, pose_to_proto};
use crate::proto::mapping::serialized_data::Data;
use crate::proto::mapping::{PoseGraph, SerializedData, TrajectoryData};
use crate::proto::transform::Quaterniond;
use crate::reader::{PbstreamReader, ReadLimits};
use crate::wire::{joined, last_varint, put_bytes_field, put_varint_field, without_field};

type Write<'a> = &'a mut dyn FnMut(Vec<u8>) -> Result<(), EditError>;

/// What is still to be copied.
pub(super) struct Rest<'a> {
    submaps: BTreeSet<IdInFile>,
    nodes: BTreeSet<IdInFile>,
    cuts: &'a BTreeMap<i32, (i64, i64)>,
    estimates: &'a BTreeMap<i32, Estimate>,
    /// The last measurement of a stream before its cut; interpolation at the first node needs it.
    held: BTreeMap<(i32, u32), Vec<u8>>,
    /// Streams whose first measurement after the cut was written.
    ended: BTreeSet<(i32, u32)>,
    pub sensor_messages_removed: u64,
}

impl<'a> Rest<'a> {
    pub fn new(
        graph: &PoseGraph,
        cuts: &'a BTreeMap<i32, (i64, i64)>,
        estimates: &'a BTreeMap<i32, Estimate>,
    ) -> Self {
        let mut submaps = BTreeSet::new();
        let mut nodes = BTreeSet::new();
        for trajectory in &graph.trajectory {
            let t = trajectory.trajectory_id;
            submaps.extend(trajectory.submap.iter().map(|s| (t, s.submap_index)));
            nodes.extend(trajectory.node.iter().map(|n| (t, n.node_index)));
        }
        let (held, ended) = (BTreeMap::new(), BTreeSet::new());
        Self { submaps, nodes, cuts, estimates, held, ended, sensor_messages_removed: 0 }
    }

    /// Copies what is wanted of one file.
    pub fn copy(&mut self, source: &Source, limits: ReadLimits, write: Write<'_>) -> Result<(), EditError> {
        let failed = |error| EditError::File { path: source.path.clone(), source: error };
        let mut reader = PbstreamReader::open_with(&source.path, limits).map_err(failed)?;
        while let Some(raw) = reader.next_message().map_err(failed)? {
            let kind = raw.kind();
            match kind {
                MessageKind::Header | MessageKind::PoseGraph | MessageKind::Options => {}
                MessageKind::Unknown(_) => write(raw.bytes)?,
                MessageKind::Submap | MessageKind::Node => self.part(&raw, kind, source, write)?,
                MessageKind::TrajectoryData => self.trajectory_data(&raw, source, write)?,
                MessageKind::ImuData
                | MessageKind::OdometryData
                | MessageKind::FixedFramePoseData
                | MessageKind::LandmarkData => self.measurement(raw, kind, source, write)?,
            }
        }
        // Streams that end before the cut begins.
        for (_, bytes) in std::mem::take(&mut self.held) {
            write(bytes)?;
        }
        Ok(())
    }

    fn part(
        &mut self,
        raw: &RawMessage,
        kind: MessageKind,
        source: &Source,
        write: Write<'_>,
    ) -> Result<(), EditError> {
        let content = joined(&raw.bytes, kind.tag());
        let id = joined(&content, 1);
        // Ids are int32: the low half of the number.
        let (trajectory, index) = (last_varint(&id, 1) as i32, last_varint(&id, 2) as i32);
        let Some(new) = source.ids.get(&trajectory) else { return Ok(()) };
        let wanted = if kind == MessageKind::Submap { &mut self.submaps } else { &mut self.nodes };
        // Taken out, so that a second one of the same id is not copied.
        if !wanted.remove(&(*new, index)) {
            return Ok(());
        }
        if *new == trajectory {
            return write(raw.bytes.clone());
        }
        let mut new_id = Vec::new();
        put_varint_field(&mut new_id, 1, new.cast_unsigned().into());
        put_varint_field(&mut new_id, 2, index.cast_unsigned().into());
        let mut renamed = Vec::with_capacity(content.len() + 8);
        put_bytes_field(&mut renamed, 1, &new_id);
        renamed.extend(without_field(&content, 1));
        write(with_content(raw, kind, &renamed))
    }

    fn trajectory_data(
        &mut self,
        raw: &RawMessage,
        source: &Source,
        write: Write<'_>,
    ) -> Result<(), EditError> {
        let content = joined(&raw.bytes, MessageKind::TrajectoryData.tag());
        let trajectory = last_varint(&content, 1) as i32;
        let Some(new) = source.ids.get(&trajectory) else { return Ok(()) };
        let decoded = TrajectoryData::decode(&*content).unwrap_or_default();
        let mut data = TrajectoryData { trajectory_id: *new, ..decoded };
        let origin = pose_from_proto(decoded.fixed_frame_origin_in_map.as_ref());
        let moved = origin.map(|origin| source.map_from_source * origin);
        let estimate = self.estimates.get(new).copied().unwrap_or_default();
        // What is not changed keeps its digits.
        if let Some(found) = estimate.fixed_frame_origin.or(moved).filter(|found| origin != Some(*found)) {
            data.fixed_frame_origin_in_map = Some(pose_to_proto(&found));
        }
        if let Some(imu) = estimate.imu {
            let q = imu.calibration.quaternion();
            data.gravity_constant = imu.gravity_constant;
            data.imu_calibration = Some(Quaterniond { x: q.i, y: q.j, z: q.k, w: q.w });
        }
        if data == decoded {
            return write(raw.bytes.clone());
        }
        write(SerializedData { data: Some(Data::TrajectoryData(data)) }.encode_to_vec())
    }

    fn measurement(
        &mut self,
        raw: RawMessage,
        kind: MessageKind,
        source: &Source,
        write: Write<'_>,
    ) -> Result<(), EditError> {
        let content = joined(&raw.bytes, kind.tag());
        let trajectory = last_varint(&content, 1) as i32;
        let Some(new) = source.ids.get(&trajectory).copied() else {
            self.sensor_messages_removed += 1;
            return Ok(());
        };
        let bytes = if new == trajectory {
            raw.bytes
        } else {
            let mut renamed = Vec::with_capacity(content.len() + 8);
            put_varint_field(&mut renamed, 1, new.cast_unsigned().into());
            renamed.extend(without_field(&content, 1));
            with_content(&raw, kind, &renamed)
        };
        let Some((start, end)) = self.cuts.get(&new) else { return write(bytes) };
        let time = last_varint(&joined(&content, 2), 1).cast_signed();
        let stream = (new, kind.tag());
        let interpolated = kind != MessageKind::LandmarkData;
        if time < *start && interpolated {
            if self.held.insert(stream, bytes).is_some() {
                self.sensor_messages_removed += 1;
            }
            return Ok(());
        }
        if let Some(before) = self.held.remove(&stream) {
            write(before)?;
        }
        let inside = (*start..=*end).contains(&time);
        if inside || (time > *end && interpolated && self.ended.insert(stream)) {
            return write(bytes);
        }
        self.sensor_messages_removed += 1;
        Ok(())
    }
}

/// The message with other content of its kind; fields beside it stay.
fn with_content(raw: &RawMessage, kind: MessageKind, content: &[u8]) -> Vec<u8> {
    let mut bytes = without_field(&raw.bytes, kind.tag());
    put_bytes_field(&mut bytes, kind.tag(), content);
    bytes
}
