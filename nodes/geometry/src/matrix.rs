use nalgebra::{Isometry3, Matrix3, Matrix4, Rotation3, Translation3, UnitQuaternion};

/// How far a matrix may be from a rotation and still be one written with few digits: 0.001 is 0.06 degrees.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// A 4 × 4 matrix that is no rigid motion.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RotationError {
    /// The last row is not 0 0 0 1.
    #[error("the last row of a rigid motion is 0 0 0 1; is the matrix written column by column?")]
    LastRow,
    /// The matrix turns right-handed frames into left-handed ones.
    #[error("the matrix is a mirror image (determinant -1); are two axes swapped, or is it RAS where LPS is meant?")]
    Mirror,
    /// The upper left is not orthonormal.
    #[error("the upper left 3 x 3 is not a rotation: its columns are off by {error:.3}; is there a scale in it?")]
    NotOrthonormal {
        /// Largest entry of `RᵀR - I`.
        error: f64,
    },
}

/// The rigid motion written as a homogeneous matrix (translation in mm); small rounding in it is removed.
///
/// # Errors
/// [`RotationError`] if the matrix scales, shears, mirrors or projects.
pub fn isometry_from_matrix(matrix: &Matrix4<f64>) -> Result<Isometry3<f64>, RotationError> {
    let last = matrix.row(3);
    if (0..4).any(|k| (last[k] - if k == 3 { 1.0 } else { 0.0 }).abs() > 1e-9) {
        return Err(RotationError::LastRow);
    }
    let r: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let excess = r.transpose() * r - Matrix3::identity();
    // A NaN compares as false, so it is refused here too.
    if !excess.iter().all(|e| e.abs() <= ROTATION_TOLERANCE) {
        return Err(RotationError::NotOrthonormal { error: excess.amax() });
    }
    if r.determinant() < 0.0 {
        return Err(RotationError::Mirror);
    }
    let svd = r.svd(true, true);
    let (u, v_t) = svd.u.zip(svd.v_t).expect("both factors were asked for");
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t));
    Ok(Isometry3::from_parts(Translation3::new(matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]), rotation))
}

/// The rows of the homogeneous matrix of `isometry`, as results and plans write it.
pub fn matrix_rows(isometry: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let m = isometry.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_motion_survives_being_written_as_a_matrix() {
        let t = Isometry3::new(Vector3::new(1.0, -2.0, 3.0), Vector3::new(0.3, -0.2, 0.9));
        let back = isometry_from_matrix(&t.to_homogeneous()).unwrap();
        assert!((back.to_homogeneous() - t.to_homogeneous()).amax() < 1e-14);
    }

    #[test]
    fn a_mirror_a_scale_and_a_nan_are_refused() {
        let mirror = Matrix4::from_diagonal(&[1.0, 1.0, -1.0, 1.0].into());
        assert_eq!(isometry_from_matrix(&mirror), Err(RotationError::Mirror));
        let scale = Matrix4::from_diagonal(&[2.0, 2.0, 2.0, 1.0].into());
        assert!(matches!(isometry_from_matrix(&scale), Err(RotationError::NotOrthonormal { .. })));
        let mut nan = Matrix4::identity();
        nan[(0, 0)] = f64::NAN;
        assert!(isometry_from_matrix(&nan).is_err());
    }
}
