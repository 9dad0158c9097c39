//! The kind `calibrate.hand_eye`.

use osteoflow_algorithms::calibrate::{HandEyeMethod, HandEyeReport, hand_eye, hand_eye_late, hand_eye_pairs};
use osteoflow_geometry::Pose;
use osteoflow_node::{
    Context, Describe, Inputs, NodeError, Outputs, function, params,
    schemars::{self, JsonSchema},
    serde::Deserialize,
};

/// The pose of the camera's marker in the camera, from poses of the marker and of a target that does not move: `A X = X B`.
///
/// The target is a phantom or a board whose pose the camera sees, in any frame of its own. Its place in the tracker's world
/// need not be known, while `calibrate.phantom_icp` needs it. The camera is turned by at least 30 degrees about at least two
/// axes, and held still at each pose. Single poses that contradict the others are left out. The report has the error with an
/// interval of 90 %, the scale, how far the methods differ and how well the motions determine the answer.
/// docs/method/calibration.md lists what is refused and what is a sign.
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

/// Parameters of [`HandEye`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// The method. `park_martin`: rotation by least squares, then translation. The report shows how far the others differ.
    pub method: HandEyeMethod,
    /// Largest difference between the stamps of a pose of the target and the nearest one of the marker. 25: half an interval of
    /// a slow tracker; the camera is held still.
    #[param(25.0, 0.0..=10_000.0)]
    pub max_stamp_difference_ms: f64,
}

/// Inputs of [`HandEye`].
#[derive(Inputs)]
pub struct In {
    /// The camera's marker in the tracker's frame, all poses until the end; those that are left out are not used.
    #[port(join = "collect")]
    marker: Vec<Option<Pose>>,
    /// The target in the camera's frame, likewise.
    #[port(join = "collect")]
    target: Vec<Option<Pose>>,
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

#[function("calibrate.hand_eye")]
impl HandEye {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let taken = |of: Vec<Option<Pose>>| of.into_iter().flatten().collect::<Vec<Pose>>();
        let (markers, targets) = (taken(i.marker), taken(i.target));
        let (Some(marker), Some(target)) = (markers.first(), targets.first()) else {
            let missing = if markers.is_empty() { "marker" } else { "target" };
            return Err(NodeError::new(format!("no pose was received at \"{missing}\"")));
        };
        let stamped = |of: &[Pose], first: &Pose| -> Result<Vec<_>, NodeError> {
            of.iter().map(|pose| Ok((pose.stamp_ns, pose.expect(&first.to, &first.from)?))).collect()
        };
        let (stamped_markers, stamped_targets) = (stamped(&markers, marker)?, stamped(&targets, target)?);
        let max_ns = params.max_stamp_difference_ms * 1e6;
        let pairs = hand_eye_pairs(&stamped_markers, &stamped_targets, 0, max_ns);
        let n_alone = targets.len() - pairs.len();
        if n_alone > 0 {
            ctx.warn(format!(
                "{n_alone} of {} poses of the target are left out: no pose of the marker is within {} ms of them",
                targets.len(),
                params.max_stamp_difference_ms
            ));
        }
        let (stamps_ns, pairs): (Vec<i64>, Vec<_>) = pairs.into_iter().unzip();
        let (t_world_marker, t_camera_target): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
        let found = hand_eye(&t_world_marker, &t_camera_target, params.method);
        let signs = found.as_ref().map_or_else(|_| Vec::new(), |fit| fit.report.signs(&stamps_ns));
        if (found.is_err() || signs.iter().any(|(rule, _)| *rule == "hand_eye_rms"))
            && let Some(late_ns) = hand_eye_late(&stamped_markers, &stamped_targets, max_ns)
        {
            return Err(NodeError::new(format!(
                "the stamps of the target are about {:.2} s later than those of the marker: paired so, the target is in one place; set both \
                 clocks alike, or shift the stamps of one log",
                late_ns as f64 * 1e-9
            )));
        }
        let fit = found?;
        signs.into_iter().for_each(|(rule, words)| ctx.sign(rule, words));
        let t_camera_camera_marker = Pose::new(&target.to, &marker.from, fit.t_marker_camera.inverse());
        Ok(Out { t_camera_camera_marker, report: fit.report })
    }
}
