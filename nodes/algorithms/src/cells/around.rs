//! The few points around a query, which serve for queries a little way off too.

use super::{Cells, EDGE, Keep, MAX_RING};
use nalgebra::Vector3;

/// How much farther than the nearest a search looks that is to be kept, in cells.
const SPARE: f64 = 0.5;

/// Points that such a search keeps; where more are near, it looks less far.
const MOST_KEPT: usize = 12;

/// Points looked at before those that are too many are left out.
const MOST_SEEN: usize = 40;

/// All points within a ball around a query, by their places among those sorted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Around {
    places: [u32; MOST_KEPT],
    n: u32,
    /// Every other point is farther from the query than this, mm.
    pub(crate) free_mm: f64,
}

impl Cells {
    /// The points around a query: the nearest if it is no farther than `limit_mm`, and those that could be the nearest of a
    /// query a little way off. `None` if the search would have to go farther than four cells.
    pub(crate) fn around(&self, query: &Vector3<f64>, limit_mm: f64, keep: impl Keep) -> Option<Around> {
        let h = self.cell_mm;
        let u = (query - self.min) / h;
        if limit_mm / h + SPARE > f64::from(MAX_RING) {
            return None;
        }
        let n_cells = self.n_blocks.map(|n| f64::from(n * EDGE));
        let mut seen = Seen::new(limit_mm, SPARE * h);
        // A cell has whole numbers at its edges; what lies outside of the grid holds no points.
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
                        if square <= seen.ball_square && keep.keeps(self.items[place], point) {
                            seen.add(place as u32, square);
                        }
                    }
                    z += n;
                }
            }
        }
        Some(seen.around())
    }

    /// The nearest to a query of the points kept around another: by index, place and squared distance, mm²; of several
    /// equally near the lowest index. It is the nearest of all if it is no farther than what is free there.
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

/// What a search for the points around a query has seen within a ball that shrinks with what it sees.
struct Seen {
    /// Places and squared distances.
    points: [(u32, f64); MOST_SEEN],
    n: usize,
    /// Nothing farther is asked for, mm².
    ball_square: f64,
    nearest_square: f64,
    spare_mm: f64,
}

impl Seen {
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
            self.leave_out();
        }
        // Those left out may have been nearer than this one.
        if square <= self.ball_square {
            self.points[self.n] = (place, square);
            self.n += 1;
        }
    }

    /// Leaves out what the ball no longer holds, and shrinks it where it holds too many.
    fn leave_out(&mut self) {
        let seen = &mut self.points[..self.n];
        // Equal points lie in one cell, the lowest index first.
        seen.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        self.n = seen.iter().take_while(|(_, square)| *square <= self.ball_square).count();
        if self.n > MOST_KEPT {
            (self.n, self.ball_square) = (MOST_KEPT, self.points[MOST_KEPT].1);
        }
    }

    fn around(mut self) -> Around {
        self.leave_out();
        let mut places = [0; MOST_KEPT];
        for (place, seen) in places.iter_mut().zip(&self.points[..self.n]) {
            *place = seen.0;
        }
        // A little less, so that rounding promises no room that is not there.
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
    fn all_that_is_free_of_other_points_is_around_a_query_and_the_nearest_of_it_serves_beside_it() {
        let mut points = sheet(6000);
        // A dense patch, where more are near than are kept.
        points.extend(sheet(400).iter().map(|p| Point3::from(p.coords * 0.02)));
        let cells = cells_of(&points);
        let (mut n_served, mut n_full) = (0, 0);
        for k in 0..400_usize {
            let query = points[k * 16].coords + Vector3::new(0.3, -0.2, 0.1) * (k % 3) as f64;
            for limit_mm in [0.2, 1.0, 50.0] {
                let Some(around) = cells.around(&query, limit_mm, All) else { continue };
                let kept: Vec<u32> =
                    around.places[..around.n as usize].iter().map(|p| cells.items[*p as usize]).collect();
                n_full += usize::from(kept.len() == MOST_KEPT);
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
    }
}
