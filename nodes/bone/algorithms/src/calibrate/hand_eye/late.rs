//! Logs whose clocks differ.

use super::agreeing::misfit_mm;
use super::causes::FAR_BETTER;
use super::signs::TELLING_RMS_MM;
use nalgebra::Isometry3;

/// Largest difference of the clocks that is tried, ns: 5 s.
const FARTHEST_NS: i64 = 5_000_000_000;
/// Largest number of differences tried, and of poses by which they are judged.
const N_TRIED: usize = 1000;
const N_JUDGED: usize = 100;
/// Least number of pairs by which a difference is judged.
const LEAST_PAIRS: usize = 6;

/// A pose and its stamp.
pub(super) type Stamped = (i64, Isometry3<f64>);

/// Each pose of the target with that of the marker nearest to its stamp less `late_ns`, and the stamp; those without any within
/// `max_ns` are left out.
pub fn hand_eye_pairs(
    marker: &[Stamped],
    target: &[Stamped],
    late_ns: i64,
    max_ns: f64,
) -> Vec<(i64, Isometry3<f64>, Isometry3<f64>)> {
    let pair = |(stamp_ns, t_camera_target): &Stamped| {
        let off = |of: &Stamped| of.0.abs_diff(stamp_ns - late_ns);
        let nearest = marker.iter().min_by_key(|of| off(of))?;
        (off(nearest) as f64 <= max_ns).then_some((*stamp_ns, nearest.1, *t_camera_target))
    };
    target.iter().filter_map(pair).collect()
}

/// By how much the stamps of the target are later than those of the marker, ns, and the misfit with that, mm, if another difference of
/// the clocks than none explains the poses far better; in steps of the marker's stamps.
pub fn hand_eye_late(marker: &[Stamped], target: &[Stamped], max_ns: f64) -> Option<(i64, f64)> {
    let target: Vec<Stamped> = target.iter().step_by(target.len().div_ceil(N_JUDGED).max(1)).copied().collect();
    let middle_ns = target.get(target.len() / 2)?.0;
    let misfit = |late_ns: i64| {
        let pairs: Vec<_> =
            hand_eye_pairs(marker, &target, late_ns, max_ns).into_iter().map(|(_, m, t)| (m, t)).collect();
        if pairs.len() < LEAST_PAIRS.max(target.len() / 2) { f64::INFINITY } else { misfit_mm(&pairs) }
    };
    let all: Vec<i64> = marker.iter().map(|(ns, _)| middle_ns - ns).filter(|late| late.abs() <= FARTHEST_NS).collect();
    let tried = all.iter().step_by(all.len().div_ceil(N_TRIED).max(1)).map(|late_ns| (*late_ns, misfit(*late_ns)));
    let (late_ns, mm) = tried.min_by(|a, b| a.1.total_cmp(&b.1))?;
    (late_ns.abs() as f64 > max_ns && mm < TELLING_RMS_MM && FAR_BETTER * mm < misfit(0)).then_some((late_ns, mm))
}
