//! The kind `calibrate.stylus_pivot`.

use osteoflow_algorithms::calibrate::{PivotReport, pivot};
use osteoflow_geometry::{NamedPoint, Points, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The tip of a tracked stylus, from poses of its marker while it is turned about its tip.
///
/// Least squares over `R_i tip + x_i = pivot`. Poses whose tip is farther from the pivot than six standard deviations are left
/// out, with a note. The predicted error counts successive poses only as far as their errors are independent.
/// docs/method/calibration.md lists what is refused and what is a sign. Lengths of a tracker that are wrong by a few percent go
/// unnoticed.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "calibrate.stylus_pivot"
in   = { pose = "recording.stylus_pivoting" }
"#,
    literature = ["Yaniv 2015, Which pivot calibration?, Proc. SPIE 9415"]
)]
pub struct StylusPivot;

/// Inputs of [`StylusPivot`].
#[derive(Inputs)]
pub struct In {
    /// The stylus' marker, all poses until the end; those that are left out are not used.
    #[port(join = "collect")]
    pose: Vec<Option<Pose>>,
}

/// Outputs of [`StylusPivot`].
#[derive(Outputs)]
pub struct Out {
    /// One point, `tip`, in the marker's frame.
    #[port(frame = "pose.from")]
    tip: Points,
    /// Residual, outliers, number of independent poses, condition, tip and pivot.
    report: PivotReport,
}

#[function("calibrate.stylus_pivot")]
impl StylusPivot {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let poses: Vec<Pose> = i.pose.into_iter().flatten().collect();
        let first = poses.first().ok_or_else(|| NodeError::new("no pose of the stylus' marker was received"))?;
        let isometries: Vec<Isometry3<f64>> =
            poses.iter().map(|pose| pose.expect(&first.to, &first.from)).collect::<Result<_, _>>()?;
        let report = pivot(&isometries)?;
        let stamps_ns: Vec<i64> = poses.iter().map(|pose| pose.stamp_ns).collect();
        report.signs(&stamps_ns).into_iter().for_each(|(rule, words)| ctx.sign(rule, words));
        Ok(Out { tip: Points::new(&first.from, vec![NamedPoint::new("tip", report.tip.into())]), report })
    }
}
