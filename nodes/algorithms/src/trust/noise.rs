//! Noise of a sensor, from a scan alone.

use crate::nearest::Nearest;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};
use rayon::prelude::*;

/// Number of places at which the noise is measured.
const N_PLACES: usize = 300;

/// Number of neighbours that a patch is fitted to.
const N_NEIGHBOURS: usize = 30;

/// Noise across the surface, mm: the median RMS residual of quadratic patches; `None` of a scan with fewer points than a patch.
pub fn sensor_noise_mm(points: &[Point3<f64>]) -> Option<f64> {
    if points.len() < N_NEIGHBOURS {
        return None;
    }
    let tree = Nearest::new(points);
    let every = points.len().div_ceil(N_PLACES).max(1);
    let places: Vec<Point3<f64>> = points.iter().step_by(every).copied().collect();
    let mut squares: Vec<f64> = places.par_iter().filter_map(|p| patch_square(points, &tree, p)).collect();
    if squares.is_empty() {
        return None;
    }
    squares.sort_by(f64::total_cmp);
    Some(squares[squares.len() / 2].sqrt())
}

fn patch_square(points: &[Point3<f64>], tree: &Nearest, place: &Point3<f64>) -> Option<f64> {
    let near: Vec<Vector3<f64>> =
        tree.nearest_n(place, N_NEIGHBOURS).into_iter().map(|(i, _)| points[i] - place).collect();
    let n = near.len();
    let mean = near.iter().sum::<Vector3<f64>>() / n as f64;
    let scatter: Matrix3<f64> = near.iter().map(|v| (v - mean) * (v - mean).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let k = eigen.eigenvalues.imin();
    let normal = eigen.eigenvectors.column(k).into_owned();
    let (x, y) =
        (eigen.eigenvectors.column((k + 1) % 3).into_owned(), eigen.eigenvectors.column((k + 2) % 3).into_owned());
    let scale = near.iter().map(|v| v.norm()).fold(0.0, f64::max).max(1e-9);
    let a = DMatrix::from_fn(n, 6, |r, c| {
        let (u, v) = ((near[r] - mean).dot(&x) / scale, (near[r] - mean).dot(&y) / scale);
        [1.0, u, v, u * u, u * v, v * v][c]
    });
    let b = DVector::from_fn(n, |r, _| (near[r] - mean).dot(&normal));
    let h = a.transpose() * &a;
    let x = h.cholesky()?.solve(&(a.transpose() * &b));
    let rest = a * x - b;
    Some(rest.norm_squared() / (n as f64 - 6.0))
}
