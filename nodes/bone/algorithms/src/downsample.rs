//! Downsampling of clouds: indices of the selected points.

use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Cloud;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// About `n` points, evenly through their order.
pub(crate) fn thinned(points: &[Point3<f64>], n: usize) -> Vec<Point3<f64>> {
    points.iter().step_by(points.len().div_ceil(n).max(1)).copied().collect()
}

/// One point of each occupied cell of a grid of `cell_mm`: the one closest to the mean of the cell's points, the lowest
/// index in case of a tie. Indices are in the cloud's order; no point is moved, so normals and extra columns stay
/// valid.
///
/// The grid starts at the origin of the cloud's frame. A cell size that is not positive keeps every point. `O(n log
/// n)`.
pub fn voxel(cloud: &Cloud, cell_mm: f64) -> Vec<usize> {
    let points = cloud.points();
    if cell_mm.is_nan() || cell_mm <= 0.0 {
        return (0..points.len()).collect();
    }
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (index, point) in points.iter().enumerate() {
        let cell: [i64; 3] = std::array::from_fn(|k| (point[k] / cell_mm).floor() as i64);
        cells.entry(cell).or_default().push(index);
    }
    let mut kept: Vec<usize> = cells.values().filter_map(|members| representative(points, members)).collect();
    kept.sort_unstable();
    kept
}

/// Every n-th point, beginning with the first; every point for `n` below two.
pub fn every(cloud: &Cloud, n: usize) -> Vec<usize> {
    (0..cloud.len()).step_by(n.max(1)).collect()
}

/// `n` points at even steps through the cloud's order, beginning with the first; every point if there are no more.
///
/// This thins a scan in the order of its image evenly, and draws at random from points in random order.
pub fn evenly(cloud: &Cloud, n: usize) -> Vec<usize> {
    let len = cloud.len();
    if n >= len { (0..len).collect() } else { (0..n).map(|k| (k as u128 * len as u128 / n as u128) as usize).collect() }
}

/// `n` points drawn uniformly at random without repetition, in the cloud's order; every point if there are no more.
///
/// Source: Knuth, The Art of Computer Programming, volume 2, algorithm 3.4.2 S.
pub fn drawn(cloud: &Cloud, n: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut wanted = n.min(cloud.len());
    let mut kept = Vec::with_capacity(wanted);
    for index in 0..cloud.len() {
        if rng.random_range(0..cloud.len() - index) < wanted {
            kept.push(index);
            wanted -= 1;
        }
    }
    kept
}

fn representative(points: &[Point3<f64>], members: &[usize]) -> Option<usize> {
    let first = points[*members.first()?];
    let sum: Vector3<f64> = members.iter().map(|&i| points[i] - first).sum();
    let mean = first + sum / members.len() as f64;
    let distance = |i: usize| (points[i] - mean).norm_squared();
    members.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn each_cell_keeps_the_point_closest_to_its_mean() {
        let xs = [0.1, 0.5, 0.8, -0.2, 5.0];
        let cloud = Cloud::new("camera", xs.map(|x| Point3::new(x, 0.0, 0.0)).to_vec()).unwrap();
        assert_eq!(voxel(&cloud, 1.0), [1, 3, 4]);
        assert_eq!(voxel(&cloud, 0.0), [0, 1, 2, 3, 4]);
        assert_eq!(every(&cloud, 2), [0, 2, 4]);
        assert_eq!(every(&cloud, 0).len(), 5);
    }

    fn line(n: u32) -> Cloud {
        Cloud::new("camera", (0..n).map(|x| Point3::new(f64::from(x), 0.0, 0.0)).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn the_requested_number_of_points_is_kept_at_even_steps() {
        assert_eq!(evenly(&line(10), 4), [0, 2, 5, 7]);
        for n in [1, 100, 777, 19_999, 20_000] {
            let kept = evenly(&line(20_000), n);
            assert_eq!(kept.len(), n);
            assert!(kept.windows(2).all(|w| w[1] > w[0] && w[1] - w[0] <= 20_000 / n + 1));
        }
        assert_eq!(evenly(&line(3), 5), [0, 1, 2]);
    }

    #[test]
    fn a_draw_is_uniform_without_repetition_and_follows_the_seed() {
        let draw = |seed, n| drawn(&line(200), n, &mut ChaCha8Rng::seed_from_u64(seed));
        let mut times = [0; 200];
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..2000 {
            let kept = drawn(&line(200), 50, &mut rng);
            assert!(kept.len() == 50 && kept.windows(2).all(|w| w[0] < w[1]));
            kept.into_iter().for_each(|k| times[k] += 1);
        }
        // 500 times each, plus or minus five standard deviations of 19.
        assert!(times.iter().all(|n| (403..=597).contains(n)), "{times:?}");
        assert_eq!(draw(1, 50), draw(1, 50));
        assert_ne!(draw(1, 50), draw(2, 50));
        assert_eq!(draw(1, 300).len(), 200);
    }

    #[test]
    fn an_empty_cloud_stays_empty() {
        let cloud = Cloud::new("camera", Vec::new()).unwrap();
        assert!(voxel(&cloud, 1.0).is_empty() && every(&cloud, 3).is_empty() && evenly(&cloud, 3).is_empty());
        assert!(drawn(&cloud, 3, &mut ChaCha8Rng::seed_from_u64(1)).is_empty());
    }
}
