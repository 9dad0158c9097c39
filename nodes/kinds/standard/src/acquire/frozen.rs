//! Trackers that repeat one pose although their stamps go on.

use osteoflow_geometry::{Pose, StampNs, nalgebra::Isometry3};
use osteoflow_node::Emission;
use std::collections::BTreeMap;

/// Default time for which equal poses are passed on, ms: forty samples of a slow tracker (20 Hz). A tracker that measures repeats a
/// pose at rest to the last bit, too, where it rounds to a tenth of a millimetre: for up to 0.85 s as measured.
const FROZEN_AFTER_MS: f64 = 2000.0;

/// Finds poses that stay the same to the last bit while their stamps go on: the tracker, or what reads it, is stuck, and
/// where the marker is now is unknown.
pub(crate) struct Frozen {
    /// `None`: never.
    after_ns: Option<StampNs>,
    streams: BTreeMap<String, Stream>,
}

/// The last pose of a marker, and since when it is the same.
struct Stream {
    last: Isometry3<f64>,
    since_ns: StampNs,
    is_reported: bool,
}

impl Frozen {
    /// With the port's parameter: unset is the default, 0 is never.
    pub(crate) fn new(frozen_after_ms: Option<f64>) -> Self {
        let after_ms = Some(frozen_after_ms.unwrap_or(FROZEN_AFTER_MS)).filter(|ms| *ms > 0.0);
        Self { after_ns: after_ms.map(|ms| (ms * 1e6).round() as StampNs), streams: BTreeMap::new() }
    }

    /// Takes the next pose of the marker called `what`. If it has been the same for too long, says why it is not to be used, and
    /// notes the first of them in a row. Constants, whose stamp is 0, are not looked at.
    pub(crate) fn take(
        &mut self,
        what: &str,
        pose: &Isometry3<f64>,
        stamp_ns: StampNs,
        notes: &mut Vec<String>,
    ) -> Option<String> {
        let after_ns = self.after_ns.filter(|_| stamp_ns != 0)?;
        let stream = match self.streams.get_mut(what) {
            // The bits, not the motion: a quaternion and its negative are the same rotation.
            Some(stream)
                if stream.last.translation == pose.translation
                    && stream.last.rotation.coords == pose.rotation.coords =>
            {
                stream
            }
            _ => {
                self.streams.insert(what.into(), Stream { last: *pose, since_ns: stamp_ns, is_reported: false });
                return None;
            }
        };
        let since_ns = stream.since_ns;
        if stamp_ns.saturating_sub(since_ns) < after_ns {
            return None;
        }
        let reason = format!(
            "{what} is frozen: its pose has been the same to the last bit since {since_ns} ns, though its stamps go on to \
             {stamp_ns} ns; does the tracker still measure? For a constant set frozen_after_ms = 0"
        );
        if !std::mem::replace(&mut stream.is_reported, true) {
            notes.push(reason.clone());
        }
        Some(reason)
    }

    /// The pose of the marker called `what`, or an empty while it is frozen, which the first notes say.
    pub(crate) fn emission(&mut self, what: &str, pose: Pose, notes: &mut Vec<String>) -> Emission {
        let reason = self.take(what, &pose.isometry, pose.stamp_ns, notes);
        reason.map_or_else(|| Emission::value(pose), Emission::Empty)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: StampNs = 1_000_000;

    #[test]
    fn a_pose_that_stays_the_same_is_frozen_from_the_limit_on_until_it_changes() {
        let mut frozen = Frozen::new(Some(100.0));
        let mut take = |x: f64, ms: StampNs| {
            let mut notes = Vec::new();
            let reason = frozen.take("bone", &Isometry3::translation(x, 0.0, 0.0), ms * MS, &mut notes)?;
            Some((!notes.is_empty(), reason))
        };
        assert_eq!((take(1.0, 10), take(1.0, 60), take(1.0, 109)), (None, None, None));
        let (is_first, reason) = take(1.0, 110).unwrap();
        assert!(
            is_first
                && reason.starts_with("bone is frozen: its pose has been the same to the last bit since 10000000 ns")
        );
        assert!(matches!(take(1.0, 160), Some((false, _))), "reported once");
        assert_eq!(
            (take(1.0 + f64::EPSILON, 210), take(1.0, 260), take(1.0, 310)),
            (None, None, None),
            "one bit is a change"
        );
        assert!(matches!(take(1.0, 400), Some((true, _))), "and once again");
        let other = Isometry3::translation(1.0, 0.0, 0.0);
        assert_eq!(frozen.take("camera", &other, 500 * MS, &mut Vec::new()), None);
    }

    #[test]
    fn constants_and_ports_that_switch_it_off_are_never_frozen() {
        let pose = Isometry3::identity();
        let mut off = Frozen::new(Some(0.0));
        assert!((1..9).all(|s| off.take("cad", &pose, s * 10_000 * MS, &mut Vec::new()).is_none()));
        let mut on = Frozen::new(None);
        let mut take = |stamp_ns| on.take("cad", &pose, stamp_ns, &mut Vec::new());
        assert!((1..9).all(|_| take(0).is_none()));
        assert!(take(1).is_none() && take(1 + 2000 * MS).is_some());
    }
}
