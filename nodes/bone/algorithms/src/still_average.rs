//! The mean pose of a marker at rest.

mod motion;
mod path;
mod take;
mod wander;

pub use path::{MarkerPath, PathError};
pub use take::{BonePose, Carries, MarkerMotion, TakeMotion, TakeTime};
pub use wander::Wander;

use motion::Motion;
use nalgebra::{Isometry3, Matrix4, Point3, Quaternion, UnitQuaternion, Vector3, Vector4};
use osteoflow_geometry::StampNs;
use serde::{Deserialize, Serialize};

/// The mean of the poses of a marker at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct StillAverage {
    /// The mean pose.
    pub mean: Isometry3<f64>,
    /// Deviations from the mean.
    pub report: StillReport,
}

/// Deviations of a marker from its mean pose over a window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StillReport {
    /// Number of samples.
    pub n: usize,
    /// RMS distance of the samples' origins from their mean, mm.
    pub rms_mm: f64,
    /// Largest such distance, mm.
    pub max_mm: f64,
    /// RMS angle of the samples from their mean, rad.
    pub rms_rad: f64,
    /// Largest such angle, rad.
    pub max_rad: f64,
    /// Distance between the mean origins of the window's first and second half, mm: shows drift, hardly noise.
    pub drift_mm: f64,
    /// Angle between the mean rotations of both halves, rad.
    pub drift_rad: f64,
    /// Noise of the origins: standard deviation along each axis, mm. From the differences of successive samples without the
    /// largest, so that neither a drift nor a step counts as noise. 0 with fewer than three samples.
    pub noise_mm: f64,
    /// Noise of the rotations: standard deviation about each axis, rad, from successive samples likewise.
    pub noise_rad: f64,
    /// Motion over the window: the length of the straight line fitted to the origins, mm. 0 with fewer than three samples,
    /// which do not tell motion from noise.
    pub moved_mm: f64,
    /// Rotation over the window, of the straight line fitted to the rotations, rad.
    pub moved_rad: f64,
    /// Motion that the noise explains, mm: a marker at rest exceeds it in one of 2,000 windows.
    pub explained_mm: f64,
    /// Rotation that the noise explains, rad: a marker at rest exceeds it in one of 2,000 windows.
    pub explained_rad: f64,
    /// The straight line fitted to the origins, from the first sample to the last, in the frame that the poses lead to, mm.
    #[serde(default)]
    pub shift_mm: [f64; 3],
    /// The straight line fitted to the rotations, from the first sample to the last, in that frame, rad.
    #[serde(default)]
    pub turn_rad: [f64; 3],
    /// The mean of the origins, in that frame, mm.
    #[serde(default)]
    pub at_mm: [f64; 3],
    /// Time from the first sample to the last, s; 0 where the samples have no times.
    #[serde(default)]
    pub span_s: f64,
    /// Stamp of the last sample; 0 where the samples have no times.
    #[serde(default)]
    pub until_ns: StampNs,
    /// The largest distance between two poses of one stamp in the stream so far, mm.
    #[serde(default)]
    pub contradiction_mm: f64,
    /// The largest angle between two poses of one stamp in the stream so far, rad.
    #[serde(default)]
    pub contradiction_rad: f64,
    /// How late the samples may be whose stamps look like times of arrival, s; 0 where they look like those of a clock.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub late_s: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Errors of [`still_average()`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StillError {
    /// There is no pose.
    #[error("no pose lies in the window; widen it, or was the marker lost?")]
    Empty,
    /// A pose is NaN or infinite.
    #[error("pose {index} is not finite; drop it before averaging")]
    NotFinite {
        /// The first such pose.
        index: usize,
    },
    /// The marker moved.
    #[error(
        "the marker moved by {moved_mm:.2} mm and {moved_rad:.4} rad within the window, {limit_mm} mm and {limit_rad} rad \
         are allowed; shorten the window"
    )]
    Moved {
        /// Distance found between the window's halves.
        moved_mm: f64,
        /// Angle found between the window's halves.
        moved_rad: f64,
        /// Distance allowed.
        limit_mm: f64,
        /// Angle allowed.
        limit_rad: f64,
    },
}

/// The mean of `poses`, in order of time: of the origins, and of the rotations by the eigenvector of the largest
/// eigenvalue of `Σ q qᵀ`, which does not depend on the signs of the quaternions. `O(n)`.
///
/// # Errors
/// [`StillError`] if there are no poses, one is not finite, or the window's halves differ by more than `limit_mm` or
/// `limit_rad`.
///
/// # Source
/// Markley et al. 2007, eq. 13, with equal weights.
pub fn still_average(poses: &[Isometry3<f64>], limit_mm: f64, limit_rad: f64) -> Result<StillAverage, StillError> {
    if let Some(index) = poses.iter().position(|p| !p.to_homogeneous().iter().all(|c| c.is_finite())) {
        return Err(StillError::NotFinite { index });
    }
    let mean = mean(poses).ok_or(StillError::Empty)?;
    let (early, late) = poses.split_at(poses.len() / 2);
    let (drift_mm, drift_rad) = match (self::mean(early), self::mean(late)) {
        (Some(a), Some(b)) => (origin_distance(&a, &b), a.rotation.angle_to(&b.rotation)),
        _ => (0.0, 0.0),
    };
    if drift_mm > limit_mm || drift_rad > limit_rad {
        return Err(StillError::Moved { moved_mm: drift_mm, moved_rad: drift_rad, limit_mm, limit_rad });
    }
    let (rms_mm, max_mm) = rms_and_max(poses.iter().map(|p| origin_distance(p, &mean)));
    let (rms_rad, max_rad) = rms_and_max(poses.iter().map(|p| p.rotation.angle_to(&mean.rotation)));
    let shifts: Vec<Vector3<f64>> = poses.iter().map(|p| p.translation.vector - mean.translation.vector).collect();
    let turns: Vec<Vector3<f64>> = poses.iter().map(|p| (mean.rotation.inverse() * p.rotation).scaled_axis()).collect();
    let (by_shift, by_turn) = (Motion::of(&shifts), Motion::of(&turns));
    let report = StillReport {
        n: poses.len(),
        rms_mm,
        max_mm,
        rms_rad,
        max_rad,
        drift_mm,
        drift_rad,
        noise_mm: by_shift.noise,
        noise_rad: by_turn.noise,
        moved_mm: by_shift.line.norm(),
        moved_rad: by_turn.line.norm(),
        explained_mm: by_shift.explained,
        explained_rad: by_turn.explained,
        shift_mm: by_shift.line.into(),
        turn_rad: (mean.rotation * by_turn.line).into(),
        at_mm: mean.translation.vector.into(),
        span_s: 0.0,
        until_ns: 0,
        contradiction_mm: 0.0,
        contradiction_rad: 0.0,
        late_s: 0.0,
    };
    Ok(StillAverage { mean, report })
}

fn mean(poses: &[Isometry3<f64>]) -> Option<Isometry3<f64>> {
    let first = poses.first()?;
    let n = poses.len() as f64;
    let shift: Vector3<f64> = poses.iter().map(|p| p.translation.vector - first.translation.vector).sum();
    let outer: Matrix4<f64> = poses.iter().map(|p| p.rotation.coords * p.rotation.coords.transpose()).sum();
    let eigen = outer.symmetric_eigen();
    let q: Vector4<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    // A quaternion and its negative are the same rotation; the sign follows the first sample.
    let q = if q.dot(&first.rotation.coords) < 0.0 { -q } else { q };
    let rotation = UnitQuaternion::from_quaternion(Quaternion::from_vector(q));
    Some(Isometry3::from_parts((first.translation.vector + shift / n).into(), rotation))
}

fn origin_distance(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a * Point3::origin() - b * Point3::origin()).norm()
}

fn rms_and_max(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut squares, mut max, mut n) = (0.0, 0.0_f64, 0_usize);
    for value in values {
        squares += value * value;
        max = max.max(value);
        n += 1;
    }
    ((squares / n.max(1) as f64).sqrt(), max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wobble(k: i32) -> Isometry3<f64> {
        let s = if k % 2 == 0 { 1.0 } else { -1.0 };
        Isometry3::new(Vector3::new(100.0 + 0.1 * s, 0.0, 1e6), Vector3::new(0.0, 3.1 + 0.01 * s, 0.0))
    }

    #[test]
    fn noise_averages_out_and_the_sign_of_a_quaternion_does_not_matter() {
        let mut poses: Vec<_> = (0..100).map(wobble).collect();
        for pose in poses.iter_mut().step_by(3) {
            pose.rotation = UnitQuaternion::new_unchecked(-pose.rotation.into_inner());
        }
        let still = still_average(&poses, 0.1, 0.01).unwrap();
        let truth = Isometry3::new(Vector3::new(100.0, 0.0, 1e6), Vector3::new(0.0, 3.1, 0.0));
        assert!(origin_distance(&still.mean, &truth) < 1e-9, "{}", still.mean);
        assert!(still.mean.rotation.angle_to(&truth.rotation) < 1e-7);
        assert!((still.report.rms_mm - 0.1).abs() < 1e-9 && (still.report.max_rad - 0.01).abs() < 1e-7);
        assert!(still.report.drift_mm < 1e-9);
    }

    #[test]
    fn a_marker_that_moves_is_refused_with_how_far() {
        let poses: Vec<_> = (0..20).map(|k| Isometry3::translation(f64::from(k) * 0.1, 0.0, 0.0)).collect();
        let error = still_average(&poses, 0.1, 0.01).unwrap_err();
        assert!(error.to_string().contains("1.00 mm"), "{error}");
        assert_eq!(still_average(&[], 0.1, 0.01), Err(StillError::Empty));
    }
}
