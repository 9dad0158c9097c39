//! The part of a target that faces the camera.

use super::IcpError;
use crate::normals;
use crate::point_grid::{All, Around, Nearby, PointFilter};
use crate::target::{Index, Side, Subset, Target, ThinnedTarget};
use nalgebra::{Point3, Vector3};
use std::{borrow::Cow, sync::OnceLock};

/// Sine of the angle past the silhouette up to which a target point counts as visible. 0.34: 20 degrees, more than a start is
/// off.
const PAST_SILHOUETTE: f64 = 0.34;

/// About as many points of the scan at its start tell the side of an open surface, and the number of them needed.
const N_TOLD: usize = 1000;
const MIN_TOLD: usize = 20;

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
    /// The part of `target` that faces `camera`; `near` is the scan at its start, around which missing normals are estimated, and
    /// beside which an open cloud faces the camera.
    ///
    /// # Errors
    /// [`IcpError::NothingFaces`].
    pub(super) fn new(
        target: &'a Target,
        camera: Option<&Point3<f64>>,
        near: &[Point3<f64>],
        pair_mm: f64,
    ) -> Result<Self, IcpError> {
        let index = target.index();
        let (normals, camera): (Cow<'_, [Vector3<f64>]>, _) = match (target.normals(), camera) {
            (Some(normals), Some(camera)) => {
                let beside = || Beside::new(target, normals, camera, near, pair_mm);
                let side = match target.side() {
                    Side::Outward => Some(1.0),
                    Side::Inward => Some(-1.0),
                    Side::Stated if target.is_open() => beside().believed().map(Some)?,
                    Side::Stated => Some(1.0),
                    Side::Unknown => beside().side(),
                };
                let camera = side.map(|side| Camera::new(index, normals, camera - index.centre, side)).transpose()?;
                (normals.into(), camera)
            }
            (Some(normals), None) => (normals.into(), None),
            (None, _) => (Cow::Owned(estimated(index, near, ESTIMATED_REACH * pair_mm)), None),
        };
        Ok(Self { index, normals, cell_normals: target.cell_normals(), camera, visible: OnceLock::new() })
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
    fn new(index: &Index, normals: &[Vector3<f64>], eye: Vector3<f64>, side: f64) -> Result<Self, IcpError> {
        let (all, items) = (index.thinned().places(), index.cells().items());
        let sees = |place: &u32| {
            let i = items[*place as usize] as usize;
            faces(&(eye - index.local(i)), &(normals[i] * side))
        };
        let visible: Vec<u32> = all.iter().copied().filter(sees).collect();
        let is_seen = !visible.is_empty();
        is_seen.then(|| Self { eye, side, thinned: ThinnedTarget::new(index, visible) }).ok_or(IcpError::NothingFaces)
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

/// An open surface beside the scan at its start.
struct Beside {
    n_source: usize,
    /// Number of points that are beside it, and of those where it faces the camera.
    n_any: usize,
    n_facing: usize,
    max_pair_distance_mm: f64,
}

impl Beside {
    fn new(
        target: &Target,
        normals: &[Vector3<f64>],
        camera: &Point3<f64>,
        near: &[Point3<f64>],
        max_pair_distance_mm: f64,
    ) -> Self {
        let some = near.iter().step_by(near.len().div_ceil(N_TOLD).max(1));
        let mut beside = Self { n_source: 0, n_any: 0, n_facing: 0, max_pair_distance_mm };
        for p in some {
            beside.n_source += 1;
            let Some((i, _)) = target.nearest(p, max_pair_distance_mm) else { continue };
            beside.n_any += 1;
            beside.n_facing += usize::from(normals[i].dot(&(camera - target.points()[i])) > 0.0);
        }
        beside
    }

    /// 1 if most normals point to the camera, -1 if they point away; none if too few points are beside the surface.
    fn side(&self) -> Option<f64> {
        (self.n_any >= MIN_TOLD).then(|| if 2 * self.n_facing >= self.n_any { 1.0 } else { -1.0 })
    }

    /// 1, as the faces say.
    ///
    /// # Errors
    /// [`IcpError::TooFewFacing`] if nearly all of them say that the camera saw the back of the surface.
    fn believed(self) -> Result<f64, IcpError> {
        let Self { n_source, n_any, n_facing, max_pair_distance_mm } = self;
        let is_back = n_any >= MIN_TOLD && 10 * n_facing < n_any;
        let error = IcpError::TooFewFacing { n_pairs: n_facing, n_source, n_any, max_pair_distance_mm };
        if is_back { Err(error) } else { Ok(1.0) }
    }
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
