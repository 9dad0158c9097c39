//! Where frames are, by the transforms that a recording has for viewers (protobuf foxglove.FrameTransform; metres).

use foxglove::{Decode, messages::FrameTransform};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde_json::{Value as Json, json};

/// A transform: takes coordinates in `child` to coordinates in `parent`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Transform {
    wire: String,
    parent: String,
    child: String,
    translation_m: [f64; 3],
    /// x, y, z, w.
    rotation: [f64; 4],
}

impl Transform {
    /// Reads the message of a wire; `None` if it is damaged.
    pub(super) fn read(wire: &str, data: &[u8]) -> Option<Self> {
        let read = FrameTransform::decode(data).ok()?;
        let (v, q) = (read.translation.unwrap_or_default(), read.rotation.unwrap_or_default());
        Some(Self {
            wire: wire.into(),
            parent: read.parent_frame_id,
            child: read.child_frame_id,
            translation_m: [v.x, v.y, v.z],
            rotation: [q.x, q.y, q.z, q.w],
        })
    }

    pub(super) fn json(&self) -> Json {
        json!({
            "wire": self.wire,
            "parent": self.parent,
            "child": self.child,
            "translation": self.translation_m,
            "rotation": self.rotation,
        })
    }

    /// In millimetres.
    fn motion(&self) -> Isometry3<f64> {
        let [x, y, z, w] = self.rotation;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Isometry3::from_parts(Translation3::from(self.translation_m.map(|c| 1e3 * c)), rotation)
    }
}

/// The root of a frame, and the motion that takes coordinates in the frame to those in its root, mm.
pub(super) fn to_root(transforms: &[Transform], frame: &str) -> (String, Isometry3<f64>) {
    let (mut at, mut motion) = (frame, Isometry3::identity());
    // The last transform of a frame counts; a circle ends after as many steps as there are transforms.
    for _ in 0..transforms.len() {
        let Some(edge) = transforms.iter().rfind(|edge| edge.child == at) else { break };
        motion = edge.motion() * motion;
        at = &edge.parent;
    }
    (at.to_owned(), motion)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn message(parent: &str, child: &str, x_m: f64) -> Vec<u8> {
        let text = |field: u8, text: &str| [&[field << 3 | 2, text.len() as u8], text.as_bytes()].concat();
        let double = |field: u8, value: f64| [&[field << 3 | 1][..], &value.to_le_bytes()].concat();
        let inner = |field: u8, bytes: Vec<u8>| [&[field << 3 | 2, bytes.len() as u8][..], &bytes].concat();
        // A time stamp comes first, and is passed over.
        let stamp = inner(1, vec![8, 5]);
        [stamp, text(2, parent), text(3, child), inner(4, double(1, x_m)), inner(5, double(4, 1.0))].concat()
    }

    #[test]
    fn frames_are_placed_by_chains_of_transforms_in_millimetres() {
        let all: Vec<_> = [("world", "bone", 0.1), ("bone", "ct", 0.02), ("bone", "ct", 0.03)]
            .map(|(parent, child, x)| Transform::read("w", &message(parent, child, x)).unwrap())
            .into();
        let (root, motion) = to_root(&all, "ct");
        assert_eq!(root, "world");
        assert!((motion * Point3::origin() - Point3::new(130.0, 0.0, 0.0)).norm() < 1e-9, "the last one counts");
        assert_eq!(to_root(&all, "elsewhere").0, "elsewhere");
    }

    #[test]
    fn a_damaged_transform_is_none_and_a_circle_ends() {
        let whole = message("a", "b", 1.0);
        for n in 1..whole.len() {
            let read = Transform::read("w", &whole[..n]);
            assert!(read.is_none_or(|t| t.child.is_empty() || t.translation_m == [0.0; 3] || t.rotation == [0.0; 4]));
        }
        let circle: Vec<_> =
            [("a", "b"), ("b", "a")].map(|(p, c)| Transform::read("w", &message(p, c, 0.0)).unwrap()).into();
        to_root(&circle, "a");
    }
}
