//! The built-in nodes: thin adapters from ports to algorithms, one file per kind, folders in pipeline order.
//!
//! A node holds no mathematics: it checks the frames of its inputs, calls one function of `osteoflow-algorithms`, and gives
//! the result its frames and stamp.
//!
//! ```
//! let registry = osteoflow_standard::registry();
//! let icp = registry.kind("icp.point_to_plane").unwrap();
//! assert!(icp.description.inputs.iter().any(|port| port.name == "init"));
//! ```

pub mod acquire;
pub mod calibrate;
pub mod cloud;
pub mod coarse;
pub mod crop;
pub mod hole;
pub mod icp;
pub mod landmarks;
pub mod metrics;
pub mod output;
pub mod plan;
pub mod plane;
pub mod refine;
pub mod send;
pub mod surface;
pub mod transform;
pub mod verdict;

pub mod own_bone;
mod params;
pub use params::NoParams;

use acquire::network::NetworkSource;
use osteoflow_node::Registry;

/// All built-in kinds and payload types.
pub fn registry() -> Registry {
    let mut registry = Registry::default();
    osteoflow_payloads::register(&mut registry);
    registry
        .source::<acquire::cloud::CloudFile>()
        .source::<acquire::folder::Folder>()
        .source::<NetworkSource<acquire::foxglove_ws::FoxgloveWs>>()
        .source::<acquire::mcap::Mcap>()
        .source::<acquire::mcap_live::McapLive>()
        .source::<NetworkSource<acquire::openigtlink::OpenIgtLink>>()
        .source::<acquire::points::PointsFile>()
        .source::<acquire::simulated::Simulated>()
        .source::<plan::file::File>()
        .source::<plan::simulated::Simulated>()
        .node::<plan::landmarks::Landmarks>()
        .source::<surface::any::Any>()
        .source::<surface::ct::Ct>()
        .source::<surface::file::File>()
        .source::<surface::simulated::Simulated>()
        .source::<surface::simulated_phantom::SimulatedPhantom>()
        .node::<surface::prepare::Prepare>()
        .node::<surface::prepare_any::PrepareAny>()
        .node::<surface::prepare_cloud::PrepareCloud>()
        .node::<calibrate::phantom_icp::PhantomIcp>()
        .node::<calibrate::stylus_pivot::StylusPivot>()
        .node::<transform::stylus_tip::StylusTip>()
        .node::<transform::still_average::StillAverage>()
        .node::<transform::to_world::ToWorld>()
        .node::<transform::to_bone_marker::ToBoneMarker>()
        .node::<transform::points_to_bone_marker::PointsToBoneMarker>()
        .node::<transform::points::Points>()
        .node::<transform::cloud::Cloud>()
        .node::<transform::first_of::FirstOf>()
        .node::<crop::r#box::Box>()
        .node::<crop::sphere::Sphere>()
        .node::<crop::polygon::Polygon>()
        .node::<crop::slab::Slab>()
        .node::<crop::file::File>()
        .node::<cloud::downsample::Downsample>()
        .node::<cloud::normals::Normals>()
        .node::<cloud::merge::Merge>()
        .node::<cloud::from_points::FromPoints>()
        .node::<hole::cloud_difference::CloudDifference>()
        .node::<hole::range_image::RangeImage>()
        .node::<hole::boundary::Boundary>()
        .node::<hole::rgb_spot::RgbSpot>()
        .node::<coarse::three_point::ThreePoint>()
        .node::<coarse::global::Global>()
        .node::<landmarks::ruled::Ruled>()
        .node::<icp::point_to_point::PointToPoint>()
        .node::<icp::point_to_plane::PointToPlane>()
        .node::<icp::symmetric::Symmetric>()
        .node::<icp::generalized::Generalized>()
        .node::<icp::point_to_mesh::PointToMesh>()
        .node::<icp::published::Published>()
        .node::<plane::last::Last>()
        .node::<refine::slide::Slide>()
        .node::<plane::to_world::ToWorld>()
        .node::<plane::update::Update>()
        .node::<metrics::tre_measured::TreMeasured>()
        .node::<metrics::tre_true::TreTrue>()
        .node::<metrics::cuts::Cuts>()
        .node::<metrics::cut_difference::CutDifference>()
        .node::<metrics::fre::Fre>()
        .node::<metrics::surface::Surface>()
        .node::<metrics::calibration::Calibration>()
        .node::<metrics::check_points::CheckPoints>()
        .node::<metrics::laser_spot::LaserSpot>()
        .node::<metrics::verdict::Verdict>()
        .node::<verdict::registration::Registration>()
        .node::<output::export::Export>()
        .node::<output::ply::Ply>()
        .node::<output::csv::Csv>()
        .node::<output::mesh::Mesh>()
        .node::<output::transform::Transform>()
        .node::<output::points::Points>()
        .node::<output::planes::Planes>()
        .node::<send::openigtlink::OpenIgtLink>();
    registry
}
