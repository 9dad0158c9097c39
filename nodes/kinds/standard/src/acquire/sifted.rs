//! Poses that are measured again, sorted out from those that a stuck tracker repeats.

use super::{frozen::Frozen, one_stamp::OneStamp};
use osteoflow_geometry::{Pose, StampNs, TransformTree, nalgebra::Isometry3};
use osteoflow_node::{Emission, schemars::JsonSchema, serde::Deserialize};

/// Time between two samples up to which a transform of a chain is interpolated, ms: four periods of a slow tracker (20 Hz).
const MAX_GAP_MS: f64 = 200.0;

/// When poses of a recording or a log are lost.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PoseStreamParams {
    /// Silence after which a tracked marker is lost and the port gives an empty; also at the end, up to the last message of the
    /// recording on any topic, or the last pose of the log. Unset: never.
    #[schemars(range(min = 1.0, max = 3_600_000.0))]
    pub lost_after_ms: Option<f64>,
    /// Time for which poses may be the same to the last bit while their stamps go on; from then on the tracker is frozen, and the
    /// port gives empties that say why until the pose changes. Unset: 2000, forty samples of a slow tracker: at rest one
    /// that rounds to 0.1 mm repeats a pose for up to 0.85 s. 0: never, for a constant that is given again and again.
    #[schemars(range(min = 0.0, max = 3_600_000.0))]
    pub frozen_after_ms: Option<f64>,
    /// Time between two samples up to which a transform is interpolated, where `parent` and `child` are joined by several
    /// transforms, or by an inverse, as tf of ROS joins frames: by the one path in their tree, each transform at the same time. Unset:
    /// 200, four samples of a slow tracker.
    #[schemars(range(min = 0.0, max = 3_600_000.0))]
    pub max_gap_ms: Option<f64>,
}

/// A pose, and why it is not to be used, if it is not.
pub(super) type Sifted = (Pose, Option<String>);

/// Poses in the order of their stamps, equal ones of one stamp once, those of a frozen tracker with the reason; and notes.
pub(super) fn sifted(mut poses: Vec<Pose>, frozen_after_ms: Option<f64>) -> (Vec<Sifted>, Vec<String>) {
    poses.sort_by_key(|pose| pose.stamp_ns);
    let (mut frozen, mut one_stamp, mut notes) = (Frozen::new(frozen_after_ms), OneStamp::default(), Vec::new());
    let mut sifted = Vec::new();
    for pose in poses {
        let what = format!("t_{}_{}", pose.to, pose.from);
        if !one_stamp.is_repeat(&what, &pose) {
            let reason = frozen.take(&what, &pose.isometry, pose.stamp_ns, &mut notes);
            sifted.push((pose, reason));
        }
    }
    notes.extend(one_stamp.notes());
    (sifted, notes)
}

/// What a port gives for a pose.
pub(super) fn emission((pose, reason): Sifted) -> (StampNs, Emission) {
    (pose.stamp_ns, reason.map_or_else(|| Emission::value(pose), Emission::Empty))
}

/// What a port gives that reads `t_parent_child` as a product of transforms of `tree`, and a note that says so; none if they do not
/// lead from one to the other.
///
/// # Errors
/// A message, if the frames are no tree.
pub(super) fn through(
    tree: &TransformTree,
    (parent, child): (&str, &str),
    max_gap_ms: Option<f64>,
) -> Result<Option<(Vec<Sifted>, String)>, String> {
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
    Ok(Some((chain.samples.into_iter().map(pose).collect(), note)))
}
