//! Convergence tests.

use super::params::IcpParams;
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

/// Steps to and fro that shrink by less than this, and turn back by more than its arc cosine, are shortened.
const SLOW_RATE: f64 = 0.5;

/// Why an ICP stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// The remaining distance is below `stop_step_mm` and the last turn below `stop_step_rad`.
    Step,
    /// The residual changed by less than `stop_residual_mm`.
    Residual,
    /// `max_iterations` were used up.
    Iterations,
    /// `stop_after_ms` were used up.
    Time,
    /// No step lowers the residual any more, although the remaining distance is not below `stop_step_mm`.
    Stalled,
    /// The observer stopped it.
    Cancelled,
}

/// A stop rule, and how near it was at the end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StopRule {
    /// Its parameter.
    pub parameter: String,
    /// It stops below this limit, or at it for `max_iterations` and `stop_after_ms`; 0: never.
    pub limit: f64,
    /// The value last compared with the limit; none if it was not compared.
    pub last: Option<f64>,
    /// Whether it was met.
    pub met: bool,
}

/// How the Gauss-Newton step changes along the step taken, and where it would become zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Secant {
    /// Length of the next step, in Gauss-Newton steps: 1, or less where steps go to and fro.
    pub(super) factor: f64,
    /// Remaining distance before it, mm; none while steps grow.
    pub(super) remaining_mm: Option<f64>,
}

impl Secant {
    /// From the Gauss-Newton step `before`, the step `taken` instead, and the Gauss-Newton step `now` after it.
    ///
    /// Source: Aitken's delta-squared process; Barzilai and Borwein 1988, eq. 5, for vectors.
    pub(super) fn new(before: &Vector6<f64>, taken: &Vector6<f64>, now: &Vector6<f64>) -> Self {
        let change = before - now;
        let square = change.norm_squared().max(f64::MIN_POSITIVE);
        let turns_back = now.dot(before) < -SLOW_RATE * now.norm() * before.norm();
        let is_to_and_fro = turns_back && now.norm() > SLOW_RATE * before.norm();
        let grows = now.dot(before) >= before.norm_squared() && now.norm() > 0.0;
        Self {
            factor: if is_to_and_fro { taken.dot(&change) / square } else { 1.0 },
            remaining_mm: (!grows).then(|| now.norm() * taken.norm() / square.sqrt()),
        }
    }
}

/// The stop rules of a registration that ended for `reason`.
pub(super) fn rules(
    params: &IcpParams,
    reason: StopReason,
    iterations: u32,
    remaining_mm: Option<f64>,
    step_rad: f64,
    change_mm: Option<f64>,
) -> Vec<StopRule> {
    let rule = |parameter: &str, limit: f64, last: Option<f64>, met: bool| StopRule {
        parameter: parameter.into(),
        limit,
        last,
        met,
    };
    let below = |last: Option<f64>, limit: f64| last.is_some_and(|l| l <= limit);
    vec![
        rule("stop_step_mm", params.stop_step_mm, remaining_mm, below(remaining_mm, params.stop_step_mm)),
        rule("stop_step_rad", params.stop_step_rad, Some(step_rad), step_rad <= params.stop_step_rad),
        rule("stop_residual_mm", params.stop_residual_mm, change_mm, reason == StopReason::Residual),
        rule("stop_after_ms", params.stop_after_ms, None, reason == StopReason::Time),
        rule(
            "max_iterations",
            f64::from(params.max_iterations),
            Some(f64::from(iterations)),
            iterations >= params.max_iterations,
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remaining_distance_is_where_the_secant_is_zero() {
        let along = |length: f64| Vector6::x() * length;
        let secant = |before: f64, taken: f64, now: f64| Secant::new(&along(before), &along(taken), &along(now));
        // Steps of 1, 0.75, 0.5625 ..: 3 mm remain.
        assert_eq!(secant(1.0, 1.0, 0.75), Secant { factor: 1.0, remaining_mm: Some(3.0) });
        // Half of a step that halves them: as much again remains.
        assert_eq!(secant(1.0, 0.5, 0.5).remaining_mm, Some(0.5));
        // To and fro by one step: the limit is in the middle.
        assert_eq!(secant(1.0, 1.0, -1.0), Secant { factor: 0.5, remaining_mm: Some(0.5) });
        assert_eq!(secant(1.0, 1.0, -0.25), Secant { factor: 1.0, remaining_mm: Some(0.2) }, "it shrinks fast");
        assert_eq!(secant(1.0, 1.0, 2.0), Secant { factor: 1.0, remaining_mm: None }, "steps grow");
        assert_eq!(secant(1.0, 1.0, 1.0).remaining_mm, None, "steps stay");
        assert_eq!(secant(1.0, 1.0, 0.0).remaining_mm, Some(0.0));
    }

    #[test]
    fn rules_say_their_limit_the_last_value_and_whether_it_was_met() {
        let params = IcpParams { stop_step_mm: 0.5, stop_step_rad: 0.25, max_iterations: 7, ..IcpParams::default() };
        let met = |reason, iterations, remaining_mm, step_rad| {
            let rules = rules(&params, reason, iterations, remaining_mm, step_rad, Some(0.125));
            let names = ["stop_step_mm", "stop_step_rad", "stop_residual_mm", "stop_after_ms", "max_iterations"];
            assert_eq!(rules.iter().map(|rule| rule.parameter.as_str()).collect::<Vec<_>>(), names);
            assert_eq!(rules.iter().map(|rule| rule.limit).collect::<Vec<_>>(), [0.5, 0.25, 0.0, 0.0, 7.0]);
            let last = [remaining_mm, Some(step_rad), Some(0.125), None, Some(f64::from(iterations))];
            assert_eq!(rules.iter().map(|rule| rule.last).collect::<Vec<_>>(), last);
            rules.iter().map(|rule| rule.met).collect::<Vec<_>>()
        };
        let [yes, no] = [true, false];
        assert_eq!(met(StopReason::Step, 6, Some(0.5), 0.25), [yes, yes, no, no, no]);
        assert_eq!(met(StopReason::Residual, 7, Some(0.51), 0.26), [no, no, yes, no, yes]);
        assert_eq!(met(StopReason::Time, 8, None, 0.0), [no, yes, no, yes, yes]);
    }
}
