//! The least-squares problem at one level: finds correspondences and builds the normal equations.

use super::IcpError;
use super::normal_equations::NormalEquations;
use super::pairing::{Correspondence, Pairing};
use super::params::IcpParams;
use super::report::IcpStep;
use super::residual::{Pair, Residual};
use super::source::PreparedSource;
use super::state::State;
use super::visible_surface::VisibleSurface;
use super::weights::Weights;
use crate::point_grid::{All, PointGrid};
use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use std::marker::PhantomData;

/// Points summed by one task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 512;

/// Points of a chunk that are paired, then summed while the processor's nearest cache holds them.
const PART: usize = 64;

/// Up to this many points, waking another thread takes longer than its share of the work.
const MIN_PARALLEL: usize = 1024;

/// The registration of one subset of the source.
pub(super) struct Problem<'a, R> {
    pub(super) surface: &'a VisibleSurface<'a>,
    pub(super) pairing: &'a dyn Pairing,
    pub(super) params: &'a IcpParams,
    /// The subset is every n-th source point.
    pub(super) every: u32,
    pub(super) source: PreparedSource,
    /// The source points in a grid, for reciprocal correspondences.
    pub(super) reciprocal: Option<&'a PointGrid>,
    /// 1 if the target's normals point outwards, -1 if inwards; none if both sides of the surface count alike.
    outward: Option<f64>,
    residual: PhantomData<R>,
}

/// The correspondences of all source points, cached from one linearisation to the next.
pub(super) struct Correspondences {
    pairs: Vec<Correspondence>,
    /// Squared residuals, mm²; infinite for points without a pair.
    squares: Vec<f64>,
    /// Whether the target points are kept, without further searches.
    pub(super) is_held: bool,
}

impl Correspondences {
    /// Mean residual of the pairs, mm.
    pub(super) fn mean_mm(&self) -> f64 {
        let found = self.squares.iter().filter(|square| square.is_finite());
        let (n, sum) = found.fold((0, 0.0), |(n, sum), square| (n + 1, sum + square.sqrt()));
        sum / f64::from(n)
    }
}

impl<'a, R: Residual> Problem<'a, R> {
    pub(super) fn new(
        surface: &'a VisibleSurface<'a>,
        pairing: &'a dyn Pairing,
        params: &'a IcpParams,
        every: u32,
        source: PreparedSource,
        reciprocal: Option<&'a PointGrid>,
    ) -> Self {
        let outward = surface.outward().filter(|_| params.one_sided.unwrap_or(R::ONE_SIDED));
        Self { surface, pairing, params, every, source, reciprocal, outward, residual: PhantomData }
    }

    /// One empty correspondence for each source point.
    pub(super) fn correspondences(&self) -> Correspondences {
        let n = self.source.points.len();
        let pairs = (0..n).map(|_| Correspondence::NONE).collect();
        Correspondences { pairs, squares: vec![f64::INFINITY; n], is_held: false }
    }

    /// Finds the correspondences at `state` and builds the normal equations. With `narrow` the weights are first narrowed
    /// to the residuals found.
    pub(super) fn linearize(
        &self,
        state: &State,
        correspondences: &mut Correspondences,
        weights: &mut Weights,
        narrow: bool,
    ) -> Result<NormalEquations, IcpError> {
        let pose = LocalPose::new(state, self.surface);
        // Weights that depend on all residuals need a second pass.
        let two_passes = narrow || self.params.trim_fraction > 0.0;
        let search = (!correspondences.is_held).then_some(self.pairing);
        let equations = self.over_chunks(correspondences, |first, pairs, squares| {
            let mut sum = Sum::new(self, weights);
            let (mut turned, mut moved) = ([Vector3::zeros(); PART], [Vector3::zeros(); PART]);
            for (part, (pairs, squares)) in pairs.chunks_mut(PART).zip(squares.chunks_mut(PART)).enumerate() {
                let first = first + part * PART;
                for (k, point) in self.source.points[first..first + pairs.len()].iter().enumerate() {
                    turned[k] = pose.rotation * point;
                    moved[k] = pose.centroid + turned[k];
                }
                if let Some(pairing) = search {
                    pairing.find_all(&moved[..pairs.len()], weights.search_radius_mm, pairs);
                }
                for (k, (correspondence, square)) in pairs.iter().zip(squares).enumerate() {
                    let pair = self.pair(&pose, first + k, &turned[k], correspondence);
                    *square = self.square(&pose, first + k, &pair, correspondence);
                    if !two_passes {
                        sum.add(&pair, *square, correspondence);
                    }
                }
            }
            sum.equations
        });
        if two_passes {
            return self.reweight(state, correspondences, weights, narrow);
        }
        self.with_enough_pairs(state, equations)
    }

    /// Narrows the weights to the residuals of the correspondences.
    pub(super) fn narrow(&self, correspondences: &Correspondences, weights: &mut Weights) {
        weights.narrow(&correspondences.squares, self.params, 2.0 * self.surface.index.cell_mm());
    }

    /// Builds the normal equations of the correspondences that [`linearize`](Self::linearize) found at `state`. With
    /// `narrow` the weights are first narrowed to their residuals.
    pub(super) fn reweight(
        &self,
        state: &State,
        correspondences: &mut Correspondences,
        weights: &mut Weights,
        narrow: bool,
    ) -> Result<NormalEquations, IcpError> {
        if narrow {
            self.narrow(correspondences, weights);
        }
        weights.trim_square = self.trim_square(&correspondences.squares);
        let pose = LocalPose::new(state, self.surface);
        let equations = self.over_chunks(correspondences, |first, pairs, squares| {
            let mut sum = Sum::new(self, weights);
            for (k, (correspondence, &square)) in (first..).zip(pairs.iter().zip(squares.iter())) {
                let source = pose.rotation * self.source.points[k];
                sum.add(&self.pair(&pose, k, &source, correspondence), square, correspondence);
            }
            sum.equations
        });
        self.with_enough_pairs(state, equations)
    }

    /// The total over chunks of the correspondences, each given with the index of its first point.
    fn over_chunks(
        &self,
        correspondences: &mut Correspondences,
        sum: impl Fn(usize, &mut [Correspondence], &mut [f64]) -> NormalEquations + Sync,
    ) -> NormalEquations {
        let Correspondences { pairs, squares, .. } = correspondences;
        let mut sums: Vec<NormalEquations> = Vec::new();
        if pairs.len() <= MIN_PARALLEL {
            let chunks = pairs.chunks_mut(CHUNK).zip(squares.chunks_mut(CHUNK)).enumerate();
            sums.extend(chunks.map(|(k, (pairs, squares))| sum(k * CHUNK, pairs, squares)));
        } else {
            let chunks = pairs.par_chunks_mut(CHUNK).zip(squares.par_chunks_mut(CHUNK)).enumerate();
            chunks.map(|(k, (pairs, squares))| sum(k * CHUNK, pairs, squares)).collect_into_vec(&mut sums);
        }
        sums.iter().fold(NormalEquations::ZERO, NormalEquations::add)
    }

    fn with_enough_pairs(&self, state: &State, total: NormalEquations) -> Result<NormalEquations, IcpError> {
        let min_pairs = self.params.min_pairs.max(3) as usize;
        if total.n_pairs < min_pairs {
            return Err(self.too_few_pairs(state, total.n_pairs, min_pairs));
        }
        Ok(total)
    }

    /// The step from `state` to `next` for the observer; the equations are those at `state`.
    pub(super) fn step(
        &self,
        equations: &NormalEquations,
        state: &State,
        next: &State,
        step_mm: f64,
        remaining_mm: Option<f64>,
    ) -> IcpStep {
        IcpStep {
            iteration: 0,
            every: self.every,
            n_pairs: equations.n_pairs,
            rms_mm: equations.rms_mm(),
            step_mm,
            step_rad: next.rotation.angle_to(&state.rotation),
            remaining_mm,
            accelerated: false,
            t_target_source: next.isometry(&self.source.centroid),
        }
    }

    /// Mean cost of a source point, mm²: the objective.
    pub(super) fn mean_cost(&self, equations: &NormalEquations) -> f64 {
        equations.cost / self.source.points.len() as f64
    }

    /// The squared residual of a pair, infinite if there is none or it is not used.
    #[inline]
    fn square(&self, pose: &LocalPose, i: usize, pair: &Pair, correspondence: &Correspondence) -> f64 {
        let is_used = correspondence.is_some()
            && self.normals_agree(pair)
            && self.reciprocal.is_none_or(|grid| self.is_reciprocal(pose, grid, i, correspondence));
        if is_used { R::square(pair) } else { f64::INFINITY }
    }

    #[inline]
    fn pair(&self, pose: &LocalPose, i: usize, source: &Vector3<f64>, correspondence: &Correspondence) -> Pair {
        let mut source_normal = Vector3::zeros();
        if let Some(normals) = &self.source.normals {
            source_normal = pose.rotation * normals[i];
            if source_normal.dot(&correspondence.normal) < 0.0 {
                source_normal = -source_normal;
            }
        }
        Pair {
            source: *source,
            difference: source - (correspondence.target - pose.centroid),
            normal: correspondence.normal,
            source_normal,
        }
    }

    #[inline]
    fn normals_agree(&self, pair: &Pair) -> bool {
        let limit_deg = self.params.max_normal_angle_deg;
        limit_deg >= 180.0 || pair.normal.dot(&pair.source_normal) >= limit_deg.to_radians().cos()
    }

    /// Whether the source point is the nearest source point to its target point.
    fn is_reciprocal(&self, pose: &LocalPose, grid: &PointGrid, i: usize, correspondence: &Correspondence) -> bool {
        let target = pose.rotation.inverse() * (correspondence.target - pose.centroid);
        let own = (target - self.source.points[i]).norm();
        // The search radius is its own distance, so only a nearer point can contradict.
        match grid.nearest(&target, own, All) {
            Some(found) => found.nearest.is_none_or(|(_, square)| square >= own * own * (1.0 - 1e-12)),
            None => false,
        }
    }

    /// The largest squared residual that is not trimmed.
    fn trim_square(&self, squares: &[f64]) -> f64 {
        if self.params.trim_fraction == 0.0 {
            return f64::INFINITY;
        }
        let mut squares: Vec<f64> = squares.iter().copied().filter(|s| s.is_finite()).collect();
        let used = ((1.0 - self.params.trim_fraction) * squares.len() as f64).ceil() as usize;
        if used == 0 || used >= squares.len() {
            return f64::INFINITY;
        }
        *squares.select_nth_unstable_by(used - 1, f64::total_cmp).1
    }

    fn too_few_pairs(&self, state: &State, n_pairs: usize, min_pairs: usize) -> IcpError {
        let pose = LocalPose::new(state, self.surface);
        let nearest = |point: &Vector3<f64>| {
            let found = self.surface.nearest(&(pose.centroid + pose.rotation * point), f64::MAX.sqrt());
            found.nearest.map_or(f64::INFINITY, |(_, square)| square)
        };
        let max_pair_distance_mm = self.params.max_pair_distance_mm;
        let is_near = |point: &&Vector3<f64>| {
            let moved = pose.centroid + pose.rotation * **point;
            self.surface.index.nearest(&moved, max_pair_distance_mm).nearest.is_some()
        };
        let n_source = self.source.points.len();
        let n_any = self.surface.outward().map_or(0, |_| self.source.points.iter().filter(is_near).count());
        if n_any >= min_pairs.max(n_source / 2) {
            return IcpError::TooFewFacing { n_pairs, n_source, n_any, max_pair_distance_mm };
        }
        IcpError::TooFewPairs {
            n_pairs,
            min_pairs,
            n_source,
            max_pair_distance_mm,
            nearest_mm: self.source.points.iter().map(nearest).fold(f64::INFINITY, f64::min).sqrt(),
        }
    }
}

/// The normal equations of a chunk while pairs are added in order.
struct Sum<'a, R> {
    problem: &'a Problem<'a, R>,
    weights: &'a Weights,
    unpaired_cost: f64,
    equations: NormalEquations,
}

impl<'a, R: Residual> Sum<'a, R> {
    fn new(problem: &'a Problem<'a, R>, weights: &'a Weights) -> Self {
        Self { problem, weights, unpaired_cost: weights.unpaired_cost(), equations: NormalEquations::ZERO }
    }

    /// Adds a pair with its squared residual, infinite if it is none.
    #[inline(always)]
    fn add(&mut self, pair: &Pair, square: f64, correspondence: &Correspondence) {
        let (problem, equations) = (self.problem, &mut self.equations);
        if square == f64::INFINITY {
            equations.cost += self.unpaired_cost;
            return;
        }
        let is_outside = problem.outward.is_some_and(|side| side * pair.difference.dot(&pair.normal) > 0.0);
        let (mut weight, cost) = match is_outside {
            true => self.weights.outside(square, problem.params),
            false => self.weights.weight_and_cost(square),
        };
        equations.cost += cost;
        if weight == 0.0 {
            return;
        }
        if problem.params.incidence_weights
            && let Some(sight) = problem.surface.sight(&correspondence.target)
        {
            weight *= sight.normalize().dot(&correspondence.normal).powi(2);
        }
        equations.n_pairs += 1;
        equations.weight += weight;
        equations.squares += weight * square;
        let largest = &mut equations.largest_squares[usize::from(is_outside)];
        *largest = largest.max(square);
        equations.point_squares += weight * pair.difference.norm_squared();
        R::accumulate(pair, weight, problem.source.lever_arm_mm, equations);
    }
}

/// A state about the centre of the target's index.
struct LocalPose {
    rotation: Rotation3<f64>,
    centroid: Vector3<f64>,
}

impl LocalPose {
    fn new(state: &State, surface: &VisibleSurface<'_>) -> Self {
        Self { rotation: state.rotation.to_rotation_matrix(), centroid: state.centroid - surface.index.centre }
    }
}
