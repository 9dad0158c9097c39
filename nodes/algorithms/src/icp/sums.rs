//! What the pairs at one pose ask for, summed.

use nalgebra::{ArrayStorage, Matrix3, Matrix6, Vector3, Vector6};

/// Sums over the pairs used, taken over chunks in order.
#[derive(Clone)]
pub(super) struct Sums {
    /// Pairs with any weight.
    pub(super) n: usize,
    /// Their weights.
    pub(super) weight: f64,
    /// Squared residuals times weights, mm².
    pub(super) squares: f64,
    /// Squared distances between the points times weights, mm².
    pub(super) point_squares: f64,
    /// `point_to_point` only: squared distances along the normals times weights, mm².
    pub(super) plane_squares: f64,
    /// What is minimised: squared residuals as the weights make them grow, unused points included, mm².
    pub(super) cost: f64,
    /// `Jᵀ W r`.
    pub(super) gradient: Vector6<f64>,
    /// `Jᵀ W J`: how the residual bends once points find new partners. Along the normals for `point_to_point`.
    pub(super) hold: Matrix6<f64>,
    /// `point_to_point` only: `Jᵀ W J` between the points, how it bends while points keep their partners.
    pub(super) grip: Matrix6<f64>,
    /// `point_to_point` only: weighted sums of arms, of the partners' places, and of their products.
    pub(super) arm: Vector3<f64>,
    pub(super) offset: Vector3<f64>,
    pub(super) offset_arm: Matrix3<f64>,
}

impl Sums {
    pub(super) const ZERO: Self = Self {
        n: 0,
        weight: 0.0,
        squares: 0.0,
        point_squares: 0.0,
        plane_squares: 0.0,
        cost: 0.0,
        gradient: Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        hold: Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6])),
        grip: Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6])),
        arm: Vector3::new(0.0, 0.0, 0.0),
        offset: Vector3::new(0.0, 0.0, 0.0),
        offset_arm: Matrix3::from_array_storage(ArrayStorage([[0.0; 3]; 3])),
    };

    pub(super) fn add(mut self, other: &Self) -> Self {
        self.n += other.n;
        self.weight += other.weight;
        self.squares += other.squares;
        self.point_squares += other.point_squares;
        self.plane_squares += other.plane_squares;
        self.cost += other.cost;
        self.gradient += other.gradient;
        self.hold += other.hold;
        self.grip += other.grip;
        self.arm += other.arm;
        self.offset += other.offset;
        self.offset_arm += other.offset_arm;
        self
    }

    /// Adds a residual of one component with this Jacobian row.
    #[inline]
    pub(super) fn add_row(&mut self, row: &Vector6<f64>, residual: f64, weight: f64) {
        self.gradient += row * (weight * residual);
        self.add_hold(row, weight);
    }

    #[inline]
    pub(super) fn add_hold(&mut self, row: &Vector6<f64>, weight: f64) {
        for (column, factor) in self.hold.as_mut_slice().chunks_exact_mut(6).zip(row) {
            let factor = factor * weight;
            for (sum, value) in column.iter_mut().zip(row) {
                *sum += factor * value;
            }
        }
    }

    /// Adds a residual `gap` of three components, of which `information` says how much each counts.
    #[inline]
    pub(super) fn add_block(
        &mut self,
        information: &Matrix3<f64>,
        gap: &Vector3<f64>,
        arm: &Vector3<f64>,
        lever_arm_mm: f64,
    ) {
        // J = [I, -[arm]x / lever arm].
        let turn = (arm / lever_arm_mm).cross_matrix();
        let pull = information * gap;
        let turned = turn * pull;
        self.gradient += Vector6::new(pull.x, pull.y, pull.z, turned.x, turned.y, turned.z);
        let upper = turn * information;
        for i in 0..3 {
            for j in 0..3 {
                self.hold[(i, j)] += information[(i, j)];
                self.hold[(i + 3, j)] += upper[(i, j)];
                self.hold[(j, i + 3)] += upper[(i, j)];
            }
        }
        let corner = -upper * turn;
        for i in 0..3 {
            for j in 0..3 {
                self.hold[(i + 3, j + 3)] += corner[(i, j)];
            }
        }
    }

    /// Adds what Kabsch and the resolution of points need.
    pub(super) fn add_grip(&mut self, arm: &Vector3<f64>, gap: &Vector3<f64>, weight: f64, lever_arm_mm: f64) {
        let cross = (arm / lever_arm_mm).cross_matrix();
        let corner = -cross * cross;
        for i in 0..3 {
            self.grip[(i, i)] += weight;
            for j in 0..3 {
                self.grip[(i, j + 3)] -= weight * cross[(i, j)];
                self.grip[(i + 3, j)] += weight * cross[(i, j)];
                self.grip[(i + 3, j + 3)] += weight * corner[(i, j)];
            }
        }
        let offset = arm - gap;
        self.arm += arm * weight;
        self.offset += offset * weight;
        self.offset_arm += offset * (arm * weight).transpose();
    }

    /// Weighted RMS of the residual over the pairs used, mm.
    pub(super) fn rms_mm(&self) -> f64 {
        (self.squares / self.weight.max(f64::MIN_POSITIVE)).sqrt()
    }
}

/// The Jacobian row of one pair: how the residual along `normal` changes with a shift and a turn about the centre.
#[inline]
pub(super) fn plane_row(normal: &Vector3<f64>, arm: &Vector3<f64>, lever_arm_mm: f64) -> Vector6<f64> {
    let turn = arm.cross(normal) / lever_arm_mm;
    Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z)
}
