//! The errors that are there in every scan: of the camera's depth, and of the surface's segmentation.

use super::cause::Axes;
use nalgebra::{Point3, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Number of waves along the scan that are alike across it.
const N_EVEN: usize = 14;

/// Number of waves along the scan that are opposite on its two sides.
const N_ODD: usize = 10;

/// Number of waves.
const N_WAVES: usize = N_EVEN + N_ODD;

/// Number of amplitudes: of the waves, and of the offset.
pub(super) const N_FIELD: usize = N_WAVES + 1;

/// The amplitude of the longest wave.
pub(super) const LONGEST: usize = 0;

/// The amplitude of the offset.
pub(super) const OFFSET: usize = N_WAVES;

/// Half waves of the first over the scan: fewer look as a shift and a tilt.
const FIRST: usize = 2;

/// Displacements towards the camera that vary along the scan, as 2, 3, ... 15 half waves, and an offset along the surface's normal. A shaft is
/// too narrow to show how the waves vary across it.
///
/// Without them each such error is explained by the cause that is most like it: a smooth error of the camera by a step, the segmentation's
/// threshold by a growth.
pub(super) struct Field {
    /// The waves' values at the points of the scan.
    waves: Vec<[f64; N_WAVES]>,
    /// Prior standard deviations of the amplitudes, mm.
    pub(super) sds_mm: [f64; N_FIELD],
}

impl Field {
    /// The field at the points of a scan, whose longest wave and offset have these standard deviations, mm; the other waves have less in
    /// proportion to their lengths.
    pub(super) fn new(axes: &Axes, points: &[Point3<f64>], longest_mm: f64, offset_mm: f64) -> Self {
        let mut across_mm: Vec<f64> = points.iter().map(|p| (p - axes.centre).dot(&axes.sideways).abs()).collect();
        across_mm.sort_by(f64::total_cmp);
        let half_mm = across_mm[(across_mm.len() - 1) * 98 / 100].max(1.0);
        let half_waves = |k: usize| (FIRST + if k < N_EVEN { k } else { k - N_EVEN }) as f64;
        let waves = |p: &Point3<f64>| {
            let phase = FRAC_PI_2 * (axes.along_share(p).clamp(-1.0, 1.0) + 1.0);
            let across = ((p - axes.centre).dot(&axes.sideways) / half_mm).clamp(-1.0, 1.0);
            std::array::from_fn(|k| (half_waves(k) * phase).cos() * if k < N_EVEN { 1.0 } else { across })
        };
        let sd_mm = |k: usize| if k == OFFSET { offset_mm } else { longest_mm * FIRST as f64 / half_waves(k) };
        Self { waves: points.iter().map(waves).collect(), sds_mm: std::array::from_fn(sd_mm) }
    }

    /// The same at every `every`-th point.
    pub(super) fn thinned(&self, every: usize) -> Self {
        Self { waves: self.waves.iter().step_by(every).copied().collect(), ..*self }
    }

    /// What each amplitude does at a point of the scan: multiples of the direction towards the camera, and of the normal.
    pub(super) fn at(&self, index: usize, towards: f64, normal: f64) -> [f64; N_FIELD] {
        std::array::from_fn(|k| if k == OFFSET { normal } else { towards * self.waves[index][k] })
    }

    /// The displacement of a point of the scan, mm.
    pub(super) fn displacement(
        &self,
        index: usize,
        towards: &Vector3<f64>,
        normal: &Vector3<f64>,
        amplitudes_mm: &[f64; N_FIELD],
    ) -> Vector3<f64> {
        let waves: f64 = self.waves[index].iter().zip(amplitudes_mm).map(|(wave, amplitude)| wave * amplitude).sum();
        towards * waves + normal * amplitudes_mm[OFFSET]
    }
}
