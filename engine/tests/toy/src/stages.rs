//! Nodes with every feature that `check` examines. They are described and built, never run.
#![allow(dead_code, reason = "the nodes are never run")]

use crate::NoParams;
use osteoflow_node::{
    Context, Declared, Describe, FilePath, Inputs, Node, NodeError, Outputs, ParamError, Payload, Registry,
    SchemaEntry, Source, Unused, Value, View, ViewError, schemars::JsonSchema, serde::Deserialize, serde::Serialize,
};
use std::collections::BTreeMap;

macro_rules! payload {
    ($name:ident, $interpolates:expr) => {
        #[derive(Clone)]
        pub struct $name;

        impl Payload<$name> for $name {
            const NAME: &'static str = concat!("toy/", stringify!($name));
            const VERSION: u32 = 1;
            const SCHEMA: &'static [SchemaEntry] = &[];
            const INTERPOLATES: bool = $interpolates;

            fn to_view(&self) -> View {
                View::new()
            }

            fn from_view(_: &View) -> Result<Self, ViewError> {
                Ok(Self)
            }
        }
    };
}

payload!(Cloud, false);
payload!(Pose, true);
payload!(Target, false);
payload!(Report, false);

macro_rules! params {
    ($(#[$meta:meta])* struct $name:ident { $($body:tt)* }) => {
        #[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
        #[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
        #[schemars(crate = "osteoflow_node::schemars")]
        $(#[$meta])*
        pub struct $name { $($body)* }
    };
}

macro_rules! node {
    ($name:ident, $kind:literal, $params:ty, $inputs:ty, $outputs:ty) => {
        impl Node for $name {
            const KIND: &'static str = $kind;
            type Params = $params;
            type Inputs = $inputs;
            type Outputs = $outputs;

            fn new(_: $params) -> Result<Self, ParamError> {
                Ok(Self)
            }

            fn process(&mut self, _: $inputs, _: &mut Context) -> Result<$outputs, NodeError> {
                Err(NodeError::new("only to be checked"))
            }
        }
    };
}

macro_rules! source {
    ($name:ident, $kind:literal, $live:literal, $params:ty, $outputs:ty) => {
        source!($name, $kind, $live, false, $params, $outputs);
    };
    ($name:ident, $kind:literal, $live:literal, $constant:literal, $params:ty, $outputs:ty) => {
        impl Source for $name {
            const KIND: &'static str = $kind;
            const LIVE: bool = $live;
            const CONSTANT: bool = $constant;
            type Params = $params;
            type Outputs = $outputs;

            fn new(_: $params) -> Result<Self, ParamError> {
                Ok(Self)
            }

            fn next(&mut self, _: &mut Context) -> Result<Option<$outputs>, NodeError> {
                Ok(None)
            }
        }
    };
}

/// Plays a recording.
#[derive(Describe)]
pub struct Recording;

params! {
    #[derive(Default)]
    struct RecordingParams {
        /// The recording to play.
        path: FilePath,
        /// Whether to play a truncated recording up to its end. No: half a scan is no scan.
        allow_truncated: bool,
    }
}

#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct PortParams {
    /// The topic of the recording.
    topic: String,
    /// Keep every n-th message only.
    #[serde(default)]
    every: Option<u32>,
}

source!(Recording, "acquire.recording", false, RecordingParams, Declared<PortParams>);

/// A live camera.
#[derive(Describe)]
pub struct Camera;

#[derive(Outputs)]
pub struct CameraOut {
    /// The scan.
    #[port(frame = "@camera")]
    cloud: Cloud,
}

source!(Camera, "acquire.camera", true, NoParams, CameraOut);

/// Reads a surface.
#[derive(Describe)]
pub struct Surface;

params! {
    #[derive(Default)]
    struct SurfaceParams {
        /// The mesh.
        path: FilePath,
        /// A second mesh.
        other: Option<FilePath>,
        /// The frame of the mesh.
        frame: String,
    }
}

#[derive(Outputs)]
pub struct SurfaceOut {
    /// The prepared surface.
    #[port(frame = "$frame")]
    target: Target,
    /// A report on the mesh.
    report: Report,
}

source!(Surface, "surface.read", false, true, SurfaceParams, SurfaceOut);

/// Keeps the points in a box.
#[derive(Describe)]
pub struct Crop;

params! {
    struct CropParams {
        /// Half the edges, mm. 50: the bone's width.
        half_mm: [f64; 3],
        /// What is kept.
        keep: Keep,
        /// Rounds, from coarse to fine.
        rounds: Vec<Round>,
        /// Named offsets, mm.
        offsets_mm: BTreeMap<String, f64>,
        /// Where to look.
        region: Option<Region>,
        /// A margin: a number, or one for each side.
        margin: Margin,
        /// A label.
        label: String,
        /// A threshold.
        #[schemars(range(min = 0))]
        threshold: Option<f64>,
    }
}

impl Default for CropParams {
    fn default() -> Self {
        Self {
            half_mm: [50.0; 3],
            keep: Keep::Inside,
            rounds: Vec::new(),
            offsets_mm: BTreeMap::new(),
            region: None,
            margin: Margin::All(1.0),
            label: String::new(),
            threshold: None,
        }
    }
}

#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub enum Keep {
    /// What lies in the box.
    Inside,
    /// What lies outside.
    Outside,
}

#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub enum Margin {
    All(f64),
    Each([f64; 3]),
}

#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "shape", rename_all = "snake_case", deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub enum Region {
    Sphere {
        /// Its radius.
        #[schemars(range(min = 1.0))]
        radius_mm: f64,
    },
    Slab {
        /// Its ends.
        from_mm: f64,
        to_mm: f64,
    },
}

params! {
    struct Round {
        /// How many.
        #[schemars(range(min = 1))]
        n: u32,
        /// How finely.
        step_mm: f64,
    }
}

impl Default for Round {
    fn default() -> Self {
        Self { n: 1, step_mm: 0.5 }
    }
}

#[derive(Inputs)]
pub struct CropIn {
    /// What is cut.
    cloud: Cloud,
}

#[derive(Outputs)]
pub struct CropOut {
    /// The points in the box.
    #[port(frame = "cloud")]
    cloud: Cloud,
    /// A report on the crop.
    report: Report,
}

node!(Crop, "crop.box", CropParams, CropIn, CropOut);

/// Keeps the points in a sphere.
#[derive(Describe)]
pub struct CropSphere;

params! {
    struct SphereParams {
        /// The sphere's radius.
        #[schemars(range(min = 1.0, max = 500.0))]
        radius_mm: f64,
        /// The angle that is kept. Half a turn: all of it.
        #[schemars(range(max = 180.0), extend("exclusiveMinimum" = 0.0))]
        angle_deg: f64,
    }
}

impl Default for SphereParams {
    fn default() -> Self {
        Self { radius_mm: 30.0, angle_deg: 180.0 }
    }
}

#[derive(Outputs)]
pub struct CloudOut {
    /// The points in the sphere.
    #[port(frame = "cloud")]
    cloud: Cloud,
}

node!(CropSphere, "crop.sphere", SphereParams, CropIn, CloudOut);

/// Transforms a cloud by a pose.
#[derive(Describe)]
pub struct Transform;

#[derive(Inputs)]
pub struct TransformIn {
    /// The cloud to transform.
    cloud: Cloud,
    /// The motion.
    #[port(join = "interpolate", max_gap_ms = 100.0, from = "cloud")]
    pose: Pose,
}

#[derive(Outputs)]
pub struct TransformOut {
    /// The transformed cloud.
    #[port(frame = "pose.to")]
    cloud: Cloud,
}

node!(Transform, "transform.apply", NoParams, TransformIn, TransformOut);

/// Fine registration, point to point.
#[derive(Describe)]
pub struct PointToPoint;

params! {
    struct IcpParams {
        /// Most steps. 50: three times what the slowest bone needs.
        #[schemars(range(min = 1, max = 1000))]
        max_iterations: u32,
        /// Longest pair. 5 mm: twice the largest error of the coarse fit.
        #[schemars(range(min = 0.1, max = 100.0))]
        max_pair_distance_mm: f64,
        /// Smallest turn that goes on.
        tolerance_rad: f64,
    }
}

impl Default for IcpParams {
    fn default() -> Self {
        Self { max_iterations: 50, max_pair_distance_mm: 5.0, tolerance_rad: 1e-6 }
    }
}

#[derive(Inputs)]
pub struct IcpIn {
    /// Moves: the scanned surface, cropped.
    source: Cloud,
    /// Stays: the prepared surface.
    #[port(join = "once")]
    target: Target,
    /// The initial pose.
    #[port(to = "target", from = "source")]
    init: Option<Pose>,
}

#[derive(Outputs)]
pub struct IcpOut {
    /// The fit.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// A report on the registration.
    report: Report,
}

node!(PointToPoint, "icp.point_to_point", IcpParams, IcpIn, IcpOut);

/// Fine registration, point to plane.
#[derive(Describe)]
pub struct PointToPlane;

params! {
    struct PlaneParams {
        /// Most steps.
        #[schemars(range(min = 1, max = 1000))]
        max_iterations: u32,
        /// Points that span a plane.
        n_neighbours: usize,
    }
}

impl Default for PlaneParams {
    fn default() -> Self {
        Self { max_iterations: 50, n_neighbours: 8 }
    }
}

node!(PointToPlane, "icp.point_to_plane", PlaneParams, IcpIn, IcpOut);

/// Merges several clouds.
#[derive(Describe)]
pub struct Merge;

#[derive(Inputs)]
pub struct MergeIn {
    /// The clouds.
    clouds: Vec<Cloud>,
}

#[derive(Outputs)]
pub struct MergeOut {
    /// All points.
    #[port(frame = "clouds")]
    cloud: Cloud,
}

node!(Merge, "cloud.merge", NoParams, MergeIn, MergeOut);

/// Follows a marker.
#[derive(Describe)]
pub struct Follow;

#[derive(Inputs)]
pub struct FollowIn {
    /// The fit.
    #[port(join = "latest")]
    fit: Pose,
    /// The marker.
    #[port(join = "latest")]
    marker: Pose,
    /// Ignored.
    spare: Unused<Cloud>,
}

#[derive(Outputs)]
pub struct FollowOut {
    /// The pose of the marker.
    pose: Pose,
}

node!(Follow, "plane.follow", NoParams, FollowIn, FollowOut);

/// Writes any value.
#[derive(Describe)]
pub struct Write;

#[derive(Inputs)]
pub struct WriteIn {
    /// The value.
    value: Value,
}

#[derive(Outputs)]
pub struct WriteOut {}

#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct WriteParams {
    /// The file's name in the run's folder.
    name: String,
}

node!(Write, "output.write", WriteParams, WriteIn, WriteOut);

/// A kind with a parameter of a reserved name.
#[derive(Describe)]
pub struct Greedy;

params! {
    #[derive(Default)]
    struct GreedyParams {
        /// A reserved name.
        out: String,
    }
}

node!(Greedy, "output.greedy", GreedyParams, WriteIn, WriteOut);

pub fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Cloud, _>().payload::<Pose, _>().payload::<Target, _>().payload::<Report, _>();
    registry.source::<Recording>().source::<Camera>().source::<Surface>();
    registry.node::<Crop>().node::<CropSphere>().node::<Transform>().node::<PointToPoint>().node::<PointToPlane>();
    registry.node::<Merge>().node::<Follow>().node::<Write>().node::<Greedy>();
    registry
}
