//! What counts as a wrong answer.

use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Limits of a right answer: beyond any of them it is wrong.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Limits {
    /// Maximum mean TRE of the assessment points. 1.5: half of what a cut may be off.
    #[param(1.5, 0.0..=1000.0)]
    pub max_tre_mm: f64,
    /// Maximum displacement of a cut along its normal, in the middle of the bone. 1.5: as above.
    #[param(1.5, 0.0..=1000.0)]
    pub max_offset_mm: f64,
    /// Maximum tilt of a cut. 0.5: moves its rim by 0.1 mm on a fibula; a jaw of several pieces adds them up.
    #[param(0.5, 0.0..=180.0)]
    pub max_tilt_deg: f64,
}

impl Limits {
    /// The largest of error over limit.
    pub fn times(&self, tre_mm: f64, offset_mm: f64, tilt_deg: f64) -> f64 {
        (tre_mm / self.max_tre_mm).max(offset_mm / self.max_offset_mm).max(tilt_deg / self.max_tilt_deg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_of_error_over_limit_counts() {
        let limits = Limits { max_tre_mm: 2.0, max_offset_mm: 4.0, max_tilt_deg: 0.5 };
        assert_eq!(limits.times(3.0, 4.0, 0.25), 1.5);
        assert_eq!(limits.times(1.0, 10.0, 0.25), 2.5);
        assert_eq!(limits.times(1.0, 2.0, 1.75), 3.5);
    }
}
