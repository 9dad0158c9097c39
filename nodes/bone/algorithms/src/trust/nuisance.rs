//! What may be wrong beside the pose: how large it is, how large it may be, or from which size it would matter.
//!
//! A registration estimates six numbers. Each way in which the world departs from a rigid copy of the CT is a few numbers more,
//! with a prior: it is fitted beside the six, and is then *measured*, *bounded* by the data, or *unseen* by them.

mod cause;
mod effect;
mod fit;
mod model;
pub(super) mod params;
mod report;
mod words;

use super::Limits;
use super::evidence::Registered;
use super::predict::Where;
use crate::nearest::Nearest;
use crate::target::Target;
use cause::Axes;
use model::Model;
use nalgebra::{Point3, Vector3};
pub use params::NuisanceParams;
use rayon::prelude::*;
pub(super) use report::Nuisances;
pub use report::{Nuisance, NuisanceState};

/// Number of points of the scan that are fitted, each for its neighbours.
const N_FITTED: usize = 2000;

/// Number of points of the scan that they are chosen from.
const N_READ: usize = 20_000;

/// Examines what may be wrong beside the pose. `None` where the target has no normals or the scan leaves the pose undetermined.
pub(super) fn examine(
    registered: &Registered<'_>,
    place: &Where<'_>,
    noise_mm: f64,
    cell_mm: f64,
    limits: &Limits,
    params: &NuisanceParams,
) -> Option<Nuisances> {
    let Registered { target, source, t_target_source, .. } = *registered;
    let normals = target.normals()?;
    let every = source.len().div_ceil(N_READ).max(1);
    let read: Vec<Point3<f64>> = source.points().iter().step_by(every).map(|p| t_target_source * p).collect();
    let (points, seen): (Vec<_>, Vec<_>) = middling(target, normals, &read, N_FITTED).into_iter().unzip();
    let noise_mm = noise_mm / (read.len() as f64 / N_FITTED as f64).max(1.0).sqrt();
    let camera = source.viewpoint.map(|viewpoint| t_target_source * (viewpoint * Point3::origin()));
    let axes = Axes::new(&points, &seen, camera)?;
    let problem = fit::Problem { target, normals, points: &points, axes: &axes, noise_mm, cell_mm };
    Some(Model::new(problem, place, limits, params)?.judge())
}

/// At most about `n` registered points within reach of the surface, each with the surface's normal: of the points around one of an
/// even thinning, the one of median residual, so that the noise of single points is averaged and outliers are left out.
fn middling(
    target: &Target,
    normals: &[Vector3<f64>],
    points: &[Point3<f64>],
    n: usize,
) -> Vec<(Point3<f64>, Vector3<f64>)> {
    let thinned: Vec<Point3<f64>> = points.iter().step_by(points.len().div_ceil(n).max(1)).copied().collect();
    let tree = Nearest::new(&thinned);
    let paired = |p: &Point3<f64>| {
        let (index, _) = target.nearest(p, fit::REACH_MM)?;
        let (around, _) = tree.nearest(p)?;
        Some((around, (p - target.points()[index]).dot(&normals[index]), *p, normals[index]))
    };
    let mut paired: Vec<_> = points.par_iter().filter_map(paired).collect();
    paired.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    paired
        .chunk_by(|a, b| a.0 == b.0)
        .map(|group| group[group.len() / 2])
        .map(|(_, _, p, normal)| (p, normal))
        .collect()
}
