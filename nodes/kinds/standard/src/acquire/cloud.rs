//! The kind `acquire.cloud`.

use crate::{constant::Constant, parts};
use osteoflow_formats::{
    input,
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
};
use osteoflow_geometry::{Cloud, nalgebra::Isometry3};
use osteoflow_node::{
    Context, Describe, FilePath, NodeError, Outputs, ParamError, params, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::Json;
use serde_json::json;
use std::sync::Arc;

/// A scan from a file of points, in any format that `register` reads; of a surface, its vertices.
///
/// Left out, with a warning that counts them, are points that are not finite, and pixels without depth: points at one value
/// that more than 1 % of the points share, if it is farther from each of the others than 20 times the median distance between
/// neighbours; and points at 0, 0, 0 of fewer, if that is also outside of the box around all others.
#[derive(Describe)]
#[describe(example = r#"
kind   = "acquire.cloud"
path   = "scan.ply"
camera = [0.0, 0.0, 0.0]
"#)]
pub struct CloudFile;

/// Parameters of [`CloudFile`].
#[params(path)]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// The file.
    pub path: FilePath,
    /// The frame of its coordinates. `camera`: that of the camera that made the scan.
    #[param("camera")]
    pub frame: String,
    /// Millimetres in the file's unit. 1: most scanners write millimetres; 1000: metres.
    #[param(1.0, 1e-6..=1e6)]
    pub unit_mm: f64,
    /// Position of the camera in the file's coordinates, mm; 0, 0, 0 for a scan in its camera's frame. Points then pair only
    /// with the side of the bone that faces it. Unset: unknown, as after a turntable or a merge of scans.
    pub camera: Option<[f64; 3]>,
    /// Which part of the file is the scan: `"largest"`, its number by size, such as `"2"`, or `"nearest:X,Y,Z"`, the part
    /// nearest to a point, mm; `osteoflow info` lists them. Parts of a surface share corners; in a cluster of points, gaps are
    /// at most five times the median distance to the nearest other point. Unset: all of it.
    pub component: Option<String>,
}

/// Outputs of [`CloudFile`].
#[derive(Outputs)]
pub struct Out {
    /// The cloud, once.
    #[port(frame = "$frame")]
    cloud: Cloud,
    /// What the file holds: `holds` (`points`, or `vertices` of a surface), `n_dropped` points that are not finite, `n_invalid`
    /// pixels without depth, and the `space` of its coordinates.
    report: Json,
}

impl Out {
    /// The outputs for the content of a file, or for points in memory, seen from `camera` if it is known; with notes.
    pub fn of(scan: MeshOrCloud, camera: Option<[f64; 3]>) -> (Self, Vec<String>) {
        let holds = if matches!(scan, MeshOrCloud::Mesh(_)) { "vertices" } else { "points" };
        let (read, notes) = scan.into_cloud();
        let report = json!({ "holds": holds, "n_dropped": read.n_dropped, "n_invalid": read.n_invalid, "space": read.space.to_string() });
        let cloud = match camera {
            // Only the camera's position is used.
            Some([x, y, z]) => read.cloud.seen_from(Isometry3::translation(x, y, z)),
            None => read.cloud,
        };
        (Self { cloud, report: Json(Arc::new(report)) }, notes)
    }
}

impl Constant for CloudFile {
    const KIND: &'static str = "acquire.cloud";
    type Params = Params;
    type Outputs = Out;

    fn check(params: &Params) -> Result<(), ParamError> {
        if params.camera.is_some_and(|camera| camera.iter().any(|c| !c.is_finite())) {
            return Err(ParamError::new("camera", "three finite numbers are expected, such as [0.0, 0.0, 0.0]"));
        }
        parts::choice(params.component.as_deref()).map(drop)
    }

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        let Params { path, frame, unit_mm, camera, component } = params;
        let bytes = input::read(path.as_ref())?;
        let read = read_mesh_or_cloud(path.as_ref(), &bytes, *unit_mm, frame.as_str())?;
        let (read, of_parts) = parts::of_scan(read, parts::choice(component.as_deref())?)
            .map_err(|error| parts::in_file(path.as_ref(), &error))?;
        let (out, notes) = Out::of(read, *camera);
        notes.into_iter().chain(of_parts).for_each(|note| ctx.warn(note));
        Ok(out)
    }
}
