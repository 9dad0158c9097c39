//! The normal equations of the correspondences at one pose.

use nalgebra::{ArrayStorage, Matrix3, Matrix6, Vector3, Vector6};

/// Sums over the inliers, taken over chunks in order. The unknowns are `(shift, turn · lever arm)`, mm.
#[derive(Clone)]
pub(super) struct NormalEquations {
    /// Number of pairs with a weight above zero.
    pub(super) n_pairs: usize,
    /// Sum of their weights.
    pub(super) weight: f64,
    /// Weighted sum of squared residuals, mm².
    pub(super) squares: f64,
    /// Largest squared residuals of the inliers, mm²: where outside of the surface counts less, of those inside and of those outside.
    pub(super) largest_squares: [f64; 2],
    /// Weighted sum of squared distances between the points, mm².
    pub(super) point_squares: f64,
    /// `point_to_point` only: weighted sum of squared distances along the target's normals, mm².
    pub(super) plane_squares: f64,
    /// The robust cost, outliers and unpaired points included, mm².
    pub(super) cost: f64,
    /// The gradient `JᵀWr`.
    pub(super) b: Vector6<f64>,
    /// `JᵀWJ`. Along the target's normals for `point_to_point`: the curvature once points have found new pairs.
    pub(super) h: Matrix6<f64>,
    /// `point_to_point` only: `JᵀWJ` of the distances between the points, the curvature while the pairs stay.
    pub(super) h_points: Matrix6<f64>,
    /// `point_to_point` only: weighted sum of the source points, about the source's centroid.
    pub(super) source_sum: Vector3<f64>,
    /// `point_to_point` only: weighted sum of the paired target points, about the source's centroid.
    pub(super) target_sum: Vector3<f64>,
    /// `point_to_point` only: weighted sum of `target · sourceᵀ`.
    pub(super) cross_products: Matrix3<f64>,
}

impl NormalEquations {
    pub(super) const ZERO: Self = Self {
        n_pairs: 0,
        weight: 0.0,
        squares: 0.0,
        largest_squares: [0.0; 2],
        point_squares: 0.0,
        plane_squares: 0.0,
        cost: 0.0,
        b: Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        h: Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6])),
        h_points: Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6])),
        source_sum: Vector3::new(0.0, 0.0, 0.0),
        target_sum: Vector3::new(0.0, 0.0, 0.0),
        cross_products: Matrix3::from_array_storage(ArrayStorage([[0.0; 3]; 3])),
    };

    pub(super) fn add(mut self, other: &Self) -> Self {
        self.n_pairs += other.n_pairs;
        self.weight += other.weight;
        self.squares += other.squares;
        for (largest, other) in self.largest_squares.iter_mut().zip(other.largest_squares) {
            *largest = largest.max(other);
        }
        self.point_squares += other.point_squares;
        self.plane_squares += other.plane_squares;
        self.cost += other.cost;
        self.b += other.b;
        self.h += other.h;
        self.h_points += other.h_points;
        self.source_sum += other.source_sum;
        self.target_sum += other.target_sum;
        self.cross_products += other.cross_products;
        self
    }

    /// Adds a scalar residual with this Jacobian row.
    #[inline]
    pub(super) fn add_row(&mut self, row: &Vector6<f64>, residual: f64, weight: f64) {
        self.b += row * (weight * residual);
        self.add_h(row, weight);
    }

    /// Adds `weight · rowᵀ row` to `h`.
    #[inline]
    pub(super) fn add_h(&mut self, row: &Vector6<f64>, weight: f64) {
        for (column, factor) in self.h.as_mut_slice().chunks_exact_mut(6).zip(row) {
            let factor = factor * weight;
            for (sum, value) in column.iter_mut().zip(row) {
                *sum += factor * value;
            }
        }
    }

    /// Adds a residual of three components with this information matrix, at a source point about the centroid.
    #[inline]
    pub(super) fn add_block(
        &mut self,
        information: &Matrix3<f64>,
        residual: &Vector3<f64>,
        source: &Vector3<f64>,
        lever_arm_mm: f64,
    ) {
        // J = [I, -[source]x / lever arm].
        let cross = (source / lever_arm_mm).cross_matrix();
        let force = information * residual;
        let torque = cross * force;
        self.b += Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z);
        let upper = cross * information;
        for i in 0..3 {
            for j in 0..3 {
                self.h[(i, j)] += information[(i, j)];
                self.h[(i + 3, j)] += upper[(i, j)];
                self.h[(j, i + 3)] += upper[(i, j)];
            }
        }
        let corner = -upper * cross;
        for i in 0..3 {
            for j in 0..3 {
                self.h[(i + 3, j + 3)] += corner[(i, j)];
            }
        }
    }

    /// Adds a pair to `h_points` and to the sums of Kabsch; `difference` is the source point less the target point.
    pub(super) fn add_points(
        &mut self,
        source: &Vector3<f64>,
        difference: &Vector3<f64>,
        weight: f64,
        lever_arm_mm: f64,
    ) {
        let cross = (source / lever_arm_mm).cross_matrix();
        let corner = -cross * cross;
        for i in 0..3 {
            self.h_points[(i, i)] += weight;
            for j in 0..3 {
                self.h_points[(i, j + 3)] -= weight * cross[(i, j)];
                self.h_points[(i + 3, j)] += weight * cross[(i, j)];
                self.h_points[(i + 3, j + 3)] += weight * corner[(i, j)];
            }
        }
        let target = source - difference;
        self.source_sum += source * weight;
        self.target_sum += target * weight;
        self.cross_products += target * (source * weight).transpose();
    }

    /// Weighted RMS residual of the inliers, mm.
    pub(super) fn rms_mm(&self) -> f64 {
        (self.squares / self.weight.max(f64::MIN_POSITIVE)).sqrt()
    }
}

/// The Jacobian row of the residual along `normal` at a source point about the centroid.
#[inline]
pub(super) fn jacobian_row(normal: &Vector3<f64>, source: &Vector3<f64>, lever_arm_mm: f64) -> Vector6<f64> {
    let turn = source.cross(normal) / lever_arm_mm;
    Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3x6;

    /// A block adds `JᵀΩJ` and `JᵀΩr` with `J = [I, -[source]x / lever arm]`, to what is there.
    #[test]
    fn a_block_adds_the_products_of_its_jacobian() {
        let information = Matrix3::new(2.0, 0.5, -0.3, 0.5, 1.0, 0.2, -0.3, 0.2, 3.0);
        let (mut found, mut h, mut b) = (NormalEquations::ZERO, Matrix6::zeros(), Vector6::zeros());
        for (source, residual) in [([3.0, -7.0, 40.0], [0.1, 0.4, -0.2]), ([-5.0, 2.0, -31.0], [-0.3, 0.2, 0.6])]
            .map(|(s, r)| (Vector3::from(s), Vector3::from(r)))
        {
            found.add_block(&information, &residual, &source, 25.0);
            let mut jacobian = Matrix3x6::zeros();
            jacobian.fixed_columns_mut::<3>(0).fill_with_identity();
            jacobian.fixed_columns_mut::<3>(3).copy_from(&(-source.cross_matrix() / 25.0));
            h += jacobian.transpose() * information * jacobian;
            b += jacobian.transpose() * information * residual;
        }
        assert!((found.h - h).amax() < 1e-12, "{}", found.h - h);
        assert!((found.b - b).amax() < 1e-12, "{}", found.b - b);
    }
}
