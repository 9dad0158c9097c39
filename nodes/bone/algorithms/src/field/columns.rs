//! A field as three flat columns, for files.

use super::grid::{BLOCK, Grid, NO_BLOCK};
use super::{ClosestPointField, FieldError, FieldParams, Inner};
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_geometry::Column;
use std::sync::Arc;

/// Version of the layout, the first number of the head.
const LAYOUT: f64 = 1.0;

/// Length of the head.
const HEAD: usize = 1 + 3 + 9 + 4 + 2 * 7 + 1;

/// A field as columns, in the machine's byte order, in memory or in a mapped file.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldColumns {
    /// Layout, centre, axes column by column, parameters; spacing, lowest corner and number of blocks along each axis of the fine,
    /// then of the coarse grid; number of blocks of the fine grid.
    pub head: Column<f64>,
    /// Number of each block among the nodes, of the fine, then of the coarse grid; `u32::MAX` for none.
    pub index: Column<u32>,
    /// The nodes: gradient (in the field's axes) and distance, four numbers each.
    pub nodes: Column<f32>,
}

impl ClosestPointField {
    /// The field as columns; index and nodes are shared, not copied.
    pub fn to_columns(&self) -> FieldColumns {
        let inner = &*self.inner;
        let mut head = vec![LAYOUT];
        head.extend(inner.centre.iter().chain(inner.axes.iter()));
        let FieldParams { fine_mm, band_mm, coarse_mm, reach_mm } = inner.params;
        head.extend([fine_mm, band_mm, coarse_mm, reach_mm]);
        for grid in &inner.grids {
            head.push(grid.spacing);
            head.extend(grid.corner.iter());
            head.extend(grid.blocks.map(|n| n as f64));
        }
        head.push(inner.n_fine as f64);
        FieldColumns { head: head.into(), index: inner.index.clone(), nodes: inner.nodes.clone() }
    }

    /// The field of these columns, which are not copied.
    ///
    /// Every number is checked, so that no look-up of a damaged file leaves the columns.
    ///
    /// # Errors
    /// [`FieldError::Damaged`] names the damage.
    pub fn from_columns(columns: FieldColumns) -> Result<Self, FieldError> {
        let damaged = |what: String| FieldError::Damaged { what };
        let head: &[f64; HEAD] = (&*columns.head)
            .try_into()
            .map_err(|_| damaged(format!("its head has {} numbers, {HEAD} are expected", columns.head.len())))?;
        if head[0] != LAYOUT {
            return Err(damaged(format!("its layout is {}, this program reads {LAYOUT}", head[0])));
        }
        if !head.iter().all(|n| n.is_finite()) {
            return Err(damaged("its head holds a number that is not finite".into()));
        }
        let centre = Point3::new(head[1], head[2], head[3]);
        let axes = Matrix3::from_column_slice(&head[4..13]);
        if (axes.tr_mul(&axes) - Matrix3::identity()).amax() > 1e-6 || axes.determinant() < 0.0 {
            return Err(damaged("its axes are no rotation".into()));
        }
        let params = FieldParams { fine_mm: head[13], band_mm: head[14], coarse_mm: head[15], reach_mm: head[16] };
        params.checked().map_err(|e| damaged(e.to_string()))?;
        let grids = [17, 24].map(|k| {
            let blocks = [head[k + 4], head[k + 5], head[k + 6]].map(|n| n as usize);
            Grid::new(head[k], Vector3::new(head[k + 1], head[k + 2], head[k + 3]), blocks)
        });
        if grids[0].spacing != params.fine_mm || grids[1].spacing != params.coarse_mm {
            return Err(damaged("its grids do not have the spacing of its parameters".into()));
        }
        let n_blocks = columns.nodes.len() / (4 * BLOCK);
        let n_fine = head[31] as usize;
        let n_entries = grids.each_ref().map(|grid| {
            let [x, y, z] = grid.blocks;
            x.checked_mul(y).and_then(|xy| xy.checked_mul(z)).unwrap_or(usize::MAX)
        });
        if n_entries[0].checked_add(n_entries[1]) != Some(columns.index.len()) {
            return Err(damaged(format!("its index has {} entries, which its grids do not have", columns.index.len())));
        }
        if !columns.nodes.len().is_multiple_of(4 * BLOCK) || n_fine > n_blocks {
            return Err(damaged(format!("it has {} numbers at its nodes, which make no blocks", columns.nodes.len())));
        }
        let (fine, coarse) = columns.index.split_at(n_entries[0]);
        for (index, n) in [(fine, n_fine), (coarse, n_blocks - n_fine)] {
            // The largest number but `NO_BLOCK`, which wraps to zero.
            let above = index.iter().fold(0, |most, &k| most.max(k.wrapping_add(1)));
            debug_assert_eq!(NO_BLOCK.wrapping_add(1), 0);
            if above as usize > n {
                return Err(damaged(format!("its index names block {}, but there are {n}", above - 1)));
            }
        }
        let largest = columns.nodes.iter().fold(0, |most, n| most.max(n.to_bits() & 0x7fff_ffff));
        if largest >= f32::INFINITY.to_bits() {
            return Err(damaged("a node is not finite".into()));
        }
        let FieldColumns { index, nodes, .. } = columns;
        Ok(Self { inner: Arc::new(Inner::new(centre, axes, params, grids, index, nodes, n_fine)) })
    }
}
