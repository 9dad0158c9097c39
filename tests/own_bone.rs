//! Simulation on a user's bone: left or right, coarse or fine, anywhere in the CT.

#[path = "../nodes/bone/simulation/tests/common/exact.rs"]
mod exact;

use crate::common::{data, is_slow_run, osteoflow, reproduce, run};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_formats::write::write_stl;
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};
use osteoflow_geometry::{Anatomy, Mesh};
use osteoflow_simulation::{BoneParams, CtParams, Procedure, ProcedureParams, bone, ct_surface};
use osteoflow_standard::own_bone;
use serde_json::json;
use std::{fs, path::Path, path::PathBuf};

/// Writes a bone and its anatomy under the bone's name, with another bone's beside it.
fn write(dir: &Path, bone: &Mesh, anatomy: &Anatomy) -> (PathBuf, PathBuf) {
    let (stl, plan) = (dir.join("my_fibula.stl"), dir.join("anatomy.json"));
    write_stl(&stl, bone).unwrap();
    let own = json!({
        "malleolus_tip": anatomy.malleolus_tip.coords.as_slice(), "proximal": anatomy.proximal.as_slice(),
        "lateral": anatomy.lateral.as_slice(), "posterior": anatomy.posterior.as_slice(),
    });
    fs::write(&plan, json!({ "another": {}, "my_fibula": own }).to_string()).unwrap();
    (stl, plan)
}

fn small() -> ProcedureParams {
    let mut params = ProcedureParams::default();
    params.camera.n_points = 2000;
    params
}

#[test]
fn the_built_in_bone_read_from_a_file_gives_the_built_in_procedure() {
    let dir = tempfile::tempdir().unwrap();
    let built_in = BoneParams::default();
    let (stl, plan) = write(dir.path(), &bone::fibula(&built_in), &bone::anatomy(&built_in));
    let subject = own_bone::read(&stl, &plan).unwrap();
    assert_eq!(subject.notes, Vec::<String>::new());
    let own = Procedure::simulate_for(&subject, &small(), 3).unwrap();
    let expected = Procedure::simulate(&small(), 3).unwrap();
    let rounding = "an STL holds 1000 mm to within 0.00006 mm";
    for (a, b) in own.plan.landmarks.points.iter().zip(expected.plan.landmarks.points.iter()) {
        let off = (a.position - b.position).norm();
        assert!(off < 1e-3, "{} is {off} mm off; {rounding}", a.name);
    }
    assert_eq!(own.scan.len(), expected.scan.len());
    for (a, b) in own.stylus_init.points.iter().zip(expected.stylus_init.points.iter()) {
        assert!((a.position - b.position).norm() < 1e-3, "{rounding}");
    }
}

#[test]
fn an_experiment_is_reproduced_on_a_bone_of_ones_own_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let (stl, plan) = write(dir.path(), &bone::fibula(&BoneParams::default()), &bone::anatomy(&BoneParams::default()));
    let out = dir.path().join("out");
    let name = "an_experiment_is_reproduced_on_a_bone_of_ones_own_as_it_is";
    let [stl, plan, folder] = [&stl, &plan, &out].map(|path| path.to_str().unwrap());
    let args = ["--only", "accuracy_stylus", "--quiet", "--bone", stl, "--plan", plan, "--out", folder];
    let Some((_, err, code)) = reproduce(name, &args) else { return };
    assert_eq!(code, 0, "{err}");
    let rows = fs::read_to_string(out.join("accuracy_stylus/runs.csv")).unwrap();
    assert_eq!(rows.matches(",complete,").count(), 10, "{rows}");
    let page = fs::read_to_string(out.join("paper-reproduction.md")).unwrap();
    assert!(page.contains("| 1 bone, 10 procedures |"), "{page}");
}

/// A variant of the built-in bone: mirrored (a left bone), rotated and far away.
fn another(params: &BoneParams, left: bool, motion: &Isometry3<f64>) -> (Mesh, Anatomy) {
    let (bone, anatomy) = (bone::fibula(params), bone::anatomy(params));
    let side = if left { -1.0 } else { 1.0 };
    let mirror = |v: &Vector3<f64>| Vector3::new(side * v.x, v.y, v.z);
    let point = |p: &Point3<f64>| motion * Point3::from(mirror(&p.coords));
    let direction = |d: &Unit<Vector3<f64>>| Unit::new_normalize(motion * mirror(d));
    let vertices: Vec<_> = bone.vertices().iter().map(point).collect();
    let mesh = Mesh::new("ct", bone.origin, vertices, bone.faces().to_vec()).unwrap();
    let anatomy = Anatomy {
        malleolus_tip: point(&anatomy.malleolus_tip),
        proximal: direction(&anatomy.proximal),
        lateral: direction(&anatomy.lateral),
        posterior: direction(&anatomy.posterior),
    };
    (mesh, anatomy)
}

#[test]
fn left_and_right_bones_coarse_and_fine_are_scanned_anywhere_in_the_ct() {
    let turn = UnitQuaternion::from_euler_angles(2.2, -0.4, 1.0);
    let far = Isometry3::from_parts(Vector3::new(900.0, -1500.0, 40.0).into(), turn);
    let identity = Isometry3::identity();
    let bones = [(true, 3.0, far), (false, 0.5, identity), (false, 3.0, far), (true, 0.5, identity)];
    for (left, edge_mm, motion) in bones.into_iter().take(if is_slow_run() { 4 } else { 2 }) {
        let dir = tempfile::tempdir().unwrap();
        let (mesh, anatomy) = another(&BoneParams { edge_mm, ..BoneParams::default() }, left, &motion);
        let (stl, plan) = write(dir.path(), &mesh, &anatomy);
        let subject = own_bone::read(&stl, &plan).unwrap();
        // A mirrored mesh is inside out.
        assert_eq!(subject.notes.len(), usize::from(left), "{:?}", subject.notes);
        let params = exact::without_errors(small());
        let own = Procedure::simulate_for(&subject, &params, 1).unwrap();
        let truth = &own.truth;
        let t_ct_camera = truth.t_world_ct_at_scan.isometry.inverse() * truth.t_world_camera_at_scan.isometry;
        let surface = MeshQuery::new(subject.bone());
        let off = |p: &Point3<f64>| surface.closest_point(p).unwrap().distance_mm;
        assert_eq!(own.scan.len(), 2000);
        assert!(own.scan.points().iter().all(|p| off(&(t_ct_camera * p)) < 1e-8));
        let ct = ct_surface(subject.bone(), &CtParams::default(), 1).unwrap();
        let mean = ct.vertices().iter().map(off).sum::<f64>() / ct.vertices().len() as f64;
        assert!(mean < 0.1, "left {left}, edges of {edge_mm} mm: the CT surface is {mean} mm off the bone");
    }
}

#[test]
fn a_bone_that_is_open_or_too_short_and_a_plan_without_anatomy_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let built_in = BoneParams::default();
    let (whole, anatomy) = (bone::fibula(&built_in), bone::anatomy(&built_in));
    let refusal = |mesh: &Mesh, anatomy: &Anatomy| {
        let (stl, plan) = write(dir.path(), mesh, anatomy);
        own_bone::read(&stl, &plan).err().unwrap().to_string()
    };
    let open = Mesh::new("ct", whole.origin, whole.vertices().to_vec(), whole.faces()[5..].to_vec()).unwrap();
    let words = refusal(&open, &anatomy);
    assert!(words.contains("edges of the bone's surface are open") && words.contains("close its holes"), "{words}");
    let stump = BoneParams { length_mm: 120.0, ..built_in };
    let words = refusal(&bone::fibula(&stump), &bone::anatomy(&stump));
    assert!(words.contains("P2 would lie 130 mm above the malleolus tip, where there is no bone"), "{words}");

    let (stl, plan) = write(dir.path(), &whole, &anatomy);
    fs::write(&plan, "{\"landmarks\": {}}").unwrap();
    let words = own_bone::read(&stl, &plan).err().unwrap().to_string();
    assert!(words.contains("the plan has no anatomy"), "{words}");
    for (node, given, lacks) in [
        ("recording", "bone_file", "plan_file"),
        ("plan", "plan_file", "bone_file"),
        ("bone", "bone_file", "plan_file"),
    ] {
        let file = if given == "bone_file" { &stl } else { &plan };
        let ran = run("graphs/fibula.toml", &["--set", &format!("{node}.{given}={}", file.display())]);
        let expected = format!("{given} is given, but {lacks} is not");
        assert!(ran.code != 0 && ran.stderr.contains(&expected), "{node}: {}", ran.stderr);
    }
    // What would change nothing.
    for node in ["recording", "plan", "bone"] {
        let of_node = |param: &str, file: &Path| format!("{node}.{param}={}", file.display());
        let (bone_file, plan_file) = (of_node("bone_file", &stl), of_node("plan_file", &plan));
        let sets = ["--set", &bone_file, "--set", &plan_file, "--set", &format!("{node}.bone.girth=1.1")];
        let ran = run("graphs/fibula.toml", &sets);
        let expected = "it shapes the built-in bone and changes nothing of bone_file";
        assert!(ran.code == 2 && ran.stderr.contains(expected), "{node}: {} {}", ran.code, ran.stderr);
    }
}

#[test]
fn the_measured_bones_go_through_the_whole_graph_and_through_simulate() {
    const NAME: &str = "the_measured_bones_go_through_the_whole_graph_and_through_simulate";
    let Some(anatomy) = data(NAME, "bones/anatomy.json") else { return };
    for name in ["TLEM2_CT_fibula_r", "MC22_fibula_r"] {
        let stl = anatomy.with_file_name(format!("{name}.stl"));
        let (stl, anatomy) = (stl.to_str().unwrap(), anatomy.to_str().unwrap());
        let mut arguments = vec!["--no-record".to_owned()];
        for node in ["recording", "plan", "bone"] {
            arguments.extend(["--set".into(), format!("{node}.bone_file={stl}")]);
            arguments.extend(["--set".into(), format!("{node}.plan_file={anatomy}")]);
        }
        let ran = run("graphs/fibula.toml", &arguments.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let mean = ran.results["metrics"]["tre_true_mm"]["mean_abs"]["norm"].as_f64().unwrap();
        assert!(mean < 1.5, "{name}: {mean} mm");

        let dir = tempfile::tempdir().unwrap();
        let simulate = ["simulate", "--points", "2000", "--bone", stl, "--plan", anatomy, "--out"];
        osteoflow().args(simulate).arg(dir.path()).assert().success();
        let readme = fs::read_to_string(dir.path().join("README.md")).unwrap();
        assert!(readme.contains(&format!("--bone {stl} --plan {anatomy}")) && !readme.contains("CC0"), "{readme}");
    }
    osteoflow().args(["simulate", "--bone", "b.stl", "--out", "x"]).assert().code(2);
}

#[test]
fn the_ct_of_the_other_leg_is_a_setting_of_plan_and_surface_alone() {
    let dir = tempfile::tempdir().unwrap();
    let (stl, plan) = write(dir.path(), &bone::fibula(&BoneParams::default()), &bone::anatomy(&BoneParams::default()));
    let mut sets = Vec::new();
    for node in ["recording", "plan", "bone"] {
        sets.push(format!("{node}.bone_file={}", stl.display()));
        sets.push(format!("{node}.plan_file={}", plan.display()));
    }
    let ran = |more: &[&str]| {
        let sets = sets.iter().map(String::as_str).chain(more.iter().copied());
        let arguments: Vec<&str> = sets.flat_map(|set| ["--set", set]).chain(["--no-record"]).collect();
        run("graphs/fibula.toml", &arguments)
    };
    let right = ran(&[]);
    let tre_mm = right.results["metrics"]["tre_true_mm"]["mean_abs"]["norm"].as_f64().unwrap();
    assert!(right.code == 0 && tre_mm < 1.0, "{tre_mm} mm with the right CT: {}", right.stderr);
    let other_leg = ran(&["plan.bone.mirrored=true", "bone.bone.mirrored=true"]);
    assert_eq!(
        (other_leg.code, &other_leg.results["verdict"]["answer"]),
        (3, &"refused".into()),
        "{}",
        other_leg.stderr
    );
}
