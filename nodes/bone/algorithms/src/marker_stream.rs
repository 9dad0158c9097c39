//! Which poses of a tracked marker are measurements of where it was, judged by those before and after them.

mod arrival;
mod cause;
mod chain;
mod frozen;
mod scale;
mod tracks;

pub use arrival::Arrival;
pub use cause::{Cause, Kind};
pub use frozen::Repeats;

use nalgebra::Isometry3;
use osteoflow_geometry::StampNs;
use osteoflow_node_macros::params;
use scale::Scales;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Silence after which a marker may be anywhere, s: the samples after it are judged by themselves.
const SILENCE_S: f64 = 1.0;

/// Time in which a hand reaches its largest speed, s: it bounds the acceleration.
const SPEED_UP_S: f64 = 0.25;

/// Half of the window in which samples that disagree are counted, s.
const WINDOW_S: f64 = 0.5;

/// Share of samples in a window that disagree with the others from which nothing says which of them are right.
const AMBIGUOUS: f64 = 0.4;

/// Smallest number of samples that are judged by each other.
const N_JUDGED: usize = 3;

/// How fast a marker moves at most.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotionLimits {
    /// Largest speed of a marker in a hand, reached within 0.25 s. 1000: three times that of a leg that is carried, and what a
    /// hand reaches freely. 0: poses are given as they are.
    #[param(1000.0, 0.0..=100_000.0)]
    pub hand_mm_s: f64,
    /// Largest speed of its rotation, reached within 0.25 s. 300: a stylus that is turned about its tip.
    #[param(300.0, 0.0..=100_000.0)]
    pub hand_deg_s: f64,
    /// Amplitude with which a saw shakes a marker faster than the tracker follows. 2: half the stroke of a saw's blade.
    #[param(2.0, 0.0..=1000.0)]
    pub saw_mm: f64,
    /// Amplitude of its rotation. 1: 2 mm over the 115 mm from the middle of a cut to a marker.
    #[param(1.0, 0.0..=180.0)]
    pub saw_deg: f64,
}

/// A pose and its stamp.
pub type Sample = (StampNs, Isometry3<f64>);

/// A length and an angle: of a motion, of a deviation, or of what is tolerated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Size {
    mm: f64,
    rad: f64,
}

impl Size {
    /// The larger of length and angle, each over the other's.
    fn over(&self, tolerance: &Self) -> f64 {
        (self.mm / tolerance.mm).max(self.rad / tolerance.rad)
    }

    fn min(self, other: Self) -> Self {
        Self { mm: self.mm.min(other.mm), rad: self.rad.min(other.rad) }
    }

    fn max(self, other: Self) -> Self {
        Self { mm: self.mm.max(other.mm), rad: self.rad.max(other.rad) }
    }
}

impl std::ops::Mul<f64> for Size {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self { mm: self.mm * factor, rad: self.rad * factor }
    }
}

impl std::ops::Add for Size {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { mm: self.mm + other.mm, rad: self.rad + other.rad }
    }
}

impl MotionLimits {
    fn speed(&self) -> Size {
        Size { mm: self.hand_mm_s, rad: self.hand_deg_s.to_radians() }
    }

    /// Per s².
    fn acceleration(&self) -> Size {
        self.speed() * (1.0 / SPEED_UP_S)
    }

    fn saw(&self) -> Size {
        Size { mm: self.saw_mm, rad: self.saw_deg.to_radians() }
    }

    /// Whether samples are judged at all.
    pub fn are_set(&self) -> bool {
        self.hand_mm_s > 0.0 && self.hand_deg_s > 0.0
    }
}

/// The samples of a marker, judged.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Judged {
    /// For each sample why it is left out; `None` of one that is a measurement.
    pub out: Vec<Option<Cause>>,
    /// Motions that no hand makes, after which the marker stayed: the number of the first sample after each, and its size.
    pub jumps: Vec<(usize, Cause)>,
}

/// Judges the samples of a marker, in the order of their stamps, by those before and after them.
///
/// Samples belong together if each is where those before it lead, by the noise and the motion measured around it; of what does not
/// belong together, that is taken which has more samples and is reached by motions that a hand or a saw makes. Left out are single
/// samples and bursts off the others; identities; all of a time in which 40 % or more disagree; and the last samples where they
/// disagree with those before and no later ones confirm them. A motion that no hand makes is taken once the marker has stayed for 1 s and
/// ten samples. Across a silence of 1 s nothing is judged. Of several samples of one stamp, and of those that repeat a pose to the last bit, the
/// first is judged for all. `O(n)` for
/// few outliers.
pub fn judge(samples: &[Sample], limits: &MotionLimits) -> Judged {
    let mut judged = Judged { out: vec![None; samples.len()], jumps: Vec::new() };
    if !limits.are_set() {
        return judged;
    }
    let has_pose = samples.iter().any(|(_, pose)| !is_identity(pose));
    let mut islands: Vec<Island> = Vec::new();
    // The sample whose judgement holds for another: the first of its stamp, or of those that repeat a pose.
    let mut as_of: Vec<usize> = (0..samples.len()).collect();
    let mut last: Option<usize> = None;
    for (index, (stamp_ns, pose)) in samples.iter().enumerate() {
        if has_pose && is_identity(pose) {
            judged.out[index] = Some(Cause::new(Kind::Identity, Size::default()));
            continue;
        }
        let before = last.replace(index).map(|before| (before, seconds(stamp_ns - samples[before].0)));
        match (before, islands.last_mut()) {
            (Some((before, gap_s)), Some(island)) if gap_s < SILENCE_S => {
                if gap_s == 0.0 || samples[as_of[before]].1 == *pose {
                    as_of[index] = as_of[before];
                    island.n_repeated += usize::from(gap_s > 0.0);
                } else {
                    island.samples.push(index);
                }
            }
            _ => islands.push(Island { samples: vec![index], n_repeated: 0 }),
        }
    }
    for island in islands.iter().filter(|island| island.samples.len() >= N_JUDGED) {
        judge_island(samples, island, limits, &mut judged);
    }
    for index in (0..samples.len()).filter(|index| as_of[*index] != *index) {
        judged.out[index] = judged.out[as_of[index]];
    }
    judged
}

/// Samples without a silence between them.
struct Island {
    /// The numbers of those that were measured anew.
    samples: Vec<usize>,
    n_repeated: usize,
}

fn judge_island(
    all: &[Sample],
    Island { samples: island, n_repeated }: &Island,
    limits: &MotionLimits,
    judged: &mut Judged,
) {
    let samples: Vec<Sample> = island.iter().map(|index| all[*index]).collect();
    let repeats = *n_repeated as f64 / (samples.len() + n_repeated) as f64;
    let scales = Scales::new(&samples, repeats, limits);
    let tracks = tracks::tracks(&samples, &scales);
    let linked = chain::linked(&samples, &tracks, &scales);
    for (index, out) in island.iter().zip(&linked.out) {
        judged.out[*index] = *out;
    }
    judged.jumps.extend(linked.jumps.into_iter().map(|(index, cause)| (island[index], cause)));
    // Where many disagree, nothing says which are right.
    let seconds_at: Vec<f64> = samples.iter().map(|(stamp_ns, _)| seconds(*stamp_ns - samples[0].0)).collect();
    let end_s = seconds_at.last().copied().unwrap_or(0.0);
    for (k, index) in island.iter().enumerate() {
        // At an end the window lies within the samples.
        let from_s = (seconds_at[k] - WINDOW_S).min(end_s - 2.0 * WINDOW_S).max(0.0);
        let from = seconds_at.partition_point(|s| *s < from_s);
        let to = seconds_at.partition_point(|s| *s <= from_s + 2.0 * WINDOW_S);
        let off = linked.out[from..to].iter().flatten().filter(|cause| cause.kind != Kind::Unconfirmed);
        let (n_off, n) = (off.clone().count(), to - from);
        if n_off >= N_JUDGED && n_off as f64 >= AMBIGUOUS * n as f64 && judged.out[*index].is_none() {
            let largest = off.max_by(|a, b| a.size().mm.total_cmp(&b.size().mm));
            judged.out[*index] = largest.map(|largest| Cause::new(Kind::Ambiguous, largest.size()));
        }
    }
}

/// What some trackers give in place of a tool that they do not see.
fn is_identity(pose: &Isometry3<f64>) -> bool {
    pose.translation.vector == nalgebra::Vector3::zeros() && pose.rotation.w.abs() == 1.0
}

fn seconds(ns: StampNs) -> f64 {
    ns as f64 / 1e9
}

/// The deviation of a pose from another.
fn deviation(pose: &Isometry3<f64>, from: &Isometry3<f64>) -> Size {
    let rad = pose.rotation.angle_to(&from.rotation);
    Size { mm: (pose.translation.vector - from.translation.vector).norm(), rad: rad.min(2.0 * PI - rad) }
}

/// Where the motion from `a` to `b` leads, `share` of it after `b`; between them where `share` is negative.
fn extrapolated(a: &Isometry3<f64>, b: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let shift = (b.translation.vector - a.translation.vector) * share;
    let turn = (b.rotation * a.rotation.inverse()).scaled_axis() * share;
    Isometry3::from_parts(
        (b.translation.vector + shift).into(),
        nalgebra::UnitQuaternion::from_scaled_axis(turn) * b.rotation,
    )
}

#[cfg(test)]
mod tests;
