//! Distances of eight points at a time, in single precision.

use super::{CELLS, EDGE, NONE, Nearby, PointFilter, PointGrid};
use nalgebra::Vector3;
use std::ops::Range;
use wide::f32x4;

/// Points at a time, as two registers of four.
const LANES: usize = 8;

/// How much farther than the nearest point so far a search looks, in cells: the farther, the longer a pair is kept.
const SPARE: f64 = 0.25;

/// Maximum radius of a search, in cells: beyond, one that narrows as it goes is faster.
const MAX_REACH: f64 = 4.0;

/// Maximum number of cells along an axis that such a ball reaches into.
const MAX_CELLS: usize = 10;

/// How far a search looks that has no point so far, in cells.
const FIRST_REACH: f64 = 1.75;

/// Relative rounding of a distance: of the differences, their squares, the sum and the root.
const ROUNDING: f64 = 1e-6;

/// Square of no distance, mm²; still finite.
const FAR_SQUARE: f32 = 1e30;

/// For each number of points, 0 at as many lanes and a large number at the others.
const MASKS: [[[f32; 4]; 2]; LANES + 1] = masks();

const fn masks() -> [[[f32; 4]; 2]; LANES + 1] {
    let mut masks = [[[FAR_SQUARE; 4]; 2]; LANES + 1];
    let mut n = 0;
    while n <= LANES {
        let mut lane = 0;
        while lane < n {
            masks[n][lane / 4][lane % 4] = 0.0;
            lane += 1;
        }
        n += 1;
    }
    masks
}

/// Coordinates of points in single precision, mm, by axis.
pub(super) struct Lanes {
    /// Followed by as many zeros as there are lanes.
    axes: [Vec<f32>; 3],
    /// Upper bound on the error of the distance between a point and a query near them by the rounding of both, mm.
    rounding_mm: f64,
}

/// The nearest of the points seen at each lane, and the second nearest.
struct Nearest {
    query: [f32x4; 3],
    first: [f32x4; 2],
    second: [f32x4; 2],
    /// The bits of the indices of the nearest points.
    at: [f32x4; 2],
}

/// The nearest point of a search.
#[derive(Clone, Copy)]
struct Candidate {
    at: usize,
    /// Lower bound of its distance, mm.
    nearest_mm: f64,
    /// Lower bound of the distance to every other point, mm.
    others_mm: f64,
}

impl Lanes {
    /// Lanes of points whose largest absolute coordinate is `largest_mm`.
    pub(super) fn new(points: &[Vector3<f64>], largest_mm: f64) -> Self {
        let column = |axis: usize| -> Vec<f32> {
            points.iter().map(|p| p[axis] as f32).chain(std::iter::repeat_n(0.0, LANES)).collect()
        };
        // Each of the six coordinates is rounded by half of the last digit; the double of that covers queries beside the points.
        let rounding_mm = 3.0_f64.sqrt() * 2.0 * f64::from(f32::EPSILON) * largest_mm;
        Self { axes: [0, 1, 2].map(column), rounding_mm }
    }
}

impl Nearest {
    #[inline(always)]
    fn to(query: &Vector3<f64>) -> Self {
        Self {
            query: [0, 1, 2].map(|axis| f32x4::splat(query[axis] as f32)),
            first: [f32x4::splat(FAR_SQUARE); 2],
            second: [f32x4::splat(FAR_SQUARE); 2],
            at: [f32x4::ZERO; 2],
        }
    }

    /// Adds the points of a range.
    #[inline(always)]
    fn add(&mut self, lanes: &Lanes, range: Range<usize>) {
        let mut start = range.start;
        loop {
            self.add_eight(lanes, start, (range.end - start).min(LANES));
            start += LANES;
            if start >= range.end {
                return;
            }
        }
    }

    /// Adds at most eight points from `start`.
    #[inline(always)]
    fn add_eight(&mut self, lanes: &Lanes, start: usize, n: usize) {
        let axes = [0, 1, 2].map(|axis| &lanes.axes[axis][start..start + LANES]);
        for half in 0..2 {
            let away = |axis: usize| {
                let four: [f32; 4] = std::array::from_fn(|k| axes[axis][4 * half + k]);
                let away = f32x4::new(four) - self.query[axis];
                away * away
            };
            let square = (away(0) + away(1) + away(2)).fast_max(f32x4::new(MASKS[n][half]));
            let first = self.first[half];
            let at = f32x4::splat(f32::from_bits((start + 4 * half) as u32));
            self.at[half] = square.simd_lt(first).select(at, self.at[half]);
            self.second[half] = self.second[half].fast_min(first.fast_max(square));
            self.first[half] = first.fast_min(square);
        }
    }

    /// The nearest point of all lanes; `None` if there are no points.
    #[inline(always)]
    fn candidate(&self, lanes: &Lanes) -> Option<Candidate> {
        let [low, high] = self.first;
        let at = high.simd_lt(low).select(self.at[1], self.at[0]).to_array();
        let first = low.fast_min(high).to_array();
        let second = self.second[0].fast_min(self.second[1]).fast_min(low.fast_max(high)).to_array();
        let (mut lane, mut other) = (0, second[0]);
        for k in 1..4 {
            other = other.min(second[k]).min(first[lane].max(first[k]));
            lane = if first[k] < first[lane] { k } else { lane };
        }
        let least_mm = |square: f32| f64::from(square).sqrt() * (1.0 - ROUNDING) - lanes.rounding_mm;
        (first[lane] < FAR_SQUARE).then(|| Candidate {
            at: at[lane].to_bits() as usize + lane,
            nearest_mm: least_mm(first[lane]),
            others_mm: least_mm(other),
        })
    }
}

impl PointGrid {
    /// The nearest point, if it is near enough and single precision tells it from the others.
    #[inline(always)]
    pub(super) fn nearest_by_lanes(
        &self,
        query: &Vector3<f64>,
        limit_mm: f64,
        filter: impl PointFilter,
    ) -> Option<Nearby> {
        let u = (query - self.min) / self.cell_mm;
        let (mut candidate, mut seen_mm) = self.in_eight(query, &u);
        let distance_mm = |candidate: &Option<Candidate>| match candidate {
            Some(candidate) => (self.points[candidate.at] - query).norm(),
            None => f64::INFINITY,
        };
        let mut mm = distance_mm(&candidate);
        while mm.min(limit_mm) > seen_mm {
            // Without a point so far, only a little farther.
            let reach_mm = mm.min(limit_mm).min(FIRST_REACH * self.cell_mm + 2.0 * seen_mm.max(0.0));
            seen_mm = reach_mm + SPARE * self.cell_mm;
            candidate = self.in_ball(query, &u, seen_mm)?;
            mm = distance_mm(&candidate);
        }
        let Some(candidate) = candidate.filter(|candidate| candidate.nearest_mm <= limit_mm) else {
            let free_mm = seen_mm.min(candidate.map_or(f64::INFINITY, |candidate| candidate.nearest_mm)).max(0.0);
            return Some(Nearby { nearest: None, at: None, free_square: free_mm * free_mm });
        };
        let (item, point) = (self.items[candidate.at], &self.points[candidate.at]);
        if mm > limit_mm || mm >= candidate.others_mm || !filter.accepts(item, point) {
            return None;
        }
        let (square, free_mm) = ((point - query).norm_squared(), seen_mm.min(candidate.others_mm));
        Some(Nearby { nearest: Some((item, square)), at: Some(candidate.at as u32), free_square: free_mm * free_mm })
    }

    /// The nearest point in the 2 × 2 × 2 cells around the query, and the distance within which there are no others, mm:
    /// none if the query is not among the cells.
    #[inline(always)]
    fn in_eight(&self, query: &Vector3<f64>, u: &Vector3<f64>) -> (Option<Candidate>, f64) {
        let Some((first, side_mm)) = self.eight_cells(u) else { return (None, f64::NEG_INFINITY) };
        let mut nearest = Nearest::to(query);
        for (x, y) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            self.add_column::<false>([first[0] + x, first[1] + y], [first[2], first[2] + 1], &mut nearest);
        }
        (nearest.candidate(&self.lanes), side_mm)
    }

    /// Adds the points of the cells at `[x, y]` from the first `z` to the last, both within the grid. Without `SKIP_EMPTY` no
    /// branch has to be predicted for cells without points, which pays where few are.
    #[inline(always)]
    fn add_column<const SKIP_EMPTY: bool>(&self, [x, y]: [u32; 2], [from, to]: [u32; 2], nearest: &mut Nearest) {
        let block = ((x / EDGE) * self.n_blocks[1] + y / EDGE) * self.n_blocks[2];
        let cell = ((x % EDGE) * EDGE + y % EDGE) * EDGE;
        for z in from / EDGE..=to / EDGE {
            let number = self.blocks[(block + z) as usize];
            if number != NONE {
                let cells = number * CELLS + cell;
                let first = cells + if z == from / EDGE { from % EDGE } else { 0 };
                let last = cells + if z == to / EDGE { to % EDGE } else { EDGE - 1 };
                let points = self.starts[first as usize] as usize..self.starts[last as usize + 1] as usize;
                if !(SKIP_EMPTY && points.is_empty()) {
                    nearest.add(&self.lanes, points);
                }
            }
        }
    }

    /// The nearest point in the cells that reach into a ball around the query; `None` if the ball is too large.
    #[inline(never)]
    fn in_ball(&self, query: &Vector3<f64>, u: &Vector3<f64>, radius_mm: f64) -> Option<Option<Candidate>> {
        let radius = radius_mm / self.cell_mm;
        if radius > MAX_REACH {
            return None;
        }
        let [x, y, z] = [0, 1, 2].map(|k| {
            let last = (self.n_blocks[k] * EDGE - 1) as i32;
            // A cast rounds towards zero, and negative numbers to the first cell: a cell too many does no harm.
            ((u[k] - radius).max(0.0) as i32, ((u[k] + radius) as i32).min(last))
        });
        // Squared distances from the query to the cells along an axis.
        let gaps = |k: usize, first: i32| -> [f64; MAX_CELLS] {
            std::array::from_fn(|n| {
                let cell = f64::from(first) + n as f64;
                (cell - u[k]).max(u[k] - (cell + 1.0)).max(0.0).powi(2)
            })
        };
        let mut nearest = Nearest::to(query);
        if z.0 <= z.1 {
            let (across, along) = (gaps(0, x.0), gaps(1, y.0));
            for (x, across) in (x.0..=x.1).zip(across) {
                for (y, along) in (y.0..=y.1).zip(along) {
                    if across + along <= radius * radius {
                        self.add_column::<true>([x as u32, y as u32], [z.0 as u32, z.1 as u32], &mut nearest);
                    }
                }
            }
        }
        Some(nearest.candidate(&self.lanes))
    }
}
