//! Files for other programs from a run: what they hold, and that a refused run writes none of what is wrong.

use crate::common::{osteoflow, run_whole};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_formats::{
    Space,
    mesh_or_cloud::{read_cloud, read_mesh},
    picked_points::read_picked_points,
    plan_file::{plan_json, read_plan},
    pose_file::read_pose,
    write::{Precision, write_mesh},
};
use osteoflow_geometry::{SurfaceOrigin, isometry_from_matrix, nalgebra::Matrix4};
use serde_json::Value;
use std::{fs, path::Path};

const GRAPH: &str = "graphs/variants/fibula_export.toml";

#[test]
fn the_exported_files_lie_on_each_other_in_lps_and_hold_what_the_results_say() {
    let ran = run_whole(GRAPH, &["--no-record"]);
    let at = |name: &str| ran.dir.path().join(name);
    let bone = read_mesh(&at("export_bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap();
    let scan = read_cloud(&at("export_scan.ply"), 1.0, "ct").unwrap();
    assert_eq!((bone.space, scan.space), (Space::Lps, Space::Lps));
    let surface = MeshQuery::new(&bone.mesh);
    let mut off: Vec<f64> = scan.cloud.points().iter().map(|p| surface.closest_point(p).unwrap().distance_mm).collect();
    off.sort_by(f64::total_cmp);
    let median_mm = off[off.len() / 2];
    assert!(median_mm < 0.1, "{median_mm} mm from the bone in the median");

    let landmarks = read_picked_points(&at("export_landmarks.mrk.json")).unwrap();
    let names: Vec<&str> = landmarks.points.iter().map(|p| &*p.name).collect();
    assert_eq!((landmarks.space, &names[..]), (Space::Lps, &["P1", "P2", "P3"][..]));
    let lowest_mm = landmarks.points.iter().map(|p| surface.closest_point(&p.position).unwrap().distance_mm);
    assert!(lowest_mm.fold(0.0, f64::max) < 1.0, "landmarks lie on the bone");

    let planes = read_picked_points(&at("export_planes.mrk.json")).unwrap().planes;
    let text = fs::read_to_string(at("export_planes.mrk.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(planes.len(), 2);
    for (plane, markup) in planes.iter().zip(json["markups"].as_array().unwrap()) {
        // The matrix, the normal and the control point say the same.
        let numbers: Vec<f64> = markup["baseToNode"].as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).collect();
        let pose = isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap();
        let read = plane.isometry().unwrap();
        assert!((pose.translation.vector - read.translation.vector).norm() < 1e-9);
        let axis = pose.rotation.to_rotation_matrix().matrix().column(2).into_owned();
        assert!((axis - plane.normal().unwrap()).norm() < 1e-9);
        assert_eq!(markup["controlPoints"][0]["position"], markup["center"]);
    }
    let transform = read_pose(&at("export_transform.tfm"), 1.0).unwrap().isometry;
    assert!(fs::read_to_string(at("export_transform.tfm")).unwrap().contains("moves frame bone_marker to frame ct"));
    let simple = transform.to_homogeneous();
    assert!(simple.iter().all(|c| c.is_finite()) && transform.translation.vector.norm() > 1.0, "{simple}");
}

#[test]
fn other_programs_read_the_folder_export_of_every_graph_with_a_ct_to_a_ten_thousandth_of_a_millimetre() {
    for graph in ["graphs/fibula.toml", "graphs/fibula_folder.toml", "graphs/variants/fibula_modules.toml"] {
        let dir = tempfile::tempdir().unwrap();
        let wires = r#"record.wires=["to_bone.cloud", "icp.*"]"#;
        let output = osteoflow().args(["run", graph, "--set", wires, "--out"]).arg(dir.path()).output().unwrap();
        assert!(output.status.success(), "{graph}: {}", String::from_utf8_lossy(&output.stderr));
        let files = ["bone.stl", "scan.ply", "scan.vtk", "scan_to_ct.tfm", "landmarks.mrk.json", "planes.mrk.json"];
        for file in files {
            let bytes = fs::read(dir.path().join("export").join(file)).unwrap();
            let notice = b"research use only";
            assert!(bytes.windows(notice.len()).any(|part| part == notice), "{graph}: {file} is not marked");
        }
        let python = std::env::var("OSTEOFLOW_PYTHON").unwrap_or_else(|_| "python3".into());
        let script = crate::common::root().join("tests/python/check_export.py");
        let checked = match std::process::Command::new(&python).arg(script).arg(dir.path()).output() {
            Ok(checked) => checked,
            Err(error) => return eprintln!("skipped: export read by other programs: {python}: {error}"),
        };
        let said = String::from_utf8_lossy(&checked.stdout).into_owned();
        if checked.status.code() == Some(2) {
            return eprintln!("skipped: export read by other programs: {python}: {}", said.trim());
        }
        assert!(checked.status.success(), "{graph}: {said}{}", String::from_utf8_lossy(&checked.stderr));
        // The script sees a scan that lies elsewhere.
        let scan = dir.path().join("export/scan.vtk");
        let mut bytes = fs::read(&scan).unwrap();
        let first = bytes.windows(7).position(|part| part == b"double\n").unwrap() + 7;
        let moved = f64::from_be_bytes(bytes[first..first + 8].try_into().unwrap()) + 2e-4;
        bytes[first..first + 8].copy_from_slice(&moved.to_be_bytes());
        fs::write(&scan, bytes).unwrap();
        let checked = std::process::Command::new(&python)
            .arg(crate::common::root().join("tests/python/check_export.py"))
            .arg(dir.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&checked.stdout).into_owned();
        assert!(checked.status.code() == Some(1) && said.ends_with("wrong: scan.vtk (vtk)\n"), "{said}");
    }
}

#[test]
fn two_files_are_exported_without_a_plan_and_without_a_fit_only_the_bone() {
    let ran = run_whole("graphs/two_files.toml", &[]);
    let export = ran.dir.path().join("export");
    let mut names: Vec<_> =
        fs::read_dir(&export).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["bone.stl", "scan.ply", "scan.vtk", "scan_to_ct.tfm"]);

    let ran = crate::common::run("graphs/fibula.toml", &["--no-record", "--set", "icp.max_pair_distance_mm=0.000001"]);
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let export = ran.dir.path().join("export");
    assert!(["bone.stl", "landmarks.mrk.json", "planes.mrk.json"].iter().all(|name| export.join(name).exists()));
    assert!(!["scan.ply", "scan.vtk", "scan_to_ct.tfm"].iter().any(|name| export.join(name).exists()));
}

#[test]
fn a_refused_registration_leaves_no_scan_and_no_transform() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    // So strict that noise alone is refused.
    let strict = ["--set", "verdict.rules.max_inward_misfit_mm=0"];
    let output = osteoflow().args(["run", GRAPH, "--no-record", "--out"]).arg(&out).args(strict).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    for name in ["export_scan.ply", "export_transform.tfm"] {
        assert!(!out.join(name).exists(), "{name}");
    }
    let whole = dir.path().join("whole");
    let refused =
        osteoflow().args(["run", "graphs/fibula.toml", "--no-record", "--out"]).arg(&whole).args(strict).output();
    assert_eq!(refused.unwrap().status.code(), Some(3));
    assert!(whole.join("export/bone.stl").exists());
    for name in ["scan.ply", "scan.vtk", "scan_to_ct.tfm"] {
        assert!(!whole.join("export").join(name).exists(), "{name}");
    }
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(stderr.contains("nothing is written, since the verdict is refused"), "{stderr}");
}

#[test]
fn what_is_not_in_the_ct_is_not_written_as_if_it_were() {
    for (set, name) in [
        (r#"export_transform.in.pose="calibration.t_camera_camera_marker""#, "export_transform.tfm"),
        (r#"export_landmarks.in.points="recording.stylus_assessment""#, "export_landmarks.mrk.json"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("run");
        let output = osteoflow().args(["run", GRAPH, "--no-record", "--set", set, "--out"]).arg(&out).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(stderr.contains("and the file is LPS, as only ct is"), "{set}: {stderr}");
        assert!(!out.join(name).exists(), "{name}");
    }
}

#[test]
fn a_plan_that_is_written_and_read_has_no_unread_keys() {
    let plan = read_plan(&crate::common::root().join("tests/data/procedure/plan.json")).unwrap();
    assert_eq!(plan.notes, [""; 0]);
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("plan.json");
    fs::write(&file, plan_json(&plan.plan).to_string()).unwrap();
    assert_eq!(read_plan(&file).unwrap().notes, [""; 0]);
}

#[test]
fn a_surface_that_states_no_space_is_told_and_turned_where_the_graph_says_ras() {
    let dir = tempfile::tempdir().unwrap();
    let stated = read_mesh("tests/data/folder/bone.stl".as_ref(), 1.0, "ct", SurfaceOrigin::User).unwrap();
    let write = |name: &str, space: Space, says: bool| {
        let path = dir.path().join(name);
        write_mesh(&path, &stated.mesh, space, Precision::Double).unwrap();
        if !says {
            let mut bytes = fs::read(&path).unwrap();
            bytes[..80].fill(0);
            fs::write(&path, bytes).unwrap();
        }
        path
    };
    let exported = |path: &Path, space: &str| {
        let graph = dir.path().join("graph.toml");
        let text = format!(
            "[graph]\nformat = 1\n[node.bone]\nkind = \"surface.file\"\npath = {path:?}\n{space}\n[node.export]\nkind = \
             \"output.export\"\nin = {{ bone = \"bone.mesh\" }}\n"
        );
        fs::write(&graph, text).unwrap();
        let out = tempfile::tempdir_in(dir.path()).unwrap().path().join("out");
        let output = osteoflow().arg("run").arg(&graph).arg("--out").arg(&out).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        let mesh = read_mesh(&out.join("export/bone.stl"), 1.0, "ct", SurfaceOrigin::User).ok().map(|read| read.mesh);
        (output.status.code(), mesh, said)
    };
    let note = "the file states no space: its numbers are taken for LPS, as 3D Slicer takes them; set space";
    for (name, space, says, option, is_told) in [
        ("lps.stl", Space::Lps, true, "", false),
        ("ras.stl", Space::Ras, true, "", false),
        ("ras.stl", Space::Ras, true, "space = \"RAS\"", false),
        ("silent.stl", Space::Lps, false, "", true),
        ("silent.stl", Space::Lps, false, "space = \"LPS\"", false),
        ("silent_ras.stl", Space::Ras, false, "space = \"RAS\"", false),
    ] {
        let (code, mesh, said) = exported(&write(name, space, says), option);
        assert_eq!((code, said.contains(note)), (Some(0), is_told), "{name} {option}: {said}");
        let mesh = mesh.unwrap();
        assert_eq!(mesh.vertices(), stated.mesh.vertices(), "{name} {option}");
        assert_eq!(mesh.volume_mm3(), stated.mesh.volume_mm3(), "{name} {option}: turned, not mirrored");
    }
    let (code, mesh, said) = exported(&write("ras.stl", Space::Ras, true), "space = \"LPS\"");
    assert_eq!((code, mesh), (Some(3), None));
    assert!(said.contains("the file states SPACE=RAS, but space = \"LPS\"; leave space out"), "{said}");
}

#[test]
fn clouds_are_written_for_programs_that_know_floats_alone_with_colours_and_distances_and_doubles_are_told() {
    let ran = run_whole("graphs/fibula.toml", &["--no-record"]);
    let scan = ran.dir.path().join("export/scan.ply");
    let head = |path: &Path| String::from_utf8_lossy(&fs::read(path).unwrap()[..600]).into_owned();
    let text = head(&scan);
    for property in ["float x", "float z", "uchar red", "uchar blue", "float scalar_distance_mm"] {
        assert!(text.contains(&format!("property {property}\n")), "{property}: {text}");
    }
    let cloud = read_cloud(&scan, 1.0, "ct").unwrap().cloud;
    let bone = read_mesh(&ran.dir.path().join("export/bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
    let surface = MeshQuery::new(&bone);
    let column = |name: &str| cloud.extras().iter().find(|(other, _)| &**other == name).unwrap().1.clone();
    let (distances, red, blue) = (column("scalar_distance_mm"), column("red"), column("blue"));
    let on_bone = column("on_bone");
    let [from_mm, to_mm] = [0, 1].map(|end| ran.results["icp"]["inliers_mm"][end].as_f64().unwrap());
    assert!(on_bone.contains(&1.0) && to_mm < 2.0, "inliers from {from_mm} to {to_mm} mm");
    for (k, point) in cloud.points().iter().enumerate() {
        let off = (surface.closest_point(point).unwrap().distance_mm - distances[k].abs()).abs();
        assert!(off < 1e-4, "point {k}: its distance is {off} mm off");
        // Ends of the range are rounded to single precision.
        let at_end = (distances[k] - from_mm).abs().min((distances[k] - to_mm).abs()) < 1e-5;
        assert!(at_end || (on_bone[k] == 1.0) == (from_mm..=to_mm).contains(&distances[k]), "point {k}");
        assert!(distances[k].abs() < 0.1 || (distances[k] > 0.0) == (red[k] > blue[k]), "outside is orange: {k}");
    }
    let converted = |name: &str, options: &[&str]| {
        let out = ran.dir.path().join(name);
        let output = osteoflow().arg("convert").args([&scan, &out]).args(options).output().unwrap();
        assert!(output.status.success());
        (head(&out), String::from_utf8(output.stderr).unwrap())
    };
    let (text, said) = converted("scan.pcd", &[]);
    assert!(
        text.contains("FIELDS x y z scalar_distance_mm on_bone rgb\nSIZE 4 4 4 4 4 4\n") && said.is_empty(),
        "{text}{said}"
    );
    let (text, said) = converted("double.pcd", &["--double"]);
    assert!(text.contains("SIZE 8 8 8 8 8 4\n"), "{text}");
    assert!(
        said.contains("the coordinates are doubles, as requested; PCL and Open3D read zeros from such a PCD"),
        "{said}"
    );
    let output = osteoflow().args(["convert", "NOSUCH", "out.stl", "--iso-hu", "300"]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("NOSUCH") && !said.contains("is for a CT"), "{said}");
    let output = osteoflow().arg("convert").arg(&scan).args(["out.stl", "--iso-hu", "300"]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("--iso-hu is for a CT, and this file holds a cloud of points; leave it out"), "{said}");
}
