//! The samples of one marker over some seconds: where it was at a time, and how it moved over a time.

use super::{BonePose, StillReport, still_average};
use nalgebra::Isometry3;
use osteoflow_geometry::StampNs;
use serde::{Deserialize, Serialize};

/// Largest number of samples.
const N_SAMPLES: usize = 256;

/// Between samples that are farther apart the marker was lost, ns.
const MAX_GAP_NS: StampNs = 200_000_000;

/// Before the first sample and after the last one the marker is where it was then, for so long, ns: two frames of a slow tracker.
const MAX_BEYOND_NS: StampNs = 100_000_000;

/// Fewer samples do not tell motion from noise.
const MIN_SAMPLES: usize = 5;

/// Motion over a time that the noise explains, over the RMS distance of the samples from the straight line. 8: with noise that is white or
/// correlated by up to 0.96 from sample to sample, rounded to 0.11 mm or not, and repeated for up to 12 samples, one of 1,000 windows of 21
/// samples exceeds 9, of 61 samples 7.2.
const EXPLAINED: f64 = 8.0;

/// More is no noise of a tracker at rest: 0.5 mm and 0.15 degrees, ten times what is measured.
const MOST_MM: f64 = 0.5;
const MOST_RAD: f64 = 0.15 * std::f64::consts::PI / 180.0;

/// The samples of one marker over some seconds.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MarkerPath {
    /// In order of time, of long paths every second, third .. one.
    samples: Vec<PathSample>,
}

/// A sample of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct PathSample {
    stamp_ns: StampNs,
    #[serde(flatten)]
    pose: BonePose,
}

/// Errors of [`MarkerPath::at`].
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PathError {
    /// There is no sample.
    #[error("there are no poses of it")]
    Empty,
    /// The time is before the first sample or after the last one.
    #[error("its poses are there from {from_s:.2} s to {to_s:.2} s after the cloud's stamp only")]
    Outside {
        /// The first sample.
        from_s: f64,
        /// The last sample.
        to_s: f64,
    },
    /// The marker was lost for a time.
    #[error("it was not seen from {from_s:.2} s to {to_s:.2} s after the cloud's stamp")]
    Lost {
        /// The last sample before.
        from_s: f64,
        /// The first sample after.
        to_s: f64,
    },
}

impl MarkerPath {
    /// The path of samples in order of time. `O(1)` in the number of samples.
    pub fn of(samples: &[(StampNs, Isometry3<f64>)]) -> Self {
        let stride = samples.len().div_ceil(N_SAMPLES).max(1);
        // The newest sample is one of them.
        let first = (samples.len() + stride - 1) % stride;
        let sample = |(stamp_ns, pose): &(StampNs, Isometry3<f64>)| PathSample {
            stamp_ns: *stamp_ns,
            pose: BonePose::new(pose),
        };
        Self { samples: samples.iter().skip(first).step_by(stride).map(sample).collect() }
    }

    /// The pose at a time after `stamp_ns`, between the samples before and after it: linear in the origin, SLERP in the rotation. `O(log n)`.
    ///
    /// # Errors
    /// [`PathError`] if the time is more than 0.1 s beyond the samples, or between two that are more than 0.2 s apart.
    pub fn at(&self, stamp_ns: StampNs, after_ns: StampNs) -> Result<Isometry3<f64>, PathError> {
        let seconds = |sample: &PathSample| (sample.stamp_ns - stamp_ns) as f64 / 1e9;
        let (Some(first), Some(last)) = (self.samples.first(), self.samples.last()) else {
            return Err(PathError::Empty);
        };
        let at_ns = stamp_ns + after_ns;
        if at_ns < first.stamp_ns - MAX_BEYOND_NS || at_ns > last.stamp_ns + MAX_BEYOND_NS {
            return Err(PathError::Outside { from_s: seconds(first), to_s: seconds(last) });
        }
        let next = self.samples.partition_point(|sample| sample.stamp_ns < at_ns);
        let (Some(a), Some(b)) = (next.checked_sub(1).map(|k| &self.samples[k]), self.samples.get(next)) else {
            return Ok(if next == 0 { first } else { last }.pose.isometry());
        };
        let apart_ns = b.stamp_ns - a.stamp_ns;
        if apart_ns > MAX_GAP_NS && at_ns != b.stamp_ns {
            return Err(PathError::Lost { from_s: seconds(a), to_s: seconds(b) });
        }
        let share = (at_ns - a.stamp_ns) as f64 / apart_ns.max(1) as f64;
        let (a, b) = (a.pose.isometry(), b.pose.isometry());
        Ok(a.try_lerp_slerp(&b, share, 1e-12).unwrap_or(a))
    }

    /// The motion from one stamp to another: the straight line through the samples in between, against their distances from it. None with
    /// fewer than five samples.
    pub fn motion(&self, from_ns: StampNs, to_ns: StampNs) -> Option<StillReport> {
        let within = |sample: &&PathSample| (from_ns..=to_ns).contains(&sample.stamp_ns);
        let samples: Vec<&PathSample> = self.samples.iter().filter(within).collect();
        let (first, last) = (samples.first()?, samples.last().filter(|_| samples.len() >= MIN_SAMPLES)?);
        let poses: Vec<Isometry3<f64>> = samples.iter().map(|sample| sample.pose.isometry()).collect();
        let report = still_average(&poses, f64::INFINITY, f64::INFINITY).ok()?.report;
        let n = poses.len() as f64;
        let explained = |rms: f64, moved: f64, most: f64| {
            let of_line = moved * moved * (n + 1.0) / (12.0 * (n - 1.0));
            (EXPLAINED * (rms * rms - of_line).max(0.0).sqrt()).min(most)
        };
        Some(StillReport {
            span_s: (last.stamp_ns - first.stamp_ns) as f64 / 1e9,
            until_ns: last.stamp_ns,
            explained_mm: explained(report.rms_mm, report.moved_mm, MOST_MM),
            explained_rad: explained(report.rms_rad, report.moved_rad, MOST_RAD),
            ..report
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    const SCAN_NS: StampNs = 1_750_000_011_000_000_000;

    /// Samples at 20 Hz for 2 s on either side of a scan, without those in a gap.
    fn path(at: impl Fn(f64) -> Isometry3<f64>, gap_s: [f64; 2]) -> MarkerPath {
        let sample = |k: i64| (SCAN_NS + k * 50_000_000, at(k as f64 / 20.0));
        let is_seen = |(stamp_ns, _): &(StampNs, _)| {
            let s = (stamp_ns - SCAN_NS) as f64 / 1e9;
            s <= gap_s[0] || s >= gap_s[1]
        };
        MarkerPath::of(&(-40..=40).map(sample).filter(is_seen).collect::<Vec<_>>())
    }

    fn passing(s: f64) -> Isometry3<f64> {
        Isometry3::new(Vector3::new(3.0, -4.0, 12.0) * s + Vector3::x() * 1000.0, Vector3::z() * (0.2 * s + 3.0))
    }

    const NO_GAP: [f64; 2] = [0.0, 0.0];

    #[test]
    fn a_pose_between_samples_is_that_of_a_steady_motion_and_none_is_given_far_from_samples() {
        let path = path(passing, [1.0, 1.5]);
        for s in [-2.0, -1.234, 0.0, 0.017, 1.0, 1.99] {
            let off = path.at(SCAN_NS, (s * 1e9) as StampNs).unwrap().inverse() * passing(s);
            let (mm, rad) = (off.translation.vector.norm(), off.rotation.angle());
            assert!(mm < 1e-5 && rad < 1e-7, "{mm} mm, {rad} rad at {s} s");
        }
        assert_eq!(path.at(SCAN_NS, 1_200_000_000), Err(PathError::Lost { from_s: 1.0, to_s: 1.5 }));
        let beyond = path.at(SCAN_NS, 2_050_000_000).unwrap();
        assert!(((beyond * Point3::origin()) - (passing(2.0) * Point3::origin())).norm() < 1e-9, "the last sample");
        assert_eq!(path.at(SCAN_NS, 2_150_000_000), Err(PathError::Outside { from_s: -2.0, to_s: 2.0 }));
        assert_eq!(MarkerPath::default().at(SCAN_NS, 0), Err(PathError::Empty));
    }

    #[test]
    fn a_path_is_thinned_evenly_and_keeps_the_newest_sample() {
        for n in [1, 255, 256, 257, 1000, 5123] {
            let samples: Vec<_> = (0..n).map(|k| (k as StampNs, passing(0.0))).collect();
            let path = MarkerPath::of(&samples).samples;
            assert!(path.len() <= N_SAMPLES && path.last().unwrap().stamp_ns == n as StampNs - 1, "of {n} samples");
            let steps: Vec<_> = path.windows(2).map(|w| w[1].stamp_ns - w[0].stamp_ns).collect();
            assert!(steps.iter().all(|step| *step == steps[0]) && path[0].stamp_ns < 20.max(n as StampNs / 200));
        }
    }

    #[test]
    fn the_motion_over_a_time_is_that_of_its_samples_and_its_noise_the_distance_from_a_line() {
        let shaken = |k: f64| Isometry3::translation(0.02 * (7.0 * k).sin(), 0.02 * (11.0 * k).cos(), 0.0);
        let moving = |s: f64| passing(s) * shaken(20.0 * s);
        let motion = path(moving, NO_GAP).motion(SCAN_NS - 500_000_000, SCAN_NS + 1_000_000_000).unwrap();
        assert_eq!((motion.n, motion.span_s), (31, 1.5));
        assert!((motion.moved_mm - 19.5).abs() < 0.05, "13 mm/s for 1.5 s, not {} mm", motion.moved_mm);
        assert!((motion.moved_rad - 0.3).abs() < 1e-6 && motion.moved_rad > motion.explained_rad);
        assert!((0.05..0.5).contains(&motion.explained_mm), "{} mm", motion.explained_mm);
        let rest = path(|s| shaken(20.0 * s), NO_GAP).motion(SCAN_NS - 500_000_000, SCAN_NS + 500_000_000).unwrap();
        assert!(rest.moved_mm < rest.explained_mm, "{rest:?}");
        assert_eq!(path(passing, NO_GAP).motion(SCAN_NS, SCAN_NS + 150_000_000), None, "four samples");
    }
}
