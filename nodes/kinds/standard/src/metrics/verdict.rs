//! The kind `metrics.verdict`.

use osteoflow_algorithms::metrics::{CutReport, CutsReport, TreReport};
use osteoflow_algorithms::trust::{Verdict as Judged, VerdictScore, VerdictScoreParams, verdict_score};
use osteoflow_geometry::{Pose, nalgebra::Point3};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// A verdict beside the true error, where that is known: was a wrong answer trusted, or a right answer not trusted?
///
/// For `[results]` of a graph that has no entry `verdict` there, so that a refused answer still has a score.
#[derive(Describe)]
#[describe(example = r#"
kind = "metrics.verdict"
in   = { verdict = "verdict.verdict", tre = "tre_true.report", cuts = "cuts.report", t_ct_world = "planes_at_scan.t_ct_world", t_ct_world_true = "recording.t_ct_world_true" }
"#)]
pub struct Verdict;

/// Inputs of [`Verdict`].
#[derive(Inputs)]
pub struct In {
    /// The verdict.
    verdict: Judged,
    /// The true error at the assessment points.
    #[port(join = "once")]
    tre: TreReport,
    /// The true error of the cuts.
    #[port(join = "once")]
    cuts: CutsReport,
    /// The registration.
    #[port(join = "once", to = "t_ct_world_true.to", from = "t_ct_world_true.from")]
    t_ct_world: Pose,
    /// The true registration.
    #[port(join = "once", to = "t_ct_world.to", from = "t_ct_world.from")]
    t_ct_world_true: Pose,
}

/// Outputs of [`Verdict`].
#[derive(Outputs)]
pub struct Out {
    /// The score.
    report: VerdictScore,
}

#[function("metrics.verdict")]
impl Verdict {
    fn process(params: &VerdictScoreParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let error = i.t_ct_world_true.compose(&i.t_ct_world.inverse())?.isometry;
        // Reports of older recordings do not have it; their CT and bone differ by the registration alone.
        let moved = |at: &[f64; 3]| (error * Point3::from(*at) - Point3::from(*at)).norm();
        let cut_error_mm = |cut: &CutReport| cut.moved_mm.unwrap_or_else(|| moved(&cut.at));
        let cut_errors_mm: Vec<f64> = i.cuts.cuts.iter().map(cut_error_mm).collect();
        Ok(Out { report: verdict_score(&i.verdict, &i.tre, &i.cuts, &cut_errors_mm, params) })
    }
}
