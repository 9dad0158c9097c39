//! What a deformation does at the targets.

use super::cause::{Axes, Mode};
use crate::trust::Limits;
use crate::trust::predict::Where;
use nalgebra::{Point3, Vector3, Vector6};

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

/// The error of the answer at a point: what the pose of `shift` and `turn` about the centroid and the modes do there, mm.
pub(super) fn error_at(
    axes: &Axes,
    pose: &Vector6<f64>,
    modes: &[Mode],
    values: &[f64],
    p: &Point3<f64>,
) -> Vector3<f64> {
    let (shift, turn) = (pose.fixed_rows::<3>(0).into_owned(), pose.fixed_rows::<3>(3).into_owned());
    let bone = modes.iter().zip(values).filter(|(mode, _)| mode.moves_bone());
    // A planned point has no normal of its own, and no mode that moves the bone needs one.
    let own: Vector3<f64> = bone.map(|(mode, value)| mode.at(axes, p, &Vector3::zeros()) * *value).sum();
    shift + turn.cross(&(p - axes.centre)) + own
}
