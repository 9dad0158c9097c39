//! Nearest neighbours by a uniform grid with a list of the points in each cell.

mod around;
mod lanes;

pub(crate) use around::Around;

use lanes::Lanes;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Column;

/// Mean number of points in an occupied cell: fewer cost look-ups of cells, more cost distances.
const PER_CELL: f64 = 2.0;

/// Cells along each edge of a block; only blocks that hold points have cells.
const EDGE: u32 = 4;
const CELLS: u32 = EDGE * EDGE * EDGE;

/// Maximum number of blocks, occupied or not: 16 MiB. Wider clouds get larger cells.
const MAX_BLOCKS: f64 = (1 << 22) as f64;

/// Maximum distance of a search, in cells from its own; beyond, a kd-tree is faster.
const MAX_RING: i32 = 4;

const NONE: u32 = u32::MAX;

/// Points sorted by the cells of a uniform grid, relative to a centre, mm.
///
/// Finds the nearest point of a surface in a few dozen nanoseconds, if it is not farther than a few cells.
/// Source: Bentley, Weide and Yao 1980; the second neighbour's distance is kept as in Greenspan and Godin 2001.
pub(crate) struct PointGrid {
    cell_mm: f64,
    min: Vector3<f64>,
    max: Vector3<f64>,
    n_blocks: [u32; 3],
    /// For each block of the grid its index among the occupied blocks, or `NONE`.
    blocks: Vec<u32>,
    /// Index of the first point of each cell of each occupied block, followed by the number of points.
    starts: Vec<u32>,
    points: Vec<Vector3<f64>>,
    /// The points in single precision.
    lanes: Lanes,
    /// The index in the input of each point.
    items: Vec<u32>,
}

/// The cells of a [`PointGrid`] as flat columns, without the points.
#[derive(Debug, Clone, PartialEq)]
pub struct GridColumns {
    /// Edge length of a cell, mm.
    pub cell_mm: f64,
    /// Indices of the occupied blocks of 4 × 4 × 4 cells, in the order of the grid (z fastest).
    pub blocks: Column<u32>,
    /// Index among the items of the first point of each cell of each occupied block, followed by the number of points.
    pub starts: Column<u32>,
    /// Indices of the points, sorted by cell.
    pub items: Column<u32>,
}

/// The nearest point to a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Nearby {
    /// Index and squared distance (mm²) of the nearest point; the lowest index in case of a tie.
    pub(crate) nearest: Option<(u32, f64)>,
    /// Its position among the sorted points, if the grid found it.
    pub(crate) at: Option<u32>,
    /// Lower bound of the squared distance to every other point, mm².
    pub(crate) free_square: f64,
}

impl Nearby {
    /// The nearest point as found by a kd-tree, if it is no farther than `limit_mm`.
    #[cold]
    pub(crate) fn within(limit_mm: f64, found: Option<(usize, f64)>) -> Self {
        let near = found.filter(|(_, square)| *square <= limit_mm * limit_mm);
        Self {
            nearest: near.map(|(item, square)| (item as u32, square)),
            at: None,
            free_square: found.map_or(f64::INFINITY, |(_, square)| square),
        }
    }
}

/// Selects the points that a search considers.
pub(crate) trait PointFilter: Copy {
    /// Whether all points are considered.
    const ALL: bool;

    fn accepts(&self, item: u32, point: &Vector3<f64>) -> bool;
}

#[derive(Clone, Copy)]
pub(crate) struct All;

impl PointFilter for All {
    const ALL: bool = true;

    #[inline]
    fn accepts(&self, _: u32, _: &Vector3<f64>) -> bool {
        true
    }
}

/// Points relative to a centre.
struct Centred<'a> {
    points: &'a [Point3<f64>],
    centre: &'a Point3<f64>,
}

impl Centred<'_> {
    fn len(&self) -> usize {
        self.points.len()
    }

    fn iter(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.points.iter().map(|point| point - self.centre)
    }

    /// The corners of the bounding box; zero without points.
    fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let first = self.iter().next().unwrap_or_else(Vector3::zeros);
        let (mut min, mut max) = (first, first);
        for p in self.iter() {
            for k in 0..3 {
                min[k] = if p[k] < min[k] { p[k] } else { min[k] };
                max[k] = if p[k] > max[k] { p[k] } else { max[k] };
            }
        }
        (min, max)
    }
}

/// Edge length of cells that hold the preferred number of these points, mm. `O(n)`.
pub(crate) fn cell_mm(points: &[Point3<f64>], centre: &Point3<f64>) -> f64 {
    let points = Centred { points, centre };
    let (min, max) = points.bounds();
    // The number of cells that a surface occupies is inversely proportional to the square of their size.
    let trial_mm = ((max - min).max() / 256.0).max(f64::MIN_POSITIVE.sqrt());
    let grid = PointGrid::without_points(&points, trial_mm);
    let mut occupied = vec![0_u64; grid.blocks.len()];
    for point in points.iter() {
        let (block, cell) = grid.place(&grid.cell_of(&point));
        occupied[block as usize] |= 1 << cell;
    }
    let n_occupied = occupied.iter().map(|block| block.count_ones()).sum::<u32>().max(1);
    let wanted_mm = trial_mm * (PER_CELL * f64::from(n_occupied) / points.len().max(1) as f64).sqrt();
    large_enough(&(max - min), wanted_mm)
}

/// The given edge length, enlarged where it would make too many cells, mm.
fn large_enough(extent: &Vector3<f64>, mut cell_mm: f64) -> f64 {
    let n_blocks = |mm: f64| extent.iter().map(|e| (e / (mm * f64::from(EDGE))).floor() + 1.0).product::<f64>();
    while n_blocks(cell_mm) > MAX_BLOCKS {
        cell_mm *= 1.5;
    }
    cell_mm
}

impl PointGrid {
    /// An empty grid around the points; cells are enlarged where they would be too many.
    fn without_points(points: &Centred<'_>, cell_mm: f64) -> Self {
        let (min, max) = points.bounds();
        let extent = max - min;
        let cell_mm = large_enough(&extent, cell_mm);
        let n_blocks = [0, 1, 2].map(|k| (extent[k] / (cell_mm * f64::from(EDGE))) as u32 + 1);
        Self {
            cell_mm,
            min,
            max,
            n_blocks,
            blocks: vec![NONE; n_blocks.iter().map(|n| *n as usize).product()],
            starts: Vec::new(),
            points: Vec::new(),
            lanes: Lanes::new(&[], 0.0),
            items: Vec::new(),
        }
    }

    /// Sorts finite `points` into cells. `O(n)`.
    pub(crate) fn new(points: &[Point3<f64>], centre: &Point3<f64>, cell_mm: f64) -> Self {
        let points = Centred { points, centre };
        let mut cells = Self::without_points(&points, cell_mm);
        let places: Vec<(u32, u32)> = points.iter().map(|p| cells.place(&cells.cell_of(&p))).collect();
        for (block, _) in &places {
            cells.blocks[*block as usize] = 0;
        }
        let mut n_occupied = 0;
        for block in cells.blocks.iter_mut().filter(|b| **b != NONE) {
            *block = n_occupied;
            n_occupied += 1;
        }
        let slot = |blocks: &[u32], (block, cell): (u32, u32)| (blocks[block as usize] * CELLS + cell) as usize;
        cells.starts = vec![0; (n_occupied * CELLS) as usize + 1];
        for place in &places {
            cells.starts[slot(&cells.blocks, *place) + 1] += 1;
        }
        for k in 1..cells.starts.len() {
            cells.starts[k] += cells.starts[k - 1];
        }
        let mut next = cells.starts.clone();
        cells.points = vec![Vector3::zeros(); points.len()];
        cells.items = vec![0; points.len()];
        for (item, (point, place)) in (0_u32..).zip(points.iter().zip(&places)) {
            let at = &mut next[slot(&cells.blocks, *place)];
            cells.points[*at as usize] = point;
            cells.items[*at as usize] = item;
            *at += 1;
        }
        cells.lanes = Lanes::new(&cells.points, cells.min.abs().sup(&cells.max.abs()).max());
        cells
    }

    /// The cells as columns.
    pub(crate) fn to_columns(&self) -> GridColumns {
        let held = (0_u32..).zip(&self.blocks).filter(|(_, number)| **number != NONE);
        GridColumns {
            cell_mm: self.cell_mm,
            blocks: held.map(|(block, _)| block).collect(),
            starts: self.starts.clone().into(),
            items: self.items.clone().into(),
        }
    }

    /// The grid of finite `points` with the cells of its columns; the error says why they do not belong to these points.
    ///
    /// The points are sorted anew, so damaged columns never give a wrong neighbour. `O(n)`.
    pub(crate) fn from_columns(
        points: &[Point3<f64>],
        centre: &Point3<f64>,
        columns: &GridColumns,
    ) -> Result<Self, String> {
        let cell_mm = columns.cell_mm;
        if !(cell_mm > 0.0 && cell_mm.is_finite()) {
            return Err(format!("its cells are {cell_mm} mm large"));
        }
        let cells = Self::new(points, centre, cell_mm);
        if cells.to_columns() != *columns {
            return Err("its cells are not those of its points".into());
        }
        Ok(cells)
    }

    /// The `at`-th of the sorted points.
    #[inline]
    pub(crate) fn point(&self, at: u32) -> Vector3<f64> {
        self.points[at as usize]
    }

    /// Indices in the input of the sorted points; neighbours in this order are mostly neighbours in space.
    pub(crate) fn items(&self) -> &[u32] {
        &self.items
    }

    fn cell(&self, v: &Vector3<f64>) -> [i32; 3] {
        let u = (v - self.min) / self.cell_mm;
        [u.x.floor() as i32, u.y.floor() as i32, u.z.floor() as i32]
    }

    /// The cell of a point within the grid. Coordinates are not negative, so truncation rounds down.
    #[inline]
    fn cell_of(&self, point: &Vector3<f64>) -> [i32; 3] {
        let u = (point - self.min) / self.cell_mm;
        [u.x as i32, u.y as i32, u.z as i32]
    }

    /// The block of a cell within the grid, and the index of the cell in the block.
    #[inline]
    fn place(&self, cell: &[i32; 3]) -> (u32, u32) {
        let [x, y, z] = cell.map(|c| c as u32);
        let block = ((x / EDGE) * self.n_blocks[1] + y / EDGE) * self.n_blocks[2] + z / EDGE;
        (block, ((x % EDGE) * EDGE + y % EDGE) * EDGE + z % EDGE)
    }

    #[inline]
    fn range(&self, cell: [i32; 3]) -> std::ops::Range<usize> {
        if (0..3).any(|k| cell[k] < 0 || cell[k] as u32 >= self.n_blocks[k] * EDGE) {
            return 0..0;
        }
        self.run(cell, 1)
    }

    /// The nearest accepted point no farther than `limit_mm`; `None` if the search would exceed four cells around the
    /// query's own.
    #[inline]
    pub(crate) fn nearest(&self, query: &Vector3<f64>, limit_mm: f64, filter: impl PointFilter) -> Option<Nearby> {
        self.nearest_by_lanes(query, limit_mm, filter).or_else(|| self.nearest_in_rings(query, limit_mm, filter))
    }

    /// The first of the 2 × 2 × 2 cells around a place given in cells, and the distance from it to their nearest side, mm: 0.5 to
    /// 1 cell. `None` if the place is not among the cells.
    #[inline(always)]
    fn eight_cells(&self, place: &Vector3<f64>) -> Option<([u32; 3], f64)> {
        let u = place - Vector3::repeat(0.5);
        if !(0..3).all(|k| u[k] >= 0.0 && u[k] < f64::from(self.n_blocks[k] * EDGE - 1)) {
            return None;
        }
        let first = [u.x as u32, u.y as u32, u.z as u32];
        let side = (0..3).map(|k| 1.0 - (u[k] - f64::from(first[k]) - 0.5).abs()).fold(f64::INFINITY, f64::min);
        Some((first, side * self.cell_mm))
    }

    /// The result of a search that has seen all points within `seen_square`.
    #[inline]
    fn nearby(&self, best: &Best, seen_square: f64) -> Nearby {
        let near = best.square <= best.limit_square;
        let free_square = if near { best.second } else { best.square };
        Nearby {
            nearest: near.then(|| (self.items[best.at], best.square)),
            at: near.then_some(best.at as u32),
            free_square: free_square.min(seen_square),
        }
    }

    /// The points of `n` consecutive cells of a block along z.
    #[inline(always)]
    fn run(&self, cell: [i32; 3], n: usize) -> std::ops::Range<usize> {
        let (block, cell) = self.place(&cell);
        match self.blocks[block as usize] {
            NONE => 0..0,
            number => {
                let k = (number * CELLS + cell) as usize;
                self.starts[k] as usize..self.starts[k + n] as usize
            }
        }
    }

    #[inline(always)]
    fn add(&self, range: std::ops::Range<usize>, query: &Vector3<f64>, filter: impl PointFilter, best: &mut Best) {
        for (at, point) in range.clone().zip(&self.points[range]) {
            let square = (point - query).norm_squared();
            if !self.matters(at, square, filter, best) {
                continue;
            }
            let farther = if square < best.square { best.square } else { square };
            best.second = if farther < best.second { farther } else { best.second };
            if square < best.square || (square == best.square && self.items[at] < self.items[best.at]) {
                (best.at, best.square) = (at, square);
            }
        }
    }

    /// Whether an accepted point could change the result.
    #[inline(always)]
    fn matters<K: PointFilter>(&self, at: usize, square: f64, filter: K, best: &Best) -> bool {
        K::ALL || (square < best.second && filter.accepts(self.items[at], &self.points[at]))
    }

    /// [`Self::nearest`] by distances in double precision alone.
    #[inline(never)]
    fn nearest_in_rings(&self, query: &Vector3<f64>, limit_mm: f64, filter: impl PointFilter) -> Option<Nearby> {
        let limit_square = limit_mm * limit_mm;
        let own = self.cell(query);
        if (0..3).any(|k| own[k] < -MAX_RING || own[k] - MAX_RING > (self.n_blocks[k] * EDGE) as i32) {
            let square = (query - query.sup(&self.min).inf(&self.max)).norm_squared();
            return (square > limit_square).then_some(Nearby { nearest: None, at: None, free_square: square });
        }
        let h = self.cell_mm;
        let within = self.within(query, own);
        // Squared distances from the query to the cells below, at and above its own along each axis.
        let gap = [0, 1, 2].map(|k| {
            let (below, above) = (within[k], h - within[k]);
            [below * below, 0.0, above * above]
        });
        let margin = (0..3).map(|k| within[k].min(h - within[k])).fold(f64::INFINITY, f64::min);
        let mut best = Best::within(limit_mm * limit_mm);
        let mut skipped = f64::INFINITY;
        self.add(self.range(own), query, filter, &mut best);
        for [x, y, z] in AROUND {
            let square = gap[0][x as usize] + gap[1][y as usize] + gap[2][z as usize];
            if square > best.search_square() {
                skipped = skipped.min(square);
            } else {
                let range = self.range([own[0] + x - 1, own[1] + y - 1, own[2] + z - 1]);
                self.add(range, query, filter, &mut best);
            }
        }
        let mut ring = 1;
        loop {
            let seen_mm = f64::from(ring) * h + margin;
            if best.search_square() <= seen_mm * seen_mm {
                return Some(self.nearby(&best, skipped.min(seen_mm * seen_mm)));
            }
            if ring == MAX_RING {
                return None;
            }
            ring += 1;
            self.look_at_ring(own, ring, query, filter, &mut best, &mut skipped);
        }
    }

    /// Position of the query in its own cell, mm from its lowest corner.
    #[inline]
    fn within(&self, query: &Vector3<f64>, own: [i32; 3]) -> Vector3<f64> {
        (query - self.min) - Vector3::from(own.map(f64::from)) * self.cell_mm
    }

    #[cold]
    fn look_at_ring(
        &self,
        own: [i32; 3],
        ring: i32,
        query: &Vector3<f64>,
        filter: impl PointFilter,
        best: &mut Best,
        skipped: &mut f64,
    ) {
        let (h, within) = (self.cell_mm, self.within(query, own));
        let gap = |k: usize, step: i32| {
            let mm = match step {
                0 => 0.0,
                s if s < 0 => within[k] - f64::from(s + 1) * h,
                s => f64::from(s) * h - within[k],
            };
            mm * mm
        };
        for x in -ring..=ring {
            for y in -ring..=ring {
                let edge = x.abs() == ring || y.abs() == ring;
                for z in (-ring..=ring).step_by(if edge { 1 } else { 2 * ring as usize }) {
                    let square = gap(0, x) + gap(1, y) + gap(2, z);
                    if square > best.search_square() {
                        *skipped = skipped.min(square);
                    } else {
                        self.add(self.range([own[0] + x, own[1] + y, own[2] + z]), query, filter, best);
                    }
                }
            }
        }
    }
}

/// The nearest point so far, by its position among the sorted points, and the squared distances of it and the second.
struct Best {
    at: usize,
    square: f64,
    second: f64,
    /// Maximum squared distance, mm².
    limit_square: f64,
}

impl Best {
    fn within(limit_square: f64) -> Self {
        Self { at: 0, square: f64::INFINITY, second: f64::INFINITY, limit_square }
    }

    /// Squared distance beyond which nothing needs to be looked at, mm².
    #[inline]
    fn search_square(&self) -> f64 {
        if self.square < self.limit_square { self.square } else { self.limit_square }
    }
}

/// The 26 cells around a cell, as offsets plus one: first across a face, then an edge, then a corner.
const AROUND: [[i32; 3]; 26] = around();

const fn around() -> [[i32; 3]; 26] {
    let mut found = [[0; 3]; 26];
    let (mut n, mut steps) = (0, 1);
    while steps <= 3 {
        let mut k = 0;
        while k < 27 {
            let [x, y, z] = [k / 9, k / 3 % 3, k % 3];
            if (x != 1) as i32 + (y != 1) as i32 + (z != 1) as i32 == steps {
                found[n] = [x, y, z];
                n += 1;
            }
            k += 1;
        }
        steps += 1;
    }
    found
}

#[cfg(test)]
mod tests;
