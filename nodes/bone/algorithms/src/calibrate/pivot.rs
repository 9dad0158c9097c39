//! Pivot calibration: the tip of a tracked stylus, from poses of its marker while it is turned about its tip.

mod signs;

use super::inliers::{Gate, inliers, selected};
use super::interval::radius_90;
use crate::Refusal;
use crate::median::median;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Maximum condition number of the equations: poses turned about one axis alone give infinity, a cone of 15 degrees
/// about 8.
const MAX_CONDITION: f64 = 100.0;

/// Residuals beyond six standard deviations, one of which the median of lengths of three normal numbers is 1.538 times, are outliers: one
/// of millions of poses by chance. 1e-6 mm: rounding.
const GATE: Gate = Gate { share: 0.5, times: 6.0 / 1.538_2, least_mm: 1e-6 };

/// A stylus' tip and its accuracy.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PivotReport {
    /// Number of poses.
    pub n_poses: usize,
    /// Number of poses that were left out: the tip was elsewhere.
    pub n_outliers: usize,
    /// Indices of these poses, in order.
    pub outliers: Vec<usize>,
    /// Largest distance between the tip of a pose that was left out and the pivot, mm; 0 without any.
    pub outlier_max_mm: f64,
    /// Distance between the median tip in the first and in the last third of the poses, mm: a tip that slips drifts.
    pub drift_mm: f64,
    /// Number of independent poses that tell as much as those used, whose errors depend on those before them.
    pub n_effective: f64,
    /// RMS distance between the tip of each pose used and the pivot, mm.
    pub rms_mm: f64,
    /// Largest such distance, mm.
    pub max_mm: f64,
    /// Condition number of the equations: ratio of the largest to the smallest singular value.
    pub condition: f64,
    /// Standard deviation of the tip predicted from the residuals and the number of independent poses, RMS over its three
    /// directions, mm.
    pub tip_sd_mm: f64,
    /// Radius about the tip that holds its true place with a chance of 90 %, mm.
    pub error_90_mm: f64,
    /// The tip in the marker's frame, mm.
    pub tip: [f64; 3],
    /// The point about which it was turned, in the frame that the poses lead to, mm.
    pub pivot: [f64; 3],
}

/// The tip `t` of a stylus in its marker's frame and the pivot `p`, from `R_i t + x_i = p` for all poses in the order in which they
/// were taken, in the least-squares sense; `O(n)`.
///
/// Poses whose tip is farther from the pivot than six standard deviations, by the median of all, are left out: the tip had slipped,
/// or had not arrived. Where none is, the answer is that of all poses. Errors of poses that follow each other are alike, so the
/// predicted error counts as many independent poses as the autocorrelation of the residuals leaves.
///
/// # Errors
/// [`Refusal`] if there are fewer than three poses, one is not finite, they do not determine the tip, it is farther than 500 mm from its
/// marker, or more than 5 mm RMS from one place; with the cause if another reading explains the poses.
///
/// # Source
/// Yaniv 2015, "Which pivot calibration?", Proc. SPIE 9415: the algebraic one-step method. The start of the search for outliers: least
/// median of squares, Rousseeuw 1984. The number of independent poses: the initial positive sequence of Geyer 1992.
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
    let offsets_mm = |used: &[Isometry3<f64>]| -> Option<Vec<f64>> {
        let fit = Fit::of(used).ok().filter(|fit| fit.condition <= MAX_CONDITION)?;
        Some(t_world_marker.iter().map(|t| fit.residual(t).norm()).collect())
    };
    let is_used = inliers(t_world_marker, offsets_mm, &GATE);
    let used = selected(t_world_marker, &is_used);
    let fit = Fit::of(&used)?;
    let condition = fit.condition;
    if condition.is_nan() || condition > MAX_CONDITION {
        return Err(Refusal::of(format!(
            "the poses leave the tip open (condition {condition:.0}, at most {MAX_CONDITION} is allowed); tilt the stylus \
             farther, in all directions"
        )));
    }
    let report = report(&fit, &used, t_world_marker, &is_used);
    report.check(t_world_marker)?;
    Ok(report)
}

fn report(fit: &Fit, used: &[Isometry3<f64>], all: &[Isometry3<f64>], is_used: &[bool]) -> PivotReport {
    let residuals: Vec<Vector3<f64>> = used.iter().map(|t| fit.residual(t)).collect();
    let squares: Vec<f64> = residuals.iter().map(Vector3::norm_squared).collect();
    let sum: f64 = squares.iter().sum();
    let of_all: Vec<Vector3<f64>> = all.iter().map(|t| fit.residual(t)).collect();
    let outliers: Vec<usize> = (0..all.len()).filter(|k| !is_used[*k]).collect();
    let n_effective = used.len() as f64 / correlation_length(&residuals);
    // Three poses determine the tip, and leave nothing over to predict an error from beyond rounding.
    let variance = sum / (3 * used.len() - 6).max(1) as f64 * (used.len() as f64 / n_effective);
    PivotReport {
        n_poses: all.len(),
        n_outliers: outliers.len(),
        outlier_max_mm: outliers.iter().map(|k| of_all[*k].norm()).fold(0.0, f64::max),
        outliers,
        drift_mm: drift_mm(&of_all),
        n_effective,
        rms_mm: (sum / used.len() as f64).sqrt(),
        max_mm: squares.iter().copied().fold(0.0, f64::max).sqrt(),
        condition: fit.condition,
        tip_sd_mm: (variance * fit.tip_covariance.trace() / 3.0).sqrt(),
        error_90_mm: radius_90(&(variance * fit.tip_covariance), 3.0 * n_effective - 6.0),
        tip: fit.tip.coords.into(),
        pivot: fit.pivot.coords.into(),
    }
}

/// A least-squares fit.
struct Fit {
    tip: Point3<f64>,
    pivot: Point3<f64>,
    condition: f64,
    /// Covariance of the tip's coordinates for residuals of variance 1.
    tip_covariance: Matrix3<f64>,
}

impl Fit {
    fn of(t_world_marker: &[Isometry3<f64>]) -> Result<Self, Refusal> {
        let n = t_world_marker.len();
        // Relative to the first marker, so that a distant world origin costs no digits.
        let first = t_world_marker.first().map(|t| t.translation.vector).unwrap_or_default();
        let mut equations = DMatrix::zeros(3 * n, 6);
        let mut right = DVector::zeros(3 * n);
        for (k, t) in t_world_marker.iter().enumerate() {
            equations.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(t.rotation.to_rotation_matrix().matrix());
            equations.fixed_view_mut::<3, 3>(3 * k, 3).copy_from(&-Matrix3::identity());
            right.fixed_rows_mut::<3>(3 * k).copy_from(&(first - t.translation.vector));
        }
        let svd = equations.svd(true, true);
        let (largest, smallest) = (svd.singular_values.max(), svd.singular_values.min());
        let solution =
            svd.solve(&right, 0.0).map_err(|error| Refusal::of(format!("the poses give no tip: {error}")))?;
        // The covariance of the solution: the inverse of the normal matrix times the residuals' variance.
        let factor = svd.v_t.expect("both factors were asked for");
        let part = |k: usize, i: usize| factor[(i, k)] / svd.singular_values[i];
        let tip_covariance = Matrix3::from_fn(|j, k| (0..6).map(|i| part(j, i) * part(k, i)).sum::<f64>());
        Ok(Self {
            tip: Point3::new(solution[0], solution[1], solution[2]),
            pivot: Point3::new(solution[3], solution[4], solution[5]) + first,
            condition: largest / smallest,
            tip_covariance,
        })
    }

    fn residual(&self, t_world_marker: &Isometry3<f64>) -> Vector3<f64> {
        t_world_marker * self.tip - self.pivot
    }
}

fn drift_mm(residuals: &[Vector3<f64>]) -> f64 {
    let third = residuals.len() / 3;
    let middle =
        |of: &[Vector3<f64>]| Vector3::from_fn(|axis, _| median(&mut of.iter().map(|r| r[axis]).collect::<Vec<_>>()));
    (middle(&residuals[residuals.len() - third..]) - middle(&residuals[..third])).norm()
}

/// Number of residuals that tell as much as one independent residual, at least 1: the integrated autocorrelation time, summed in
/// pairs of lags up to the first that is not positive; `O(n²)` at worst.
fn correlation_length(residuals: &[Vector3<f64>]) -> f64 {
    let n = residuals.len();
    let at = |lag: usize| residuals.iter().zip(&residuals[lag..]).map(|(a, b)| a.dot(b)).sum::<f64>();
    let variance = at(0);
    if !(variance.is_finite() && variance > 0.0) {
        return 1.0;
    }
    let pairs = (0..n / 2).map(|k| (at(2 * k) + at(2 * k + 1)) / variance).take_while(|pair| *pair > 0.0);
    (2.0 * pairs.sum::<f64>() - 1.0).clamp(1.0, n as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
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
    fn poses_whose_tip_is_elsewhere_are_left_out_and_told() {
        let clean = pivot(&poses(60, 25.0, 0.1, 3)).unwrap();
        assert_eq!((clean.n_outliers, clean.outlier_max_mm), (0, 0.0));
        // The tip slips by 3.9 mm for eight poses, and the stylus is lifted for twelve more.
        let mut slipped = poses(60, 25.0, 0.1, 3);
        slipped[20..28].iter_mut().for_each(|t| t.translation.vector.x += 3.9);
        slipped[48..].iter_mut().enumerate().for_each(|(k, t)| t.translation.vector.z += 20.0 + 3.0 * k as f64);
        let report = pivot(&slipped).unwrap();
        assert_eq!((report.n_poses, report.n_outliers), (60, 20), "{report:?}");
        assert!((report.outlier_max_mm - 53.0).abs() < 0.5, "{report:?}");
        // 40 of 60 poses, three standard deviations.
        assert!(off(&report) < 3.0 * 3f64.sqrt() * report.tip_sd_mm, "{} mm off, {report:?}", off(&report));
        let kept: Vec<_> = slipped[..20].iter().chain(&slipped[28..48]).copied().collect();
        assert_eq!(pivot(&kept).unwrap().tip, report.tip, "the answer is that of the others");
    }

    #[test]
    fn correlated_poses_count_as_few_and_the_tip_errs_as_predicted() {
        // A tip that wanders within its divot: a first-order process with a time constant of ten poses.
        let (mut found, mut predicted, mut n_effective) = (0.0, 0.0, 0.0);
        let keep = (-0.1_f64).exp();
        for seed in 0..200 {
            let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
            let mut one = || 2.0 * rng.random::<f64>() - 1.0;
            let (mut at, mut tilt) = (Vector3::zeros(), Vector3::zeros());
            let poses: Vec<_> = (0..120)
                .map(|k| {
                    let push = Vector3::new(one(), one(), one()) * 0.2 * 3f64.sqrt();
                    at = at * keep + push * (1.0 - keep * keep).sqrt();
                    let angle = 0.15 * f64::from(k);
                    tilt = Vector3::new(angle.cos(), angle.sin(), (0.3 * angle).sin()) * 0.4;
                    let turn = UnitQuaternion::from_scaled_axis(tilt);
                    Translation3::from(Vector3::new(500.0, -800.0, 1200.0) + at - turn * Vector3::from(TIP)) * turn
                })
                .collect();
            let report = pivot(&poses).unwrap();
            found += off(&report).powi(2) / 3.0 / 200.0;
            predicted += report.tip_sd_mm.powi(2) / 200.0;
            n_effective += report.n_effective / 200.0;
        }
        let (found, predicted) = (found.sqrt(), predicted.sqrt());
        // 120 poses of a process whose sum of autocorrelations is 20, of which the fit takes some.
        assert!((6.0..25.0).contains(&n_effective), "{n_effective} independent poses");
        let ratio = predicted / found;
        assert!((0.75..1.5).contains(&ratio), "the tip errs by {found} mm per axis, {predicted} predicted");
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
