//! Where the scan contradicts the phantom's CAD: it looks through the CAD, or shows something before it.

use super::pairs::Faces;
use crate::median::median;
use crate::mesh_query::MeshQuery;
use crate::nearest::Nearest;
use nalgebra::{Isometry3, Point3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Length along the sight by which a point contradicts the CAD, mm, with six standard deviations of the noise: beyond the smooth error of a
/// camera, the rounded edges of a print and the outliers beside its edges, below the size of a block.
const OFF_MM: f64 = 2.0;

/// Number of neighbours of a point, of which most have to contradict as it does: points beside an edge are outliers, a block is a patch.
const AROUND: usize = 8;
const MOST: f64 = 0.75;

/// Points of the scan that are compared with the CAD.
const N_RAYS: usize = 8000;

/// Distance behind a face from which the ray is followed through the CAD, mm: beyond rounding.
const INSIDE_MM: f64 = 1e-3;

/// Contradictions of one sign.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Contradiction {
    /// Share of the points whose rays meet the CAD.
    pub share: f64,
    /// Mean of the places, in the phantom's frame, mm; none without one.
    pub at_mm: Option<[f64; 3]>,
    /// Median distance from the CAD along the rays, mm.
    pub along_mm: f64,
}

/// Sums up the points that the camera sees through the CAD, and those before it. Points and tree are in the phantom's frame.
pub(super) fn contradicted(
    query: &MeshQuery,
    faces: &Faces,
    points: &[Point3<f64>],
    tree: &Nearest,
    t_phantom_camera: &Isometry3<f64>,
    noise_mm: f64,
) -> [Contradiction; 2] {
    let eye = t_phantom_camera * Point3::origin();
    let limit_mm = OFF_MM + 6.0 * noise_mm;
    // Positive through the CAD, negative before it; none where the ray passes beside it.
    let along = |point: &Point3<f64>| {
        let sight = point - eye;
        let distance_mm = sight.norm();
        let direction = sight / distance_mm;
        let hit = query.cast_ray(&eye, &direction)?;
        let off_mm = distance_mm - hit.distance_mm;
        if off_mm < 0.0 {
            return Some(if -off_mm > limit_mm && faces.distance_mm(point) > limit_mm { off_mm } else { 0.0 });
        }
        // Within the CAD: at an edge little, whatever is behind.
        let inside = query.cast_ray(&(hit.point + direction * INSIDE_MM), &direction);
        let within_mm = inside.map_or(0.0, |exit| exit.distance_mm).min(off_mm);
        Some(if within_mm > limit_mm { within_mm } else { 0.0 })
    };
    let all: Vec<Option<f64>> = points.par_iter().map(along).collect();
    let every = points.len().div_ceil(N_RAYS).max(1);
    let counted: Vec<usize> = (0..points.len()).step_by(every).filter(|i| all[*i].is_some()).collect();
    [1.0, -1.0].map(|sign| {
        let is_its = |i: usize| all[i].is_some_and(|mm| mm * sign > 0.0);
        let in_patch = |i: &usize| {
            is_its(*i) && {
                let around = tree.nearest_n(&points[*i], AROUND);
                let n = around.iter().filter(|(j, _)| is_its(*j)).count();
                n as f64 >= MOST * around.len() as f64
            }
        };
        let of: Vec<usize> = counted.iter().copied().filter(in_patch).collect();
        let n = of.len() as f64;
        let sum: nalgebra::Vector3<f64> = of.iter().map(|i| points[*i].coords).sum();
        let mut distances: Vec<f64> = of.iter().filter_map(|i| all[*i]).map(f64::abs).collect();
        Contradiction {
            share: n / counted.len().max(1) as f64,
            at_mm: (n > 0.0).then(|| (sum / n).into()),
            along_mm: median(&mut distances),
        }
    })
}
