//! Files and foreign streams to geometry and back: surfaces, clouds, picked points, messages in MCAP, plans, folders.
//!
//! Every reader gives millimetres, finite points, rigid motions and the frame that the file names. A reader never repairs
//! silently: ambiguous content is an error with its place and a remedy, data left out are counted, and corrections are noted.
//!
//! | Module | Reads | Writes |
//! |---|---|---|
//! | [`probe`](mod@probe) | what any file or folder is | |
//! | [`mcap_read`] | MCAP recordings of any writer, also damaged ones, and the folders of ROS 2 bags | |
//! | [`message_read`] | point clouds, transforms, poses and images of Foxglove (protobuf, JSON) and ROS 2 (CDR) | |
//! | [`recording_write`] | | recordings of Foxglove's messages |
//! | [`mesh_or_cloud`] | a surface or a cloud: PLY, STL, PCD, OBJ, OFF, VTK, text | |
//! | [`write`] | | surfaces and clouds: PLY, STL, PCD, OBJ, VTK, CSV |
//! | [`picked_points`] | named points of 3D Slicer, MeshLab, CloudCompare, CSV; planes, boxes and scenes of 3D Slicer | markups of 3D Slicer, CSV |
//! | [`scene_file`] | | scenes of 3D Slicer (`.mrb`) |
//! | [`plan_file`] | surgical plans in JSON, or of what was drawn in 3D Slicer | surgical plans in JSON |
//! | [`pose_file`] | one rigid motion: a matrix as text or JSON, an ITK transform | |
//! | [`region_file`] | regions of interest drawn by hand, JSON | the same |
//! | [`poses_csv`] | poses over time | poses over time |
//! | [`pose_log`] | poses over time of others: tracked sequences of PLUS, TUM, EuRoC, KITTI, tables | |
//! | [`volume`] | voxels of a CT: NIfTI, NRRD, MetaImage, a DICOM series | |
//! | [`openigtlink`] | messages of OpenIGTLink | messages of OpenIGTLink |
//! | [`folder`] | a whole procedure as a folder of such files | |
//!
//! ```
//! use nalgebra::Point3;
//! use osteoflow_formats::{message_read::read_cloud, mcap_read::Recording};
//! use osteoflow_formats::recording_write::{Stream, recording_bytes};
//! use osteoflow_geometry::Cloud;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scan = Cloud::new("camera", vec![Point3::new(1.0, 2.0, 200.0)])?.at(1_750_000_011_000_000_000);
//! let streams = [("/camera/scan", Stream::Clouds(vec![scan.clone()]))];
//! let bytes = recording_bytes(&streams, &Default::default(), &[])?;
//!
//! let recording = Recording::from_bytes("example.mcap", &bytes, false)?;
//! let read = read_cloud(&recording.messages("/camera/scan")[0])?;
//! assert_eq!((read.cloud.frame.as_str(), read.cloud.stamp_ns), ("camera", scan.stamp_ns));
//! assert!((read.cloud.points()[0] - scan.points()[0]).norm() < 1e-4, "single precision in metres");
//! # Ok(())
//! # }
//! ```

mod cloud_text;
mod columns;
mod cursor;
mod cut;
mod error;
pub mod folder;
mod foreign_recording;
mod foxglove_json;
pub mod input;
mod invalid;
mod jpeg;
mod json;
mod kind;
mod lost;
pub mod mcap_read;
pub mod mesh_or_cloud;
pub mod message_read;
mod metaimage_header;
mod normals;
mod obj;
mod off;
pub mod openigtlink;
mod pcd;
pub mod picked_points;
mod pixels;
pub mod plan_file;
mod ply;
mod png;
pub mod pose_file;
pub mod pose_log;
pub mod probe;
pub mod recording_write;
pub mod region_file;
mod ros2;
mod scalar;
pub mod scene_file;
mod scene_header;
mod shape;
pub mod space;
mod spellings;
mod stamp_order;
mod stl;
mod table;
mod unit;
pub mod volume;
mod vtk;
pub mod write;

pub use error::FileError;
pub use lost::{LostPose, PoseError};
pub use osteoflow_container::durable;
pub use pose_log::poses_csv;
pub use space::Space;
pub use spellings::{Spellings, without_slash};
pub use stamp_order::StampOrder;

/// A sign that a file is wrong: the name of the rule that found it, and a sentence.
pub type Sign = (&'static str, String);
