//! The points around a query, kept for the next queries nearby.

use super::{EDGE, MAX_RING, PointFilter, PointGrid};
use nalgebra::Vector3;

/// How much farther than the nearest point a kept search looks, in cells.
const SPARE: f64 = 0.5;

/// Maximum number of points of a kept search; where more are near, it looks less far.
const MOST_KEPT: usize = 12;

/// Number of points collected before the farthest are dropped.
const MOST_SEEN: usize = 40;

/// All points within a ball around a query, by their positions among the sorted points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Around {
    places: [u32; MOST_KEPT],
    n: u32,
    /// Lower bound of the distance from the query to every other point, mm.
    pub(crate) free_mm: f64,
}

impl PointGrid {
    /// The nearest point to a query, if it is no farther than `limit_mm`, and the points that could be nearest to queries
    /// nearby. `None` if the search would exceed four cells.
    pub(crate) fn around(&self, query: &Vector3<f64>, limit_mm: f64, filter: impl PointFilter) -> Option<Around> {
        let h = self.cell_mm;
        let u = (query - self.min) / h;
        if limit_mm / h + SPARE > f64::from(MAX_RING) {
            return None;
        }
        let n_cells = self.n_blocks.map(|n| f64::from(n * EDGE));
        let mut seen = Candidates::new(limit_mm, SPARE * h);
        // Cells have integer edges; there are no points outside of the grid.
        let cells = |k: usize, reach: f64| {
            let (from, to) = ((u[k] - reach).max(0.0), (u[k] + reach).min(n_cells[k] - 0.5));
            (from as i32, if to < 0.0 { -1 } else { to as i32 })
        };
        let gap_square =
            |k: usize, cell: i32| (f64::from(cell) - u[k]).max(u[k] - f64::from(cell + 1)).max(0.0).powi(2);
        let reach = seen.ball_square.sqrt() / h;
        let ((x0, x1), (y0, y1)) = (cells(0, reach), cells(1, reach));
        for x in x0..=x1 {
            let across = gap_square(0, x);
            for y in y0..=y1 {
                let left = seen.ball_square / (h * h) - across - gap_square(1, y);
                if left < 0.0 {
                    continue;
                }
                let (mut z, last) = cells(2, left.sqrt());
                while z <= last {
                    let n = (EDGE as i32 - z % EDGE as i32).min(last + 1 - z);
                    let range = self.run([x, y, z], n as usize);
                    for (place, point) in range.clone().zip(&self.points[range]) {
                        let square = (point - query).norm_squared();
                        if square <= seen.ball_square && filter.accepts(self.items[place], point) {
                            seen.add(place as u32, square);
                        }
                    }
                    z += n;
                }
            }
        }
        Some(seen.around())
    }

    /// Index, position and squared distance (mm²) of the point nearest to a query among those kept around another; the
    /// lowest index in case of a tie. It is the nearest of all if it is within the ball of the kept search.
    #[inline]
    pub(crate) fn nearest_kept(&self, around: &Around, query: &Vector3<f64>) -> Option<(u32, u32, f64)> {
        let mut best: Option<(u32, f64)> = None;
        for &place in &around.places[..around.n as usize] {
            let square = (self.points[place as usize] - query).norm_squared();
            let nearer = best.is_none_or(|(of, least)| {
                square < least || (square == least && self.items[place as usize] < self.items[of as usize])
            });
            if nearer {
                best = Some((place, square));
            }
        }
        best.map(|(place, square)| (self.items[place as usize], place, square))
    }
}

/// Points seen by a search within a ball that shrinks as nearer points are seen.
struct Candidates {
    /// Positions and squared distances.
    points: [(u32, f64); MOST_SEEN],
    n: usize,
    /// Squared radius of the ball, mm².
    ball_square: f64,
    nearest_square: f64,
    spare_mm: f64,
}

impl Candidates {
    fn new(limit_mm: f64, spare_mm: f64) -> Self {
        let ball_square = (limit_mm + spare_mm).powi(2);
        Self { points: [(0, 0.0); MOST_SEEN], n: 0, ball_square, nearest_square: limit_mm * limit_mm, spare_mm }
    }

    #[inline]
    fn add(&mut self, place: u32, square: f64) {
        if square < self.nearest_square {
            self.nearest_square = square;
            self.ball_square = self.ball_square.min((square.sqrt() + self.spare_mm).powi(2));
        }
        if self.n == MOST_SEEN {
            self.shrink();
        }
        // The dropped points may have been nearer than this one.
        if square <= self.ball_square {
            self.points[self.n] = (place, square);
            self.n += 1;
        }
    }

    /// Drops the points outside of the ball, which shrinks if it holds too many.
    fn shrink(&mut self) {
        let seen = &mut self.points[..self.n];
        // Equal points lie in one cell, the lowest index first.
        seen.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        self.n = seen.iter().take_while(|(_, square)| *square <= self.ball_square).count();
        if self.n > MOST_KEPT {
            (self.n, self.ball_square) = (MOST_KEPT, self.points[MOST_KEPT].1);
        }
    }

    fn around(mut self) -> Around {
        self.shrink();
        let mut places = [0; MOST_KEPT];
        for (place, seen) in places.iter_mut().zip(&self.points[..self.n]) {
            *place = seen.0;
        }
        // Rounded down, so that it remains a lower bound.
        Around { places, n: self.n as u32, free_mm: self.ball_square.sqrt() * (1.0 - 1e-12) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{
        All,
        tests::{cells_of, sheet},
    };
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn the_kept_points_contain_the_nearest_of_queries_within_the_ball() {
        let mut points = sheet(6000);
        // A dense patch, where more are near than are kept.
        points.extend(sheet(400).iter().map(|p| Point3::from(p.coords * 0.02)));
        let cells = cells_of(&points);
        let (mut n_served, mut n_full) = (0, 0);
        let (mut n_searches, mut n_kept, mut free_mm) = (0, 0, 0.0);
        for k in 0..400_usize {
            let query = points[k * 16].coords + Vector3::new(0.3, -0.2, 0.1) * (k % 3) as f64;
            for limit_mm in [0.2, 1.0, 50.0] {
                let Some(around) = cells.around(&query, limit_mm, All) else { continue };
                let kept: Vec<u32> =
                    around.places[..around.n as usize].iter().map(|p| cells.items[*p as usize]).collect();
                n_full += usize::from(kept.len() == MOST_KEPT);
                (n_searches, n_kept, free_mm) = (n_searches + 1, n_kept + kept.len(), free_mm + around.free_mm);
                let mut distances: Vec<(f64, u32)> =
                    points.iter().map(|p| (p.coords - query).norm()).zip(0..).collect();
                distances.sort_by(|a, b| a.0.total_cmp(&b.0));
                let others = distances.iter().find(|(_, item)| !kept.contains(item)).unwrap();
                assert!(others.0 > around.free_mm, "query {k}, limit {limit_mm}: {others:?}");
                if distances[0].0 <= limit_mm {
                    assert!(kept.contains(&distances[0].1), "query {k}: the nearest is not kept");
                }
                let beside = query + Vector3::new(0.4, 0.7, -0.5) * (k % 5) as f64 * 0.05 * cells.cell_mm;
                let Some((item, place, square)) = cells.nearest_kept(&around, &beside) else { continue };
                if square.sqrt() < around.free_mm - (beside - query).norm() {
                    n_served += 1;
                    let all = points.iter().map(|p| (p.coords - beside).norm_squared()).fold(f64::INFINITY, f64::min);
                    assert_eq!((square, cells.point(place)), (all, points[item as usize].coords), "query {k}");
                }
            }
        }
        assert!(n_served > 200 && n_full > 10, "{n_served} served, {n_full} full");
        // Of the ball: a smaller one serves fewer queries, and more points take longer.
        let means = [n_kept as f64, free_mm].map(|sum| sum / f64::from(n_searches));
        assert_eq!(format!("{n_searches} {n_served} {n_full} {means:.4?}"), "400 310 16 [2.3500, 0.2186]");
    }
}
