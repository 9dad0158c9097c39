//! A random motion of a cloud, to measure a registration from starts that nothing is known of.

use crate::kabsch::centroid;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

/// A turn about the centroid by a random angle about a random axis, then a shift by a random length in a random direction.
///
/// Each angle up to `max_turn_rad` and each length up to `max_shift_mm` is as likely, and so is each axis and direction. Published
/// protocols draw three Euler angles and three coordinates instead, up to the same limits.
pub fn random_motion(
    points: &[Point3<f64>],
    max_turn_rad: f64,
    max_shift_mm: f64,
    rng: &mut impl Rng,
) -> Isometry3<f64> {
    let centre = centroid(points).coords;
    let turn = UnitQuaternion::new(direction(rng) * rng.random_range(0.0..=max_turn_rad));
    let shift = direction(rng) * rng.random_range(0.0..=max_shift_mm);
    Translation3::from(centre + shift) * turn * Translation3::from(-centre)
}

/// A direction, each as likely: points of a ball, by rejection from a cube.
fn direction(rng: &mut impl Rng) -> Vector3<f64> {
    loop {
        let in_cube = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        let length: f64 = in_cube.norm();
        if (0.1..=1.0).contains(&length) {
            return in_cube / length;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn turns_and_shifts_fill_their_ranges_and_follow_the_seed() {
        let points = [[0.0, 0.0, 900.0], [30.0, 0.0, 900.0], [0.0, 40.0, 910.0]].map(Point3::from);
        let centre = centroid(&points);
        let drawn = |seed| random_motion(&points, 1.5, 200.0, &mut ChaCha8Rng::seed_from_u64(seed));
        let (mut turns, mut shifts, mut ways) = (Vec::new(), Vec::new(), Vector3::zeros());
        for seed in 0..400 {
            assert_eq!(drawn(seed), drawn(seed));
            turns.push(drawn(seed).rotation.angle());
            let shift = drawn(seed) * centre - centre;
            shifts.push(shift.norm());
            ways += shift.normalize();
        }
        for (values, most) in [(&turns, 1.5), (&shifts, 200.0)] {
            let mean = values.iter().sum::<f64>() / 400.0;
            assert!(values.iter().all(|value| *value <= most), "{values:?}");
            assert!((mean / most - 0.5).abs() < 0.06, "uniform within four standard errors: {mean}");
        }
        assert!(ways.norm() < 80.0, "four standard errors of a sum of 400 directions: {ways}");
    }
}
