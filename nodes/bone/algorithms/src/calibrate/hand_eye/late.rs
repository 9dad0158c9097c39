//! Logs whose clocks differ.

use super::{Pair, misfit::misfit_mm, signs::TELLING_RMS_MM};
use crate::calibrate::misread::FAR_BETTER;
use nalgebra::Isometry3;

/// Largest difference of the clocks that is tried, ns: 5 s.
const FARTHEST_NS: i64 = 5_000_000_000;
/// Largest number of differences tried, and of poses by which they are judged.
const N_TRIED: usize = 1000;
const N_JUDGED: usize = 100;

pub(super) type Stamped = (i64, Isometry3<f64>);

/// The stamp of each pose of the target, with that of the marker nearest to it less `late_ns`; those without any within `max_ns` are
/// left out.
pub fn hand_eye_pairs(marker: &[Stamped], target: &[Stamped], late_ns: i64, max_ns: f64) -> Vec<(i64, Pair)> {
    let pair = |(stamp_ns, t_camera_target): &Stamped| {
        let off = |of: &Stamped| of.0.abs_diff(stamp_ns - late_ns);
        let nearest = marker.iter().min_by_key(|of| off(of))?;
        (off(nearest) as f64 <= max_ns).then_some((*stamp_ns, (nearest.1, *t_camera_target)))
    };
    target.iter().filter_map(pair).collect()
}

/// By how much the stamps of the target are later than those of the marker, ns, if another difference of the clocks than none explains
/// the poses far better; to about the time for which the camera was held still.
pub fn hand_eye_late(marker: &[Stamped], target: &[Stamped], max_ns: f64) -> Option<i64> {
    let target: Vec<Stamped> = target.iter().step_by(target.len().div_ceil(N_JUDGED).max(1)).copied().collect();
    let middle_ns = target.get(target.len() / 2)?.0;
    let misfit = |late_ns: i64| {
        let pairs: Vec<Pair> = hand_eye_pairs(marker, &target, late_ns, max_ns).into_iter().map(|of| of.1).collect();
        if pairs.len() < 6.max(target.len() / 2) { f64::INFINITY } else { misfit_mm(&pairs) }
    };
    let all: Vec<i64> = marker.iter().map(|(ns, _)| middle_ns - ns).filter(|late| late.abs() <= FARTHEST_NS).collect();
    let tried = all.iter().step_by(all.len().div_ceil(N_TRIED).max(1)).map(|late_ns| (misfit(*late_ns), *late_ns));
    let (mm, late_ns) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (late_ns.abs() as f64 > max_ns && mm < TELLING_RMS_MM && FAR_BETTER * mm < misfit(0)).then_some(late_ns)
}
