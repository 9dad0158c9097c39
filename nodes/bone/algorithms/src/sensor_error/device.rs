//! What several scans have in common: the device.

use super::scan::{Estimate, ScanErrors, Stretch};
use crate::median::median;
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// Probability below either end of an interval: 90 %.
const TAIL: f64 = 0.05;
/// Fewer scans than this say little of each other, and stretches of them are compared instead.
const MIN_SCANS: usize = 3;
/// Upper ends of the classes of tilt, degrees; number of classes of distance.
const TILTS_DEG: [f64; 5] = [15.0, 30.0, 45.0, 60.0, 90.0];
const N_DISTANCES: usize = 4;
/// Fewest places of a class.
const MIN_PLACES: usize = 20;

/// A number with the ends of its 90 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Told {
    /// The number.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Told {
    /// The mean of independent values, by Student's t.
    fn mean(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let value = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - value).powi(2)).sum::<f64>() / (n - 1.0);
        let reach = t(n) * (variance / n).sqrt();
        Self { value, low: value - reach, high: value + reach }
    }

    fn map(self, of: impl Fn(f64) -> f64) -> Self {
        Self { value: of(self.value), low: of(self.low), high: of(self.high) }
    }

    /// Whether the interval holds a number.
    pub fn holds(&self, number: f64) -> bool {
        (self.low..=self.high).contains(&number)
    }
}

/// Noise in a class of distance or tilt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TableRow {
    /// The class, mm or degrees.
    pub from: f64,
    /// Its upper end.
    pub to: f64,
    /// Noise, mm.
    pub noise_mm: f64,
    /// Number of places.
    pub n: usize,
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
    /// Standard deviation, from scan to scan, of the error that a scan shares along the normal, where the part shows it.
    pub bias_mm: Option<Told>,
    /// Its mean, positive outward.
    pub mean_bias_mm: Option<Told>,
    /// Size of the scans over that of the part.
    pub scale: Option<Told>,
    /// Share of points off by more.
    pub outliers: Told,
    /// Shares of the outliers and of the other points that lie near the border of their scan.
    pub near_border: [f64; 2],
    /// Noise over the distance to the sensor, mm; without classes where it is unknown where that stood.
    pub by_distance: Vec<TableRow>,
    /// Noise over the tilt of the surface to the line of sight, degrees.
    pub by_tilt: Vec<TableRow>,
}

impl SensorErrors {
    /// The errors that at least two scans have in common; `None` of fewer.
    ///
    /// # Source
    /// Offset and scale: random effects, the variance by Paule and Mandel 1982 with the interval of Viechtbauer 2007, the mean with that of
    /// Hartung and Knapp 2001. Noise, patches and outliers: Student's t over the scans.
    pub fn of(scans: &[ScanErrors]) -> Option<Self> {
        let n = scans.len() as f64;
        let (by, units): (_, Vec<Stretch>) = match scans.len() {
            0 | 1 => return None,
            k if k < MIN_SCANS => ("stretches of scans", scans.iter().flat_map(ScanErrors::stretches).collect()),
            _ => ("scans", scans.iter().map(|scan| scan.stretch(|_| true)).collect()),
        };
        let over = |of: fn(&Stretch) -> f64| Told::mean(&units.iter().map(of).collect::<Vec<_>>());
        let root = |square: f64| square.max(0.0).sqrt();
        let all = |of: fn(&ScanErrors) -> Option<Estimate>| scans.iter().map(of).collect::<Option<Vec<_>>>();
        let bias = all(|scan| scan.bias).map(|of| random_effects(&of));
        let noise: Vec<_> = scans.iter().flat_map(|scan| &scan.noise).filter(|at| at.tilt_deg.is_finite()).collect();
        let mut distances: Vec<f64> = noise.iter().map(|at| at.distance_mm).collect();
        distances.sort_by(f64::total_cmp);
        let cut = |k: usize| distances.get((k * distances.len() / N_DISTANCES).min(distances.len().saturating_sub(1)));
        let classes = |ends: Vec<f64>, of: fn(&super::scan::NoiseAt) -> f64| -> Vec<TableRow> {
            let row = |ends: &[f64]| {
                let is_in = |at: &f64| *at >= ends[0] && *at < ends[1];
                let mut squares: Vec<f64> = noise.iter().filter(|at| is_in(&of(at))).map(|at| at.square).collect();
                let (from, to, n) = (ends[0], ends[1], squares.len());
                (n >= MIN_PLACES).then(|| TableRow { from, to, noise_mm: median(&mut squares).sqrt(), n })
            };
            ends.windows(2).filter_map(row).collect()
        };
        Some(Self {
            n_scans: scans.len(),
            by,
            noise_mm: over(|of| of.noise).map(root),
            patch_mm: over(|of| of.level).map(root),
            length_mm: scans.iter().map(|scan| scan.error.length_mm).sum::<f64>() / n,
            bias_mm: bias.map(|(_, sd)| sd),
            mean_bias_mm: bias.map(|(mean, _)| mean),
            scale: all(|scan| scan.scale).map(|of| random_effects(&of).0.map(|scale| 1.0 + scale)),
            outliers: over(|of| of.outliers).map(|share| share.max(0.0)),
            near_border: [0, 1].map(|k| scans.iter().map(|scan| scan.near_border[k]).sum::<f64>() / n),
            by_distance: classes((0..=N_DISTANCES).filter_map(cut).copied().collect(), |at| at.distance_mm),
            by_tilt: classes([&[0.0], &TILTS_DEG[..]].concat(), |at| at.tilt_deg),
        })
    }
}

fn t(n: f64) -> f64 {
    StudentsT::new(0.0, 1.0, n - 1.0).map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - TAIL))
}

/// Mean and standard deviation of what estimates scatter about beyond their own standard deviations.
fn random_effects(of: &[Estimate]) -> (Told, Told) {
    let n = of.len() as f64;
    let weight = |one: &Estimate, sd: f64| 1.0 / (one.sd * one.sd + sd * sd).max(1e-18);
    let mean = |sd: f64| {
        of.iter().map(|one| weight(one, sd) * one.value).sum::<f64>()
            / of.iter().map(|one| weight(one, sd)).sum::<f64>()
    };
    // It falls as the standard deviation rises.
    let q = |sd: f64| of.iter().map(|one| weight(one, sd) * (one.value - mean(sd)).powi(2)).sum::<f64>();
    let sd_of = |expected: f64| {
        let (mut low, mut high) = (0.0, 1e4 * of.iter().map(|one| one.value.abs()).fold(1e-9, f64::max));
        for _ in 0..100 {
            let middle: f64 = (low + high) / 2.0;
            if q(middle) > expected { low = middle } else { high = middle }
        }
        low
    };
    let chi = |share: f64| ChiSquared::new(n - 1.0).map_or(n - 1.0, |chi| chi.inverse_cdf(share));
    let sd = Told { value: sd_of(n - 1.0), low: sd_of(chi(1.0 - TAIL)), high: sd_of(chi(TAIL)) };
    let weights = of.iter().map(|one| weight(one, sd.value)).sum::<f64>();
    let reach = t(n) * ((q(sd.value) / (n - 1.0)).max(1.0) / weights).sqrt();
    let value = mean(sd.value);
    (Told { value, low: value - reach, high: value + reach }, sd)
}
