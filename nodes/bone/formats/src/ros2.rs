//! The messages of ROS 2 that are read, as CDR lays them out.
//!
//! # Source
//! The interface definitions of `builtin_interfaces`, `std_msgs`, `geometry_msgs`, `sensor_msgs` and `tf2_msgs`.

use foxglove::messages::{Timestamp, packed_element_field::NumericType};
use serde::{Deserialize, Serialize};

/// A cloud.
pub(crate) const POINT_CLOUD_2: &str = "sensor_msgs/msg/PointCloud2";
/// One transform.
pub(crate) const TRANSFORM_STAMPED: &str = "geometry_msgs/msg/TransformStamped";
/// Several transforms.
pub(crate) const TF_MESSAGE: &str = "tf2_msgs/msg/TFMessage";
/// An image without compression.
pub(crate) const IMAGE: &str = "sensor_msgs/msg/Image";
/// A compressed image.
pub(crate) const COMPRESSED_IMAGE: &str = "sensor_msgs/msg/CompressedImage";
/// The calibration of a camera.
pub(crate) const CAMERA_INFO: &str = "sensor_msgs/msg/CameraInfo";
/// A pose in a frame.
pub(crate) const POSE_STAMPED: &str = "geometry_msgs/msg/PoseStamped";

/// A pose in a frame with its covariance, which is not read.
pub(crate) const POSE_WITH_COVARIANCE: &str = "geometry_msgs/msg/PoseWithCovarianceStamped";
/// The pose of a child frame with its covariance and velocity, which are not read.
pub(crate) const ODOMETRY: &str = "nav_msgs/msg/Odometry";

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
pub(crate) struct Image<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) height: u32,
    pub(crate) width: u32,
    pub(crate) encoding: &'a str,
    pub(crate) is_bigendian: u8,
    pub(crate) step: u32,
    pub(crate) data: &'a [u8],
}

#[derive(Serialize, Deserialize)]
pub(crate) struct CompressedImage<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) format: &'a str,
    pub(crate) data: &'a [u8],
}

#[derive(Serialize, Deserialize)]
pub(crate) struct CameraInfo<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) height: u32,
    pub(crate) width: u32,
    pub(crate) distortion_model: &'a str,
    pub(crate) d: Vec<f64>,
    pub(crate) k: [f64; 9],
    pub(crate) r: [f64; 9],
    pub(crate) p: [f64; 12],
    pub(crate) binning_x: u32,
    pub(crate) binning_y: u32,
    pub(crate) roi: RegionOfInterest,
}

/// The part of the sensor that an image shows; zeros for all of it.
#[derive(Serialize, Deserialize)]
pub(crate) struct RegionOfInterest {
    pub(crate) x_offset: u32,
    pub(crate) y_offset: u32,
    pub(crate) height: u32,
    pub(crate) width: u32,
    pub(crate) do_rectify: bool,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct TransformStamped<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) child_frame_id: &'a str,
    /// x, y, z.
    pub(crate) translation: [f64; 3],
    /// x, y, z, w.
    pub(crate) rotation: [f64; 4],
}

#[derive(Serialize, Deserialize)]
pub(crate) struct PoseStamped<'a> {
    #[serde(borrow)]
    pub(crate) header: Header<'a>,
    pub(crate) position: [f64; 3],
    pub(crate) orientation: [f64; 4],
}

type Covariance = [[f64; 6]; 6];

#[derive(Serialize, Deserialize)]
pub(crate) struct PoseWithCovariance<'a> {
    #[serde(borrow)]
    pub(crate) pose: PoseStamped<'a>,
    pub(crate) covariance: Covariance,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct Odometry<'a> {
    #[serde(borrow)]
    pub(crate) pose: TransformStamped<'a>,
    pub(crate) covariance: Covariance,
    pub(crate) twist: [f64; 6],
    pub(crate) twist_covariance: Covariance,
}

impl Stamp {
    /// None before 1970, which no clock gives.
    pub(crate) fn timestamp(&self) -> Option<Timestamp> {
        Timestamp::new_checked(u32::try_from(self.sec).ok()?, self.nanosec)
    }
}
