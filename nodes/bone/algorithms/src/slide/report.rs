//! What a slide profile says, in numbers and in words.

use super::axis::LongAxis;
use super::compare::Cells;
use super::search::{Minimum, SAME_MM};
use super::surface::{Loss, Scene};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// A minimum this many standard errors worse than the best is told apart from it.
const TOLD_SIGMAS: f64 = 2.0;

/// Turn over slide along a valley from which a slide is a screw, rad/mm: 10 mm per degree.
const SCREW_RAD_PER_MM: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// Half the length over which the slope of a valley is taken, as a share of the profile's half length.
const SLOPE_SHARE: f64 = 0.1;

/// The residual along one motion, with the five others fitted at each place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SlideProfile {
    /// Offsets from the result: mm along the bone, radians around it. In ascending order, closer together about 0.
    pub offsets: Vec<f64>,
    /// The other of these two motions where the residual is smallest: radians, or mm.
    pub others: Vec<f64>,
    /// RMS residual, limited to 5 standard deviations inside the surface and 2.5 outside, mm.
    pub residual_mm: Vec<f64>,
    /// Root of the growth of its square from the result, mm; 0 where it falls.
    pub excess_mm: Vec<f64>,
    /// The places next to the result, below and above, from which on the residuals are larger by more than one standard error
    /// and 0.02 mm. The ends of the profile if they are nowhere.
    pub interval: [f64; 2],
    /// Whether this interval reaches beyond `undetermined_mm` or `undetermined_deg`.
    pub is_undetermined: bool,
}

/// Another minimum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Other {
    /// Where it is along the bone, from the result, mm.
    pub along_mm: f64,
    /// Where it is around the bone, rad.
    pub turn_rad: f64,
    /// RMS distance of the scan there from the scan at the result, mm.
    pub apart_mm: f64,
    /// Its RMS residual, mm.
    pub residual_mm: f64,
    /// Root of the difference of the squared residuals, mm.
    pub excess_mm: f64,
    /// This difference in standard errors, from what differs between cells of 10 mm.
    pub sigmas: f64,
    /// Whether the residuals tell it from the result: by 2 standard errors and 0.02 mm.
    pub is_told_apart: bool,
}

/// How well the residuals determine the place of a scan along and around a bone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SlideReport {
    /// Whether the place is determined both along the bone and around it.
    pub determined: bool,
    /// Weak motions in words.
    pub modes: Vec<String>,
    /// The bone's axis where the scan lies, a unit vector in the target's frame.
    pub axis: [f64; 3],
    /// A point of it, target's frame, mm.
    pub middle_mm: [f64; 3],
    /// RMS distance of the surface from it, mm.
    pub radius_mm: f64,
    /// How far the scan moved along the bone, mm.
    pub moved_along_mm: f64,
    /// How far it turned about the bone, rad.
    pub moved_turn_rad: f64,
    /// RMS movement of the scan, mm.
    pub moved_mm: f64,
    /// RMS residual at the result, limited as in the profiles, mm.
    pub residual_mm: f64,
    /// Robust standard deviation of the residuals, mm: noise, and the error of both surfaces.
    pub sigma_mm: f64,
    /// The sensor's noise alone, from the scan, mm.
    pub noise_mm: f64,
    /// Number of cells of 10 mm whose residuals count as one draw each.
    pub n_cells: usize,
    /// Along the bone.
    pub along: SlideProfile,
    /// Around the bone.
    pub around: SlideProfile,
    /// The best of the other minima, if there is one within reach.
    pub runner_up: Option<Other>,
}

impl SlideReport {
    /// What the reader of a result should know: a place that is not determined, one that is hardly better than another, and a
    /// movement of more than `warn_mm` along the bone or `warn_rad` around it.
    pub fn warnings(&self, warn_mm: f64, warn_rad: f64) -> Vec<String> {
        let mut warnings = Vec::new();
        if !self.determined {
            warnings.push(format!(
                "the scan does not determine its place on the bone: {}; scan a longer stretch, or one with more shape",
                self.undetermined().join("; ")
            ));
        }
        if let Some(other) = self.runner_up.as_ref().filter(|other| self.determined && !other.is_told_apart) {
            warnings.push(format!("{}; scan a longer stretch, or one with more shape", other.words(self.residual_mm)));
        }
        if self.moved_along_mm.abs() > warn_mm || self.moved_turn_rad.abs() > warn_rad {
            warnings.push(format!(
                "the scan fits better {:+.1} mm along the bone and {:+.1} degrees around it from where the registration ended",
                self.moved_along_mm,
                self.moved_turn_rad.to_degrees()
            ));
        }
        warnings
    }

    /// The words for the motions that are not determined.
    pub fn undetermined(&self) -> Vec<String> {
        let profiles = [&self.along, &self.around];
        profiles
            .iter()
            .zip(&self.modes)
            .filter(|(profile, _)| profile.is_undetermined)
            .map(|(_, mode)| mode.clone())
            .collect()
    }
}

impl Other {
    /// Where it is, and how much worse it fits than the result.
    pub fn words(&self, best_mm: f64) -> String {
        format!(
            "the scan fits as well {:.0} mm along the bone and {:.0} degrees around it: {:.3} mm (RMS) against {best_mm:.3} mm, \
             {:.1} standard errors",
            self.along_mm,
            self.turn_rad.to_degrees(),
            self.residual_mm,
            self.sigmas
        )
    }
}

/// The parts of a report.
pub(super) struct Parts<'a> {
    pub(super) seen: &'a Scene<'a>,
    pub(super) axis: &'a LongAxis,
    pub(super) given: &'a Isometry3<f64>,
    pub(super) pose: &'a Isometry3<f64>,
    pub(super) minima: &'a [Minimum],
    pub(super) sigma_mm: f64,
    pub(super) sensor_mm: f64,
    pub(super) along: SlideProfile,
    pub(super) around: SlideProfile,
    /// Whether a turn alone, without a slide, is told apart where both are undetermined: one screw is, a cylinder is not.
    pub(super) turn_is_told: bool,
}

pub(super) fn report(found: &Parts<'_>) -> SlideReport {
    let Parts { seen, axis, given, pose, minima, sigma_mm, sensor_mm, along, around, turn_is_told } = found;
    let loss = Loss::new(*sigma_mm);
    let cells = Cells::new(&seen.points, &seen.centroid);
    let best = seen.costs(pose, &loss);
    let rms = |costs: &[f64]| (costs.iter().sum::<f64>() / costs.len().max(1) as f64).sqrt();
    let other = |minimum: &Minimum| {
        let costs = seen.costs(&minimum.pose, &loss);
        let difference = cells.difference(&costs, &best);
        let [along_mm, turn_rad] = axis.offset(seen, pose, &minimum.pose);
        Other {
            along_mm,
            turn_rad,
            apart_mm: seen.apart_mm(&minimum.pose, pose),
            residual_mm: rms(&costs),
            excess_mm: difference.excess_mm(),
            sigmas: difference.sigmas(),
            is_told_apart: difference.clear(TOLD_SIGMAS) > 1.0,
        }
    };
    let others = minima.iter().filter(|m| seen.apart_mm(&m.pose, pose) > SAME_MM).map(other);
    let [moved_along_mm, moved_turn_rad] = axis.offset(seen, given, pose);
    SlideReport {
        determined: !(along.is_undetermined || around.is_undetermined),
        modes: words(along, around, *turn_is_told),
        axis: axis.along.into(),
        middle_mm: axis.middle.coords.into(),
        radius_mm: axis.radius_mm,
        moved_along_mm,
        moved_turn_rad,
        moved_mm: seen.apart_mm(given, pose),
        residual_mm: rms(&best),
        sigma_mm: *sigma_mm,
        noise_mm: *sensor_mm,
        n_cells: cells.len(),
        along: along.clone(),
        around: around.clone(),
        runner_up: others.min_by(|a, b| a.sigmas.total_cmp(&b.sigmas)),
    }
}

/// The weak motions.
fn words(along: &SlideProfile, around: &SlideProfile, turn_is_told: bool) -> Vec<String> {
    let turn_per_mm = slope(along);
    let screws = turn_per_mm.abs() >= SCREW_RAD_PER_MM && (!around.is_undetermined || turn_is_told);
    let how = match screws {
        true => {
            let hand = if turn_per_mm > 0.0 { "right" } else { "left" };
            format!("screws along the bone, {:.1} mm per degree, {hand}-handed", 1.0 / turn_per_mm.abs().to_degrees())
        }
        false => "slides along the bone".to_owned(),
    };
    let of = |how: &str, profile: &SlideProfile, one: f64, unit: &str, each: &str| {
        let [low, high] = profile.interval.map(|end| end / one);
        match profile.is_undetermined {
            true => format!("{how}: undetermined, nothing tells {low:.0} to {high:.0} {unit} apart"),
            false => format!(
                "{how}: {each} changes the residual by {:.3} mm; determined to {low:+.2} .. {high:+.2} {unit}",
                excess_at(profile, one)
            ),
        }
    };
    vec![
        of(&how, along, 1.0, "mm", "1 mm"),
        of("turns about the bone", around, 1_f64.to_radians(), "degrees", "1 degree"),
    ]
}

/// Growth of the residual at an offset, the mean of both ways, mm.
fn excess_at(profile: &SlideProfile, offset: f64) -> f64 {
    let one = |offset: f64| interpolated(&profile.offsets, &profile.excess_mm, offset);
    (one(offset) + one(-offset)) / 2.0
}

/// Slope of the other motion along the valley through the result.
fn slope(profile: &SlideProfile) -> f64 {
    let reach = SLOPE_SHARE * profile.offsets.last().copied().unwrap_or(1.0);
    let one = |offset: f64| interpolated(&profile.offsets, &profile.others, offset);
    (one(reach) - one(-reach)) / (2.0 * reach)
}

fn interpolated(xs: &[f64], ys: &[f64], x: f64) -> f64 {
    let k = xs.partition_point(|at| *at < x).clamp(1, xs.len().max(2) - 1);
    let (Some(&x0), Some(&x1)) = (xs.get(k - 1), xs.get(k)) else { return 0.0 };
    let share = ((x - x0) / (x1 - x0)).clamp(0.0, 1.0);
    ys[k - 1] + share * (ys[k] - ys[k - 1])
}
