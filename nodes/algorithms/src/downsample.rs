//! Fewer points.

use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Cloud;
use std::collections::BTreeMap;

/// One point of each occupied cell of a grid of `cell_mm`: the one closest to the mean of the cell's points, the lowest
/// index among equals. Indices in the cloud's order; no point is moved, so normals and extra columns stay true.
///
/// Cells are laid from the origin of the cloud's frame. A cell that is not positive keeps every point. `O(n log n)`.
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

/// Every n-th point, the first among them; every point for `n` below two.
pub fn every(cloud: &Cloud, n: usize) -> Vec<usize> {
    (0..cloud.len()).step_by(n.max(1)).collect()
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

    #[test]
    fn each_cell_keeps_the_point_closest_to_its_mean() {
        let xs = [0.1, 0.5, 0.8, -0.2, 5.0];
        let cloud = Cloud::new("camera", xs.map(|x| Point3::new(x, 0.0, 0.0)).to_vec()).unwrap();
        assert_eq!(voxel(&cloud, 1.0), [1, 3, 4]);
        assert_eq!(voxel(&cloud, 0.0), [0, 1, 2, 3, 4]);
        assert_eq!(every(&cloud, 2), [0, 2, 4]);
        assert_eq!(every(&cloud, 0).len(), 5);
    }

    #[test]
    fn an_empty_cloud_stays_empty() {
        let cloud = Cloud::new("camera", Vec::new()).unwrap();
        assert!(voxel(&cloud, 1.0).is_empty() && every(&cloud, 3).is_empty());
    }
}
