//! Views for Foxglove and other viewers: its schemas, metres. Derived, lossy, and outside digests.

mod scene;

pub(crate) use scene::{mesh, named_points, no_planes, planes, scene_schema, surface_points, surface_schema};

pub(crate) use foxglove::messages::{FrameTransform, PointCloud, RawImage};

use foxglove::{
    Encode,
    bytes::Bytes,
    messages::{
        PackedElementField, Pose as FoxglovePose, Quaternion, Timestamp, Vector3, packed_element_field::NumericType,
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

/// The channel of a message.
pub(crate) fn schema<M: Encode>() -> Option<Display> {
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
    let mut data = Vec::with_capacity(points.len() * 12);
    for coordinate in points.iter().flat_map(|p| p.iter()) {
        data.extend_from_slice(&((coordinate / MM_PER_M) as f32).to_le_bytes());
    }
    point_cloud(frame, stamp_ns, &["x", "y", "z"], &[], data)
}

/// The message of points that have these fields: 32-bit floats, then bytes.
fn point_cloud(frame: &Frame, stamp_ns: StampNs, floats: &[&str], bytes: &[&str], data: Vec<u8>) -> Option<Vec<u8>> {
    let types = floats.iter().map(|name| (name, 4, NumericType::Float32));
    let mut point_stride = 0;
    let fields = types.chain(bytes.iter().map(|name| (name, 1, NumericType::Uint8))).map(|(name, size, of)| {
        let offset = point_stride;
        point_stride += size;
        PackedElementField { name: (*name).into(), offset, r#type: i32::from(of) }
    });
    let fields = fields.collect();
    encode(&PointCloud {
        timestamp: timestamp(stamp_ns),
        frame_id: frame.to_string(),
        pose: Some(pose(&Isometry3::identity())),
        point_stride,
        fields,
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
    let mut data = Vec::with_capacity(cloud.len() * 20);
    for point in cloud.points() {
        let point = t * point;
        let distance_mm = query.and_then(|query| distance_outside(&point, query)).unwrap_or(f64::NAN);
        let metres = point.coords / MM_PER_M;
        data.extend([metres.x, metres.y, metres.z, distance_mm].iter().flat_map(|&c| (c as f32).to_le_bytes()));
        data.extend(distance_colour(distance_mm));
        data.push(u8::MAX);
    }
    point_cloud(frame, stamp_ns, &["x", "y", "z", "distance_mm"], &["red", "green", "blue", "alpha"], data)
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
