//! A surface prepared for registration.

use crate::nearest::Nearest;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Column, Frame, SurfaceOrigin};
use std::fmt;

/// What a scan is registered onto: points in mm, their unit normals where known, and a search tree over them.
///
/// A cheap handle: clones share everything.
#[derive(Clone)]
pub struct Target {
    /// The frame of the points.
    pub frame: Frame,
    /// Where the surface comes from.
    pub origin: SurfaceOrigin,
    points: Column<Point3<f64>>,
    normals: Option<Column<Vector3<f64>>>,
    tree: Nearest,
}

/// Points that make no target.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TargetError {
    /// There is no point.
    #[error("the target has no points; is the surface empty, or was nothing sampled from it?")]
    Empty,
    /// There is not one normal for each point.
    #[error("the target has {n_normals} normals for {n_points} points")]
    Normals {
        /// The number of points.
        n_points: usize,
        /// The number of normals.
        n_normals: usize,
    },
    /// A point or normal is NaN or infinite.
    #[error("target point {index} is not finite; drop it before the target is prepared")]
    NotFinite {
        /// The first such point.
        index: usize,
    },
}

impl Target {
    /// A target of `points` in `frame`, with one unit normal for each point where they are known.
    ///
    /// `O(n log n)`, on all threads of the current pool.
    ///
    /// # Errors
    /// [`TargetError`] if there are no points, a number is not finite, or normals and points differ in number.
    pub fn new(
        frame: impl Into<Frame>,
        origin: SurfaceOrigin,
        points: impl Into<Column<Point3<f64>>>,
        normals: Option<Column<Vector3<f64>>>,
    ) -> Result<Self, TargetError> {
        let points = points.into();
        if points.is_empty() {
            return Err(TargetError::Empty);
        }
        if let Some(normals) = normals.as_ref().filter(|n| n.len() != points.len()) {
            return Err(TargetError::Normals { n_points: points.len(), n_normals: normals.len() });
        }
        let wild = |v: &Vector3<f64>| !v.iter().all(|c| c.is_finite());
        let wild_point = points.iter().position(|p| wild(&p.coords));
        let wild_normal = normals.as_ref().and_then(|n| n.iter().position(wild));
        if let Some(index) = wild_point.or(wild_normal) {
            return Err(TargetError::NotFinite { index });
        }
        let tree = Nearest::new(&points);
        Ok(Self { frame: frame.into(), origin, points, normals, tree })
    }

    /// The points, `n`, mm.
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Unit normals, one for each point, where known.
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

    /// Index and distance (mm) of the point nearest to `point`, if it is no farther than `max_mm`.
    pub fn nearest(&self, point: &Point3<f64>, max_mm: f64) -> Option<(usize, f64)> {
        let (index, squared) = self.tree.nearest(point)?;
        let distance = squared.sqrt();
        (distance <= max_mm).then_some((index, distance))
    }

    /// The tree over the points.
    pub fn tree(&self) -> &Nearest {
        &self.tree
    }
}

impl PartialEq for Target {
    fn eq(&self, other: &Self) -> bool {
        self.frame == other.frame
            && self.origin == other.origin
            && self.points == other.points
            && self.normals == other.normals
    }
}

impl fmt::Debug for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Target({} points in {}, {})", self.points.len(), self.frame, self.origin)
    }
}
