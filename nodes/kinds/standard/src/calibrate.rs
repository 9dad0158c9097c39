//! Calibration of the camera to its marker, and of the stylus tip to its own.

pub mod hand_eye;
pub mod phantom_icp;
pub mod stylus_pivot;
