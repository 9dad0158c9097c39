//! The report and the trace of an ICP.

use super::observability::Observability;
use super::stop::{StopReason, StopRule};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// The result of an ICP.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpFit {
    /// The motion that takes the source onto the target.
    pub t_target_source: Isometry3<f64>,
    /// How it ended.
    pub report: IcpReport,
    /// Its steps.
    pub trace: IcpTrace,
}

/// How an ICP ended. Its RMS is a surface residual, neither FRE nor TRE.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IcpReport {
    /// Whether `remaining_mm` is at most `stop_step_mm`: the pose is a stationary point of the variant. That of
    /// `point_to_point` may be away from its minimum; see `resolution_mm` and `left_mm`.
    pub converged: bool,
    /// Why it stopped.
    pub stop_reason: StopReason,
    /// Every stop rule, and how near it was.
    pub rules: Vec<StopRule>,
    /// Steps taken, all levels together.
    pub iterations: u32,
    /// Source points.
    pub n_source: usize,
    /// Number of inliers of the last step: pairs with a weight above zero.
    pub n_pairs: usize,
    /// `n_pairs / n_source`.
    pub pair_share: f64,
    /// Weighted RMS residual of the inliers, mm: the distance between points (`point_to_point`), along the target's normal
    /// (`point_to_plane`), and so on.
    pub rms_mm: f64,
    /// Weighted RMS distance between the points of the inliers, mm.
    pub point_rms_mm: f64,
    /// RMS movement of the source points by the last step, mm.
    pub step_mm: f64,
    /// Turn of the last step, rad.
    pub step_rad: f64,
    /// Remaining distance to the minimum, mm, as RMS movement of the source points: `step / (1 - rate)`, with the contraction
    /// rate of the last steps. For `point_to_point` the Gauss-Newton step along the target's normals, as its rate is too close
    /// to 1 to be estimated.
    pub remaining_mm: Option<f64>,
    /// How far from its minimum a `point_to_point` can become stationary, mm, one standard deviation: its cost is rough, as
    /// pairs change from sample to sample. Denser samples make it finer. None for others.
    pub resolution_mm: Option<f64>,
    /// Distance from the result of a `point_to_point` to where a `point_to_plane` that starts there ends, mm (RMS movement of the
    /// source points): the error that it leaves, mostly along the bone. All points within `max_pair_distance_mm` pair anew,
    /// whatever the gate left out. None for others.
    pub left_mm: Option<f64>,
    /// Residuals of the inliers of the last step, mm, from the one farthest inside the surface to the one farthest outside. Where both sides
    /// count alike, the larger of both, either way. None in reports of earlier versions.
    #[serde(default)]
    pub inliers_mm: Option<[f64; 2]>,
    /// `JᵀWJ` of the last step, unknowns (shift in mm, turn in rad about `centroid_mm`), target's axes. Along the target's
    /// normals for `point_to_point`.
    pub normal_matrix: [[f64; 6]; 6],
    /// The centroid of the source at the end, in the target's frame, mm.
    pub centroid_mm: [f64; 3],
    /// Which motions the pairs determine, and which they leave undetermined.
    pub observability: Observability,
}

/// One step of an ICP, as its observer sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IcpStep {
    /// Counted from 1, all levels together.
    pub iteration: u32,
    /// The level: every n-th source point.
    pub every: u32,
    /// Number of inliers.
    pub n_pairs: usize,
    /// RMS residual before the step, mm.
    pub rms_mm: f64,
    /// RMS movement of the source points by the step, mm.
    pub step_mm: f64,
    /// Turn of the step, rad.
    pub step_rad: f64,
    /// Remaining distance before the step, mm; see [`IcpReport::remaining_mm`].
    pub remaining_mm: Option<f64>,
    /// Whether the step was extrapolated.
    pub accelerated: bool,
    /// The motion after the step.
    pub t_target_source: Isometry3<f64>,
}

/// The steps of an ICP in order.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct IcpTrace {
    /// One entry for each step.
    pub steps: Vec<IcpStep>,
}

/// Why an observer stops an ICP.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// The result is no longer needed.
    Cancelled,
    /// The time is up.
    Time,
}

/// Records every step in the trace and reports it to the caller.
pub(super) struct Observer<'a> {
    pub(super) trace: IcpTrace,
    pub(super) caller: &'a mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
}

impl Observer<'_> {
    /// Numbers and records a step; the reason to stop if the caller stops.
    pub(super) fn observe(&mut self, step: IcpStep) -> Option<StopReason> {
        let step = IcpStep { iteration: self.trace.steps.len() as u32 + 1, ..step };
        let halt = (self.caller)(&step).break_value();
        self.trace.steps.push(step);
        halt.map(|halt| match halt {
            Halt::Cancelled => StopReason::Cancelled,
            Halt::Time => StopReason::Time,
        })
    }
}
