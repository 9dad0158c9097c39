//! The motion of a scan that its registration leaves least certain, in words.

use crate::axes::largest_first;
use crate::kabsch::centroid;
use nalgebra::{Matrix3, Matrix6, Point3, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Share of a motion's squares from which its part is named.
const NAMED: f64 = 0.25;

/// The least certain motion of a scan, one standard deviation, by its long axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pattern {
    /// Slide along the scan's long axis, mm.
    pub slide_mm: f64,
    /// Spin about it, degrees.
    pub spin_deg: f64,
    /// Shift across it, mm.
    pub across_mm: f64,
    /// Turn about axes across it, degrees.
    pub tilt_deg: f64,
    /// Movement of the scan's points, RMS, mm; none where nothing holds it.
    pub rms_mm: Option<f64>,
    /// Shares of that movement's squares: slide, spin, across, tilt.
    pub shares: [f64; 4],
}

impl Pattern {
    /// The direction of `covariance`, of shift and turn about the points' centroid, that moves `points` most.
    pub(super) fn largest(covariance: &Matrix6<f64>, points: &[Point3<f64>]) -> Option<Self> {
        let scan = Scan::new(points)?;
        let root = scan.squares.cholesky()?.l();
        let eigen = (root.transpose() * covariance * root).symmetric_eigen();
        let k = eigen.eigenvalues.imax();
        let motion = root.transpose().try_inverse()? * eigen.eigenvectors.column(k);
        let rms_mm = eigen.eigenvalues[k].max(0.0).sqrt();
        Some(scan.pattern(&(motion * rms_mm), Some(rms_mm)))
    }

    /// The direction in which the normal matrix `h` of shift and turn holds `points` least: a movement of 1 mm (RMS) along it.
    pub(super) fn free(h: &Matrix6<f64>, points: &[Point3<f64>]) -> Option<Self> {
        let scan = Scan::new(points)?;
        let inverse = scan.squares.cholesky()?.l().try_inverse()?;
        let eigen = (inverse * h * inverse.transpose()).symmetric_eigen();
        let motion = inverse.transpose() * eigen.eigenvectors.column(eigen.eigenvalues.imin());
        Some(scan.pattern(&motion, None))
    }

    /// The motion in words: "slides along its long axis by 1.2 mm and spins about it by 3 degrees".
    pub fn words(&self) -> String {
        let sized = |what: &str, size: f64, unit: &str| match self.rms_mm {
            Some(_) => format!("{what} by {size:.1} {unit}"),
            None => what.to_owned(),
        };
        let parts = [
            sized("slides along its long axis", self.slide_mm, "mm"),
            sized("spins about its long axis", self.spin_deg, "degrees"),
            sized("shifts across its long axis", self.across_mm, "mm"),
            sized("tilts", self.tilt_deg, "degrees"),
        ];
        let largest = self.shares.iter().copied().fold(0.0, f64::max);
        let named = parts.into_iter().zip(self.shares).filter(|(_, share)| *share >= NAMED.min(largest));
        named.map(|(part, _)| part).collect::<Vec<_>>().join(" and ")
    }
}

/// The long axis of a scan, and the mean squares of its points' movement.
struct Scan {
    axis: Vector3<f64>,
    squares: Matrix6<f64>,
}

impl Scan {
    fn new(points: &[Point3<f64>]) -> Option<Self> {
        let middle = centroid(points);
        let scatter: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
        let scatter = scatter / points.len().max(1) as f64;
        let (axes, _) = largest_first(&scatter);
        let mut squares = Matrix6::identity();
        let turning = Matrix3::identity() * scatter.trace() - scatter;
        squares.fixed_view_mut::<3, 3>(3, 3).copy_from(&turning);
        (!points.is_empty()).then_some(Self { axis: axes[0], squares })
    }

    fn pattern(&self, motion: &Vector6<f64>, rms_mm: Option<f64>) -> Pattern {
        let (shift, turn) = (motion.fixed_rows::<3>(0).into_owned(), motion.fixed_rows::<3>(3).into_owned());
        let split = |v: &Vector3<f64>| {
            let along = self.axis * v.dot(&self.axis);
            (along, v - along)
        };
        let ((slide, across), (spin, tilt)) = (split(&shift), split(&turn));
        let turning = self.squares.fixed_view::<3, 3>(3, 3);
        let of = |turn: &Vector3<f64>| turn.dot(&(turning * turn));
        let squares = [slide.norm_squared(), of(&spin), across.norm_squared(), of(&tilt)];
        let all = squares.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        Pattern {
            slide_mm: slide.norm(),
            spin_deg: spin.norm().to_degrees(),
            across_mm: across.norm(),
            tilt_deg: tilt.norm().to_degrees(),
            rms_mm,
            shares: squares.map(|square| square / all),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a tube along z.
    fn tube() -> Vec<Point3<f64>> {
        (0..2400)
            .map(|k| {
                let (sin, cos) = (f64::from(k % 24) * 15.0).to_radians().sin_cos();
                Point3::new(6.0 * cos, 6.0 * sin, f64::from(k / 24))
            })
            .collect()
    }

    #[test]
    fn the_least_certain_motion_is_named_by_the_long_axis() {
        let diagonal = |values: [f64; 6]| Matrix6::from_diagonal(&Vector6::from(values));
        let words = |values: [f64; 6]| Pattern::largest(&diagonal(values), &tube()).unwrap().words();
        assert_eq!(words([0.01, 0.01, 1.44, 1e-8, 1e-8, 1e-8]), "slides along its long axis by 1.2 mm");
        // 0.1 rad at a radius of 6 mm is 0.6 mm.
        assert_eq!(words([0.01, 0.01, 0.01, 1e-8, 1e-8, 0.01]), "spins about its long axis by 5.7 degrees");
        assert_eq!(words([0.81, 0.01, 0.01, 1e-8, 1e-8, 1e-8]), "shifts across its long axis by 0.9 mm");
        assert_eq!(words([0.01, 0.01, 0.01, 0.01, 1e-8, 1e-8]), "tilts by 5.7 degrees");
        let mut screw = diagonal([0.001, 0.001, 1.0, 1e-8, 1e-8, 0.04]);
        (screw[(2, 5)], screw[(5, 2)]) = (0.2, 0.2);
        let found = Pattern::largest(&screw, &tube()).unwrap();
        assert_eq!(found.words(), "slides along its long axis by 1.0 mm and spins about its long axis by 11.5 degrees");
        assert!((found.rms_mm.unwrap() - (1.0 + 0.04 * 36.0_f64).sqrt()).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn what_nothing_holds_is_named_without_a_size() {
        let h = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 900.0, 900.0, 1e-9));
        let free = Pattern::free(&h, &tube()).unwrap();
        assert_eq!(free.words(), "spins about its long axis");
        assert_eq!(Pattern::free(&h, &[]), None);
    }
}
