//! A sparse grid of nodes: blocks near the surface only.

use super::{FieldError, Node, SignedDistance};
use crate::bvh::Aabb;
use nalgebra::Vector3;
use rayon::prelude::*;
use wide::f32x4;

/// Number of cells along each edge of a block.
pub(super) const CELLS: usize = 4;
/// Number of nodes along each edge of a block: blocks repeat those on their faces, so that a cell needs one block only.
const SIDE: usize = CELLS + 1;
/// Number of nodes of a block.
pub(super) const BLOCK: usize = SIDE * SIDE * SIDE;
/// Index entry of no block.
pub(super) const NO_BLOCK: u32 = u32::MAX;
/// Largest number of index entries: 64 MB, a cubic metre in steps of 1 mm.
const MAX_ENTRIES: f64 = 16_777_216.0;
/// Distance of a node without surface, mm.
const NO_SURFACE: f32 = 1e30;
/// Blended distances above this, mm, have a node without surface among their eight.
const MAX_BLENDED: f32 = 1e6;
/// Edge of the largest cube of the octree search for blocks, in blocks.
const LARGEST: usize = 8;

/// Layout of a grid. Blocks are numbered x fastest; so are the nodes in them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    /// Distance between nodes, mm.
    pub(super) spacing: f64,
    /// Lowest corner in the field's axes about its centre, mm.
    pub(super) corner: Vector3<f64>,
    /// Number of blocks along each axis.
    pub(super) blocks: [usize; 3],
    /// `1 / spacing`.
    per_mm: f64,
    /// Half the spacing.
    half: f32,
    /// Number of cells along each axis.
    cells: [u64; 3],
}

impl Grid {
    /// A grid over everything within `band` of the surface.
    pub(super) fn around(extent: &Aabb, spacing: f64, band: f64) -> Result<Self, FieldError> {
        let block = spacing * CELLS as f64;
        let corner = extent.min - Vector3::repeat(band + spacing);
        let blocks = ((extent.max - corner + Vector3::repeat(band + spacing)) / block).map(|b| b.ceil().max(1.0));
        if blocks.product() > MAX_ENTRIES {
            return Err(FieldError::TooLarge { extent_mm: (extent.max - extent.min).max(), spacing_mm: spacing });
        }
        Ok(Self::new(spacing, corner, [blocks.x as usize, blocks.y as usize, blocks.z as usize]))
    }

    pub(super) fn new(spacing: f64, corner: Vector3<f64>, blocks: [usize; 3]) -> Self {
        let cells = blocks.map(|n| n.saturating_mul(CELLS) as u64);
        Self { spacing, corner, blocks, per_mm: 1.0 / spacing, half: (0.5 * spacing) as f32, cells }
    }

    /// Number of index entries.
    pub(super) fn n_entries(&self) -> usize {
        self.blocks.iter().product()
    }

    fn entry(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.blocks[1] + y) * self.blocks[0] + x
    }

    /// The index and the nodes of the blocks within `band` of the surface.
    ///
    /// A search starts from the element nearest to the node before, so it visits little. Each block is computed alone and in one
    /// order, so the result does not depend on the number of threads.
    pub(super) fn filled(&self, surface: &impl SignedDistance, band: f64) -> (Vec<u32>, Vec<f32>) {
        let steps = self.blocks.map(|n| n.div_ceil(LARGEST));
        let found: Vec<([usize; 3], u32)> = (0..steps.iter().product())
            .into_par_iter()
            .flat_map_iter(|k| {
                let first = [k % steps[0], k / steps[0] % steps[1], k / steps[0] / steps[1]].map(|b| b * LARGEST);
                let mut found = Vec::new();
                self.near(surface, band, first, LARGEST, None, &mut found);
                found
            })
            .collect();
        let mut index = vec![NO_BLOCK; self.n_entries()];
        for (number, (block, _)) in (0_u32..).zip(&found) {
            index[self.entry(*block)] = number;
        }
        let mut nodes = vec![[0.0_f32; 4]; found.len() * BLOCK];
        nodes.par_chunks_mut(BLOCK).zip(&found).for_each(|(nodes, (block, nearest))| {
            self.fill(surface, *block, *nearest, &index, nodes);
        });
        for (number, (block, _)) in found.iter().enumerate() {
            self.copy_shared(*block, number, &index, &mut nodes);
        }
        (index, nodes.into_flattened())
    }

    /// The blocks of a cube of `size` blocks within `band` of the surface, each with the element nearest to its middle.
    fn near(
        &self,
        surface: &impl SignedDistance,
        band: f64,
        first: [usize; 3],
        size: usize,
        hint: Option<u32>,
        found: &mut Vec<([usize; 3], u32)>,
    ) {
        if (0..3).any(|axis| first[axis] >= self.blocks[axis]) {
            return;
        }
        let edge = self.spacing * (CELLS * size) as f64;
        let low = self.node_position(first.map(|b| b * CELLS));
        let half_diagonal = |edge: f64| edge * 0.75_f64.sqrt();
        let nearest = surface.nearest(&(low + Vector3::repeat(edge / 2.0)), hint);
        if nearest.square.sqrt() > band + half_diagonal(edge) {
            return;
        }
        let eighths = (0..8_usize).map(|k| [k & 1, k >> 1 & 1, k >> 2]);
        if size > 1 {
            for eighth in eighths {
                let first = std::array::from_fn(|axis| first[axis] + eighth[axis] * size / 2);
                self.near(surface, band, first, size / 2, Some(nearest.index), found);
            }
            return;
        }
        // The bounding spheres of its eighths are tighter than that of the block.
        let any = eighths.into_iter().any(|eighth| {
            let middle = low + Vector3::from(eighth.map(|k| edge * (0.25 + 0.5 * k as f64)));
            surface.nearest(&middle, Some(nearest.index)).square.sqrt() <= band + half_diagonal(edge / 2.0)
        });
        if any {
            found.push((first, nearest.index));
        }
    }

    fn node_position(&self, node: [usize; 3]) -> Vector3<f64> {
        self.corner + Vector3::from(node.map(|i| i as f64 * self.spacing))
    }

    /// The blocks on the far sides of a block: bit 0 of the side is along x, bit 1 along y, bit 2 along z.
    fn beyond(&self, block: [usize; 3], index: &[u32]) -> [u32; 8] {
        std::array::from_fn(|side| {
            let block: [usize; 3] = std::array::from_fn(|axis| block[axis] + (side >> axis & 1));
            if (0..3).all(|axis| block[axis] < self.blocks[axis]) { index[self.entry(block)] } else { NO_BLOCK }
        })
    }

    /// Computes the nodes of a block, except for those that a block beyond computes.
    fn fill(
        &self,
        surface: &impl SignedDistance,
        block: [usize; 3],
        nearest: u32,
        index: &[u32],
        nodes: &mut [[f32; 4]],
    ) {
        let beyond = self.beyond(block, index);
        let mut hint = nearest;
        for k in 0..BLOCK {
            // In serpentine order, so that each node is next to the one before.
            let z = k / (SIDE * SIDE);
            let row = k / SIDE % SIDE;
            let y = if z.is_multiple_of(2) { row } else { SIDE - 1 - row };
            let x = if (z + y).is_multiple_of(2) { k % SIDE } else { SIDE - 1 - k % SIDE };
            let side = usize::from(x == CELLS) | usize::from(y == CELLS) << 1 | usize::from(z == CELLS) << 2;
            if side != 0 && beyond[side] != NO_BLOCK {
                continue;
            }
            let at = self.node_position([block[0] * CELLS + x, block[1] * CELLS + y, block[2] * CELLS + z]);
            let nearest = surface.nearest(&at, Some(hint));
            nodes[number([x, y, z])] = surface.node(&at, &nearest).0;
            hint = nearest.index;
        }
    }

    /// Copies the shared nodes that blocks beyond have computed.
    fn copy_shared(&self, block: [usize; 3], this: usize, index: &[u32], nodes: &mut [[f32; 4]]) {
        let beyond = self.beyond(block, index);
        for (side, &other) in beyond.iter().enumerate().skip(1).filter(|(_, other)| **other != NO_BLOCK) {
            let range = |axis: usize| if side >> axis & 1 == 1 { CELLS..SIDE } else { 0..CELLS };
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        let there = number([x % CELLS, y % CELLS, z % CELLS]);
                        nodes[this * BLOCK + number([x, y, z])] = nodes[other as usize * BLOCK + there];
                    }
                }
            }
        }
    }

    /// The cell of a position in the field's axes about its centre; `None` if the grid has no block there.
    #[inline(always)]
    pub(super) fn cell<'a>(&self, at: &Vector3<f64>, index: &[u32], nodes: &'a [[f32; 4]]) -> Option<Cell<'a>> {
        let c = (at - self.corner) * self.per_mm;
        let ((x, fx), (y, fy), (z, fz)) = (whole(c.x), whole(c.y), whole(c.z));
        if x >= self.cells[0] || y >= self.cells[1] || z >= self.cells[2] {
            return None;
        }
        let (x, y, z) = (x as usize, y as usize, z as usize);
        let number = *index.get(self.entry([x / CELLS, y / CELLS, z / CELLS])).filter(|number| **number != NO_BLOCK)?;
        let first = number as usize * BLOCK;
        let nodes = nodes.get(first..first + BLOCK)?.first_chunk()?;
        Some(Cell {
            nodes,
            first: ((z % CELLS) * SIDE + y % CELLS) * SIDE + x % CELLS,
            fraction: [fx, fy, fz],
            half: self.half,
        })
    }
}

/// Floor and fraction of a coordinate in cells.
///
/// Adding 1.5 · 2^52 leaves no bits for fractions, so it rounds to an integer in the lowest bits: two additions instead of the
/// dozen instructions of a conversion. Negative, too large and NaN coordinates give a cell beyond all grids.
#[inline(always)]
fn whole(c: f64) -> (u64, f32) {
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    /// Below one, so that a node without surface affects the whole cell.
    const MAX_FRACTION: f32 = 1.0 - f32::EPSILON / 2.0;
    let shifted = (c - 0.5) + SHIFT;
    let share = (c - (shifted - SHIFT)) as f32;
    (shifted.to_bits().wrapping_sub(SHIFT.to_bits()), if share < MAX_FRACTION { share } else { MAX_FRACTION })
}

/// A cell of a grid and a position in it.
pub(super) struct Cell<'a> {
    nodes: &'a [[f32; 4]; BLOCK],
    /// Its lowest node.
    first: usize,
    /// The position, as fractions of the cell's edges.
    fraction: [f32; 3],
    /// Half the spacing of the nodes, mm.
    half: f32,
}

impl Cell<'_> {
    /// Distance, mm, and its gradient in the grid's axes, about as long as the spacing; `None` beside a rim.
    ///
    /// The gradient is the derivative of the blended distance: on bones it is a fifth closer to the surface's normal than a blend
    /// of the nodes' gradients, and it is the slope of the cost that a least-squares step lowers.
    ///
    /// Four `f32` at once, in a vector of its own: the compiler takes plain arrays apart again where only some of the
    /// four are used in the end, which costs a third of the speed. Sums and products alone, so every machine gives the same bits.
    #[inline(always)]
    pub(super) fn sample(&self) -> Option<(f32, [f32; 3])> {
        let [fx, fy, fz] = self.fraction;
        let node = |k: usize| f32x4::new(self.nodes[self.first + k]);

        // Blended along x, then y, then z; the slopes along each axis, and along each two, are intermediate results.
        let (low00, low10, low01, low11) = (node(0), node(SIDE), node(SIDE * SIDE), node(SIDE * SIDE + SIDE));
        let x00 = node(1) - low00;
        let x10 = node(SIDE + 1) - low10;
        let x01 = node(SIDE * SIDE + 1) - low01;
        let x11 = node(SIDE * SIDE + SIDE + 1) - low11;
        let (n00, n10) = (low00 + x00 * fx, low10 + x10 * fx);
        let (n01, n11) = (low01 + x01 * fx, low11 + x11 * fx);
        let (y0, y1) = (n10 - n00, n11 - n01);
        let (xy0, xy1) = (x10 - x00, x11 - x01);
        let (n0, n1) = (n00 + y0 * fy, n01 + y1 * fy);
        let (x0, x1) = (x00 + xy0 * fy, x01 + xy1 * fy);
        let (slope_z, xz, yz) = (n1 - n0, x1 - x0, y1 - y0);
        let (slope_x, slope_y) = (x0 + xz * fz, y0 + yz * fz);
        let xy = xy0 + (xy1 - xy0) * fz;
        let [_, _, _, blend] = (n0 + slope_z * fz).to_array();
        let ([gx, _, _, dx], [_, gy, _, dy]) = (slope_x.to_array(), slope_y.to_array());
        let [_, _, gz, dz] = slope_z.to_array();
        let [xy_x, xy_y, _, _] = xy.to_array();
        let ([xz_x, _, xz_z, _], [_, yz_y, yz_z, _]) = (xz.to_array(), yz.to_array());

        let half = self.half;
        let bend = |f: f32| half * (f - f * f);
        let (bx, by, bz) = (bend(fx), bend(fy), bend(fz));
        let slope = |f: f32| half - half * (f + f);
        let gradient = [
            dx - (slope(fx) * gx + by * xy_y + bz * xz_z),
            dy - (slope(fy) * gy + bx * xy_x + bz * yz_z),
            dz - (slope(fz) * gz + bx * xz_x + by * yz_y),
        ];
        (blend.abs() < MAX_BLENDED).then_some((blend - (bx * gx + by * gy + bz * gz), gradient))
    }
}

fn number([x, y, z]: [usize; 3]) -> usize {
    (z * SIDE + y) * SIDE + x
}

impl Node {
    /// No surface: beyond the rim of an open one. Finite, so that NaN in a file means damage.
    pub(super) const NONE: Self = Self([0.0, 0.0, 0.0, NO_SURFACE]);

    pub(super) fn new(distance: f64, gradient: &Vector3<f64>) -> Self {
        Self([gradient.x as f32, gradient.y as f32, gradient.z as f32, distance as f32])
    }
}
