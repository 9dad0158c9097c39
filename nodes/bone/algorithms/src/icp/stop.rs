//! Convergence tests.

use super::params::IcpParams;
use serde::{Deserialize, Serialize};

/// Upper bound on the contraction rate: at most 1000 further steps of the last length are assumed.
const MAX_RATE: f64 = 0.999;

/// Upper bound on the contraction rate assumed after an extrapolated step.
const MAX_EXTRAPOLATED_RATE: f64 = 0.9;

/// Contraction rate assumed before there are two steps.
const UNKNOWN_RATE: f64 = 0.5;

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

/// Contraction rate of the steps, and the distance to the limit of their geometric series.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ConvergenceRate {
    last_mm: Option<f64>,
    rate: Option<f64>,
    /// Lower bound on the rate, from extrapolated steps.
    least_rate: f64,
}

impl ConvergenceRate {
    /// Sets a lower bound on the rate: steps shortened by an extrapolation do not show it.
    pub(super) fn at_least(&mut self, rate: f64) {
        self.least_rate = self.least_rate.max(rate.min(MAX_EXTRAPOLATED_RATE));
    }

    /// The remaining distance before a step of this length, `step / (1 - rate)`; `None` while steps grow.
    pub(super) fn remaining_mm(&mut self, step_mm: f64) -> Option<f64> {
        if let Some(last) = self.last_mm.replace(step_mm).filter(|l| *l > 0.0) {
            self.rate = Some(step_mm / last);
        }
        self.before_mm(step_mm)
    }

    /// The remaining distance after a step of this length.
    pub(super) fn remaining_after_mm(&self, step_mm: f64) -> Option<f64> {
        self.before_mm(step_mm).map(|remaining| remaining * self.rate())
    }

    fn before_mm(&self, step_mm: f64) -> Option<f64> {
        let rate = self.rate();
        (rate < 1.0 || step_mm == 0.0).then(|| if step_mm == 0.0 { 0.0 } else { step_mm / (1.0 - rate.min(MAX_RATE)) })
    }

    fn rate(&self) -> f64 {
        self.rate.unwrap_or(UNKNOWN_RATE).max(self.least_rate)
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
    fn the_remaining_distance_is_the_sum_of_a_geometric_series() {
        let mut rate = ConvergenceRate::default();
        // Half a step follows each of an unknown rate.
        assert_eq!(rate.remaining_mm(4.0), Some(8.0));
        assert_eq!(rate.remaining_mm(1.0), Some(1.0 / 0.75));
        assert_eq!(rate.remaining_after_mm(1.0), Some(1.0 / 0.75 * 0.25));
        rate.at_least(0.5);
        assert_eq!(rate.remaining_mm(0.25), Some(0.5), "no faster than told");
        rate.at_least(0.99);
        assert!((rate.remaining_mm(0.1).unwrap() - 1.0).abs() < 1e-12, "what is told counts up to 0.9");
        assert_eq!(rate.remaining_mm(0.2), None, "steps grow");
        assert_eq!(rate.remaining_mm(0.0), Some(0.0));
        let mut rate = ConvergenceRate::default();
        assert_eq!([rate.remaining_mm(0.0), rate.remaining_mm(1.0)], [Some(0.0), Some(2.0)], "no rate from nothing");
        let mut slow = ConvergenceRate::default();
        slow.remaining_mm(1.0);
        assert!((slow.remaining_mm(0.9999).unwrap() - 999.9).abs() < 1e-6, "at most a thousand steps");
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
