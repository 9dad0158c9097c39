//! The kind `calibrate.stylus_pivot`.

use osteoflow_algorithms::calibrate::{PivotReport, pivot};
use osteoflow_geometry::{NamedPoint, Points, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Describe, Function, Inputs, NodeError, Outputs};

/// The tip of a tracked stylus, from poses of its marker while it is turned about its tip.
///
/// Least squares over `R_i tip + x_i = pivot`. Poses whose tip is farther from the pivot than five standard deviations are left out
/// and told, and the predicted error counts poses that follow each other as far as their errors are independent. Poses that are tilted
/// too little, or about one axis only, are refused.
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
    /// The stylus' marker, all poses until the end.
    #[port(join = "collect")]
    pose: Vec<Pose>,
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

impl Function for StylusPivot {
    const KIND: &'static str = "calibrate.stylus_pivot";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let first = i.pose.first().ok_or_else(|| NodeError::new("no pose of the stylus' marker was received"))?;
        let poses: Vec<Isometry3<f64>> =
            i.pose.iter().map(|pose| pose.expect(&first.to, &first.from)).collect::<Result<_, _>>()?;
        let report = pivot(&poses)?;
        if report.n_outliers > 0 {
            ctx.warn(format!(
                "{} of {} poses are left out: their tip is up to {:.2} mm from the pivot, where the others are within {:.2} mm",
                report.n_outliers, report.n_poses, report.outlier_max_mm, report.max_mm
            ));
        }
        Ok(Out { tip: Points::new(&first.from, vec![NamedPoint::new("tip", report.tip.into())]), report })
    }
}
