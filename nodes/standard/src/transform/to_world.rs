//! The kind `transform.to_world`.

use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{Context, Describe, Inputs, Node, NodeError, Outputs, ParamError};

/// The camera's cloud in the tracker's world.
///
/// `cloud_world = t_world_camera_marker * inverse(t_camera_camera_marker) * cloud_camera`. The camera marker's pose is
/// interpolated at the cloud's stamp; where the tracker did not see the marker for longer than `max_gap_ms` around it,
/// there is no result: a stale pose is never used.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "transform.to_world"
in   = { cloud = "crop.cloud", t_world_camera_marker = "camera_marker.pose", calibration = "calibration.t_camera_camera_marker" }
"#,
    literature = ["section 2.2 of the paper"]
)]
pub struct ToWorld;

/// Inputs of [`ToWorld`].
#[derive(Inputs)]
pub struct In {
    /// What the camera saw.
    #[port(frame = "calibration.to")]
    cloud: Cloud,
    /// The tracked marker on the camera.
    #[port(join = "interpolate", max_gap_ms = 200.0, from = "calibration.from")]
    t_world_camera_marker: Pose,
    /// `t_camera_camera_marker`, equation 1.
    #[port(join = "once", to = "cloud")]
    calibration: Pose,
}

/// Outputs of [`ToWorld`].
#[derive(Outputs)]
pub struct Out {
    /// The cloud in the tracker's world.
    #[port(frame = "t_world_camera_marker.to")]
    cloud: Cloud,
    /// Where the camera stood.
    #[port(to = "t_world_camera_marker.to", from = "cloud")]
    t_world_camera: Pose,
}

impl Node for ToWorld {
    const KIND: &'static str = "transform.to_world";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(_: crate::NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let t_world_camera = i.t_world_camera_marker.compose(&i.calibration.inverse())?;
        i.cloud.frame.expect(&t_world_camera.from, "the cloud")?;
        let cloud = i.cloud.transformed(&t_world_camera.to, &t_world_camera.isometry);
        Ok(Out { cloud, t_world_camera: t_world_camera.at(i.cloud.stamp_ns) })
    }
}
