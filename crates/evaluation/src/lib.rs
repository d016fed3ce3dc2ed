//! Trajectory errors, relations, map sharpness
