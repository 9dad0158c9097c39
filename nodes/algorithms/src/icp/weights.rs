//! How much a pair counts.

use super::params::{IcpParams, Kernel};

/// Of a Gaussian's absolute values a quarter lies below this many standard deviations.
const QUARTER_SIGMAS: f64 = 0.318_639_363_964_375_15;

/// Steps shorter than this share of the spread do not change it.
const SETTLED: f64 = 0.1;

/// The gate on the way keeps this share of all points at full weight.
const BETTER_HALF: f64 = 0.45;

/// Of a Gaussian's absolute values that share lies below this many standard deviations.
const BETTER_HALF_SIGMAS: f64 = 0.597_760_126_042_478;

/// On the way partners are those of a thinned target or of few points, and rougher by this factor than the noise.
const ON_THE_WAY: f64 = 1.5;

/// On the way full weight reaches to this share of the gate, from where it falls.
const FLAT: f64 = 2.0 / 3.0;

/// On the last level it reaches farther: where noise alone meets the fall, a pose that little holds has several places of
/// rest.
const FLAT_AT_LAST: f64 = 0.85;

/// The last level looks for partners beyond the gate that the spread so far gives by this factor: it may find more.
const WIDER: f64 = 2.0;

/// At most so many residuals are asked for a spread, evenly along the curve: it then errs by a hundredth.
const ASKED: usize = 5000;

/// Residuals within so many spreads are taken for the bone's when the spread is taken again.
const INNER_SIGMAS: f64 = 4.0;

/// And so often at most.
const ROUNDS: u32 = 5;

/// Of a Gaussian's absolute values half lie below this many standard deviations.
const MEDIAN_SIGMAS: f64 = 0.674_489_750_196_081_7;

/// Constants of the kernels, in standard deviations, at which they are 95 % as efficient as least squares on Gaussian
/// noise. Source: Holland and Welsch 1977.
const HUBER: f64 = 1.345;
const TUKEY: f64 = 4.685;
const WELSCH: f64 = 2.985;

/// The weight of a pair by its squared residual: a reach that shrinks as the pose gets better, and a kernel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Weights {
    kernel: Kernel,
    /// The spread of the residuals, mm; infinite until known.
    scale_mm: f64,
    /// No residual beyond counts, mm; full weight up to a share of it.
    gate_mm: f64,
    /// No pair farther apart is looked for, mm.
    pub(super) reach_mm: f64,
    /// Squared residuals above this are trimmed, mm².
    pub(super) worst_square: f64,
    last: bool,
}

impl Weights {
    /// Every pair no farther than `reach_mm` counts fully.
    pub(super) fn open(params: &IcpParams, reach_mm: f64) -> Self {
        Self {
            kernel: params.kernel,
            scale_mm: f64::INFINITY,
            gate_mm: f64::INFINITY,
            last: false,
            reach_mm,
            worst_square: f64::INFINITY,
        }
    }

    /// The same for the last level: the spread is to be learnt anew from all points, and the gate is as wide as asked for.
    pub(super) fn for_last(self, params: &IcpParams, slack_mm: f64) -> Self {
        // Infinite where no level came before.
        let reach_mm = params.gate_sigmas * WIDER * self.scale_mm + slack_mm;
        let gated = params.gate_sigmas > 0.0 && reach_mm < params.max_pair_distance_mm;
        Self { last: true, ..Self::open(params, if gated { reach_mm } else { params.max_pair_distance_mm }) }
    }

    /// Narrows to what the squared residuals of all source points tell, infinite for those without a partner; never
    /// widens, so that weights cannot swing to and fro.
    ///
    /// On the way the gate lies just beyond the better half of the points: with up to half of them off the bone, these
    /// still lie on it. On the last level the spread is first taken from the better quarter, then from all points
    /// within the gate until both agree.
    pub(super) fn shrink(&mut self, squares: &[f64], params: &IcpParams, slack_mm: f64) {
        if (params.gate_sigmas == 0.0 && self.kernel == Kernel::None) || squares.is_empty() {
            return;
        }
        let mut some: Vec<f64> = squares.iter().copied().step_by(squares.len().div_ceil(ASKED)).collect();
        let squares = &mut some[..];
        let (scale_mm, gate_mm) = match self.last {
            true => {
                let scale_mm = spread_mm(squares, params);
                (scale_mm, params.gate_sigmas * scale_mm)
            }
            false => {
                let half_mm = quantile(squares, BETTER_HALF);
                (
                    (half_mm / BETTER_HALF_SIGMAS).max(ON_THE_WAY * params.noise_mm),
                    (half_mm / FLAT).max(params.gate_sigmas * ON_THE_WAY * params.noise_mm),
                )
            }
        };
        self.scale_mm = self.scale_mm.min(scale_mm);
        if params.gate_sigmas > 0.0 && gate_mm < self.gate_mm {
            self.gate_mm = gate_mm;
            self.reach_mm = self.reach_mm.min(self.gate_mm + slack_mm);
        }
    }

    /// Full weight up to here, mm.
    #[inline]
    fn flat_mm(&self) -> f64 {
        self.gate_mm * if self.last { FLAT_AT_LAST } else { FLAT }
    }

    /// Whether residuals would hardly narrow these weights any more after a step of this length.
    pub(super) fn settled(&self, params: &IcpParams, step_mm: f64) -> bool {
        let by_scale = params.gate_sigmas > 0.0 || self.kernel != Kernel::None;
        !by_scale || self.scale_mm <= params.noise_mm || step_mm < SETTLED * self.scale_mm
    }

    /// The weight of a squared residual, and what it adds to the cost: a least-squares term where the weight is 1.
    #[inline]
    pub(super) fn of(&self, square: f64) -> (f64, f64) {
        if square > self.worst_square {
            return (0.0, self.worst_square);
        }
        let flat = self.flat_mm();
        if self.kernel == Kernel::None && square <= flat * flat {
            return (1.0, square);
        }
        self.falling(square, flat)
    }

    #[inline(never)]
    fn falling(&self, square: f64, flat: f64) -> (f64, f64) {
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
                let rest = 1.0 - (square / (c * c)).min(1.0);
                (rest * rest, c * c / 3.0 * (1.0 - rest.powi(3)))
            }
            Kernel::Welsch => {
                let c = WELSCH * self.scale_mm;
                let rest = (-square / (c * c)).exp();
                (rest, c * c * (1.0 - rest))
            }
        }
    }

    /// What a source point without a partner costs, mm².
    pub(super) fn unpaired(&self) -> f64 {
        self.falling(self.reach_mm * self.reach_mm, self.flat_mm()).1
    }
}

/// The spread of the residuals as of a Gaussian's, mm, not below the noise.
fn spread_mm(squares: &mut [f64], params: &IcpParams) -> f64 {
    let mut scale_mm = (quantile(squares, 0.25) / QUARTER_SIGMAS).max(params.noise_mm);
    for _ in 0..ROUNDS {
        let inner = INNER_SIGMAS * scale_mm;
        let mut near: Vec<f64> = squares.iter().copied().filter(|s| *s < inner * inner).collect();
        if near.is_empty() {
            break;
        }
        let narrower = (quantile(&mut near, 0.5) / MEDIAN_SIGMAS).max(params.noise_mm);
        if narrower >= scale_mm {
            break;
        }
        scale_mm = narrower;
    }
    scale_mm
}

/// The root of the squared residual that this share of all lies below, mm.
fn quantile(squares: &mut [f64], share: f64) -> f64 {
    let k = ((squares.len() as f64 * share) as usize).min(squares.len() - 1);
    squares.select_nth_unstable_by(k, f64::total_cmp).1.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_points_far_off_do_not_widen_the_reach() {
        let squares: Vec<f64> =
            (0..1000).map(|k| if k % 2 == 0 { 100.0 } else { (f64::from(k) / 5000.0).powi(2) }).collect();
        let params = IcpParams { noise_mm: 0.01, ..IcpParams::default() };
        let weights = Weights::open(&params, 20.0);
        let mut weights = weights.for_last(&params, 0.0);
        weights.shrink(&squares, &params, 0.0);
        // Uniform up to 0.2 mm: the median of those on the bone is 0.1 mm.
        assert!((weights.scale_mm - 0.1 / MEDIAN_SIGMAS).abs() < 0.002, "{weights:?}");
        assert_eq!(weights.of(100.0).0, 0.0);
        assert_eq!(weights.of(0.2 * 0.2), (1.0, 0.2 * 0.2));
        let before = weights;
        weights.shrink(&[50.0; 100], &params, 0.0);
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
            weights.shrink(&[0.0; 8], &params, 1.0);
            let (mut sum, step) = (0.0, 1e-4);
            for k in 0..20_000 {
                let r = (f64::from(k) + 0.5) * step;
                sum += 2.0 * weights.of(r * r).0 * r * step;
                let end = (f64::from(k) + 1.0) * step;
                let cost = weights.of(end * end).1;
                assert!((cost - sum).abs() < 1e-5, "{kernel:?} at {end}: {cost} but {sum}");
            }
        }
    }
}
