//! The residual along one motion, with the others fitted.

use super::SlideParams;
use super::axis::LongAxis;
use super::compare::{Cells, Difference};
use super::report::SlideProfile;
use super::search::Minimum;
use super::surface::{Beside, Loss, Scene};
use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, UnitQuaternion, Vector3, Vector6};

/// Places of a profile as a share of its half length: close together where the minimum is.
const PLACES: [f64; 17] =
    [0.01, 0.02, 0.033, 0.05, 0.067, 0.1, 0.133, 0.167, 0.2, 0.267, 0.333, 0.417, 0.5, 0.625, 0.75, 0.875, 1.0];

/// Steps of a fit at one place: the first with residuals up to [`WIDE_MM`].
const N_WIDE: usize = 2;
const N_STEPS: usize = 8;
const WIDE_MM: f64 = 1.5;

/// Steps shorter than this, mm, end a fit.
const SHORT_MM: f64 = 1e-3;

/// And so does a step that lowers the mean cost by a smaller share.
const SETTLED: f64 = 1e-3;

/// Damping of a step, as a share of each diagonal entry of the normal matrix: a cylinder determines four motions.
const DAMPING: f64 = 1e-5;

/// A minimum found elsewhere starts the fits of a profile this close to it, as a share of the profile's half length.
const NEAR_SHARE: f64 = 0.15;

/// A motion that a profile holds fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Motion {
    /// Along the axis.
    Along,
    /// About it.
    Around,
}

impl Motion {
    pub(super) const ALL: [Self; 2] = [Self::Along, Self::Around];

    fn index(self) -> usize {
        self as usize
    }
}

/// A fit at a place of a profile.
struct Fit {
    pose: Isometry3<f64>,
    costs: Vec<f64>,
    mean: f64,
}

/// The profile about `pose` over one motion.
pub(super) fn along(
    seen: &Scene<'_>,
    axis: &LongAxis,
    pose: &Isometry3<f64>,
    motion: Motion,
    loss: &Loss,
    minima: &[Minimum],
    params: &SlideParams,
) -> SlideProfile {
    let fixed = [motion == Motion::Along, motion == Motion::Around];
    let fitter = Fitter { seen, axis, fixed, loss, points: seen.few() };
    let moved = |pose: &Isometry3<f64>, by: f64| match motion {
        Motion::Along => axis.moved(pose, by, 0.0),
        Motion::Around => axis.moved(pose, 0.0, by),
    };
    let (half, limit) = match motion {
        Motion::Along => (params.along_mm, params.undetermined_mm),
        Motion::Around => (params.around_deg.to_radians(), params.undetermined_deg.to_radians()),
    };
    let elsewhere: Vec<(f64, Isometry3<f64>)> =
        minima.iter().map(|m| (axis.offset(seen, pose, &m.pose)[motion.index()], m.pose)).collect();
    let centre = fitter.fit(pose);
    // From the middle outward, each place from its neighbour and from minima nearby.
    let side = |sign: f64| {
        let (mut at, mut last) = (0.0, centre.pose);
        let mut places = Vec::new();
        for share in PLACES {
            let offset = sign * share * half;
            let near = elsewhere.iter().filter(|(there, _)| (there - offset).abs() <= NEAR_SHARE * half);
            let starts = near.map(|(there, pose)| (*there, *pose)).chain([(at, last)]);
            let fits = starts.map(|(there, pose)| fitter.fit(&moved(&pose, offset - there)));
            let Some(best) = fits.reduce(|a, b| if b.mean < a.mean { b } else { a }) else { continue };
            (at, last) = (offset, best.pose);
            places.push((offset, best));
        }
        places
    };
    let (below, above) = rayon::join(|| side(-1.0), || side(1.0));
    let mut places = below;
    places.reverse();
    let middle = places.len();
    places.push((0.0, centre));
    places.extend(above);

    let cells = Cells::new(&fitter.points, &seen.centroid);
    let best = &places[middle].1.costs;
    let differences: Vec<Difference> = places.iter().map(|(_, fit)| cells.difference(&fit.costs, best)).collect();
    let offsets: Vec<f64> = places.iter().map(|(offset, _)| *offset).collect();
    let other = 1 - motion.index();
    let interval = [end(&offsets, &differences, middle, -1), end(&offsets, &differences, middle, 1)];
    SlideProfile {
        is_undetermined: interval.iter().any(|end| end.abs() >= limit.min(half)),
        offsets,
        others: places.iter().map(|(_, fit)| axis.offset(seen, pose, &fit.pose)[other]).collect(),
        residual_mm: places.iter().map(|(_, fit)| fit.mean.sqrt()).collect(),
        excess_mm: differences.iter().map(Difference::excess_mm).collect(),
        interval,
    }
}

/// Whether the residuals tell a turn alone, without a slide, from none.
pub(super) fn turn_is_told(
    seen: &Scene<'_>,
    axis: &LongAxis,
    pose: &Isometry3<f64>,
    loss: &Loss,
    params: &SlideParams,
) -> bool {
    let fitter = Fitter { seen, axis, fixed: [true, true], loss, points: seen.few() };
    let cells = Cells::new(&fitter.points, &seen.centroid);
    let best = fitter.fit(pose).costs;
    let turn_rad = params.undetermined_deg.min(params.around_deg).to_radians();
    let is_told =
        |turn_rad| cells.difference(&fitter.fit(&axis.moved(pose, 0.0, turn_rad)).costs, &best).clear(1.0) > 1.0;
    is_told(turn_rad) && is_told(-turn_rad)
}

/// Where the residuals begin to tell a place from the middle, going one way; the end of the profile if nowhere.
///
/// A place is told apart if its residuals are larger by one standard error and by the floor. At one standard error the half
/// width of a parabola is twice the standard deviation of its minimum.
fn end(offsets: &[f64], differences: &[Difference], middle: usize, way: isize) -> f64 {
    let (mut at, mut before) = (middle, 0.0);
    loop {
        let Some(next) = at.checked_add_signed(way).filter(|next| *next < offsets.len()) else { return offsets[at] };
        let here = differences[next].clear(1.0);
        if here > 1.0 {
            let share = ((1.0 - before) / (here - before)).clamp(0.0, 1.0);
            return offsets[at] + share * (offsets[next] - offsets[at]);
        }
        (at, before) = (next, here.max(0.0));
    }
}

struct Fitter<'a> {
    seen: &'a Scene<'a>,
    axis: &'a LongAxis,
    /// Whether the motion along the axis, and the one about it, are held.
    fixed: [bool; 2],
    loss: &'a Loss,
    points: Vec<Point3<f64>>,
}

impl Fitter<'_> {
    /// The best fit near a pose in the motions that are not held.
    fn fit(&self, start: &Isometry3<f64>) -> Fit {
        let mut pose = *start;
        let mut best: Option<Fit> = None;
        for k in 0..=N_STEPS {
            let beside = self.seen.all_beside(&self.points, &pose);
            let costs = self.loss.costs(&beside);
            let mean = costs.iter().sum::<f64>() / costs.len().max(1) as f64;
            let is_better = best.as_ref().is_none_or(|best| mean < best.mean);
            // Close to its minimum the cost no longer falls.
            let is_done = best.as_ref().is_some_and(|best| k > N_WIDE && mean > best.mean * (1.0 - SETTLED));
            if is_better {
                best = Some(Fit { pose, costs, mean });
            }
            let next = if is_done { None } else { self.step(&pose, &beside, k < N_WIDE) };
            match next {
                Some((next, step_mm)) if step_mm > SHORT_MM => pose = next,
                _ => break,
            }
        }
        best.unwrap_or_else(|| Fit { pose, costs: Vec::new(), mean: 0.0 })
    }

    /// A point-to-plane step that leaves the held motions as they are, and its length, mm.
    fn step(&self, pose: &Isometry3<f64>, beside: &[Option<Beside>], is_wide: bool) -> Option<(Isometry3<f64>, f64)> {
        let loss = if is_wide { Loss::within(WIDE_MM) } else { *self.loss };
        let centre = pose * self.seen.centroid;
        let u = self.axis.along;
        let v = u.cross(&Vector3::ith(u.iamin(), 1.0)).normalize();
        let axes = Matrix3::from_columns(&[u, v, u.cross(&v)]);
        let (mut h, mut b, mut n, mut lever) = (Matrix6::zeros(), Vector6::zeros(), 0.0, 0.0);
        for (p, beside) in self.points.iter().zip(beside) {
            let Some(beside) = beside else { continue };
            let arm = pose * p - centre;
            let (shift, turn) = (axes.tr_mul(&beside.normal), axes.tr_mul(&arm.cross(&beside.normal)));
            let row = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
            let weight = loss.weight(beside.signed_mm);
            h.syger(weight, &row, &row, 1.0);
            b += row * (weight * beside.signed_mm);
            n += weight;
            lever += arm.norm_squared();
        }
        if n < 12.0 {
            return None;
        }
        h.fill_upper_triangle_with_lower_triangle();
        for k in 0..6 {
            h[(k, k)] *= 1.0 + DAMPING;
        }
        for (fixed, _) in [0, 3].into_iter().zip(self.fixed).filter(|(_, is_fixed)| *is_fixed) {
            h.fill_row(fixed, 0.0);
            h.fill_column(fixed, 0.0);
            (h[(fixed, fixed)], b[fixed]) = (1.0, 0.0);
        }
        let step = h.cholesky()?.solve(&-b);
        let shift: Vector3<f64> = axes * step.fixed_rows::<3>(0);
        let turn: Vector3<f64> = axes * step.fixed_rows::<3>(3);
        let lever_mm = (lever / self.points.len() as f64).sqrt();
        let step_mm = (shift.norm_squared() + (turn.norm() * lever_mm).powi(2)).sqrt();
        if !step_mm.is_finite() {
            return None;
        }
        let turn = UnitQuaternion::new(turn);
        let to = centre + shift;
        let moved = Isometry3::from_parts((to.coords - turn * centre.coords).into(), turn) * pose;
        Some((moved, step_mm))
    }
}
