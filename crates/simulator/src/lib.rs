//! Buildings, lidars, IMU, wheels and walks with exact truth
