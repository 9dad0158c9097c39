//! The verdict of `register`, by the rules of `verdict.registration`.

use super::{
    Stop,
    align::Fit,
    inputs::{Inputs, ms_since},
    start::{OTHER_WAYS, Started},
};
use osteoflow_algorithms::{
    normals,
    target::{Target, TargetError},
    trust::{self, Answer, Case, EvidenceParams, PredictParams, Reason, Registered, RuleParams, Verdict},
};
use osteoflow_engine::run::verdict::{FAILURE, INTERRUPTED, REQUIRE};
use std::time::Instant;

/// The verdict asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judge {
    /// Whether a doubtful pose is refused.
    pub(super) trusted_only: bool,
    pub(super) stop: Stop,
}

/// A verdict and the time that it took, ms.
pub(super) struct Judged {
    pub(super) verdict: Verdict,
    pub(super) ms: f64,
    /// Why there is no pose, if the verdict does not suffice.
    pub(super) refusal: Option<String>,
}

impl Judge {
    /// Judges a pose. A target without normals is examined with estimated ones.
    pub(super) fn judge(self, target: &Target, inputs: &Inputs, started: &Started, fit: &Fit) -> Judged {
        let began = Instant::now();
        let with_normals = match target.normals() {
            Some(_) => None,
            None => estimated(target),
        };
        let ended = fit.report.ended();
        let (landmarks, located) = inputs.start.landmarks();
        let case = Case {
            registered: Registered {
                target: with_normals.as_ref().unwrap_or(target),
                source: inputs.source.cloud(),
                t_target_source: &fit.t_target_source,
                at: &[],
            },
            // A fixed number of steps need not converge.
            icp: (self.stop == Stop::Converge).then_some(&ended),
            landmarks,
            located,
            assessment: &[],
            planes: None,
            tracking: None,
            measured_tre_mm: None,
            slide: None,
            check: &[],
            start: started.shape(),
            reasons: &[],
        };
        let (examine, rules, errors) = (EvidenceParams::default(), RuleParams::default(), PredictParams::default());
        let mut verdict = trust::judge(&case, &examine, &rules, &errors);
        verdict.assumptions = assumptions(inputs, with_normals.is_some());
        if ended.converged.is_none() {
            verdict.assumptions.push("the plugin converged: it does not report whether it did".to_owned());
        }
        if started.shape().is_some() {
            let by_shape = verdict.reasons.iter_mut().filter(|reason| ["start", "shape"].contains(&&*reason.rule));
            by_shape.for_each(|reason| reason.remedy = format!("start from {OTHER_WAYS}, or scan more of the bone"));
        }
        let first = verdict.reasons.first().map(|first| format!("{}; {}", first.reason, first.remedy));
        let refusal = match (verdict.answer, first) {
            (Answer::Refused, Some(first)) => Some(format!("the pose is refused: {first}")),
            (Answer::Doubtful, Some(first)) if self.trusted_only => {
                let reason = "the pose is doubtful, and --require is trusted";
                let remedy = "remove the doubts, or let doubtful poses pass with --require doubtful";
                verdict.answer = Answer::Refused;
                verdict.reasons.insert(0, Reason::new(REQUIRE, Answer::Refused, reason, remedy));
                Some(format!("{reason}: {first}"))
            }
            _ => None,
        };
        Judged { verdict, ms: ms_since(began), refusal }
    }
}

/// The verdict where there is no pose to judge.
pub(super) fn no_pose(why: &str) -> Verdict {
    let reason = Reason::new(FAILURE, Answer::Refused, why, "mend the cause and run again");
    Verdict::new(vec![reason], Vec::new(), None, None)
}

/// The verdict of a registration that was interrupted.
pub(super) fn interrupted() -> Verdict {
    let reason = Reason::new(INTERRUPTED, Answer::Refused, "interrupted", "run it again to its end");
    Verdict::new(vec![reason], Vec::new(), None, None)
}

/// The target with estimated normals; `None` if they cannot be estimated.
fn estimated(target: &Target) -> Option<Target> {
    let normals = normals::of_surface(target.points()).ok()?;
    let with_normals: Result<Target, TargetError> =
        Target::new(target.frame.clone(), target.origin, target.point_column().clone(), Some(normals.into()));
    with_normals.ok()
}

/// What the verdict takes for granted.
fn assumptions(inputs: &Inputs, estimated_to_judge: bool) -> Vec<String> {
    let mut all = vec![
        "the target shows the bone at its true size, and its surface is not swollen or shrunk as a whole",
        "no plan or calibration was given, so only the scan and the surface were examined",
    ];
    if inputs.source.cloud().viewpoint.is_none() {
        all.push("without --camera it was not examined whether the scan lies on the side that the camera saw");
    }
    if estimated_to_judge || inputs.target.has_estimated_normals() {
        all.push("the target's normals were estimated; on an open surface their side is a guess");
    }
    all.into_iter().map(str::to_owned).collect()
}
