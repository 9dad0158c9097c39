//! The kind `calibrate.stylus_pivot`.

use osteoflow_algorithms::calibrate::{PIVOT_TELLING_RMS_MM as TELLING_RMS_MM, PivotReport, pivot};
use osteoflow_geometry::{NamedPoint, Points, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Describe, Function, Inputs, NodeError, Outputs};

/// The tip of a tracked stylus, from poses of its marker while it is turned about its tip.
///
/// Least squares over `R_i tip + x_i = pivot`. Poses whose tip is farther from the pivot than five standard deviations are left out
/// and told, and the predicted error counts poses that follow each other as far as their errors are independent. Poses that are tilted
/// too little, or about one axis only, are refused, as are a tip farther from its marker than any stylus has it and residuals that no
/// divot and tracker leave. A tip that drifts, or is as near as that of poses in metres, is a sign. That a tracker's lengths are all
/// wrong by a few percent cannot be noticed.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "calibrate.stylus_pivot"
in   = { pose = "recording.stylus_pivoting" }
"#,
    literature = ["Yaniv 2015, Which pivot calibration?, Proc. SPIE 9415"]
)]
pub struct StylusPivot;

/// A tip is no farther from its marker, mm: half a metre of stylus.
const FARTHEST_TIP_MM: f64 = 500.0;
/// A tip is no nearer to its marker, mm: the markers of a tracker are wider.
const NEAREST_TIP_MM: f64 = 20.0;
/// Largest RMS residual, mm: twice the play of the widest divot, and beyond any tracker's noise.
const MOST_RMS_MM: f64 = 5.0;
/// Largest drift of the tip, mm: more than a divot's play, half of what a search for outliers begins at.
const MOST_DRIFT_MM: f64 = 0.5;

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

impl Function for StylusPivot {
    const KIND: &'static str = "calibrate.stylus_pivot";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let poses: Vec<Pose> = i.pose.into_iter().flatten().collect();
        let first = poses.first().ok_or_else(|| NodeError::new("no pose of the stylus' marker was received"))?;
        let isometries: Vec<Isometry3<f64>> =
            poses.iter().map(|pose| pose.expect(&first.to, &first.from)).collect::<Result<_, _>>()?;
        let report = pivot(&isometries)?;
        check(&report, ctx)?;
        Ok(Out { tip: Points::new(&first.from, vec![NamedPoint::new("tip", report.tip.into())]), report })
    }
}

/// Refuses a fit that no stylus gives, and signs one that is doubtful.
fn check(report: &PivotReport, ctx: &mut Context) -> Result<(), NodeError> {
    let length = |of: &[f64; 3]| of.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (tip_mm, pivot_mm, rms_mm) = (length(&report.tip), length(&report.pivot), report.rms_mm);
    if rms_mm > MOST_RMS_MM {
        return Err(NodeError::new(format!(
            "the tip is {rms_mm:.1} mm RMS from one place, {MOST_RMS_MM} mm is allowed; was it kept in one divot, is the quaternion in \
             the order x, y, z, w, and is no axis mirrored?"
        )));
    }
    if tip_mm > FARTHEST_TIP_MM {
        return Err(NodeError::new(format!(
            "the tip is {tip_mm:.0} mm from its marker, {FARTHEST_TIP_MM} mm is allowed, and the pivot {pivot_mm:.0} mm from the \
             tracker; are the poses inverses? give the marker in the tracker's frame, in mm"
        )));
    }
    if tip_mm < NEAREST_TIP_MM {
        ctx.sign(
            "pivot_unit",
            format!(
                "the tip is {tip_mm:.2} mm from its marker, less than the {NEAREST_TIP_MM} mm of the smallest stylus; are the poses in \
                 metres or centimetres? give them in mm"
            ),
        );
    }
    if rms_mm > TELLING_RMS_MM {
        ctx.sign(
            "pivot_rms",
            format!("the tip is {rms_mm:.2} mm RMS from one place, {TELLING_RMS_MM} mm at most is expected; was it kept in one divot?"),
        );
    }
    if report.drift_mm > MOST_DRIFT_MM {
        ctx.sign(
            "pivot_drift",
            format!(
                "the tip drifts by {:.2} mm from the first to the last third of the poses, {MOST_DRIFT_MM} mm at most is expected; did \
                 it slip?",
                report.drift_mm
            ),
        );
    }
    if report.n_outliers > 0 {
        ctx.sign(
            "pivot_outliers",
            format!(
                "{} of {} poses are left out: their tip is up to {:.2} mm from the pivot, where the others are within {:.2} mm",
                report.n_outliers, report.n_poses, report.outlier_max_mm, report.max_mm
            ),
        );
    }
    Ok(())
}
