//! How the registration that is judged ended.

use crate::icp::{IcpReport, StopReason};
use osteoflow_verdict::{Answer, Reason};
use serde::Deserialize;

/// A registration that has not converged but is this close to its end is as good, mm.
const CLOSE_MM: f64 = 0.05;

/// How an iterative registration ended, as far as its report has it. Other keys of a report are ignored.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Convergence {
    /// Whether it converged.
    pub converged: Option<bool>,
    /// Remaining distance to where it would converge, mm.
    pub remaining_mm: Option<f64>,
    /// Why it stopped.
    pub stop_reason: Option<StopCause>,
}

/// Why an iterative registration stopped.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum StopCause {
    /// By a rule of the built-in ICPs.
    By(StopReason),
    /// In the words of another ICP.
    Other(String),
}

impl From<&IcpReport> for Convergence {
    fn from(report: &IcpReport) -> Self {
        Self {
            converged: Some(report.converged),
            remaining_mm: report.remaining_mm,
            stop_reason: Some(StopCause::By(report.stop_reason)),
        }
    }
}

/// The sign in a registration that stopped before its end; none if it rests `unsettled_mm` from where the scan fits best nearby,
/// and that is close enough.
pub(super) fn convergence_reason(ended: &Convergence, unsettled_mm: Option<f64>) -> Option<Reason> {
    let is_far = |mm: f64| mm > CLOSE_MM;
    let is_short =
        ended.converged == Some(false) && ended.remaining_mm.is_none_or(is_far) && unsettled_mm.is_none_or(is_far);
    is_short.then(|| {
        let by = ended.stop_reason.as_ref().map(|stopped| format!(": it stopped by {}", words(stopped)));
        let reason = format!("the registration did not converge{}", by.unwrap_or_default());
        Reason::new("converged", Answer::Doubtful, reason, "allow more steps (max_iterations) or begin nearer")
    })
}

fn words(stopped: &StopCause) -> &str {
    match stopped {
        StopCause::By(StopReason::Step) => "its step",
        StopCause::By(StopReason::Residual) => "stop_residual_mm",
        StopCause::By(StopReason::Iterations) => "max_iterations",
        StopCause::By(StopReason::Time) => "stop_after_ms",
        StopCause::By(StopReason::Stalled) => "a step that does not lower the residual",
        StopCause::By(StopReason::Cancelled) => "the user",
        StopCause::Other(words) => words,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reason(report: &str) -> Option<String> {
        convergence_reason(&serde_json::from_str(report).unwrap(), Some(0.3)).map(|reason| reason.reason)
    }

    #[test]
    fn a_registration_that_rests_where_the_scan_fits_best_has_ended() {
        let stopped = Convergence { converged: Some(false), ..Convergence::default() };
        assert!(convergence_reason(&stopped, None).is_some() && convergence_reason(&stopped, Some(0.06)).is_some());
        assert_eq!(convergence_reason(&stopped, Some(0.04)), None);
    }

    #[test]
    fn either_distance_that_is_at_most_0_05_mm_ends_a_registration() {
        let at = |remaining_mm| Convergence { converged: Some(false), remaining_mm, ..Convergence::default() };
        let is_short = |remaining_mm, unsettled_mm| convergence_reason(&at(remaining_mm), unsettled_mm).is_some();
        assert!(is_short(None, None) && is_short(Some(0.06), Some(0.06)) && is_short(Some(0.06), None));
        assert!(!is_short(Some(0.05), Some(0.06)) && !is_short(Some(0.06), Some(0.05)));
        let converged = Convergence { converged: Some(true), remaining_mm: Some(0.3), ..Convergence::default() };
        assert_eq!(convergence_reason(&converged, Some(0.3)), None);
    }

    #[test]
    fn each_rule_by_which_it_stopped_is_named() {
        for (stop, words) in [
            (StopReason::Step, "its step"),
            (StopReason::Residual, "stop_residual_mm"),
            (StopReason::Iterations, "max_iterations"),
            (StopReason::Time, "stop_after_ms"),
            (StopReason::Stalled, "a step that does not lower the residual"),
            (StopReason::Cancelled, "the user"),
        ] {
            let ended =
                Convergence { converged: Some(false), stop_reason: Some(StopCause::By(stop)), remaining_mm: None };
            let reason = convergence_reason(&ended, None).unwrap();
            assert_eq!(reason.reason, format!("the registration did not converge: it stopped by {words}"));
            assert_eq!((reason.rule.as_str(), reason.answer), ("converged", Answer::Doubtful));
        }
    }

    #[test]
    fn any_report_is_read_as_far_as_it_goes() {
        assert_eq!(reason(r#"{ "iterations": 7, "n_pairs": [1, 2] }"#), None);
        assert_eq!(reason(r#"{ "converged": true, "stop_reason": "residual" }"#), None);
        assert_eq!(reason(r#"{ "converged": false }"#).unwrap(), "the registration did not converge");
        let by_rule = reason(r#"{ "converged": false, "stop_reason": "iterations" }"#).unwrap();
        assert!(by_rule.ends_with("it stopped by max_iterations"), "{by_rule}");
        let by_words = reason(r#"{ "converged": false, "remaining_mm": 0.2, "stop_reason": "its lattice" }"#).unwrap();
        assert!(by_words.ends_with("it stopped by its lattice"), "{by_words}");
        assert_eq!(reason(r#"{ "converged": false, "remaining_mm": 0.02, "stop_reason": "time" }"#), None);
    }
}
