//! How an ICP ended, and how it got there.

use super::observability::Observability;
use super::stop::{StopReason, StopRule};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Where an ICP ended.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpFit {
    /// The motion that takes the source onto the target.
    pub t_target_source: Isometry3<f64>,
    /// How it ended.
    pub report: IcpReport,
    /// How it got there.
    pub trace: IcpTrace,
}

/// How an ICP ended. What it leaves is a surface residual, neither FRE nor TRE.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IcpReport {
    /// Whether `remaining_mm` is not above `stop_step_mm`: the variant has come to rest. A `point_to_point` may rest away
    /// from its least; see `resolution_mm` and `left_mm`.
    pub converged: bool,
    /// Why it stopped.
    pub stop_reason: StopReason,
    /// Every rule of stopping, and how near it was.
    pub rules: Vec<StopRule>,
    /// Steps taken, all levels together.
    pub iterations: u32,
    /// Source points.
    pub n_source: usize,
    /// Pairs that the last step used: near enough and not trimmed.
    pub n_pairs: usize,
    /// `n_pairs / n_source`.
    pub pair_share: f64,
    /// Weighted RMS over those pairs of what this variant minimises, mm: the distance between points
    /// (`point_to_point`), along the target's normal (`point_to_plane`), and so on.
    pub rms_mm: f64,
    /// Weighted RMS over those pairs of the distance between points, mm.
    pub point_rms_mm: f64,
    /// RMS movement of the source points by the last step, mm.
    pub step_mm: f64,
    /// Turn of the last step, rad.
    pub step_rad: f64,
    /// Way still to go, mm, as RMS movement of the source points, from the last steps: `step / (1 - rate)`, with the rate
    /// at which they shrink. For `point_to_point` from the last pairs, `N⁺ Jᵀr` with `N` along the target's normals, as a
    /// crawl has no rate that could be told from 1: it shows here, however short its steps are.
    pub remaining_mm: Option<f64>,
    /// How far from its least a `point_to_point` can come to rest, mm, one standard deviation: its residual is rough, as
    /// points prefer to stay with the target samples they have. Denser samples make it finer. None for others.
    pub resolution_mm: Option<f64>,
    /// What a `point_to_point` leaves although it has come to rest, mm: how far a first step along the target's normals
    /// would move the source from here (RMS of its points), mostly along the bone. None for others.
    pub left_mm: Option<f64>,
    /// `JᵀWJ` of the last step, unknowns (shift in mm, turn in rad about `centroid_mm`), target's axes. Along the target's
    /// normals for `point_to_point`.
    pub normal_matrix: [[f64; 6]; 6],
    /// The centroid of the source at the end, in the target's frame, mm.
    pub centroid_mm: [f64; 3],
    /// Which motions the pairs hold, and which they leave free.
    pub observability: Observability,
}

/// One step of an ICP, as its observer sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IcpStep {
    /// Counted from 1, all levels together.
    pub iteration: u32,
    /// Every n-th source point took part.
    pub every: u32,
    /// Pairs used.
    pub n_pairs: usize,
    /// RMS residual of the pairs before the step, mm.
    pub rms_mm: f64,
    /// RMS movement of the source points by the step, mm.
    pub step_mm: f64,
    /// Turn of the step, rad.
    pub step_rad: f64,
    /// Way still to go before the step, mm; see [`IcpReport::remaining_mm`].
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

/// Why an observer breaks an ICP off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// The result is no longer wanted.
    Cancelled,
    /// The time is up.
    Time,
}

/// What sees every step: the caller, and the trace.
pub(super) struct Observer<'a> {
    pub(super) trace: IcpTrace,
    pub(super) caller: &'a mut dyn FnMut(&IcpStep) -> ControlFlow<Halt>,
}

impl Observer<'_> {
    /// Numbers and keeps a step; the reason to stop if the caller breaks off.
    pub(super) fn see(&mut self, step: IcpStep) -> Option<StopReason> {
        let step = IcpStep { iteration: self.trace.steps.len() as u32 + 1, ..step };
        let halt = (self.caller)(&step).break_value();
        self.trace.steps.push(step);
        halt.map(|halt| match halt {
            Halt::Cancelled => StopReason::Cancelled,
            Halt::Time => StopReason::Time,
        })
    }
}
