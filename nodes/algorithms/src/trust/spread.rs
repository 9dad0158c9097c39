//! Spread of a pose, from the residuals that it leaves.

use super::residuals::Residual;
use crate::kabsch::centroid;
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Point3, Vector6};
use std::collections::BTreeMap;

/// Covariance of the pose of a registered scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// Of a shift (mm) and a turn (rad) about `centre`, target's axes.
    pub covariance: Matrix6<f64>,
    /// Centroid of the pairs, target's frame, mm.
    pub centre: Point3<f64>,
    /// Covariance caused by an error of the surface of 1 mm (RMS), constant over a cell and independent between cells.
    pub bias: Matrix6<f64>,
    /// Covariance caused by independent noise of 1 mm.
    pub by_noise: Matrix6<f64>,
    /// Number of cells.
    pub n_cells: usize,
}

impl Spread {
    /// The spread of the pose that these residuals leave, with the residuals of one cell of `cell_mm` taken for one draw.
    ///
    /// A delete-one-cell jackknife of the linearised registration: cells whose removal moves the scan far make it wide. `None`
    /// if the points leave a motion undetermined, with or without one of the cells.
    pub fn new(pairs: &[Residual], cell_mm: f64) -> Option<Self> {
        let points: Vec<Point3<f64>> = pairs.iter().map(|pair| pair.point).collect();
        let centre = centroid(&points);
        let mut cells: BTreeMap<[i64; 3], Cell> = BTreeMap::new();
        for pair in pairs {
            let turn = (pair.point - centre).cross(&pair.normal);
            let row = Vector6::new(pair.normal.x, pair.normal.y, pair.normal.z, turn.x, turn.y, turn.z);
            let key = std::array::from_fn(|k| ((pair.point[k] - centre[k]) / cell_mm).floor() as i64);
            cells.entry(key).or_default().add(&row, pair.signed_mm);
        }
        let h: Matrix6<f64> = cells.values().map(|cell| cell.h).sum();
        let b: Vector6<f64> = cells.values().map(|cell| cell.b).sum();
        let inverse = h.try_inverse()?;
        let whole = inverse * b;
        let (mut covariance, mut bias) = (Matrix6::zeros(), Matrix6::zeros());
        for cell in cells.values() {
            let moved = (h - cell.h).try_inverse()? * (b - cell.b) - whole;
            covariance += moved * moved.transpose();
            bias += cell.rows * cell.rows.transpose();
        }
        let n_cells = cells.len();
        covariance *= (n_cells as f64 - 1.0) / n_cells as f64;
        let is_finite = covariance.iter().all(|value| value.is_finite());
        is_finite.then_some(Self { covariance, centre, bias: inverse * bias * inverse, by_noise: inverse, n_cells })
    }

    /// Covariance of the position of a point of the target's frame that moves with the scan, mm².
    pub fn at(&self, point: &Point3<f64>) -> Matrix3<f64> {
        self.carried(&self.covariance, point)
    }

    /// The same for independent noise of 1 mm.
    pub(super) fn by_noise_at(&self, point: &Point3<f64>) -> Matrix3<f64> {
        self.carried(&self.by_noise, point)
    }

    fn carried(&self, covariance: &Matrix6<f64>, point: &Point3<f64>) -> Matrix3<f64> {
        let mut motion = Matrix3x6::zeros();
        motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(point - self.centre).cross_matrix());
        motion * covariance * motion.transpose()
    }
}

/// Sums over the pairs of a cell.
#[derive(Default)]
struct Cell {
    h: Matrix6<f64>,
    b: Vector6<f64>,
    /// Sum of the rows: the right-hand side of a residual of 1 mm.
    rows: Vector6<f64>,
}

impl Cell {
    fn add(&mut self, row: &Vector6<f64>, residual_mm: f64) {
        self.h += row * row.transpose();
        self.b += row * residual_mm;
        self.rows += row;
    }
}
