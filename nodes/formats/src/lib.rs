//! Files and foreign streams to geometry and back: STL, PLY, Foxglove messages in MCAP, plans, folders.

pub mod cloud_file;
mod error;
mod foxglove_json;
pub mod foxglove_read;
mod lost;
pub mod mcap_read;
pub mod mesh_file;
pub mod plan_file;
mod ply;
pub mod poses_csv;
pub mod recording_write;

pub use error::FileError;
pub use lost::LostPose;
