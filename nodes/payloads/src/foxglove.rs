//! Views for Foxglove and other viewers: its schemas, metres. Derived, lossy, and outside digests.

use foxglove::{
    Encode,
    bytes::Bytes,
    messages::{
        FrameTransform, PackedElementField, PointCloud, Pose as FoxglovePose, PosesInFrame, Quaternion, Timestamp,
        Vector3, packed_element_field::NumericType,
    },
};
use osteoflow_geometry::{
    Frame, MM_PER_M, Planes, Pose,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{Display, StampNs};

const NS_PER_S: i64 = 1_000_000_000;

/// The channel of [`points`].
pub(crate) fn points_schema() -> Option<Display> {
    schema::<PointCloud>()
}

/// The channel of [`transform`].
pub(crate) fn transform_schema() -> Option<Display> {
    schema::<FrameTransform>()
}

/// The channel of [`poses`].
pub(crate) fn poses_schema() -> Option<Display> {
    schema::<PosesInFrame>()
}

fn schema<M: Encode>() -> Option<Display> {
    let schema = M::get_schema()?;
    Some(Display {
        schema_name: schema.name,
        schema_encoding: schema.encoding,
        schema_data: schema.data.into_owned(),
        message_encoding: M::get_message_encoding(),
    })
}

/// `foxglove.PointCloud` with `x`, `y`, `z` as 32-bit floats: half the bytes, a resolution of 0.03 µm at 300 mm.
pub(crate) fn points(frame: &Frame, stamp_ns: StampNs, points: &[Point3<f64>]) -> Option<Vec<u8>> {
    let field =
        |name: &str, offset| PackedElementField { name: name.into(), offset, r#type: i32::from(NumericType::Float32) };
    let mut data = Vec::with_capacity(points.len() * 12);
    for coordinate in points.iter().flat_map(|p| p.iter()) {
        data.extend_from_slice(&((coordinate / MM_PER_M) as f32).to_le_bytes());
    }
    encode(&PointCloud {
        timestamp: timestamp(stamp_ns),
        frame_id: frame.to_string(),
        pose: Some(pose(&Isometry3::identity())),
        point_stride: 12,
        fields: vec![field("x", 0), field("y", 4), field("z", 8)],
        data: Bytes::from(data),
    })
}

/// `foxglove.FrameTransform` with parent `to` and child `from`.
pub(crate) fn transform(t: &Pose, stamp_ns: StampNs) -> Option<Vec<u8>> {
    let FoxglovePose { position, orientation } = pose(&t.isometry);
    encode(&FrameTransform {
        timestamp: timestamp(stamp_ns),
        parent_frame_id: t.to.to_string(),
        child_frame_id: t.from.to_string(),
        translation: position,
        rotation: orientation,
    })
}

/// `foxglove.PosesInFrame` of the planes that are known.
pub(crate) fn poses(planes: &Planes, stamp_ns: StampNs) -> Option<Vec<u8>> {
    encode(&PosesInFrame {
        timestamp: timestamp(stamp_ns),
        frame_id: planes.frame.to_string(),
        poses: planes.planes.iter().filter_map(|p| p.isometry()).map(pose).collect(),
    })
}

fn pose(t: &Isometry3<f64>) -> FoxglovePose {
    let (v, q) = (t.translation.vector / MM_PER_M, t.rotation.coords);
    FoxglovePose {
        position: Some(Vector3 { x: v.x, y: v.y, z: v.z }),
        orientation: Some(Quaternion { x: q.x, y: q.y, z: q.z, w: q.w }),
    }
}

fn timestamp(stamp_ns: StampNs) -> Option<Timestamp> {
    let seconds = u32::try_from(stamp_ns.div_euclid(NS_PER_S)).ok()?;
    Some(Timestamp::new(seconds, stamp_ns.rem_euclid(NS_PER_S) as u32))
}

fn encode<M: Encode>(message: &M) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(message.encoded_len().unwrap_or(0));
    message.encode(&mut out).ok()?;
    Some(out)
}
