use super::*;
use foxglove::{Encode, messages::PackedElementField};

fn message(schema_name: &'static str, message_encoding: &'static str, data: impl Into<Bytes>) -> Encoded<'static> {
    Encoded { schema_name, message_encoding, publish_time_ns: 77, data: data.into() }
}

fn protobuf<M: Encode>(schema_name: &'static str, content: &M) -> Encoded<'static> {
    let mut data = Vec::new();
    content.encode(&mut data).unwrap();
    message(schema_name, "protobuf", data)
}

fn cloud_of(stride: u32, fields: &[(&str, u32, i32)], data: Vec<u8>) -> PointCloud {
    let field =
        |&(name, offset, kind): &(&str, u32, i32)| PackedElementField { name: name.into(), offset, r#type: kind };
    PointCloud {
        timestamp: Some(Timestamp::new(5, 6)),
        frame_id: "camera".into(),
        pose: None,
        point_stride: stride,
        fields: fields.iter().map(field).collect(),
        data: data.into(),
    }
}

fn xyz_f32(points: &[[f32; 3]]) -> PointCloud {
    let data = points.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    cloud_of(12, &[("x", 0, 7), ("y", 4, 7), ("z", 8, 7)], data)
}

fn read(raw: &PointCloud) -> Result<CloudRead, MessageError> {
    read_cloud(protobuf(POINT_CLOUD, raw))
}

#[test]
fn every_numeric_type_is_read_as_what_it_is() {
    // Foxglove's codes: 1 is unsigned and 2 signed, the other way round than in ROS.
    let minus_two: [(i32, Vec<u8>, f64); 8] = [
        (1, vec![254], 254.0),
        (2, vec![254], -2.0),
        (3, (-2_i16).to_le_bytes().into(), 65_534.0),
        (4, (-2_i16).to_le_bytes().into(), -2.0),
        (5, (-2_i32).to_le_bytes().into(), 4_294_967_294.0),
        (6, (-2_i32).to_le_bytes().into(), -2.0),
        (7, (-2_f32).to_le_bytes().into(), -2.0),
        (8, (-2_f64).to_le_bytes().into(), -2.0),
    ];
    for (code, bytes, metres) in minus_two {
        let n = bytes.len() as u32;
        let mut data = vec![3, 4];
        data.extend(&bytes);
        let raw = cloud_of(2 + n, &[("z", 0, 1), ("y", 1, 2), ("x", 2, code)], data);
        if metres * 1000.0 > osteoflow_geometry::FARTHEST_MM {
            let refusal = read(&raw).unwrap_err().to_string();
            let far = format!("point 1, at byte 0 of the data: the coordinate {:?} mm is farther", metres * 1000.0);
            assert!(refusal.starts_with(&far), "type {code}: {refusal}");
            continue;
        }
        let result = read(&raw).unwrap().cloud.points()[0];
        assert_eq!(result, Point3::new(metres * 1000.0, 4000.0, 3000.0), "type {code}");
    }
}

#[test]
fn points_that_are_not_finite_are_left_out_and_counted() {
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let read = read(&xyz_f32(&[[nan; 3], [0.5, 0.0, 1.0], [0.0, -inf, 0.0], [0.0, 0.0, nan]])).unwrap();
    assert_eq!((read.n_points_in_message, read.n_dropped), (4, 3));
    assert_eq!(read.cloud.points(), [Point3::new(500.0, 0.0, 1000.0)]);
    assert_eq!(read.cloud.stamp_ns, 5_000_000_006);
}

#[test]
fn the_times_of_points_are_a_column_and_those_of_points_that_are_left_out_are_not_in_it() {
    // As Ouster and Livox write them: nanoseconds from the stamp, unsigned.
    let point = |x: f32, ns: u32| [x.to_le_bytes(), 0f32.to_le_bytes(), 1f32.to_le_bytes(), ns.to_le_bytes()].concat();
    let points = [(0.1, 0), (f32::NAN, 1_000_000_000), (0.3, 3_000_000_000)];
    let data = points.iter().flat_map(|(x, ns)| point(*x, *ns)).collect();
    let fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("offset_time", 12, 5), ("intensity", 0, 7)];
    let cloud = read(&cloud_of(16, &fields, data)).unwrap().cloud;
    let columns: Vec<(&str, &[f64])> = cloud.extras().iter().map(|(name, values)| (&**name, &**values)).collect();
    assert_eq!(columns, [("offset_time", &[0.0, 3e9][..])]);
    // As Hesai and RoboSense do: seconds since 1970.
    let point = |s: f64| [&0.1f32.to_le_bytes()[..], &[0; 8], &s.to_le_bytes()].concat();
    let data = [1_750_000_011.25, 1_750_000_011.5].iter().flat_map(|s| point(*s)).collect();
    let fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("timestamp", 12, 8)];
    let cloud = read(&cloud_of(20, &fields, data)).unwrap().cloud;
    assert_eq!(&*cloud.extras()[0].1, [1_750_000_011.25, 1_750_000_011.5]);
}

#[test]
fn an_empty_cloud_is_a_cloud() {
    let read = read(&xyz_f32(&[])).unwrap();
    assert!(read.cloud.is_empty() && read.n_points_in_message == 0);
}

#[test]
fn a_pose_moves_points_and_normals_while_the_camera_stays_at_its_own_origin() {
    let mut raw = xyz_f32(&[[0.1, 0.0, 0.0], [0.0, 0.0, 1.0]]);
    raw.point_stride = 24;
    raw.fields.extend([("nx", 12), ("ny", 16), ("nz", 20)].map(|(name, offset)| PackedElementField {
        name: name.into(),
        offset,
        r#type: 7,
    }));
    raw.data = [0.1, 0.0, 0.0, 2.0, 0.0, 0.0_f32].iter().flat_map(|c| c.to_le_bytes()).collect::<Vec<u8>>().into();
    // A quarter turn about z and half a metre along y.
    let q = std::f64::consts::FRAC_1_SQRT_2;
    raw.pose = Some(FoxglovePose {
        position: Some(FoxgloveVector3 { x: 0.0, y: 0.5, z: 0.0 }),
        orientation: Some(FoxgloveQuaternion { x: 0.0, y: 0.0, z: q, w: q }),
    });
    let cloud = read(&raw).unwrap().cloud;
    // 0.1 in single precision is off by 1.5e-6 mm.
    assert!((cloud.points()[0] - Point3::new(0.0, 600.0, 0.0)).norm() < 1e-5);
    assert!((cloud.normals().unwrap()[0] - Vector3::y()).norm() < 1e-12, "unit length, turned along");
    assert_eq!(cloud.viewpoint, Some(Isometry3::identity()));
    raw.frame_id = "world".into();
    let seen_from = read(&raw).unwrap().cloud.viewpoint.unwrap() * Point3::origin();
    assert!((seen_from - Point3::new(0.0, 500.0, 0.0)).norm() < 1e-9, "in the world the pose is the sensor's");
}

#[test]
fn an_unset_pose_leaves_the_coordinates_as_they_are() {
    let plain = read(&xyz_f32(&[[0.1, 0.2, 0.3]])).unwrap().cloud;
    assert_eq!(plain.viewpoint, Some(Isometry3::identity()));
    let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]]);
    raw.pose = Some(FoxglovePose { position: None, orientation: None });
    assert_eq!(read(&raw).unwrap().cloud, plain);
}

#[test]
fn a_cloud_that_was_moved_to_the_world_does_not_say_where_its_camera_was() {
    for frame in ["world", "bone_marker"] {
        let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]]);
        raw.frame_id = frame.into();
        assert_eq!(read(&raw).unwrap().cloud.viewpoint, None, "{frame}");
    }
}

#[test]
fn a_pose_that_turns_nothing_is_refused() {
    for (w, refusal) in [
        (0.0, "the quaternion is zero"),
        (f64::NAN, "the quaternion is not finite"),
        (
            2.0,
            "the quaternion has length 2 instead of 1, off by 1.0e0 where 1e-3 is allowed; it would move a point at 1 m by up to 4000 mm",
        ),
    ] {
        let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]]);
        let orientation = FoxgloveQuaternion { x: 0.0, y: 0.0, z: 0.0, w };
        raw.pose = Some(FoxglovePose { position: None, orientation: Some(orientation) });
        let error = read(&raw).unwrap_err().to_string();
        assert_eq!(error, format!("the cloud's pose cannot be used: {refusal}"));
        assert_eq!(read_cloud_head(protobuf(POINT_CLOUD, &raw)).unwrap_err().to_string(), error);
    }
}

#[test]
fn a_rounded_pose_of_a_cloud_is_corrected_and_says_by_how_much() {
    let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]]);
    let orientation = FoxgloveQuaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.9998 };
    raw.pose = Some(FoxglovePose { position: None, orientation: Some(orientation) });
    let result = read(&raw).unwrap();
    assert!((result.correction.deviation - 2e-4).abs() < 1e-12, "{:?}", result.correction);
    let head = read_cloud_head(protobuf(POINT_CLOUD, &raw)).unwrap();
    assert_eq!(
        head,
        CloudHead { frame: result.cloud.frame.clone(), stamp_ns: 5_000_000_006, correction: result.correction }
    );
    let json = r#"{"timestamp":{"sec":5,"nsec":6},"frame_id":"camera","pose":{"orientation":{"w":0.9998}},"data":"!"}"#;
    assert_eq!(read_cloud_head(message(POINT_CLOUD, "json", json)).unwrap(), head);
}

#[test]
fn a_transform_is_lost_rounded_or_no_rigid_motion_by_the_length_of_its_quaternion() {
    let read = |w: f64| {
        let transform = FrameTransform {
            timestamp: Some(Timestamp::new(1, 0)),
            parent_frame_id: "world".into(),
            child_frame_id: "m".into(),
            translation: None,
            rotation: Some(FoxgloveQuaternion { x: 0.0, y: 0.0, z: 0.0, w }),
        };
        read_transforms(protobuf(FRAME_TRANSFORM, &transform)).unwrap().remove(0)
    };
    assert_eq!(read(1.0).unwrap().correction, Correction::default());
    let rounded = read(1.0005).unwrap();
    assert!((rounded.correction.mm_at_1_m - 2.0).abs() < 1e-9, "{:?}", rounded.correction);
    assert_eq!(rounded.value.isometry, Isometry3::identity());
    assert!(matches!(read(1e-9), Err(PoseError::Lost(_))));
    for w in [1.0011, 0.9, -2.0, 1e-3, 1e9] {
        let error = read(w).unwrap_err();
        assert!(matches!(error, PoseError::NotRigid { .. }), "{error}");
        assert!(error.to_string().starts_with("t_world_m at 1000000000 ns is no rigid motion: "), "{error}");
    }
}

#[test]
fn bytes_that_do_not_add_up_are_named_with_their_numbers() {
    let mut raw = xyz_f32(&[[0.1, 0.2, 0.3]; 2]);
    raw.data = raw.data.slice(..23);
    let error = read(&raw).unwrap_err().to_string();
    assert!(
        error.starts_with("the data has 23 bytes, which is no whole number of points of 12 bytes: 11 remain"),
        "{error}"
    );
    raw.point_stride = 11;
    let refused = |raw: &PointCloud, reason: &str| {
        let message = read(raw).unwrap_err().to_string();
        assert!(message.starts_with(reason), "{message}");
    };
    refused(&raw, "field \"z\" ends at byte 12 of a point, but a point has 11 bytes");
    raw.point_stride = 0;
    refused(&raw, "field \"x\" ends at byte 4 of a point, but a point has 0 bytes");
    raw.fields.pop();
    refused(&raw, "field \"x\" ends at byte 4 of a point, but a point has 0 bytes");
    raw.point_stride = 23;
    refused(&raw, "the points have no field \"z\"; there are: x, y");
    raw.fields[0].r#type = 9;
    refused(&raw, "field \"x\" has numeric type 9");
}

#[test]
fn a_missing_or_zero_timestamp_gives_way_to_the_publish_time() {
    let mut raw = xyz_f32(&[[0.0; 3]]);
    for timestamp in [None, Some(Timestamp::new(0, 0))] {
        raw.timestamp = timestamp;
        assert_eq!(read(&raw).unwrap().cloud.stamp_ns, 77);
        assert_eq!(read_cloud_head(protobuf(POINT_CLOUD, &raw)).unwrap().stamp_ns, 77);
    }
}

#[test]
fn a_marker_that_was_not_seen_is_lost_and_not_at_zero() {
    let nan = f64::NAN;
    let cases = [
        (0.0, 0.5, "an all-zero quaternion"),
        (nan, 0.5, "a quaternion that is not finite"),
        (1.0, nan, "a position that is not finite"),
        // What an NDI tracker writes for a missing marker.
        (1.0, -3.697314e28, "a position 3.7e28 m away"),
    ];
    for (w, x, reason) in cases {
        let transform = FrameTransform {
            timestamp: Some(Timestamp::new(1, 0)),
            parent_frame_id: "world".into(),
            child_frame_id: "bone_marker".into(),
            translation: Some(FoxgloveVector3 { x, y: 0.0, z: 0.0 }),
            rotation: Some(FoxgloveQuaternion { x: 0.0, y: 0.0, z: 0.0, w }),
        };
        let lost = read_transforms(protobuf(FRAME_TRANSFORM, &transform)).unwrap().remove(0).unwrap_err();
        let PoseError::Lost(lost) = lost else { panic!("{lost}") };
        assert_eq!((lost.stamp_ns, lost.reason.as_str()), (1_000_000_000, reason));
        assert!(lost.to_string().starts_with("marker lost: t_world_bone_marker at 1000000000 ns"));
    }
}

#[test]
fn json_is_read_as_writers_spell_it() {
    let spelt = [
        r#"{"timestamp":{"sec":1750000001,"nsec":5},"parent_frame_id":"world","child_frame_id":"m",
            "translation":{"x":1,"y":0.5,"z":0},"rotation":{"x":0,"y":0,"z":0,"w":1}}"#,
        r#"{"timestamp":"2025-06-15T15:06:41.000000005Z","parentFrameId":"world","childFrameId":"m",
            "translation":{"x":1.0,"y":5e-1},"rotation":{"w":"1"}}"#,
        r#"{"timestamp":"2025-06-15T17:06:41.000000005+02:00","parentFrameId":"world","childFrameId":"m",
            "translation":{"x":1.0,"y":0.5},"rotation":{"w":1.0}}"#,
        r#"{"timestamp":{"seconds":"1750000001","nanos":5},"parent_frame_id":"world","child_frame_id":"m","more":NaN,
            "translation":{"x":1,"y":0.5,"z":0},"rotation":{"x":0,"y":0,"z":0,"w":1}}"#,
    ];
    for text in spelt {
        let pose = read_transforms(message(FRAME_TRANSFORM, "json", text)).unwrap().remove(0).unwrap().value;
        let expected =
            Pose::new("world", "m", Isometry3::translation(1000.0, 500.0, 0.0)).at(1_750_000_001_000_000_005);
        assert_eq!(pose, expected, "{text}");
    }
    let lost = r#"{"parent_frame_id":"w\"NaN","child_frame_id":"m","translation":{"x":NaN,"y":null,"z":-Infinity},
        "rotation":{"x":"NaN","y":0,"z":0,"w":1}}"#;
    let lost = read_transforms(message(FRAME_TRANSFORM, "json", lost)).unwrap().remove(0).unwrap_err();
    let PoseError::Lost(lost) = lost else { panic!("{lost}") };
    assert_eq!((lost.stamp_ns, lost.to.as_str()), (77, "w\"NaN"), "a text that says NaN stays a text");
}

#[test]
fn a_json_cloud_is_read_with_types_by_name_and_base64_of_either_alphabet() {
    // 0.5, -1, 2 in single precision; the second spelling has no padding and the alphabet for URLs.
    for data in ["AAAAPwAAgL8AAABA", " AAAAPwAAgL8AAABA\n"] {
        let text = format!(
            r#"{{"frameId":"camera","pointStride":12,"data":{data:?},"pose":{{"orientation":{{"w":1}}}},
            "fields":[{{"name":"x","type":"FLOAT32"}},{{"name":"y","offset":4,"type":7}},{{"name":"z","offset":8,"type":"FLOAT32"}}]}}"#
        );
        let read = read_cloud(message(POINT_CLOUD, "json", text)).unwrap();
        assert_eq!(read.cloud.points(), [Point3::new(500.0, -1000.0, 2000.0)]);
    }
    let data = [1.5_f32, f32::from_bits(0xFBFF_BFBF), 0.25].iter().flat_map(|c| c.to_le_bytes()).collect::<Vec<_>>();
    for engine in [base64::prelude::BASE64_URL_SAFE_NO_PAD, base64::prelude::BASE64_STANDARD_NO_PAD] {
        use base64::Engine;
        let mut bytes = data.clone();
        bytes.push(0xFF);
        let text = format!(
            r#"{{"point_stride":13,"data":"{}","fields":[{{"name":"x","type":7}},{{"name":"y","offset":8,"type":7}},
            {{"name":"z","offset":8,"type":7}}]}}"#,
            engine.encode(&bytes)
        );
        let read = read_cloud(message(POINT_CLOUD, "json", text)).unwrap();
        assert_eq!(read.cloud.points()[0].z, 250.0);
    }
    let bad = r#"{"point_stride":12,"data":"A*","fields":[]}"#;
    let error = read_cloud(message(POINT_CLOUD, "json", bad)).unwrap_err().to_string();
    assert!(error.starts_with("the message is no foxglove.PointCloud: data is no base64"), "{error}");
}

#[test]
fn a_tip_may_lack_its_orientation_but_not_its_position() {
    let tip = |pose| PoseInFrame { timestamp: None, frame_id: "world".into(), pose };
    let position = Some(FoxgloveVector3 { x: 0.001, y: 0.0, z: 0.0 });
    let read = |t: &PoseInFrame| read_pose_in_frame(protobuf(POSE_IN_FRAME, t));
    let result = read(&tip(Some(FoxglovePose { position, orientation: None }))).unwrap();
    assert_eq!((result.position, &result.orientation, result.stamp_ns), (Point3::new(1.0, 0.0, 0.0), &None, 77));
    let error = result.pose("tip").unwrap_err().to_string();
    assert!(error.ends_with("t_world_tip at 77 ns has no orientation"), "no identity in its place: {error}");
    let turned =
        |w| tip(Some(FoxglovePose { position, orientation: Some(FoxgloveQuaternion { w, ..Default::default() }) }));
    let pose = read(&turned(0.9999)).unwrap().pose("tip").unwrap();
    assert_eq!(pose.value, Pose::new("world", "tip", Isometry3::translation(1.0, 0.0, 0.0)).at(77));
    assert!(pose.correction.deviation > 9e-5);
    assert!(matches!(read(&turned(0.0)).unwrap().pose("tip"), Err(PoseError::Lost(_))));
    assert!(matches!(read(&turned(0.9)).unwrap().pose("tip"), Err(PoseError::NotRigid { .. })));
    assert!(read(&tip(None)).unwrap_err().to_string().contains("no pose"));
}

#[test]
fn another_schema_or_encoding_is_named() {
    let refusal = read_cloud(message("sensor_msgs/msg/PointCloud2", "cdr", "")).unwrap_err().to_string();
    assert_eq!(refusal, "the message is no sensor_msgs/msg/PointCloud2: it has 0 bytes, and CDR begins with 4");
    // The schema of one family in the encoding of the other.
    for (schema, encoding) in [(POINT_CLOUD, "cdr"), ("sensor_msgs/msg/PointCloud2", "protobuf"), (POINT_CLOUD, "ros1")]
    {
        let refusal = read_cloud(message(schema, encoding, "")).unwrap_err().to_string();
        assert!(
            refusal.starts_with(&format!("a {schema} written as \"{encoding}\" is not read; foxglove.*")),
            "{refusal}"
        );
    }
    let refusal = read_transforms(message(POINT_CLOUD, "protobuf", "")).unwrap_err().to_string();
    assert!(refusal.contains("but the topic carries foxglove.PointCloud"), "{refusal}");
}

#[test]
fn a_region_that_cannot_be_understood_is_an_error_and_not_ignored() {
    let recording = |min: &str, max: &str| {
        let keys = [("roi_camera_min_m", min), ("roi_camera_max_m", max)];
        let record = keys.into_iter().filter(|k| !k.1.is_empty()).map(|(k, v)| (k.to_owned(), v.to_owned()));
        let mut recording = Recording::default();
        recording.metadata.insert("procedure".into(), record.collect());
        recording
    };
    assert_eq!(procedure_region(&recording("", "")), Ok(None));
    for (min, max, refusal) in [
        ("0 0", "1 1 1", "\"0 0\" is not three numbers"),
        ("0 0 0", "1 1 1 1", "\"1 1 1 1\" is not three numbers"),
        ("0 0 nan", "1 1 1", "is not three numbers"),
        ("0 2 0", "1 1 1", "its y is above that of roi_camera_max_m"),
        ("0 0 0", "", "key \"roi_camera_max_m\": it is missing"),
    ] {
        let error = procedure_region(&recording(min, max)).unwrap_err().to_string();
        assert!(error.contains(refusal), "{error}");
    }
}
