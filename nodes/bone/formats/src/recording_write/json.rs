//! Foxglove's messages as JSON, with the schemas that viewers need.

use crate::message_read::{FRAME_TRANSFORM, FRAME_TRANSFORMS, POSE_IN_FRAME};
use base64::{Engine, engine::general_purpose::STANDARD};
use foxglove::messages::{
    FrameTransform, PointCloud, Pose as FoxglovePose, Quaternion as FoxgloveQuaternion, Timestamp,
    Vector3 as FoxgloveVector3,
};
use serde_json::{Value, json};

pub(super) fn time_json(time: Option<Timestamp>) -> Value {
    time.map_or(Value::Null, |t| json!({"sec": t.sec(), "nsec": t.nsec()}))
}

pub(super) fn vector_json(v: &FoxgloveVector3) -> Value {
    json!({"x": v.x, "y": v.y, "z": v.z})
}

pub(super) fn quaternion_json(q: &FoxgloveQuaternion) -> Value {
    json!({"x": q.x, "y": q.y, "z": q.z, "w": q.w})
}

pub(super) fn pose_json(pose: &FoxglovePose) -> Value {
    json!({"position": pose.position.as_ref().map(vector_json), "orientation": pose.orientation.as_ref().map(quaternion_json)})
}

pub(super) fn transform_json(t: &FrameTransform) -> Value {
    json!({
        "timestamp": time_json(t.timestamp),
        "parent_frame_id": t.parent_frame_id,
        "child_frame_id": t.child_frame_id,
        "translation": t.translation.as_ref().map(vector_json),
        "rotation": t.rotation.as_ref().map(quaternion_json),
    })
}

pub(super) fn cloud_json(cloud: &PointCloud) -> Value {
    let fields = cloud.fields.iter().map(|f| json!({"name": f.name, "offset": f.offset, "type": f.r#type}));
    json!({
        "timestamp": time_json(cloud.timestamp),
        "frame_id": cloud.frame_id,
        "pose": cloud.pose.as_ref().map(pose_json),
        "point_stride": cloud.point_stride,
        "fields": fields.collect::<Vec<_>>(),
        "data": STANDARD.encode(&cloud.data),
    })
}

/// The JSON Schema of a message, which viewers need to show it.
pub(super) fn json_schema(name: &str) -> Value {
    let object = |properties: Value| json!({"type": "object", "properties": properties});
    let (text, number, whole) = (json!({"type": "string"}), json!({"type": "number"}), json!({"type": "integer"}));
    let time = object(json!({"sec": whole, "nsec": whole}));
    let vector = object(json!({"x": number, "y": number, "z": number}));
    let quaternion = object(json!({"x": number, "y": number, "z": number, "w": number}));
    let pose = object(json!({"position": vector, "orientation": quaternion}));
    let transform = object(json!({
        "timestamp": time, "parent_frame_id": text, "child_frame_id": text, "translation": vector, "rotation": quaternion,
    }));
    let mut schema = match name {
        FRAME_TRANSFORM => transform,
        FRAME_TRANSFORMS => object(json!({"transforms": {"type": "array", "items": transform}})),
        POSE_IN_FRAME => object(json!({"timestamp": time, "frame_id": text, "pose": pose})),
        _ => object(json!({
            "timestamp": time, "frame_id": text, "pose": pose, "point_stride": whole,
            "fields": {"type": "array", "items": object(json!({"name": text, "offset": whole, "type": whole}))},
            "data": {"type": "string", "contentEncoding": "base64"},
        })),
    };
    schema["title"] = name.into();
    schema
}
