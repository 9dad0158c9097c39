//! Foxglove's messages as those of ROS 2, in CDR.

use crate::{
    message_read::{FRAME_TRANSFORM, FRAME_TRANSFORMS, POINT_CLOUD},
    ros2::{
        Header, NUMERIC_TYPES, POINT_CLOUD_2, POSE_STAMPED, PointCloud2, PointField, PoseStamped, Stamp, TF_MESSAGE,
        TRANSFORM_STAMPED, TransformStamped, Xyz, Xyzw,
    },
};
use foxglove::{
    Schema,
    messages::{FrameTransform, FrameTransforms, PointCloud, Pose, PoseInFrame, Timestamp},
};
use re_cdr::{BigEndian, LittleEndian, to_vec};
use serde::Serialize;

/// The schema of ROS 2 for one of Foxglove: its definition with those that it needs.
pub(super) fn schema(foxglove: &str) -> Schema {
    let (name, definition) = match foxglove {
        POINT_CLOUD => (POINT_CLOUD_2, [CLOUD, HEADER, FIELD].concat()),
        FRAME_TRANSFORM => (TRANSFORM_STAMPED, [STAMPED, HEADER, TRANSFORM, VECTOR, QUATERNION].concat()),
        FRAME_TRANSFORMS => (
            TF_MESSAGE,
            [TF, "\n===\nMSG: geometry_msgs/TransformStamped\n", STAMPED, HEADER, TRANSFORM, VECTOR, QUATERNION]
                .concat(),
        ),
        _ => (POSE_STAMPED, [POSE_IN_FRAME, HEADER, POSE, POINT, QUATERNION].concat()),
    };
    let rule = "=".repeat(80);
    Schema::new(name, "ros2msg", definition.replace("\n===\n", &format!("\n{rule}\n")).into_bytes())
}

const CLOUD: &str = "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n\
     uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n";
const FIELD: &str = "\n===\nMSG: sensor_msgs/PointField\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n";
const TF: &str = "geometry_msgs/TransformStamped[] transforms\n";
const STAMPED: &str = "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n";
const POSE_IN_FRAME: &str = "std_msgs/Header header\ngeometry_msgs/Pose pose\n";
const HEADER: &str = "\n===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
     \n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
const TRANSFORM: &str =
    "\n===\nMSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n";
const POSE: &str =
    "\n===\nMSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n";
const VECTOR: &str = "\n===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
const POINT: &str = "\n===\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n";
const QUATERNION: &str = "\n===\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n";

pub(super) fn cloud(cloud: &PointCloud, big_endian: bool) -> Vec<u8> {
    let datatype = |kind: i32| NUMERIC_TYPES.iter().find(|(_, known)| i32::from(*known) == kind).map_or(0, |t| t.0);
    let fields = cloud.fields.iter().map(|field| PointField {
        name: &field.name,
        offset: field.offset,
        datatype: datatype(field.r#type),
        count: 1,
    });
    let n_bytes = cloud.data.len() as u32;
    let message = PointCloud2 {
        header: header(cloud.timestamp, &cloud.frame_id),
        height: 1,
        width: n_bytes / cloud.point_stride.max(1),
        fields: fields.collect(),
        is_bigendian: big_endian,
        point_step: cloud.point_stride,
        row_step: n_bytes,
        data: &cloud.data,
        is_dense: false,
    };
    encode(&message, big_endian)
}

pub(super) fn transform(t: &FrameTransform, big_endian: bool) -> Vec<u8> {
    encode(&stamped(t), big_endian)
}

pub(super) fn transforms(batch: &FrameTransforms, big_endian: bool) -> Vec<u8> {
    encode(&batch.transforms.iter().map(stamped).collect::<Vec<_>>(), big_endian)
}

pub(super) fn pose(tip: &PoseInFrame, big_endian: bool) -> Vec<u8> {
    let Pose { position, orientation } = tip.pose.unwrap_or_default();
    let (p, q) = (position.unwrap_or_default(), orientation.unwrap_or_default());
    let message = PoseStamped {
        header: header(tip.timestamp, &tip.frame_id),
        position: Xyz { x: p.x, y: p.y, z: p.z },
        orientation: Xyzw { x: q.x, y: q.y, z: q.z, w: q.w },
    };
    encode(&message, big_endian)
}

fn stamped(t: &FrameTransform) -> TransformStamped<'_> {
    let (v, q) = (t.translation.unwrap_or_default(), t.rotation.unwrap_or_default());
    TransformStamped {
        header: header(t.timestamp, &t.parent_frame_id),
        child_frame_id: &t.child_frame_id,
        translation: Xyz { x: v.x, y: v.y, z: v.z },
        rotation: Xyzw { x: q.x, y: q.y, z: q.z, w: q.w },
    }
}

fn header(time: Option<Timestamp>, frame_id: &str) -> Header<'_> {
    let stamp = time.map_or(Stamp { sec: 0, nanosec: 0 }, |t| Stamp { sec: t.sec() as i32, nanosec: t.nsec() });
    Header { stamp, frame_id }
}

fn encode<T: Serialize>(message: &T, big_endian: bool) -> Vec<u8> {
    let body = if big_endian { to_vec::<T, BigEndian>(message) } else { to_vec::<T, LittleEndian>(message) };
    [&[0, u8::from(!big_endian), 0, 0][..], &body.expect("memory takes any message")].concat()
}
