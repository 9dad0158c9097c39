//! Poses of markers that are measurements, and why others are left out.

use super::{frozen::Frozen, one_stamp::OneStamp};
use osteoflow_algorithms::marker_stream::{Arrival, Cause, Kind, MotionLimits, Sample, judge};
pub(super) use osteoflow_formats::Sign;
use osteoflow_geometry::{Pose, StampNs, Step, TransformTree, nalgebra::Isometry3};
use osteoflow_node::{Emission, schemars::JsonSchema, serde::Deserialize};
use std::collections::BTreeMap;

/// Time between two samples up to which a transform of a chain is interpolated, ms: four periods of a slow tracker (20 Hz).
const MAX_GAP_MS: f64 = 200.0;

/// Time by which a stamp may be ahead of the next pose's or behind the last one's, as of a live source: longer than a network or a buffer
/// delays a pose.
const STRAY_NS: i128 = 10_000_000_000;

/// One of this many poses, or a single one, may have a damaged stamp.
const ONE_IN: usize = 20;

/// When poses of a recording or a log are lost.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PoseStreamParams {
    /// Silence after which a tracked marker is lost and the port gives an empty; also at the end, up to the last message on any
    /// topic or the last pose of the log. Unset: never.
    #[schemars(range(min = 1.0, max = 3_600_000.0))]
    pub lost_after_ms: Option<f64>,
    /// Time for which poses may be the same to the last bit while their stamps go on. Beyond it the tracker is frozen, and the
    /// port gives empties that say why until the pose changes. Unset: three times as long as this tracker repeats poses by
    /// chance, within 500 to 2000: at rest one that rounds to 0.1 mm repeats a pose for up to 0.85 s. 0: never, for a constant.
    #[schemars(range(min = 0.0, max = 3_600_000.0))]
    pub frozen_after_ms: Option<f64>,
    /// How a marker moves at most: poses that contradict it, or their neighbours, are left out and counted.
    pub motion: MotionLimits,
    /// Time between two samples up to which a transform is interpolated, if `parent` and `child` are joined by several
    /// transforms or an inverse: by the one path in their tree, each at the same time, as tf of ROS does. Unset: 200, four
    /// samples of a slow tracker.
    #[schemars(range(min = 0.0, max = 3_600_000.0))]
    pub max_gap_ms: Option<f64>,
}

/// A pose, and why it is not to be used, if it is not.
pub(super) type Sifted = (Pose, Option<String>);

/// The poses of markers in the order of their stamps, equal ones of one stamp once, those that are no measurements with the reason, or
/// left out where their neighbours are near enough to be interpolated; and the signs. `poses` are in the order in which they were sent.
pub(super) fn sifted(poses: Vec<Pose>, params: &PoseStreamParams) -> (Vec<Sifted>, Vec<Sign>) {
    let mut sent: BTreeMap<String, Vec<Pose>> = BTreeMap::new();
    for pose in poses {
        sent.entry(format!("t_{}_{}", pose.to, pose.from)).or_default().push(pose);
    }
    let (mut sifted, mut signs) = (Vec::new(), Vec::new());
    let mut one_stamp = OneStamp::default();
    for (what, mut poses) in sent {
        let strays = strays(&poses);
        if let Some(k) = strays.iter().position(|is_stray| *is_stray) {
            let (n, stamp_ns, before_ns) =
                (strays.iter().filter(|stray| **stray).count(), poses[k].stamp_ns, poses[k - 1].stamp_ns);
            let are = if n == 1 { "1 pose is" } else { &format!("{n} poses are") };
            let text = format!(
                "{what}: {are} left out, the stamp {stamp_ns} ns of the first is far from those of the poses before and after it \
                 ({before_ns} ns): it was damaged"
            );
            signs.push(("stray_stamps", text));
        }
        let mut strays = strays.into_iter();
        poses.retain(|_| !strays.next().unwrap_or_default());
        poses.sort_by_key(|pose| pose.stamp_ns);
        poses.retain(|pose| !one_stamp.is_repeat(&what, pose));
        sifted.extend(of_marker(&what, poses, params, &mut signs));
    }
    signs.extend(one_stamp.notes().into_iter().map(|note| ("stamps_contradict", note)));
    sifted.sort_by_key(|(pose, _)| pose.stamp_ns);
    (sifted, signs)
}

/// Which poses have a stamp that is far ahead of both neighbours' or far behind them, while these follow each other. Of two clocks whose
/// poses take turns none is the stray.
fn strays(poses: &[Pose]) -> Vec<bool> {
    let stamp_ns = |k: usize| poses.get(k).map(|pose| i128::from(pose.stamp_ns)).filter(|ns| *ns != 0);
    let is_far = |k: usize| {
        let (before, after) = k.checked_sub(1).and_then(stamp_ns).zip(stamp_ns(k + 1))?;
        let at = stamp_ns(k)?;
        Some(before <= after && (at > after + STRAY_NS || at < before - STRAY_NS))
    };
    let far: Vec<bool> = (0..poses.len()).map(|k| is_far(k).unwrap_or_default()).collect();
    let strays: Vec<bool> = (0..far.len()).map(|k| far[k] && !far[k - 1] && !far[k + 1]).collect();
    // More of them is an order of some other kind.
    let are_few = strays.iter().filter(|stray| **stray).count() <= (poses.len() / ONE_IN).max(1);
    strays.into_iter().map(|stray| stray && are_few).collect()
}

/// The newest stamp of poses in the order in which they were sent, strays left out.
pub(super) fn last_ns(poses: &[Pose]) -> Option<StampNs> {
    poses.iter().zip(strays(poses)).filter(|(_, is_stray)| !is_stray).map(|(pose, _)| pose.stamp_ns).max()
}

/// The poses of one marker.
fn of_marker(what: &str, poses: Vec<Pose>, params: &PoseStreamParams, signs: &mut Vec<Sign>) -> Vec<Sifted> {
    let frozen = Frozen::of(what, &poses, params.frozen_after_ms, signs);
    let measured: Vec<usize> = (0..poses.len()).filter(|k| frozen[*k].is_none() && poses[*k].stamp_ns != 0).collect();
    let samples: Vec<Sample> = measured.iter().map(|k| (poses[*k].stamp_ns, poses[*k].isometry)).collect();
    let judged = judge(&samples, &params.motion);
    signs.extend(out_signs(what, &samples, &judged.out));
    signs.extend(judged.jumps.iter().map(|(k, jump)| ("marker_jump", jump_words(what, samples[*k].0, jump))));
    let stamps: Vec<StampNs> = samples.iter().map(|(stamp_ns, _)| *stamp_ns).collect();
    let arrival = Arrival::of(&stamps).filter(|_| params.motion.are_set());
    signs.extend(arrival.map(|arrival| ("stamps_of_arrival", format!("{what}: {}", arrival.words()))));
    let mut reasons = frozen;
    for (k, cause) in measured.iter().zip(&judged.out) {
        reasons[*k] = cause.map(|cause| format!("{what} is left out: {}", cause.words()));
    }
    // Between neighbours that are near enough a pose is interpolated.
    let max_gap_ns = (params.max_gap_ms.unwrap_or(MAX_GAP_MS) * 1e6).round() as StampNs;
    let mut is_bridged = vec![false; poses.len()];
    let sound: Vec<usize> = (0..poses.len()).filter(|k| reasons[*k].is_none()).collect();
    for pair in sound.windows(2).filter(|pair| poses[pair[1]].stamp_ns - poses[pair[0]].stamp_ns <= max_gap_ns) {
        is_bridged[pair[0] + 1..pair[1]].iter_mut().for_each(|bridged| *bridged = true);
    }
    poses.into_iter().zip(reasons).zip(is_bridged).filter(|(_, bridged)| !bridged).map(|(sifted, _)| sifted).collect()
}

/// One sentence for each kind of fault.
fn out_signs(what: &str, samples: &[Sample], out: &[Option<Cause>]) -> Vec<Sign> {
    let mut kinds: BTreeMap<Kind, Vec<usize>> = BTreeMap::new();
    for (k, cause) in out.iter().enumerate() {
        kinds
            .entry(match cause {
                Some(cause) => cause.kind,
                None => continue,
            })
            .or_default()
            .push(k);
    }
    let sign = |(kind, of): (Kind, Vec<usize>)| {
        let size = |k: &usize| out[*k].map_or(0.0, |cause| cause.mm + cause.rad.to_degrees());
        let largest = of.iter().copied().max_by(|a, b| size(a).total_cmp(&size(b))).unwrap_or(of[0]);
        let words = out[largest].map(|cause| cause.words()).unwrap_or_default();
        let (n, n_all, first_ns, at_ns) = (of.len(), samples.len(), samples[of[0]].0, samples[largest].0);
        let (are, at) = if n == 1 {
            ("pose is", format!("at {at_ns} ns"))
        } else {
            ("poses are", format!("from {first_ns} to {} ns; at {at_ns} ns", samples[of[n - 1]].0))
        };
        (kind.rule(), format!("{what}: {n} of {n_all} {are} left out, {at}: {words}"))
    };
    kinds.into_iter().map(sign).collect()
}

/// A motion that no hand makes.
pub(crate) fn jump_words(what: &str, stamp_ns: StampNs, jump: &Cause) -> String {
    format!(
        "{what}: by {stamp_ns} ns {} and it stayed there: the marker slipped, was knocked, or its attitude is read wrongly on one side of \
         that; what was measured on both sides of it does not belong together",
        jump.words()
    )
}

/// What a port gives for a pose.
pub(super) fn emission((pose, reason): Sifted) -> (StampNs, Emission) {
    (pose.stamp_ns, reason.map_or_else(|| Emission::value(pose), Emission::Empty))
}

/// Adds a pose to the transforms of a tree.
pub(super) fn add(tree: &mut TransformTree, (pose, reason): &Sifted) {
    let motion = reason.as_ref().map_or_else(|| Ok(pose.isometry), |reason| Err(format!("has no new pose: {reason}")));
    tree.add(&pose.to, &pose.from, pose.stamp_ns, motion);
}

/// Adds a transform that holds for good, and gives a sign if the tree has it over time.
pub(super) fn add_static(tree: &mut TransformTree, pose: &Pose) -> Option<Sign> {
    let Pose { to, from, stamp_ns, isometry, .. } = pose;
    let message =
        || format!("t_{to}_{from} is static on one topic and moves on another, whose poses are used; remove one");
    (!tree.add_static(to, from, *stamp_ns, *isometry)).then(|| ("static_moves", message()))
}

/// How a port reads transforms that are joined.
pub(super) struct Joined {
    /// The sentence that says so.
    pub(super) note: String,
    /// The transforms.
    pub(super) steps: Vec<Step>,
    /// Later samples, in order, change no pose up to this stamp.
    pub(super) settled_ns: StampNs,
}

/// What a port gives that reads `t_parent_child` as a product of transforms of `tree`; none if they do not lead from one to the other.
///
/// # Errors
/// A message, if the frames are no tree.
pub(super) fn through(
    tree: &TransformTree,
    (parent, child): (&str, &str),
    max_gap_ms: Option<f64>,
) -> Result<Option<(Vec<Sifted>, Joined)>, String> {
    let max_gap_ns = (max_gap_ms.unwrap_or(MAX_GAP_MS) * 1e6).round() as StampNs;
    let chain = tree.chain(&parent.into(), &child.into(), max_gap_ns).map_err(|error| error.to_string())?;
    let Some(chain) = chain else { return Ok(None) };
    let note = format!("t_{parent}_{child} is {}, as tf takes it", chain.formula());
    let pose = |(stamp_ns, motion): (StampNs, Result<Isometry3<f64>, String>)| {
        let (motion, reason) = match motion {
            Ok(motion) => (motion, None),
            Err(reason) => {
                (Isometry3::identity(), Some(format!("t_{parent}_{child} is unknown at {stamp_ns} ns: {reason}")))
            }
        };
        (Pose::new(parent, child, motion).at(stamp_ns), reason)
    };
    let joined = Joined { note, steps: chain.steps, settled_ns: chain.settled_ns };
    Ok(Some((chain.samples.into_iter().map(pose).collect(), joined)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_stamp_far_from_its_neighbours_is_a_stray_and_two_clocks_a_reset_a_pause_or_a_buffer_are_not() {
        const YEAR_MS: StampNs = 31_536_000_000;
        let left_out = |ms: &[StampNs]| {
            let pose = |ms: &StampNs| {
                Pose::new("world", "bone", Isometry3::identity()).at(1_750_000_000_000_000_000 + ms * 1_000_000)
            };
            let strays = strays(&ms.iter().map(pose).collect::<Vec<_>>());
            (0..ms.len()).filter(|k| strays[*k]).collect::<Vec<_>>()
        };
        assert_eq!(left_out(&[0, 50, 100, 80 * YEAR_MS, 200, 250]), [3]);
        assert_eq!(left_out(&[0, 50, 100, -40 * YEAR_MS, 200, 250]), [3]);
        assert_eq!(left_out(&[0, 60_000, 120_000, 180_000]), [0; 0], "stations");
        assert_eq!(left_out(&[0, 50, 100, 150, 20_000]), [0; 0], "a pause before the last");
        assert_eq!(left_out(&[60_000, 60_050, 60_100, 0, 50, 100]), [0; 0], "a clock that was set back");
        assert_eq!(left_out(&[0, 60_000, 50, 60_050, 100, 60_100]), [0; 0], "two clocks");
        assert_eq!(left_out(&[0, 50, 9_000, 150, 200]), [0; 0], "a buffer");
        assert_eq!(left_out(&[0, 50, 60_000, 100, 150, 60_000, 200, 250]), [0; 0], "a quarter of all");
        assert_eq!(left_out(&[]), [0; 0]);
    }
}
