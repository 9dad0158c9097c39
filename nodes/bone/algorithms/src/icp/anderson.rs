//! Anderson acceleration of a fixed-point iteration on rigid motions.

use nalgebra::{Matrix5, SMatrix, Vector5, Vector6};

/// Longest history.
const MAX_DEPTH: usize = 5;

/// Tikhonov term of the history's normal matrix, as a share of the mean square of its columns: it keeps rounding from
/// deciding between nearly equal differences of steps.
const REGULARISATION: f64 = 1e-10;

/// The last few points `x` of an iteration and the images `g(x)` under its plain step.
///
/// Source: Walker and Ni 2011, type II; Zhang, Yao and Deng 2021 for its use in ICP.
pub(super) struct Anderson {
    depth: usize,
    /// Oldest first: `(g, f = g - x)`.
    history: Vec<(Vector6<f64>, Vector6<f64>)>,
}

impl Anderson {
    pub(super) fn new(depth: u32) -> Self {
        Self { depth: (depth as usize).min(MAX_DEPTH), history: Vec::new() }
    }

    /// The fixed point extrapolated from the history and the newest `x -> g`; `g` itself without a history.
    pub(super) fn next(&mut self, x: Vector6<f64>, g: Vector6<f64>) -> Vector6<f64> {
        let f = g - x;
        self.history.push((g, f));
        if self.history.len() > self.depth + 1 {
            self.history.remove(0);
        }
        let columns = self.history.len() - 1;
        if columns == 0 {
            return g;
        }
        // Unused columns stay zero and get a zero coefficient.
        let mut df = SMatrix::<f64, 6, 5>::zeros();
        let mut dg = SMatrix::<f64, 6, 5>::zeros();
        for (k, pair) in self.history.windows(2).enumerate() {
            dg.set_column(k, &(pair[1].0 - pair[0].0));
            df.set_column(k, &(pair[1].1 - pair[0].1));
        }
        let normal: Matrix5<f64> = df.tr_mul(&df);
        let scale = normal.trace() / columns as f64;
        let damped = normal + Matrix5::identity() * (scale * REGULARISATION).max(f64::MIN_POSITIVE);
        let Some(cholesky) = damped.cholesky() else { return g };
        let coefficients: Vector5<f64> = cholesky.solve(&df.tr_mul(&f));
        let next = g - dg * coefficients;
        if next.iter().all(|c| c.is_finite()) { next } else { g }
    }
}
