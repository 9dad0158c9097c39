//! When to stop.

use super::params::IcpParams;
use serde::{Deserialize, Serialize};

/// A crawl leaves at most so many steps out of sight.
const MAX_RATE: f64 = 0.999;

/// A crawl that is hurried along is taken for no slower than this.
const CRAWL: f64 = 0.9;

/// What a step is taken to leave where no step before tells: half of itself.
const UNKNOWN_RATE: f64 = 0.5;

/// Why an ICP stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// The way still to go is shorter than `stop_step_mm`, and the last turn smaller than `stop_step_rad`.
    Step,
    /// The residual changed by less than `stop_residual_mm`.
    Residual,
    /// `max_iterations` were used up.
    Iterations,
    /// `stop_after_ms` were used up.
    Time,
    /// No step lowers the residual any more, although the way still to go is not short.
    Stalled,
    /// The observer broke it off.
    Cancelled,
}

/// A rule of stopping, and how near it was at the end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StopRule {
    /// Its parameter.
    pub parameter: String,
    /// What it stops below, or at for `max_iterations` and `stop_after_ms`; 0: never.
    pub limit: f64,
    /// What was last compared with it; none where it was not looked at.
    pub last: Option<f64>,
    /// Whether it was met.
    pub met: bool,
}

/// Follows the lengths of steps.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pace {
    last_mm: Option<f64>,
    rate: Option<f64>,
    /// The slowest rate at which steps shrank before something hurried them.
    crawl: f64,
}

impl Pace {
    /// Steps shrink no faster than at this rate, whatever hurries the next ones.
    pub(super) fn crawls(&mut self, rate: f64) {
        self.crawl = self.crawl.max(rate.min(CRAWL));
    }

    /// The way still to go before a step of this length: `step / (1 - rate)`, with the rate at which steps shrink.
    /// None while steps grow: nothing tells then.
    pub(super) fn remaining_mm(&mut self, step_mm: f64) -> Option<f64> {
        if let Some(last) = self.last_mm.replace(step_mm).filter(|l| *l > 0.0) {
            self.rate = Some(step_mm / last);
        }
        self.left_mm(step_mm)
    }

    /// The way still to go after the last step of this length has been taken, too.
    pub(super) fn left_after_mm(&self, step_mm: f64) -> Option<f64> {
        self.left_mm(step_mm).map(|left| left * self.rate.unwrap_or(UNKNOWN_RATE).max(self.crawl))
    }

    fn left_mm(&self, step_mm: f64) -> Option<f64> {
        let rate = self.rate.unwrap_or(UNKNOWN_RATE).max(self.crawl);
        (rate < 1.0 || step_mm == 0.0).then(|| if step_mm == 0.0 { 0.0 } else { step_mm / (1.0 - rate.min(MAX_RATE)) })
    }
}

/// The rules and how they ended.
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
