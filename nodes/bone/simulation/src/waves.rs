//! A smooth random field in space.

use crate::draws::direction;
use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

const N_WAVES: usize = 24;

/// A sum of plane waves of uniformly distributed directions: nearly normal, mean 0, standard deviation 1.
pub(crate) struct Waves(Vec<(Vector3<f64>, f64)>);

impl Waves {
    /// Wavelengths from half to twice `wavelength_mm`.
    pub(crate) fn new(rng: &mut ChaCha8Rng, wavelength_mm: f64) -> Self {
        Self::of(rng, |share| wavelength_mm * 2f64.powf(2.0 * share - 1.0))
    }

    /// Wavelengths from `min_mm` to `max_mm`.
    pub(crate) fn between(rng: &mut ChaCha8Rng, [min_mm, max_mm]: [f64; 2]) -> Self {
        Self::of(rng, |share| min_mm * (max_mm / min_mm).powf(share))
    }

    fn of(rng: &mut ChaCha8Rng, wavelength_mm: impl Fn(f64) -> f64) -> Self {
        let wave = |_| {
            let wavelength_mm = wavelength_mm(rng.random());
            (direction(rng) * (TAU / wavelength_mm), TAU * rng.random::<f64>())
        };
        Self((0..N_WAVES).map(wave).collect())
    }

    /// The field at a point times `scale`, not evaluated if `scale` is 0.
    pub(crate) fn scaled(&self, scale: f64, point: &Point3<f64>) -> f64 {
        if scale == 0.0 {
            return 0.0;
        }
        let sum = self.0.iter().map(|(k, phase)| (k.dot(&point.coords) + phase).cos()).sum::<f64>();
        scale * (2.0 / N_WAVES as f64).sqrt() * sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draws::{Term, stream};

    #[test]
    fn the_field_has_standard_deviation_one_and_hardly_changes_over_a_tenth_of_a_wave() {
        let (mut squares, mut steps) = (0.0, 0.0);
        for seed in 0..400 {
            let waves = Waves::new(&mut stream(seed, Term::DepthBias, 0), 20.0);
            let at = |x: f64| waves.scaled(1.0, &Point3::new(x, 3.0, -200.0));
            squares += at(0.0).powi(2);
            steps += (at(2.0) - at(0.0)).powi(2);
        }
        let (spread, step) = ((squares / 400.0).sqrt(), (steps / 400.0).sqrt());
        // Four standard errors of a standard deviation over 400 draws are 14 %.
        assert!((spread - 1.0).abs() < 0.14 && step < 0.6, "{spread}, over 2 mm {step}");
    }
}
