//! The kind `calibrate.hand_eye`.

use osteoflow_algorithms::calibrate::{
    HAND_EYE_TELLING_RMS_MM, HAND_EYE_TELLING_RMS_RAD, HandEyeMethod, HandEyeReport, hand_eye,
};
use osteoflow_geometry::{Pose, nalgebra::Isometry3};
use osteoflow_node::{
    Context, Describe, Function, Inputs, NodeError, Outputs,
    schemars::{self, JsonSchema},
    serde::Deserialize,
};

/// The pose of the camera's marker in the camera, from poses of the marker and of a target that does not move: `A X = X B`.
///
/// The target is a phantom or a board whose pose the camera sees, in any frame of its own. Its place in the tracker's
/// world need not be known, while `calibrate.phantom_icp` needs it. The camera is turned by 30 degrees or more about
/// two axes or more, and held still at each pose. Motions about one axis alone are refused, as are poses of which one or the other are
/// inverses; a camera that is farther from its marker than the target from the tracker is warned of. The report says how far the methods differ and how well the motions determine the answer.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "calibrate.hand_eye"
in   = { marker = "recording.camera_marker", target = "recording.board" }
method = "park_martin"
"#,
    literature = [
        "Park and Martin 1994, Robot sensor calibration: solving AX = XB on the Euclidean group",
        "Tsai and Lenz 1989, A new technique for fully autonomous and efficient 3D robotics hand/eye calibration",
        "Daniilidis 1999, Hand-eye calibration using dual quaternions"
    ]
)]
pub struct HandEye;

/// Largest RMS distance of the target from one place, mm: no camera errs by it.
const MOST_RMS_MM: f64 = 10.0;
/// A scale is a sign if it differs from 1 by more than this, and by four of its standard deviations: 1 mm at 200 mm.
const MOST_SCALE: f64 = 0.005;
const SCALE_SIGMAS: f64 = 4.0;
/// Largest radius that holds 90 % of the errors of the translation, mm, and that radius in standard deviations per direction.
const MOST_ERROR_MM: f64 = 5.0;
const RADIUS_90: f64 = 2.5;

/// A marker is no farther from its camera than this, mm, where the target is nearer to the tracker than half of it.
const FARTHEST_MARKER_MM: f64 = 300.0;

/// Parameters of [`HandEye`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The method. park_martin: rotation by least squares, then translation; the others show in the report how far they differ.
    pub method: HandEyeMethod,
    /// Largest difference between the stamps of a pose of the target and the nearest one of the marker, ms. 25: half an interval
    /// of a slow tracker; the camera is held still.
    #[schemars(range(min = 0.0, max = 10_000.0))]
    pub max_stamp_difference_ms: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { method: HandEyeMethod::default(), max_stamp_difference_ms: 25.0 }
    }
}

/// Inputs of [`HandEye`].
#[derive(Inputs)]
pub struct In {
    /// The camera's marker in the tracker's frame, all poses until the end.
    #[port(join = "collect")]
    marker: Vec<Pose>,
    /// The target in the camera's frame, all poses until the end.
    #[port(join = "collect")]
    target: Vec<Pose>,
}

/// Outputs of [`HandEye`].
#[derive(Outputs)]
pub struct Out {
    /// The calibration.
    #[port(to = "target.to", from = "marker.from")]
    t_camera_camera_marker: Pose,
    /// Residuals, observability and predicted error.
    report: HandEyeReport,
}

impl Function for HandEye {
    const KIND: &'static str = "calibrate.hand_eye";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let (Some(marker), Some(target)) = (i.marker.first(), i.target.first()) else {
            let missing = if i.marker.is_empty() { "marker" } else { "target" };
            return Err(NodeError::new(format!("no pose was received at \"{missing}\"")));
        };
        let markers =
            i.marker.iter().map(|pose| pose.expect(&marker.to, &marker.from)).collect::<Result<Vec<_>, _>>()?;
        let targets =
            i.target.iter().map(|pose| pose.expect(&target.to, &target.from)).collect::<Result<Vec<_>, _>>()?;
        let most_ns = params.max_stamp_difference_ms * 1e6;
        let pair = |(pose, t_camera_target): (&Pose, &Isometry3<f64>)| {
            let off = |of: &Pose| of.stamp_ns.abs_diff(pose.stamp_ns);
            let (marker, t_world_marker) = i.marker.iter().zip(&markers).min_by_key(|(marker, _)| off(marker))?;
            (off(marker) as f64 <= most_ns).then_some((*t_world_marker, *t_camera_target))
        };
        let (t_world_marker, t_camera_target): (Vec<_>, Vec<_>) =
            i.target.iter().zip(&targets).filter_map(pair).unzip();
        let n_alone = targets.len() - t_camera_target.len();
        if n_alone > 0 {
            ctx.warn(format!(
                "{n_alone} of {} poses of the target are left out: no pose of the marker is within {} ms of them",
                targets.len(),
                params.max_stamp_difference_ms
            ));
        }
        let fit = hand_eye(&t_world_marker, &t_camera_target, params.method)?;
        check(&fit.report, ctx)?;
        let camera_mm = fit.t_marker_camera.translation.vector.norm();
        let placed = t_world_marker[0] * fit.t_marker_camera * t_camera_target[0];
        let target_mm = placed.translation.vector.norm();
        if camera_mm > FARTHEST_MARKER_MM && target_mm < camera_mm / 2.0 {
            ctx.sign("hand_eye_exchanged", format!(
                "the camera is {camera_mm:.0} mm from its marker, and the target {target_mm:.0} mm from the tracker; is the camera on a \
                 stand and the target on the marker, are marker and target exchanged, or the poses of both inverses?"
            ));
        }
        let t_camera_camera_marker = Pose::new(&target.to, &marker.from, fit.t_marker_camera.inverse());
        Ok(Out { t_camera_camera_marker, report: fit.report })
    }
}

/// Refuses a fit that does not explain its poses, and signs one that is doubtful.
fn check(report: &HandEyeReport, ctx: &mut Context) -> Result<(), NodeError> {
    let HandEyeReport { rms_mm, rms_rad, scale, scale_sd, .. } = *report;
    let is_scaled = (scale - 1.0).abs() > MOST_SCALE.max(SCALE_SIGMAS * scale_sd);
    if is_scaled {
        ctx.sign(
            "hand_eye_scale",
            format!(
                "the target's lengths are {scale:.4} +- {scale_sd:.4} of the tracker's, and leave {:.2} mm RMS in place of {rms_mm:.2} mm; \
                 multiply the size of the board by {:.4}, or give both logs in mm (the pose is that of scale 1)",
                report.scaled_rms_mm,
                1.0 / scale
            ),
        );
    }
    let words = format!(
        "the target is {rms_mm:.1} mm and {:.1} degrees RMS from one place; was it moved, is its length in another unit, or are poses of \
         different times paired?",
        rms_rad.to_degrees()
    );
    if rms_mm > MOST_RMS_MM {
        return Err(NodeError::new(words));
    }
    if !is_scaled && (rms_mm > HAND_EYE_TELLING_RMS_MM || rms_rad > HAND_EYE_TELLING_RMS_RAD) {
        ctx.sign("hand_eye_rms", words);
    }
    if report.n_outliers > 0 {
        let (n, n_kept) = (report.n_outliers, report.n_poses);
        ctx.sign(
            "hand_eye_outliers",
            format!(
                "{n} of {} poses are left out: the target is far from where the others have it; are they flipped?",
                n + n_kept
            ),
        );
    }
    if RADIUS_90 * report.translation_sd_mm > MOST_ERROR_MM {
        ctx.sign(
            "hand_eye_open",
            format!(
                "the camera's place is known to {:.1} mm (90 %); take more poses, and turn the camera by 30 degrees or more",
                RADIUS_90 * report.translation_sd_mm
            ),
        );
    }
    Ok(())
}
