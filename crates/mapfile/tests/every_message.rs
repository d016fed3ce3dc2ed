//! Every message of the format: what is decoded is encoded to the same bytes, whatever is in it; and what
//! is not known here passes through reading, writing and editing.

#![allow(clippy::unwrap_used, clippy::panic)]

#[path = "common/any_message.rs"]
mod any_message;
use crate::common;

use std::collections::BTreeMap;

use any_message::{RandomBytes, Schema, put_bytes, put_varint};
use common::small_map::SmallMap;
use portolan_mapfile::MapDraft;
use portolan_pbstream::proto::{
    common as common_proto, constraints, ground_truth, mapping, optimization, scan_matching, sensor,
    transform,
};
use portolan_pbstream::{Message, MessageKind, PbstreamReader, PbstreamWriter, RawMessage, ReadLimits};
use proptest::prelude::*;

/// Decodes as a type and encodes again.
type Again = fn(&[u8]) -> Vec<u8>;

fn again<T: prost::Message + Default>(bytes: &[u8]) -> Vec<u8> {
    T::decode(bytes).unwrap().encode_to_vec()
}

macro_rules! messages {
    ($($name:literal => $type:ty,)*) => {
        [$(($name, again::<$type> as Again)),*]
    };
}

/// Every message of the schema and its type, without `cartographer.` before the name.
fn types() -> BTreeMap<String, Again> {
    let types = messages! {
    "common.proto.CeresSolverOptions" => common_proto::CeresSolverOptions,
    "ground_truth.proto.Relation" => ground_truth::Relation,
    "ground_truth.proto.GroundTruth" => ground_truth::GroundTruth,
    "mapping.proto.CellLimits" => mapping::CellLimits,
    "mapping.proto.ConnectedComponents" => mapping::ConnectedComponents,
    "mapping.proto.ConnectedComponents.ConnectedComponent" => mapping::connected_components::ConnectedComponent,
    "mapping.proto.Grid2D" => mapping::Grid2D,
    "mapping.proto.Grid2D.CellBox" => mapping::grid2_d::CellBox,
    "mapping.proto.GridOptions2D" => mapping::GridOptions2D,
    "mapping.proto.HybridGrid" => mapping::HybridGrid,
    "mapping.proto.LocalTrajectoryBuilderOptions2D" => mapping::LocalTrajectoryBuilderOptions2D,
    "mapping.proto.LocalTrajectoryBuilderOptions3D" => mapping::LocalTrajectoryBuilderOptions3D,
    "mapping.proto.MapBuilderOptions" => mapping::MapBuilderOptions,
    "mapping.proto.MapLimits" => mapping::MapLimits,
    "mapping.proto.MotionFilterOptions" => mapping::MotionFilterOptions,
    "mapping.proto.NormalEstimationOptions2D" => mapping::NormalEstimationOptions2D,
    "mapping.proto.ConstantVelocityPoseExtrapolatorOptions" => mapping::ConstantVelocityPoseExtrapolatorOptions,
    "mapping.proto.ImuBasedPoseExtrapolatorOptions" => mapping::ImuBasedPoseExtrapolatorOptions,
    "mapping.proto.PoseExtrapolatorOptions" => mapping::PoseExtrapolatorOptions,
    "mapping.proto.SubmapId" => mapping::SubmapId,
    "mapping.proto.NodeId" => mapping::NodeId,
    "mapping.proto.PoseGraph" => mapping::PoseGraph,
    "mapping.proto.PoseGraph.Constraint" => mapping::pose_graph::Constraint,
    "mapping.proto.PoseGraph.LandmarkPose" => mapping::pose_graph::LandmarkPose,
    "mapping.constraints.proto.ConstraintBuilderOptions" => constraints::ConstraintBuilderOptions,
    "mapping.optimization.proto.OptimizationProblemOptions" => optimization::OptimizationProblemOptions,
    "mapping.proto.PoseGraphOptions" => mapping::PoseGraphOptions,
    "mapping.proto.PoseGraphOptions.OverlappingSubmapsTrimmerOptions2D" => mapping::pose_graph_options::OverlappingSubmapsTrimmerOptions2D,
    "mapping.proto.ProbabilityGrid" => mapping::ProbabilityGrid,
    "mapping.proto.ProbabilityGridRangeDataInserterOptions2D" => mapping::ProbabilityGridRangeDataInserterOptions2D,
    "mapping.proto.RangeDataInserterOptions" => mapping::RangeDataInserterOptions,
    "mapping.proto.RangeDataInserterOptions3D" => mapping::RangeDataInserterOptions3D,
    "mapping.scan_matching.proto.CeresScanMatcherOptions2D" => scan_matching::CeresScanMatcherOptions2D,
    "mapping.scan_matching.proto.IntensityCostFunctionOptions" => scan_matching::IntensityCostFunctionOptions,
    "mapping.scan_matching.proto.CeresScanMatcherOptions3D" => scan_matching::CeresScanMatcherOptions3D,
    "mapping.scan_matching.proto.FastCorrelativeScanMatcherOptions2D" => scan_matching::FastCorrelativeScanMatcherOptions2D,
    "mapping.scan_matching.proto.FastCorrelativeScanMatcherOptions3D" => scan_matching::FastCorrelativeScanMatcherOptions3D,
    "mapping.scan_matching.proto.RealTimeCorrelativeScanMatcherOptions" => scan_matching::RealTimeCorrelativeScanMatcherOptions,
    "mapping.proto.Submap" => mapping::Submap,
    "mapping.proto.Node" => mapping::Node,
    "mapping.proto.ImuData" => mapping::ImuData,
    "mapping.proto.OdometryData" => mapping::OdometryData,
    "mapping.proto.FixedFramePoseData" => mapping::FixedFramePoseData,
    "mapping.proto.LandmarkData" => mapping::LandmarkData,
    "mapping.proto.TrajectoryData" => mapping::TrajectoryData,
    "mapping.proto.LocalSlamResultData" => mapping::LocalSlamResultData,
    "mapping.proto.SerializationHeader" => mapping::SerializationHeader,
    "mapping.proto.SerializedData" => mapping::SerializedData,
    "mapping.proto.Submap2D" => mapping::Submap2D,
    "mapping.proto.Submap3D" => mapping::Submap3D,
    "mapping.proto.SubmapList" => mapping::SubmapList,
    "mapping.proto.SubmapList.SubmapEntry" => mapping::submap_list::SubmapEntry,
    "mapping.proto.SubmapList.TrajectorySubmapList" => mapping::submap_list::TrajectorySubmapList,
    "mapping.proto.SubmapQuery" => mapping::SubmapQuery,
    "mapping.proto.SubmapQuery.Request" => mapping::submap_query::Request,
    "mapping.proto.SubmapQuery.Response" => mapping::submap_query::Response,
    "mapping.proto.SubmapQuery.Response.SubmapTexture" => mapping::submap_query::response::SubmapTexture,
    "mapping.proto.SubmapsOptions2D" => mapping::SubmapsOptions2D,
    "mapping.proto.SubmapsOptions3D" => mapping::SubmapsOptions3D,
    "mapping.proto.GeodeticPosition" => mapping::GeodeticPosition,
    "mapping.proto.Trajectory" => mapping::Trajectory,
    "mapping.proto.Trajectory.Node" => mapping::trajectory::Node,
    "mapping.proto.Trajectory.Submap" => mapping::trajectory::Submap,
    "mapping.proto.InitialTrajectoryPose" => mapping::InitialTrajectoryPose,
    "mapping.proto.TrajectoryBuilderOptions" => mapping::TrajectoryBuilderOptions,
    "mapping.proto.TrajectoryBuilderOptions.PureLocalizationTrimmerOptions" => mapping::trajectory_builder_options::PureLocalizationTrimmerOptions,
    "mapping.proto.SensorId" => mapping::SensorId,
    "mapping.proto.TrajectoryBuilderOptionsWithSensorIds" => mapping::TrajectoryBuilderOptionsWithSensorIds,
    "mapping.proto.AllTrajectoryBuilderOptions" => mapping::AllTrajectoryBuilderOptions,
    "mapping.proto.TrajectoryNodeData" => mapping::TrajectoryNodeData,
    "mapping.proto.PlanarVoxelMap" => mapping::PlanarVoxelMap,
    "mapping.proto.TSDF2D" => mapping::Tsdf2d,
    "mapping.proto.TSDFRangeDataInserterOptions2D" => mapping::TsdfRangeDataInserterOptions2D,
    "sensor.proto.AdaptiveVoxelFilterOptions" => sensor::AdaptiveVoxelFilterOptions,
    "sensor.proto.RangefinderPoint" => sensor::RangefinderPoint,
    "sensor.proto.TimedRangefinderPoint" => sensor::TimedRangefinderPoint,
    "sensor.proto.CompressedPointCloud" => sensor::CompressedPointCloud,
    "sensor.proto.TimedPointCloudData" => sensor::TimedPointCloudData,
    "sensor.proto.RangeData" => sensor::RangeData,
    "sensor.proto.ImuData" => sensor::ImuData,
    "sensor.proto.OdometryData" => sensor::OdometryData,
    "sensor.proto.FixedFramePoseData" => sensor::FixedFramePoseData,
    "sensor.proto.LandmarkData" => sensor::LandmarkData,
    "sensor.proto.LandmarkData.LandmarkObservation" => sensor::landmark_data::LandmarkObservation,
    "transform.proto.TimestampedTransform" => transform::TimestampedTransform,
    "transform.proto.Vector2d" => transform::Vector2d,
    "transform.proto.Vector2f" => transform::Vector2f,
    "transform.proto.Vector3d" => transform::Vector3d,
    "transform.proto.Vector3f" => transform::Vector3f,
    "transform.proto.Vector4f" => transform::Vector4f,
    "transform.proto.Quaterniond" => transform::Quaterniond,
    "transform.proto.Quaternionf" => transform::Quaternionf,
    "transform.proto.Rigid2d" => transform::Rigid2d,
    "transform.proto.Rigid2f" => transform::Rigid2f,
    "transform.proto.Rigid3d" => transform::Rigid3d,
    "transform.proto.Rigid3f" => transform::Rigid3f,
    };
    types.into_iter().map(|(name, again)| (format!("cartographer.{name}"), again)).collect()
}

#[test]
fn no_message_is_left_out() {
    let (schema, types) = (Schema::load(), types());
    assert!(schema.names().eq(types.keys().map(String::as_str)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_message_comes_back_byte_for_byte(seed in any::<u64>()) {
        let (schema, types) = (Schema::load(), types());
        for (i, (name, again)) in types.iter().enumerate() {
            let bytes = schema.any(name, &mut RandomBytes::new(seed.wrapping_add(i as u64)));
            prop_assert_eq!(again(&bytes), bytes, "{}", name);
        }
    }

    #[test]
    fn every_message_of_a_map_survives_a_file_with_unknown_fields(seed in any::<u64>(), number in 100u32..5000) {
        let (schema, mut random) = (Schema::load(), RandomBytes::new(seed));
        let messages: Vec<Vec<u8>> = CONTENTS
            .iter()
            .enumerate()
            .map(|(i, name)| {
                let mut content = schema.any(&format!("cartographer.mapping.proto.{name}"), &mut random);
                put_bytes(&mut content, number, b"within");
                let mut message = Vec::new();
                put_bytes(&mut message, i as u32 + 1, &content);
                put_varint(&mut message, u64::from(number) << 3);
                put_varint(&mut message, seed);
                message
            })
            .collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.pbstream");
        let mut writer = PbstreamWriter::create(&path).unwrap();
        writer.write_header(2).unwrap();
        messages.iter().for_each(|m| writer.write_bytes(m.clone()).unwrap());
        writer.finish().unwrap();
        let read: Vec<RawMessage> = PbstreamReader::open(&path).unwrap().collect::<Result<_, _>>().unwrap();
        prop_assert!(read.iter().skip(1).map(|m| &m.bytes).eq(&messages));
        for raw in &read {
            prop_assert!(!matches!(raw.decode().unwrap(), Message::Unknown(_)));
            prop_assert!(raw.index == 0 || raw.to_text().contains(&number.to_string()));
        }
    }
}

/// What a `SerializedData` can hold, in the order of its fields.
const CONTENTS: [&str; 9] = [
    "PoseGraph",
    "AllTrajectoryBuilderOptions",
    "Submap",
    "Node",
    "TrajectoryData",
    "ImuData",
    "OdometryData",
    "FixedFramePoseData",
    "LandmarkData",
];

#[test]
fn editing_keeps_unknown_fields() {
    let folder = tempfile::tempdir().unwrap();
    let (path, edited) = (folder.path().join("map.pbstream"), folder.path().join("edited.pbstream"));
    SmallMap::new(false).write(&path);
    let before: Vec<RawMessage> = PbstreamReader::open(&path).unwrap().collect::<Result<_, _>>().unwrap();
    let mut writer = PbstreamWriter::create(&path).unwrap();
    for raw in before {
        // Merged into the content of the message, because its field is there a second time.
        let field = raw.kind().tag();
        let mut bytes = raw.bytes;
        if field > 0 {
            let mut unknown = Vec::new();
            put_bytes(&mut unknown, 77, b"of another program");
            put_bytes(&mut bytes, field, &unknown);
            put_bytes(&mut bytes, 99, b"beside it");
        }
        writer.write_bytes(bytes).unwrap();
    }
    writer.finish().unwrap();
    let mut draft = MapDraft::open(&path, ReadLimits::default()).unwrap();
    draft.rename_trajectories(&BTreeMap::from([(0, 3)])).unwrap();
    draft.write(&edited).unwrap();
    let mut kept = 0;
    for raw in PbstreamReader::open(&edited).unwrap() {
        let raw = raw.unwrap();
        if raw.kind() != MessageKind::Header {
            let has = |text: &[u8]| raw.bytes.windows(text.len()).any(|w| w == text);
            assert!(has(b"of another program") && has(b"beside it"), "{:?}", raw.kind());
            kept += 1;
        }
    }
    assert!(kept > 9);
}
