//! Tracking: the registration of a scan starts from that of the scan before.

pub mod last_pose;
