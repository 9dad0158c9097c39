//! What several scans have in common: the device.

use super::ScanErrors;
use crate::median::median;
use crate::trust::{Residual, SurfaceError};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// Probability below either end of an interval: 90 %.
const TAIL: f64 = 0.05;
/// Fewer scans than this are too few for a standard deviation; then stretches of each scan are compared, as many as the second number.
const MIN_SCANS: usize = 3;
const N_STRETCHES: usize = 6;
/// Number of classes of distance; ends of the classes of tilt, degrees; fewest places of a class.
const N_DISTANCES: usize = 4;
const TILTS_DEG: [f64; 6] = [0.0, 15.0, 30.0, 45.0, 60.0, 90.0];
const MIN_PLACES: usize = 20;

/// A number with the ends of its 90 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[allow(missing_docs, reason = "their names say it")]
pub struct Told {
    pub value: f64,
    pub low: f64,
    pub high: f64,
}

impl Told {
    /// The mean of independent values, by Student's t.
    fn mean(values: Vec<f64>) -> Self {
        let n = values.len() as f64;
        let value = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - value).powi(2)).sum::<f64>() / (n - 1.0);
        let reach = t(n) * (variance / n).sqrt();
        Self { value, low: (value - reach).max(0.0), high: value + reach }
    }

    fn map(self, of: impl Fn(f64) -> f64) -> Self {
        Self { value: of(self.value), low: of(self.low), high: of(self.high) }
    }

    /// Whether the interval holds a number.
    pub fn holds(&self, number: f64) -> bool {
        (self.low..=self.high).contains(&number)
    }
}

/// How a sensor errs, each number with its 90 % interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorErrors {
    /// Number of scans.
    pub n_scans: usize,
    /// What the intervals of noise, patches and outliers are by: scans, or stretches of too few of them.
    pub by: &'static str,
    /// Error of single points.
    pub noise_mm: Told,
    /// Error that neighbours share.
    pub patch_mm: Told,
    /// Distance over which it falls to 37 %.
    pub length_mm: f64,
    /// Standard deviation, from scan to scan, of what a scan shares along the normal, where the part holds it.
    pub bias_mm: Option<Told>,
    /// Its mean, positive outward.
    pub mean_bias_mm: Option<Told>,
    /// Size of the scans over that of the part.
    pub scale: Option<Told>,
    /// Share of points off by more.
    pub outliers: Told,
    /// Shares of the outliers and of the other points that lie near the border of their scan.
    pub near_border: [f64; 2],
    /// Noise in classes of the distance to the sensor: from, to, noise, mm; none if it is unknown where that stood.
    pub by_distance: Vec<[f64; 3]>,
    /// In classes of the tilt of the surface to the line of sight, degrees.
    pub by_tilt: Vec<[f64; 3]>,
}

impl SensorErrors {
    /// The errors that two or more scans have in common; `None` of fewer.
    ///
    /// # Source
    /// Offset and scale: random effects, the variance by Paule and Mandel 1982 with the interval of Viechtbauer 2007, the mean with that of
    /// Hartung and Knapp 2001. Noise, patches and outliers: Student's t.
    pub fn of(scans: &[ScanErrors]) -> Option<Self> {
        let n = scans.len();
        let (by, n_stretches) = if n < MIN_SCANS { ("stretches of scans", N_STRETCHES) } else { ("scans", 1) };
        let units = scans.iter().flat_map(|scan| (0..n_stretches).map(move |k| stretch(scan, k, n_stretches)));
        let units: Vec<[f64; 3]> = units.collect();
        let over = |k: usize| Told::mean(units.iter().map(|unit| unit[k]).collect());
        let all = |of: fn(&ScanErrors) -> Option<[f64; 2]>| scans.iter().map(of).collect::<Option<Vec<_>>>();
        let mean = |of: &dyn Fn(&ScanErrors) -> f64| scans.iter().map(of).sum::<f64>() / n as f64;
        let bias = all(|scan| scan.bias).filter(|_| n > 1).map(|of| random_effects(&of));
        let noise: Vec<[f64; 4]> =
            scans.iter().flat_map(|scan| &scan.noise).filter(|at| at[3].is_finite()).copied().collect();
        let mut distances: Vec<f64> = noise.iter().map(|at| at[2]).collect();
        distances.sort_by(f64::total_cmp);
        let cut = |k: usize| distances.get(k * distances.len().saturating_sub(1) / N_DISTANCES).copied();
        let classes = |ends: &[f64], of: usize| -> Vec<[f64; 3]> {
            let class = |ends: &[f64]| {
                let is_in = |at: &&[f64; 4]| at[of] >= ends[0] && at[of] < ends[1];
                let mut squares: Vec<f64> = noise.iter().filter(is_in).map(|at| at[1]).collect();
                (squares.len() >= MIN_PLACES).then(|| [ends[0], ends[1], median(&mut squares).sqrt()])
            };
            ends.windows(2).filter_map(class).collect()
        };
        (n > 1).then(|| Self {
            n_scans: n,
            by,
            noise_mm: over(0).map(f64::sqrt),
            patch_mm: over(1).map(f64::sqrt),
            length_mm: mean(&|scan| scan.length_mm),
            bias_mm: bias.map(|(_, sd)| sd),
            mean_bias_mm: bias.map(|(mean, _)| mean),
            scale: all(|scan| scan.scale).map(|of| random_effects(&of).0.map(|scale| 1.0 + scale)),
            outliers: over(2),
            near_border: [0, 1].map(|k| mean(&|scan| scan.near_border[k])),
            by_distance: classes(&(0..=N_DISTANCES).filter_map(cut).collect::<Vec<_>>(), 2),
            by_tilt: classes(&TILTS_DEG, 3),
        })
    }
}

/// Squares of noise and level, mm², and the share of outliers, of one of so many stretches of a scan.
fn stretch(scan: &ScanErrors, k: usize, of: usize) -> [f64; 3] {
    let residuals = &scan.residuals[k * scan.residuals.len() / of..(k + 1) * scan.residuals.len() / of];
    let noise = &scan.noise[k * scan.noise.len() / of..(k + 1) * scan.noise.len() / of];
    let on: Vec<Residual> = residuals.iter().filter(|(_, is_off)| !is_off).map(|(at, _)| *at).collect();
    let error = SurfaceError::new(&on);
    let mut squares: Vec<f64> = noise.iter().map(|at| at[1]).collect();
    // Where points are too sparse for patches, what neighbours do not share.
    let noise = if squares.is_empty() { error.noise_mm.powi(2) } else { median(&mut squares) };
    [noise, error.level_mm.powi(2) / scan.left_share, 1.0 - on.len() as f64 / residuals.len().max(1) as f64]
}

fn t(n: f64) -> f64 {
    StudentsT::new(0.0, 1.0, n - 1.0).map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - TAIL))
}

/// Mean and standard deviation of what estimates scatter about beyond their own standard deviations.
fn random_effects(of: &[[f64; 2]]) -> (Told, Told) {
    let n = of.len() as f64;
    let weight = |own: f64, sd: f64| 1.0 / (own * own + sd * sd).max(1e-18);
    let weights = |sd: f64| of.iter().map(|[_, own]| weight(*own, sd)).sum::<f64>();
    let mean = |sd: f64| of.iter().map(|[value, own]| weight(*own, sd) * value).sum::<f64>() / weights(sd);
    // It falls as the standard deviation rises.
    let q = |sd: f64| {
        let mean = mean(sd);
        of.iter().map(|[value, own]| weight(*own, sd) * (value - mean).powi(2)).sum::<f64>()
    };
    let sd_of = |expected: f64| {
        let (mut low, mut high) = (0.0, 1e4 * of.iter().map(|[value, _]| value.abs()).fold(1e-9, f64::max));
        for _ in 0..100 {
            let middle: f64 = (low + high) / 2.0;
            *(if q(middle) > expected { &mut low } else { &mut high }) = middle;
        }
        low
    };
    let chi = |share: f64| ChiSquared::new(n - 1.0).map_or(n - 1.0, |chi| chi.inverse_cdf(share));
    let sd = Told { value: sd_of(n - 1.0), low: sd_of(chi(1.0 - TAIL)), high: sd_of(chi(TAIL)) };
    let (value, reach) = (mean(sd.value), t(n) * ((q(sd.value) / (n - 1.0)).max(1.0) / weights(sd.value)).sqrt());
    (Told { value, low: value - reach, high: value + reach }, sd)
}
