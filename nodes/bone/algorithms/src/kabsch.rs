//! The rigid motion between paired points.

use crate::Refusal;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Below this ratio of singular values the points are a line to working precision: about the rounding of `f64` at
/// 10 km from the origin.
const COLLINEAR_RATIO: f64 = 1e-9;

/// Rigid motion that best carries `source` onto `target` in the least-squares sense, pairing points by index.
///
/// Lengths in millimetres. Always a proper rotation (det = +1), never a mirror image. `O(n)`.
///
/// # Errors
/// [`Refusal`] if the slices differ in length or hold fewer than three points, a coordinate is NaN or infinite, or the points
/// lie on a line.
///
/// # Source
/// Kabsch 1976; Umeyama 1991, eqs. 38-43 with scale 1. The coarse fit of section 2.3 of the paper.
pub fn kabsch(target: &[Point3<f64>], source: &[Point3<f64>]) -> Result<Isometry3<f64>, Refusal> {
    let (n_target, n_source) = (target.len(), source.len());
    if n_target != n_source || n_source < 3 {
        return Err(Refusal::of(format!(
            "three or more pairs are needed, but there are {n_target} target and {n_source} source points"
        )));
    }
    if let Some(index) = target.iter().zip(source).position(|(t, s)| !finite(t) || !finite(s)) {
        return Err(Refusal::of(format!("pair {index} is not finite; drop it before fitting")));
    }
    let (mean_target, mean_source) = (centroid(target), centroid(source));
    let covariance: Matrix3<f64> =
        target.iter().zip(source).map(|(t, s)| (t - mean_target) * (s - mean_source).transpose()).sum();
    let line = "the points lie on a line, which leaves the turn about it unknown; add a point off the line";
    from_covariance(&covariance, &mean_target, &mean_source).ok_or_else(|| Refusal::of(line))
}

/// The motion from the sum of `(t - mean_target)(s - mean_source)ᵀ`; `None` if its rank is below two.
pub(crate) fn from_covariance(
    covariance: &Matrix3<f64>,
    mean_target: &Point3<f64>,
    mean_source: &Point3<f64>,
) -> Option<Isometry3<f64>> {
    let svd = covariance.svd(true, true);
    if svd.singular_values[1] <= COLLINEAR_RATIO * svd.singular_values[0] {
        return None;
    }
    let (u, v_t) = svd.u.zip(svd.v_t)?;
    // Noise can favour a reflection; flipping the weakest axis gives the nearest rotation.
    let turn = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * turn * v_t));
    let translation = mean_target.coords - rotation * mean_source.coords;
    Some(Isometry3::from_parts(Translation3::from(translation), rotation))
}

/// The mean of the points, summed relative to the first so that a distant origin costs no digits; the origin if there
/// are none.
pub fn centroid(points: &[Point3<f64>]) -> Point3<f64> {
    let Some(&first) = points.first() else { return Point3::origin() };
    let sum: Vector3<f64> = points.iter().map(|p| p - first).sum();
    first + sum / points.len() as f64
}

pub(crate) fn finite(point: &Point3<f64>) -> bool {
    point.coords.iter().all(|c| c.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn motion(seed: f64) -> Isometry3<f64> {
        Isometry3::new(Vector3::new(seed, -3.0 * seed, 7.0), Vector3::new(seed.sin(), 0.4, seed.cos()) * 1.3)
    }

    fn corners() -> Vec<Point3<f64>> {
        [[0.0, 0.0, 0.0], [30.0, 0.0, 2.0], [5.0, 11.0, -4.0], [-7.0, 3.0, 19.0]].map(Point3::from).to_vec()
    }

    #[test]
    fn a_turn_of_30_degrees_about_z_is_found() {
        let truth = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::z() * (PI / 6.0));
        let target: Vec<_> = corners().iter().map(|p| truth * p).collect();
        let fit = kabsch(&target, &corners()).unwrap();
        assert!((fit.to_homogeneous() - truth.to_homogeneous()).amax() < 1e-13, "{fit}");
    }

    #[test]
    fn moving_the_source_multiplies_the_answer_and_swapping_inverts_it() {
        let target: Vec<_> = corners().iter().map(|p| motion(2.0) * p + Vector3::new(0.1, -0.2, 0.05)).collect();
        let fit = kabsch(&target, &corners()).unwrap();
        let moved: Vec<_> = corners().iter().map(|p| motion(5.0) * p).collect();
        let again = kabsch(&target, &moved).unwrap();
        assert!((again.to_homogeneous() - (fit * motion(5.0).inverse()).to_homogeneous()).amax() < 1e-12);
        let back = kabsch(&corners(), &target).unwrap();
        assert!(((back * fit).to_homogeneous() - nalgebra::Matrix4::identity()).amax() < 1e-12);
    }

    #[test]
    fn a_mirror_image_is_answered_by_a_proper_rotation() {
        let target: Vec<_> = corners().iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect();
        let fit = kabsch(&target, &corners()).unwrap();
        assert!((fit.rotation.to_rotation_matrix().matrix().determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn lines_too_few_points_and_nans_are_refused() {
        let line: Vec<_> = (0..5).map(|i| Point3::new(f64::from(i), 2.0 * f64::from(i), 1e6)).collect();
        let refusal = |target: &[_], source: &[_]| kabsch(target, source).unwrap_err().to_string();
        assert!(refusal(&line, &line).starts_with("the points lie on a line"));
        assert!(refusal(&[Point3::origin(); 4], &[Point3::origin(); 4]).starts_with("the points lie on a line"));
        assert!(refusal(&corners()[..2], &corners()[..2]).ends_with("there are 2 target and 2 source points"));
        assert!(refusal(&corners(), &corners()[..3]).ends_with("there are 4 target and 3 source points"));
        let mut wild = corners();
        wild[2].y = f64::NAN;
        assert_eq!(refusal(&corners(), &wild), "pair 2 is not finite; drop it before fitting");
    }
}
