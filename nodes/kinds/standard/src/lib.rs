//! The built-in nodes: thin adapters from ports to algorithms, one file per kind or for kinds of the same parameters, folders in pipeline order.
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
pub mod pose;
pub mod refine;
pub mod send;
pub mod surface;
pub mod track;
pub mod transform;
pub mod verdict;

mod constant;
mod moved;
pub mod own_bone;
mod params;
pub mod parts;
pub use params::NoParams;

use acquire::network::NetworkSource;
use constant::Once;
use osteoflow_node::Registry;

/// All built-in kinds and payload types.
pub fn registry() -> Registry {
    let mut registry = Registry::default();
    osteoflow_payloads::register(&mut registry);
    registry
        .source::<Once<acquire::cloud::CloudFile>>()
        .source::<acquire::folder::Folder>()
        .source::<NetworkSource<acquire::foxglove_ws::FoxgloveWs>>()
        .source::<acquire::mcap::Mcap>()
        .source::<acquire::mcap_live::McapLive>()
        .source::<NetworkSource<acquire::openigtlink::OpenIgtLink>>()
        .source::<Once<acquire::points::PointsFile>>()
        .source::<acquire::poses::Poses>()
        .source::<acquire::simulated::Simulated>()
        .source::<acquire::simulated_stream::SimulatedStream>()
        .source::<Once<plan::file::File>>()
        .source::<Once<plan::simulated::Simulated>>()
        .node::<plan::landmarks::Landmarks>()
        .source::<Once<surface::any::Any>>()
        .source::<Once<surface::any::Ct>>()
        .source::<Once<surface::any::File>>()
        .source::<Once<surface::simulated::Simulated>>()
        .source::<Once<surface::simulated_phantom::SimulatedPhantom>>()
        .function::<surface::prepare::Prepare>()
        .function::<surface::prepare::PrepareAny>()
        .function::<surface::prepare::PrepareCloud>()
        .function::<calibrate::phantom_icp::PhantomIcp>()
        .function::<calibrate::hand_eye::HandEye>()
        .function::<calibrate::stylus_pivot::StylusPivot>()
        .function::<transform::stylus_tip::StylusTip>()
        .node::<transform::still_average::StillAverage>()
        .function::<transform::to_world::ToWorld>()
        .function::<transform::to_bone_marker::ToBoneMarker>()
        .function::<transform::points_to_bone_marker::PointsToBoneMarker>()
        .function::<transform::motion_after::MotionAfter>()
        .function::<transform::points::Points>()
        .function::<transform::cloud::Cloud>()
        .function::<transform::first_of::FirstOf>()
        .function::<pose::perturb::Perturb>()
        .node::<crop::r#box::Box>()
        .function::<crop::sphere::Sphere>()
        .node::<crop::polygon::Polygon>()
        .node::<crop::slab::Slab>()
        .node::<crop::file::File>()
        .function::<cloud::downsample::Downsample>()
        .function::<cloud::normals::Normals>()
        .function::<cloud::merge::Merge>()
        .function::<cloud::from_points::FromPoints>()
        .function::<hole::cloud_difference::CloudDifference>()
        .function::<hole::range_image::RangeImage>()
        .function::<hole::boundary::Boundary>()
        .function::<hole::rgb_spot::RgbSpot>()
        .function::<coarse::three_point::ThreePoint>()
        .function::<coarse::global::Global>()
        .function::<landmarks::ruled::Ruled>()
        .function::<icp::point_to_point::PointToPoint>()
        .function::<icp::point_to_plane::PointToPlane>()
        .function::<icp::symmetric::Symmetric>()
        .function::<icp::generalized::Generalized>()
        .function::<icp::point_to_mesh::PointToMesh>()
        .function::<icp::published::Published>()
        .node::<track::last_pose::LastPose>()
        .function::<plane::last::Last>()
        .function::<refine::slide::Slide>()
        .function::<plane::to_world::ToWorld>()
        .function::<plane::update::Update>()
        .function::<metrics::tre_measured::TreMeasured>()
        .function::<metrics::tre_true::TreTrue>()
        .function::<metrics::cuts::Cuts>()
        .function::<metrics::cut_difference::CutDifference>()
        .function::<metrics::fre::Fre>()
        .function::<metrics::surface::Surface>()
        .function::<metrics::calibration::Calibration>()
        .function::<metrics::check_points::CheckPoints>()
        .function::<metrics::laser_spot::LaserSpot>()
        .function::<metrics::pose::Pose>()
        .function::<metrics::verdict::Verdict>()
        .function::<verdict::registration::Registration>()
        .function::<output::export::Export>()
        .function::<output::ply::Ply>()
        .function::<output::csv::Csv>()
        .function::<output::mesh::Mesh>()
        .function::<output::transform::Transform>()
        .function::<output::points::Points>()
        .function::<output::planes::Planes>()
        .node::<send::openigtlink::OpenIgtLink>();
    registry
}
