//! The part of a target that a scan can pair with.

use crate::cells::{All, Around, Keep, Nearby};
use crate::normals;
use crate::target::{Index, Subset, Target};
use nalgebra::{Point3, Vector3};
use std::{borrow::Cow, sync::OnceLock};

/// A target point may turn away from the camera by so much and still be kept: sine of the angle past the silhouette.
/// 0.34 is 20 degrees, more than a start is off.
const PAST_SILHOUETTE: f64 = 0.34;

/// The normals of a closed surface point away from its middle on average. A bone thirty times as long as thick gives
/// 0.05 of what a ball gives; below this share (a flat or open surface) nothing is known of their side.
const OUTWARD_SHARE: f64 = 0.02;

/// A scan that starts this many pair distances off may still find partners with estimated normals.
const REACH: f64 = 4.0;

/// Points to pair with, and a normal for each (zero where unknown); of those that face the camera, where that is known.
pub(super) struct Surface<'a> {
    pub(super) index: &'a Index,
    pub(super) normals: Cow<'a, [Vector3<f64>]>,
    /// The same in the order of the cells, so that neighbours in space are neighbours in memory.
    along: Option<&'a [Vector3<f64>]>,
    camera: Option<Camera>,
    /// What faces the camera, for searches beyond the cells.
    facing: OnceLock<Subset>,
}

/// What a camera sees of a surface.
struct Camera {
    /// Where it stood, about the index's centre, mm.
    eye: Vector3<f64>,
    /// 1 where the normals point outwards, -1 where inwards.
    side: f64,
    /// A few of the points that face it.
    thin: Subset,
}

impl<'a> Surface<'a> {
    /// What of `target` faces `camera`, or all of it; `near` is the scan as it starts.
    pub(super) fn new(target: &'a Target, camera: Option<&Point3<f64>>, near: &[Point3<f64>], pair_mm: f64) -> Self {
        let index = target.index();
        let (normals, camera) = match target.normals() {
            Some(normals) => (normals.into(), camera.and_then(|c| Camera::new(index, normals, c - index.centre))),
            None => (Cow::Owned(estimated(index, near, REACH * pair_mm)), None),
        };
        Self { index, normals, along: target.normals_along(), camera, facing: OnceLock::new() }
    }

    /// A point and its normal, by its index and its place in the cells.
    #[inline]
    pub(super) fn point_and_normal(&self, item: u32, at: Option<u32>) -> (Vector3<f64>, Vector3<f64>) {
        match (at, self.along) {
            (Some(at), Some(along)) => (self.index.cells().point(at), along[at as usize]),
            _ => (self.index.local(item as usize), self.normals[item as usize]),
        }
    }

    /// Whether a place on the surface with this normal may be seen by the camera; true without one.
    #[inline]
    pub(super) fn faces(&self, at: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        self.camera.as_ref().is_none_or(|camera| camera.may_see(at, normal))
    }

    /// From a place to where the camera stood, mm.
    pub(super) fn sight(&self, at: &Vector3<f64>) -> Option<Vector3<f64>> {
        self.camera.as_ref().map(|camera| camera.eye - at)
    }

    /// The nearest point no farther than `limit_mm` from `query`, which is about the index's centre.
    #[inline]
    pub(super) fn nearest(&self, query: &Vector3<f64>, limit_mm: f64) -> Nearby {
        match &self.camera {
            None => self.index.nearest(query, limit_mm),
            Some(camera) => {
                let close = self.index.cells().nearest(query, limit_mm, Facing { camera, normals: &self.normals });
                close.unwrap_or_else(|| Nearby::within(limit_mm, self.facing(camera).nearest(query)))
            }
        }
    }

    /// The points around `query`, which is about the index's centre, if they are near.
    #[inline]
    pub(super) fn around(&self, query: &Vector3<f64>, limit_mm: f64) -> Option<Around> {
        let cells = self.index.cells();
        match &self.camera {
            None => cells.around(query, limit_mm, All),
            Some(camera) => cells.around(query, limit_mm, Facing { camera, normals: &self.normals }),
        }
    }

    /// Index and squared distance (mm²) of the nearest point, by a search tree alone.
    pub(super) fn nearest_by_tree(&self, query: &Vector3<f64>) -> Option<(usize, f64)> {
        match &self.camera {
            None => self.index.tree().nearest(&Point3::from(*query)),
            Some(camera) => self.facing(camera).nearest(query),
        }
    }

    /// The same among a few of the points.
    pub(super) fn nearest_of_few(&self, query: &Vector3<f64>) -> Option<(usize, f64)> {
        self.camera.as_ref().map_or_else(|| self.index.thin(), |camera| &camera.thin).nearest(query)
    }

    fn facing(&self, camera: &Camera) -> &Subset {
        self.facing.get_or_init(|| {
            let sees = |i: &u32| camera.may_see(&self.index.local(*i as usize), &self.normals[*i as usize]);
            self.index.subset((0..self.index.len() as u32).filter(sees).collect())
        })
    }
}

impl Camera {
    /// None where it cannot be told what it sees, or it sees nothing.
    fn new(index: &Index, normals: &[Vector3<f64>], eye: Vector3<f64>) -> Option<Self> {
        let all = index.thin().items();
        let side = side(index, normals, all)?;
        let sees = |i: &u32| faces(&(eye - index.local(*i as usize)), &(normals[*i as usize] * side));
        let seen: Vec<u32> = all.iter().copied().filter(sees).collect();
        (!seen.is_empty()).then(|| Self { eye, side, thin: index.subset(seen) })
    }

    #[inline]
    fn may_see(&self, at: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        faces(&(self.eye - at), &(normal * self.side))
    }
}

/// Points that face a camera.
#[derive(Clone, Copy)]
struct Facing<'a> {
    camera: &'a Camera,
    normals: &'a [Vector3<f64>],
}

impl Keep for Facing<'_> {
    const ALL: bool = false;

    #[inline]
    fn keeps(&self, item: u32, point: &Vector3<f64>) -> bool {
        self.camera.may_see(point, &self.normals[item as usize])
    }
}

#[inline]
fn faces(sight: &Vector3<f64>, outward: &Vector3<f64>) -> bool {
    outward.dot(sight) > -PAST_SILHOUETTE * sight.norm()
}

/// 1 where the normals point outwards, -1 where the faces were turned inside out, none where that cannot be told; from
/// these points.
fn side(index: &Index, normals: &[Vector3<f64>], items: &[u32]) -> Option<f64> {
    let (mut along, mut length) = (0.0, 0.0);
    for &i in items {
        let (p, n) = (index.local(i as usize), &normals[i as usize]);
        along += p.dot(n);
        length += p.norm() * n.norm();
    }
    ((along / length).abs() > OUTWARD_SHARE).then_some(along.signum())
}

/// Normals without a side for the points within `reach_mm` of the box around `near`, zero elsewhere.
fn estimated(index: &Index, near: &[Point3<f64>], reach_mm: f64) -> Vec<Vector3<f64>> {
    let (min, max) = near.iter().fold((near[0], near[0]), |(min, max), p| (min.inf(p), max.sup(p)));
    let reach = Vector3::repeat(reach_mm);
    let (min, max) = (min - reach - index.centre, max + reach - index.centre);
    let inside = |p: &Vector3<f64>| (0..3).all(|k| p[k] >= min[k] && p[k] <= max[k]);
    let inside: Vec<usize> = (0..index.len()).filter(|&i| inside(&index.local(i))).collect();
    let places: Vec<Vector3<f64>> = inside.iter().map(|&i| index.local(i)).collect();
    let mut all = vec![Vector3::zeros(); index.len()];
    for (i, normal) in inside.into_iter().zip(normals::without_side(&places)) {
        all[i] = normal;
    }
    all
}
