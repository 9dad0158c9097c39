//! Parameters of the registrations.

use super::IcpError;
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of pairing, weights, steps and stop rules, the same for every variant.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct IcpParams {
    /// Largest distance of a pair. 5: twice the largest error of a three-point fit to laser holes, and less than half the
    /// thickness of a fibula, so no point pairs with the opposite side.
    #[param(5.0, 1e-6..=1e6)]
    pub max_pair_distance_mm: f64,
    /// Correspondence search. `tree`: the nearest samples, searched at every step. `cached`: the same pairs in a fifth of the
    /// time, as points are searched again only after they have moved so far that another sample could be nearer.
    #[param(PairingKind::Cached)]
    pub pairing: PairingKind,
    /// Whether a pair is used only if the source point is also the nearest to its target point. false: a scan covers a part of
    /// the bone, and each of its points has a target point.
    pub reciprocal: bool,
    /// Largest angle between the normals of a pair. 180: all pairs. The scan's normals are estimated if it has none.
    #[param(180.0, 0.0..=180.0)]
    pub max_normal_angle_deg: f64,
    /// Residuals beyond this many standard deviations of the inliers have no weight, those below 0.85 of it full weight. 5:
    /// bare bone keeps full weight, and up to half of the points, some millimetres off, lose theirs. 0: no gate, full weight
    /// within `max_pair_distance_mm`. Before the last level the gate is just beyond the better half of the points.
    #[param(5.0, 0.0..=1000.0)]
    pub gate_sigmas: f64,
    /// Depth noise of the camera: a lower bound on the standard deviation of the residuals. 0.07: a structured-light camera at
    /// 300 mm. Less noise gets a wider gate than it needs; more is estimated.
    #[param(0.07, 0.0..=100.0)]
    pub noise_mm: f64,
    /// Whether points outside the surface count less than those inside, as soft tissue lies outside the bone: before the last
    /// level they have a twentieth of the weight, then a gate of 2.5 standard deviations. Needs a cloud with a viewpoint. None:
    /// true for variants along normals, false for `point_to_point`, as in the paper.
    pub one_sided: Option<bool>,
    /// Robust kernel beside the gate, scaled by the standard deviation of the residuals. `none`: least squares. The others have
    /// an efficiency of 95 % on Gaussian noise.
    #[param(Kernel::None)]
    pub kernel: Kernel,
    /// Share of the pairs, those with the largest residuals, that a step leaves out. 0: the gate leaves out outliers.
    #[param(0.0, 0.0..=0.9)]
    pub trim_fraction: f64,
    /// Whether a pair is weighted by the squared cosine of the camera's incidence, as depth noise grows with its inverse.
    /// false: no assumption on the camera. Needs a cloud with a viewpoint.
    pub incidence_weights: bool,
    /// Subsets to register before all points: every n-th source point, until its noise exceeds its steps. [32, 8]: most of the
    /// distance at a twentieth of the cost; the first pairs with a thinned target. []: all points from the start.
    #[param(vec![32, 8])]
    #[schemars(length(max = 8), inner(range(min = 2, max = 10_000)))]
    pub levels: Vec<u32>,
    /// Solution of a step. `gauss_newton`: the minimum of the linearised problem, with a line search. `levenberg_marquardt`:
    /// damped until the cost does not rise.
    #[param(StepRule::GaussNewton)]
    pub step: StepRule,
    /// `point_to_point` only: number of earlier steps that the next one is extrapolated from (Anderson). 5: as in the
    /// literature; 0: Kabsch's steps alone, without Gauss-Newton steps along the normals, which takes hundreds of steps, as
    /// each recovers 0.1 % of a slide along the bone.
    #[param(5, 0..=5)]
    pub acceleration: u32,
    /// Converged if the remaining distance, estimated from the last steps as RMS movement of the source points, is below this.
    /// 0.001: a hundredth of the tracker's resolution.
    #[param(0.001, 0.0..=10.0)]
    pub stop_step_mm: f64,
    /// And if the last turn is below this. 1e-5: a micrometre at 100 mm.
    #[param(1e-5, 0.0..=1.0)]
    pub stop_step_rad: f64,
    /// Also stop if a step changes the RMS residual by less. 0: never. The residual of a bone hardly changes while it still
    /// slides along its axis: 0.01 stops after three or four steps, millimetres away, and the report does not say converged.
    #[param(0.0, 0.0..=10.0)]
    pub stop_residual_mm: f64,
    /// Also stop after this time. 0: never. It is recorded, and a replay stops at the same step.
    #[param(0.0, 0.0..=1e9)]
    pub stop_after_ms: f64,
    /// Largest number of steps of all levels. 500: ten times the steps on real bones.
    #[param(500, 1..=100_000)]
    pub max_iterations: u32,
    /// Smallest number of pairs; fewer are an error. 10: six unknowns and some redundancy.
    #[param(10, 3..=1_000_000)]
    pub min_pairs: u32,
}

/// Correspondence search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PairingKind {
    /// The nearest samples, searched again only after a point has moved so far that another could be nearer.
    Cached,
    /// The nearest samples, searched at every step.
    Tree,
}

/// Robust kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Kernel {
    /// Full weight.
    None,
    /// Falls inversely beyond 1.345 times the scale.
    Huber,
    /// Falls to zero at 4.685 times the scale.
    Tukey,
    /// A Gaussian of 2.985 times the scale.
    Welsch,
}

/// Solution of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StepRule {
    /// The minimum of the linearised problem, with a line search.
    GaussNewton,
    /// Damped until the cost does not rise.
    LevenbergMarquardt,
}

impl IcpParams {
    pub(super) fn check(&self) -> Result<(), IcpError> {
        let positive = |parameter, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(IcpError::Parameter { parameter, value, expected: "it must be a positive number" }),
        };
        positive("max_pair_distance_mm", self.max_pair_distance_mm)?;
        let not_negative = |parameter, value: f64| match value.is_finite() && value >= 0.0 {
            true => Ok(()),
            false => Err(IcpError::Parameter { parameter, value, expected: "it must be zero or a positive number" }),
        };
        not_negative("gate_sigmas", self.gate_sigmas)?;
        not_negative("noise_mm", self.noise_mm)?;
        not_negative("max_normal_angle_deg", self.max_normal_angle_deg)?;
        not_negative("stop_step_mm", self.stop_step_mm)?;
        not_negative("stop_step_rad", self.stop_step_rad)?;
        not_negative("stop_residual_mm", self.stop_residual_mm)?;
        if !(0.0..1.0).contains(&self.trim_fraction) {
            let expected = "it must be at least 0 and below 1";
            return Err(IcpError::Parameter { parameter: "trim_fraction", value: self.trim_fraction, expected });
        }
        Ok(())
    }
}
