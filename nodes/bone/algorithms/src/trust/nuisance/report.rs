//! What is known of the causes.

use crate::trust::predict::Deformation;
use osteoflow_verdict::Reason;
use serde::{Deserialize, Serialize};

/// What the data say of a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NuisanceState {
    /// It is there, and large enough to matter at the targets.
    Measured,
    /// The data limit it; the limit is part of the predicted error.
    Bounded,
    /// The data do not limit it: an assumption.
    Unseen,
}

/// A cause of error beside the pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Nuisance {
    /// Its name.
    pub name: String,
    /// What the data say of it.
    pub state: NuisanceState,
    /// Its size, in `unit`; none where it was not fitted.
    pub estimate: Option<f64>,
    /// Standard deviation of the size, from the data and the prior.
    pub sd: f64,
    /// The unit of `estimate`, `sd` and `critical`.
    pub unit: String,
    /// The direction in which it acts, unit vector of the target's frame, where it has one.
    pub axis: Option<[f64; 3]>,
    /// The place where it acts, target's frame, mm, where it has one.
    pub at: Option<[f64; 3]>,
    /// Largest error of mean TRE and cuts, mm: of its size if measured, of its bound of 90 % if bounded, of its prior's if unseen.
    pub effect_mm: f64,
    /// Largest tilt of a cut by as much, degrees.
    pub effect_deg: f64,
    /// The size at which the answer would be beyond the first of the limits.
    pub critical: f64,
}

/// What is known of the causes.
pub(in crate::trust) struct Nuisances {
    /// Each cause.
    pub list: Vec<Nuisance>,
    /// The sign against the registration that a cause was measured.
    pub reason: Option<Reason>,
    /// What is taken for granted, the most critical first; each with whether it is of the camera.
    pub assumptions: Vec<(bool, String)>,
    /// What the causes may do to the answer, for the predicted error.
    pub deformation: Option<Deformation>,
}
