//! Reads files of other programs; each test is skipped if the development data is missing.

use crate::layouts::stamp;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};
use osteoflow_formats::{
    Space,
    mcap_read::{McapError, Recording},
    mesh_or_cloud::{read_cloud as read_cloud_file, read_mesh},
    message_read::{procedure_region, read_cloud, read_pose_in_frame, read_transforms},
    picked_points::read_picked_points,
    plan_file::{parse_plan, read_plan},
    pose_log::{LogFormat, LogOptions, read_log},
    write::{Precision, write_mesh},
};
use osteoflow_geometry::{StampNs, SurfaceOrigin};
use std::path::PathBuf;

fn data(test: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../shared/data");
    let folder = std::env::var_os("OSTEOFLOW_DATA").map_or_else(|| PathBuf::from(beside), PathBuf::from);
    if !folder.join("recordings").is_dir() {
        println!("skipped: {test}: no development data");
        return None;
    }
    Some(folder)
}

fn assert_near_mm(content: Point3<f64>, expected: [f64; 3], tolerance_mm: f64) {
    let off = (content - Point3::from(expected)).norm();
    assert!(off < tolerance_mm, "{content} is {off} mm from {expected:?}");
}

#[test]
fn the_development_procedure_holds_what_its_makers_reader_finds() {
    let Some(data) = data("the development procedure") else { return };
    let recording = Recording::open(&data.join("recordings/procedure_dev.mcap"), false).unwrap();
    assert_eq!(recording.notes, [""; 0]);
    let told: Vec<_> = recording.topics().iter().map(|t| (t.name.as_str(), t.n_messages)).collect();
    // Counted with the Python reader.
    let expected = [
        ("/tracker/camera_marker", 196),
        ("/tracker/phantom_marker", 37),
        ("/phantom/marker_cad", 1),
        ("/camera/calibration", 1),
        ("/tracker/bone_marker", 305),
        ("/camera/scan", 1),
        ("/camera/laser_p1", 1),
        ("/camera/laser_p2", 1),
        ("/camera/laser_p3", 1),
        ("/stylus/init", 3),
        ("/stylus/assessment", 5),
        ("/stylus/palpation", 300),
    ];
    assert_eq!(told, expected);
    assert_eq!(recording.metadata["procedure"]["seed"], "101");
    assert_eq!(procedure_region(&recording), Ok(None), "this one has no region of interest");

    let scan = read_cloud(&recording.messages("/camera/scan")[0]).unwrap();
    assert_eq!((scan.n_points_in_message, scan.n_dropped), (20_000, 0));
    assert_eq!((scan.cloud.frame.as_str(), scan.cloud.stamp_ns), ("camera", 1_750_000_011_000_000_000));
    // Expected coordinates in mm, read with NumPy.
    assert_near_mm(scan.cloud.points()[0], [46.89876362681389, -7.711812388151884, 203.04621756076813], 1e-9);
    assert_near_mm(scan.cloud.points()[19_999], [-47.094009816646576, 8.310537785291672, 203.66047322750092], 1e-9);
    let mean: Vector3<f64> = scan.cloud.points().iter().map(|p| p.coords / 20_000.0).sum();
    assert_near_mm(mean.into(), [0.8560085763070674, 0.08707344985632517, 201.90751578360795], 1e-9);
    assert_eq!(read_cloud(&recording.messages("/camera/calibration")[0]).unwrap().cloud.len(), 13_145);

    let marker = read_transforms(&recording.messages("/tracker/camera_marker")[0]).unwrap().remove(0).unwrap().value;
    assert_eq!((marker.to.as_str(), marker.from.as_str()), ("world", "camera_marker"));
    assert_eq!(marker.stamp_ns, 1_749_999_999_999_859_810, "the sensor's time, not the log's");
    assert_near_mm(
        marker.isometry.translation.vector.into(),
        [181.8333427100312, -101.3576519870127, 1070.6068945087468],
        1e-9,
    );
    assert!((marker.isometry.rotation.j - 0.758_390_895_790_972_4).abs() < 1e-12);
    let init = read_pose_in_frame(&recording.messages("/stylus/init")[0]).unwrap();
    assert_near_mm(init.position, [-19.108219689991084, 5.310590812428581, 1223.6622743332525], 1e-9);
    assert_eq!(init.frame.as_str(), "world");
    for topic in recording.topics() {
        let stamps: Vec<StampNs> = recording.messages(&topic.name).iter().map(stamp).collect();
        assert!(stamps.is_sorted(), "{} is not in order of sensor time", topic.name);
    }
}

#[test]
fn the_plan_is_the_same_in_its_file_and_in_the_recording() {
    let Some(data) = data("the plan") else { return };
    let path = data.join("recordings/procedure_dev.plan.json");
    let plan = read_plan(&path).unwrap().plan;
    let recording = Recording::open(&data.join("recordings/procedure_dev.mcap"), false).unwrap();
    let attached = std::str::from_utf8(&recording.attachment("plan.json").unwrap().data).unwrap();
    assert_eq!(parse_plan(&path, attached).unwrap().plan, plan);
    let names: Vec<&str> = plan.landmarks.points.iter().map(|p| &*p.name).collect();
    assert_eq!(names, ["P1", "P2", "P3"]);
    assert_eq!(plan.assessment.points.len(), 5);
    let planes: Vec<&str> = plan.planes.planes.iter().map(|p| &*p.name).collect();
    assert_eq!(planes, ["plane_1", "plane_2"]);
    assert_near_mm(
        plan.landmarks.points[0].position,
        [-86.03160917042067, -84.71615113435571, -954.6846277336338],
        1e-12,
    );
    let cad = read_transforms(&recording.messages("/phantom/marker_cad")[0]).unwrap().remove(0).unwrap().value;
    let off = cad.isometry.inverse() * plan.t_phantom_phantom_marker.unwrap().isometry;
    assert!(
        off.translation.vector.norm() + off.rotation.angle() < 1e-9,
        "the plan and the recording agree on the phantom"
    );
    assert!(plan.anatomy.is_some() && plan.axes.is_some() && plan.t_camera_camera_marker_nominal.is_some());
}

#[test]
fn damaged_files_give_their_named_errors() {
    let Some(data) = data("damaged files") else { return };
    let open = |name: &str, allow_truncated| Recording::open(&data.join("mcap").join(name), allow_truncated);
    for (name, allow_truncated, reason) in [
        ("bad_empty.mcap", false, "the file is empty"),
        ("bad_empty.mcap", true, "the file is empty"),
        ("bad_wrong_magic.mcap", false, "byte 0: an MCAP begins with"),
    ] {
        let message = open(name, allow_truncated).unwrap_err().to_string();
        assert!(message.contains(reason), "{message}");
    }
    let cut = open("bad_truncated_60pct.mcap", false).unwrap_err();
    assert!(matches!(cut, McapError::Truncated { .. }), "{cut}");
    let part = open("bad_truncated_60pct.mcap", true).unwrap();
    assert_eq!(part.notes.len(), 1, "{:?}", part.notes);
    assert!(part.topics().iter().map(|t| t.n_messages).sum::<usize>() > 0);
    for topic in part.topics() {
        for message in part.messages(&topic.name) {
            stamp(message);
        }
    }
}

#[test]
fn ros_recordings_list_their_topics_and_say_what_they_carry() {
    let Some(data) = data("ROS recordings") else { return };
    for name in ["rosbag2_talker.mcap", "rosbag2_topics_and_services.mcap"] {
        let recording = Recording::open(&data.join("mcap").join(name), false).unwrap();
        assert!(!recording.topics().is_empty(), "{name}");
        for topic in recording.topics() {
            assert_eq!(topic.message_encoding, "cdr", "{name} {}", topic.name);
            assert_eq!(recording.messages(&topic.name).len(), topic.n_messages);
        }
        let busy = recording.topics().iter().find(|t| t.n_messages > 0).unwrap();
        let refusal = read_cloud(&recording.messages(&busy.name)[0]).unwrap_err().to_string();
        assert!(refusal.contains("of Foxglove or ROS 2 is needed here, but the topic carries "), "{refusal}");
    }
}

#[test]
fn bones_are_closed_surfaces_of_their_size() {
    let Some(data) = data("bones") else { return };
    // Number of faces and diagonal of the bounding box in mm, computed with NumPy.
    for (name, n_faces, span_mm) in [
        ("MC22_fibula_r.stl", 8080, 362.3798813970505),
        ("TLEM2_CT_fibula_r.stl", 31902, 339.7359521506569),
        ("calibration_phantom.stl", 60, 129.9038105676658),
        ("myosim_fibula_r.stl", 240, 366.49349138600957),
        ("myosim_jaw.stl", 2916, 156.29360789010693),
    ] {
        let read = read_mesh(&data.join("bones").join(name), 1.0, "ct", SurfaceOrigin::User).unwrap();
        let mesh = &read.mesh;
        assert_eq!(mesh.faces().len() + read.n_degenerate, n_faces, "{name}");
        assert_eq!(read.notes.len(), usize::from(read.n_degenerate > 0), "{name}: {:?}", read.notes);
        let (min, max) =
            mesh.vertices().iter().fold((mesh.vertices()[0], mesh.vertices()[0]), |(a, b), v| (a.inf(v), b.sup(v)));
        assert!(((max - min).norm() - span_mm).abs() < 1e-3, "{name}: {} mm", (max - min).norm());
        // With merged corners the surface is closed: vertices - edges + faces = 2, and each face has three half edges.
        if read.n_degenerate == 0 && name != "myosim_jaw.stl" {
            assert_eq!(mesh.vertices().len() as i64 - mesh.faces().len() as i64 / 2, 2, "{name}");
        }
        // If read as metres, the file gets a note that the unit is doubtful.
        let metres = read_mesh(&data.join("bones").join(name), 0.001, "ct", SurfaceOrigin::User).unwrap();
        assert!(metres.notes.iter().any(|n| n.contains("unit_mm = 1000")), "{name}: {:?}", metres.notes);
    }
}

#[test]
fn a_scanner_cloud_reads_in_metres() {
    let Some(data) = data("a scanner cloud") else { return };
    let read = read_cloud_file(&data.join("scans/small_gicp_source.ply"), 1000.0, "sensor").unwrap();
    assert_eq!((read.n_points_in_file, read.n_dropped), (69_792, 0));
    assert_near_mm(read.cloud.points()[0], [4.045109264552593, 2575.1945972442627, -1527.2173881530762], 1e-6);
}

/// The first and last points of the clouds, mm.
const BUN0: [[f64; 3]; 2] = [[5.4216, 113.49, 40.748999], [-77.930003, 175.16001, -44.399999]];
const BUN4: [[f64; 3]; 2] = [[53.026, 113.49, 77.131], [-46.917, 80.411, 22.365]];
const MILK: [[f64; 3]; 2] = [[-131.607607, -209.5429, 772.000015], [13.80667, -188.206702, 763.000011]];

#[test]
fn clouds_of_pcl_read_in_all_encodings() {
    let Some(data) = data("clouds of PCL") else { return };
    // Number of points, the first and the last, computed with NumPy and an LZF decoder of Python.
    for (name, n, first, last) in [
        ("pcl_bun0.pcd", 397, BUN0[0], BUN0[1]),
        ("pcl_bun4.pcd", 361, BUN4[0], BUN4[1]),
        ("pcl_milk.pcd", 13_704, MILK[0], MILK[1]),
    ] {
        let read = read_cloud_file(&data.join("scans").join(name), 1000.0, "sensor").unwrap();
        // PCL has padded the compressed one with 3913 zeros, which are nothing to tell.
        assert_eq!((read.n_points_in_file, read.n_dropped, read.notes), (n, 0, vec![]), "{name}");
        assert_near_mm(read.cloud.points()[0], first, 1e-3);
        assert_near_mm(read.cloud.points()[n - 1], last, 1e-3);
        assert_eq!(read.cloud.normals().is_some(), name == "pcl_bun0.pcd");
        assert_eq!(read.cloud.extras().len(), usize::from(name == "pcl_bun0.pcd"), "curvature");
    }
}

#[test]
fn images_and_markups_are_refused_by_name() {
    let Some(data) = data("images and markups") else { return };
    for (name, expected) in [
        ("medical/nibabel_anatomical.nii", "it holds a CT (NIfTI), and a surface or a cloud is needed"),
        ("medical/pydicom_CT_small.dcm", "it holds a CT (DICOM), and a surface or a cloud is needed"),
        ("medical/tlem2r_distal_ct.nii.gz", "it holds a CT (NIfTI), and a surface or a cloud is needed"),
        ("recordings/procedure_dev.mcap", "it holds a recording (MCAP), and a surface or a cloud is needed"),
        ("markups/tlem2r_plan_LPS.mrk.json", "it holds picked points (markups of 3D Slicer), and a surface"),
        ("markups/tlem2r_plan_RAS.fcsv", "it holds picked points (fiducials of 3D Slicer), and a surface"),
        ("markups/tlem2r_plan.pp", "it holds picked points (a list of MeshLab), and a surface"),
        ("mcap/bad_empty.mcap", "the file is empty"),
    ] {
        let refusal = read_cloud_file(&data.join(name), 1.0, "ct").unwrap_err().to_string();
        assert!(refusal.contains(expected), "{refusal}");
    }
}

#[test]
fn markups_of_every_program_give_the_same_points() {
    let Some(data) = data("markups") else { return };
    let plan = read_plan(&data.join("recordings/procedure_dev.plan.json")).unwrap().plan;
    let expected: Vec<_> = plan.landmarks.points.iter().chain(&*plan.assessment.points).cloned().collect();
    assert_eq!(expected.len(), 8);
    for (name, space, n_skipped) in [
        ("tlem2r_plan_LPS.mrk.json", Space::Lps, 0),
        ("tlem2r_plan_RAS.mrk.json", Space::Ras, 0),
        ("tlem2r_plan_LPS.fcsv", Space::Lps, 0),
        ("tlem2r_plan_RAS.fcsv", Space::Ras, 0),
        ("tlem2r_plan_cc_picking_list.txt", Space::Unknown, 0),
        ("tlem2r_plan.pp", Space::Unknown, 1),
    ] {
        let content = read_picked_points(&data.join("markups").join(name)).unwrap();
        assert_eq!((content.space, content.n_skipped, content.is_named), (space, n_skipped, true), "{name}");
        let n_notes = usize::from(space == Space::Ras) + usize::from(n_skipped > 0);
        assert_eq!(content.notes.len(), n_notes, "{name}: {:?}", content.notes);
        assert_eq!(content.points.len(), 8 - n_skipped, "{name}");
        // MeshLab's file has five digits behind the point.
        let tolerance_mm = if name.ends_with(".pp") { 1e-5 } else { 1e-6 };
        for (point, expected) in content.points.iter().zip(&expected) {
            assert_eq!(point.name, expected.name, "{name}");
            assert_near_mm(point.position, expected.position.coords.into(), tolerance_mm);
        }
    }
}

#[test]
fn a_bone_survives_being_written_in_every_format_and_space() {
    let Some(data) = data("a bone") else { return };
    let bone = read_mesh(&data.join("bones/MC22_fibula_r.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
    let dir = tempfile::tempdir().unwrap();
    for ending in ["ply", "stl", "obj"] {
        for space in [Space::Lps, Space::Ras, Space::Unknown] {
            let path = dir.path().join(format!("bone.{ending}"));
            write_mesh(&path, &bone, space, Precision::Double).unwrap();
            let back = read_mesh(&path, 1.0, "ct", SurfaceOrigin::User).unwrap();
            assert_eq!((back.space, back.mesh.faces().len()), (space, bone.faces().len()), "{ending}");
            for face in 0..bone.faces().len() {
                assert_eq!(back.mesh.corners(face), bone.corners(face), "{ending} {space}: face {face}");
            }
        }
    }
}

#[test]
fn tracked_sequences_of_plus_hold_the_poses_that_are_in_their_headers() {
    let Some(data) = data("tracked sequences of PLUS") else { return };
    let folder = data.join("real/plus");
    if !folder.is_dir() {
        return println!("skipped: tracked sequences of PLUS: no {}", folder.display());
    }
    let read = |name: &str| read_log(&folder.join(name), &LogOptions::default()).unwrap();
    // Frames, transforms in each, and the first stamp, ns.
    for (name, n_frames, n_transforms, first_ns) in [
        ("EightLandmarkPointsTrackedForPhantomRegistration.igs.mha", 1000, 2, 280_461_142_857),
        ("ReferenceToRASCalibration.igs.mha", 93, 2, 196_720_814_286),
        ("TimestampFilteringTest.igs.mha", 500, 1, 1_840_749_750_288_000),
    ] {
        let log = read(name);
        assert_eq!((log.format, log.poses.len()), (LogFormat::IgsMha, n_frames * n_transforms), "{name}");
        assert!(log.poses.iter().all(Result::is_ok), "{name}: every status is OK");
        assert_eq!(log.poses[0].as_ref().unwrap().value.stamp_ns, first_ns, "{name}");
    }
    let log = read("EightLandmarkPointsTrackedForPhantomRegistration.igs.mha");
    let stylus = &log.poses[1].as_ref().unwrap().value;
    assert_eq!((stylus.to.as_str(), stylus.from.as_str()), ("Tracker", "Stylus"));
    // The first row of the matrix is 0.68393 0.36068 -0.63430 315.553.
    let corner = stylus.isometry * Point3::new(100.0, 0.0, 0.0);
    // The matrices of this log are 3.6e-4 from a rotation, which is 0.036 mm at 100 mm.
    assert!((corner.x - (68.39311099507384 + 315.55283203125)).abs() < 0.036, "{corner}");
    // The stylus turns about its tip at several places: in its own frame the tip is one point, which it is not if the sense were inverse.
    let stylus: Vec<_> =
        log.poses.iter().skip(1).step_by(2).map(|pose| pose.as_ref().unwrap().value.isometry).collect();
    let pivot = |start: usize| {
        let (mut a, mut b) = (DMatrix::<f64>::zeros(3 * 75, 6), DVector::<f64>::zeros(3 * 75));
        for (k, pose) in stylus[start..start + 75].iter().enumerate() {
            a.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(pose.rotation.to_rotation_matrix().matrix());
            a.fixed_view_mut::<3, 3>(3 * k, 3).copy_from(&-Matrix3::identity());
            b.fixed_rows_mut::<3>(3 * k).copy_from(&-pose.translation.vector);
        }
        let x = a.svd(true, true).solve(&b, 1e-9).unwrap();
        (Vector3::new(x[0], x[1], x[2]), Vector3::new(x[3], x[4], x[5]))
    };
    let ((tip, place), (other_tip, other_place)) = (pivot(380), pivot(840));
    assert!((tip - other_tip).norm() < 2.0, "{tip} and {other_tip}: poses of 0.5 mm RMS");
    assert!((place - other_place).norm() > 20.0, "{place} and {other_place}");
}
