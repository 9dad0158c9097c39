//! Poses of one marker that have the same stamp.

use osteoflow_geometry::{Pose, StampNs, nalgebra::Isometry3};
use std::collections::BTreeMap;

/// Distance and angle up to which two poses are equal: rounding in single precision.
const EQUAL_MM: f64 = 1e-4;
const EQUAL_RAD: f64 = 1e-6;

/// Finds poses that share their stamp: equal ones are one, and others contradict each other, as where two programs send one transform.
#[derive(Default)]
pub(crate) struct OneStamp {
    streams: BTreeMap<String, Stream>,
}

/// The poses of a marker at its last stamp, and the contradictions so far.
struct Stream {
    stamp_ns: StampNs,
    poses: Vec<Isometry3<f64>>,
    /// Number of stamps with poses that differ.
    n_stamps: usize,
    first_ns: StampNs,
    largest_mm: f64,
    largest_rad: f64,
    is_told: bool,
}

impl OneStamp {
    /// Takes the next pose of the marker called `what`, in the order of stamps; whether it repeats one of the same stamp, and is to
    /// be left out. Constants, whose stamp is 0, are not looked at.
    pub(crate) fn is_repeat(&mut self, what: &str, pose: &Pose) -> bool {
        if pose.stamp_ns == 0 {
            return false;
        }
        let stream = self.streams.entry(what.to_owned()).or_insert_with(|| Stream::new(pose.stamp_ns));
        if stream.stamp_ns != pose.stamp_ns {
            (stream.stamp_ns, stream.poses) = (pose.stamp_ns, Vec::new());
        }
        let apart: Vec<(f64, f64)> = stream
            .poses
            .iter()
            .map(|other| other.inverse() * pose.isometry)
            .map(|between| (between.translation.vector.norm(), between.rotation.angle()))
            .collect();
        if apart.iter().any(|(mm, rad)| *mm <= EQUAL_MM && *rad <= EQUAL_RAD) {
            return true;
        }
        if !apart.is_empty() {
            if stream.n_stamps == 0 {
                stream.first_ns = pose.stamp_ns;
            }
            stream.n_stamps += usize::from(apart.len() == 1);
            for (mm, rad) in apart {
                (stream.largest_mm, stream.largest_rad) = (stream.largest_mm.max(mm), stream.largest_rad.max(rad));
            }
        }
        stream.poses.push(pose.isometry);
        false
    }

    /// One sentence for each marker with contradictions.
    pub(crate) fn notes(&self) -> Vec<String> {
        let contrary = self.streams.iter().filter(|(_, stream)| stream.n_stamps > 0);
        contrary.map(|(what, stream)| stream.note(what)).collect()
    }

    /// The sentence for a marker, once, after its first contradiction: for sources that do not end.
    pub(crate) fn first_note(&mut self, what: &str) -> Option<String> {
        let stream = self.streams.get_mut(what).filter(|stream| stream.n_stamps > 0)?;
        (!std::mem::replace(&mut stream.is_told, true)).then(|| stream.note(what))
    }
}

impl Stream {
    fn new(stamp_ns: StampNs) -> Self {
        Self {
            stamp_ns,
            poses: Vec::new(),
            n_stamps: 0,
            first_ns: 0,
            largest_mm: 0.0,
            largest_rad: 0.0,
            is_told: false,
        }
    }

    fn note(&self, what: &str) -> String {
        let Self { n_stamps, first_ns, largest_mm, largest_rad, .. } = self;
        let stamps = if *n_stamps == 1 { "stamp has" } else { "stamps have" };
        format!(
            "{what}: {n_stamps} {stamps} poses that contradict each other, first at {first_ns} ns, up to {largest_mm:.2} mm and {:.2} \
             degrees apart: one of them is wrong, and what is between them is used; find what else sends this transform",
            largest_rad.to_degrees()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::{UnitQuaternion, Vector3};

    fn pose(x: f64, deg: f64, stamp_ns: StampNs) -> Pose {
        let isometry = Isometry3::new(Vector3::new(x, 500.0, 0.0), Vector3::z() * deg.to_radians());
        Pose::new("world", "bone_marker", isometry).at(stamp_ns)
    }

    #[test]
    fn equal_poses_of_one_stamp_are_one_and_others_contradict() {
        let mut one = OneStamp::default();
        let mut take = |x, deg, ns| one.is_repeat("t_world_bone_marker", &pose(x, deg, ns));
        assert!(!take(1.0, 0.0, 5) && take(1.0, 0.0, 5) && !take(1.0, 0.0, 6));
        // The negative quaternion is the same rotation.
        let mut negative = pose(1.0, 0.0, 6);
        negative.isometry.rotation = UnitQuaternion::new_unchecked(-negative.isometry.rotation.into_inner());
        assert!(one.is_repeat("t_world_bone_marker", &negative));
        assert_eq!(one.notes(), Vec::<String>::new());
        let mut take = |x, deg, ns| one.is_repeat("t_world_bone_marker", &pose(x, deg, ns));
        // Thrice at one stamp, of which two are equal; then in rotation alone.
        assert!(!take(2.0, 0.0, 7) && !take(5.0, 0.0, 7) && take(2.0, 0.0, 7));
        assert!(!take(2.0, 0.0, 9) && !take(2.0, 1.0, 9));
        let [note] = &one.notes()[..] else { panic!("{:?}", one.notes()) };
        let words = "t_world_bone_marker: 2 stamps have poses that contradict each other, first at 7 ns, up to 3.00 mm and 1.00 degrees";
        assert!(note.starts_with(words), "{note}");
    }

    #[test]
    fn constants_and_other_markers_do_not_contradict_and_a_live_source_is_told_once() {
        let mut one = OneStamp::default();
        assert!(!one.is_repeat("cad", &pose(1.0, 0.0, 0)) && !one.is_repeat("cad", &pose(9.0, 0.0, 0)));
        let mut told = |what: &str, x, ns| {
            let pose = pose(x, 0.0, ns);
            (!one.is_repeat(what, &pose)).then(|| one.first_note(what).is_some())
        };
        assert_eq!((told("a", 1.0, 5), told("b", 2.0, 5)), (Some(false), Some(false)));
        assert_eq!((told("a", 4.0, 5), told("a", 7.0, 5), told("a", 7.0, 5)), (Some(true), Some(false), None));
        assert_eq!((told("a", 1.0, 6), told("a", 3.0, 6)), (Some(false), Some(false)));
    }
}
