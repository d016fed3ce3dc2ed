#![allow(clippy::unwrap_used)] // tests fail so
use portolan_config::Options;
use portolan_geometry::{Quaternion, Vector2, embed_3d, rotation_angle};

use super::*;

#[test]
fn a_lost_scanner_restarts_at_its_last_accepted_pose() {
    let mut options = Options::for_2d().trajectory_builder.trajectory_builder_2d;
    options.use_imu_data = false;
    let extras = LocalSlamExtras { adaptive_search: true, ..LocalSlamExtras::default() };
    let velocity = Velocity { linear: Vector2::new(8.0, 0.0), angular: 0.0 };
    let mut front_end = FrontEnd::new(&options, extras, velocity, Role::Mapping).unwrap();
    let at = |seconds: f64| Time::from_ros(1_700_000_000, 0) + Duration::from_seconds(seconds);
    let far = Rigid2::new(40.0, -3.0, 0.5);
    front_end.start_extrapolator(at(0.0)).add_pose(at(5.0), embed_3d(&far));
    front_end.last_confirmed = far;
    let (pose, lost) = front_end.begin_at_dead_reckoning(at(4.0), at(6.0), &Quaternion::identity());
    assert!(pose == far && lost.is_some() && front_end.take_restarted());
    // At the pose of the scan that fitted nowhere.
    front_end.start_extrapolator(at(6.0)).add_pose(at(6.0), embed_3d(&far));
    for speed in [0.0, 5.0] {
        let velocity = Velocity { linear: Vector2::new(speed, 0.0), angular: 0.0 };
        front_end.set_velocity(velocity);
        let predicted = front_end.start_extrapolator(at(6.0)).extrapolate_pose(at(6.1));
        let expected = embed_3d(&(far * velocity.motion(0.1)));
        let off = expected.inverse() * predicted;
        assert!(off.translation.vector.norm() < 1e-6 && rotation_angle(&off) < 1e-6, "{speed} m/s: {off}");
    }
}
