//! The kind `metrics.calibration`.

use osteoflow_algorithms::metrics::{PoseErrorReport, pose_error};
use osteoflow_geometry::{Pose, nalgebra::Point3};
use osteoflow_node::{
    Context, Describe, Inputs, NodeError, Outputs, function, params, schemars::JsonSchema, serde::Deserialize,
};

/// The true error of a calibration, and what it does to a point at the working distance.
///
/// A point on the camera's axis at `working_distance_mm` moves by `|t_true * inverse(t) * p - p|`: 0.1 degree is 0.35 mm at 200
/// mm.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.calibration"
in   = { t_camera_camera_marker = "calibration.t_camera_camera_marker", t_camera_camera_marker_true = "recording.t_camera_camera_marker_true" }
working_distance_mm = 200.0
"#,
    literature = ["section 3.1 of the paper"]
)]
pub struct Calibration;

/// Parameters of [`Calibration`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Distance of the bone from the camera. 200: the paper's 200 +- 50 mm.
    #[param(200.0, 1.0..=10_000.0)]
    pub working_distance_mm: f64,
}

/// Inputs of [`Calibration`].
#[derive(Inputs)]
pub struct In {
    /// The calibration.
    #[port(to = "t_camera_camera_marker_true.to", from = "t_camera_camera_marker_true.from")]
    t_camera_camera_marker: Pose,
    /// The true calibration.
    #[port(join = "once")]
    t_camera_camera_marker_true: Pose,
}

/// Outputs of [`Calibration`].
#[derive(Outputs)]
pub struct Out {
    /// Translation, rotation, and the error at the working distance.
    report: PoseErrorReport,
}

#[function("metrics.calibration")]
impl Calibration {
    fn process(params: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let (t, truth) = (i.t_camera_camera_marker, i.t_camera_camera_marker_true);
        // A measured world point reaches the camera by the true calibration and comes back by the one in use.
        let error = t.compose(&truth.inverse())?.expect(&t.to, &t.to)?;
        Ok(Out { report: pose_error(&error, &Point3::new(0.0, 0.0, params.working_distance_mm)) })
    }
}
