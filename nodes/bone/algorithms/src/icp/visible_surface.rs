//! The part of a target that faces the camera.

use crate::normals;
use crate::point_grid::{All, Around, Nearby, PointFilter};
use crate::target::{Index, Subset, Target, ThinnedTarget};
use nalgebra::{Point3, Vector3};
use std::{borrow::Cow, sync::OnceLock};

/// Sine of the angle past the silhouette up to which a target point counts as visible. 0.34: 20 degrees, more than a start is
/// off.
const PAST_SILHOUETTE: f64 = 0.34;

/// Mean cosine between normals and directions from the centroid, below which the side of the normals is unknown (a flat or
/// open surface). A ball has 1, a bone thirty times as long as thick 0.05.
const OUTWARD_SHARE: f64 = 0.02;

/// Normals are estimated within this many pair distances of the scan's start.
const ESTIMATED_REACH: f64 = 4.0;

/// The target points that face the camera, all of them without a camera, with a normal for each (zero where unknown).
pub(super) struct VisibleSurface<'a> {
    pub(super) index: &'a Index,
    pub(super) normals: Cow<'a, [Vector3<f64>]>,
    /// The normals in the order of the cells: neighbours in space are neighbours in memory.
    cell_normals: Option<&'a [Vector3<f64>]>,
    camera: Option<Camera>,
    /// The visible points in a kd-tree, for searches beyond the cells.
    visible: OnceLock<Subset>,
}

/// A camera and the surface in its view.
struct Camera {
    /// Its position about the index's centre, mm.
    eye: Vector3<f64>,
    /// 1 where the normals point outwards, -1 where inwards.
    side: f64,
    /// The visible points of the thinned target.
    thinned: ThinnedTarget,
}

impl<'a> VisibleSurface<'a> {
    /// The part of `target` that faces `camera`; `near` is the scan at its start, around which missing normals are estimated.
    pub(super) fn new(target: &'a Target, camera: Option<&Point3<f64>>, near: &[Point3<f64>], pair_mm: f64) -> Self {
        let index = target.index();
        let (normals, camera) = match target.normals() {
            Some(normals) => (normals.into(), camera.and_then(|c| Camera::new(index, normals, c - index.centre))),
            None => (Cow::Owned(estimated(index, near, ESTIMATED_REACH * pair_mm)), None),
        };
        Self { index, normals, cell_normals: target.cell_normals(), camera, visible: OnceLock::new() }
    }

    /// A point and its normal, by its index and, where known, its place in the cells.
    #[inline]
    pub(super) fn point_and_normal(&self, item: u32, place: Option<u32>) -> (Vector3<f64>, Vector3<f64>) {
        match (place, self.cell_normals) {
            (Some(place), Some(normals)) => (self.index.cells().point(place), normals[place as usize]),
            _ => (self.index.local(item as usize), self.normals[item as usize]),
        }
    }

    /// Whether a surface point with this normal faces the camera; true without a camera.
    #[inline]
    pub(super) fn is_visible(&self, point: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        self.camera.as_ref().is_none_or(|camera| camera.sees(point, normal))
    }

    /// 1 if the normals point outwards, -1 if inwards; none without a camera, where that is unknown.
    pub(super) fn outward(&self) -> Option<f64> {
        self.camera.as_ref().map(|camera| camera.side)
    }

    /// The vector from a point to the camera, mm.
    pub(super) fn sight(&self, point: &Vector3<f64>) -> Option<Vector3<f64>> {
        self.camera.as_ref().map(|camera| camera.eye - point)
    }

    /// The nearest point within `limit_mm` of `query`, which is about the index's centre.
    #[inline]
    pub(super) fn nearest(&self, query: &Vector3<f64>, limit_mm: f64) -> Nearby {
        match &self.camera {
            None => self.index.nearest(query, limit_mm),
            Some(camera) => {
                let close = self.index.cells().nearest(query, limit_mm, Facing { camera, normals: &self.normals });
                close.unwrap_or_else(|| Nearby::within(limit_mm, self.visible(camera).nearest(query)))
            }
        }
    }

    /// The points around `query`, which is about the index's centre; `None` if the search would leave the nearby cells.
    #[inline]
    pub(super) fn around(&self, query: &Vector3<f64>, limit_mm: f64) -> Option<Around> {
        let cells = self.index.cells();
        match &self.camera {
            None => cells.around(query, limit_mm, All),
            Some(camera) => cells.around(query, limit_mm, Facing { camera, normals: &self.normals }),
        }
    }

    /// Index and squared distance (mm²) of the nearest point, by the kd-tree alone.
    pub(super) fn nearest_by_tree(&self, query: &Vector3<f64>) -> Option<(usize, f64)> {
        match &self.camera {
            None => self.index.tree().nearest(&Point3::from(*query)),
            Some(camera) => self.visible(camera).nearest(query),
        }
    }

    /// The nearest point of the thinned target within `limit_mm` of `query`, which is about the index's centre.
    #[inline]
    pub(super) fn nearest_thinned(&self, query: &Vector3<f64>, limit_mm: f64) -> Nearby {
        let thinned = self.camera.as_ref().map_or_else(|| self.index.thinned(), |camera| &camera.thinned);
        thinned.nearest(self.index, query, limit_mm)
    }

    fn visible(&self, camera: &Camera) -> &Subset {
        self.visible.get_or_init(|| {
            let sees = |i: &u32| camera.sees(&self.index.local(*i as usize), &self.normals[*i as usize]);
            self.index.subset((0..self.index.len() as u32).filter(sees).collect())
        })
    }
}

impl Camera {
    /// `None` if the side of the normals is unknown, or no point is visible.
    fn new(index: &Index, normals: &[Vector3<f64>], eye: Vector3<f64>) -> Option<Self> {
        let (all, items) = (index.thinned().places(), index.cells().items());
        let side = side_of_normals(index, normals, all.iter().map(|place| items[*place as usize]))?;
        let sees = |place: &u32| {
            let i = items[*place as usize] as usize;
            faces(&(eye - index.local(i)), &(normals[i] * side))
        };
        let visible: Vec<u32> = all.iter().copied().filter(sees).collect();
        (!visible.is_empty()).then(|| Self { eye, side, thinned: ThinnedTarget::new(index, visible) })
    }

    #[inline]
    fn sees(&self, point: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        faces(&(self.eye - point), &(normal * self.side))
    }
}

/// A filter for the points that face a camera.
#[derive(Clone, Copy)]
struct Facing<'a> {
    camera: &'a Camera,
    normals: &'a [Vector3<f64>],
}

impl PointFilter for Facing<'_> {
    const ALL: bool = false;

    #[inline]
    fn accepts(&self, item: u32, point: &Vector3<f64>) -> bool {
        self.camera.sees(point, &self.normals[item as usize])
    }
}

#[inline]
fn faces(sight: &Vector3<f64>, outward: &Vector3<f64>) -> bool {
    outward.dot(sight) > -PAST_SILHOUETTE * sight.norm()
}

/// 1 if the normals of these points are outward, -1 if they are inward, `None` if that is unknown.
fn side_of_normals(index: &Index, normals: &[Vector3<f64>], items: impl Iterator<Item = u32>) -> Option<f64> {
    let (mut along, mut length) = (0.0, 0.0);
    for i in items {
        let (p, n) = (index.local(i as usize), &normals[i as usize]);
        along += p.dot(n);
        length += p.norm() * n.norm();
    }
    ((along / length).abs() > OUTWARD_SHARE).then_some(along.signum())
}

/// Unoriented normals of the points within `reach_mm` of the bounding box of `near`; zero for all others.
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
