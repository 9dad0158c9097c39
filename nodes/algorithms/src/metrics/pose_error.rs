use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

/// How far a pose is from the true one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseErrorReport {
    /// The turn between both, rad.
    pub rotation_rad: f64,
    /// The same in degrees, as calibrations are told.
    pub rotation_deg: f64,
    /// How far the frame's origin is off, mm.
    pub origin_mm: f64,
    /// How far the point asked for is off, mm.
    pub at_point_mm: f64,
    /// The point asked for, mm.
    pub point: [f64; 3],
}

/// The error `t * inverse(t_true)` told as a turn, at the origin, and at `point` (mm, in the frame that both lead to).
///
/// A turn acts by its lever arm: 0.1 degree is 0.35 mm at 200 mm, whatever the origin says.
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
