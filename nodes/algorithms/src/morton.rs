//! An order of points in which neighbours in space are mostly neighbours in memory.

use nalgebra::Point3;

/// Cells along the longest edge of the bounding box. Few enough that the rounding of coordinates far from the origin hardly
/// ever moves a point to another cell.
const CELLS: f64 = 1024.0;

/// Indices of the points along a Morton curve through their bounding box; within a cell by coordinates.
///
/// The order in which the points were given does not matter, so neither do sums over them depend on it. Finite points
/// only. `O(n log n)`.
pub(crate) fn order(points: &[Point3<f64>]) -> Vec<u32> {
    let Some(&first) = points.first() else { return Vec::new() };
    let (min, max) = points.iter().fold((first, first), |(min, max), p| (min.inf(p), max.sup(p)));
    let extent = (max - min).max().max(f64::MIN_POSITIVE);
    let scale = (CELLS - 1.0) / extent;
    let mut keyed: Vec<u64> = (0_u64..)
        .zip(points)
        .map(|(i, p)| {
            let cell = (p - min) * scale;
            let code = spread(cell.x as u64) | spread(cell.y as u64) << 1 | spread(cell.z as u64) << 2;
            code << 32 | i
        })
        .collect();
    keyed.sort_unstable();
    let mut begin = 0;
    let point = |key: &u64| &points[(key & 0xffff_ffff) as usize];
    while begin < keyed.len() {
        let cell = keyed[begin] >> 32;
        let end = begin + keyed[begin..].iter().take_while(|key| *key >> 32 == cell).count();
        keyed[begin..end].sort_by(|a, b| {
            let (p, q) = (point(a), point(b));
            p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z))
        });
        begin = end;
    }
    keyed.into_iter().map(|key| (key & 0xffff_ffff) as u32).collect()
}

/// The lowest 21 bits, two zeros between each.
fn spread(bits: u64) -> u64 {
    let mut x = bits & 0x1f_ffff;
    x = (x | x << 32) & 0x1f_0000_0000_ffff;
    x = (x | x << 16) & 0x1f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_given_does_not_matter() {
        let points: Vec<_> = (0..500)
            .map(|i| Point3::new((i * 37 % 101) as f64, (i * 53 % 97) as f64 - 1e6, (i * 71 % 89) as f64))
            .collect();
        let reversed: Vec<_> = points.iter().rev().copied().collect();
        let sorted = |points: &[Point3<f64>]| order(points).into_iter().map(|i| points[i as usize]).collect::<Vec<_>>();
        assert_eq!(sorted(&points), sorted(&reversed));
    }

    #[test]
    fn neighbours_in_the_order_are_near_each_other() {
        let points: Vec<_> = (0..4096).map(|i| Point3::new((i % 64) as f64, (i / 64) as f64, 0.0)).collect();
        let ordered: Vec<_> = order(&points).into_iter().map(|i| points[i as usize]).collect();
        let length: f64 = ordered.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
        assert!(length < 2.0 * 4096.0, "walk of {length} mm through a 64 mm grid of 1 mm");
        assert_eq!(order(&[Point3::origin(); 3]).len(), 3);
    }
}
