//! Pairs of source and target points at one pose, and what they ask for.

use super::acceleration::State;
use super::observability::{FREE_PER_MM, plane_row, point_block, sorted_eigen};
use super::surface::Surface;
use super::{IcpError, IcpParams};
use crate::kabsch::from_covariance;
use nalgebra::{ArrayStorage, Matrix3, Matrix6, Point3, Vector3, Vector6};
use rayon::prelude::*;

/// Points summed by one task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 512;

/// What a variant minimises.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Residual {
    Point,
    Plane,
}

/// One registration: everything but the pose.
pub(super) struct Problem<'a> {
    pub(super) residual: Residual,
    pub(super) surface: &'a Surface<'a>,
    pub(super) params: &'a IcpParams,
    /// Source points about the centroid of the whole source.
    pub(super) arms: Vec<Vector3<f64>>,
    pub(super) source_centre: Point3<f64>,
    pub(super) lever_arm_mm: f64,
}

/// Sums over the pairs used, taken over chunks in order.
#[derive(Clone)]
pub(super) struct Sums {
    /// Pairs used.
    pub(super) n: usize,
    /// Squared distances between the points, mm².
    pub(super) point_squares: f64,
    /// Squared distances along the normals, mm².
    pub(super) plane_squares: f64,
    /// What the variant minimises: one of the two above.
    pub(super) squares: f64,
    arm: Vector3<f64>,
    offset: Vector3<f64>,
    offset_arm: Matrix3<f64>,
    /// `Jᵀ r` of the residual.
    pub(super) gradient: Vector6<f64>,
    /// `JᵀJ` along the normals: how the residual bends once points find new partners.
    pub(super) hold: Matrix6<f64>,
    /// `JᵀJ` between the points: how it bends while points keep their partners.
    grip: Matrix6<f64>,
}

impl Sums {
    const ZERO: Self = Self {
        n: 0,
        point_squares: 0.0,
        plane_squares: 0.0,
        squares: 0.0,
        arm: Vector3::new(0.0, 0.0, 0.0),
        offset: Vector3::new(0.0, 0.0, 0.0),
        offset_arm: Matrix3::from_array_storage(ArrayStorage([[0.0; 3]; 3])),
        gradient: Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        hold: Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6])),
        grip: Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6])),
    };

    fn add(mut self, other: &Self) -> Self {
        self.n += other.n;
        self.point_squares += other.point_squares;
        self.plane_squares += other.plane_squares;
        self.squares += other.squares;
        self.arm += other.arm;
        self.offset += other.offset;
        self.offset_arm += other.offset_arm;
        self.gradient += other.gradient;
        self.hold += other.hold;
        self.grip += other.grip;
        self
    }
}

/// A source point's nearest target point.
#[derive(Clone, Copy)]
struct Pair {
    target: u32,
    point_square: f64,
    /// The square of what is minimised; infinite where the pair is too far apart to be used.
    square: f64,
}

/// What the pairs at one pose give.
#[derive(Clone)]
pub(super) struct Pairing {
    pub(super) sums: Sums,
    /// Mean over all source points of the squared residual, where an unused point counts as far as the limit, mm².
    pub(super) energy: f64,
}

impl Pairing {
    /// RMS of what is minimised over the pairs used, mm.
    pub(super) fn rms_mm(&self) -> f64 {
        (self.sums.squares / self.sums.n.max(1) as f64).sqrt()
    }
}

impl Problem<'_> {
    /// Pairs every source point at `state` and sums over the pairs used.
    pub(super) fn pair(&self, state: &State) -> Result<Pairing, IcpError> {
        let rotation = state.rotation.to_rotation_matrix();
        let Surface { points, normals, tree } = self.surface;
        let limit = self.params.max_pair_distance_mm.powi(2);
        let mut pairs = vec![Pair { target: 0, point_square: f64::INFINITY, square: f64::INFINITY }; self.arms.len()];
        pairs.par_chunks_mut(CHUNK).zip(self.arms.par_chunks(CHUNK)).for_each(|(pairs, arms)| {
            for (pair, arm) in pairs.iter_mut().zip(arms) {
                let moved = state.centre + rotation * arm;
                let Some((index, point_square)) = tree.nearest(&moved) else { continue };
                let square = match self.residual {
                    _ if point_square > limit => f64::INFINITY,
                    Residual::Point => point_square,
                    Residual::Plane => (moved - points[index]).dot(&normals[index]).powi(2),
                };
                *pair = Pair { target: index as u32, point_square, square };
            }
        });
        let worst = self.worst_used(&pairs)?;
        let chunks: Vec<Sums> = pairs
            .par_chunks(CHUNK)
            .zip(self.arms.par_chunks(CHUNK))
            .map(|(pairs, arms)| {
                let used = pairs.iter().zip(arms).filter(|(pair, _)| pair.square <= worst);
                let mut sums = Sums::ZERO;
                for (pair, arm) in used {
                    let target = pair.target as usize;
                    let offset = points[target] - state.centre;
                    self.add_pair(&mut sums, pair, &(rotation * arm), &offset, &normals[target]);
                }
                sums
            })
            .collect();
        let sums = chunks.iter().fold(Sums::ZERO, Sums::add);
        let energy = (sums.squares + (self.arms.len() - sums.n) as f64 * limit) / self.arms.len() as f64;
        Ok(Pairing { sums, energy })
    }

    /// Adds a pair whose source and target point lie at `arm` and `offset` from the source's centroid.
    fn add_pair(&self, sums: &mut Sums, pair: &Pair, arm: &Vector3<f64>, offset: &Vector3<f64>, normal: &Vector3<f64>) {
        let row = plane_row(normal, arm, self.lever_arm_mm);
        let gap = arm - offset;
        let along = gap.dot(normal);
        sums.n += 1;
        sums.point_squares += pair.point_square;
        sums.plane_squares += along * along;
        sums.squares += pair.square;
        sums.hold += row * row.transpose();
        match self.residual {
            Residual::Plane => sums.gradient += row * along,
            Residual::Point => {
                let turn = arm.cross(&gap) / self.lever_arm_mm;
                sums.gradient += Vector6::new(gap.x, gap.y, gap.z, turn.x, turn.y, turn.z);
                sums.grip += point_block(arm, self.lever_arm_mm);
                sums.arm += arm;
                sums.offset += offset;
                sums.offset_arm += offset * arm.transpose();
            }
        }
    }

    /// The largest squared residual that is used: below the limit, and above it only the trimmed share.
    fn worst_used(&self, pairs: &[Pair]) -> Result<f64, IcpError> {
        let mut squares: Vec<f64> = pairs.iter().map(|p| p.square).filter(|s| s.is_finite()).collect();
        let used = ((1.0 - self.params.trim_fraction) * squares.len() as f64).ceil() as usize;
        let min_pairs = self.params.min_pairs.max(3) as usize;
        if used < min_pairs {
            let nearest = pairs.iter().map(|p| p.point_square).fold(f64::INFINITY, f64::min);
            return Err(IcpError::TooFewPairs {
                n_pairs: used,
                min_pairs,
                n_source: pairs.len(),
                max_pair_distance_mm: self.params.max_pair_distance_mm,
                nearest_mm: nearest.sqrt(),
            });
        }
        if used == squares.len() {
            return Ok(f64::MAX);
        }
        Ok(*squares.select_nth_unstable_by(used - 1, f64::total_cmp).1)
    }

    /// Where the plain step of the variant leads: Kabsch for points, Gauss-Newton for planes.
    pub(super) fn plain(&self, state: &State, pairing: &Pairing) -> State {
        let sums = &pairing.sums;
        let n = sums.n as f64;
        if self.residual == Residual::Plane {
            return state.moved(&self.newton(pairing), self.lever_arm_mm);
        }
        let (arm, offset) = (sums.arm / n, sums.offset / n);
        let covariance = sums.offset_arm - offset * arm.transpose() * n;
        let Some(turn) = from_covariance(&covariance, &Point3::from(offset), &Point3::from(arm)) else {
            // Points on a line: the smallest motion that does as well, without a turn about the line.
            return state.moved(&least_step(&(sums.grip / n), &(sums.gradient / n)), self.lever_arm_mm);
        };
        let mut rotation = turn.rotation * state.rotation;
        rotation.renormalize();
        State { rotation, centre: state.centre + turn.translation.vector }
    }

    /// The motion to where the residual has its least if the surface is as the normals say: `-N⁺ Jᵀr`.
    ///
    /// For planes this is the Gauss-Newton step. For points, whose partners change as they slide, the residual bends
    /// along the surface no more than for planes, although the plain step believes it does; so this is the way to go.
    pub(super) fn newton(&self, pairing: &Pairing) -> Vector6<f64> {
        let n = pairing.sums.n as f64;
        least_step(&(pairing.sums.hold / n), &(pairing.sums.gradient / n))
    }

    /// The motion that the pairs hold least among those they hold, of length 1 mm.
    pub(super) fn weakest(&self, pairing: &Pairing) -> Option<Vector6<f64>> {
        let (values, vectors) = sorted_eigen(&(pairing.sums.hold / pairing.sums.n as f64));
        let k = (0..6).rfind(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM)?;
        Some(vectors.column(k).into_owned())
    }

    /// How far from its least the residual of points can come to rest among the target's samples, mm: what a random
    /// offset of the partners along the surface does to [`Problem::newton`], one standard deviation. None for planes.
    pub(super) fn resolution_mm(&self, pairing: &Pairing) -> Option<f64> {
        let sums = &pairing.sums;
        if self.residual == Residual::Plane {
            return None;
        }
        // Half of the squared offset along the surface falls on each of its two directions.
        let offset_square = (sums.point_squares - sums.plane_squares).max(0.0) / sums.n as f64 / 2.0;
        let (values, vectors) = sorted_eigen(&(sums.hold / sums.n as f64));
        let loose = (sums.grip - sums.hold) / sums.n as f64;
        let variance: f64 = (0..6)
            .filter(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM)
            .map(|k| {
                let v: Vector6<f64> = vectors.column(k).into_owned();
                v.dot(&(loose * v)) * offset_square / (sums.n as f64 * values[k] * values[k])
            })
            .sum();
        Some(variance.max(0.0).sqrt())
    }
}

/// `-H⁺ g`: the least of a quadratic model, leaving alone the motions that it leaves free.
fn least_step(hessian: &Matrix6<f64>, gradient: &Vector6<f64>) -> Vector6<f64> {
    let (values, vectors) = sorted_eigen(hessian);
    (0..6).filter(|&k| values[k] >= FREE_PER_MM * FREE_PER_MM).fold(Vector6::zeros(), |step, k| {
        let v: Vector6<f64> = vectors.column(k).into_owned();
        step - v * (v.dot(gradient) / values[k])
    })
}
