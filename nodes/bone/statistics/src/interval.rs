//! Confidence intervals.

use serde::{Serialize, Serializer, ser::SerializeMap};
use thiserror::Error;

/// A two-sided confidence interval, in the unit of its estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The share of repetitions of the experiment in which such an interval contains the true value: 0.95.
    pub level: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// The reason why an estimate has no interval.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum NoInterval {
    /// All rows belong to one unit of the highest level, so the spread between units is unknown.
    #[error("n = 1 {unit}: one {unit} does not show how others differ; measure a second one")]
    OneUnit {
        /// Name of the highest level.
        unit: String,
    },
    /// The statistic was not finite in some resamples.
    #[error("the statistic is no number in {n_failed} of {n_resamples} resamples; there are too few units for it")]
    NotFinite {
        /// Number of resamples without a finite value.
        n_failed: usize,
        /// Number of resamples.
        n_resamples: usize,
    },
    /// All resamples are on one side of the estimate, so its bias cannot be corrected.
    #[error("all {n_resamples} resamples lie on one side of the estimate; take the percentile interval")]
    OneSided {
        /// Number of resamples.
        n_resamples: usize,
    },
    /// There are fewer rows than the interval needs.
    #[error("{found} rows, at least {needed} needed for an interval")]
    TooFewRows {
        /// Number of rows.
        found: usize,
        /// Number of rows needed.
        needed: usize,
    },
    /// The correlation is 1 or -1, where Fisher's z is infinite.
    #[error("the points lie on one line, so that their correlation has no interval")]
    OnALine,
}

/// Serializes the interval as `{level, low, high}`, or as `{no_interval: reason}`.
pub(crate) fn or_reason<S: Serializer>(interval: &Result<Interval, NoInterval>, to: S) -> Result<S::Ok, S::Error> {
    match interval {
        Ok(interval) => interval.serialize(to),
        Err(reason) => {
            let mut map = to.serialize_map(Some(1))?;
            map.serialize_entry("no_interval", &reason.to_string())?;
            map.end()
        }
    }
}
