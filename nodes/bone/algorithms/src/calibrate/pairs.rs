//! Scan points on the phantom's faces.

use crate::kabsch::centroid;
use crate::nearest::Nearest;
use crate::normals;
use crate::target::Target;
use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

/// A scan point on its face.
pub(super) struct Pair {
    /// The scan point in the phantom's frame.
    pub(super) phantom: Point3<f64>,
    /// The face's normal in the phantom's frame.
    pub(super) normal: Vector3<f64>,
    pub(super) residual_mm: f64,
    /// Change of the residual with the depth of the point: the cosine of the incidence.
    pub(super) per_depth: f64,
}

/// Cosine of the largest angle between the normals of a scan point and its face: half of that between two faces.
pub(super) const SAME_FACE_COS: f64 = 0.7;

/// Points of a scan in the camera's frame, mm, with unit normals of either sign.
#[derive(Clone)]
pub(super) struct Scan {
    pub(super) points: Vec<Point3<f64>>,
    pub(super) normals: Vec<Vector3<f64>>,
}

impl Scan {
    pub(super) fn new(points: &[Point3<f64>]) -> Self {
        let centre = centroid(points);
        let offsets: Vec<Vector3<f64>> = points.iter().map(|p| p - centre).collect();
        Self { points: points.to_vec(), normals: normals::without_side(&offsets) }
    }

    /// About `n` points, evenly along the scan.
    pub(super) fn thinned(&self, n: usize) -> Self {
        let every = self.points.len().div_ceil(n).max(1);
        Self {
            points: self.points.iter().copied().step_by(every).collect(),
            normals: self.normals.iter().copied().step_by(every).collect(),
        }
    }
}

impl Scan {
    /// The points within `max_mm` of the faces, without what stands around the phantom.
    pub(super) fn near(&self, faces: &Faces, t_phantom_camera: &Isometry3<f64>, max_mm: f64) -> Self {
        let is_near = |p: &Point3<f64>| faces.distance_mm(&(t_phantom_camera * p)) <= max_mm;
        let kept: Vec<usize> = (0..self.points.len()).filter(|&i| is_near(&self.points[i])).collect();
        Self {
            points: kept.iter().map(|&i| self.points[i]).collect(),
            normals: kept.iter().map(|&i| self.normals[i]).collect(),
        }
    }
}

/// Some samples of the CAD's faces. Far from them, a tree is faster than the cells of a [`Target`].
pub(super) struct Faces {
    pub(super) points: Vec<Point3<f64>>,
    pub(super) normals: Vec<Vector3<f64>>,
    tree: Nearest,
}

impl Faces {
    /// About `n` of a target's samples, which have normals.
    pub(super) fn of(target: &Target, n: usize) -> Self {
        let every = target.points().len().div_ceil(n).max(1);
        let points: Vec<Point3<f64>> = target.points().iter().copied().step_by(every).collect();
        let normals = target.normals().unwrap_or_default().iter().copied().step_by(every).collect();
        Self { tree: Nearest::new(&points), points, normals }
    }

    /// Distance of a point from the nearest sample, mm.
    pub(super) fn distance_mm(&self, point: &Point3<f64>) -> f64 {
        self.tree.nearest(point).map_or(f64::INFINITY, |(_, square)| square.sqrt())
    }
}

/// A scan point on the face nearest to it.
pub(super) struct OnFace {
    pair: Pair,
    /// Whether the scan has the direction of the face there.
    agrees: bool,
}

/// The points within `max_mm` of the faces, on them.
pub(super) fn on_faces(faces: &Faces, scan: &Scan, t_phantom_camera: &Isometry3<f64>, max_mm: f64) -> Vec<OnFace> {
    let on_face = |(point, direction): (&Point3<f64>, &Vector3<f64>)| {
        let phantom = t_phantom_camera * point;
        let (index, _) = faces.tree.nearest(&phantom).filter(|(_, square)| *square <= max_mm * max_mm)?;
        let normal = *faces.normals.get(index)?;
        let residual_mm = (phantom - faces.points[index]).dot(&normal);
        let per_depth = (t_phantom_camera * point.coords.normalize()).dot(&normal);
        let agrees = (t_phantom_camera * direction).dot(&normal).abs() >= SAME_FACE_COS;
        Some(OnFace { pair: Pair { phantom, normal, residual_mm, per_depth }, agrees })
    };
    let pairs: Vec<Option<OnFace>> = scan.points.par_iter().zip(&scan.normals).map(on_face).collect();
    pairs.into_iter().flatten().collect()
}

/// The pairs on faces that have the direction of the scan.
pub(super) fn agreeing(on_faces: Vec<OnFace>) -> impl Iterator<Item = Pair> {
    on_faces.into_iter().filter(|on| on.agrees).map(|on| on.pair)
}

/// Absolute distances from the nearest faces, mm, ascending.
pub(super) fn distances(on_faces: &[OnFace]) -> Vec<f64> {
    let mut distances: Vec<f64> = on_faces.iter().map(|on| on.pair.residual_mm.abs()).collect();
    distances.sort_by(f64::total_cmp);
    distances
}

/// Share of the points that count for a misfit: edges, and what stands around the phantom, are beyond.
const NEAR_SHARE: f64 = 0.8;

/// RMS of the nearest four fifths of a Gaussian's values, in standard deviations.
pub(super) const NEAR_SIGMAS: f64 = 0.661_6;

/// RMS of the distances of `n` points, each counted as at most `cap_mm`, as are those not among the distances.
pub(super) fn capped_rms_mm(distances: &[f64], n: usize, cap_mm: f64) -> f64 {
    let squares: f64 = distances.iter().map(|d| d.min(cap_mm).powi(2)).sum();
    ((squares + (n - distances.len()) as f64 * cap_mm * cap_mm) / n as f64).sqrt()
}

/// RMS of the nearest four fifths of ascending distances, mm; infinite for none.
pub(super) fn near_rms_mm(distances: &[f64]) -> f64 {
    let n = (distances.len() as f64 * NEAR_SHARE) as usize;
    (distances[..n].iter().map(|d| d * d).sum::<f64>() / n as f64).sqrt()
}
