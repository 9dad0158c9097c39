//! How much a pair counts.

use super::params::{IcpParams, Kernel};

/// Of a Gaussian's absolute values a quarter lies below this many standard deviations.
const QUARTER_SIGMAS: f64 = 0.318_639_363_964_375_15;

/// Steps shorter than this share of the spread do not change it.
const SETTLED: f64 = 0.1;

/// On the way, the gate lies at this share of where it lies at the end: what is off must be left out before the pose is
/// right, and a few good pairs more or less do not matter yet.
const EARLY: f64 = 0.5;

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
    /// No residual beyond counts, mm; full weight up to half of it.
    gate_mm: f64,
    /// No pair farther apart is looked for, mm.
    pub(super) reach_mm: f64,
    /// Squared residuals above this are trimmed, mm².
    pub(super) worst_square: f64,
    /// Where the gate lies, in spreads.
    gate_sigmas: f64,
}

impl Weights {
    /// Every pair no farther than `reach_mm` counts fully.
    pub(super) fn open(params: &IcpParams, reach_mm: f64) -> Self {
        Self {
            kernel: params.kernel,
            scale_mm: f64::INFINITY,
            gate_mm: f64::INFINITY,
            gate_sigmas: params.gate_sigmas * EARLY,
            reach_mm,
            worst_square: f64::INFINITY,
        }
    }

    /// The same for the last level: the spread is to be learnt anew from all points, and the gate is as wide as asked for.
    pub(super) fn for_last(self, params: &IcpParams) -> Self {
        let reach_mm = (self.reach_mm / EARLY).min(params.max_pair_distance_mm);
        Self { gate_sigmas: params.gate_sigmas, ..Self::open(params, reach_mm) }
    }

    /// Shrinks to what the squared residuals of all source points tell, infinite for those without a partner; never
    /// widens, so that weights cannot swing to and fro.
    ///
    /// The spread is taken from the quarter of the points that fit best: with up to half of them off the bone these still
    /// lie on it, where the median would not.
    pub(super) fn shrink(&mut self, squares: &mut [f64], params: &IcpParams, slack_mm: f64) {
        if (params.gate_sigmas == 0.0 && self.kernel == Kernel::None) || squares.is_empty() {
            return;
        }
        let quarter = squares.len() / 4;
        let square = *squares.select_nth_unstable_by(quarter, f64::total_cmp).1;
        let scale_mm = (square.sqrt() / QUARTER_SIGMAS).max(params.noise_mm);
        if scale_mm < self.scale_mm {
            self.scale_mm = scale_mm;
            if self.gate_sigmas > 0.0 {
                self.gate_mm = (self.gate_sigmas * scale_mm).max(params.gate_sigmas * params.noise_mm);
                self.reach_mm = self.reach_mm.min(self.gate_mm + slack_mm);
            }
        }
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
        let half = self.gate_mm / 2.0;
        if self.kernel == Kernel::None && square <= half * half {
            return (1.0, square);
        }
        self.falling(square, half)
    }

    #[inline(never)]
    fn falling(&self, square: f64, half: f64) -> (f64, f64) {
        let residual = square.sqrt();
        let (by_kernel, cost) = self.by_kernel(square, residual);
        if residual <= half {
            return (by_kernel, cost);
        }
        let u = ((residual - half) / half).min(1.0);
        let by_gate = (1.0 - u * u) * (1.0 - u * u);
        // The integral of 2 w(r) r.
        let beyond = u + u * u / 2.0 - 2.0 / 3.0 * u.powi(3) - u.powi(4) / 2.0 + u.powi(5) / 5.0 + u.powi(6) / 6.0;
        let gated = half * half * (1.0 + 2.0 * beyond);
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
        let reach = self.reach_mm * self.reach_mm;
        if self.kernel == Kernel::None && !self.gate_mm.is_finite() {
            reach
        } else {
            self.falling(reach.min(1e300), self.gate_mm / 2.0).1
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_points_far_off_do_not_widen_the_reach() {
        let mut squares: Vec<f64> =
            (0..1000).map(|k| if k % 2 == 0 { 100.0 } else { (f64::from(k) / 5000.0).powi(2) }).collect();
        let params = IcpParams { noise_mm: 0.01, ..IcpParams::default() };
        let weights = Weights::open(&params, 20.0);
        let mut weights = weights.for_last(&params);
        weights.shrink(&mut squares, &params, 0.0);
        // Uniform up to 0.2 mm: the quarter of all is the median of those on the bone, 0.1 mm.
        assert!((weights.scale_mm - 0.1 / QUARTER_SIGMAS).abs() < 0.002, "{weights:?}");
        assert_eq!(weights.of(100.0).0, 0.0);
        assert_eq!(weights.of(0.2 * 0.2), (1.0, 0.2 * 0.2));
        let before = weights;
        weights.shrink(&mut [50.0; 100], &params, 0.0);
        assert_eq!(weights, before, "never wider");
    }

    #[test]
    fn every_cost_is_the_integral_of_its_weight() {
        for kernel in [Kernel::None, Kernel::Huber, Kernel::Tukey, Kernel::Welsch] {
            let params = IcpParams {
                kernel,
                gate_sigmas: if kernel == Kernel::None { 8.0 } else { 0.0 },
                ..IcpParams::default()
            };
            let mut weights = Weights::open(&params, 50.0);
            weights.shrink(&mut [0.0; 8], &params, 1.0);
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
