//! What errors do at the targets.

use super::axes::Axes;
use super::cause::{Mode, Spot};
use crate::product::gram;
use crate::trust::Limits;
use crate::trust::predict::Where;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3, Vector6};

/// The largest errors at the targets.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(in crate::trust) struct Effect {
    /// The larger of the mean TRE and the displacements of cuts, mm.
    pub(in crate::trust) mm: f64,
    /// The largest tilt of a cut, degrees.
    pub(in crate::trust) deg: f64,
    /// The largest of error over limit.
    pub(in crate::trust) times: f64,
}

impl Effect {
    /// The effect of an error at the targets.
    pub(in crate::trust) fn new(
        place: &Where<'_>,
        limits: &Limits,
        error: &dyn Fn(&Point3<f64>) -> Vector3<f64>,
    ) -> Self {
        let tre_mm = place.limited.iter().map(|p| error(p).norm()).sum::<f64>() / place.limited.len().max(1) as f64;
        let (mut offset_mm, mut tilt_deg) = (0.0_f64, 0.0_f64);
        for displaced in place.cuts.iter().map(|cut| cut.displaced_by(error)) {
            offset_mm = offset_mm.max(displaced.offset_mm);
            tilt_deg = tilt_deg.max(displaced.slope.atan().to_degrees());
        }
        Self { mm: tre_mm.max(offset_mm), deg: tilt_deg, times: limits.times(tre_mm, offset_mm, tilt_deg) }
    }

    /// The larger in each.
    pub(in crate::trust) fn larger(self, other: Self) -> Self {
        Self { mm: self.mm.max(other.mm), deg: self.deg.max(other.deg), times: self.times.max(other.times) }
    }

    /// The effect of an error that is larger by a factor.
    pub(super) fn scaled(self, by: f64) -> Self {
        Self { mm: self.mm * by, deg: self.deg * by, times: self.times * by }
    }
}

/// What parameters of modes do at the targets, through the pose that a registration answers with and by themselves.
pub(super) struct Levers {
    axes: Axes,
    modes: Vec<Mode>,
    /// The pose's answer to each mode: a shift and a turn about the centre, a column for each.
    response: DMatrix<f64>,
}

impl Levers {
    pub(super) fn new(axes: Axes, modes: Vec<Mode>, response: DMatrix<f64>) -> Self {
        Self { axes, modes, response }
    }

    /// A column for each mode: the error of the answer at a point, mm, for a parameter of 1.
    pub(super) fn at(&self, p: &Point3<f64>) -> DMatrix<f64> {
        let arm = p - self.axes.centre;
        // A planned point has no normal of its own, and no mode that moves it needs one.
        let spot = Spot::new(&self.axes, *p, Vector3::zeros());
        let mut levers = DMatrix::zeros(3, self.modes.len());
        for (k, (mode, mut column)) in self.modes.iter().zip(levers.column_iter_mut()).enumerate() {
            let pose = Vector6::from_fn(|row, _| self.response[(row, k)]);
            let (shift, turn) = (pose.fixed_rows::<3>(0).into_owned(), pose.fixed_rows::<3>(3).into_owned());
            let own = if mode.moves_plan() { mode.at(&self.axes, &spot) } else { Vector3::zeros() };
            column.copy_from(&(shift + turn.cross(&arm) + own));
        }
        levers
    }

    /// A column for each of the pose's shifts and turns, and one for each mode at a pose that does not answer.
    pub(super) fn with_pose(&self, p: &Point3<f64>) -> DMatrix<f64> {
        let spot = Spot::new(&self.axes, *p, Vector3::zeros());
        let mut levers = DMatrix::zeros(3, 6 + self.modes.len());
        levers.view_mut((0, 0), (3, 3)).copy_from(&Matrix3::identity());
        levers.view_mut((0, 3), (3, 3)).copy_from(&-(p - self.axes.centre).cross_matrix());
        for (k, mode) in self.modes.iter().enumerate().filter(|(_, mode)| mode.moves_plan()) {
            levers.column_mut(6 + k).copy_from(&mode.at(&self.axes, &spot));
        }
        levers
    }

    /// The effect of parameters.
    pub(super) fn effect(&self, place: &Where<'_>, limits: &Limits, values: &DVector<f64>) -> Effect {
        Effect::new(place, limits, &|p| {
            let error = self.at(p) * values;
            Vector3::new(error[0], error[1], error[2])
        })
    }

    /// Of the modes `first..first + k` the directions of unit length that may move one of the targets most.
    pub(super) fn worst(&self, place: &Where<'_>, first: usize, k: usize) -> Vec<DVector<f64>> {
        let of = |p: &Point3<f64>| self.at(p).columns(first, k).into_owned();
        let mut maps: Vec<DMatrix<f64>> = place.cuts.iter().flat_map(|cut| cut.levers(&of)).collect();
        let mut points = DMatrix::zeros(3 * place.limited.len(), k);
        for (i, p) in place.limited.iter().enumerate() {
            points.rows_mut(3 * i, 3).copy_from(&of(p));
        }
        maps.push(points);
        let top = |map: DMatrix<f64>| {
            let eigen = gram(&map).symmetric_eigen();
            let mut whole = DVector::zeros(self.modes.len());
            whole.rows_mut(first, k).copy_from(&eigen.eigenvectors.column(eigen.eigenvalues.imax()));
            whole
        };
        maps.into_iter().map(top).collect()
    }
}
