//! Whether numbers from outside are a rigid motion, and how much may be corrected.
//!
//! The **deviation** of a rotation is its distance from the nearest rotation, in the numbers it is written in:
//!
//! - of a quaternion `q`, `|1 − ‖q‖|`. Rounding each component to three decimals changes the length by less than 0.001,
//!   so such a quaternion is always within [`ROUNDED_ROTATION`].
//! - of a matrix `R`, the largest `|1 − σ|` over its singular values, which is the spectral norm of `R` minus the nearest
//!   rotation: the farthest that a point at distance 1 moves if the one is used for the other. The entries of `RᵀR − I`
//!   say the same twice as large, and refuse one in five matrices of three decimals at the same limit.
//!
//! A rotation used with its deviation moves a point at a distance of 1 m by up to `lever arm × deviation`:
//!
//! | Deviation | Matrix, mm at 1 m | Quaternion, mm at 1 m |
//! |---|---|---|
//! | [`ROTATION_NOISE`], 1e-8 | 0.00001 | 0.00004 |
//! | [`EXACT_ROTATION`], 1e-6 | 0.001 | 0.004 |
//! | [`ROUNDED_ROTATION`], 1e-3 | 1 | 4 |
//!
//! A quaternion counts four times because `q v q*` scales the displacement `Rv − v` by `‖q‖²`, and the displacement is up
//! to twice the distance.

use crate::farthest::{TooFar, first_not};
use nalgebra::{Isometry3, Matrix3, Matrix4, Quaternion, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use std::fmt;

/// Largest deviation of a rotation in double precision, from a plugin, an exact recording or `results.json`: 0.004 mm at
/// 1 m. It is used as it is, bit for bit; beyond, it is refused.
pub const EXACT_ROTATION: f64 = 1e-6;

/// Largest deviation of a rotation that was rounded, in a file or a message: 4 mm at 1 m if it were used as it is. The
/// nearest rotation is taken, and the correction is reported; beyond, the rotation is refused.
pub const ROUNDED_ROTATION: f64 = 1e-3;

/// Largest correction that is not reported: 0.00004 mm at 1 m, from computing in double precision or rounding to nine
/// decimals. Single precision is above it.
pub const ROTATION_NOISE: f64 = 1e-8;

/// Shorter quaternions and directions are zero.
const SHORTEST: f64 = 1e-6;

const MM_AT_1_M: f64 = 1e3;

/// Numbers that are no rigid motion.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RigidError {
    /// A number is NaN or infinite.
    #[error("the {what} is not finite")]
    NotFinite {
        /// `translation`, `quaternion` or `matrix`.
        what: &'static str,
    },
    /// A translation is beyond [`FARTHEST_MM`](crate::FARTHEST_MM).
    #[error("the translation: {0}")]
    TooFar(#[from] TooFar),
    /// The rotation is zero, or too short to be scaled.
    #[error("the {what} is zero")]
    Zero {
        /// `quaternion` or `matrix`.
        what: &'static str,
    },
    /// The last row of a 4 × 4 matrix is not 0 0 0 1.
    #[error("the last row of a rigid motion is 0 0 0 1; is the matrix written column by column?")]
    LastRow,
    /// The matrix turns right-handed frames into left-handed ones.
    #[error(
        "the matrix is a mirror image (determinant {determinant:.3}); are two axes swapped, or is it RAS where LPS is meant?"
    )]
    Mirror {
        /// Below zero.
        determinant: f64,
    },
    /// A quaternion is too long or too short.
    #[error(
        "the quaternion has length {length} instead of 1, off by {:.1e} where {limit:.0e} is allowed; it would move a \
         point at 1 m by up to {} mm",
        (1.0 - .length).abs(), millimetres(Correction::of_quaternion(*.length).mm_at_1_m)
    )]
    Length {
        /// Its length.
        length: f64,
        /// The largest deviation that is allowed here.
        limit: f64,
    },
    /// The columns of a matrix are not orthonormal.
    #[error(
        "the upper left 3 x 3 is not a rotation: it is off by {deviation:.1e} where {limit:.0e} is allowed, and its columns \
         have lengths {:.4}, {:.4}, {:.4}; is there a scale in it?", .lengths[0], .lengths[1], .lengths[2]
    )]
    NotOrthonormal {
        /// Its deviation.
        deviation: f64,
        /// The lengths of its columns.
        lengths: [f64; 3],
        /// The largest deviation that is allowed here.
        limit: f64,
    },
}

/// How far a rotation was from the nearest one, which was taken instead.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd)]
pub struct Correction {
    /// The farthest that a point at 1 m would move if the rotation were used as written, mm.
    pub mm_at_1_m: f64,
    /// The deviation.
    pub deviation: f64,
}

impl Correction {
    /// Whether it is at most [`ROTATION_NOISE`], so that nobody needs to hear of it.
    pub fn is_noise(&self) -> bool {
        self.deviation <= ROTATION_NOISE
    }

    fn of_quaternion(length: f64) -> Self {
        let deviation = (1.0 - length).abs();
        Self { mm_at_1_m: 4.0 * MM_AT_1_M * deviation, deviation }
    }

    fn of_matrix(deviation: f64) -> Self {
        Self { mm_at_1_m: MM_AT_1_M * deviation, deviation }
    }
}

impl fmt::Display for Correction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1e}, {} mm at 1 m", self.deviation, millimetres(self.mm_at_1_m))
    }
}

/// A rigid motion or rotation as it is used, and how far its numbers were from it.
#[derive(Debug, Clone, PartialEq)]
pub struct Nearest<T> {
    /// The motion.
    pub value: T,
    /// Zero where nothing was changed.
    pub correction: Correction,
}

impl<T> Nearest<T> {
    /// The value mapped, with its correction.
    pub fn map<U>(self, f: impl FnOnce(T) -> U) -> Nearest<U> {
        Nearest { value: f(self.value), correction: self.correction }
    }
}

/// The corrections of one source, to be reported once.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Corrections {
    n: usize,
    n_corrected: usize,
    largest: Correction,
}

impl Corrections {
    /// Counts one rotation.
    pub fn add(&mut self, correction: Correction) {
        self.n += 1;
        self.n_corrected += usize::from(!correction.is_noise());
        if correction.mm_at_1_m > self.largest.mm_at_1_m {
            self.largest = correction;
        }
    }

    /// Counts a rotation and returns it.
    pub fn take<T>(&mut self, nearest: Nearest<T>) -> T {
        self.add(nearest.correction);
        nearest.value
    }

    /// The largest correction.
    pub fn largest(&self) -> Correction {
        self.largest
    }

    /// A sentence with the number of corrected rotations and the largest correction; `None` if all are below
    /// [`ROTATION_NOISE`].
    pub fn note(&self) -> Option<String> {
        let Self { n, n_corrected, largest } = self;
        (*n_corrected > 0).then(|| {
            format!(
                "{n_corrected} of {n} rotations are rounded, and the nearest rotation is used; the largest correction is \
                 {largest}"
            )
        })
    }
}

/// Millimetres with two digits that count.
fn millimetres(mm: f64) -> String {
    if mm >= 1e-3 { format!("{:.*}", (1.0 - mm.log10().floor()).max(0.0) as usize, mm) } else { format!("{mm:.0e}") }
}

/// The rigid motion of a translation in mm and a quaternion in double precision, bit for bit.
///
/// # Errors
/// [`RigidError`] if a number is not finite, the translation is too far, or the quaternion's length is farther than [`EXACT_ROTATION`] from 1.
pub fn exact_isometry(translation: Vector3<f64>, rotation: Quaternion<f64>) -> Result<Isometry3<f64>, RigidError> {
    if !translation.iter().all(|c| c.is_finite()) {
        return Err(RigidError::NotFinite { what: "translation" });
    }
    TooFar::check(translation.as_slice())?;
    quaternion_correction(&rotation, EXACT_ROTATION)?;
    Ok(Isometry3::from_parts(translation.into(), UnitQuaternion::new_unchecked(rotation)))
}

/// The rotation nearest to a quaternion that may be rounded.
///
/// # Errors
/// [`RigidError`] if a number is not finite, or the length is zero or farther than [`ROUNDED_ROTATION`] from 1.
pub fn nearest_rotation(quaternion: Quaternion<f64>) -> Result<Nearest<UnitQuaternion<f64>>, RigidError> {
    let correction = quaternion_correction(&quaternion, ROUNDED_ROTATION)?;
    Ok(Nearest { value: UnitQuaternion::from_quaternion(quaternion), correction })
}

fn quaternion_correction(quaternion: &Quaternion<f64>, limit: f64) -> Result<Correction, RigidError> {
    if !quaternion.coords.iter().all(|c| c.is_finite()) {
        return Err(RigidError::NotFinite { what: "quaternion" });
    }
    let length = quaternion.norm();
    if length < SHORTEST {
        return Err(RigidError::Zero { what: "quaternion" });
    }
    let correction = Correction::of_quaternion(length);
    if correction.deviation <= limit { Ok(correction) } else { Err(RigidError::Length { length, limit }) }
}

/// The rigid motion of a homogeneous matrix in double precision, translation in mm, such as one in `results.json`.
///
/// # Errors
/// [`RigidError`] if a number is not finite, the translation is too far, or the matrix projects, mirrors, or is farther than [`EXACT_ROTATION`] from a
/// rotation.
pub fn isometry_from_matrix(matrix: &Matrix4<f64>) -> Result<Isometry3<f64>, RigidError> {
    Ok(isometry_within(matrix, EXACT_ROTATION)?.value)
}

/// The rigid motion nearest to a homogeneous matrix that may be rounded, translation in mm.
///
/// # Errors
/// [`RigidError`] if a number is not finite, the translation is too far, or the matrix projects, mirrors, or is farther than [`ROUNDED_ROTATION`] from
/// a rotation.
pub fn nearest_isometry(matrix: &Matrix4<f64>) -> Result<Nearest<Isometry3<f64>>, RigidError> {
    isometry_within(matrix, ROUNDED_ROTATION)
}

fn isometry_within(matrix: &Matrix4<f64>, limit: f64) -> Result<Nearest<Isometry3<f64>>, RigidError> {
    if !matrix.iter().all(|c| c.is_finite()) {
        return Err(RigidError::NotFinite { what: "matrix" });
    }
    let last = matrix.row(3);
    if (0..4).any(|k| (last[k] - if k == 3 { 1.0 } else { 0.0 }).abs() > 1e-9) {
        return Err(RigidError::LastRow);
    }
    let nearest = rotation_within(&matrix.fixed_view::<3, 3>(0, 0).into_owned(), limit)?;
    let translation = Translation3::new(matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]);
    TooFar::check(translation.vector.as_slice())?;
    Ok(nearest.map(|rotation| Isometry3::from_parts(translation, UnitQuaternion::from_rotation_matrix(&rotation))))
}

/// Checks that a matrix in double precision is a rotation; it is used as it is.
///
/// # Errors
/// [`RigidError`] if a number is not finite, or the matrix mirrors or is farther than [`EXACT_ROTATION`] from a rotation.
pub fn check_rotation(matrix: &Matrix3<f64>) -> Result<(), RigidError> {
    rotation_within(matrix, EXACT_ROTATION).map(drop)
}

/// The rotation nearest to a matrix, by its singular value decomposition.
fn rotation_within(matrix: &Matrix3<f64>, limit: f64) -> Result<Nearest<Rotation3<f64>>, RigidError> {
    if !matrix.iter().all(|c| c.is_finite()) {
        return Err(RigidError::NotFinite { what: "matrix" });
    }
    if *matrix == Matrix3::zeros() {
        return Err(RigidError::Zero { what: "matrix" });
    }
    let determinant = matrix.determinant();
    if determinant < 0.0 {
        return Err(RigidError::Mirror { determinant });
    }
    let lengths = [0, 1, 2].map(|k| matrix.column(k).norm());
    // The decomposition need not converge where squares overflow.
    if matrix.amax() > 1e6 {
        return Err(RigidError::NotOrthonormal { deviation: matrix.amax(), lengths, limit });
    }
    let svd = matrix.svd(true, true);
    let deviation = svd.singular_values.iter().map(|s| (1.0 - s).abs()).fold(0.0, f64::max);
    if deviation > limit {
        return Err(RigidError::NotOrthonormal { deviation, lengths, limit });
    }
    let (u, v_t) = svd.u.zip(svd.v_t).expect("both factors were asked for");
    let value = Rotation3::from_matrix_unchecked(u * v_t);
    Ok(Nearest { value, correction: Correction::of_matrix(deviation) })
}

/// The unit vector along a direction of any length.
///
/// # Errors
/// A message, if a number is not finite, or the length is below 1e-6 or overflows.
pub fn direction(vector: Vector3<f64>) -> Result<Unit<Vector3<f64>>, String> {
    if !vector.iter().all(|c| c.is_finite()) {
        return Err("a direction is three finite numbers".into());
    }
    let length = vector.norm();
    let unit = Unit::try_new(vector, SHORTEST).filter(|_| length.is_finite());
    unit.ok_or_else(|| format!("a direction has a length above zero, this one has {length:e}"))
}

/// The index and length of the first normal whose length is farther than [`EXACT_ROTATION`] from 1, or NaN.
pub fn first_not_unit(normals: &[Vector3<f64>]) -> Option<(usize, f64)> {
    // The squared length is off by twice as much.
    let is_unit = |n: &Vector3<f64>| (n.norm_squared() - 1.0).abs() <= 2.0 * EXACT_ROTATION;
    let index = first_not(normals, is_unit)?;
    Some((index, normals[index].norm()))
}

/// The rows of the homogeneous matrix of `isometry`, as results and plans write it.
pub fn matrix_rows(isometry: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let m = isometry.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)]))
}

#[cfg(test)]
mod tests;
