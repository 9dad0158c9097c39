//! Nearest neighbours by a uniform grid with a list of the points in each cell.

mod around;

pub(crate) use around::Around;

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

    fn get(&self, item: usize) -> Option<Vector3<f64>> {
        self.points.get(item).map(|point| point - self.centre)
    }

    fn iter(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.points.iter().map(|point| point - self.centre)
    }

    /// The corners of the bounding box; zero without points.
    fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let first = self.get(0).unwrap_or_else(Vector3::zeros);
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
    /// Sorts finite `points` into cells. `O(n)`.
    pub(crate) fn new(points: &[Point3<f64>], centre: &Point3<f64>, cell_mm: f64) -> Self {
        Self::sorted(&Centred { points, centre }, cell_mm)
    }

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
            items: Vec::new(),
        }
    }

    fn sorted(points: &Centred<'_>, cell_mm: f64) -> Self {
        let mut cells = Self::without_points(points, cell_mm);
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

    /// The grid of finite `points` from its columns; the error says why they do not belong to these points.
    ///
    /// Every point is checked, so damaged columns never give a wrong neighbour. `O(n)`.
    pub(crate) fn from_columns(
        points: &[Point3<f64>],
        centre: &Point3<f64>,
        columns: &GridColumns,
    ) -> Result<Self, String> {
        let points = &Centred { points, centre };
        let cell_mm = columns.cell_mm;
        let (held, starts, items): (&[u32], &[u32], &[u32]) = (&columns.blocks, &columns.starts, &columns.items);
        if !(cell_mm > 0.0 && cell_mm.is_finite()) {
            return Err(format!("its cells are {cell_mm} mm large"));
        }
        let mut cells = Self::without_points(points, cell_mm);
        if cells.cell_mm != cell_mm {
            return Err(format!("cells of {cell_mm} mm are too many for its points"));
        }
        if !held.is_sorted_by(|a, b| a < b) || held.last().is_some_and(|last| *last as usize >= cells.blocks.len()) {
            return Err("its blocks of cells are not in order".into());
        }
        if starts.len() != held.len() * CELLS as usize + 1 || items.len() != points.len() {
            return Err(format!("it has {} cells with {} points", starts.len().saturating_sub(1), items.len()));
        }
        if starts[0] != 0 || starts[starts.len() - 1] as usize != points.len() || !starts.is_sorted() {
            return Err("the points of its cells are not in order".into());
        }
        for (number, block) in (0..).zip(held) {
            cells.blocks[*block as usize] = number;
        }
        cells.points.reserve_exact(points.len());
        let mut before = None;
        for (at, &item) in (0..).zip(items) {
            let point = points.get(item as usize);
            let bounds = point.and_then(|point| {
                let (block, cell) = cells.place(&cells.cell_of(&point));
                let slot = cells.blocks[block as usize] as usize * CELLS as usize + cell as usize;
                starts.get(slot..slot + 2)
            });
            let is_there = bounds.is_some_and(|b| b[0] <= at && at < b[1] && (at == b[0] || before < Some(item)));
            let Some(point) = point.filter(|_| is_there) else {
                return Err(format!("point {item} lies in another cell"));
            };
            cells.points.push(point);
            before = Some(item);
        }
        cells.starts = starts.to_vec();
        cells.items = items.to_vec();
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
        self.nearest_in_eight(query, limit_mm, filter).or_else(|| self.nearest_in_rings(query, limit_mm, filter))
    }

    /// The nearest point if it lies in the 2 × 2 × 2 cells around the query and no point outside of them can be nearer.
    /// Answers most queries close to the surface.
    #[inline(always)]
    fn nearest_in_eight(&self, query: &Vector3<f64>, limit_mm: f64, filter: impl PointFilter) -> Option<Nearby> {
        let u = (query - self.min) / self.cell_mm - Vector3::repeat(0.5);
        if !(0..3).all(|k| u[k] >= 0.0 && u[k] < f64::from(self.n_blocks[k] * EDGE - 1)) {
            return None;
        }
        let first = [u.x as i32, u.y as i32, u.z as i32];
        // Distance to the nearest side of the eight cells, in cells: from 0.5 to 1.
        let seen = (0..3).map(|k| 1.0 - (u[k] - f64::from(first[k]) - 0.5).abs()).fold(f64::INFINITY, f64::min);
        let seen_square = (seen * self.cell_mm).powi(2);
        let mut best = Best::within(limit_mm * limit_mm);
        for (x, y) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let [x, y, z] = [first[0] + x, first[1] + y, first[2]];
            if z as u32 % EDGE + 1 < EDGE {
                self.add(self.run([x, y, z], 2), query, filter, &mut best);
            } else {
                self.add(self.run([x, y, z], 1), query, filter, &mut best);
                self.add(self.run([x, y, z + 1], 1), query, filter, &mut best);
            }
        }
        (best.search_square() <= seen_square).then(|| self.nearby(&best, seen_square))
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
mod tests {
    use super::*;

    pub(super) fn cells_of(points: &[Point3<f64>]) -> PointGrid {
        PointGrid::new(points, &Point3::origin(), cell_mm(points, &Point3::origin()))
    }

    /// Points on a bent sheet, without a pattern.
    pub(super) fn sheet(n: u32) -> Vec<Point3<f64>> {
        let part = |k: u32, m: u32| f64::from(k.wrapping_mul(2_654_435_761).wrapping_mul(m) >> 8) / f64::from(1 << 24);
        (0..n)
            .map(|k| {
                let (u, v) = (part(k, 1) * 40.0, part(k, 7919) * 25.0);
                Point3::new(u, v, 0.1 * u * u / 4.0 + v.sin())
            })
            .collect()
    }

    #[test]
    fn the_nearest_point_and_the_bound_are_those_of_an_exhaustive_search() {
        let points = sheet(3000);
        let cells = cells_of(&points);
        let mut n_near = 0;
        for k in 0..400_usize {
            let off = Vector3::new(0.3, -0.2, 0.1) * (k % 7) as f64;
            let query = points[k * 7].coords + off;
            for limit_mm in [0.2, 1.0, 50.0] {
                let Some(found) = cells.nearest(&query, limit_mm, All) else { continue };
                n_near += 1;
                let mut squares: Vec<(f64, u32)> =
                    points.iter().map(|p| (p.coords - query).norm_squared()).zip(0..).collect();
                squares.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let expected = Some((squares[0].1, squares[0].0)).filter(|n| n.1 <= limit_mm * limit_mm);
                assert_eq!(found.nearest, expected, "query {k}, limit {limit_mm}");
                let next = if expected.is_some() { squares[1].0 } else { squares[0].0 };
                assert!(found.free_square <= next, "query {k}: {} but {next}", found.free_square);
            }
        }
        assert!(n_near > 600, "{n_near} answers");
    }

    #[test]
    fn a_grid_comes_back_from_its_columns_and_others_are_refused() {
        let points = sheet(3000);
        let cells = cells_of(&points);
        let parts = cells.to_columns();
        let back = PointGrid::from_columns(&points, &Point3::origin(), &parts).unwrap();
        assert_eq!((&back.points, &back.blocks), (&cells.points, &cells.blocks));
        assert_eq!((back.min, back.max, back.n_blocks), (cells.min, cells.max, cells.n_blocks));
        assert_eq!(back.to_columns(), parts);
        for of_few in [&points[..1], &[points[0]; 3]] {
            let cells = cells_of(of_few);
            assert_eq!(
                PointGrid::from_columns(of_few, &Point3::origin(), &cells.to_columns()).unwrap().points,
                cells.points
            );
        }

        let refused = |points: &[Point3<f64>], damage: &dyn Fn(&mut GridColumns), why: &str| {
            let mut parts = parts.clone();
            damage(&mut parts);
            let error = PointGrid::from_columns(points, &Point3::origin(), &parts).err();
            assert!(error.as_ref().is_some_and(|error| error.contains(why)), "{why}: {error:?}");
        };
        let changed = |column: &Column<u32>, at: usize, value: u32| {
            let mut values = column.to_vec();
            values[at] = value;
            Column::from(values)
        };
        refused(&points, &|p| p.cell_mm = f64::NAN, "NaN mm large");
        refused(&points, &|p| p.cell_mm = 1e-9, "too many");
        refused(&points, &|p| p.cell_mm *= 1.5, "");
        refused(&points, &|p| p.blocks = changed(&p.blocks, 0, u32::MAX), "not in order");
        refused(&points, &|p| p.starts = changed(&p.starts, 5, u32::MAX), "not in order");
        refused(&points, &|p| p.starts = p.starts[1..].to_vec().into(), "cells with 3000 points");
        refused(&points, &|p| p.items = changed(&p.items, 7, p.items[8]), "another cell");
        refused(&points, &|p| p.items = changed(&p.items, 7, u32::MAX), "another cell");
        refused(&points[1..], &|_| {}, "3000 points");
        let mut moved = points.clone();
        moved[40] += Vector3::repeat(2.0 * cells.cell_mm);
        refused(&moved, &|_| {}, "another cell");
    }

    #[test]
    fn equal_points_give_the_lowest_index_and_no_clearance() {
        let cells = cells_of(&[1.0, 0.0, 1.0].map(|c| Point3::from(Vector3::repeat(c))));
        let found = cells.nearest(&Vector3::repeat(1.0), 0.5, All).unwrap();
        assert_eq!((found.nearest, found.free_square), (Some((0, 0.0)), 0.0));
        let cells = cells_of(&[]);
        assert_eq!(cells.nearest(&Vector3::repeat(1.0), 0.0, All).map(|n| n.nearest), Some(None));
    }

    #[test]
    fn wide_clouds_and_queries_far_outside_are_handled() {
        let mut points = sheet(500);
        points.push(Vector3::repeat(1e7).into());
        let cells = cells_of(&points);
        // The reported size is that of the enlarged cells, so that columns are read back unchanged.
        assert_eq!(cells.cell_mm, cell_mm(&points, &Point3::origin()));
        assert_eq!(cells.nearest(&points[500].coords, 1.0, All).unwrap().nearest, Some((500, 0.0)));
        assert_eq!(cells.nearest(&Vector3::repeat(-1e9), 0.5, All).map(|n| n.nearest), Some(None));
    }

    #[derive(Clone, Copy)]
    struct Even;

    impl PointFilter for Even {
        const ALL: bool = false;

        fn accepts(&self, item: u32, _: &Vector3<f64>) -> bool {
            item.is_multiple_of(2)
        }
    }

    /// Answers of both searches to queries on the sheet, beside it and outside of the grid: how many, how many with a point, and
    /// the mean of their bounds on the others, mm. Each answer is compared with an exhaustive search.
    fn tally(filter: impl PointFilter, accepted: impl Fn(u32) -> bool) -> String {
        let points = sheet(3000);
        let cells = cells_of(&points);
        let mut tallies = [(0, 0, 0.0); 2];
        for k in 0..600_usize {
            let off = Vector3::new(0.45, -0.35, 0.6) * (k % 13) as f64 * if k % 2 == 0 { 0.5 } else { -0.5 };
            let query = points[k * 5].coords + off;
            let mut squares: Vec<(f64, u32)> = (0..)
                .zip(&points)
                .filter(|(i, _)| accepted(*i))
                .map(|(i, p)| ((p.coords - query).norm_squared(), i))
                .collect();
            squares.sort_by(|a, b| a.0.total_cmp(&b.0));
            for limit_mm in [0.2, 1.0, 3.0, 50.0] {
                let answers = [
                    cells.nearest_in_eight(&query, limit_mm, filter),
                    cells.nearest_in_rings(&query, limit_mm, filter),
                ];
                for (found, tally) in answers.iter().zip(&mut tallies) {
                    let Some(found) = found else { continue };
                    let expected = Some((squares[0].1, squares[0].0)).filter(|n| n.1 <= limit_mm * limit_mm);
                    assert_eq!(found.nearest, expected, "query {k}, limit {limit_mm}");
                    assert_eq!(found.at.map(|at| cells.items()[at as usize]), expected.map(|n| n.0), "its place");
                    let next = if expected.is_some() { squares[1].0 } else { squares[0].0 };
                    assert!(found.free_square <= next, "query {k}: {} but {next}", found.free_square);
                    tally.0 += 1;
                    tally.1 += usize::from(expected.is_some());
                    tally.2 += found.free_square.sqrt();
                }
            }
        }
        format!("{:.4?}", tallies.map(|(n, n_found, sum)| (n, n_found, sum / f64::from(n))))
    }

    #[test]
    fn both_searches_answer_as_often_and_with_as_wide_a_bound_as_they_did() {
        // Fewer answers are slower, as the kd-tree is asked; so is a narrower bound, as a point is looked up again sooner.
        assert_eq!(tally(All, |_| true), "[(401, 396, 0.1331), (1854, 1362, 0.3571)]");
        assert_eq!(tally(Even, |i| i.is_multiple_of(2)), "[(213, 208, 0.1364), (1848, 1303, 0.3887)]");
    }

    #[test]
    fn cells_of_a_sheet_hold_as_many_points_as_they_did_and_those_around_a_cell_go_by_their_distance() {
        let points = sheet(3000);
        let cells = cells_of(&points);
        let n_occupied = cells.starts.windows(2).filter(|two| two[0] < two[1]).count();
        // Of so few points the trial cells are too small to tell how many would share one: fewer do than wanted.
        let per_cell = 3000.0 / f64::from(n_occupied as u32);
        assert_eq!(format!("{per_cell:.4} {:.6}", cells.cell_mm), "1.2479 0.220733");
        for (at, point) in cells.points.iter().enumerate() {
            let range = cells.range(cells.cell(point));
            assert!(range.contains(&at) && cells.cell(point) == cells.cell_of(point), "point {at} in {range:?}");
        }
        let steps = AROUND.map(|cell| cell.iter().filter(|c| **c != 1).count());
        assert_eq!(steps.map(|n| (1..=3).contains(&n)), [true; 26]);
        assert!(steps.is_sorted() && [1, 2, 3].map(|n| steps.iter().filter(|s| **s == n).count()) == [6, 12, 8]);
        let mut distinct = AROUND.to_vec();
        distinct.sort_unstable();
        distinct.dedup();
        assert_eq!(distinct.len(), 26);
    }
}
