//! What may be wrong beside the pose: how large it is, how large it may be, or from which size it would matter.
//!
//! A registration estimates six numbers. Each way in which the world departs from a rigid copy of the CT is a few numbers more,
//! with a prior: it is fitted beside the six, and is then *measured*, *bounded* by the data, or *unseen* by them.

mod axes;
mod cause;
mod effect;
mod field;
mod fit;
mod model;
pub(super) mod params;
mod report;
mod words;

use super::RuleParams;
use super::evidence::Registered;
use super::predict::Where;
use super::{Residual, Residuals};
use crate::nearest::Nearest;
pub(super) use axes::Axes;
pub(super) use effect::Effect;
use field::Field;
use model::Family;
pub(super) use model::Nuisances;
use nalgebra::Point3;
pub use params::NuisanceParams;
use rayon::prelude::*;
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
    has_markers: bool,
    rules: &RuleParams,
    params: &NuisanceParams,
) -> Option<Nuisances> {
    let Registered { target, source, t_target_source, .. } = *registered;
    let normals = target.normals()?;
    let read = Residuals::new(target, source.points(), t_target_source, fit::REACH_MM, N_READ)?.near;
    let (points, seen): (Vec<_>, Vec<_>) =
        middling(&read, N_FITTED).into_iter().map(|at| (at.point, at.normal)).unzip();
    let noise_mm = noise_mm / (read.len() as f64 / N_FITTED as f64).max(1.0).sqrt();
    let camera = source.viewpoint.map(|viewpoint| t_target_source * (viewpoint * Point3::origin()));
    let targets = place.limited.iter().chain(place.cuts.iter().map(|cut| &cut.middle.position));
    let axes = Axes::new(&points, &seen, camera)?.with_targets(targets);
    let field = Field::new(&axes, &points, params.field_mm);
    let (families, modes) = Family::all(&axes, has_markers, params);
    let problem =
        fit::Problem { target, normals, points: &points, axes: &axes, field: &field, modes: &modes, noise_mm };
    Nuisances::new(&problem, families, place, &rules.limits, params)
}

/// At most about `n` of the residuals: of those around one of an even thinning, the median one, so that the noise of single points is
/// averaged and outliers are left out.
fn middling(all: &[Residual], n: usize) -> Vec<Residual> {
    let thinned: Vec<Point3<f64>> =
        all.iter().step_by(all.len().div_ceil(n).max(1)).map(|residual| residual.point).collect();
    let tree = Nearest::new(&thinned);
    let around = |residual: &Residual| Some((tree.nearest(&residual.point)?.0, *residual));
    let mut grouped: Vec<(usize, Residual)> = all.par_iter().filter_map(around).collect();
    grouped.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.signed_mm.total_cmp(&b.1.signed_mm)));
    grouped.chunk_by(|a, b| a.0 == b.0).map(|group| group[group.len() / 2].1).collect()
}
