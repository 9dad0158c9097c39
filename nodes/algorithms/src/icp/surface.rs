//! The part of a target that a scan can pair with.

use crate::nearest::Nearest;
use crate::normals::plane_normal;
use crate::target::Target;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::borrow::Cow;

/// A target point may turn away from the camera by so much and still be kept: sine of the angle past the silhouette.
/// 0.34 is 20 degrees, more than a start is off.
const PAST_SILHOUETTE: f64 = 0.34;

/// The normals of a closed surface point away from its middle on average. A bone thirty times as long as thick gives
/// 0.05 of what a ball gives; below this share (a flat or open surface) nothing is known of their side.
const OUTWARD_SHARE: f64 = 0.02;

/// Neighbours that the normal of a target point is estimated from, where the target has none.
const NEIGHBOURS: usize = 10;

/// A scan that starts this many pair distances off may still find partners with estimated normals.
const REACH: f64 = 4.0;

/// Points to pair with, a normal for each (zero where unknown), and their tree.
pub(super) struct Surface<'a> {
    pub(super) points: Cow<'a, [Point3<f64>]>,
    pub(super) normals: Cow<'a, [Vector3<f64>]>,
    pub(super) tree: Nearest,
}

impl<'a> Surface<'a> {
    /// What of `target` faces `camera`, or all of it; `near` is the scan as it starts.
    pub(super) fn new(target: &'a Target, camera: Option<&Point3<f64>>, near: &[Point3<f64>], pair_mm: f64) -> Self {
        let points = target.points();
        let Some(normals) = target.normals() else {
            let normals = Cow::Owned(estimated(target, near, REACH * pair_mm));
            return Self { points: Cow::Borrowed(points), normals, tree: target.tree().clone() };
        };
        if let Some((camera, side)) = camera.zip(side(target, normals)) {
            let faces = |i: &usize| {
                let sight = camera - points[*i];
                normals[*i].dot(&sight) * side > -PAST_SILHOUETTE * sight.norm()
            };
            let kept: Vec<usize> = (0..points.len()).filter(faces).collect();
            if !kept.is_empty() {
                let points: Vec<Point3<f64>> = kept.iter().map(|&i| points[i]).collect();
                let tree = Nearest::new(&points);
                return Self { points: points.into(), normals: kept.iter().map(|&i| normals[i]).collect(), tree };
            }
        }
        Self { points: points.into(), normals: normals.into(), tree: target.tree().clone() }
    }
}

/// 1 where the normals point outwards, -1 where the faces were turned inside out, none where that cannot be told.
fn side(target: &Target, normals: &[Vector3<f64>]) -> Option<f64> {
    let centre = target.tree().centre();
    let (mut along, mut length) = (0.0, 0.0);
    for (p, n) in target.points().iter().zip(normals) {
        along += (p - centre).dot(n);
        length += (p - centre).norm() * n.norm();
    }
    ((along / length).abs() > OUTWARD_SHARE).then_some(along.signum())
}

/// Normals without a side for the points within `reach_mm` of the box around `near`, zero elsewhere.
fn estimated(target: &Target, near: &[Point3<f64>], reach_mm: f64) -> Vec<Vector3<f64>> {
    let (min, max) = near.iter().fold((near[0], near[0]), |(min, max), p| (min.inf(p), max.sup(p)));
    let reach = Vector3::repeat(reach_mm);
    let (min, max) = (min - reach, max + reach);
    let points = target.points();
    let normal = |p: &Point3<f64>| {
        if (0..3).any(|k| p[k] < min[k] || p[k] > max[k]) {
            return Vector3::zeros();
        }
        let around: Vec<Point3<f64>> =
            target.tree().nearest_n(p, NEIGHBOURS).into_iter().map(|(i, _)| points[i]).collect();
        plane_normal(&around).unwrap_or_else(Vector3::zeros)
    };
    points.par_iter().map(normal).collect()
}
