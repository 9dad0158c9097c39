//! Trackers that repeat one pose although their stamps go on.

use super::sifted::Sign;
use osteoflow_algorithms::marker_stream::Repeats;
use osteoflow_geometry::{
    Pose, StampNs,
    nalgebra::{Isometry3, UnitQuaternion},
};
use std::collections::BTreeMap;

/// Longest and shortest default time for which equal poses are passed on, ms. A tracker that measures repeats a pose at rest to the last
/// bit, too, where it rounds to a tenth of a millimetre: for up to 0.85 s as measured.
const FROZEN_AFTER_MS: f64 = 2000.0;
const AT_LEAST_MS: f64 = 500.0;

/// Finds poses that stay the same to the last bit while their stamps go on: the tracker, or what reads it, is stuck, and
/// where the marker is now is unknown.
pub(crate) struct Frozen {
    /// The port's parameter, ms: unset is what the tracker's own repeats say, 0 is never.
    after_ms: Option<f64>,
    streams: BTreeMap<String, Stream>,
}

/// The last pose of a marker, and since when it is the same.
struct Stream {
    first_ns: StampNs,
    last: Isometry3<f64>,
    since_ns: StampNs,
    is_reported: bool,
    repeats: Repeats,
}

impl Frozen {
    /// With the port's parameter: unset is the default, 0 is never.
    pub(crate) fn new(frozen_after_ms: Option<f64>) -> Self {
        Self { after_ms: frozen_after_ms, streams: BTreeMap::new() }
    }

    /// For each of the poses of one marker, in order, why it is not to be used: all that repeat one for too long, by how often the whole
    /// stream repeats itself.
    pub(super) fn of(what: &str, poses: &[Pose], after_ms: Option<f64>, signs: &mut Vec<Sign>) -> Vec<Option<String>> {
        let mut whole = Self::new(after_ms);
        poses.iter().for_each(|pose| drop(whole.take(what, &pose.isometry, pose.stamp_ns, &mut Vec::new())));
        let own_ms = whole
            .streams
            .get(what)
            .map(|stream| stream.after_ms(after_ms, poses.last().map_or(0, |pose| pose.stamp_ns)));
        let (mut frozen, mut notes) = (Self::new(own_ms.or(after_ms)), Vec::new());
        let mut reasons: Vec<Option<String>> = Vec::with_capacity(poses.len());
        for pose in poses {
            let reason = frozen.take(what, &pose.isometry, pose.stamp_ns, &mut notes);
            if let (Some(reason), Some(stream)) = (&reason, frozen.streams.get(what)) {
                let repeated =
                    reasons.iter_mut().zip(poses).rev().take_while(|(_, pose)| pose.stamp_ns > stream.since_ns);
                repeated.for_each(|(before, _)| *before = Some(reason.clone()));
            }
            reasons.push(reason);
        }
        signs.extend(notes.into_iter().map(|note| ("marker_frozen", note)));
        reasons
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
        if stamp_ns == 0 || self.after_ms == Some(0.0) {
            return None;
        }
        let stream = self.streams.entry(what.into()).or_insert_with(|| Stream::new(*pose, stamp_ns));
        // The bits, not the motion: a quaternion and its negative are the same rotation.
        let is_equal =
            stream.last.translation == pose.translation && stream.last.rotation.coords == pose.rotation.coords;
        stream.repeats.take(is_equal);
        if !is_equal {
            (stream.last, stream.since_ns, stream.is_reported) = (*pose, stamp_ns, false);
            return None;
        }
        let since_ns = stream.since_ns;
        if (stamp_ns.saturating_sub(since_ns)) < (stream.after_ms(self.after_ms, stamp_ns) * 1e6).round() as StampNs {
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
}

impl Stream {
    fn new(pose: Isometry3<f64>, stamp_ns: StampNs) -> Self {
        // Its first pose repeats none.
        let last = Isometry3::from_parts(
            pose.translation,
            UnitQuaternion::new_unchecked(pose.rotation.into_inner() * f64::NAN),
        );
        Self { first_ns: stamp_ns, last, since_ns: stamp_ns, is_reported: false, repeats: Repeats::default() }
    }

    /// The time after which the marker is frozen, ms.
    fn after_ms(&self, set_ms: Option<f64>, now_ns: StampNs) -> f64 {
        let period_ms = (now_ns - self.first_ns) as f64 / 1e6 / self.repeats.n().max(2).saturating_sub(1) as f64;
        let by_repeats = self.repeats.n_frozen().map(|n| (n as f64 * period_ms).clamp(AT_LEAST_MS, FROZEN_AFTER_MS));
        set_ms.or(by_repeats).unwrap_or(FROZEN_AFTER_MS)
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
