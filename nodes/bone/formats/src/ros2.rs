//! The messages of ROS 2 that are read, as CDR lays them out.
//!
//! # Source
//! The interface definitions of `builtin_interfaces`, `std_msgs`, `geometry_msgs`, `sensor_msgs` and `tf2_msgs`.

use foxglove::messages::{Quaternion, Timestamp, Vector3, packed_element_field::NumericType};
use serde::{Deserialize, Serialize};

/// A cloud.
pub(crate) const POINT_CLOUD_2: &str = "sensor_msgs/msg/PointCloud2";
/// One transform.
pub(crate) const TRANSFORM_STAMPED: &str = "geometry_msgs/msg/TransformStamped";
/// Several transforms.
pub(crate) const TF_MESSAGE: &str = "tf2_msgs/msg/TFMessage";
/// A pose in a frame.
pub(crate) const POSE_STAMPED: &str = "geometry_msgs/msg/PoseStamped";

/// Codes of `sensor_msgs/msg/PointField` and the same types of Foxglove, whose codes differ.
pub(crate) const NUMERIC_TYPES: [(u8, NumericType); 8] = [
    (1, NumericType::Int8),
    (2, NumericType::Uint8),
    (3, NumericType::Int16),
    (4, NumericType::Uint16),
    (5, NumericType::Int32),
    (6, NumericType::Uint32),
    (7, NumericType::Float32),
    (8, NumericType::Float64),
];

#[derive(Serialize, Deserialize)]
pub(crate) struct Stamp {
    pub(crate) sec: i32,
    pub(crate) nanosec: u32,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct Header<'a> {
    pub(crate) stamp: Stamp,
    pub(crate) frame_id: &'a str,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct PointField<'a> {
    pub(crate) name: &'a str,
    pub(crate) offset: u32,
    pub(crate) datatype: u8,
    /// Number of elements; only the first is read.
    pub(crate) count: u32,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct PointCloud2<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) height: u32,
    pub(crate) width: u32,
    #[serde(borrow)]
    pub(crate) fields: Vec<PointField<'a>>,
    pub(crate) is_bigendian: bool,
    pub(crate) point_step: u32,
    pub(crate) row_step: u32,
    pub(crate) data: &'a [u8],
    pub(crate) is_dense: bool,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct Xyz {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) z: f64,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct Xyzw {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) z: f64,
    pub(crate) w: f64,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct TransformStamped<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) child_frame_id: &'a str,
    pub(crate) translation: Xyz,
    pub(crate) rotation: Xyzw,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct PoseStamped<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) position: Xyz,
    pub(crate) orientation: Xyzw,
}

impl Stamp {
    /// None before 1970, which no clock gives.
    pub(crate) fn timestamp(&self) -> Option<Timestamp> {
        Timestamp::new_checked(u32::try_from(self.sec).ok()?, self.nanosec)
    }
}

impl From<Xyz> for Vector3 {
    fn from(v: Xyz) -> Self {
        Self { x: v.x, y: v.y, z: v.z }
    }
}

impl From<Xyzw> for Quaternion {
    fn from(q: Xyzw) -> Self {
        Self { x: q.x, y: q.y, z: q.z, w: q.w }
    }
}
