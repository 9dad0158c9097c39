//! An order of points in which neighbours in space are mostly neighbours in memory.

use nalgebra::Point3;

/// The points along a Morton curve through their bounding box; equal cells by coordinates.
///
/// The order in which the points were given does not matter, so neither do sums over them depend on it. Finite points
/// only. `O(n log n)`.
pub(crate) fn sorted(points: &[Point3<f64>]) -> Vec<Point3<f64>> {
    let Some(&first) = points.first() else { return Vec::new() };
    let (min, max) = points.iter().fold((first, first), |(min, max), p| (min.inf(p), max.sup(p)));
    let extent = (max - min).max().max(f64::MIN_POSITIVE);
    let mut keyed: Vec<(u64, Point3<f64>)> = points
        .iter()
        .map(|p| {
            let cell = (p - min) * ((1_u64 << 20) as f64 / extent);
            (spread(cell.x as u64) | spread(cell.y as u64) << 1 | spread(cell.z as u64) << 2, *p)
        })
        .collect();
    keyed.sort_unstable_by(|(a, p), (b, q)| {
        a.cmp(b).then(p.x.total_cmp(&q.x)).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z))
    });
    keyed.into_iter().map(|(_, p)| p).collect()
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
        assert_eq!(sorted(&points), sorted(&reversed));
    }

    #[test]
    fn neighbours_in_the_order_are_near_each_other() {
        let points: Vec<_> = (0..4096).map(|i| Point3::new((i % 64) as f64, (i / 64) as f64, 0.0)).collect();
        let ordered = sorted(&points);
        let length: f64 = ordered.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
        assert!(length < 2.0 * 4096.0, "walk of {length} mm through a 64 mm grid of 1 mm");
        assert_eq!(sorted(&[Point3::origin(); 3]).len(), 3);
    }
}
