//! The kind `metrics.check_points`.

use osteoflow_algorithms::metrics::{CheckReport, check_points};
use osteoflow_geometry::{Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The distance between points read by the camera, carried over by a calibration, and the same points by localiser and CAD.
///
/// One list for each place of the check piece; the place is the part of the points' names before the number.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.check_points"
in   = { read = "recording.check_camera", known = "recording.check_world", calibration = "calibration.t_camera_camera_marker", t_world_camera_marker = "camera_marker.pose", t_camera_camera_marker_true = "recording.t_camera_camera_marker_true" }
"#,
    literature = ["section 3.1 of the paper"]
)]
pub struct CheckPoints;

/// Inputs of [`CheckPoints`].
#[derive(Inputs)]
pub struct In {
    /// Points as read from the camera's cloud.
    #[port(frame = "calibration.to")]
    read: Points,
    /// These points by localiser and CAD, in the same order.
    #[port(frame = "t_world_camera_marker.to")]
    known: Points,
    /// `t_camera_camera_marker`, the calibration to be checked.
    #[port(join = "once", to = "read", from = "t_world_camera_marker.from")]
    calibration: Pose,
    /// The tracked marker on the camera.
    #[port(join = "interpolate", max_gap_ms = 500.0, to = "known", from = "calibration.from")]
    t_world_camera_marker: Pose,
    /// The true calibration, where it is known.
    #[port(join = "once", to = "calibration.to", from = "calibration.from")]
    t_camera_camera_marker_true: Option<Pose>,
}

/// Outputs of [`CheckPoints`].
#[derive(Outputs)]
pub struct Out {
    /// Per point and in summary, with the calibration's true error.
    report: CheckReport,
}

#[function("metrics.check_points")]
impl CheckPoints {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let t_camera_world = i.calibration.compose(&i.t_world_camera_marker.inverse())?;
        let t_camera_world = t_camera_world.expect(&i.read.frame, &i.known.frame)?;
        let error = i.t_camera_camera_marker_true.map(|truth| i.calibration.compose(&truth.inverse())).transpose()?;
        let error = error.map(|pose| pose.expect(&i.read.frame, &i.read.frame)).transpose()?;
        Ok(Out { report: check_points(&i.read.points, &i.known.points, &t_camera_world, error.as_ref())? })
    }
}
