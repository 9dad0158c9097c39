//! The camera's image as a grid of cells.

use crate::median::median;
use crate::nearest::Nearest;
use nalgebra::Point3;

/// Edge length of a cell in spacings of the scan's points in the image: cells within the scan nearly always have a
/// point.
const CELL: f64 = 1.3;

/// Maximum number of cells; more are due to points next to the camera.
const MAX_CELLS: f64 = 16e6;

/// The image coordinates of a point in the camera's frame; `None` behind the camera.
pub(super) fn seen(p: &Point3<f64>) -> Option<Point3<f64>> {
    (p.z > 0.0).then(|| Point3::new(p.x / p.z, p.y / p.z, 0.0))
}

/// The cells of an image that contain points of one scan.
pub(super) struct Grid {
    pub(super) corner: [f64; 2],
    pub(super) cell: f64,
    pub(super) size: [usize; 2],
    filled: Vec<bool>,
}

impl Grid {
    /// A grid whose cells follow the spacing of these points, filled by them; `None` if they have no spacing.
    pub(super) fn over(flat: &[Point3<f64>]) -> Option<Self> {
        let first = *flat.first()?;
        let tree = Nearest::new(flat);
        let near = |p: &Point3<f64>| tree.nearest_n(p, 5).last().map_or(0.0, |(_, square)| square.sqrt());
        let step = median(&mut flat.iter().step_by(flat.len().div_ceil(1000)).map(near).collect::<Vec<_>>());
        let (min, max) = flat.iter().fold((first, first), |(min, max), p| (min.inf(p), max.sup(p)));
        let cell = CELL * step;
        let extent = [0, 1].map(|k| ((max[k] - min[k]) / cell).floor() + 1.0);
        if step <= 0.0 || extent[0] * extent[1] > MAX_CELLS {
            return None;
        }
        let empty = Self { corner: [min.x, min.y], cell, size: extent.map(|e| e as usize), filled: Vec::new() };
        Some(empty.with(flat.iter()))
    }

    /// A grid of the same layout, filled by other points.
    pub(super) fn with<'a>(&self, flat: impl Iterator<Item = &'a Point3<f64>>) -> Self {
        let mut filled = vec![false; self.size[0] * self.size[1]];
        for [x, y] in flat.filter_map(|p| self.place(p)) {
            filled[y * self.size[0] + x] = true;
        }
        Self { filled, ..*self }
    }

    /// The cell of a point.
    pub(super) fn place(&self, flat: &Point3<f64>) -> Option<[usize; 2]> {
        let [x, y] = [0, 1].map(|k| (flat[k] - self.corner[k]) / self.cell);
        let inside = x >= 0.0 && y >= 0.0 && (x as usize) < self.size[0] && (y as usize) < self.size[1];
        inside.then_some([x as usize, y as usize])
    }

    pub(super) fn is_filled(&self, [x, y]: [usize; 2]) -> bool {
        self.filled[y * self.size[0] + x]
    }

    pub(super) fn n_filled(&self) -> usize {
        self.filled.iter().filter(|f| **f).count()
    }
}
