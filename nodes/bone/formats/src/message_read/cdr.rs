//! Messages of ROS 2 in CDR.
//!
//! The bytes begin with four of encapsulation, of which the second gives the byte order; only plain CDR (version 1) is
//! read, which is what ROS 2 writes. Lengths are metres (REP 103). A quaternion of zeros is a pose that was not set.
//!
//! # Source
//! OMG DDSI-RTPS 2.5, section 10.2 (encapsulation); the interface definitions of `sensor_msgs`, `geometry_msgs`, `tf2_msgs`.

use super::{Encoded, MessageError, no_such};
use crate::{
    foxglove_json::{JsonPose, JsonPoseInFrame, JsonTransform, Time},
    ros2::{
        NUMERIC_TYPES, ODOMETRY, Odometry, POSE_WITH_COVARIANCE, PointCloud2, PoseStamped, PoseWithCovariance,
        TransformStamped,
    },
};
use bytes::Bytes;
use foxglove::messages::{PackedElementField, PointCloud, Quaternion, Vector3, packed_element_field::NumericType};
use re_cdr::{BigEndian, LittleEndian, from_bytes};
use serde::Deserialize;

/// The cloud of a `sensor_msgs/msg/PointCloud2` without the padding of its rows, and whether its numbers are big-endian.
pub(super) fn cloud(message: &Encoded) -> Result<(PointCloud, bool), MessageError> {
    let read: PointCloud2 = decode(message)?;
    let fault = |reason: String| no_such(message, reason);
    let (width, height) = (u64::from(read.width), u64::from(read.height));
    let (point, row, n_bytes) = (u64::from(read.point_step), u64::from(read.row_step), read.data.len() as u64);
    if width * point > row {
        return Err(fault(format!("a row of {width} points of {point} bytes exceeds its {row} bytes (row_step)")));
    }
    if row * height != n_bytes {
        return Err(fault(format!(
            "the data has {n_bytes} bytes, but {height} rows of {row} bytes are announced; was the message cut short?"
        )));
    }
    let used = (width * point) as usize;
    let data = if used as u64 == row {
        message.data.slice_ref(read.data)
    } else {
        Bytes::from(read.data.chunks_exact(row as usize).flat_map(|row| &row[..used]).copied().collect::<Vec<u8>>())
    };
    let fields = read.fields.iter().map(|field| PackedElementField {
        name: field.name.into(),
        offset: field.offset,
        r#type: numeric_type(field.datatype).into(),
    });
    let cloud = PointCloud {
        timestamp: read.header.stamp.timestamp(),
        frame_id: read.header.frame_id.into(),
        pose: None,
        point_stride: read.point_step,
        fields: fields.collect(),
        data,
    };
    Ok((cloud, read.is_bigendian))
}

/// The transforms of a `tf2_msgs/msg/TFMessage`.
pub(super) fn transforms(message: &Encoded) -> Result<Vec<JsonTransform>, MessageError> {
    let read: Vec<TransformStamped> = decode(message)?;
    Ok(read.into_iter().map(JsonTransform::from).collect())
}

/// The transform of a `geometry_msgs/msg/TransformStamped`, or of the pose of a `nav_msgs/msg/Odometry`.
pub(super) fn transform(message: &Encoded) -> Result<JsonTransform, MessageError> {
    Ok(match message.schema_name {
        ODOMETRY => decode::<Odometry>(message)?.pose.into(),
        _ => decode::<TransformStamped>(message)?.into(),
    })
}

/// The pose of a `geometry_msgs/msg/PoseStamped` or `PoseWithCovarianceStamped`.
pub(super) fn pose(message: &Encoded) -> Result<JsonPoseInFrame, MessageError> {
    let read: PoseStamped = match message.schema_name {
        POSE_WITH_COVARIANCE => decode::<PoseWithCovariance>(message)?.pose,
        _ => decode(message)?,
    };
    let pose = JsonPose { position: vector(read.position), orientation: quaternion(read.orientation) };
    Ok(JsonPoseInFrame {
        timestamp: Time::from(read.header.stamp.timestamp()),
        frame_id: read.header.frame_id.into(),
        pose: Some(pose),
    })
}

pub(super) fn decode<'a, T: Deserialize<'a>>(message: &'a Encoded) -> Result<T, MessageError> {
    let Some(([high, low, _, _], body)) = message.data.split_first_chunk() else {
        return Err(no_such(message, format!("it has {} bytes, and CDR begins with 4", message.data.len())));
    };
    let (value, n_read) = match (high, low) {
        (0, 0) => from_bytes::<T, BigEndian>(body),
        (0, 1) => from_bytes::<T, LittleEndian>(body),
        _ => return Err(no_such(message, format!("encapsulation {high:#04x} {low:#04x} is not plain CDR"))),
    }
    .map_err(|error| no_such(message, error))?;
    // Writers may align the end.
    match body.len() - n_read {
        0..=7 => Ok(value),
        rest => Err(no_such(message, format!("{rest} bytes follow it; another version of the message?"))),
    }
}

impl From<TransformStamped<'_>> for JsonTransform {
    fn from(t: TransformStamped) -> Self {
        Self {
            timestamp: t.header.stamp.timestamp().into(),
            parent_frame_id: t.header.frame_id.into(),
            child_frame_id: t.child_frame_id.into(),
            translation: vector(t.translation),
            rotation: quaternion(t.rotation),
        }
    }
}

fn vector([x, y, z]: [f64; 3]) -> Option<Vector3> {
    Some(Vector3 { x, y, z })
}

fn quaternion([x, y, z, w]: [f64; 4]) -> Option<Quaternion> {
    Some(Quaternion { x, y, z, w })
}

fn numeric_type(datatype: u8) -> NumericType {
    let known = NUMERIC_TYPES.iter().find(|(code, _)| *code == datatype);
    known.map_or(NumericType::Unknown, |(_, kind)| *kind)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        message_read::{read_cloud, read_pose_in_frame, read_transforms},
        ros2::{Header, POINT_CLOUD_2, POSE_STAMPED, PointField, Stamp, TF_MESSAGE, TRANSFORM_STAMPED},
    };
    use nalgebra::Point3;
    use re_cdr::to_vec;
    use serde::Serialize;

    fn message(schema_name: &'static str, data: Vec<u8>) -> Encoded<'static> {
        Encoded { schema_name, message_encoding: "cdr", publish_time_ns: 77, data: data.into() }
    }

    fn little(value: &impl Serialize) -> Vec<u8> {
        [&[0, 1, 0, 0][..], &to_vec::<_, LittleEndian>(value).unwrap()].concat()
    }

    fn header(frame_id: &str) -> Header<'_> {
        Header { stamp: Stamp { sec: 5, nanosec: 6 }, frame_id }
    }

    /// Two rows of two points of 16 bytes (x, y, z as float32, four bytes of padding) and eight bytes behind each row.
    fn organised(change: impl Fn(&mut PointCloud2<'_>)) -> Vec<u8> {
        let mut data = Vec::new();
        for row in 0..2_u8 {
            for column in 0..2_u8 {
                [f32::from(row), f32::from(column), 0.25].iter().for_each(|c| data.extend(c.to_le_bytes()));
                data.extend([0xA5; 4]);
            }
            data.extend([0xFF; 8]);
        }
        let field = |(name, offset)| PointField { name, offset, datatype: 7, count: 1 };
        let mut cloud = PointCloud2 {
            header: header("lidar"),
            height: 2,
            width: 2,
            fields: [("x", 0), ("y", 4), ("z", 8)].map(field).into(),
            is_bigendian: false,
            point_step: 16,
            row_step: 40,
            data: &data,
            is_dense: true,
        };
        change(&mut cloud);
        little(&cloud)
    }

    #[test]
    fn the_padding_of_rows_and_points_is_no_point() {
        let read = read_cloud(message(POINT_CLOUD_2, organised(|_| ()))).unwrap();
        let expected = [(0.0, 0.0), (0.0, 1e3), (1e3, 0.0), (1e3, 1e3)].map(|(x, y)| Point3::new(x, y, 250.0));
        assert_eq!(read.cloud.points(), expected);
        assert_eq!((read.cloud.frame.as_str(), read.cloud.stamp_ns), ("lidar", 5_000_000_006));
    }

    #[test]
    fn numbers_that_contradict_each_other_are_refused() {
        let fault = |change: fn(&mut PointCloud2<'_>)| {
            read_cloud(message(POINT_CLOUD_2, organised(change))).unwrap_err().to_string()
        };
        for (refusal, expected) in [
            (
                fault(|c| c.height = 3),
                "the data has 80 bytes, but 3 rows of 40 bytes are announced; was the message cut",
            ),
            (fault(|c| c.width = 3), "a row of 3 points of 16 bytes exceeds its 40 bytes (row_step)"),
            (fault(|c| c.width = u32::MAX), "exceeds its 40 bytes"),
            (fault(|c| c.row_step = u32::MAX), "are announced"),
            (fault(|c| c.fields[0].offset = 14), "field \"x\" ends at byte 18 of a point"),
            (fault(|c| c.fields[1].datatype = 9), "field \"y\" has numeric type 0"),
            (fault(|c| c.fields[2].name = "depth"), "the points have no field \"z\"; there are: x, y, depth"),
            (fault(|c| c.row_step = 0), "a row of 2 points of 16 bytes exceeds its 0 bytes"),
        ] {
            assert!(refusal.contains(expected), "{refusal}\n{expected}");
        }
    }

    #[test]
    fn big_endian_points_are_read_as_such_and_not_as_noise() {
        let swapped = |big_endian: bool| {
            let bytes: Vec<u8> = [1.0_f32, 2.0, 3.0].iter().flat_map(|c| c.to_be_bytes()).collect();
            let field = |(name, offset)| PointField { name, offset, datatype: 7, count: 1 };
            little(&PointCloud2 {
                header: header("camera"),
                height: 1,
                width: 1,
                fields: [("x", 0), ("y", 4), ("z", 8)].map(field).into(),
                is_bigendian: big_endian,
                point_step: 12,
                row_step: 12,
                data: &bytes,
                is_dense: true,
            })
        };
        let read = read_cloud(message(POINT_CLOUD_2, swapped(true))).unwrap();
        assert_eq!(read.cloud.points(), [Point3::new(1e3, 2e3, 3e3)]);
    }

    fn transform_to(child_frame_id: &str, w: f64) -> TransformStamped<'_> {
        TransformStamped {
            header: header("world"),
            child_frame_id,
            translation: [0.1, 0.2, 0.3],
            rotation: [0.0, 0.0, 0.0, w],
        }
    }

    #[test]
    fn poses_with_covariance_are_those_without() {
        let covariance = [[7.0; 6]; 6];
        let odometry =
            Odometry { pose: transform_to("base", 1.0), covariance, twist: [9.0; 6], twist_covariance: covariance };
        let bytes = little(&odometry);
        let read = read_transforms(message(ODOMETRY, bytes.clone())).unwrap();
        let [Ok(pose)] = &read[..] else { panic!("{read:?}") };
        assert_eq!((pose.value.to.as_str(), pose.value.from.as_str()), ("world", "base"));
        assert!((pose.value.isometry.translation.vector - nalgebra::Vector3::new(100.0, 200.0, 300.0)).norm() < 1e-9);
        // What follows the pose is part of the message: a shorter one is damaged.
        assert!(read_transforms(message(ODOMETRY, bytes[..bytes.len() - 8].to_vec())).is_err());
        assert!(read_transforms(message(TRANSFORM_STAMPED, bytes)).is_err(), "another schema");
        let position =
            PoseStamped { header: header("map"), position: [1.0, 2.0, 3.0], orientation: [0.0, 0.0, 0.0, 1.0] };
        let whole = little(&PoseWithCovariance { pose: position, covariance });
        let tip = read_pose_in_frame(message(POSE_WITH_COVARIANCE, whole)).unwrap();
        assert_eq!((tip.frame.as_str(), tip.position.z), ("map", 3000.0));
    }

    #[test]
    fn a_quaternion_of_zeros_is_a_marker_that_was_not_seen() {
        let both = message(TF_MESSAGE, little(&vec![transform_to("a", 1.0), transform_to("b", 0.0)]));
        let read = read_transforms(both).unwrap();
        let seen = read[0].as_ref().unwrap();
        assert_eq!((seen.value.to.as_str(), seen.value.from.as_str()), ("world", "a"));
        assert_eq!(seen.value.isometry.translation.vector.as_slice(), [100.0, 200.0, 300.0]);
        assert!(read[1].as_ref().unwrap_err().to_string().contains("all-zero quaternion"));
        let one = read_transforms(message(TRANSFORM_STAMPED, little(&transform_to("a", 1.0)))).unwrap();
        assert_eq!(one[0], read[0]);
    }

    #[test]
    fn a_message_that_is_short_long_or_of_another_layout_is_refused() {
        let pose =
            PoseStamped { header: header("world"), position: [0.0, 1.0, 2.0], orientation: [0.0, 0.0, 0.0, 1.0] };
        let whole = little(&pose);
        assert_eq!(read_pose_in_frame(message(POSE_STAMPED, whole.clone())).unwrap().position.y, 1e3);
        for n in 0..whole.len() {
            let refusal = read_pose_in_frame(message(POSE_STAMPED, whole[..n].to_vec())).unwrap_err().to_string();
            assert!(refusal.contains("the message is no geometry_msgs/msg/PoseStamped"), "{n} bytes: {refusal}");
        }
        let mut long = whole.clone();
        long.extend([0; 36 * 8]);
        let refusal = read_pose_in_frame(message(POSE_STAMPED, long)).unwrap_err().to_string();
        assert!(refusal.contains("288 bytes follow it"), "a pose with covariance: {refusal}");
        for encapsulation in [[0, 2], [0, 7], [0x28, 0xb5]] {
            let mut other = whole.clone();
            other[..2].copy_from_slice(&encapsulation);
            let refusal = read_pose_in_frame(message(POSE_STAMPED, other)).unwrap_err().to_string();
            assert!(refusal.contains("is not plain CDR"), "{refusal}");
        }
    }
}
