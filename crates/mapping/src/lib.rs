//! Local SLAM, submaps, constraints and the pose graph; one pose graph for 2D and 3D
