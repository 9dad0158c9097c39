//! Pivot calibration: the tip of a tracked stylus, from poses of its marker while it is turned about its tip.

use crate::Refusal;
use nalgebra::{DMatrix, DVector, Isometry3, Point3};
use serde::{Deserialize, Serialize};

/// Maximum condition number of the equations: poses turned about one axis alone give infinity, a cone of 15 degrees
/// about 8.
const MAX_CONDITION: f64 = 100.0;

/// A stylus' tip and its accuracy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PivotReport {
    /// Number of poses.
    pub n_poses: usize,
    /// RMS distance between the tip of each pose and the pivot, mm.
    pub rms_mm: f64,
    /// Largest such distance, mm.
    pub max_mm: f64,
    /// Condition number of the equations: ratio of the largest to the smallest singular value.
    pub condition: f64,
    /// Standard deviation of the tip predicted from the residuals, RMS over its three directions, mm.
    pub tip_sd_mm: f64,
    /// The tip in the marker's frame, mm.
    pub tip: [f64; 3],
    /// The point about which it was turned, in the frame that the poses lead to, mm.
    pub pivot: [f64; 3],
}

/// The tip `t` of a stylus in its marker's frame and the pivot `p`, from `R_i t + x_i = p` for all poses, in the
/// least-squares sense; `O(n)`.
///
/// # Errors
/// [`Refusal`] if there are fewer than three poses, one is not finite, or they do not determine the tip.
///
/// # Source
/// Yaniv 2015, "Which pivot calibration?", Proc. SPIE 9415: the algebraic one-step method.
pub fn pivot(t_world_marker: &[Isometry3<f64>]) -> Result<PivotReport, Refusal> {
    let n = t_world_marker.len();
    if n < 3 {
        return Err(Refusal::of(format!(
            "{n} poses of the stylus, at least 3 are needed; turn it about its tip for some seconds"
        )));
    }
    if let Some(index) = t_world_marker.iter().position(|t| !t.to_homogeneous().iter().all(|x| x.is_finite())) {
        return Err(Refusal::of(format!("pose {index} of the stylus is not finite; drop it before calibrating")));
    }
    // Relative to the first marker, so that a distant world origin costs no digits.
    let first = t_world_marker[0].translation.vector;
    let mut equations = DMatrix::zeros(3 * n, 6);
    let mut right = DVector::zeros(3 * n);
    for (k, t) in t_world_marker.iter().enumerate() {
        equations.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(t.rotation.to_rotation_matrix().matrix());
        equations.fixed_view_mut::<3, 3>(3 * k, 3).copy_from(&-nalgebra::Matrix3::identity());
        right.fixed_rows_mut::<3>(3 * k).copy_from(&(first - t.translation.vector));
    }
    let svd = equations.svd(true, true);
    let (largest, smallest) = (svd.singular_values.max(), svd.singular_values.min());
    let condition = largest / smallest;
    if condition.is_nan() || condition > MAX_CONDITION {
        return Err(Refusal::of(format!(
            "the poses leave the tip open (condition {condition:.0}, at most {MAX_CONDITION} is allowed); tilt the stylus \
             farther, in all directions"
        )));
    }
    let solution = svd.solve(&right, 0.0).expect("both factors were asked for");
    let tip = Point3::new(solution[0], solution[1], solution[2]);
    let pivot = Point3::new(solution[3], solution[4], solution[5]) + first;
    let squares: Vec<f64> = t_world_marker.iter().map(|t| (t * tip - pivot).norm_squared()).collect();
    let sum: f64 = squares.iter().sum();
    // The covariance of the solution: the inverse of the normal matrix times the residuals' variance.
    let factor = svd.v_t.expect("both factors were asked for");
    let of_tip = |k: usize| (0..6).map(|i| (factor[(i, k)] / svd.singular_values[i]).powi(2)).sum::<f64>();
    let variance = sum / (3 * n - 6) as f64;
    Ok(PivotReport {
        n_poses: n,
        rms_mm: (sum / n as f64).sqrt(),
        max_mm: squares.iter().copied().fold(0.0, f64::max).sqrt(),
        condition,
        tip_sd_mm: (variance * (0..3).map(of_tip).sum::<f64>() / 3.0).sqrt(),
        tip: tip.coords.into(),
        pivot: pivot.coords.into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use rand::RngExt;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    const TIP: [f64; 3] = [12.0, -4.0, 158.0];

    /// Poses tilted by up to `deg` about the tip, which stands at (500, -800, 1200), with noise of the tip's place.
    fn poses(n: usize, deg: f64, noise_mm: f64, seed: u64) -> Vec<Isometry3<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut one = || 2.0 * rng.random::<f64>() - 1.0;
        let poses = (0..n).map(|_| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(one(), one(), 2.0 * one()) * deg.to_radians());
            // A uniform number of this width has the given standard deviation.
            let at = Vector3::new(500.0, -800.0, 1200.0) + Vector3::new(one(), one(), one()) * noise_mm * 3f64.sqrt();
            Translation3::from(at - turn * Vector3::from(TIP)) * turn
        });
        poses.collect()
    }

    fn off(report: &PivotReport) -> f64 {
        (Vector3::from(report.tip) - Vector3::from(TIP)).norm()
    }

    #[test]
    fn exact_poses_give_the_tip_and_the_pivot() {
        let report = pivot(&poses(20, 30.0, 0.0, 1)).unwrap();
        assert!(off(&report) < 1e-9 && report.rms_mm < 1e-9 && report.n_poses == 20, "{report:?}");
        assert!((Vector3::from(report.pivot) - Vector3::new(500.0, -800.0, 1200.0)).norm() < 1e-9);
    }

    #[test]
    fn noise_shows_in_the_residual_and_the_tip_errs_as_predicted() {
        let (mut found, mut predicted, mut rms) = (0.0, 0.0, 0.0);
        for seed in 0..200 {
            let report = pivot(&poses(60, 25.0, 0.1, seed)).unwrap();
            found += off(&report).powi(2) / 3.0 / 200.0;
            predicted += report.tip_sd_mm.powi(2) / 200.0;
            rms += report.rms_mm / 200.0;
        }
        let (found, predicted) = (found.sqrt(), predicted.sqrt());
        // 600 errors, correlated within a calibration: 10 %.
        assert!((found / predicted - 1.0).abs() < 0.1, "the tip errs by {found} mm per axis, {predicted} predicted");
        assert!((rms - 0.1 * 3f64.sqrt()).abs() < 0.01, "{rms} mm");
    }

    #[test]
    fn poses_turned_too_little_or_about_one_axis_are_refused() {
        let message = |poses: &[Isometry3<f64>]| pivot(poses).unwrap_err().to_string();
        assert!(message(&poses(2, 30.0, 0.0, 1)).starts_with("2 poses of the stylus"));
        assert!(message(&poses(30, 0.5, 0.05, 1)).starts_with("the poses leave the tip open"));
        let spun: Vec<_> = (0..30).map(|k| Isometry3::rotation(Vector3::z() * f64::from(k) * 0.1)).collect();
        assert!(message(&spun).starts_with("the poses leave the tip open"));
        let mut broken = poses(5, 30.0, 0.0, 1);
        broken[3].translation.vector.x = f64::NAN;
        assert!(message(&broken).starts_with("pose 3 of the stylus is not finite"));
    }
}
