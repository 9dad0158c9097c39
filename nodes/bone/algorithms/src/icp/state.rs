//! The pose of the source while it is registered.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3, Vector6};

/// The pose of the source: its rotation, and the place of its centroid in the target's frame.
///
/// Motions are `(shift of the centroid, rotation vector · lever arm)`, all six in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct State {
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) centroid: Point3<f64>,
}

impl State {
    /// The pose as `t_target_source`, for a source with this centroid.
    pub(super) fn isometry(&self, source_centroid: &Point3<f64>) -> Isometry3<f64> {
        let translation = self.centroid.coords - self.rotation * source_centroid.coords;
        Isometry3::from_parts(translation.into(), self.rotation)
    }

    /// The motion from `reference` to this state.
    pub(super) fn since(&self, reference: &State, lever_arm_mm: f64) -> Vector6<f64> {
        let shift = self.centroid - reference.centroid;
        let turn = (self.rotation * reference.rotation.inverse()).scaled_axis() * lever_arm_mm;
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    /// The state `motion` after this one: the inverse of [`State::since`].
    pub(super) fn moved(&self, motion: &Vector6<f64>, lever_arm_mm: f64) -> State {
        let turn = Vector3::new(motion[3], motion[4], motion[5]) / lever_arm_mm;
        let mut rotation = UnitQuaternion::from_scaled_axis(turn) * self.rotation;
        rotation.renormalize();
        State { rotation, centroid: self.centroid + Vector3::new(motion[0], motion[1], motion[2]) }
    }

    /// The state after the screw motion whose first derivative is `motion`: a turn about an axis away from the centroid
    /// moves the centroid along a circle.
    pub(super) fn screwed(&self, motion: &Vector6<f64>, lever_arm_mm: f64) -> State {
        let (shift, turn) = (motion.fixed_rows::<3>(0).into_owned(), motion.fixed_rows::<3>(3) / lever_arm_mm);
        let angle = turn.norm();
        let mut bent = *motion;
        if angle > 1e-6 {
            let (across, twice) = (turn.cross(&shift), turn.cross(&turn.cross(&shift)));
            let shift = shift
                + across * ((1.0 - angle.cos()) / angle.powi(2))
                + twice * ((angle - angle.sin()) / angle.powi(3));
            bent.fixed_rows_mut::<3>(0).copy_from(&shift);
        }
        self.moved(&bent, lever_arm_mm)
    }
}
