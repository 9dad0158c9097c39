//! Covariance of what is estimated from the pairs.

use super::pairs::Pair;
use crate::kabsch::centroid;
use nalgebra::{Isometry3, Matrix3, Matrix3x6, Matrix6, Point3, SMatrix, SVector, Vector6};
use std::collections::BTreeMap;

/// Cell size for clustering residuals, mm: about the correlation length of a camera's smooth distortion.
pub const CELL_MM: f64 = 10.0;

/// Length over which a camera's smooth error of depth is correlated, mm: a third of its wavelength.
const SMOOTH_LENGTH_MM: f64 = 20.0;

/// About this many pairs represent all in sums over two.
const N_SMOOTH: usize = 400;

/// The middle of the sandwich `H⁻¹ M H⁻¹` for unknowns whose rows of the Jacobian are given: sums of residuals over cells,
/// which are seen, and a smooth error of depth of `smooth_mm`, which a motion of the phantom may hide.
pub(super) fn middle<const D: usize>(pairs: &[Pair], rows: &[SVector<f64, D>], smooth_mm: f64) -> SMatrix<f64, D, D> {
    let mut cells: BTreeMap<[i64; 3], SVector<f64, D>> = BTreeMap::new();
    for (pair, row) in pairs.iter().zip(rows) {
        let cell = std::array::from_fn(|k| (pair.phantom[k] / CELL_MM).floor() as i64);
        *cells.entry(cell).or_insert_with(SVector::zeros) += row * pair.residual_mm;
    }
    let mut middle: SMatrix<f64, D, D> = cells.values().map(|sum| sum * sum.transpose()).sum();
    let every = pairs.len().div_ceil(N_SMOOTH).max(1);
    let some: Vec<(&Point3<f64>, SVector<f64, D>)> =
        pairs.iter().zip(rows).step_by(every).map(|(p, row)| (&p.phantom, row * p.per_depth)).collect();
    let variance = (smooth_mm * every as f64).powi(2);
    for (at, row) in &some {
        let together: SVector<f64, D> = some
            .iter()
            .map(|(other, row)| row * (-(*at - **other).norm_squared() / SMOOTH_LENGTH_MM.powi(2)).exp())
            .sum();
        middle += row * together.transpose() * variance;
    }
    middle
}

/// Covariance of a small motion of the phantom, in the camera's frame.
pub(super) struct Spread {
    /// Of shift (mm) and turn (rad) about `centre`.
    pub(super) covariance: Matrix6<f64>,
    /// Centroid of the phantom's seen points, in the camera's frame, mm.
    pub(super) centre: Point3<f64>,
}

impl Spread {
    pub(super) fn new(pairs: &[Pair], t_camera_phantom: &Isometry3<f64>, smooth_mm: f64) -> Self {
        let points: Vec<Point3<f64>> = pairs.iter().map(|p| t_camera_phantom * p.phantom).collect();
        let centre = centroid(&points);
        let row = |(pair, point): (&Pair, &Point3<f64>)| {
            let n = t_camera_phantom * pair.normal;
            let turn = (point - centre).cross(&n);
            Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z)
        };
        let rows: Vec<Vector6<f64>> = pairs.iter().zip(&points).map(row).collect();
        let normal: Matrix6<f64> = rows.iter().map(|row| row * row.transpose()).sum();
        let inverse = normal.try_inverse().unwrap_or_else(Matrix6::zeros);
        let covariance = inverse * middle(pairs, &rows, smooth_mm) * inverse;
        // Rounding leaves it a little unsymmetric.
        Self { covariance: (covariance + covariance.transpose()) / 2.0, centre }
    }

    pub(super) fn rotation_sd_rad(&self) -> f64 {
        (3..6).map(|k| self.covariance[(k, k)]).sum::<f64>().max(0.0).sqrt()
    }

    /// RMS error of a point in the camera's frame, mm: the shift plus what the turn does there.
    pub(super) fn error_at(&self, point: &Point3<f64>) -> f64 {
        let mut motion = Matrix3x6::zeros();
        motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(point - self.centre).cross_matrix());
        (motion * self.covariance * motion.transpose()).trace().max(0.0).sqrt()
    }
}
