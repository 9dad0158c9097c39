//! Blocks of eight points along a Morton curve, for nearest-neighbour searches with SIMD.

use crate::bvh::{Aabb, Bvh, WIDE, bits};
use crate::morton;
use nalgebra::Vector3;
use wide::f32x4;

/// Points of a block.
pub(crate) const BLOCK_LEN: usize = WIDE;

/// Coordinate of padding points, mm: far from all others, but its square is a finite `f32`.
const PADDING: f32 = 1e15;

/// Eight points relative to the first: for each axis four and four.
pub(crate) struct PointBlock {
    pub(crate) first: Vector3<f64>,
    pub(crate) at: [[f32x4; 2]; 3],
}

/// Points along a Morton curve, in blocks under a bounding volume hierarchy.
pub(crate) struct PointBlocks {
    pub(crate) blocks: Vec<PointBlock>,
    pub(crate) bvh: Bvh,
    /// The index in the input of each point along the curve.
    pub(crate) order: Vec<u32>,
}

/// Splits eight numbers into four and four.
pub(crate) fn halves(of: [f32; BLOCK_LEN]) -> [f32x4; 2] {
    let [a, b, c, d, e, f, g, h] = of;
    [f32x4::new([a, b, c, d]), f32x4::new([e, f, g, h])]
}

impl PointBlock {
    /// Vectors from `place` to the points.
    #[inline(always)]
    pub(crate) fn relative_to(&self, place: &Vector3<f64>) -> [[f32x4; 2]; 3] {
        let away = place - self.first;
        [0, 1, 2].map(|axis| self.at[axis].map(|four| four - away[axis] as f32))
    }

    /// Squared distances of the points from a place.
    #[inline(always)]
    pub(crate) fn squared(&self, place: &Vector3<f64>) -> [f32x4; 2] {
        let [x, y, z] = self.relative_to(place);
        [0, 1].map(|half| x[half] * x[half] + y[half] * y[half] + z[half] * z[half])
    }
}

impl PointBlocks {
    /// Blocks of finite points, which should be relative to a centre nearby. `O(n)`.
    pub(crate) fn new(places: &[Vector3<f64>]) -> Self {
        let order = morton::order_by_index(places);
        let mut blocks = Vec::with_capacity(places.len().div_ceil(BLOCK_LEN));
        let mut boxes = Vec::with_capacity(blocks.capacity());
        for eight in order.chunks(BLOCK_LEN) {
            let first = places[eight[0] as usize];
            let mut at = [[PADDING; BLOCK_LEN]; 3];
            for (k, &i) in eight.iter().enumerate() {
                let away = places[i as usize] - first;
                for axis in 0..3 {
                    at[axis][k] = away[axis] as f32;
                }
            }
            boxes.push(Aabb::of(eight.iter().map(|&i| &places[i as usize])));
            blocks.push(PointBlock { first, at: at.map(halves) });
        }
        Self { blocks, bvh: Bvh::new(&boxes), order }
    }

    /// Permutes `places` into the order of the curve.
    pub(crate) fn along(&self, places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        self.order.iter().map(|&i| places[i as usize]).collect()
    }

    pub(crate) fn len(&self) -> usize {
        self.order.len()
    }

    /// Fills `nearest` with the squared distances (mm²) and positions along the curve of the `n` points nearest to a place,
    /// nearest first, ties by position.
    pub(crate) fn nearest_n(&self, place: &Vector3<f64>, n: usize, nearest: &mut Vec<(f32, u32)>) {
        nearest.clear();
        let n = n.min(self.len());
        self.bvh.nearest(place, f64::INFINITY, |block| {
            let squared = self.blocks[block].squared(place);
            let bound = if nearest.len() == n { nearest[n - 1].0 } else { f32::MAX.sqrt() };
            let bound = f32x4::splat(bound);
            let near = squared[0].simd_le(bound).to_bitmask() | squared[1].simd_le(bound).to_bitmask() << 4;
            for k in bits(near) {
                let candidate = (squared[k / 4].as_array()[k % 4], (block * BLOCK_LEN + k) as u32);
                let place = nearest.partition_point(|other| *other < candidate);
                if place < n {
                    nearest.truncate(n - 1);
                    nearest.insert(place, candidate);
                }
            }
            if nearest.len() == n { f64::from(nearest[n - 1].0) } else { f64::INFINITY }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_are_those_of_an_exhaustive_search() {
        let places: Vec<_> = (0..1003)
            .map(|i| Vector3::new((i * 37 % 101) as f64, (i * 53 % 97) as f64, (i * 71 % 89) as f64) * 0.3)
            .collect();
        let blocks = PointBlocks::new(&places);
        let mut nearest = Vec::new();
        for place in places.iter().step_by(17).map(|p| p + Vector3::new(0.1, 0.2, -0.1)) {
            let mut plain: Vec<f64> = places.iter().map(|p| (p - place).norm()).collect();
            plain.sort_by(f64::total_cmp);
            blocks.nearest_n(&place, 20, &mut nearest);
            for ((squared, which), plain) in nearest.iter().zip(&plain) {
                assert!((f64::from(squared.sqrt()) - plain).abs() < 1e-4);
                let point = places[blocks.order[*which as usize] as usize];
                assert!(((point - place).norm() - plain).abs() < 1e-4);
            }
            assert_eq!(nearest.len(), 20);
        }
        blocks.nearest_n(&places[0], 5000, &mut nearest);
        assert_eq!(nearest.len(), places.len());
    }
}
