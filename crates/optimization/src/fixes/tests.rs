use portolan_geometry::{Quaternion, Rigid3};
use portolan_numeric::SplitMix64;

use super::*;
use crate::SensorPolicy;

const ID: TrajectoryId = TrajectoryId(0);
const WEIGHED: SensorPolicy = SensorPolicy {
    estimates_imu_biases: false,
    holds_imu_mounting: false,
    weighs_fixes_by_scatter: true,
    has_robust_fixes: true,
    holds_start_level: false,
};

/// A drive around a block whose map has drifted, and fixes in a frame that is rotated by 2 rad, with this
/// error (east and north).
fn drive(error: impl Fn(u32) -> [f64; 2]) -> OptimizationData {
    let mut data = OptimizationData { sensor_policy: WEIGHED, ..Default::default() };
    let fixed_from_map = Rigid3::from_parts(
        Vector3::new(500.0, -300.0, 20.0).into(),
        rotation_from_roll_pitch_yaw(0.0, 0.0, 2.0),
    );
    for k in 0..400 {
        let (time, angle) = (Time::from_unix_seconds(1e9 + f64::from(k)), 0.01 * f64::from(k));
        let place = Rigid3::translation(60.0 * angle.cos(), 60.0 * angle.sin(), 0.0);
        let drifted = Rigid3::translation(0.002 * f64::from(k), 0.0, 0.0) * place;
        let node = OptimizationNode {
            time,
            local_from_node: drifted,
            map_from_node: drifted,
            gravity_alignment: Quaternion::identity(),
        };
        data.nodes.insert(NodeId::new(ID, k), node);
        let [east, north] = error(k);
        let fix = (fixed_from_map * place).translation.vector + Vector3::new(east, north, 0.0);
        let fixed_from_tracking = Some(Rigid3::translation(fix.x, fix.y, fix.z));
        data.sensors_mut(ID).fixed_frame.insert(time, FixedFramePoseData { time, fixed_from_tracking });
    }
    data
}

fn noise(k: u32) -> [f64; 2] {
    let mut random = SplitMix64::new(u64::from(k));
    [0, 1].map(|_| 2.0 * random.uniform() - 1.0)
}

fn frame(data: &OptimizationData) -> Option<FixedFrame> {
    let options =
        OptimizationProblemOptions { fixed_frame_pose_translation_weight: 10.0, ..Default::default() };
    FixedFrame::of(data, ID, &options)
}

#[test]
fn the_frame_heading_is_estimated_and_fixes_are_weighted_by_scatter() {
    let jump = |k: u32| if (50..60).contains(&k) { 30.0 } else { 0.0 };
    let of = |size: f64| frame(&drive(|k| noise(k).map(|n| size * n + jump(k)))).unwrap();
    let (poor, good) = (of(4.0), of(0.05));
    for found in [&poor, &good] {
        let turned = found.map_from_fixed.rotation * rotation_from_roll_pitch_yaw(0.0, 0.0, 2.0);
        assert!(turned.angle() < 0.02, "{}", turned.angle());
    }
    // Numbers that are uniform from -4 to 4 have a standard deviation of 2.31.
    let sigma = 1.0 / poor.weights.0;
    assert!((2.0..2.8).contains(&sigma), "{sigma}");
    assert_eq!(good.weights.0, 10.0);
}

#[test]
fn slowly_varying_errors_count_as_those_of_a_few_fixes() {
    let slow = |k: u32| {
        let knot = |k: u32| noise(k / 40);
        let share = f64::from(k % 40) / 40.0;
        let (a, b) = (knot(k), knot(k + 40));
        [0, 1].map(|i| 4.0 * (a[i] * (1.0 - share) + b[i] * share))
    };
    let sigma = 1.0 / frame(&drive(slow)).unwrap().weights.0;
    assert!(sigma > 5.0, "{sigma}");
}

#[test]
fn fixes_that_contradict_the_map_are_rejected() {
    let frozen = drive(|_| [0.0; 2]);
    let mut repeated = frozen.clone();
    let fixes = &mut repeated.sensors_mut(ID).fixed_frame;
    let first = fixes.values().next().copied().unwrap();
    fixes.values_mut().for_each(|fix| fix.fixed_from_tracking = first.fixed_from_tracking);
    assert_eq!(frame(&repeated), None);
    let mut in_other_units = frozen;
    for fix in in_other_units.sensors_mut(ID).fixed_frame.values_mut() {
        let place = fix.fixed_from_tracking.unwrap().translation.vector;
        fix.fixed_from_tracking = Some(Rigid3::translation(1000.0 * place.x, 1000.0 * place.y, place.z));
    }
    assert_eq!(frame(&in_other_units), None);
}

#[test]
fn the_cartographer_policy_uses_all_fixes() {
    let data =
        OptimizationData { sensor_policy: SensorPolicy::default(), ..drive(|k| noise(k).map(|n| 4.0 * n)) };
    let found = frame(&data).unwrap();
    assert_eq!(found.weights.0, 10.0);
    assert!(found.map_from_fixed.rotation.angle() < 1e-9);
}
