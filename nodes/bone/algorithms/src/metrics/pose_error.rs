use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

/// Error of a pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseErrorReport {
    /// Angle between both rotations, rad.
    pub rotation_rad: f64,
    /// Angle between both rotations, degrees.
    pub rotation_deg: f64,
    /// Error at the frame's origin, mm.
    pub origin_mm: f64,
    /// Error at the given point, mm.
    pub at_point_mm: f64,
    /// The given point, mm.
    pub point: [f64; 3],
}

/// The error `t * inverse(t_true)` as an angle, at the origin, and at `point` (mm, in the frame to which both map).
///
/// A rotation acts by its lever arm: 0.1 degree is 0.35 mm at 200 mm.
pub fn pose_error(error: &Isometry3<f64>, point: &Point3<f64>) -> PoseErrorReport {
    let rotation_rad = error.rotation.angle();
    PoseErrorReport {
        rotation_rad,
        rotation_deg: rotation_rad.to_degrees(),
        origin_mm: error.translation.vector.norm(),
        at_point_mm: (error * point - point).norm(),
        point: [point.x, point.y, point.z],
    }
}

/// RMS distance between points at two poses, mm; zero without points.
pub fn rms_apart_mm(points: &[Point3<f64>], a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let sum: f64 = points.iter().map(|p| (a * p - b * p).norm_squared()).sum();
    (sum / points.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_tenth_of_a_degree_is_a_third_of_a_millimetre_at_200_mm() {
        let turn = Isometry3::rotation(Vector3::x() * 0.1_f64.to_radians());
        let report = pose_error(&turn, &Point3::new(0.0, 0.0, 200.0));
        assert!((report.at_point_mm - 0.349).abs() < 1e-3, "{} mm", report.at_point_mm);
        assert!((report.rotation_deg - 0.1).abs() < 1e-12);
        assert_eq!(report.origin_mm, 0.0);
    }
}
