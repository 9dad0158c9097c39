//! Changes of frame: to the tracker's world, to the marker on the bone.

mod bone_frame;
pub mod cloud;
pub mod first_of;
pub mod motion_after;
pub mod points;
pub mod points_to_bone_marker;
pub mod still_average;
pub mod stylus_tip;
pub mod to_bone_marker;
pub mod to_world;

#[cfg(test)]
mod own_times_tests;

pub use bone_frame::TrackingParams;
pub(crate) use bone_frame::{Carried, marker_motion, note_motion, pose_at};
