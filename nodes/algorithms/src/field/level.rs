//! One grid of a field: blocks of nodes near the surface.

use super::four::Four;
use super::{FieldError, Node, Surface};
use crate::bvh::Aabb;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Cells of a block along each edge.
pub(super) const CELLS: usize = 4;
/// Nodes of a block along each edge: blocks share those on their faces, so that a cell needs one block only.
const SIDE: usize = CELLS + 1;
/// Nodes of a block.
pub(super) const BLOCK: usize = SIDE * SIDE * SIDE;
/// Where the index has no block.
pub(super) const NOTHING: u32 = u32::MAX;
/// More places for blocks than this are not laid out: 64 MB of index, a room of a cubic metre in steps of 1 mm.
const MAX_PLACES: f64 = 16_777_216.0;
/// What a node without surface holds for a distance, mm.
const NO_SURFACE: f32 = 1e30;
/// A blended distance above this, mm, has such a node among its eight.
const BESIDE: f32 = 1e6;
/// Blocks are looked for from boxes of so many blocks' edge.
const FIRST: usize = 8;

/// Where the blocks of a grid lie. Blocks are numbered x fastest; so are the nodes in them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    /// Distance between nodes, mm.
    pub(super) spacing: f64,
    /// The lowest corner, mm, along the field's axes about its centre.
    pub(super) corner: Vector3<f64>,
    /// Blocks along each axis.
    pub(super) blocks: [usize; 3],
    /// `1 / spacing`.
    per_mm: f64,
    /// Half the spacing.
    half: f32,
    /// Cells along each axis.
    cells: [u64; 3],
}

impl Grid {
    /// A grid that has room for everything within `band` of the surface.
    pub(super) fn around(extent: &Aabb, spacing: f64, band: f64) -> Result<Self, FieldError> {
        let block = spacing * CELLS as f64;
        let corner = extent.min - Vector3::repeat(band + spacing);
        let blocks = ((extent.max - corner + Vector3::repeat(band + spacing)) / block).map(|b| b.ceil().max(1.0));
        if blocks.product() > MAX_PLACES {
            return Err(FieldError::TooLarge { extent_mm: (extent.max - extent.min).max(), spacing_mm: spacing });
        }
        Ok(Self::new(spacing, corner, [blocks.x as usize, blocks.y as usize, blocks.z as usize]))
    }

    pub(super) fn new(spacing: f64, corner: Vector3<f64>, blocks: [usize; 3]) -> Self {
        let cells = blocks.map(|n| (n * CELLS) as u64);
        Self { spacing, corner, blocks, per_mm: 1.0 / spacing, half: (0.5 * spacing) as f32, cells }
    }

    /// Blocks that the index has places for.
    pub(super) fn n_places(&self) -> usize {
        self.blocks.iter().product()
    }

    fn place(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.blocks[1] + y) * self.blocks[0] + x
    }

    /// Fills the grid: the index and the nodes of the blocks that come within `band` of the surface.
    ///
    /// A search starts from what is nearest to the node before it, so it visits little. Each block is computed on its own
    /// and in one order, so the threads change nothing.
    pub(super) fn filled(&self, surface: &impl Surface, band: f64) -> (Vec<u32>, Vec<f32>) {
        let steps = self.blocks.map(|n| n.div_ceil(FIRST));
        let found: Vec<([usize; 3], u32)> = (0..steps.iter().product())
            .into_par_iter()
            .flat_map_iter(|k| {
                let first = [k % steps[0], k / steps[0] % steps[1], k / steps[0] / steps[1]].map(|b| b * FIRST);
                let mut found = Vec::new();
                self.near(surface, band, first, FIRST, None, &mut found);
                found
            })
            .collect();
        let mut index = vec![NOTHING; self.n_places()];
        for (number, (block, _)) in (0_u32..).zip(&found) {
            index[self.place(*block)] = number;
        }
        let mut nodes = vec![[0.0_f32; 4]; found.len() * BLOCK];
        nodes.par_chunks_mut(BLOCK).zip(&found).for_each(|(nodes, (block, nearest))| {
            self.fill(surface, *block, *nearest, &index, nodes);
        });
        for (number, (block, _)) in found.iter().enumerate() {
            self.share(*block, number, &index, &mut nodes);
        }
        (index, nodes.into_flattened())
    }

    /// The blocks of a cube of `size` blocks that come within `band`, each with what is nearest to its middle.
    fn near(
        &self,
        surface: &impl Surface,
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
        let low = self.at(first.map(|b| b * CELLS));
        let half_diagonal = |edge: f64| edge * 0.75_f64.sqrt();
        let nearest = surface.nearest(&(low + Vector3::repeat(edge / 2.0)), hint);
        if nearest.squared.sqrt() > band + half_diagonal(edge) {
            return;
        }
        let eighths = (0..8_usize).map(|k| [k & 1, k >> 1 & 1, k >> 2]);
        if size > 1 {
            for eighth in eighths {
                let first = std::array::from_fn(|axis| first[axis] + eighth[axis] * size / 2);
                self.near(surface, band, first, size / 2, Some(nearest.which), found);
            }
            return;
        }
        // A ball around the whole block is generous; those around its eighths are less so.
        let any = eighths.into_iter().any(|eighth| {
            let middle = low + Vector3::from(eighth.map(|k| edge * (0.25 + 0.5 * k as f64)));
            surface.nearest(&middle, Some(nearest.which)).squared.sqrt() <= band + half_diagonal(edge / 2.0)
        });
        if any {
            found.push((first, nearest.which));
        }
    }

    fn at(&self, node: [usize; 3]) -> Vector3<f64> {
        self.corner + Vector3::from(node.map(|i| i as f64 * self.spacing))
    }

    /// The blocks on the far sides of a block: of bit 0 along x, of bit 1 along y, of bit 2 along z.
    fn beyond(&self, block: [usize; 3], index: &[u32]) -> [u32; 8] {
        std::array::from_fn(|side| {
            let block: [usize; 3] = std::array::from_fn(|axis| block[axis] + (side >> axis & 1));
            if (0..3).all(|axis| block[axis] < self.blocks[axis]) { index[self.place(block)] } else { NOTHING }
        })
    }

    /// Computes the nodes of a block, but for those that a block beyond has, too.
    fn fill(&self, surface: &impl Surface, block: [usize; 3], nearest: u32, index: &[u32], nodes: &mut [[f32; 4]]) {
        let beyond = self.beyond(block, index);
        let mut hint = nearest;
        for k in 0..BLOCK {
            // There and back, so that each node is next to the one before.
            let z = k / (SIDE * SIDE);
            let row = k / SIDE % SIDE;
            let y = if z.is_multiple_of(2) { row } else { SIDE - 1 - row };
            let x = if (z + y).is_multiple_of(2) { k % SIDE } else { SIDE - 1 - k % SIDE };
            let side = usize::from(x == CELLS) | usize::from(y == CELLS) << 1 | usize::from(z == CELLS) << 2;
            if side != 0 && beyond[side] != NOTHING {
                continue;
            }
            let at = self.at([block[0] * CELLS + x, block[1] * CELLS + y, block[2] * CELLS + z]);
            let nearest = surface.nearest(&at, Some(hint));
            nodes[number([x, y, z])] = surface.node(&at, &nearest).0;
            hint = nearest.which;
        }
    }

    /// Takes over what blocks beyond have computed.
    fn share(&self, block: [usize; 3], this: usize, index: &[u32], nodes: &mut [[f32; 4]]) {
        let beyond = self.beyond(block, index);
        for (side, &other) in beyond.iter().enumerate().skip(1).filter(|(_, other)| **other != NOTHING) {
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

    /// The cell that holds a place along the field's axes about its centre; `None` where the grid has no block.
    #[inline(always)]
    pub(super) fn cell<'a>(&self, at: &Vector3<f64>, index: &[u32], nodes: &'a [[f32; 4]]) -> Option<Cell<'a>> {
        let c = (at - self.corner) * self.per_mm;
        let ((x, fx), (y, fy), (z, fz)) = (whole(c.x), whole(c.y), whole(c.z));
        if x >= self.cells[0] || y >= self.cells[1] || z >= self.cells[2] {
            return None;
        }
        let (x, y, z) = (x as usize, y as usize, z as usize);
        let number = *index.get(self.place([x / CELLS, y / CELLS, z / CELLS])).filter(|number| **number != NOTHING)?;
        let first = number as usize * BLOCK;
        let nodes = nodes.get(first..first + BLOCK)?.first_chunk()?;
        Some(Cell {
            nodes,
            first: ((z % CELLS) * SIDE + y % CELLS) * SIDE + x % CELLS,
            share: [fx, fy, fz],
            half: self.half,
        })
    }
}

/// The cell below a coordinate counted in cells, and how far into it.
///
/// Adding 1.5 · 2^52 leaves no bits for fractions, so it rounds to a whole number, which then stands in the lowest bits: two
/// additions where a conversion takes a dozen instructions. What is negative, too large or no number gives a cell beyond
/// all grids.
#[inline(always)]
fn whole(c: f64) -> (u64, f32) {
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    /// Never quite one, so that a node without surface is felt by the whole cell.
    const MOST: f32 = 1.0 - f32::EPSILON / 2.0;
    let shifted = (c - 0.5) + SHIFT;
    let share = (c - (shifted - SHIFT)) as f32;
    (shifted.to_bits().wrapping_sub(SHIFT.to_bits()), if share < MOST { share } else { MOST })
}

/// A cell of a grid and a place in it.
pub(super) struct Cell<'a> {
    nodes: &'a [[f32; 4]; BLOCK],
    /// Its lowest node.
    first: usize,
    /// The place, as shares of the cell's edges.
    share: [f32; 3],
    /// Half the spacing of the nodes, mm.
    half: f32,
}

impl Cell<'_> {
    /// Distance, mm, and its gradient along the grid's axes, about as long as the spacing; `None` beside a rim.
    ///
    /// The gradient is the very derivative of the distance: on bones it is nearer to the surface's normal than a blend of
    /// the nodes' gradients by a fifth, and a least-squares step sees the slope of what it lowers.
    #[inline(always)]
    pub(super) fn sample(&self) -> Option<(f32, [f32; 3])> {
        let [fx, fy, fz] = self.share;
        let node = |k: usize| Four::new(self.nodes[self.first + k]);

        // Blended along x, then y, then z; what rises along each axis, and along each two, falls out on the way.
        let (low00, low10, low01, low11) = (node(0), node(SIDE), node(SIDE * SIDE), node(SIDE * SIDE + SIDE));
        let x00 = node(1).minus(low00);
        let x10 = node(SIDE + 1).minus(low10);
        let x01 = node(SIDE * SIDE + 1).minus(low01);
        let x11 = node(SIDE * SIDE + SIDE + 1).minus(low11);
        let (n00, n10) = (low00.on(x00, fx), low10.on(x10, fx));
        let (n01, n11) = (low01.on(x01, fx), low11.on(x11, fx));
        let (y0, y1) = (n10.minus(n00), n11.minus(n01));
        let (xy0, xy1) = (x10.minus(x00), x11.minus(x01));
        let (n0, n1) = (n00.on(y0, fy), n01.on(y1, fy));
        let (x0, x1) = (x00.on(xy0, fy), x01.on(xy1, fy));
        let (rise_z, xz, yz) = (n1.minus(n0), x1.minus(x0), y1.minus(y0));
        let (rise_x, rise_y) = (x0.on(xz, fz), y0.on(yz, fz));
        let xy = xy0.on(xy1.minus(xy0), fz);
        let [_, _, _, blend] = n0.on(rise_z, fz).values();
        let ([gx, _, _, dx], [_, gy, _, dy], [_, _, gz, dz]) = (rise_x.values(), rise_y.values(), rise_z.values());
        let ([xy_x, xy_y, _, _], [xz_x, _, xz_z, _], [_, yz_y, yz_z, _]) = (xy.values(), xz.values(), yz.values());

        let half = self.half;
        let bend = |f: f32| half * (f - f * f);
        let (bx, by, bz) = (bend(fx), bend(fy), bend(fz));
        let slope = |f: f32| half - half * (f + f);
        let gradient = [
            dx - (slope(fx) * gx + by * xy_y + bz * xz_z),
            dy - (slope(fy) * gy + bx * xy_x + bz * yz_z),
            dz - (slope(fz) * gz + bx * xz_x + by * yz_y),
        ];
        (blend.abs() < BESIDE).then_some((blend - (bx * gx + by * gy + bz * gz), gradient))
    }
}

fn number([x, y, z]: [usize; 3]) -> usize {
    (z * SIDE + y) * SIDE + x
}

impl Node {
    /// No surface here: beyond the rim of an open one. Finite, so that a file with NaN in it is a damaged file.
    pub(super) const NONE: Self = Self([0.0, 0.0, 0.0, NO_SURFACE]);

    pub(super) fn new(distance: f64, gradient: &Vector3<f64>) -> Self {
        Self([gradient.x as f32, gradient.y as f32, gradient.z as f32, distance as f32])
    }
}
