//! What is known of the causes.

use serde::{Deserialize, Serialize};

/// What the data say of a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NuisanceState {
    /// It is there, and large enough to matter at the targets.
    Measured,
    /// The data exclude a size that matters, even if it is at fault.
    Bounded,
    /// The data do not: an assumption.
    Unseen,
}

/// A cause of error beside the pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Nuisance {
    /// Its name.
    pub name: String,
    /// What the data say of it.
    pub state: NuisanceState,
    /// Mean of its size, from data and prior; of several parameters their norm, of a step that at its likeliest place.
    pub estimate: f64,
    /// Standard deviation of each of its parameters, from data and prior.
    pub sd: f64,
    /// Standard deviation of its parameters in a sound procedure.
    pub prior: f64,
    /// The unit of `estimate`, `sd`, `prior` and `critical`.
    pub unit: String,
    /// The direction in which it acts, unit vector of the target's frame, where it has one.
    pub axis: Option<[f64; 3]>,
    /// Where a step is likeliest, target's frame, mm.
    pub at: Option<[f64; 3]>,
    /// Largest error of mean TRE and cuts, mm: of its size if measured, else of the largest size that is likely (90 %).
    pub effect_mm: f64,
    /// Largest tilt of a cut by as much, degrees.
    pub effect_deg: f64,
    /// The size at which the answer would be beyond the first of the limits.
    pub critical: f64,
    /// The chance that it is larger.
    pub chance: f64,
}
