//! Pictures, clouds and trajectories for other programs
