//! The error between scan and surface, estimated from the residuals.

use super::Residual;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Minimum edge of the cells whose residuals count as one draw, mm: the correlation length of a camera's distortion and of a CT
/// surface's bumps.
pub(super) const CELL_MM: f64 = 10.0;

/// Number of points whose residuals are multiplied in pairs: level and length are then known to a tenth in half a million
/// products.
const N_POINTS: usize = 1000;

/// Upper ends of the classes of distances, mm, as in the published residuals of scanners: the first is that of the level.
const CLASSES_MM: [f64; 8] = [1.5, 3.0, 5.0, 8.0, 12.0, 18.0, 26.0, 36.0];

/// Fewest products of a class.
const MIN_PRODUCTS: usize = 50;

/// Residuals count as at most this many robust standard deviations: the few at a scan's edges must not decide.
const CLIP_SIGMAS: f64 = 4.0;

/// Half of a Gaussian's absolute values are below this many standard deviations.
pub(crate) const MEDIAN_SIGMAS: f64 = 0.674_489_750_196_081_7;

/// The error between a registered scan and the surface, of camera and CT together, by an exponential variogram.
///
/// Usual levels, mm, and lengths: structured light 0.03 to 0.1 over 3 to 5 mm; laser triangulation 0.05 to 0.1 over 3 to 8 mm;
/// stereo 0.3 over 2 to 3 mm; tracked ultrasound 0.4 to 1; a stylus 0.3; the segmentation of a CT 0.2 to 0.8 over 5 to 15 mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SurfaceError {
    /// Standard deviation that neighbouring points do not share, mm.
    pub noise_mm: f64,
    /// Standard deviation that they share, mm.
    pub level_mm: f64,
    /// Distance over which what they share falls to 37 %, mm.
    pub length_mm: f64,
}

impl SurfaceError {
    /// The error of points on the surface.
    ///
    /// Residuals are multiplied in pairs by classes of distance: products of near pairs have the shared part alone. `O(n)` for the
    /// points, and half a million products.
    ///
    /// # Source
    /// Matheron 1963 for the variogram, in its covariance form; winsorised as in Huber 1964.
    pub(crate) fn new(on: &[Residual]) -> Self {
        let some: Vec<&Residual> = on.iter().step_by(on.len().div_ceil(N_POINTS).max(1)).collect();
        let mut sizes: Vec<f64> = some.iter().map(|near| near.signed_mm.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let clip_mm = CLIP_SIGMAS * sizes.get(sizes.len() / 2).map_or(0.0, |median| median / MEDIAN_SIGMAS);
        let at: Vec<(Vector3<f64>, f64)> =
            some.iter().map(|near| (near.point.coords, near.signed_mm.clamp(-clip_mm, clip_mm))).collect();
        let variance = at.iter().map(|(_, mm)| mm * mm).sum::<f64>() / at.len().max(1) as f64;
        let mut classes = [(0_usize, 0.0, 0.0); CLASSES_MM.len()];
        for (i, (a, of_a)) in at.iter().enumerate() {
            for (b, of_b) in &at[..i] {
                let apart_mm = (a - b).norm();
                let Some(class) = CLASSES_MM.iter().position(|end| apart_mm < *end) else { continue };
                let (n, distances, products) = &mut classes[class];
                (*n, *distances, *products) = (*n + 1, *distances + apart_mm, *products + of_a * of_b);
            }
        }
        let covariances: Vec<(f64, f64)> = classes
            .iter()
            .filter(|(n, ..)| *n >= MIN_PRODUCTS)
            .map(|(n, distances, products)| (distances / *n as f64, products / *n as f64))
            .collect();
        let level = covariances.first().map_or(0.0, |(_, covariance)| covariance.clamp(0.0, variance));
        let length_mm = length_mm(&covariances, level);
        Self { noise_mm: (variance - level).sqrt(), level_mm: level.sqrt(), length_mm }
    }

    /// Edge of cells whose residuals are nearly independent of each other, at least `least_mm`, mm.
    pub(super) fn cell_mm(&self, least_mm: f64) -> f64 {
        (2.0 * self.length_mm).max(least_mm)
    }
}

/// Where the covariance falls to 37 % of the level, between the classes' mean distances; the last one if it never does.
fn length_mm(covariances: &[(f64, f64)], level: f64) -> f64 {
    let limit = level / std::f64::consts::E;
    let (mut before, mut above) = (0.0, level);
    for &(apart_mm, covariance) in covariances {
        if covariance <= limit {
            let share = if above > covariance { (above - limit) / (above - covariance) } else { 1.0 };
            return before + share * (apart_mm - before);
        }
        (before, above) = (apart_mm, covariance);
    }
    before
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
    use rand_distr::{Distribution, StandardNormal};

    /// A plate of 100 mm by 60 mm with white noise and a smooth error: averages of white noise by a Gaussian of this width.
    fn plate(noise_mm: f64, level_mm: f64, width_mm: f64) -> Vec<Residual> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        let (nx, ny) = (100_i32, 60_i32);
        let field: Vec<f64> = (0..(nx + 40) * (ny + 40)).map(|_| draw()).collect();
        let reach = (3.0 * width_mm).ceil().min(20.0) as i32;
        let weight = |dx: i32, dy: i32| (-f64::from(dx * dx + dy * dy) / (2.0 * width_mm * width_mm)).exp();
        let around = || (-reach..=reach).flat_map(move |dx| (-reach..=reach).map(move |dy| (dx, dy)));
        let norm = around().map(|(dx, dy)| weight(dx, dy).powi(2)).sum::<f64>().sqrt();
        let at = |k: i32| {
            let (x, y) = (k % nx, k / nx);
            let sum: f64 = around()
                .map(|(dx, dy)| weight(dx, dy) * field[((y + 20 + dy) * (nx + 40) + x + 20 + dx) as usize])
                .sum();
            (x, y, level_mm * sum / norm)
        };
        let smooth: Vec<_> = (0..nx * ny).map(at).collect();
        let residual = |(x, y, smooth): (i32, i32, f64)| Residual {
            point: Point3::new(f64::from(x), f64::from(y), 0.0),
            normal: Vector3::z(),
            signed_mm: smooth + noise_mm * draw(),
            aside_mm: 0.0,
        };
        smooth.into_iter().map(residual).collect()
    }

    #[test]
    fn noise_level_and_length_are_found_and_a_white_error_has_no_level() {
        // The covariance of such averages is exp(-h² / 4w²), 37 % at twice the width.
        for (noise_mm, level_mm, width_mm) in [(0.05, 0.1, 2.5), (0.6, 0.8, 3.0), (0.02, 0.3, 5.0)] {
            let found = SurfaceError::new(&plate(noise_mm, level_mm, width_mm));
            // A plate has a few hundred independent patches, and classes of distance are some millimetres wide.
            let near = |found: f64, expected: f64, share: f64| (found / expected - 1.0).abs() < share;
            assert!(near(found.level_mm, level_mm, 0.2), "{found:?}, level {level_mm}");
            assert!(near(found.length_mm, 2.0 * width_mm, 0.35), "{found:?}, length {}", 2.0 * width_mm);
            assert!((found.noise_mm - noise_mm).abs() < 0.35 * level_mm, "{found:?}, noise {noise_mm}");
        }
        let white = SurfaceError::new(&plate(0.3, 0.0, 2.0));
        assert!(white.level_mm < 0.06 && (white.noise_mm - 0.3).abs() < 0.02, "{white:?}");
    }

    #[test]
    fn single_outliers_do_not_decide_and_nothing_has_no_error() {
        let mut plate = plate(0.05, 0.1, 2.5);
        let clean = SurfaceError::new(&plate);
        plate.iter_mut().step_by(83).for_each(|near| near.signed_mm += 3.0);
        let with = SurfaceError::new(&plate);
        assert!((with.level_mm - clean.level_mm).abs() < 0.03, "{with:?} instead of {clean:?}");
        assert!((with.length_mm / clean.length_mm - 1.0).abs() < 0.3, "{with:?} instead of {clean:?}");
        assert_eq!(SurfaceError::new(&[]), SurfaceError { noise_mm: 0.0, level_mm: 0.0, length_mm: 0.0 });
    }
}
