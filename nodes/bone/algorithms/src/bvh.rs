//! A bounding volume hierarchy over items in Morton order.

use nalgebra::Vector3;
use wide::f32x4;

/// Children of a node: two registers of four `f32` for each side of their boxes.
pub(crate) const WIDE: usize = 8;

/// Rounding of a box and of a query, relative to the largest coordinate.
const ROUNDING: f32 = 8.0 * f32::EPSILON;

/// Smallest component of a ray's direction: over the extent of all boxes it moves a ray by less than their rounding, and
/// its inverse is finite, so that a side in which the ray starts gives 0 and not NaN.
const PARALLEL: f64 = 1e-9;

/// Rounding of lengths along a ray, relative to the largest coordinate of a box.
const ROUNDING_ALONG: f64 = 1e-5;

/// Maximum number of levels: `8^11` items are more than `u32` counts.
const MAX_LEVELS: usize = 12;

/// The boxes of eight children: for each axis four and four.
#[derive(Clone)]
struct Node {
    min: [[f32x4; 2]; 3],
    max: [[f32x4; 2]; 3],
}

/// An eight-wide bounding volume hierarchy of items such as triangles or point blocks.
///
/// Boxes are `f32` and rounded outwards, so no item is missed; the caller measures exact distances in `f64`. The items
/// found and their order depend only on the boxes and the query.
pub(crate) struct Bvh {
    /// The boxes of the items first, the root last.
    levels: Vec<Vec<Node>>,
    /// Largest absolute coordinate of a box.
    largest: f64,
}

/// An axis-aligned bounding box, mm.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aabb {
    pub(crate) min: Vector3<f64>,
    pub(crate) max: Vector3<f64>,
}

impl Aabb {
    pub(crate) fn of<'a>(points: impl IntoIterator<Item = &'a Vector3<f64>>) -> Self {
        let nothing = Self { min: Vector3::repeat(f64::INFINITY), max: Vector3::repeat(f64::NEG_INFINITY) };
        points.into_iter().fold(nothing, |e, p| Self { min: e.min.inf(p), max: e.max.sup(p) })
    }

    fn largest(&self) -> f64 {
        self.min.abs().sup(&self.max.abs()).max()
    }
}

impl Node {
    /// A node of at most eight boxes.
    fn new(eight: &[[[f32; 3]; 2]]) -> Self {
        let side = |k: usize, axis: usize, side: usize| match eight.get(k) {
            Some(sides) => sides[side][axis],
            None => [f32::INFINITY, f32::NEG_INFINITY][side],
        };
        let four = |axis, which| [0, 4].map(|first| f32x4::new([0, 1, 2, 3].map(|k| side(first + k, axis, which))));
        Self { min: [0, 1, 2].map(|axis| four(axis, 0)), max: [0, 1, 2].map(|axis| four(axis, 1)) }
    }

    /// The box around all children.
    fn bounds(&self) -> [[f32; 3]; 2] {
        [
            self.min.map(|both| to_array(&both).into_iter().fold(f32::INFINITY, f32::min)),
            self.max.map(|both| to_array(&both).into_iter().fold(f32::NEG_INFINITY, f32::max)),
        ]
    }

    /// Lower bounds, up to rounding, of the squared distances between the children's boxes and the query box.
    #[inline(always)]
    fn squared(&self, min: &[f32x4; 3], max: &[f32x4; 3]) -> [f32x4; 2] {
        let half = |half: usize| {
            let gap = |axis: usize| {
                let beside = (self.min[axis][half] - max[axis]).fast_max(min[axis] - self.max[axis][half]);
                let gap = beside.fast_max(f32x4::ZERO);
                gap * gap
            };
            gap(0) + gap(1) + gap(2)
        };
        [half(0), half(1)]
    }

    /// Where a ray enters the children's boxes, and a bit for each box that it meets between `from` and `to`.
    ///
    /// The near and the far side are chosen by the sign of the direction, so an empty slot begins at infinity.
    #[inline(always)]
    fn entered(&self, ray: &Ray, from: f32x4, to: f32x4) -> ([f32x4; 2], u32) {
        let half = |half: usize| {
            let (mut enter, mut leave) = (from, to);
            for axis in 0..3 {
                let (min, max) = (&self.min[axis], &self.max[axis]);
                let (near, far) = if ray.backwards[axis] { (max, min) } else { (min, max) };
                enter = enter.fast_max((near[half] - ray.origin[axis]) * ray.per_mm[axis]);
                leave = leave.fast_min((far[half] - ray.origin[axis]) * ray.per_mm[axis]);
            }
            (enter, enter.simd_le(leave).to_bitmask())
        };
        let ((low, low_met), (high, high_met)) = (half(0), half(1));
        ([low, high], low_met | high_met << 4)
    }
}

/// A ray in single precision, from a point near the boxes.
struct Ray {
    origin: [f32x4; 3],
    /// Length of the ray per millimetre along each axis.
    per_mm: [f32x4; 3],
    /// Whether the ray runs towards lower coordinates.
    backwards: [bool; 3],
}

impl Ray {
    fn new(origin: &Vector3<f64>, direction: &Vector3<f64>) -> Self {
        let per_mm = direction.map(|c| 1.0 / c.abs().max(PARALLEL).copysign(c));
        Self {
            origin: splat(origin),
            per_mm: splat(&per_mm),
            backwards: (*direction).map(|c| c.is_sign_negative()).into(),
        }
    }
}

/// Bit mask of the values below `limit`.
#[inline(always)]
pub(crate) fn below(squared: &[f32x4; 2], limit: f32) -> u32 {
    let limit = f32x4::splat(limit);
    squared[0].simd_lt(limit).to_bitmask() | squared[1].simd_lt(limit).to_bitmask() << 4
}

/// Indices of the set bits, lowest first.
#[inline(always)]
pub(crate) fn bits(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = (mask != 0).then(|| mask.trailing_zeros() as usize)?;
        mask &= mask - 1;
        Some(lowest)
    })
}

#[inline(always)]
fn to_array(of: &[f32x4; 2]) -> [f32; WIDE] {
    let ([a, b, c, d], [e, f, g, h]) = (of[0].to_array(), of[1].to_array());
    [a, b, c, d, e, f, g, h]
}

fn splat(v: &Vector3<f64>) -> [f32x4; 3] {
    [v.x, v.y, v.z].map(|c| f32x4::splat(c as f32))
}

/// A node still to be visited: its distance, its index and its level.
type Pending = (f32, u32, u8);

/// Puts a node into the last slot or before it, so that the farthest is first: the stack is read from its end.
#[inline(always)]
fn push_sorted(slots: &mut [Pending], node: Pending) {
    let mut place = slots.len() - 1;
    while place > 0 && slots[place - 1].0 < node.0 {
        slots[place] = slots[place - 1];
        place -= 1;
    }
    slots[place] = node;
}

/// A bound widened by the rounding of squared distances.
#[inline]
fn above(bound: f64) -> f32 {
    bound as f32 * (1.0 + 1e-5) + f32::MIN_POSITIVE
}

impl Bvh {
    /// A hierarchy of items with these boxes, which should follow a space-filling curve. `O(n)`.
    pub(crate) fn new(boxes: &[Aabb]) -> Self {
        let largest = boxes.iter().map(Aabb::largest).fold(0.0, f64::max);
        let slack = largest as f32 * ROUNDING;
        let sides: Vec<[[f32; 3]; 2]> = boxes
            .iter()
            .map(|e| [e.min.map(|c| c as f32 - slack).into(), e.max.map(|c| c as f32 + slack).into()])
            .collect();
        let mut levels: Vec<Vec<Node>> = vec![sides.chunks(WIDE).map(Node::new).collect()];
        while levels[levels.len() - 1].len() > 1 {
            let sides: Vec<[[f32; 3]; 2]> = levels[levels.len() - 1].iter().map(Node::bounds).collect();
            levels.push(sides.chunks(WIDE).map(Node::new).collect());
        }
        Self { levels, largest }
    }

    /// An item that may be near `at`, for a first bound of [`Self::nearest`]. `None` if there are no items.
    #[inline]
    pub(crate) fn near(&self, at: &Vector3<f64>) -> Option<usize> {
        let at = splat(at);
        let mut place = 0;
        for level in self.levels.iter().rev() {
            let squared = to_array(&level.get(place)?.squared(&at, &at));
            let nearest = (1..WIDE).fold(0, |best, k| if squared[k] < squared[best] { k } else { best });
            place = place * WIDE + nearest;
        }
        Some(place)
    }

    /// Visits all items that may lie within `bound` (mm²) of `at`, near nodes first; `visit` returns the next bound.
    #[inline]
    pub(crate) fn nearest(&self, at: &Vector3<f64>, mut bound: f64, mut visit: impl FnMut(usize) -> f64) {
        let at = splat(at);
        let mut stack = [(0.0_f32, 0_u32, 0_u8); WIDE * MAX_LEVELS];
        let mut n = usize::from(!self.levels[0].is_empty());
        stack[0].2 = (self.levels.len() - 1) as u8;
        let mut limit = above(bound);
        while n > 0 {
            n -= 1;
            let (squared, node, level) = stack[n];
            if squared >= limit {
                continue;
            }
            let squared = self.levels[level as usize][node as usize].squared(&at, &at);
            let (near, first) = (below(&squared, limit), node as usize * WIDE);
            if level == 0 {
                let squared = to_array(&squared);
                for k in bits(near) {
                    if squared[k] < limit {
                        bound = visit(first + k);
                        limit = above(bound);
                    }
                }
                continue;
            }
            let (from, squared) = (n, to_array(&squared));
            for k in bits(near) {
                push_sorted(&mut stack[from..=n], (squared[k], (first + k) as u32, level - 1));
                n += 1;
            }
        }
    }

    /// Visits all items that a ray may meet within `bound` mm of its origin, near nodes first; `visit` returns the next
    /// bound. The direction is of unit length, the boxes are about the origin of the coordinates.
    #[inline]
    pub(crate) fn along(
        &self,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        mut bound: f64,
        mut visit: impl FnMut(usize) -> f64,
    ) {
        // From its point nearest to the middle of the boxes, so that an origin far off costs no digits.
        let before = -origin.dot(direction);
        let middle = origin + direction * before;
        let rounding = self.largest * ROUNDING_ALONG + 8.0 * f64::EPSILON * before.abs();
        // The boxes are within a ball of √3 times the largest coordinate.
        if middle.norm() > 1.74 * self.largest + rounding {
            return;
        }
        let ray = Ray::new(&middle, direction);
        let from = f32x4::splat((-before - rounding) as f32);
        let limit = |bound: f64| (bound - before + rounding) as f32;
        let mut to = limit(bound);
        let mut stack = [(0.0_f32, 0_u32, 0_u8); WIDE * MAX_LEVELS];
        let mut n = usize::from(!self.levels[0].is_empty());
        stack[0] = (f32::NEG_INFINITY, 0, (self.levels.len() - 1) as u8);
        while n > 0 {
            n -= 1;
            let (enter, node, level) = stack[n];
            if enter > to {
                continue;
            }
            let (enter, met) = self.levels[level as usize][node as usize].entered(&ray, from, f32x4::splat(to));
            let (enter, first) = (to_array(&enter), node as usize * WIDE);
            if level == 0 {
                for k in bits(met) {
                    if enter[k] <= to {
                        bound = visit(first + k);
                        to = limit(bound);
                    }
                }
                continue;
            }
            let from = n;
            for k in bits(met) {
                push_sorted(&mut stack[from..=n], (enter[k], (first + k) as u32, level - 1));
                n += 1;
            }
        }
    }

    /// Visits all items that may lie within `radius` mm of a box, always in the same order.
    #[inline]
    pub(crate) fn within(&self, query: &Aabb, radius: f64, mut visit: impl FnMut(usize)) {
        let (min, max, limit) = (splat(&query.min), splat(&query.max), above(radius * radius));
        let mut stack = [(0_u32, 0_u8); WIDE * MAX_LEVELS];
        let mut n = usize::from(!self.levels[0].is_empty());
        stack[0].1 = (self.levels.len() - 1) as u8;
        while n > 0 {
            n -= 1;
            let (node, level) = stack[n];
            let squared = self.levels[level as usize][node as usize].squared(&min, &max);
            let (near, first) = (below(&squared, limit), node as usize * WIDE);
            if level == 0 {
                bits(near).for_each(|k| visit(first + k));
                continue;
            }
            for k in bits(near) {
                stack[n] = ((first + k) as u32, level - 1);
                n += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests;
