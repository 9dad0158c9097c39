//! The cells of a target as flat columns, for files: to lay a hundred thousand points out in them takes ten times as long
//! as to read the columns.

use super::{GridColumns, Index, Target, TargetError};
use crate::point_grid::PointGrid;
use std::sync::{Arc, OnceLock};

impl Target {
    /// The cells that the points are found by, as columns; built now if they were not.
    pub fn to_parts(&self) -> GridColumns {
        self.index().cells().to_columns()
    }

    /// The target with the cells that the columns hold, which are then not built.
    ///
    /// Every point is looked up once: columns of other points are refused, they never give a wrong neighbour. `O(n)`.
    ///
    /// # Errors
    /// [`TargetError::Damaged`] if they are not the cells of these points.
    pub fn with_parts(self, parts: &GridColumns) -> Result<Self, TargetError> {
        let index = Index::new(&self.points);
        let cells = PointGrid::from_columns(&self.points, &index.centre, parts);
        let index = index.with_cells(cells.map_err(|what| TargetError::Damaged { what })?, parts.cell_mm);
        let index = Arc::new(OnceLock::from(index));
        Ok(Self { index, ..self })
    }
}
