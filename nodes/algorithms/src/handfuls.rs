//! Points along a space-filling curve, eight at a time, and their neighbours.

use crate::boxes::{Boxes, Extent, WIDE, along_curve, bits};
use nalgebra::Vector3;
use parry3d_f64::glamx::Vec4;

/// Points of a handful.
pub(crate) const HANDFUL: usize = WIDE;

/// So far away that a point has no neighbours, mm; its square is an `f32` still.
const NOWHERE: f32 = 1e15;

/// A typical radius is the median over so many points, spread evenly.
const MEASURED: usize = 500;

/// Eight points side by side, about the first: for each axis four and four.
pub(crate) struct Handful {
    pub(crate) first: Vector3<f64>,
    pub(crate) at: [[Vec4; 2]; 3],
}

/// Points in the order of a space-filling curve, in handfuls, under a tree of boxes.
pub(crate) struct Handfuls {
    pub(crate) handfuls: Vec<Handful>,
    pub(crate) boxes: Boxes,
    /// Which of the points given each one is.
    pub(crate) order: Vec<u32>,
}

/// Eight numbers as four and four.
pub(crate) fn halves(of: [f32; HANDFUL]) -> [Vec4; 2] {
    [Vec4::from_slice(&of[..4]), Vec4::from_slice(&of[4..])]
}

impl Handful {
    /// The point of a number below eight.
    #[inline]
    pub(crate) fn place(&self, k: usize) -> Vector3<f64> {
        self.first + Vector3::from(self.at.map(|halves| f64::from(halves[k / 4][k % 4])))
    }

    /// From a place to the points.
    #[inline(always)]
    pub(crate) fn from(&self, place: &Vector3<f64>) -> [[Vec4; 2]; 3] {
        let away = place - self.first;
        [0, 1, 2].map(|axis| self.at[axis].map(|four| four - away[axis] as f32))
    }

    /// Squared distances of the points from a place.
    #[inline(always)]
    pub(crate) fn squared(&self, place: &Vector3<f64>) -> [Vec4; 2] {
        let [x, y, z] = self.from(place);
        [0, 1].map(|half| x[half] * x[half] + y[half] * y[half] + z[half] * z[half])
    }
}

impl Handfuls {
    /// Finite points about a centre nearby. `O(n log n)`.
    pub(crate) fn new(places: &[Vector3<f64>]) -> Self {
        let order = along_curve(places);
        let mut handfuls = Vec::with_capacity(places.len().div_ceil(HANDFUL));
        let mut extents = Vec::with_capacity(handfuls.capacity());
        for eight in order.chunks(HANDFUL) {
            let first = places[eight[0] as usize];
            let mut at = [[NOWHERE; HANDFUL]; 3];
            for (k, &i) in eight.iter().enumerate() {
                let away = places[i as usize] - first;
                for axis in 0..3 {
                    at[axis][k] = away[axis] as f32;
                }
            }
            extents.push(Extent::of(eight.iter().map(|&i| &places[i as usize])));
            handfuls.push(Handful { first, at: at.map(halves) });
        }
        Self { handfuls, boxes: Boxes::new(&extents), order }
    }

    /// The points given, along the curve.
    pub(crate) fn along(&self, places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        self.order.iter().map(|&i| places[i as usize]).collect()
    }

    pub(crate) fn len(&self) -> usize {
        self.order.len()
    }

    /// The point of a number along the curve.
    pub(crate) fn place(&self, which: u32) -> Vector3<f64> {
        self.handfuls[which as usize / HANDFUL].place(which as usize % HANDFUL)
    }

    /// Fills `nearest` with squared distances (mm²) and numbers along the curve of the `n` points nearest to a place,
    /// nearest first, ties by number.
    pub(crate) fn nearest_n(&self, place: &Vector3<f64>, n: usize, nearest: &mut Vec<(f32, u32)>) {
        nearest.clear();
        let n = n.min(self.len());
        self.boxes.nearest(place, f64::INFINITY, |handful| {
            let squared = self.handfuls[handful].squared(place);
            let bound = if nearest.len() == n { nearest[n - 1].0 } else { f32::MAX.sqrt() };
            let bound = Vec4::splat(bound);
            let near = squared[0].cmple(bound).bitmask() | squared[1].cmple(bound).bitmask() << 4;
            for k in bits(near) {
                let found = (squared[k / 4][k % 4], (handful * HANDFUL + k) as u32);
                let place = nearest.partition_point(|other| *other < found);
                if place < n {
                    nearest.truncate(n - 1);
                    nearest.insert(place, found);
                }
            }
            if nearest.len() == n { f64::from(nearest[n - 1].0) } else { f64::INFINITY }
        });
    }

    /// Within which a point has `n` others, mm: the median.
    pub(crate) fn typical_radius(&self, n: usize) -> f64 {
        let mut nearest = Vec::new();
        let mut radii: Vec<f32> = (0..self.len())
            .step_by(self.len().div_ceil(MEASURED).max(1))
            .map(|i| {
                self.nearest_n(&self.place(i as u32), n, &mut nearest);
                nearest.last().map_or(0.0, |(squared, _)| squared.sqrt())
            })
            .collect();
        radii.sort_unstable_by(f32::total_cmp);
        radii.get(radii.len() / 2).map_or(0.0, |&r| f64::from(r))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_are_those_of_a_plain_search() {
        let places: Vec<_> = (0..1003)
            .map(|i| Vector3::new((i * 37 % 101) as f64, (i * 53 % 97) as f64, (i * 71 % 89) as f64) * 0.3)
            .collect();
        let handfuls = Handfuls::new(&places);
        let mut nearest = Vec::new();
        for place in places.iter().step_by(17).map(|p| p + Vector3::new(0.1, 0.2, -0.1)) {
            let mut plain: Vec<f64> = places.iter().map(|p| (p - place).norm()).collect();
            plain.sort_by(f64::total_cmp);
            handfuls.nearest_n(&place, 20, &mut nearest);
            for ((squared, which), plain) in nearest.iter().zip(&plain) {
                assert!((f64::from(squared.sqrt()) - plain).abs() < 1e-4);
                let point = places[handfuls.order[*which as usize] as usize];
                assert!(((point - place).norm() - plain).abs() < 1e-4);
            }
            assert_eq!(nearest.len(), 20);
        }
        handfuls.nearest_n(&places[0], 5000, &mut nearest);
        assert_eq!(nearest.len(), places.len());
        assert_eq!(Handfuls::new(&[]).typical_radius(3), 0.0);
    }
}
