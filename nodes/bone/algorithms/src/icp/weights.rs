//! Robust weights: a gate, a kernel and trimming.

use super::params::{IcpParams, Kernel};

/// A quarter of a Gaussian's absolute values are below this many standard deviations.
const QUARTER_SIGMAS: f64 = 0.318_639_363_964_375_15;

/// Steps shorter than this share of the scale do not change it.
const SETTLED: f64 = 0.1;

/// Share of all points that keeps full weight on a level before the last.
const BETTER_HALF: f64 = 0.45;

/// That share of a Gaussian's absolute values is below this many standard deviations.
const BETTER_HALF_SIGMAS: f64 = 0.597_760_126_042_478;

/// Factor on the noise before the last level, where the target is thinned or the source is sparse.
const SPARSE_NOISE: f64 = 1.5;

/// Share of the gate with full weight before the last level; the weight falls from there to the gate.
const FLAT: f64 = 2.0 / 3.0;

/// Share of the gate with full weight on the last level. Larger than [`FLAT`]: where noise alone reaches the falling part, an
/// ill-conditioned pose has several stationary points.
const FLAT_AT_LAST: f64 = 0.85;

/// The last level searches beyond the gate of the scale so far by this factor, as its scale may be larger.
const SEARCH_MARGIN: f64 = 2.0;

/// Most residuals used to estimate a scale, evenly along the curve: its standard error is then 1 %.
const MAX_SAMPLED: usize = 5000;

/// Residuals within this many scales are taken for inliers when the scale is refined.
const INNER_SIGMAS: f64 = 4.0;

/// Most refinements of a scale.
const MAX_REFINEMENTS: u32 = 5;

/// Weight, before the last level, of a point outside the surface: the scan settles on its inner side, which is bone where
/// tissue covers the rest. On a bare bone it then lies about the noise too deep, which the last level corrects.
const OUTSIDE_WEIGHT: f64 = 0.05;

/// The gate for points outside the surface on the last level, in standard deviations: closer than on the inside, where
/// nothing but noise and the error of the surface can lie.
const OUTSIDE_SIGMAS: f64 = 2.5;

/// Half of a Gaussian's absolute values are below this many standard deviations.
const MEDIAN_SIGMAS: f64 = 0.674_489_750_196_081_7;

/// Tuning constants of the kernels, in standard deviations, for an efficiency of 95 % on Gaussian noise. Source: Holland and
/// Welsch 1977.
const HUBER: f64 = 1.345;
const TUKEY: f64 = 4.685;
const WELSCH: f64 = 2.985;

/// The weight of a pair by its squared residual. Gate and scale only ever narrow within a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Weights {
    kernel: Kernel,
    /// Robust standard deviation of the inliers' residuals, mm; infinite until estimated.
    scale_mm: f64,
    /// Residuals beyond have no weight, mm.
    gate_mm: f64,
    /// Correspondences are searched within this distance, mm.
    pub(super) search_radius_mm: f64,
    /// Squared residuals above this are trimmed, mm².
    pub(super) trim_square: f64,
    is_last: bool,
}

impl Weights {
    /// Full weight for every pair within `search_radius_mm`.
    pub(super) fn open(params: &IcpParams, search_radius_mm: f64) -> Self {
        Self {
            kernel: params.kernel,
            scale_mm: f64::INFINITY,
            gate_mm: f64::INFINITY,
            is_last: false,
            search_radius_mm,
            trim_square: f64::INFINITY,
        }
    }

    /// Open weights for the last level, which estimates its scale anew from all points; the scale so far only limits the
    /// search radius.
    pub(super) fn for_last(self, params: &IcpParams, slack_mm: f64) -> Self {
        // Infinite if there was no level before.
        let radius_mm = params.gate_sigmas * SEARCH_MARGIN * self.scale_mm + slack_mm;
        let gated = params.gate_sigmas > 0.0 && radius_mm < params.max_pair_distance_mm;
        Self { is_last: true, ..Self::open(params, if gated { radius_mm } else { params.max_pair_distance_mm }) }
    }

    /// Narrows scale and gate to the squared residuals of all source points, infinite for those without a pair. Never
    /// widens, so that weights cannot oscillate.
    ///
    /// Before the last level the gate is just beyond the better half of the points, which are bone even if up to half of all
    /// points are not. On the last level the scale starts from the better quarter and is refined over the inliers.
    pub(super) fn narrow(&mut self, squares: &[f64], params: &IcpParams, slack_mm: f64) {
        if (params.gate_sigmas == 0.0 && self.kernel == Kernel::None) || squares.is_empty() {
            return;
        }
        let mut sampled: Vec<f64> = squares.iter().copied().step_by(squares.len().div_ceil(MAX_SAMPLED)).collect();
        let squares = &mut sampled[..];
        let (scale_mm, gate_mm) = match self.is_last {
            true => {
                let scale_mm = robust_scale_mm(squares, params);
                (scale_mm, params.gate_sigmas * scale_mm)
            }
            false => {
                let half_mm = quantile(squares, BETTER_HALF);
                (
                    (half_mm / BETTER_HALF_SIGMAS).max(SPARSE_NOISE * params.noise_mm),
                    (half_mm / FLAT).max(params.gate_sigmas * SPARSE_NOISE * params.noise_mm),
                )
            }
        };
        self.scale_mm = self.scale_mm.min(scale_mm);
        if params.gate_sigmas > 0.0 && gate_mm < self.gate_mm {
            self.gate_mm = gate_mm;
            self.search_radius_mm = self.search_radius_mm.min(self.gate_mm + slack_mm);
        }
    }

    /// Residuals up to this have full weight, mm.
    #[inline]
    fn flat_mm(&self) -> f64 {
        self.gate_mm * if self.is_last { FLAT_AT_LAST } else { FLAT }
    }

    /// Whether a step of this length is too short for its residuals to narrow these weights.
    pub(super) fn is_settled(&self, params: &IcpParams, step_mm: f64) -> bool {
        let by_scale = params.gate_sigmas > 0.0 || self.kernel != Kernel::None;
        !by_scale || self.scale_mm <= params.noise_mm || step_mm < SETTLED * self.scale_mm
    }

    /// The weight of a squared residual, and its robust cost: the squared residual itself where the weight is 1.
    #[inline]
    pub(super) fn weight_and_cost(&self, square: f64) -> (f64, f64) {
        if square > self.trim_square {
            return (0.0, self.trim_square);
        }
        let flat = self.flat_mm();
        if self.kernel == Kernel::None && square <= flat * flat {
            return (1.0, square);
        }
        self.gated(square, flat)
    }

    /// The same of a point outside a surface that tissue may cover. Trimming and kernel are those of any point.
    pub(super) fn outside(&self, square: f64, params: &IcpParams) -> (f64, f64) {
        if !self.is_last {
            let (weight, cost) = self.weight_and_cost(square);
            return (OUTSIDE_WEIGHT * weight, OUTSIDE_WEIGHT * cost);
        }
        let gate_mm = self.gate_mm * (OUTSIDE_SIGMAS / params.gate_sigmas).min(1.0);
        Self { gate_mm, ..*self }.weight_and_cost(square)
    }

    #[inline(never)]
    fn gated(&self, square: f64, flat: f64) -> (f64, f64) {
        let residual = square.sqrt();
        let (by_kernel, cost) = self.by_kernel(square, residual);
        if residual <= flat {
            return (by_kernel, cost);
        }
        let width = self.gate_mm - flat;
        let u = ((residual - flat) / width).min(1.0);
        let by_gate = (1.0 - u * u) * (1.0 - u * u);
        // The integral of 2 w(r) r.
        let (u2, u4) = (u * u, u.powi(4));
        let gated = flat * flat
            + 2.0 * flat * width * u * (1.0 - 2.0 / 3.0 * u2 + u4 / 5.0)
            + width * width * u2 * (1.0 - u2 + u4 / 3.0);
        (by_gate * by_kernel, cost.min(gated))
    }

    fn by_kernel(&self, square: f64, residual: f64) -> (f64, f64) {
        if !self.scale_mm.is_finite() {
            return (1.0, square);
        }
        match self.kernel {
            Kernel::None => (1.0, square),
            Kernel::Huber => {
                let k = HUBER * self.scale_mm;
                if residual <= k { (1.0, square) } else { (k / residual, 2.0 * k * residual - k * k) }
            }
            Kernel::Tukey => {
                let c = TUKEY * self.scale_mm;
                let u = 1.0 - (square / (c * c)).min(1.0);
                (u * u, c * c / 3.0 * (1.0 - u.powi(3)))
            }
            Kernel::Welsch => {
                let c = WELSCH * self.scale_mm;
                let w = (-square / (c * c)).exp();
                (w, c * c * (1.0 - w))
            }
        }
    }

    /// Cost of a source point without a pair, mm².
    pub(super) fn unpaired_cost(&self) -> f64 {
        self.gated(self.search_radius_mm * self.search_radius_mm, self.flat_mm()).1
    }
}

/// Robust standard deviation of the residuals, mm, at least the noise.
fn robust_scale_mm(squares: &mut [f64], params: &IcpParams) -> f64 {
    let mut scale_mm = (quantile(squares, 0.25) / QUARTER_SIGMAS).max(params.noise_mm);
    for _ in 0..MAX_REFINEMENTS {
        let inner = INNER_SIGMAS * scale_mm;
        let mut inliers: Vec<f64> = squares.iter().copied().filter(|s| *s < inner * inner).collect();
        if inliers.is_empty() {
            break;
        }
        let narrower = (quantile(&mut inliers, 0.5) / MEDIAN_SIGMAS).max(params.noise_mm);
        if narrower >= scale_mm {
            break;
        }
        scale_mm = narrower;
    }
    scale_mm
}

/// Square root of a quantile of the squared residuals, mm.
fn quantile(squares: &mut [f64], share: f64) -> f64 {
    let k = ((squares.len() as f64 * share) as usize).min(squares.len() - 1);
    squares.select_nth_unstable_by(k, f64::total_cmp).1.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_points_far_off_do_not_widen_the_gate() {
        let squares: Vec<f64> =
            (0..1000).map(|k| if k % 2 == 0 { 100.0 } else { (f64::from(k) / 5000.0).powi(2) }).collect();
        let params = IcpParams { noise_mm: 0.01, ..IcpParams::default() };
        let weights = Weights::open(&params, 20.0);
        let mut weights = weights.for_last(&params, 0.0);
        weights.narrow(&squares, &params, 0.0);
        // Uniform up to 0.2 mm: the median of those on the bone is 0.1 mm.
        assert!((weights.scale_mm - 0.1 / MEDIAN_SIGMAS).abs() < 0.002, "{weights:?}");
        assert_eq!(weights.weight_and_cost(100.0).0, 0.0);
        assert_eq!(weights.weight_and_cost(0.2 * 0.2), (1.0, 0.2 * 0.2));
        let before = weights;
        weights.narrow(&[50.0; 100], &params, 0.0);
        assert_eq!(weights, before, "never wider");
    }

    #[test]
    fn every_cost_is_the_integral_of_its_weight() {
        for kernel in [Kernel::None, Kernel::Huber, Kernel::Tukey, Kernel::Welsch] {
            let params = IcpParams {
                kernel,
                gate_sigmas: if kernel == Kernel::None { 5.0 } else { 0.0 },
                ..IcpParams::default()
            };
            let mut weights = Weights::open(&params, 50.0);
            weights.narrow(&[0.0; 8], &params, 1.0);
            let (mut sum, step) = (0.0, 1e-4);
            for k in 0..20_000 {
                let r = (f64::from(k) + 0.5) * step;
                sum += 2.0 * weights.weight_and_cost(r * r).0 * r * step;
                let end = (f64::from(k) + 1.0) * step;
                let cost = weights.weight_and_cost(end * end).1;
                assert!((cost - sum).abs() < 1e-5, "{kernel:?} at {end}: {cost} but {sum}");
            }
        }
    }

    #[test]
    fn outside_the_surface_the_gate_is_closer_and_trimming_and_kernel_are_not() {
        for kernel in [Kernel::None, Kernel::Huber, Kernel::Tukey, Kernel::Welsch] {
            let params = IcpParams { kernel, ..IcpParams::default() };
            let mut weights = Weights::open(&params, 50.0).for_last(&params, 0.0);
            weights.narrow(&[0.0; 8], &params, 0.0);
            let square = |sigmas: f64| (sigmas * params.noise_mm).powi(2);
            weights.trim_square = square(3.0);
            for sigmas in [0.5, 1.0, 1.6, 2.1, 3.1] {
                let (outside, inside) =
                    (weights.outside(square(sigmas), &params), weights.weight_and_cost(square(sigmas)));
                assert_eq!(outside, inside, "{kernel:?} at {sigmas} standard deviations");
            }
            assert_eq!(weights.outside(square(2.6), &params).0, 0.0, "{kernel:?}");
            assert!(weights.weight_and_cost(square(2.6)).0 > 0.0, "{kernel:?}");
        }
    }
}
