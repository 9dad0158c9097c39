//! The kind `transform.to_world`.

use super::{TrackingParams, marker_motion, note_motion};
use osteoflow_algorithms::still_average::{Carries, StillReport, TakeMotion};
use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{Context, Describe, Function, Inputs, NodeError, Outputs};

/// The camera's cloud in the tracker's world.
///
/// `cloud_world = t_world_camera_marker * inverse(t_camera_camera_marker) * cloud_camera`. The camera marker's pose is
/// interpolated at the cloud's stamp; if the tracker did not see the marker for longer than `max_gap_ms` around it,
/// there is no result, because an old pose is never used. A marker that moved before the scan by more than the
/// tracker's noise explains is reported.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "transform.to_world"
in   = { cloud = "crop.cloud", t_world_camera_marker = "camera_marker.pose", motion = "camera_marker.motion", calibration = "calibration.t_camera_camera_marker" }
"#,
    literature = ["section 2.2 of the paper"]
)]
pub struct ToWorld;

/// Inputs of [`ToWorld`].
#[derive(Inputs)]
pub struct In {
    /// The camera's cloud.
    #[port(frame = "calibration.to")]
    cloud: Cloud,
    /// The tracked marker on the camera.
    #[port(join = "interpolate", max_gap_ms = 200.0, from = "calibration.from")]
    t_world_camera_marker: Pose,
    /// How the marker moved in the time before a sample, from `transform.still_average`.
    #[port(join = "latest")]
    motion: Option<StillReport>,
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
    /// The pose of the camera.
    #[port(to = "t_world_camera_marker.to", from = "cloud")]
    t_world_camera: Pose,
    /// How the camera's marker moved while the cloud was taken: for the verdict.
    take_motion: TakeMotion,
}

impl Function for ToWorld {
    const KIND: &'static str = "transform.to_world";
    type Params = TrackingParams;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &TrackingParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let t_world_camera = i.t_world_camera_marker.compose(&i.calibration.inverse())?;
        i.cloud.frame.expect(&t_world_camera.from, "the cloud")?;
        let what = i.cloud.label.as_deref().unwrap_or("the scan");
        note_motion("camera", i.motion.as_ref(), params, what, "before", ctx);
        let cloud = i.cloud.transformed(&t_world_camera.to, &t_world_camera.isometry);
        let camera = marker_motion("camera", Carries::Data, &i.t_world_camera_marker, i.motion.as_ref());
        let take_motion = TakeMotion::new(what).by(camera);
        Ok(Out { cloud, take_motion, t_world_camera: t_world_camera.at(i.cloud.stamp_ns) })
    }
}
