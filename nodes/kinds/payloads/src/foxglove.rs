//! Views for Foxglove and other viewers: its schemas, metres. Derived, lossy, and outside digests.

mod scene;

pub(crate) use scene::{mesh, named_points, no_planes, planes, scene_schema, surface_points, surface_schema};

use foxglove::{
    Encode,
    bytes::Bytes,
    messages::{
        FrameTransform, PackedElementField, PointCloud, Pose as FoxglovePose, Quaternion, RawImage, Timestamp, Vector3,
        packed_element_field::NumericType,
    },
};
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    metrics::{distance_colour, distance_outside},
    target::Target,
};
use osteoflow_geometry::{
    Cloud, Frame, Image, MM_PER_M, Mesh, Pose,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{Display, DisplayContext, StampNs, Value, frame_edge};
use std::cell::RefCell;

const NS_PER_S: i64 = 1_000_000_000;

/// The channel of [`points`].
pub(crate) fn points_schema() -> Option<Display> {
    schema::<PointCloud>()
}

/// The channel of [`transform`].
pub(crate) fn transform_schema() -> Option<Display> {
    schema::<FrameTransform>()
}

fn schema<M: Encode>() -> Option<Display> {
    let schema = M::get_schema()?;
    Some(Display {
        schema_name: schema.name,
        schema_encoding: schema.encoding,
        schema_data: schema.data.into_owned(),
        message_encoding: M::get_message_encoding(),
        answer: false,
        anchor: false,
        removal: Vec::new(),
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

/// The points of a cloud where a pose places them on a surface: `distance_mm` from it, positive outside, and its colour on the page.
/// They are given in the surface's own frame, so that they stay on it in every viewer.
pub(crate) fn points_on(cloud: &Cloud, surface: &Value, pose: &Pose, stamp_ns: StampNs) -> Option<Vec<u8>> {
    let (frame, t) = match () {
        () if pose.from == cloud.frame => (&pose.to, pose.isometry),
        () if pose.to == cloud.frame => (&pose.from, pose.isometry.inverse()),
        () => return None,
    };
    let mesh = surface.get::<Mesh>().map(query_of);
    let target = surface.get::<Target>();
    let surface_frame = target.map(|target| &target.frame).or(mesh.as_ref().map(|query| &query.mesh().frame))?;
    if surface_frame != frame {
        return None;
    }
    let query = mesh.as_ref().or_else(|| target?.mesh());
    let mut data = Vec::with_capacity(cloud.len() * POINT_ON_BYTES as usize);
    for point in cloud.points() {
        let point = t * point;
        let distance_mm = query.and_then(|query| distance_outside(&point, query)).unwrap_or(f64::NAN);
        let metres = point.coords / MM_PER_M;
        data.extend([metres.x, metres.y, metres.z, distance_mm].iter().flat_map(|&c| (c as f32).to_le_bytes()));
        data.extend(distance_colour(distance_mm));
        data.push(u8::MAX);
    }
    let field = |(name, offset, ty): (&str, u32, NumericType)| PackedElementField {
        name: name.into(),
        offset,
        r#type: i32::from(ty),
    };
    let floats = [("x", 0), ("y", 4), ("z", 8), ("distance_mm", 12)].map(|(name, at)| (name, at, NumericType::Float32));
    let bytes =
        [("red", 16), ("green", 17), ("blue", 18), ("alpha", 19)].map(|(name, at)| (name, at, NumericType::Uint8));
    encode(&PointCloud {
        timestamp: timestamp(stamp_ns),
        frame_id: frame.to_string(),
        pose: Some(self::pose(&Isometry3::identity())),
        point_stride: POINT_ON_BYTES,
        fields: floats.into_iter().chain(bytes).map(field).collect(),
        data: Bytes::from(data),
    })
}

/// The query of a mesh, whose search structure is built once where the same mesh comes again, as for each fit of a live scan.
fn query_of(mesh: &Mesh) -> MeshQuery {
    thread_local! {
        static LAST: RefCell<Option<MeshQuery>> = const { RefCell::new(None) };
    }
    LAST.with_borrow_mut(|last| {
        // The query keeps its mesh, so no other can have its place in memory.
        let is_same = |query: &&mut MeshQuery| std::ptr::eq(query.mesh().vertices(), mesh.vertices());
        match last.as_mut().filter(is_same) {
            Some(query) => query.clone(),
            None => last.insert(MeshQuery::new(mesh)).clone(),
        }
    })
}

/// Bytes of a point with its distance and colour.
const POINT_ON_BYTES: u32 = 20;

/// The channel of [`image`].
pub(crate) fn image_schema() -> Option<Display> {
    schema::<RawImage>()
}

/// `foxglove.RawImage`, `rgb8` or `mono8`. The intrinsics are in the exact payload alone.
pub(crate) fn image(image: &Image, stamp_ns: StampNs) -> Option<Vec<u8>> {
    encode(&RawImage {
        timestamp: timestamp(stamp_ns),
        frame_id: image.frame.to_string(),
        width: image.width(),
        height: image.height(),
        encoding: if image.channels() == 1 { "mono8" } else { "rgb8" }.into(),
        step: image.width() * image.channels(),
        data: Bytes::copy_from_slice(image.pixels()),
    })
}

/// `foxglove.FrameTransform` of the edge that the pose is in the tree of frames.
pub(crate) fn transform(t: &Pose, about: &DisplayContext<'_>) -> Option<Vec<u8>> {
    let (parent_frame_id, child_frame_id, inverted) = frame_edge(about, t.to.as_str(), t.from.as_str());
    let t_parent_child = if inverted { t.isometry.inverse() } else { t.isometry };
    let FoxglovePose { position, orientation } = pose(&t_parent_child);
    encode(&FrameTransform {
        timestamp: timestamp(about.stamp_ns),
        parent_frame_id,
        child_frame_id,
        translation: position,
        rotation: orientation,
    })
}

/// The middle of the smallest box around points, metres.
pub(crate) fn centre(points: &[Point3<f64>]) -> Option<[f64; 3]> {
    let first = points.first()?;
    let (min, max) = points.iter().fold((*first, *first), |(min, max), p| (min.inf(p), max.sup(p)));
    Some(std::array::from_fn(|k| (min[k] + max[k]) / 2.0 / MM_PER_M))
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
