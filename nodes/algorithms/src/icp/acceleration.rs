//! Anderson acceleration of a fixed-point iteration on rigid motions.

use nalgebra::{Isometry3, Matrix5, Point3, SMatrix, UnitQuaternion, Vector3, Vector5, Vector6};

/// The longest history.
const MAX_DEPTH: usize = 5;

/// Share of the mean square of the history's columns that is added to their normal matrix: differences of steps that
/// are equal up to this would otherwise be told apart by rounding alone.
const REGULARISATION: f64 = 1e-10;

/// A pose of the source: its rotation, and where its centroid lies in the target's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct State {
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) centre: Point3<f64>,
}

impl State {
    /// The motion as `t_target_source`, for a source with this centroid.
    pub(super) fn isometry(&self, source_centre: &Point3<f64>) -> Isometry3<f64> {
        let translation = self.centre.coords - self.rotation * source_centre.coords;
        Isometry3::from_parts(translation.into(), self.rotation)
    }

    /// The motion from `reference` to here: shift of the centroid, turn about it times the lever arm, all in mm.
    pub(super) fn since(&self, reference: &State, lever_arm_mm: f64) -> Vector6<f64> {
        let shift = self.centre - reference.centre;
        let turn = (self.rotation * reference.rotation.inverse()).scaled_axis() * lever_arm_mm;
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    /// The state after the screw motion that begins as `motion`: what turns about an axis away from the centroid stays on
    /// its circle.
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

    /// The state that lies `motion` after this one: the inverse of [`State::since`].
    pub(super) fn moved(&self, motion: &Vector6<f64>, lever_arm_mm: f64) -> State {
        let turn = Vector3::new(motion[3], motion[4], motion[5]) / lever_arm_mm;
        let mut rotation = UnitQuaternion::from_scaled_axis(turn) * self.rotation;
        rotation.renormalize();
        State { rotation, centre: self.centre + Vector3::new(motion[0], motion[1], motion[2]) }
    }
}

/// The last few points `x` of an iteration and where its plain step leads from each, `g(x)`.
///
/// Source: Walker and Ni 2011, type II; Zhang, Yao and Deng 2021 for its use in ICP.
pub(super) struct Acceleration {
    depth: usize,
    /// Oldest first: `(g, f = g - x)`.
    history: Vec<(Vector6<f64>, Vector6<f64>)>,
}

impl Acceleration {
    pub(super) fn new(depth: u32) -> Self {
        Self { depth: (depth as usize).min(MAX_DEPTH), history: Vec::new() }
    }

    /// The fixed point as extrapolated from the history and the newest `x -> g`; `g` itself without a history.
    pub(super) fn next(&mut self, x: Vector6<f64>, g: Vector6<f64>) -> Vector6<f64> {
        let f = g - x;
        self.history.push((g, f));
        if self.history.len() > self.depth + 1 {
            self.history.remove(0);
        }
        let columns = self.history.len() - 1;
        if columns == 0 {
            return g;
        }
        // Unused columns stay zero and get a zero coefficient.
        let mut df = SMatrix::<f64, 6, 5>::zeros();
        let mut dg = SMatrix::<f64, 6, 5>::zeros();
        for (k, pair) in self.history.windows(2).enumerate() {
            dg.set_column(k, &(pair[1].0 - pair[0].0));
            df.set_column(k, &(pair[1].1 - pair[0].1));
        }
        let normal: Matrix5<f64> = df.tr_mul(&df);
        let scale = normal.trace() / columns as f64;
        let damped = normal + Matrix5::identity() * (scale * REGULARISATION).max(f64::MIN_POSITIVE);
        let Some(cholesky) = damped.cholesky() else { return g };
        let share: Vector5<f64> = cholesky.solve(&df.tr_mul(&f));
        let next = g - dg * share;
        if next.iter().all(|c| c.is_finite()) { next } else { g }
    }
}
