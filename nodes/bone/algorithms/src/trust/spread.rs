//! Spread of a pose, from the residuals that it leaves.

use super::residuals::Residual;
use crate::kabsch::centroid;
use crate::nearest::Nearest;
use crate::normals::area_normal;
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Point3, Vector3, Vector6};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Number of points that a plane of the scan is fitted to: 1.5 mm around in a scan of 5,000 points, whose noise of 0.05 mm then
/// tilts it by half a degree.
const N_PLANE: usize = 40;

/// No plane is fitted to points this far around, mm: a bone bends away.
const WIDE_MM: f64 = 5.0;

/// Cosine of 30 degrees. A point of the scan whose own normal is farther from the surface's lies on something else that passes
/// the bone there: its bed, or the edge of a film.
const SAME_SIDE: f64 = 0.866;

/// Covariance of the pose of a registered scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// Of a shift (mm) and a turn (rad) about `centre`, target's axes.
    pub covariance: Matrix6<f64>,
    /// Centroid of the pairs, target's frame, mm.
    pub centre: Point3<f64>,
    /// Covariance caused by an error of the surface of 1 mm (RMS), constant over a cell and independent between cells.
    pub bias: Matrix6<f64>,
    /// Number of cells.
    pub n_cells: usize,
}

impl Spread {
    /// The spread of the pose that these residuals leave, with the residuals of one cell of `cell_mm` taken for one draw.
    ///
    /// A delete-one-cell jackknife of the linearised registration: cells whose removal moves the scan far make it wide. `None`
    /// if the points leave a motion undetermined, with or without one of the cells.
    ///
    /// How firmly the shape holds the scan is taken from the product of the surface's and the scan's normals, each of which has
    /// its own error (an instrumental variable). Squares of the surface's normals would take its roughness for shape: a rough
    /// CT surface of a straight shaft then seems to hold the scan along the bone, and does not.
    pub fn new(pairs: &[Residual], cell_mm: f64) -> Option<Self> {
        let points: Vec<Point3<f64>> = pairs.iter().map(|pair| pair.point).collect();
        let centre = centroid(&points);
        let mut cells: BTreeMap<[i64; 3], Cell> = BTreeMap::new();
        for (pair, scan_normal) in pairs.iter().zip(scan_normals(pairs, &points)) {
            if scan_normal.dot(&pair.normal) < SAME_SIDE {
                continue;
            }
            let row = |n: &Vector3<f64>| {
                let turn = (pair.point - centre).cross(n);
                Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z)
            };
            let key = std::array::from_fn(|k| ((pair.point[k] - centre[k]) / cell_mm).floor() as i64);
            cells.entry(key).or_default().add(&row(&pair.normal), &row(&scan_normal), pair.signed_mm);
        }
        let h: Matrix6<f64> = cells.values().map(|cell| cell.h).sum();
        let b: Vector6<f64> = cells.values().map(|cell| cell.b).sum();
        let inverse = h.cholesky()?.inverse();
        let whole = inverse * b;
        let (mut covariance, mut bias) = (Matrix6::zeros(), Matrix6::zeros());
        for cell in cells.values() {
            let moved = (h - cell.h).cholesky()?.solve(&(b - cell.b)) - whole;
            covariance += moved * moved.transpose();
            bias += cell.rows * cell.rows.transpose();
        }
        let n_cells = cells.len();
        covariance *= (n_cells as f64 - 1.0) / n_cells as f64;
        let is_finite = covariance.iter().all(|value| value.is_finite());
        is_finite.then_some(Self { covariance, centre, bias: inverse * bias * inverse, n_cells })
    }

    /// What an error of the surface of `rms_mm` adds to the covariance: its excess, in the directions in which it has any. The sum
    /// is the larger of both in every direction of a common basis, so that an error that both contain counts once.
    pub fn beyond(&self, rms_mm: f64) -> Matrix6<f64> {
        let other = self.bias * (rms_mm * rms_mm);
        let Some(root) = self.covariance.cholesky().map(|cholesky| cholesky.l()) else { return other };
        let Some(inverse) = root.try_inverse() else { return other };
        let eigen = (inverse * other * inverse.transpose()).symmetric_eigen();
        let excess = Matrix6::from_diagonal(&eigen.eigenvalues.map(|value| (value - 1.0).max(0.0)));
        let back = root * eigen.eigenvectors;
        back * excess * back.transpose()
    }

    /// The spread with that of an error of the surface of at least `rms_mm`.
    pub fn widened(mut self, rms_mm: f64) -> Self {
        self.covariance += self.beyond(rms_mm);
        self
    }

    /// Covariance of the position of a point of the target's frame that moves with the scan, mm².
    pub fn at(&self, point: &Point3<f64>) -> Matrix3<f64> {
        let mut motion = Matrix3x6::zeros();
        motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(point - self.centre).cross_matrix());
        motion * self.covariance * motion.transpose()
    }
}

/// The normal matrix of a shift and a turn about the centroid of pairs.
pub(super) fn normal_matrix(pairs: &[Residual]) -> Matrix6<f64> {
    let centre = centroid(&pairs.iter().map(|pair| pair.point).collect::<Vec<_>>());
    let row = |pair: &Residual| {
        let turn = (pair.point - centre).cross(&pair.normal);
        let n = &pair.normal;
        Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z)
    };
    pairs.iter().map(row).map(|row| row * row.transpose()).sum()
}

/// The outward unit normals of the scan itself, each of the plane through the points around; the surface's where these lie along a line, or
/// so far apart that the bone is no plane there: points of a trace have no normals of their own.
fn scan_normals(pairs: &[Residual], points: &[Point3<f64>]) -> Vec<Vector3<f64>> {
    let tree = Nearest::new(points);
    let of = |pair: &Residual| {
        let around: Vec<Point3<f64>> =
            tree.nearest_n(&pair.point, N_PLANE).into_iter().map(|(i, _)| points[i]).collect();
        let is_narrow = around.iter().all(|p| (p - pair.point).norm() < WIDE_MM);
        let own = if is_narrow { area_normal(&around) } else { None };
        let normal = own.unwrap_or(pair.normal);
        if normal.dot(&pair.normal) < 0.0 { -normal } else { normal }
    };
    pairs.par_iter().map(of).collect()
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
    fn add(&mut self, surface: &Vector6<f64>, scan: &Vector6<f64>, residual_mm: f64) {
        let product = surface * scan.transpose();
        self.h += 0.5 * (product + product.transpose());
        self.b += scan * residual_mm;
        self.rows += scan;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagonal(variances: [f64; 6]) -> Matrix6<f64> {
        Matrix6::from_diagonal(&Vector6::from(variances))
    }

    #[test]
    fn what_a_surface_adds_is_its_excess_in_each_direction() {
        let centre = Point3::new(1.0, 2.0, 3.0);
        let (covariance, bias) = (diagonal([4.0, 1.0, 1.0, 0.5, 2.0, 1.0]), diagonal([1.0, 1.0, 0.1, 0.25, 0.1, 0.5]));
        let spread = Spread { covariance, centre, bias, n_cells: 9 };
        // By an error of 3 mm: nine times the bias, less the covariance where that is smaller.
        let excess = diagonal([5.0, 8.0, 0.0, 1.75, 0.0, 3.5]);
        assert!((spread.beyond(3.0) - excess).norm() < 1e-12, "rounding alone: {}", spread.beyond(3.0));
        // In a basis in which neither is diagonal, the same.
        let turn =
            Matrix6::from_fn(|r, c| [1.0, 0.3, -0.2, 0.5, 0.1, 0.7][(r + 2 * c) % 6] + f64::from(u8::from(r == c)));
        let mixed = |m: &Matrix6<f64>| turn * m * turn.transpose();
        let spread = Spread { covariance: mixed(&covariance), centre, bias: mixed(&bias), n_cells: 9 };
        assert!((spread.beyond(3.0) - mixed(&excess)).norm() < 1e-9, "rounding alone");
        let widened = spread.clone().widened(3.0);
        assert!((widened.covariance - mixed(&(covariance + excess))).norm() < 1e-9, "rounding alone");
        assert_eq!((widened.centre, widened.bias, widened.n_cells), (centre, spread.bias, 9));
        // Without a spread of its own, all of it.
        let exact = Spread { covariance: Matrix6::zeros(), ..spread };
        assert_eq!(exact.beyond(2.0), exact.bias * 4.0);
    }

    #[test]
    fn a_turn_moves_a_point_by_its_arm_from_the_centre() {
        let centre = Point3::new(1.0, 2.0, 3.0);
        let of = |covariance| Spread { covariance, centre, bias: Matrix6::zeros(), n_cells: 9 };
        let shifted = of(diagonal([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])).at(&Point3::new(50.0, 0.0, 0.0));
        assert_eq!(shifted, Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 3.0)));
        // A turn about z by a radian moves a point 10 mm along x by 10 mm along y; with a shift along y that goes with it, by 12.
        let mut covariance = diagonal([0.0, 4.0, 0.0, 0.0, 0.0, 1.0]);
        (covariance[(1, 5)], covariance[(5, 1)]) = (2.0, 2.0);
        let turned = of(covariance).at(&Point3::new(11.0, 2.0, 3.0));
        assert_eq!(turned, Matrix3::from_diagonal(&Vector3::new(0.0, 144.0, 0.0)));
    }
}
