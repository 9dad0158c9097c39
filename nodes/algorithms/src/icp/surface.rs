//! The part of a target that a scan can pair with.

use crate::normals;
use crate::target::{Index, Target};
use nalgebra::{Point3, Vector3};
use std::{borrow::Cow, ops::Deref};

/// A target point may turn away from the camera by so much and still be kept: sine of the angle past the silhouette.
/// 0.34 is 20 degrees, more than a start is off.
const PAST_SILHOUETTE: f64 = 0.34;

/// The normals of a closed surface point away from its middle on average. A bone thirty times as long as thick gives
/// 0.05 of what a ball gives; below this share (a flat or open surface) nothing is known of their side.
const OUTWARD_SHARE: f64 = 0.02;

/// A scan that starts this many pair distances off may still find partners with estimated normals.
const REACH: f64 = 4.0;

/// Points to pair with, and a normal for each (zero where unknown).
pub(super) struct Surface<'a> {
    pub(super) index: Shared<'a>,
    pub(super) normals: Cow<'a, [Vector3<f64>]>,
    /// Where the camera stood, about the index's centre, and 1 where the normals point outwards, -1 where inwards.
    pub(super) camera: Option<(Vector3<f64>, f64)>,
}

/// An index of the whole target or of a part of it.
pub(super) enum Shared<'a> {
    Whole(&'a Index),
    Part(Box<Index>),
}

impl Deref for Shared<'_> {
    type Target = Index;

    #[inline]
    fn deref(&self) -> &Index {
        match self {
            Shared::Whole(index) => index,
            Shared::Part(index) => index,
        }
    }
}

impl<'a> Surface<'a> {
    /// What of `target` faces `camera`, or all of it; `near` is the scan as it starts.
    pub(super) fn new(target: &'a Target, camera: Option<&Point3<f64>>, near: &[Point3<f64>], pair_mm: f64) -> Self {
        let points = target.points();
        let whole = Shared::Whole(target.index());
        let Some(normals) = target.normals() else {
            let normals = Cow::Owned(estimated(target, near, REACH * pair_mm));
            return Self { index: whole, normals, camera: None };
        };
        let centre = whole.centre;
        let camera = camera.and_then(|camera| Some((camera - centre, side(target, normals)?)));
        let Some((eye, side)) = camera else { return Self { index: whole, normals: normals.into(), camera: None } };
        let kept: Vec<usize> =
            (0..points.len()).filter(|&i| faces(&(eye - whole.local[i]), &(normals[i] * side))).collect();
        if kept.is_empty() || kept.len() == points.len() {
            return Self { index: whole, normals: normals.into(), camera };
        }
        let points: Vec<Point3<f64>> = kept.iter().map(|&i| points[i]).collect();
        let index = Index::new(&points);
        let camera = Some((eye + (centre - index.centre), side));
        let normals: Vec<Vector3<f64>> = kept.iter().map(|&i| normals[i]).collect();
        Self { index: Shared::Part(Box::new(index)), normals: normals.into(), camera }
    }

    /// Whether a place on the surface with this normal may be seen by the camera; true without one.
    #[inline]
    pub(super) fn faces(&self, at: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        self.camera.is_none_or(|(eye, side)| faces(&(eye - at), &(normal * side)))
    }
}

#[inline]
fn faces(sight: &Vector3<f64>, outward: &Vector3<f64>) -> bool {
    outward.dot(sight) > -PAST_SILHOUETTE * sight.norm()
}

/// 1 where the normals point outwards, -1 where the faces were turned inside out, none where that cannot be told.
fn side(target: &Target, normals: &[Vector3<f64>]) -> Option<f64> {
    let (mut along, mut length) = (0.0, 0.0);
    for (p, n) in target.index().local.iter().zip(normals) {
        along += p.dot(n);
        length += p.norm() * n.norm();
    }
    ((along / length).abs() > OUTWARD_SHARE).then_some(along.signum())
}

/// Normals without a side for the points within `reach_mm` of the box around `near`, zero elsewhere.
fn estimated(target: &Target, near: &[Point3<f64>], reach_mm: f64) -> Vec<Vector3<f64>> {
    let (min, max) = near.iter().fold((near[0], near[0]), |(min, max), p| (min.inf(p), max.sup(p)));
    let reach = Vector3::repeat(reach_mm);
    let index = target.index();
    let (min, max) = (min - reach - index.centre, max + reach - index.centre);
    let inside = |p: &Vector3<f64>| (0..3).all(|k| p[k] >= min[k] && p[k] <= max[k]);
    let inside: Vec<usize> = (0..index.local.len()).filter(|&i| inside(&index.local[i])).collect();
    let places: Vec<Vector3<f64>> = inside.iter().map(|&i| index.local[i]).collect();
    let mut all = vec![Vector3::zeros(); index.local.len()];
    for (i, normal) in inside.into_iter().zip(normals::without_side(&places)) {
        all[i] = normal;
    }
    all
}
