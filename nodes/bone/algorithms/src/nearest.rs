//! Nearest neighbours by a kd-tree.

use crate::kabsch::{centroid, finite};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::{num::NonZeroUsize, sync::Arc};

/// A kd-tree of points, mm. A cheap handle.
///
/// Points are stored relative to their centroid, so a cloud 10 km from the origin is searched as exactly as one at it.
/// Of several equal points only the one with the lowest index is ever found.
#[derive(Clone)]
pub struct Nearest {
    tree: Option<Arc<ImmutableKdTree<f64, 3>>>,
    centre: Point3<f64>,
}

impl Nearest {
    /// A tree over `points`; points that are not finite are left out. `O(n log n)`, on all threads of the current pool.
    pub fn new(points: &[Point3<f64>]) -> Self {
        let known: Vec<Point3<f64>> = points.iter().filter(|p| finite(p)).copied().collect();
        let centre = centroid(&known);
        drop(known);
        let about = (0_u32..).zip(points).filter(|(_, p)| finite(p)).map(|(i, p)| (i, p - centre));
        Self::of(about, centre, true)
    }

    /// A tree of finite points relative to a centre; queries are relative to it, too.
    ///
    /// Built by the calling thread alone, as needed while a lock is held: a pool thread that waits for stolen work runs other
    /// jobs meanwhile, and deadlocks if one of them takes the same lock.
    pub(crate) fn about(centre: &Point3<f64>, points: impl Iterator<Item = Point3<f64>>) -> Self {
        Self::of((0_u32..).zip(points.map(|p| p - centre)), Point3::origin(), false)
    }

    fn of(points: impl Iterator<Item = (u32, Vector3<f64>)>, centre: Point3<f64>, in_pool: bool) -> Self {
        // Adding 0.0 makes -0.0 equal to 0.0.
        let mut entries: Vec<(u32, [f64; 3])> = points.map(|(i, p)| (i, p.map(|c| c + 0.0).into())).collect();
        let order = |(i, a): &(u32, [f64; 3]), (j, b): &(u32, [f64; 3])| {
            a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2])).then(i.cmp(j))
        };
        if in_pool {
            entries.par_sort_unstable_by(order)
        } else {
            entries.sort_unstable_by(order)
        }
        entries.dedup_by(|later, first| later.1 == first.1);
        let build =
            if in_pool { ImmutableKdTree::new_from_entries_parallel } else { ImmutableKdTree::new_from_entries };
        let tree = if entries.is_empty() { None } else { build(&entries).ok().map(Arc::new) };
        Self { tree, centre }
    }

    /// Index and squared distance (mm²) of the nearest point; `None` if there is none or `point` is not finite.
    pub fn nearest(&self, point: &Point3<f64>) -> Option<(usize, f64)> {
        let tree = self.tree.as_ref().filter(|_| finite(point))?;
        let nearest = tree.query(&self.about_centre(point)).nearest_one::<SquaredEuclidean<f64>>().execute();
        Some((nearest.item as usize, nearest.distance))
    }

    /// Indices and squared distances (mm²) of the points no farther than `radius_mm`, by index.
    pub fn within(&self, point: &Point3<f64>, radius_mm: f64) -> Vec<(usize, f64)> {
        let Some(tree) = self.tree.as_ref().filter(|_| finite(point)) else { return Vec::new() };
        let radius = radius_mm * radius_mm;
        let query = self.about_centre(point);
        let neighbours = tree.query(&query).within::<SquaredEuclidean<f64>>(radius).unsorted().execute();
        let mut neighbours: Vec<_> = neighbours.into_iter().map(|f| (f.item as usize, f.distance)).collect();
        neighbours.sort_unstable_by_key(|f| f.0);
        neighbours
    }

    /// Indices and squared distances (mm²) of the `n` nearest points, nearest first, ties by index.
    pub fn nearest_n(&self, point: &Point3<f64>, n: usize) -> Vec<(usize, f64)> {
        let (Some(tree), Some(n)) = (self.tree.as_ref().filter(|_| finite(point)), NonZeroUsize::new(n)) else {
            return Vec::new();
        };
        let neighbours = tree.query(&self.about_centre(point)).nearest_n::<SquaredEuclidean<f64>>(n).execute();
        let mut neighbours: Vec<_> = neighbours.into_iter().map(|f| (f.item as usize, f.distance)).collect();
        neighbours.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        neighbours
    }

    fn about_centre(&self, point: &Point3<f64>) -> [f64; 3] {
        (point - self.centre).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_of_many_is_found_far_from_the_origin_too() {
        for far in [0.0, 1e3, 1e7] {
            let points: Vec<_> = (0..3000)
                .map(|i| Point3::new(f64::from(i * 37 % 101), f64::from(i * 53 % 97), f64::from(i * 71 % 89)))
                .map(|p| p + Vector3::repeat(far))
                .collect();
            let tree = Nearest::new(&points);
            for k in 0..50 {
                let query = points[k * 59] + Vector3::new(0.3, -0.2, 0.1);
                let brute = points.iter().map(|p| (p - query).norm_squared()).fold(f64::INFINITY, f64::min);
                let (index, square) = tree.nearest(&query).unwrap();
                assert!((square - brute).abs() < 1e-6 && ((points[index] - query).norm_squared() - brute).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn the_lowest_index_of_equal_points_is_found() {
        let mut points = vec![Point3::new(1.0, 2.0, 3.0); 100];
        points.insert(0, Point3::new(-0.0, 0.0, 0.0));
        points.push(Point3::origin());
        let tree = Nearest::new(&points);
        assert_eq!(tree.nearest(&Point3::new(1.0, 2.0, 3.1)).unwrap().0, 1);
        assert_eq!(tree.within(&Point3::origin(), 10.0).len(), 2);
        assert_eq!(tree.nearest_n(&Point3::origin(), 5).iter().map(|f| f.0).collect::<Vec<_>>(), [0, 1]);
    }

    #[test]
    fn no_points_and_queries_that_are_not_finite_find_nothing() {
        let tree = Nearest::new(&[]);
        assert_eq!(tree.nearest(&Point3::origin()), None);
        assert!(tree.within(&Point3::origin(), 1.0).is_empty() && tree.nearest_n(&Point3::origin(), 3).is_empty());
        let tree = Nearest::new(&[Point3::origin(), Point3::new(f64::NAN, 0.0, 0.0)]);
        assert_eq!(tree.nearest(&Point3::new(f64::NAN, 0.0, 0.0)), None);
        assert_eq!(tree.nearest(&Point3::new(3.0, 0.0, 0.0)), Some((0, 9.0)));
        assert!(tree.nearest_n(&Point3::origin(), 0).is_empty());
    }
}
