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
use cause::Axes;
use model::Model;
use nalgebra::Point3;
pub use params::NuisanceParams;
pub(super) use report::Nuisances;
pub use report::{Nuisance, NuisanceState};

/// Number of points of the scan that are fitted.
const N_FITTED: usize = 2000;

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
    let every = source.len().div_ceil(N_FITTED).max(1);
    let all: Vec<Point3<f64>> = source.points().iter().step_by(every).map(|p| t_target_source * p).collect();
    let (mut points, mut seen) = (Vec::new(), Vec::new());
    for p in all {
        if let Some((index, _)) = target.nearest(&p, fit::REACH_MM) {
            points.push(p);
            seen.push(normals[index]);
        }
    }
    let camera = source.viewpoint.map(|viewpoint| t_target_source * (viewpoint * Point3::origin()));
    let axes = Axes::new(&points, &seen, camera)?;
    let problem = fit::Problem { target, normals, points: &points, axes: &axes, noise_mm, cell_mm };
    Some(Model::new(problem, place, limits, params)?.judge())
}
