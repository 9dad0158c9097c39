//! Points along a Morton curve, on which neighbours in space are mostly neighbours in memory.

use crate::bvh::Aabb;
use nalgebra::{Point3, Vector3};

/// Cells along the longest edge of the bounding box. Few enough that the rounding of coordinates far from the origin
/// hardly ever moves a point to another cell.
const CELLS: f64 = 1024.0;

/// Indices of the points along a Morton curve through their bounding box; within a cell by coordinates.
///
/// The result does not depend on the order in which the points are given, so sums along it do not either. Finite points
/// only. `O(n log n)`.
pub(crate) fn order(points: &[Point3<f64>]) -> Vec<u32> {
    let places: Vec<Vector3<f64>> = points.iter().map(|p| p.coords).collect();
    let mut keyed = by_code(&places);
    let place = |entry: &(u32, u32)| &places[entry.1 as usize];
    for cell in keyed.chunk_by_mut(|a, b| a.0 == b.0) {
        cell.sort_by(|a, b| {
            let (p, q) = (place(a), place(b));
            p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z))
        });
    }
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// Indices of the points along a Morton curve through their bounding box; within a cell by index. Finite points only.
/// `O(n)`.
pub(crate) fn order_by_index(points: &[Vector3<f64>]) -> Vec<u32> {
    by_code(points).into_iter().map(|(_, i)| i).collect()
}

/// The Morton codes of the points and their indices, by code, then by index.
fn by_code(points: &[Vector3<f64>]) -> Vec<(u32, u32)> {
    let bounds = Aabb::of(points);
    let scale = (CELLS - 1.0) / (bounds.max - bounds.min).max().max(f64::MIN_POSITIVE);
    let digit = |key: u32, pass: usize| (key >> (10 * pass) & 1023) as usize;
    let mut counts = [[0; 1024]; 3];
    let keyed = points.iter().zip(0..).map(|(p, i)| {
        let key = code(&((p - bounds.min) * scale));
        (0..3).for_each(|pass| counts[pass][digit(key, pass)] += 1);
        (key, i)
    });
    let mut keyed: Vec<(u32, u32)> = keyed.collect();
    // A stable radix sort, ten bits at a time, the lowest first.
    let mut sorted = vec![(0, 0); keyed.len()];
    for (pass, next) in counts.iter_mut().enumerate() {
        let mut n = 0;
        next.iter_mut().for_each(|next| n += std::mem::replace(next, n));
        for entry in &keyed {
            let next = &mut next[digit(entry.0, pass)];
            sorted[*next] = *entry;
            *next += 1;
        }
        std::mem::swap(&mut keyed, &mut sorted);
    }
    keyed
}

/// The Morton code of a cell, coordinates rounded down.
fn code(cell: &Vector3<f64>) -> u32 {
    spread(cell.x as u32) | spread(cell.y as u32) << 1 | spread(cell.z as u32) << 2
}

/// The lowest ten bits, two zeros between each.
fn spread(bits: u32) -> u32 {
    let mut x = bits & 0x3ff;
    x = (x | x << 16) & 0x0300_00ff;
    x = (x | x << 8) & 0x0300_f00f;
    x = (x | x << 4) & 0x030c_30c3;
    (x | x << 2) & 0x0924_9249
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

    #[test]
    fn a_code_interleaves_the_bits_of_its_cell() {
        let code = |x: u32, y: u32, z: u32| code(&Vector3::new(f64::from(x), f64::from(y), f64::from(z)));
        assert_eq!([code(1, 0, 0), code(0, 1, 0), code(0, 0, 1)], [0b001, 0b010, 0b100]);
        assert_eq!(code(0b11_0101_1010, 0, 0), 0b001_001_000_001_000_001_001_000_001_000);
        assert_eq!(
            [code(1023, 0, 0) | code(0, 1023, 0) | code(0, 0, 1023), code(1023, 1023, 1023)],
            [(1 << 30) - 1; 2]
        );
        for bit in 0..10 {
            assert_eq!([code(1 << bit, 0, 0), code(0, 1 << bit, 0)], [1 << (3 * bit), 2 << (3 * bit)]);
        }
    }

    #[test]
    fn both_orders_are_along_the_curve_through_the_bounding_box_and_stable_within_a_cell() {
        // In cells of an extent of 1023, so that each is one unit wide.
        let cells: Vec<[u32; 3]> = (0..600_u32)
            .map(|k| [k * 397 % 1024, k * 211 % 1023, k * k % 1021])
            .chain([[0; 3], [1023, 5, 9]])
            .collect();
        let points: Vec<Point3<f64>> =
            cells.iter().chain(&cells[..50]).map(|c| Point3::from(c.map(|c| f64::from(c) - 300.0))).collect();
        let mut expected: Vec<(u32, u32)> =
            points.iter().zip(0..).map(|(p, i)| (code(&(p.coords + Vector3::repeat(300.0))), i)).collect();
        expected.sort_unstable();
        let expected: Vec<u32> = expected.into_iter().map(|(_, i)| i).collect();
        assert_eq!(order(&points), expected);
        let vectors: Vec<Vector3<f64>> = points.iter().map(|p| p.coords).collect();
        assert_eq!(order_by_index(&vectors), expected);
        // Within a cell the first goes by coordinates, the second by index.
        let close = [[0.5, 0.0, 0.0], [0.25, 0.5, 0.0], [0.25, 0.0, 0.5], [0.25, 0.0, 0.0], [1023.0; 3]];
        assert_eq!(order(&close.map(Point3::from)), [3, 2, 1, 0, 4]);
        assert_eq!(order_by_index(&close.map(Vector3::from)), [0, 1, 2, 3, 4]);
        assert_eq!(order_by_index(&[Vector3::x(); 3]), [0, 1, 2]);
        assert!(order(&[]).is_empty() && order_by_index(&[]).is_empty());
    }
}
