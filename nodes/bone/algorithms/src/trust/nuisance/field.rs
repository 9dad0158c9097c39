//! The errors of the camera's depth that are there in every scan.

use super::axes::Axes;
use nalgebra::{Point3, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Number of waves along the scan that are alike across it.
const N_EVEN: usize = 14;

/// Number of waves along the scan that are opposite on its two sides.
const N_ODD: usize = 10;

/// Number of waves.
pub(super) const N_FIELD: usize = N_EVEN + N_ODD;

/// Half waves of the first over the scan: fewer look as a shift and a tilt.
const FIRST: usize = 2;

/// Displacements towards the camera that vary along the scan, as 2, 3, ... 15 half waves. A shaft is too narrow to show how the waves vary
/// across it.
///
/// Without them each such error is explained by the cause that is most like it: a smooth error of the camera by a step.
pub(super) struct Field {
    /// The waves' values at the points of the scan.
    waves: Vec<[f64; N_FIELD]>,
    /// Prior standard deviations of the amplitudes, mm.
    pub(super) sds_mm: [f64; N_FIELD],
}

impl Field {
    /// The field at the points of a scan, whose longest wave has this standard deviation, mm; the other waves have less in proportion to their
    /// lengths.
    pub(super) fn new(axes: &Axes, points: &[Point3<f64>], longest_mm: f64) -> Self {
        let mut across_mm: Vec<f64> = points.iter().map(|p| (p - axes.centre).dot(&axes.sideways).abs()).collect();
        across_mm.sort_by(f64::total_cmp);
        let half_mm = across_mm[(across_mm.len() - 1) * 98 / 100].max(1.0);
        let half_waves = |k: usize| (FIRST + if k < N_EVEN { k } else { k - N_EVEN }) as f64;
        let waves = |p: &Point3<f64>| {
            let phase = FRAC_PI_2 * (axes.along_share(p).clamp(-1.0, 1.0) + 1.0);
            let across = ((p - axes.centre).dot(&axes.sideways) / half_mm).clamp(-1.0, 1.0);
            std::array::from_fn(|k| (half_waves(k) * phase).cos() * if k < N_EVEN { 1.0 } else { across })
        };
        let sd_mm = |k: usize| longest_mm * FIRST as f64 / half_waves(k);
        Self { waves: points.iter().map(waves).collect(), sds_mm: std::array::from_fn(sd_mm) }
    }

    /// What each amplitude does at a point of the scan: multiples of the direction towards the camera.
    pub(super) fn at(&self, index: usize) -> &[f64; N_FIELD] {
        &self.waves[index]
    }

    /// The displacement of a point of the scan towards the camera, mm.
    pub(super) fn displacement(&self, index: usize, towards: &Vector3<f64>, amplitudes_mm: &[f64]) -> Vector3<f64> {
        towards * self.waves[index].iter().zip(amplitudes_mm).map(|(wave, amplitude)| wave * amplitude).sum::<f64>()
    }
}
