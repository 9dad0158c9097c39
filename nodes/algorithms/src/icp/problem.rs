//! One registration at one level: everything but the pose.

use super::IcpError;
use super::acceleration::State;
use super::pairing::{Known, Pairing};
use super::params::IcpParams;
use super::report::IcpStep;
use super::residual::{Pair, Residual};
use super::source::Prepared;
use super::sums::Sums;
use super::surface::Surface;
use super::weights::Weights;
use crate::cells::{All, Cells};
use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use std::marker::PhantomData;

/// Points summed by one task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 512;

/// One registration at one level of the source.
pub(super) struct Problem<'a, R> {
    pub(super) surface: &'a Surface<'a>,
    pub(super) pairing: &'a dyn Pairing,
    pub(super) params: &'a IcpParams,
    /// Every so many source points take part.
    pub(super) every: u32,
    pub(super) source: Prepared,
    /// To look partners up in the source in turn, where asked for.
    pub(super) back: Option<&'a Cells>,
    residual: PhantomData<R>,
}

/// What is kept from one pairing to the next.
pub(super) struct Partners {
    known: Vec<Known>,
    squares: Vec<f64>,
}

impl Partners {
    /// Mean residual of those that were found, mm.
    pub(super) fn mean_mm(&self) -> f64 {
        let found = self.squares.iter().filter(|square| square.is_finite());
        let (n, sum) = found.fold((0, 0.0), |(n, sum), square| (n + 1, sum + square.sqrt()));
        sum / f64::from(n)
    }
}

impl<'a, R: Residual> Problem<'a, R> {
    pub(super) fn new(
        surface: &'a Surface<'a>,
        pairing: &'a dyn Pairing,
        params: &'a IcpParams,
        every: u32,
        source: Prepared,
        back: Option<&'a Cells>,
    ) -> Self {
        Self { surface, pairing, params, every, source, back, residual: PhantomData }
    }

    pub(super) fn partners(&self) -> Partners {
        let n = self.source.arms.len();
        Partners { known: vec![Known::NOTHING; n], squares: vec![f64::INFINITY; n] }
    }

    /// Pairs every source point at `state`, and sums over the pairs with these weights; with `shrink` these are first
    /// narrowed to what the residuals tell.
    pub(super) fn pair(
        &self,
        state: &State,
        partners: &mut Partners,
        weights: &mut Weights,
        shrink: bool,
    ) -> Result<Sums, IcpError> {
        let at = At::new(state, self.surface);
        // Residuals decide the weights first.
        let two_passes = shrink || self.params.trim_fraction > 0.0;
        let mut sums: Vec<Sums> = Vec::new();
        partners
            .known
            .par_chunks_mut(CHUNK)
            .zip(partners.squares.par_chunks_mut(CHUNK))
            .enumerate()
            .map(|(chunk, (known, squares))| {
                let first = chunk * CHUNK;
                for (k, (known, square)) in known.iter_mut().zip(squares.iter_mut()).enumerate() {
                    *square = self.find(&at, first + k, weights.reach_mm, known);
                }
                if two_passes { Sums::ZERO } else { self.sum(&at, first, known, squares, weights) }
            })
            .collect_into_vec(&mut sums);
        if two_passes {
            return self.weigh(state, partners, weights, shrink);
        }
        self.total(state, &sums)
    }

    /// Sums over the pairs that [`pair`](Self::pair) found at `state`; with `shrink` under weights that are first narrowed.
    pub(super) fn weigh(
        &self,
        state: &State,
        partners: &Partners,
        weights: &mut Weights,
        shrink: bool,
    ) -> Result<Sums, IcpError> {
        if shrink {
            weights.shrink(&partners.squares, self.params, 2.0 * self.surface.index.cell_mm());
        }
        weights.worst_square = self.worst(&partners.squares);
        let at = At::new(state, self.surface);
        let mut sums: Vec<Sums> = Vec::new();
        partners
            .known
            .par_chunks(CHUNK)
            .zip(partners.squares.par_chunks(CHUNK))
            .enumerate()
            .map(|(chunk, (known, squares))| self.sum(&at, chunk * CHUNK, known, squares, weights))
            .collect_into_vec(&mut sums);
        self.total(state, &sums)
    }

    fn total(&self, state: &State, sums: &[Sums]) -> Result<Sums, IcpError> {
        let sums = sums.iter().fold(Sums::ZERO, Sums::add);
        let min_pairs = self.params.min_pairs.max(3) as usize;
        if sums.n < min_pairs {
            return Err(self.too_few(state, sums.n, min_pairs));
        }
        Ok(sums)
    }

    /// A step as its observer sees it: from `state`, where these sums were found.
    pub(super) fn step(
        &self,
        sums: &Sums,
        state: &State,
        next: &State,
        step_mm: f64,
        remaining_mm: Option<f64>,
    ) -> IcpStep {
        IcpStep {
            iteration: 0,
            every: self.every,
            n_pairs: sums.n,
            rms_mm: sums.rms_mm(),
            step_mm,
            step_rad: next.rotation.angle_to(&state.rotation),
            remaining_mm,
            accelerated: false,
            t_target_source: next.isometry(&self.source.centre),
        }
    }

    /// Mean cost of a source point, mm²: what the steps bring down.
    pub(super) fn energy(&self, sums: &Sums) -> f64 {
        sums.cost / self.source.arms.len() as f64
    }

    /// Finds the partner of a source point; its squared residual, infinite where there is none.
    #[inline]
    fn find(&self, at: &At, i: usize, reach_mm: f64, known: &mut Known) -> f64 {
        let arm = at.rotation * self.source.arms[i];
        let moved = at.centre + arm;
        self.pairing.find(&moved, reach_mm, known);
        if !known.is_some() {
            return f64::INFINITY;
        }
        let pair = self.as_pair(at, i, &arm, known);
        if self.agree(&pair) && self.back.is_none_or(|cells| self.goes_back(at, cells, i, known)) {
            R::square(&pair)
        } else {
            f64::INFINITY
        }
    }

    #[inline]
    fn as_pair(&self, at: &At, i: usize, arm: &Vector3<f64>, known: &Known) -> Pair {
        let mut source_normal = Vector3::zeros();
        if let Some(normals) = &self.source.normals {
            source_normal = at.rotation * normals[i];
            if source_normal.dot(&known.normal) < 0.0 {
                source_normal = -source_normal;
            }
        }
        Pair { arm: *arm, gap: arm - (known.target - at.centre), normal: known.normal, source_normal }
    }

    /// Whether the normals of a pair agree as far as asked for.
    #[inline]
    fn agree(&self, pair: &Pair) -> bool {
        let limit_deg = self.params.max_normal_angle_deg;
        limit_deg >= 180.0 || pair.normal.dot(&pair.source_normal) >= limit_deg.to_radians().cos()
    }

    /// Whether the source point is the nearest of all to its partner.
    fn goes_back(&self, at: &At, cells: &Cells, i: usize, known: &Known) -> bool {
        let partner = at.rotation.inverse() * (known.target - at.centre);
        let own = (partner - self.source.arms[i]).norm();
        // Found within its own distance, so only a nearer one can contradict.
        match cells.nearest(&partner, own, All) {
            Some(found) => found.nearest.is_none_or(|(_, square)| square >= own * own * (1.0 - 1e-12)),
            None => false,
        }
    }

    fn sum(&self, at: &At, first: usize, known: &[Known], squares: &[f64], weights: &Weights) -> Sums {
        let mut sums = Sums::ZERO;
        for (k, (known, &square)) in known.iter().zip(squares).enumerate() {
            if square == f64::INFINITY {
                sums.cost += weights.unpaired();
                continue;
            }
            let (mut weight, cost) = weights.of(square);
            sums.cost += cost;
            if weight == 0.0 {
                continue;
            }
            let arm = at.rotation * self.source.arms[first + k];
            let pair = self.as_pair(at, first + k, &arm, known);
            if self.params.incidence_weights
                && let Some(sight) = self.surface.sight(&known.target)
            {
                weight *= sight.normalize().dot(&known.normal).powi(2);
            }
            sums.n += 1;
            sums.weight += weight;
            sums.squares += weight * square;
            sums.point_squares += weight * pair.gap.norm_squared();
            R::add(&pair, weight, self.source.lever_arm_mm, &mut sums);
        }
        sums
    }

    /// The largest squared residual that is not trimmed.
    fn worst(&self, squares: &[f64]) -> f64 {
        let mut squares: Vec<f64> = squares.iter().copied().filter(|s| s.is_finite()).collect();
        let used = ((1.0 - self.params.trim_fraction) * squares.len() as f64).ceil() as usize;
        if used == 0 || used >= squares.len() {
            return f64::INFINITY;
        }
        *squares.select_nth_unstable_by(used - 1, f64::total_cmp).1
    }

    fn too_few(&self, state: &State, n_pairs: usize, min_pairs: usize) -> IcpError {
        let at = At::new(state, self.surface);
        let nearest = |arm: &Vector3<f64>| {
            let found = self.surface.nearest(&(at.centre + at.rotation * arm), f64::MAX.sqrt());
            found.nearest.map_or(f64::INFINITY, |(_, square)| square)
        };
        IcpError::TooFewPairs {
            n_pairs,
            min_pairs,
            n_source: self.source.arms.len(),
            max_pair_distance_mm: self.params.max_pair_distance_mm,
            nearest_mm: self.source.arms.iter().map(nearest).fold(f64::INFINITY, f64::min).sqrt(),
        }
    }
}

/// A pose as a pairing needs it: about the centre of the target's index.
struct At {
    rotation: Rotation3<f64>,
    centre: Vector3<f64>,
}

impl At {
    fn new(state: &State, surface: &Surface<'_>) -> Self {
        Self { rotation: state.rotation.to_rotation_matrix(), centre: state.centre - surface.index.centre }
    }
}
