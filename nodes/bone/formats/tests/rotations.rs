//! One rule for all doors: numbers that are no rotation are refused with their place and value, wherever they come from.
//!
//! The doors that do not read files have their tests beside them: payloads of plugins, processes and exact recordings in
//! `nodes/kinds/payloads`, live sources in `nodes/kinds/standard`.

use foxglove::{
    Encode,
    messages::{FrameTransform, Pose, PoseInFrame, Quaternion, Vector3},
};
use osteoflow_formats::{
    message_read::{Encoded, read_pose_in_frame, read_transforms},
    openigtlink::Affine,
    picked_points::parse_picked_points,
    plan_file::parse_plan,
    pose_file::read_pose,
    poses_csv::read_poses,
    volume::read_volume,
};
use std::path::Path;

/// Lengths of quaternions that were once normalised without a word.
const LENGTHS: [f64; 8] = [1e-5, 1e-3, 0.5, 0.998, 1.002, 2.0, 1e3, 1e6];

/// Matrices that are no rotation, row by row, and what is said of each.
const MATRICES: [([f64; 9], &str); 5] = [
    ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], "the matrix is a mirror image (determinant -1.000)"),
    ([1.1, 0.0, 0.0, 0.0, 1.1, 0.0, 0.0, 0.0, 1.1], "not a rotation: it is off by 1.0e-1 where 1e-3 is allowed"),
    ([1.0, 0.01, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "not a rotation: it is off by"),
    ([1000.0, 0.0, 0.0, 0.0, 1000.0, 0.0, 0.0, 0.0, 1000.0], "not a rotation: it is off by"),
    ([0.0; 9], "the matrix is zero"),
];

fn in_file<T>(text: impl AsRef<[u8]>, read: impl Fn(&Path) -> T) -> T {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    read(file.path())
}

fn of_length(length: f64) -> [f64; 4] {
    [0.6 * length, 0.0, 0.0, 0.8 * length]
}

fn assert_says(door: &str, refusal: &str, place: &str, value: &str) {
    assert!(refusal.contains(place) && refusal.contains(value), "{door}: {place}: {value}\n{refusal}");
}

fn rows(matrix: &[f64; 9]) -> String {
    let row = |k: usize| format!("[{:?}, {:?}, {:?}, 0]", matrix[3 * k], matrix[3 * k + 1], matrix[3 * k + 2]);
    format!("[{}, {}, {}, [0, 0, 0, 1]]", row(0), row(1), row(2))
}

#[test]
fn a_quaternion_of_another_length_is_refused_at_every_door_of_quaternions() {
    let value = |length: f64| format!("the quaternion has length {}", format!("{length:?}").trim_end_matches(".0"));
    for length in LENGTHS {
        let [x, y, z, w] = of_length(length);
        let begin = match length {
            // Rounding may show in the last digits.
            l if l == 0.998 || l == 1.002 => format!("the quaternion has length {}", &format!("{l:?}")[..4]),
            1e-5 => "the quaternion has length 0.0000".into(),
            1e6 => "the quaternion has length 1000000".into(),
            l => value(l),
        };
        let text = format!("t_ns,parent,child,x,y,z,qx,qy,qz,qw\n5,world,m,0,0,0,{x:?},{y:?},{z:?},{w:?}\n");
        let refusal = in_file(text, |path| read_poses(path, 1.0).unwrap_err().to_string());
        assert_says("poses.csv", &refusal, "line 2", &begin);

        let rotation = Quaternion { x, y, z, w };
        let transform = FrameTransform {
            timestamp: None,
            parent_frame_id: "world".into(),
            child_frame_id: "m".into(),
            translation: Some(Vector3 { x: 0.0, y: 0.0, z: 0.0 }),
            rotation: Some(rotation),
        };
        let mut data = Vec::new();
        transform.encode(&mut data).unwrap();
        let message = |schema_name, message_encoding, data: Vec<u8>| Encoded {
            schema_name,
            message_encoding,
            publish_time_ns: 7,
            data: data.into(),
        };
        let read = read_transforms(message("foxglove.FrameTransform", "protobuf", data)).unwrap();
        assert_says("protobuf", &read[0].as_ref().unwrap_err().to_string(), "t_world_m at 7 ns", &begin);

        let json = format!(
            r#"{{"parent_frame_id":"world","child_frame_id":"m","rotation":{{"x":{x:?},"y":{y:?},"z":{z:?},"w":{w:?}}}}}"#
        );
        let read = read_transforms(message("foxglove.FrameTransform", "json", json.into())).unwrap();
        assert_says("JSON", &read[0].as_ref().unwrap_err().to_string(), "t_world_m at 7 ns", &begin);

        let position = Some(Vector3 { x: 0.0, y: 0.0, z: 0.0 });
        let pose = PoseInFrame {
            timestamp: None,
            frame_id: "world".into(),
            pose: Some(Pose { position, orientation: Some(rotation) }),
        };
        let mut data = Vec::new();
        pose.encode(&mut data).unwrap();
        let tip = read_pose_in_frame(message("foxglove.PoseInFrame", "protobuf", data)).unwrap();
        assert_says("pose in a frame", &tip.pose("m").unwrap_err().to_string(), "t_world_m at 7 ns", &begin);

        // Encapsulation; stamp, frame, child, padding to 8, translation, rotation.
        let mut cdr = vec![0, 1, 0, 0];
        cdr.extend([5_u32, 0, 6].iter().flat_map(|n| n.to_le_bytes()));
        cdr.extend(b"world\0\0\0");
        cdr.extend(2_u32.to_le_bytes());
        cdr.extend(b"m\0");
        while (cdr.len() - 4) % 8 != 0 {
            cdr.push(0);
        }
        cdr.extend([0.0, 0.0, 0.0, x, y, z, w].iter().flat_map(|n: &f64| n.to_le_bytes()));
        let read = read_transforms(message("geometry_msgs/msg/TransformStamped", "cdr", cdr)).unwrap();
        assert_says("CDR", &read[0].as_ref().unwrap_err().to_string(), "t_world_m at 5000000000 ns", &begin);
    }
}

#[test]
fn a_matrix_that_mirrors_scales_or_shears_is_refused_at_every_door_of_matrices() {
    for (matrix, value) in &MATRICES {
        let refusal = in_file(rows(matrix), |path| read_pose(path, 1.0).unwrap_err().to_string());
        assert_says("pose in JSON", &refusal, "matrix: ", value);
        let numbers = matrix.map(|n| format!("{n:?}")).join(" ");
        let itk = format!(
            "#Insight Transform File V1.0\nTransform: AffineTransform_double_3_3\nParameters: {numbers} 0 0 0\nFixedParameters: 0 0 0\n"
        );
        let refusal = in_file(itk, |path| read_pose(path, 1.0).unwrap_err().to_string());
        assert_says("ITK", &refusal, "matrix: ", value);
        let plan = format!("{{ \"planes\": {{ \"distal\": {} }} }}", rows(matrix));
        let refusal = parse_plan("plan.json".as_ref(), &plan).unwrap_err().to_string();
        assert_says("plan", &refusal, "key \"planes.distal\": ", value);
        let numbers = matrix.map(|n| format!("{n:?}")).join(", ");
        let markups = format!(
            r#"{{"markups": [{{"type": "ROI", "coordinateSystem": "LPS", "center": [0, 0, 0], "size": [1, 1, 1], "orientation": [{numbers}]}}]}}"#
        );
        let refusal = parse_picked_points("a.mrk.json".as_ref(), markups.as_bytes()).unwrap_err().to_string();
        assert_says("markups", &refusal, "markups[0].orientation: ", value);
        // Column by column.
        let [a, b, c, d, e, f, g, h, i] = matrix.map(|n| n as f32);
        let refusal = Affine([a, d, g, b, e, h, c, f, i, 0.0, 0.0, 0.0]).rigid().unwrap_err().to_string();
        assert_says("OpenIGTLink", &refusal, "", value);
    }
}

#[test]
fn a_versor_or_a_quaternion_of_nifti_that_is_too_long_is_refused() {
    let versor = "#Insight Transform File V1.0\nTransform: VersorRigid3DTransform_double_3_3\nParameters: 0.8 0.8 0 0 0 0\n\
                  FixedParameters: 0 0 0\n";
    let refusal = in_file(versor, |path| read_pose(path, 1.0).unwrap_err().to_string());
    assert_says("versor", &refusal, "Parameters: ", "the quaternion has length 1.13");

    let mut nifti = vec![0; 352];
    let mut put = |at: usize, bytes: &[u8]| nifti[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348_i32.to_le_bytes());
    [3_i16, 2, 2, 2].iter().enumerate().for_each(|(k, n)| put(40 + 2 * k, &n.to_le_bytes()));
    put(70, &4_i16.to_le_bytes());
    put(72, &16_i16.to_le_bytes());
    [1.0_f32; 4].iter().enumerate().for_each(|(k, n)| put(76 + 4 * k, &n.to_le_bytes()));
    put(108, &352.0_f32.to_le_bytes());
    put(123, &[2]);
    put(252, &1_i16.to_le_bytes());
    [0.8_f32, 0.8, 0.0].iter().enumerate().for_each(|(k, n)| put(256 + 4 * k, &n.to_le_bytes()));
    put(344, b"n+1\0");
    nifti.extend([0; 16]);
    let refusal = in_file(&nifti, |path| read_volume(path, None).unwrap_err().to_string());
    assert_says("NIfTI", &refusal, "quatern_b, quatern_c, quatern_d", "the quaternion has length 1.13");
    // An origin of another planet.
    nifti[256..268].fill(0);
    nifti[268..272].copy_from_slice(&1e30_f32.to_le_bytes());
    let refusal = in_file(&nifti, |path| read_volume(path, None).unwrap_err().to_string());
    assert_says(
        "NIfTI",
        &refusal,
        "geometry: voxel [0.0, 0.0, 0.0] is at (-1.0000000150474662e30",
        "farther than 1e7 mm",
    );
}

#[test]
fn quaternions_of_zero_and_nan_are_markers_that_were_not_seen() {
    let header = "t_ns,parent,child,x,y,z,qx,qy,qz,qw\n";
    let text = format!("{header}5,world,m,0,0,0,0,0,0,0\n6,world,m,0,0,0,nan,0,0,1\n");
    let read = in_file(text, |path| read_poses(path, 1.0).unwrap());
    let refusal: Vec<String> = read.log.poses.into_iter().map(|pose| pose.unwrap_err().to_string()).collect();
    assert!(refusal[0].contains("at 5 ns has an all-zero quaternion"), "{}", refusal[0]);
    assert!(refusal[1].contains("at 6 ns has a row without finite numbers"), "{}", refusal[1]);
}

#[test]
fn what_a_pose_or_a_header_gives_twice_is_refused() {
    let unit = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let refusal = |text: String| in_file(text, |path| read_pose(path, 1.0).unwrap_err().to_string());
    assert_says(
        "two poses",
        &refusal(format!("{{\"T\": {unit}, \"matrix\": {unit}}}")),
        "object: ",
        "the keys T and matrix",
    );
    assert_says("unit", &refusal(format!("{{\"T\": {unit}, \"unit\": \"m\"}}")), "key \"unit\": ", "found \"m\"");
    assert_says("twice", &refusal(format!("{{\"T\": {unit},\n\"T\": {unit}}}")), "line 2", "key \"T\" is given twice");
    let itk = "#Insight Transform File V1.0\nTransform: Euler3DTransform_double_3_3\nParameters: 0 0 0 0 0 0\nParameters: 1 0 0 0 0 0\n";
    assert_says("ITK", &refusal(itk.into()), "Parameters: ", "two lines");
    let fcsv = "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n# columns = id,x,y,z,x,label\na,1,2,3,4,P1\n";
    let refusal = parse_picked_points("a.fcsv".as_ref(), fcsv.as_bytes()).unwrap_err().to_string();
    assert_says("fcsv", &refusal, "line 3: ", "column 5 is called \"x\" as one before it is");
    let pcd = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nWIDTH 1\nDATA ascii\n0 0 0\n40 1 2\n";
    let refusal = osteoflow_formats::mesh_or_cloud::read_mesh_or_cloud("a.pcd".as_ref(), pcd.as_bytes(), 1.0, "ct");
    assert_says("PCD", &refusal.unwrap_err().to_string(), "line 6: ", "the header has a second line WIDTH");
}
