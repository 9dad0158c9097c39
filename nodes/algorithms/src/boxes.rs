//! A tree of boxes over things that lie in Morton order.

use nalgebra::Vector3;
use parry3d_f64::glamx::Vec4;

/// Boxes a group holds: two registers of four `f32` for each side.
pub(crate) const WIDE: usize = 8;

/// Rounding of a box and of what is asked, as a share of the largest coordinate.
const ROUNDING: f32 = 8.0 * f32::EPSILON;

/// Levels a tree can have: `8^11` things are more than `u32` counts.
const MAX_LEVELS: usize = 12;

/// Eight boxes side by side: for each axis four and four.
#[derive(Clone)]
struct Group {
    min: [[Vec4; 2]; 3],
    max: [[Vec4; 2]; 3],
}

/// Boxes around things (triangles, handfuls of points), eight to a group, eight groups to one above.
///
/// Boxes are `f32` and rounded outwards, so that nothing is missed; whoever asks then measures in `f64`. What is found
/// and in which order depends on nothing but the boxes and what is asked.
pub(crate) struct Boxes {
    /// The things' own boxes first, the root last.
    levels: Vec<Vec<Group>>,
}

/// The extent of something along the axes, mm.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent {
    pub(crate) min: Vector3<f64>,
    pub(crate) max: Vector3<f64>,
}

impl Extent {
    pub(crate) fn of<'a>(points: impl IntoIterator<Item = &'a Vector3<f64>>) -> Self {
        let nothing = Self { min: Vector3::repeat(f64::INFINITY), max: Vector3::repeat(f64::NEG_INFINITY) };
        points.into_iter().fold(nothing, |e, p| Self { min: e.min.inf(p), max: e.max.sup(p) })
    }

    fn largest(&self) -> f64 {
        self.min.abs().sup(&self.max.abs()).max()
    }
}

impl Group {
    /// Around each of up to eight.
    fn around(eight: &[[[f32; 3]; 2]]) -> Self {
        let side = |k: usize, axis: usize, side: usize| match eight.get(k) {
            Some(sides) => sides[side][axis],
            None => [f32::INFINITY, f32::NEG_INFINITY][side],
        };
        let four =
            |axis, which| [0, 4].map(|first| Vec4::from_array([0, 1, 2, 3].map(|k| side(first + k, axis, which))));
        Self { min: [0, 1, 2].map(|axis| four(axis, 0)), max: [0, 1, 2].map(|axis| four(axis, 1)) }
    }

    /// Around all of it.
    fn whole(&self) -> [[f32; 3]; 2] {
        [self.min.map(|[a, b]| a.min(b).min_element()), self.max.map(|[a, b]| a.max(b).max_element())]
    }

    /// Squared distances of the boxes from the box asked, none above the true one but for rounding.
    #[inline(always)]
    fn squared(&self, min: &[Vec4; 3], max: &[Vec4; 3]) -> [Vec4; 2] {
        let half = |half: usize| {
            let gap = |axis: usize| {
                let gap = (self.min[axis][half] - max[axis]).max(min[axis] - self.max[axis][half]).max(Vec4::ZERO);
                gap * gap
            };
            gap(0) + gap(1) + gap(2)
        };
        [half(0), half(1)]
    }
}

/// A bit for each of eight that is below `limit`.
#[inline(always)]
pub(crate) fn below(squared: &[Vec4; 2], limit: f32) -> u32 {
    let limit = Vec4::splat(limit);
    squared[0].cmplt(limit).bitmask() | squared[1].cmplt(limit).bitmask() << 4
}

/// The numbers of the bits that are set, lowest first.
#[inline(always)]
pub(crate) fn bits(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = (mask != 0).then(|| mask.trailing_zeros() as usize)?;
        mask &= mask - 1;
        Some(lowest)
    })
}

/// Eight numbers as an array.
#[inline(always)]
fn eight(of: &[Vec4; 2]) -> [f32; WIDE] {
    let ([a, b, c, d], [e, f, g, h]) = (of[0].to_array(), of[1].to_array());
    [a, b, c, d, e, f, g, h]
}

fn splat(v: &Vector3<f64>) -> [Vec4; 3] {
    [v.x, v.y, v.z].map(|c| Vec4::splat(c as f32))
}

/// What is far enough above a bound that rounding of a squared distance does not lose anything.
#[inline]
fn above(bound: f64) -> f32 {
    bound as f32 * (1.0 + 1e-5) + f32::MIN_POSITIVE
}

impl Boxes {
    /// A tree over things with these extents, best given along a space-filling curve. `O(n)`.
    pub(crate) fn new(extents: &[Extent]) -> Self {
        let largest = extents.iter().map(Extent::largest).fold(0.0, f64::max) as f32;
        let slack = largest * ROUNDING;
        let sides: Vec<[[f32; 3]; 2]> = extents
            .iter()
            .map(|e| [e.min.map(|c| c as f32 - slack).into(), e.max.map(|c| c as f32 + slack).into()])
            .collect();
        let mut levels: Vec<Vec<Group>> = vec![sides.chunks(WIDE).map(Group::around).collect()];
        while levels[levels.len() - 1].len() > 1 {
            let sides: Vec<[[f32; 3]; 2]> = levels[levels.len() - 1].iter().map(Group::whole).collect();
            levels.push(sides.chunks(WIDE).map(Group::around).collect());
        }
        Self { levels }
    }

    /// Hands everything that may lie within `bound` (mm²) of `at` to `visit`, near groups first; it answers with the
    /// bound from there on.
    #[inline]
    pub(crate) fn nearest(&self, at: &Vector3<f64>, mut bound: f64, mut visit: impl FnMut(usize) -> f64) {
        let at = splat(at);
        let mut waiting = [(0.0_f32, 0_u32, 0_u8); WIDE * MAX_LEVELS];
        let mut n = usize::from(!self.levels[0].is_empty());
        waiting[0].2 = (self.levels.len() - 1) as u8;
        let mut limit = above(bound);
        while n > 0 {
            n -= 1;
            let (squared, group, level) = waiting[n];
            if squared >= limit {
                continue;
            }
            let squared = self.levels[level as usize][group as usize].squared(&at, &at);
            let (near, first) = (below(&squared, limit), group as usize * WIDE);
            if level == 0 {
                for k in bits(near) {
                    bound = visit(first + k);
                }
                limit = above(bound);
                continue;
            }
            let (from, squared) = (n, eight(&squared));
            for k in bits(near) {
                // Farthest first, as the last to wait is the first to be seen.
                let mut place = n;
                while place > from && waiting[place - 1].0 < squared[k] {
                    waiting[place] = waiting[place - 1];
                    place -= 1;
                }
                waiting[place] = (squared[k], (first + k) as u32, level - 1);
                n += 1;
            }
        }
    }

    /// Hands everything that may lie within `reach` mm of a box to `visit`, always in the same order.
    #[inline]
    pub(crate) fn around(&self, what: &Extent, reach: f64, mut visit: impl FnMut(usize)) {
        let (min, max, limit) = (splat(&what.min), splat(&what.max), above(reach * reach));
        let mut waiting = [(0_u32, 0_u8); WIDE * MAX_LEVELS];
        let mut n = usize::from(!self.levels[0].is_empty());
        waiting[0].1 = (self.levels.len() - 1) as u8;
        while n > 0 {
            n -= 1;
            let (group, level) = waiting[n];
            let squared = self.levels[level as usize][group as usize].squared(&min, &max);
            let (near, first) = (below(&squared, limit), group as usize * WIDE);
            if level == 0 {
                bits(near).for_each(|k| visit(first + k));
                continue;
            }
            for k in bits(near) {
                waiting[n] = ((first + k) as u32, level - 1);
                n += 1;
            }
        }
    }
}

/// Indices of points along a Morton curve through their bounding box, ties by index. Finite points only. `O(n)`.
pub(crate) fn along_curve(points: &[Vector3<f64>]) -> Vec<u32> {
    let extent = Extent::of(points);
    let scale = 1023.0 / (extent.max - extent.min).max().max(f64::MIN_POSITIVE);
    let mut keyed: Vec<(u32, u32)> = points
        .iter()
        .zip(0..)
        .map(|(p, i)| {
            let cell = (p - extent.min) * scale;
            (spread(cell.x as u32) | spread(cell.y as u32) << 1 | spread(cell.z as u32) << 2, i)
        })
        .collect();
    // Ten bits at a time, the lowest first; none of the three changes the order of equals.
    let mut sorted = vec![(0, 0); keyed.len()];
    for shift in [0, 10, 20] {
        let digit = |key: u32| (key >> shift & 1023) as usize;
        let mut next = [0; 1024];
        keyed.iter().for_each(|(key, _)| next[digit(*key)] += 1);
        let mut n = 0;
        next.iter_mut().for_each(|next| n += std::mem::replace(next, n));
        for entry in &keyed {
            let next = &mut next[digit(entry.0)];
            sorted[*next] = *entry;
            *next += 1;
        }
        std::mem::swap(&mut keyed, &mut sorted);
    }
    keyed.into_iter().map(|(_, i)| i).collect()
}

/// The lowest ten bits, two zeros between each.
fn spread(bits: u32) -> u32 {
    let mut x = bits & 0x3ff;
    x = (x | x << 16) & 0x0300_00ff;
    x = (x | x << 8) & 0x0300_f00f;
    x = (x | x << 4) & 0x030c_30c3;
    (x | x << 2) & 0x0924_9249
}
