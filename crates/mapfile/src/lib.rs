//! Maps as documents: pbstream and its messages, ROS map export
