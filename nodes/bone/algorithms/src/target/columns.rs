//! The point grid of a target as flat columns, for files: sorting a hundred thousand points into it takes ten times as long as
//! reading the columns.

use super::{GridColumns, Index, Target, TargetError};
use crate::point_grid::PointGrid;
use std::sync::{Arc, OnceLock};

impl Target {
    /// The point grid as columns; built now if it was not.
    pub fn grid_columns(&self) -> GridColumns {
        self.index().cells().to_columns()
    }

    /// The target with the point grid of these columns.
    ///
    /// Every point is looked up once: columns of other points are refused, they never give a wrong neighbour. `O(n)`.
    ///
    /// # Errors
    /// [`TargetError::Damaged`] if they are not the grid of these points.
    pub fn with_grid_columns(self, columns: &GridColumns) -> Result<Self, TargetError> {
        let index = Index::new(&self.points);
        let grid = PointGrid::from_columns(&self.points, &index.centre, columns);
        let index = index.with_cells(grid.map_err(|what| TargetError::Damaged { what })?, columns.cell_mm);
        let index = Arc::new(OnceLock::from(index));
        Ok(Self { index, ..self })
    }
}
