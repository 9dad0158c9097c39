//! Noise of a sensor, from a scan alone.

use crate::nearest::Nearest;
use crate::product::gram;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};
use rayon::prelude::*;

/// Number of places at which the noise is measured.
const N_PLACES: usize = 300;

/// Number of neighbours that a patch is fitted to.
const N_NEIGHBOURS: usize = 30;

/// A quadric describes a bone this far around, mm.
const WIDE_MM: f64 = 6.0;

/// Noise across the surface, mm: the median RMS residual of quadratic patches; `None` of a scan with fewer points than a patch, or with so
/// few around most of them that a patch is wider than a quadric describes.
pub(crate) fn sensor_noise_mm(points: &[Point3<f64>]) -> Option<f64> {
    let patches = noise_patches(points, N_NEIGHBOURS)?;
    let mut squares: Vec<f64> = patches.iter().map(|patch| patch.square).collect();
    squares.sort_by(f64::total_cmp);
    Some(squares[squares.len() / 2].sqrt())
}

/// The scan around a place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NoisePatch {
    pub(crate) place: Point3<f64>,
    /// Distance of its farthest point.
    pub(crate) reach_mm: f64,
    /// Mean square of what a quadric leaves, mm².
    pub(crate) square: f64,
}

/// Patches of this many neighbours at places evenly through the order of the points; `None` as of [`sensor_noise_mm`].
pub(crate) fn noise_patches(points: &[Point3<f64>], n_neighbours: usize) -> Option<Vec<NoisePatch>> {
    if points.len() < n_neighbours {
        return None;
    }
    let tree = Nearest::new(points);
    let every = points.len().div_ceil(N_PLACES).max(1);
    let places: Vec<Point3<f64>> = points.iter().step_by(every).copied().collect();
    let patches: Vec<NoisePatch> =
        places.par_iter().filter_map(|p| noise_patch(points, &tree, p, n_neighbours)).collect();
    (2 * patches.len() > places.len()).then_some(patches)
}

fn noise_patch(points: &[Point3<f64>], tree: &Nearest, place: &Point3<f64>, n: usize) -> Option<NoisePatch> {
    let near: Vec<Vector3<f64>> = tree.nearest_n(place, n).into_iter().map(|(i, _)| points[i].coords).collect();
    let n = near.len();
    let mean = near.iter().sum::<Vector3<f64>>() / n as f64;
    let scatter: Matrix3<f64> = near.iter().map(|v| (v - mean) * (v - mean).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let k = eigen.eigenvalues.imin();
    let normal = eigen.eigenvectors.column(k).into_owned();
    let (x, y) =
        (eigen.eigenvectors.column((k + 1) % 3).into_owned(), eigen.eigenvectors.column((k + 2) % 3).into_owned());
    // Squares of small or large patches would spoil the conditioning of the normal equations.
    let scale = near.iter().map(|v| (v - mean).norm()).fold(0.0, f64::max).max(1e-9);
    if scale > WIDE_MM {
        return None;
    }
    let a = DMatrix::from_fn(n, 6, |r, c| {
        let (u, v) = ((near[r] - mean).dot(&x) / scale, (near[r] - mean).dot(&y) / scale);
        [1.0, u, v, u * u, u * v, v * v][c]
    });
    let b = DVector::from_fn(n, |r, _| (near[r] - mean).dot(&normal));
    let h = gram(&a);
    let x = h.cholesky()?.solve(&(a.transpose() * &b));
    let rest = a * x - b;
    Some(NoisePatch { place: *place, reach_mm: scale, square: rest.norm_squared() / (n as f64 - 6.0) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use rand::RngExt;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    /// A curved, rough patch around (40, -30, 200), seeded.
    fn patch(n: usize, rough_mm: f64) -> Vec<Point3<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut draw = || rng.random_range(-1.0..1.0);
        let point = |_| {
            let (x, y): (f64, f64) = (4.0 * draw(), 3.0 * draw());
            let z = 0.02 * x * x - 0.03 * x * y + 0.01 * y * y + rough_mm * draw();
            Point3::new(40.0 + x, y - 30.0, 200.0 + z)
        };
        (0..n).map(point).collect()
    }

    #[test]
    fn a_scan_in_another_unit_has_its_noise_in_that_unit() {
        let points = patch(400, 0.1);
        let noise = sensor_noise_mm(&points).unwrap();
        let scaled = |unit: f64| sensor_noise_mm(&points.iter().map(|p| p * unit).collect::<Vec<_>>());
        let ratio = scaled(1e-4).map(|scaled| scaled / 1e-4 / noise);
        assert!(ratio.is_some_and(|ratio| (ratio - 1.0).abs() < 1e-6), "{ratio:?}");
        // Thirty points of a trace are centimetres wide, and say nothing of the noise.
        assert_eq!([20.0, 1e4].map(scaled), [None; 2]);
    }

    #[test]
    fn the_noise_of_a_patch_is_the_rms_of_what_a_quadric_leaves() {
        // Of one patch, every place sees the same 30 points: residuals of a quadric over its plane, over n - 6.
        let one = sensor_noise_mm(&patch(30, 0.1)).unwrap();
        // The median of 400 / 2 places.
        let many = sensor_noise_mm(&patch(400, 0.1)).unwrap();
        assert_eq!([one, many].map(|mm| format!("{mm:.9}")), ["0.051521039", "0.057982186"]);
        assert_eq!(sensor_noise_mm(&patch(29, 0.1)), None);
    }

    #[test]
    fn the_noise_does_not_depend_on_the_pose() {
        let points = patch(60, 0.1);
        let noise = sensor_noise_mm(&points).unwrap();
        for turn in [Vector3::x() * 1.6, Vector3::y() * 1.5, Vector3::new(1.0, 2.0, -0.5), Vector3::z() * 2.0] {
            let turn = Rotation3::new(turn);
            let turned: Vec<Point3<f64>> = points.iter().map(|p| turn * p).collect();
            let noise_mm = sensor_noise_mm(&turned).unwrap();
            // Rounding of coordinates of 200 mm alone: 1e-13 mm, times the condition of the fit.
            assert!((noise_mm - noise).abs() < 1e-9, "{noise_mm} instead of {noise} mm");
        }
    }
}
