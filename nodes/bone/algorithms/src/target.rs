//! A surface prepared for registration.

mod near_map;
mod side;

pub use crate::point_grid::GridColumns;
pub(crate) use near_map::{NearMap, Sample};
pub(crate) use side::Side;

use crate::Refusal;
use crate::kabsch::centroid;
use crate::mesh_query::MeshQuery;
use crate::nearest::Nearest;
use crate::point_grid::{All, Nearby, PointGrid, cell_mm};
use crate::sensor::Sensor;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Column, Frame, SurfaceOrigin, TooFar};
use std::{
    fmt,
    sync::{Arc, OnceLock},
};

/// The thinned target holds every 32nd point. A registration starts on it.
const THINNED_EVERY: usize = 32;

/// The thinned target holds at least this many points, if there are as many.
const MIN_THINNED: usize = 2000;

/// The surface that a scan is registered onto: points in mm, their unit normals where known, and an index for nearest points.
///
/// May hold the mesh that the points were drawn from. A cheap handle: clones share everything. The index is built once, at the first search or by [`Target::prepare`].
#[derive(Clone)]
pub struct Target {
    /// The frame of the points.
    pub frame: Frame,
    /// The origin of the surface.
    pub origin: SurfaceOrigin,
    points: Column<Point3<f64>>,
    normals: Option<Column<Vector3<f64>>>,
    mesh: Option<MeshQuery>,
    index: Arc<OnceLock<Index>>,
    side: Arc<OnceLock<Side>>,
    sensor: Option<Arc<Sensor>>,
}

impl Target {
    /// A target of `points` in `frame`, with one unit normal for each point where they are known.
    ///
    /// `O(n)`.
    ///
    /// # Errors
    /// [`Refusal`] if there are no points, a number is not finite, or normals and points differ in number.
    pub fn new(
        frame: impl Into<Frame>,
        origin: SurfaceOrigin,
        points: impl Into<Column<Point3<f64>>>,
        normals: Option<Column<Vector3<f64>>>,
    ) -> Result<Self, Refusal> {
        let (frame, points) = (frame.into(), points.into());
        if points.is_empty() {
            let reason = "the target has no points; is the surface empty, or was nothing sampled from it?";
            return Err(Refusal::of(reason));
        }
        if let Some(normals) = normals.as_ref().filter(|n| n.len() != points.len()) {
            let (n_points, n_normals) = (points.len(), normals.len());
            return Err(Refusal::of(format!("the target has {n_normals} normals for {n_points} points")));
        }
        let wild = |v: &Vector3<f64>| !v.iter().all(|c| c.is_finite());
        let wild_point = points.iter().position(|p| wild(&p.coords));
        let wild_normal = normals.as_ref().and_then(|n| n.iter().position(wild));
        if let Some(index) = wild_point.or(wild_normal) {
            return Err(Refusal::of(format!(
                "target point {index} is not finite; drop it before the target is prepared"
            )));
        }
        if let Some((index, far)) = TooFar::first(&points) {
            return Err(Refusal::of(format!("target point {index}: {far}")));
        }
        let index = Arc::new(OnceLock::new());
        Ok(Self { frame, origin, points, normals, mesh: None, index, side: Arc::default(), sensor: None })
    }

    /// The target with the mesh that its points were drawn from, in the same frame.
    pub fn with_mesh(self, mesh: MeshQuery) -> Self {
        Self { mesh: Some(mesh), side: Arc::default(), ..self }
    }

    /// The target with what the scan is measured with, for whose tip it was moved.
    pub fn for_sensor(self, sensor: Option<Sensor>) -> Self {
        Self { sensor: sensor.map(Arc::new), ..self }
    }

    /// What the scan is measured with, if it is stated.
    pub fn sensor(&self) -> Option<&Sensor> {
        self.sensor.as_deref()
    }

    /// The mesh that the points were drawn from, if given.
    pub fn mesh(&self) -> Option<&MeshQuery> {
        self.mesh.as_ref()
    }

    /// Builds the index for `pairing = "cached"`: the cells and the thinned target.
    ///
    /// `O(n)`.
    pub fn prepare(&self) {
        let index = self.index();
        index.thinned();
        if let Some(normals) = &self.normals {
            index.normals.get_or_init(|| index.cells().items().iter().map(|&i| normals[i as usize]).collect());
        }
    }

    /// Normals in the order of the cells, if [`Target::prepare`] was called.
    pub(crate) fn cell_normals(&self) -> Option<&[Vector3<f64>]> {
        self.index().normals.get().map(Vec::as_slice)
    }

    pub(crate) fn index(&self) -> &Index {
        self.index.get_or_init(|| Index::new(&self.points))
    }

    /// The points, `n`, mm.
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Unit normals, one for each point, if known.
    pub fn normals(&self) -> Option<&[Vector3<f64>]> {
        self.normals.as_deref()
    }

    /// The points as a column that can be shared.
    pub fn point_column(&self) -> &Column<Point3<f64>> {
        &self.points
    }

    /// The normals as a column that can be shared.
    pub fn normal_column(&self) -> Option<&Column<Vector3<f64>>> {
        self.normals.as_ref()
    }

    /// Index and distance (mm) of the point nearest to `point` within `max_mm`.
    pub fn nearest(&self, point: &Point3<f64>, max_mm: f64) -> Option<(usize, f64)> {
        let index = self.index();
        let (found, squared) = index.nearest(&(point - index.centre), max_mm).nearest?;
        Some((found as usize, squared.sqrt()))
    }

    /// The point grid as columns; built now if it was not.
    pub fn grid_columns(&self) -> GridColumns {
        self.index().cells().to_columns()
    }

    /// The target with the cells of these columns. `O(n)`.
    ///
    /// # Errors
    /// [`Refusal`] if they are not the grid of these points.
    pub fn with_grid_columns(self, columns: &GridColumns) -> Result<Self, Refusal> {
        let index = Index::new(&self.points);
        let grid = PointGrid::from_columns(&self.points, &index.centre, columns);
        let cells = OnceLock::from(grid.map_err(|what| {
            Refusal::of(format!("the target's stored index is damaged: {what}; prepare the target again"))
        })?);
        let index = Index { cells, cell_mm: OnceLock::from(columns.cell_mm), ..index };
        Ok(Self { index: Arc::new(OnceLock::from(index)), ..self })
    }
}

impl PartialEq for Target {
    fn eq(&self, other: &Self) -> bool {
        self.frame == other.frame
            && self.origin == other.origin
            && self.points == other.points
            && self.normals == other.normals
            && self.sensor == other.sensor
    }
}

impl fmt::Debug for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Target({} points in {}, {})", self.points.len(), self.frame, self.origin)
    }
}

/// An index for nearest points. Positions are about the points' centroid, so that they are exact far from the origin.
///
/// Each structure is built at its first use, by the one thread that asks first (see [`Nearest::about`]).
pub(crate) struct Index {
    pub(crate) centre: Point3<f64>,
    points: Column<Point3<f64>>,
    cell_mm: OnceLock<f64>,
    cells: OnceLock<PointGrid>,
    /// In the order of the cells.
    normals: OnceLock<Vec<Vector3<f64>>>,
    thinned: OnceLock<ThinnedTarget>,
    tree: OnceLock<Nearest>,
    near_map: OnceLock<NearMap>,
}

/// A part of the points, evenly spread, in cells of its own.
pub(crate) struct ThinnedTarget {
    /// Places of the points in the order of all cells.
    places: Vec<u32>,
    cells: PointGrid,
    /// For searches beyond the cells.
    tree: OnceLock<Nearest>,
}

/// A subset of the points in a kd-tree.
pub(crate) struct Subset {
    items: Vec<u32>,
    tree: Nearest,
}

impl Index {
    pub(crate) fn new(points: &Column<Point3<f64>>) -> Self {
        let (cell_mm, cells, normals, thinned, tree, near_map) = Default::default();
        Self { centre: centroid(points), points: points.clone(), cell_mm, cells, normals, thinned, tree, near_map }
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// A point about the centre, mm.
    #[inline]
    pub(crate) fn local(&self, item: usize) -> Vector3<f64> {
        self.points[item] - self.centre
    }

    /// The edge of the cells, mm: a little more than the spacing of the points.
    pub(crate) fn cell_mm(&self) -> f64 {
        *self.cell_mm.get_or_init(|| cell_mm(&self.points, &self.centre))
    }

    pub(crate) fn cells(&self) -> &PointGrid {
        self.cells.get_or_init(|| PointGrid::new(&self.points, &self.centre, self.cell_mm()))
    }

    /// The kd-tree of all points, about the centre.
    pub(crate) fn tree(&self) -> &Nearest {
        self.tree.get_or_init(|| Nearest::about(&self.centre, self.points.iter().copied()))
    }

    /// The map of `target`, whose index this is, for registration by shape alone.
    pub(crate) fn near_map(&self, target: &Target) -> &NearMap {
        self.near_map.get_or_init(|| NearMap::new(target))
    }

    /// The nearest point within `limit_mm` of `query`, which is about the centre.
    #[inline]
    pub(crate) fn nearest(&self, query: &Vector3<f64>, limit_mm: f64) -> Nearby {
        let close = self.cells().nearest(query, limit_mm, All);
        close.unwrap_or_else(|| Nearby::within(limit_mm, self.tree().nearest(&Point3::from(*query))))
    }

    /// The thinned target, evenly spread.
    pub(crate) fn thinned(&self) -> &ThinnedTarget {
        self.thinned.get_or_init(|| {
            let places = (0..self.len() as u32).step_by(self.thinned_every()).collect();
            ThinnedTarget::new(self, places)
        })
    }

    fn thinned_every(&self) -> usize {
        (self.len() / MIN_THINNED).clamp(1, THINNED_EVERY)
    }

    /// A kd-tree of these points.
    pub(crate) fn subset(&self, items: Vec<u32>) -> Subset {
        let tree = Nearest::about(&self.centre, items.iter().map(|&i| self.points[i as usize]));
        Subset { items, tree }
    }
}

impl ThinnedTarget {
    /// The points at these places in the order of the cells.
    pub(crate) fn new(index: &Index, places: Vec<u32>) -> Self {
        let cells = index.cells();
        let points: Vec<Point3<f64>> = places.iter().map(|place| cells.point(*place).into()).collect();
        let cell_mm = index.cell_mm() * (index.thinned_every() as f64).sqrt();
        Self { cells: PointGrid::new(&points, &Point3::origin(), cell_mm), places, tree: OnceLock::new() }
    }

    /// The points' places in the order of the cells.
    pub(crate) fn places(&self) -> &[u32] {
        &self.places
    }

    /// The nearest of the points within `limit_mm` of `query`, which is about the centre of the index.
    #[inline]
    pub(crate) fn nearest(&self, index: &Index, query: &Vector3<f64>, limit_mm: f64) -> Nearby {
        let nearby = self.cells.nearest(query, limit_mm, All);
        let nearby =
            nearby.unwrap_or_else(|| Nearby::within(limit_mm, self.tree(index).nearest(&Point3::from(*query))));
        let Some((thinned, square)) = nearby.nearest else { return nearby };
        let place = self.places[thinned as usize];
        Nearby { nearest: Some((index.cells().items()[place as usize], square)), at: Some(place), ..nearby }
    }

    #[cold]
    fn tree(&self, index: &Index) -> &Nearest {
        let points = || self.places.iter().map(|place| Point3::from(index.cells().point(*place)));
        self.tree.get_or_init(|| Nearest::about(&Point3::origin(), points()))
    }
}

impl Subset {
    /// Index among all points and squared distance (mm²) of the nearest point of the subset.
    pub(crate) fn nearest(&self, query: &Vector3<f64>) -> Option<(usize, f64)> {
        let (found, square) = self.tree.nearest(&Point3::from(*query))?;
        Some((self.items[found] as usize, square))
    }
}
