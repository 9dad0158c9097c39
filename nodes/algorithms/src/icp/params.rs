//! How an ICP pairs, weighs, steps and stops.

use super::IcpError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How an ICP pairs, weighs, steps and stops; the same for every variant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct IcpParams {
    /// Pairs farther apart are not used, mm. 5: twice the largest error of a three-point fit to laser holes, and less
    /// than half the thickness of a fibula, so that no point pairs with the far side.
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub max_pair_distance_mm: f64,
    /// How partners are found. `cached`: the nearest samples, kept while no other can have come nearer; the pairs of
    /// `tree` in a fifth of its time. `tree`: searched anew at every step. `field`: the closest point of the surface as
    /// looked up in a grid that the target must have been prepared with, for registration at camera rate.
    pub pairing: PairingKind,
    /// With `field`: whether all points end on exact pairs, after subsets were taken near by the field. true: the result is
    /// that of exact pairs. false: the field alone, for a third of the time; as smooth as the field, it may rest some
    /// hundredths of a millimetre off. `point_to_point` never ends on exact pairs, which would hold it back among the
    /// samples.
    pub field_exact: bool,
    /// Whether a pair is used only where the source point is, in turn, the nearest to its partner. false: a scan covers a
    /// part of the bone, and each of its points has a partner.
    pub reciprocal: bool,
    /// Pairs whose normals differ by more are not used, degrees. 180: all are. The scan's normals are estimated where
    /// the cloud has none.
    #[schemars(range(min = 0.0, max = 180.0))]
    pub max_normal_angle_deg: f64,
    /// The gate: no residual beyond so many times the spread of those on the bone counts, and those below 0.85 of it
    /// count fully. 5: bare bone keeps every weight, and up to half of the points some millimetres off lose theirs. 0:
    /// no gate, all pairs within `max_pair_distance_mm` count. On levels that are not the last, it lies just beyond the
    /// better half of the points.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub gate_sigmas: f64,
    /// Depth noise of the camera, mm: the spread of residuals is never taken for less. 0.07: a structured-light camera's at
    /// 300 mm. Where it has less, the gate is wider than need be; where more, the residuals tell.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub noise_mm: f64,
    /// How a residual's weight falls with its size, beside the shrinking reach; the scale is the spread of the
    /// residuals. `none`: least squares. `huber`, `tukey`, `welsch`: 95 % as efficient on Gaussian noise.
    pub kernel: Kernel,
    /// Share of the pairs, the worst first, that a step leaves out. 0: the shrinking reach leaves out what is off.
    #[schemars(range(min = 0.0, max = 0.9))]
    pub trim_fraction: f64,
    /// Whether a pair weighs as the squared cosine of the camera's incidence on the target, as depth noise grows with its
    /// inverse. false: no assumption on the camera. Needs a cloud with a viewpoint.
    pub incidence_weights: bool,
    /// First run on every n-th source point for each of these, until no longer told from its own noise, then on all.
    /// [32, 8]: takes most of the way at a twentieth of the cost. The first runs on a thinned target, too. []: all
    /// points from the start.
    #[schemars(length(max = 8), inner(range(min = 2, max = 10_000)))]
    pub levels: Vec<u32>,
    /// How a step is solved from the pairs. `gauss_newton`: the least of the model, shortened where the residual rises.
    /// `levenberg_marquardt`: damped where it rises.
    pub step: StepRule,
    /// `point_to_point`: how many earlier steps the next one is extrapolated from (Anderson). 5: as in the literature; 0:
    /// plain steps only, without leaps along the normals either, which takes hundreds of steps, as each recovers 0.1 % of
    /// a slide along the bone. Others need none.
    #[schemars(range(min = 0, max = 5))]
    pub acceleration: u32,
    /// Converged where the way still to go, as estimated from the last steps, is shorter than this, mm. 0.001: a
    /// hundredth of what the tracker can tell. A step is the RMS movement of the source points.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub stop_step_mm: f64,
    /// And where a step turns by less than this, rad. 1e-5: a micrometre at 100 mm.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub stop_step_rad: f64,
    /// Stop, too, where the RMS residual changes by less than this in a step, mm. 0: never. Close to a coarse fit the
    /// residual of a bone hardly changes while it still slides along its axis, so 0.01 here stops after three or four
    /// steps, millimetres away; the report then does not say converged.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub stop_residual_mm: f64,
    /// Stop, too, after so many milliseconds. 0: never. Where this ends a run it is recorded, and a replay ends there.
    #[schemars(range(min = 0.0, max = 1e9))]
    pub stop_after_ms: f64,
    /// Stop after so many steps, all levels together. 500: ten times what real bones take.
    #[schemars(range(min = 1, max = 100_000))]
    pub max_iterations: u32,
    /// Fewer pairs than this are an error. 10: six unknowns and something left to judge them by.
    #[schemars(range(min = 3, max = 1_000_000))]
    pub min_pairs: u32,
    /// `point_to_point` only: do what the paper may have done, which its text leaves open: plain steps on all points
    /// until the RMS residual changes by less than 0.01 mm (`change_0.01`) or by less than 1e-5 mm (`change_1e-5`), the
    /// mean distance does so (`mean_change_1e-5`), or `max_iterations` are used up (`iterations`). The report's `left_mm`
    /// says what this leaves. `none`: our own rule.
    pub published_reading: PublishedReading,
}

impl Default for IcpParams {
    fn default() -> Self {
        Self {
            max_pair_distance_mm: 5.0,
            pairing: PairingKind::Cached,
            field_exact: true,
            reciprocal: false,
            max_normal_angle_deg: 180.0,
            gate_sigmas: 5.0,
            noise_mm: 0.07,
            kernel: Kernel::None,
            trim_fraction: 0.0,
            incidence_weights: false,
            levels: vec![32, 8],
            step: StepRule::GaussNewton,
            acceleration: 5,
            stop_step_mm: 0.001,
            stop_step_rad: 1e-5,
            stop_residual_mm: 0.0,
            stop_after_ms: 0.0,
            max_iterations: 500,
            min_pairs: 10,
            published_reading: PublishedReading::None,
        }
    }
}

/// How partners are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PairingKind {
    /// The nearest samples, kept while no other can have come nearer.
    Cached,
    /// The nearest samples, searched anew at every step.
    Tree,
    /// The closest point of the surface as looked up in a grid.
    Field,
}

/// How a residual's weight falls with its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Kernel {
    /// It does not.
    None,
    /// Inversely, beyond 1.345 times the scale.
    Huber,
    /// To zero at 4.685 times the scale.
    Tukey,
    /// As a bell of 2.985 times the scale.
    Welsch,
}

/// How a step is solved from the pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StepRule {
    /// The least of the model, shortened where the residual rises.
    GaussNewton,
    /// The least of the model, damped where the residual rises.
    LevenbergMarquardt,
}

/// How the paper's stop rule may be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum PublishedReading {
    /// Not at all: the rules of the other parameters hold.
    #[serde(rename = "none")]
    None,
    /// The RMS residual changes by less than 0.01 mm.
    #[serde(rename = "change_0.01")]
    Change001,
    /// The RMS residual changes by less than 1e-5 mm.
    #[serde(rename = "change_1e-5")]
    Change1e5,
    /// The mean distance of the pairs changes by less than 1e-5 mm.
    #[serde(rename = "mean_change_1e-5")]
    MeanChange1e5,
    /// A number of steps is used up.
    #[serde(rename = "iterations")]
    Iterations,
}

impl IcpParams {
    /// These parameters with what [`IcpParams::published_reading`] stands for spelt out.
    pub(super) fn resolved(&self) -> Self {
        let stop_residual_mm = match self.published_reading {
            PublishedReading::None => return self.clone(),
            PublishedReading::Change001 => 0.01,
            PublishedReading::Change1e5 | PublishedReading::MeanChange1e5 => 1e-5,
            PublishedReading::Iterations => 0.0,
        };
        Self {
            stop_residual_mm,
            acceleration: 0,
            levels: Vec::new(),
            gate_sigmas: 0.0,
            kernel: Kernel::None,
            trim_fraction: 0.0,
            stop_step_mm: 0.0,
            stop_step_rad: 0.0,
            ..self.clone()
        }
    }

    pub(super) fn check(&self) -> Result<(), IcpError> {
        let positive = |parameter, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => Err(IcpError::Parameter { parameter, value, expected: "it should be a positive number" }),
        };
        positive("max_pair_distance_mm", self.max_pair_distance_mm)?;
        let not_negative = |parameter, value: f64| match value.is_finite() && value >= 0.0 {
            true => Ok(()),
            false => Err(IcpError::Parameter { parameter, value, expected: "it should be zero or a positive number" }),
        };
        not_negative("gate_sigmas", self.gate_sigmas)?;
        not_negative("noise_mm", self.noise_mm)?;
        not_negative("max_normal_angle_deg", self.max_normal_angle_deg)?;
        not_negative("stop_step_mm", self.stop_step_mm)?;
        not_negative("stop_step_rad", self.stop_step_rad)?;
        not_negative("stop_residual_mm", self.stop_residual_mm)?;
        if !(0.0..1.0).contains(&self.trim_fraction) {
            let expected = "it should be at least 0 and below 1";
            return Err(IcpError::Parameter { parameter: "trim_fraction", value: self.trim_fraction, expected });
        }
        Ok(())
    }
}
