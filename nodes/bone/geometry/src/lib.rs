//! Points, clouds, meshes, planes, poses and frames: the vocabulary of the other crates.
//!
//! Lengths are millimetres, angles radians, times nanoseconds, coordinates `f64`; all frames are right-handed.
//! `t_a_b` takes coordinates in b to coordinates in a, so neighbours cancel in a product:
//!
//! ```
//! use osteoflow_geometry::{Pose, nalgebra::{Isometry3, Point3, Vector3}};
//!
//! let t_world_camera = Pose::new("world", "camera", Isometry3::translation(0.0, 0.0, 200.0));
//! let t_camera_phantom = Pose::new("camera", "phantom", Isometry3::rotation(Vector3::z() * 0.5));
//! let t_world_phantom = t_world_camera.compose(&t_camera_phantom).unwrap();
//! assert_eq!(t_world_phantom.isometry * Point3::origin(), Point3::new(0.0, 0.0, 200.0));
//! assert!(t_camera_phantom.compose(&t_world_camera).is_err(), "phantom does not meet world");
//! ```

pub use nalgebra;
// Linked for its symbols alone: the functions of C are the same on every processor.
use osteoflow_libm as _;

mod axes;
mod cloud;
mod column;
mod distortion;
mod drawn_region;
mod farthest;
mod frame;
mod image;
mod mesh;
mod plan;
mod plane;
mod points;
mod pose;
mod region;
mod rigid;
mod time_column;
mod transform_tree;
mod units;

pub use axes::Axes;
pub use cloud::{Cloud, CloudError};
pub use column::Column;
pub use distortion::{Distortion, DistortionError};
pub use drawn_region::{DrawnOn, DrawnRegion, Shape, encloses};
pub use farthest::{FARTHEST_MM, TooFar};
pub use frame::{Frame, FrameError};
pub use image::{Image, ImageError, Intrinsics};
pub use mesh::{Mesh, MeshError, SurfaceOrigin};
pub use plan::{Anatomy, SurfaceKey, SurgicalPlan};
pub use plane::{Plane, PlanePlace, Planes};
pub use points::{NamedPoint, Points};
pub use pose::Pose;
pub use region::Region;
pub use rigid::{
    Correction, Corrections, EXACT_ROTATION, Nearest, ROTATION_NOISE, ROUNDED_ROTATION, RigidError, check_rotation,
    direction, exact_isometry, first_not_unit, isometry_from_matrix, matrix_rows, nearest_isometry, nearest_rotation,
};
pub use time_column::time_column;
pub use transform_tree::{Chain, Step, TransformTree, TreeError};
pub use units::{MM_PER_M, StampNs};
