//! Copies submaps, nodes and measurements from their files, if they are in the draft.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Dimension, Time};
use prost::Message as _;

use super::EditError;
use super::clear::ClearedArea;
use super::draft::{Estimate, Source};
use crate::convert::imu_state_from_proto;
use crate::derived_imu::DerivedImu;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{PoseGraph, SerializedData, Submap, TrajectoryData};
use portolan_pbstream::proto::transform::Quaterniond;
use portolan_pbstream::wire::{joined, last_varint, put_bytes_field, put_varint_field, without_field};
use portolan_pbstream::{IdInFile, pose_from_proto, pose_to_proto};
use portolan_pbstream::{MessageKind, RawMessage};
use portolan_pbstream::{PbstreamReader, ReadLimits};

/// Field numbers of the schema.
const SUBMAP_ID: u32 = 1;
const SUBMAP_2D: u32 = 2;
const SUBMAP_3D: u32 = 3;
const DERIVED_FROM_POSES: u32 = 1000;

type Write<'a> = &'a mut dyn FnMut(Vec<u8>) -> Result<(), EditError>;

/// State while copying the messages after the first three.
pub(super) struct Rest<'a> {
    submaps: BTreeSet<IdInFile>,
    nodes: BTreeSet<IdInFile>,
    cuts: &'a BTreeMap<i32, (i64, i64)>,
    estimates: &'a BTreeMap<i32, Estimate>,
    /// The last measurement of a stream before its cut, which the interpolation at the first node needs.
    held: BTreeMap<(i32, u32), (i64, Vec<u8>)>,
    /// 3D: derived IMU samples, by trajectory.
    derived: BTreeMap<i32, DerivedImu>,
    /// Streams whose first measurement after the cut has been written.
    ended: BTreeSet<(i32, u32)>,
    cleared: &'a [ClearedArea],
    pub cells_cleared: u64,
    pub sensor_messages_removed: u64,
}

impl<'a> Rest<'a> {
    pub fn new(
        graph: &PoseGraph,
        cuts: &'a BTreeMap<i32, (i64, i64)>,
        estimates: &'a BTreeMap<i32, Estimate>,
        dimension: Option<Dimension>,
    ) -> Self {
        let mut submaps = BTreeSet::new();
        let mut nodes = BTreeSet::new();
        for trajectory in &graph.trajectory {
            let t = trajectory.trajectory_id;
            submaps.extend(trajectory.submap.iter().map(|s| (t, s.submap_index)));
            nodes.extend(trajectory.node.iter().map(|n| (t, n.node_index)));
        }
        let in_3d = graph.trajectory.iter().filter(|_| dimension == Some(Dimension::ThreeD));
        let derived = in_3d.map(|t| (t.trajectory_id, DerivedImu::of(t)));
        Self {
            submaps,
            nodes,
            cuts,
            estimates,
            held: BTreeMap::new(),
            derived: derived.collect(),
            ended: BTreeSet::new(),
            cleared: &[],
            cells_cleared: 0,
            sensor_messages_removed: 0,
        }
    }

    /// Sets the areas in which cells of submaps are cleared.
    pub fn clear(&mut self, areas: &'a [ClearedArea]) {
        self.cleared = areas;
    }

    /// Copies the parts of one file that are in the draft.
    ///
    /// # Errors
    /// If the file cannot be read, or if `write` fails.
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
        // Measurements of streams that end before the cut begins.
        for (stream, (time, bytes)) in std::mem::take(&mut self.held) {
            self.write_measured(stream, time, bytes, write)?;
        }
        Ok(())
    }

    /// Writes the derived samples after the last measured ones.
    ///
    /// # Errors
    /// If `write` fails.
    pub fn finish(&mut self, write: Write<'_>) -> Result<(), EditError> {
        let messages = self.derived.values_mut().flat_map(DerivedImu::rest);
        messages.map(|d| SerializedData { data: Some(Data::ImuData(d)) }.encode_to_vec()).try_for_each(write)
    }

    fn write_measured(
        &mut self,
        stream: (i32, u32),
        time: i64,
        bytes: Vec<u8>,
        write: Write<'_>,
    ) -> Result<(), EditError> {
        let of_imu = self.derived.get_mut(&stream.0).filter(|_| stream.1 == MessageKind::ImuData.tag());
        for sample in of_imu.map(|d| d.before(Time::from_ticks(time))).unwrap_or_default() {
            write(SerializedData { data: Some(Data::ImuData(sample)) }.encode_to_vec())?;
        }
        write(bytes)
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
        // Ids are int32: the low half of the varint.
        let (trajectory, index) = (last_varint(&id, 1) as i32, last_varint(&id, 2) as i32);
        let Some(new) = source.ids.get(&trajectory) else { return Ok(()) };
        let wanted = if kind == MessageKind::Submap { &mut self.submaps } else { &mut self.nodes };
        // Removed from the set, so that a second one of the same id is not copied.
        if !wanted.remove(&(*new, index)) {
            return Ok(());
        }
        let broken = |reason: String| {
            let reason = format!("the grid of submap {trajectory},{index} cannot be cut: {reason}");
            EditError::Broken { path: source.path.clone(), reason }
        };
        let content = self.without_cleared_cells((*new, index), kind, content).map_err(broken)?;
        if *new == trajectory && content.is_none() {
            return write(raw.bytes.clone());
        }
        let content = content.unwrap_or_else(|| joined(&raw.bytes, kind.tag()));
        let mut new_id = Vec::new();
        put_varint_field(&mut new_id, 1, new.cast_unsigned().into());
        put_varint_field(&mut new_id, 2, index.cast_unsigned().into());
        let mut renamed = Vec::with_capacity(content.len() + 8);
        put_bytes_field(&mut renamed, 1, &new_id);
        renamed.extend(without_field(&content, 1));
        write(with_content(raw, kind, &renamed))
    }

    /// The content of a submap without the cleared cells; none if nothing changed.
    fn without_cleared_cells(
        &mut self,
        id: IdInFile,
        kind: MessageKind,
        content: Vec<u8>,
    ) -> Result<Option<Vec<u8>>, String> {
        if kind != MessageKind::Submap || self.cleared.is_empty() {
            return Ok(None);
        }
        let mut submap = Submap::decode(&*content).map_err(|error| error.to_string())?;
        let cleared: u64 =
            self.cleared.iter().map(|area| area.clear(id, &mut submap)).sum::<Result<_, _>>()?;
        self.cells_cleared += cleared;
        if cleared == 0 {
            return Ok(None);
        }
        let rest = [SUBMAP_ID, SUBMAP_2D, SUBMAP_3D].iter().fold(content, |rest, n| without_field(&rest, *n));
        let mut bytes = submap.encode_to_vec();
        bytes.extend(rest);
        Ok(Some(bytes))
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
        // Unchanged poses keep all their digits.
        if let Some(found) = estimate.fixed_frame_origin.or(moved).filter(|found| origin != Some(*found)) {
            data.fixed_frame_origin_in_map = Some(pose_to_proto(&found));
        }
        if let Some(imu) = estimate.imu {
            let q = imu.calibration.quaternion();
            data.gravity_constant = imu.gravity_constant;
            data.imu_calibration = Some(Quaterniond { x: q.i, y: q.j, z: q.k, w: q.w });
        }
        if let (Some(derived), Some(state)) = (self.derived.get_mut(new), imu_state_from_proto(&data)) {
            derived.set_state(state);
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
        // Derived samples are computed anew, because nodes may have moved.
        if kind == MessageKind::ImuData && last_varint(&content, DERIVED_FROM_POSES) != 0 {
            return Ok(());
        }
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
        let time = last_varint(&joined(&content, 2), 1).cast_signed();
        let stream = (new, kind.tag());
        let Some((start, end)) = self.cuts.get(&new) else {
            return self.write_measured(stream, time, bytes, write);
        };
        let interpolated = kind != MessageKind::LandmarkData;
        if time < *start && interpolated {
            if self.held.insert(stream, (time, bytes)).is_some() {
                self.sensor_messages_removed += 1;
            }
            return Ok(());
        }
        if let Some((before, held)) = self.held.remove(&stream) {
            self.write_measured(stream, before, held, write)?;
        }
        let inside = (*start..=*end).contains(&time);
        if inside || (time > *end && interpolated && self.ended.insert(stream)) {
            return self.write_measured(stream, time, bytes, write);
        }
        self.sensor_messages_removed += 1;
        Ok(())
    }
}

/// The message with its content of this kind replaced; other fields stay.
fn with_content(raw: &RawMessage, kind: MessageKind, content: &[u8]) -> Vec<u8> {
    let mut bytes = without_field(&raw.bytes, kind.tag());
    put_bytes_field(&mut bytes, kind.tag(), content);
    bytes
}
