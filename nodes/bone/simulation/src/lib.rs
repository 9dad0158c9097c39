//! A simulated procedure on a built-in bone: camera, tracker, laser, phantom, stylus and CT, all from one seed.
//!
//! [`Procedure::simulate`] returns the contents of a recording (clouds, marker poses and stylus points with stamps),
//! and separately the [`Truth`]. Every error is a parameter with its unit and source, has its own stream of random
//! numbers, and is switched off by 0.
//!
//! ```
//! use osteoflow_simulation::{Procedure, ProcedureParams};
//!
//! let procedure = Procedure::simulate(&ProcedureParams::default(), 42).unwrap();
//! assert_eq!(procedure.scan.len(), 20_000);
//! assert_eq!(procedure.scan.frame.as_str(), "camera");
//! assert_eq!(procedure.laser[0].label.as_deref(), Some("P1"));
//! assert_eq!(procedure.truth.t_world_ct_at_scan.from.as_str(), "ct");
//! ```

pub mod bone;
mod camera;
mod check_piece;
pub mod ct;
mod distortion;
mod draws;
mod error;
mod image;
mod other_bone;
mod params;
pub mod phantom;
mod plan;
pub mod procedure;
mod ranges;
mod scene;
mod simulate;
mod stylus;
mod subject;
mod surroundings;
mod tissue;
mod tracker;
mod waves;
#[cfg(test)]
mod weakest_mode_tests;

pub use bone::BoneParams;
pub use ct::{CtParams, ct_surface};
pub use error::SimulationError;
pub use params::{
    CameraParams, CheckParams, ImageMark, ImageParams, LaserDisc, LaserParams, MotionParams, PeriosteumParams,
    PhantomParams, ProcedureParams, RulerParams, SlipsBefore, StreamParams, StylusParams, TissueParams, TrackerParams,
};
pub use phantom::t_camera_camera_marker_nominal;
pub use plan::{DisplacedParams, displaced, plan};
pub use procedure::{Procedure, ScanStream, Truth};
pub use ranges::without_table_defaults;
pub use subject::Subject;

#[cfg(test)]
fn assert_closed_and_outward(mesh: &osteoflow_geometry::Mesh) -> f64 {
    let n_open = osteoflow_algorithms::mesh_topology::open_edges(mesh);
    assert_eq!(n_open, 0, "{n_open} edges are not shared by two faces that turn alike");
    let volume = mesh.volume_mm3();
    assert!(volume > 0.0, "the normals point inward: volume {volume} mm3");
    volume
}
