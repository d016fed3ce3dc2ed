#![doc = include_str!("../README.md")]

mod buffer;
mod dimension;
mod geodesy;
mod near_frame;
mod rigid2;
mod rotation;
mod time;
mod transform;

pub use buffer::{TransformBuffer, interpolate};
pub use dimension::Dimension;
pub use geodesy::{EastNorthUp, GeodeticPosition, STANDARD_GRAVITY, Trigonometry};
pub use nalgebra;
pub use near_frame::{FARTHEST_COORDINATE, NearFrame, is_on_earth, moved};
pub use rigid2::{Rigid2, normalize_angle};
pub use rotation::{
    angle_axis_from_quaternion, angular_distance, quaternion_from_angle_axis, roll_pitch_yaw,
    rotation_between, rotation_from_roll_pitch_yaw, yaw,
};
pub use time::{Duration, Time};
pub use transform::{
    Point3f, Quaternion, Rigid3, Rigid3f, Vector2, Vector2f, Vector3, Vector3f, embed_3d, is_valid_pose,
    pose_from_xyz_quaternion, project_2d, rotation_angle, to_f32, to_f64,
};
