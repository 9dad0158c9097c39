//! The scale of the target's lengths.

use super::Motion;
use nalgebra::{Isometry3, Matrix3, Matrix3x4, Matrix4, Translation3, UnitQuaternion, Vector4};

/// The camera in its marker's frame with this rotation, and the scale of the target's lengths beside it: `(R_a - I) t - R t_b / scale =
/// -t_a` for all motions. `None` if they do not determine it.
pub(super) fn with_scale(rotation: UnitQuaternion<f64>, motions: &[Motion]) -> Option<(Isometry3<f64>, f64)> {
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for m in motions {
        let mut rows = Matrix3x4::zeros();
        let turn = m.a.rotation.to_rotation_matrix().into_inner() - Matrix3::identity();
        rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        rows.fixed_view_mut::<3, 1>(0, 3).copy_from(&-(rotation * m.b.translation.vector));
        normal += rows.transpose() * rows;
        right -= rows.transpose() * m.a.translation.vector;
    }
    let solution = normal.try_inverse()? * right;
    let (t, scale) = (Translation3::new(solution[0], solution[1], solution[2]), 1.0 / solution[3]);
    (scale.is_finite() && scale > 0.0).then_some((Isometry3::from_parts(t, rotation), scale))
}

/// The target's pose with lengths of the right scale.
pub(super) fn in_scale(t_camera_target: &Isometry3<f64>, scale: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(t_camera_target.translation.vector / scale), t_camera_target.rotation)
}
