//! Where frames are, by the transforms that a recording has for viewers (protobuf foxglove.FrameTransform; metres).

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
        let mut read = Self {
            wire: wire.into(),
            parent: String::new(),
            child: String::new(),
            translation_m: [0.0; 3],
            rotation: [0.0; 4],
        };
        for (field, value) in fields(data)? {
            let Field::Bytes(bytes) = value else { continue };
            match field {
                2 => read.parent = String::from_utf8(bytes.into()).ok()?,
                3 => read.child = String::from_utf8(bytes.into()).ok()?,
                4 => read.translation_m = doubles(bytes)?,
                5 => read.rotation = doubles(bytes)?,
                _ => {}
            }
        }
        Some(read)
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

enum Field<'a> {
    Double(f64),
    Bytes(&'a [u8]),
}

/// The doubles and the bytes of a message, by field number; other fields are passed over. `None` if it is damaged.
fn fields(mut data: &[u8]) -> Option<Vec<(u64, Field<'_>)>> {
    let mut found = Vec::new();
    while !data.is_empty() {
        let key = varint(&mut data)?;
        match key & 7 {
            0 => {
                varint(&mut data)?;
            }
            1 => found.push((key >> 3, Field::Double(f64::from_le_bytes(take(&mut data, 8)?.try_into().ok()?)))),
            2 => {
                let n = usize::try_from(varint(&mut data)?).ok()?;
                found.push((key >> 3, Field::Bytes(take(&mut data, n)?)));
            }
            5 => {
                take(&mut data, 4)?;
            }
            _ => return None,
        }
    }
    Some(found)
}

/// The doubles of a message by their field numbers from 1; protobuf leaves out those that are zero.
fn doubles<const N: usize>(data: &[u8]) -> Option<[f64; N]> {
    let mut all = [0.0; N];
    for (field, value) in fields(data)? {
        if let (Field::Double(value), Some(slot)) = (value, all.get_mut((field as usize).wrapping_sub(1))) {
            *slot = value;
        }
    }
    Some(all)
}

fn take<'a>(data: &mut &'a [u8], n: usize) -> Option<&'a [u8]> {
    let (front, rest) = data.split_at_checked(n)?;
    *data = rest;
    Some(front)
}

fn varint(data: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let [byte] = take(data, 1)? else { return None };
        value |= u64::from(byte & 127) << shift;
        if byte & 128 == 0 {
            return Some(value);
        }
    }
    None
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
