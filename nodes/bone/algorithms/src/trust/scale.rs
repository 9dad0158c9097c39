//! The scale of a scan against the surface.

use super::residuals::Residual;
use crate::kabsch::centroid;
use nalgebra::{Point3, SMatrix, SVector};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The scale of a scan, estimated beside its pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    /// Size of the scan over that of the surface: 1 if both are right.
    pub ratio: f64,
    /// Its standard deviation, by a jackknife over cells.
    pub sd: f64,
}

impl Scale {
    /// The scale that these residuals ask for, with the residuals of one cell of `cell_mm` taken for one draw; `None` if the
    /// points leave it or a motion undetermined.
    pub(super) fn new(on: &[Residual], cell_mm: f64) -> Option<Self> {
        let points: Vec<Point3<f64>> = on.iter().map(|near| near.point).collect();
        let centre = centroid(&points);
        let mut cells: BTreeMap<[i64; 3], (SMatrix<f64, 7, 7>, SVector<f64, 7>)> = BTreeMap::new();
        for near in on {
            let arm = near.point - centre;
            let (n, turn) = (near.normal, arm.cross(&near.normal));
            let row = SVector::<f64, 7>::from([n.x, n.y, n.z, turn.x, turn.y, turn.z, arm.dot(&n)]);
            let key = std::array::from_fn(|k| (arm[k] / cell_mm).floor() as i64);
            let cell = cells.entry(key).or_default();
            cell.0 += row * row.transpose();
            cell.1 += row * near.signed_mm;
        }
        let h: SMatrix<f64, 7, 7> = cells.values().map(|cell| cell.0).sum();
        let b: SVector<f64, 7> = cells.values().map(|cell| cell.1).sum();
        let excess = |h: SMatrix<f64, 7, 7>, b: SVector<f64, 7>| Some(h.cholesky()?.solve(&b)[6]);
        let whole = excess(h, b)?;
        let mut variance = 0.0;
        for (h_cell, b_cell) in cells.values() {
            variance += (excess(h - h_cell, b - b_cell)? - whole).powi(2);
        }
        let n = cells.len() as f64;
        let sd = (variance * (n - 1.0) / n).sqrt();
        (whole.is_finite() && sd.is_finite()).then_some(Self { ratio: 1.0 + whole, sd })
    }
}
