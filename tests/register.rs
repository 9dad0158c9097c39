//! `osteoflow register`: two files, one registration.

use crate::common::{self, is_slow_run, osteoflow};
use osteoflow_algorithms::sample;
use osteoflow_formats::{
    Space,
    mesh_or_cloud::{read_cloud, read_mesh},
    picked_points::write_mrk_json,
    pose_file::read_pose,
    write::{KEPT, write_ply, write_stl},
};
use osteoflow_geometry::{
    Cloud, Mesh, NamedPoint, SurfaceOrigin, isometry_from_matrix, matrix_rows,
    nalgebra::{Isometry3, Matrix4, Point3, Vector3, Vector4},
};
use osteoflow_simulation::{BoneParams, bone};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng as _, SeedableRng},
};
use serde_json::Value;
use std::{fmt::Write as _, fs, process::Output, sync::LazyLock};

/// Points drawn from the bone as the target, where a file holds points.
const N_TARGET: usize = 30_000;

/// The built-in bone and a scan of its distal half from the lateral side, as files; where the scan really is, and a
/// start some millimetres and degrees off.
struct Case {
    dir: tempfile::TempDir,
    t_target_source: Isometry3<f64>,
    init: Isometry3<f64>,
    scan: Vec<Point3<f64>>,
}

impl Case {
    /// A copy of the files, which are made once.
    fn new() -> Self {
        static MADE: LazyLock<Case> = LazyLock::new(Case::made);
        let dir = tempfile::tempdir().unwrap();
        for entry in fs::read_dir(MADE.dir.path()).unwrap().map(Result::unwrap) {
            fs::copy(entry.path(), dir.path().join(entry.file_name())).unwrap();
        }
        Self { dir, t_target_source: MADE.t_target_source, init: MADE.init, scan: MADE.scan.clone() }
    }

    fn made() -> Self {
        let dir = tempfile::tempdir_in(common::shared_folder()).unwrap();
        let params = BoneParams::default();
        let (mesh, anatomy) = (bone::fibula(&params), bone::anatomy(&params));
        write_stl(&dir.path().join("bone.stl"), &mesh).unwrap();
        fs::write(dir.path().join("bone.ply"), ply_of(&mesh)).unwrap();

        let target = sample::surface(&mesh, N_TARGET, &mut ChaCha8Rng::seed_from_u64(1));
        let bare = Cloud::new("ct", target.points).unwrap();
        write_ply(&dir.path().join("bare.ply"), &bare, 1.0).unwrap();
        let with_normals = bare.with_normals(target.normals).unwrap();
        write_ply(&dir.path().join("points.ply"), &with_normals, 1.0).unwrap();

        let t_target_source = Isometry3::new(Vector3::new(120.0, -340.0, 900.0), Vector3::new(0.4, -1.1, 2.0));
        let seen = sample::surface(&mesh, 24_000, &mut ChaCha8Rng::seed_from_u64(2));
        let scan = seen.points.iter().zip(&seen.normals).filter(|(p, n)| {
            let height_mm = (**p - anatomy.malleolus_tip).dot(&anatomy.proximal);
            (0.0..150.0).contains(&height_mm) && n.dot(&anatomy.lateral) > 0.2
        });
        let scan: Vec<_> = scan.map(|(p, _)| t_target_source.inverse() * p).collect();
        let scan = Cloud::new("camera", scan).unwrap();
        write_ply(&dir.path().join("scan.ply"), &scan, 1.0).unwrap();
        let mut text = String::from("x,y,z\n");
        scan.points().iter().for_each(|p| writeln!(text, "{:?},{:?},{:?}", p.x, p.y, p.z).unwrap());
        fs::write(dir.path().join("scan.csv"), text).unwrap();
        write_ply(&dir.path().join("scan_in_metres.ply"), &scan, 1000.0).unwrap();

        let centre = t_target_source * Point3::from(mean(scan.points()));
        let off = Isometry3::new(Vector3::new(1.5, -1.0, 2.0), Vector3::new(0.01, -0.02, 0.03));
        let init = Isometry3::from(centre.coords) * off * Isometry3::from(-centre.coords) * t_target_source;
        let case = Self { dir, t_target_source, init, scan: scan.points().to_vec() };
        case.write("init.txt", &text_of(&init));
        case
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    /// `osteoflow register` in the folder of the files.
    fn register(&self, arguments: &[&str]) -> Output {
        let mut command = osteoflow();
        command.current_dir(self.dir.path()).env("OSTEOFLOW_CACHE", self.path("store"));
        command.arg("register").args(arguments).output().unwrap()
    }

    /// `osteoflow register` from the start of the case, as JSON.
    fn answer(&self, target: &str, source: &str, arguments: &[&str]) -> Value {
        let all = [&[target, source, "--init", "init.txt", "--format", "json"], arguments].concat();
        let output = self.register(&all);
        assert_eq!(output.status.code(), Some(0), "{all:?}: {}", stderr_of(&output));
        last_line(&output)
    }

    /// The stderr of a command that fails.
    fn fault(&self, code: i32, arguments: &[&str]) -> String {
        let output = self.register(arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr_of(&output));
        assert!(output.stdout.is_empty(), "{arguments:?}");
        stderr_of(&output)
    }

    /// Largest distance of the scan's points from their true positions, mm.
    fn off_mm(&self, answer: &Value) -> f64 {
        let (found, truth) = (pose(answer), &self.t_target_source);
        self.scan.iter().map(|p| (found * p - truth * p).norm()).fold(0.0, f64::max)
    }
}

#[test]
fn a_part_that_looks_the_same_from_several_sides_is_told_and_doubtful_where_a_target_is_on_it() {
    let dir = tempfile::tempdir().unwrap();
    let corner = |k: usize| {
        let [x, y, z] = [0, 1, 2].map(|axis| ((k >> axis) & 1) as f64 - 0.5);
        Point3::new(20.0 * x, 20.0 * y, 60.0 * z)
    };
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces: Vec<[u32; 3]> = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let block = Mesh::new("ct", SurfaceOrigin::Exact, (0..8).map(corner).collect::<Vec<_>>(), faces).unwrap();
    write_stl(&dir.path().join("block.stl"), &block).unwrap();
    let motion = Isometry3::new(Vector3::new(100.0, -40.0, 300.0), Vector3::new(0.3, -0.7, 0.2));
    let samples = sample::surface(&block, 4000, &mut ChaCha8Rng::seed_from_u64(2));
    let seen = samples.points.iter().zip(&samples.normals).filter(|(_, normal)| normal.sum() > 0.5);
    let scan = Cloud::new("scan", seen.map(|(p, _)| motion * p).collect::<Vec<_>>()).unwrap();
    write_ply(&dir.path().join("scan.ply"), &scan, 1.0).unwrap();
    fs::write(dir.path().join("targets.csv"), "label,x,y,z\nT1,5,5,20\n").unwrap();
    let answer = |arguments: &[&str]| {
        let output = osteoflow()
            .current_dir(dir.path())
            .args(["register", "block.stl", "scan.ply", "--format", "json"])
            .args(arguments)
            .output()
            .unwrap();
        assert!(stderr_of(&output).contains("degrees away, by a symmetry of it, so its shape does not tell which"));
        last_line(&output)["verdict"].clone()
    };
    let alone = answer(&[]);
    assert_eq!(alone["answer"], "trusted", "{alone}");
    assert!(alone["assumptions"][0].as_str().unwrap().starts_with("it does not matter which of the sides"), "{alone}");
    let planned = answer(&["--targets", "targets.csv"]);
    assert_eq!(
        (&planned["answer"], &planned["reasons"][0]["rule"]),
        (&"doubtful".into(), &"start".into()),
        "{planned}"
    );
}

fn mean(points: &[Point3<f64>]) -> Vector3<f64> {
    points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64
}

fn ply_of(mesh: &Mesh) -> String {
    let (n, m) = (mesh.vertices().len(), mesh.faces().len());
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {m}\nproperty list uchar int vertex_indices\nend_header\n"
    );
    mesh.vertices().iter().for_each(|v| writeln!(text, "{:?} {:?} {:?}", v.x, v.y, v.z).unwrap());
    mesh.faces().iter().for_each(|[a, b, c]| writeln!(text, "3 {a} {b} {c}").unwrap());
    text
}

fn text_of(t: &Isometry3<f64>) -> String {
    matrix_rows(t).map(|row| row.map(|c| format!("{c:?}")).join(" ") + "\n").concat()
}

fn stderr_of(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn last_line(output: &Output) -> Value {
    let stdout = String::from_utf8(output.stdout.clone()).unwrap();
    serde_json::from_str(stdout.lines().last().unwrap_or_else(|| panic!("no answer: {}", stderr_of(output)))).unwrap()
}

fn pose(answer: &Value) -> Isometry3<f64> {
    let numbers: Vec<f64> = answer["T"].as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).collect();
    assert_eq!(numbers.len(), 16);
    isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap()
}

#[test]
fn a_scan_is_registered_onto_whatever_file_holds_the_bone() {
    let case = Case::new();
    for (target, normals, n_faces) in [("bone.stl", true, true), ("bone.ply", true, true), ("points.ply", true, false)]
    {
        let answer = case.answer(target, "scan.ply", &["--target-points", "30000"]);
        let off_mm = case.off_mm(&answer);
        assert!(off_mm < 0.05, "{target}: {off_mm} mm; samples lie within 0.01 mm of the chords of the surface");
        assert_eq!(answer["converged"], true, "{target}");
        let summary = &answer["target"];
        assert_eq!((summary["n_points"].as_u64(), summary["normals"].as_bool()), (Some(30_000), Some(normals)));
        assert_eq!(summary["n_faces"].is_u64(), n_faces, "{target}");
    }
    let from_text = case.answer("points.ply", "scan.csv", &[]);
    assert_eq!(from_text["T"], case.answer("points.ply", "scan.ply", &[])["T"], "text holds every bit");
    // The vertices of a surface are points as well.
    let itself = case.register(&["points.ply", "bone.stl", "--init", "identity", "--format", "json"]);
    let turned = pose(&last_line(&itself));
    assert!(turned.translation.vector.norm() < 0.05 && turned.rotation.angle() < 1e-3, "{turned}");
    let notes = last_line(&itself)["notes"].to_string();
    assert!(notes.contains("bone.stl: a surface; its vertices are taken as the points"), "{notes}");
}

#[test]
fn missing_normals_are_estimated_for_every_method() {
    let case = Case::new();
    for (method, tolerance_mm) in METHODS.into_iter().filter(|(method, _)| *method != "point_to_mesh") {
        let answer = case.answer("bare.ply", "scan.ply", &["--method", method]);
        let off_mm = case.off_mm(&answer);
        assert!(off_mm < tolerance_mm, "{method}: {off_mm} mm");
        assert_eq!(
            (&answer["target"]["normals"], &answer["target"]["normals_estimated"]),
            (&true.into(), &true.into())
        );
        assert!(answer["notes"].to_string().contains("bare.ply: no normals; they are estimated"), "{answer}");
    }
}

#[test]
fn files_in_metres_give_the_same_pose() {
    let case = Case::new();
    let plain = pose(&case.answer("points.ply", "scan.ply", &[]));
    let metres = pose(&case.answer("points.ply", "scan_in_metres.ply", &["--source-unit-mm", "1000"]));
    assert!((plain.to_homogeneous() - metres.to_homogeneous()).amax() < 1e-6);
    let mut init = case.init;
    init.translation.vector /= 1000.0;
    case.write("init_in_metres.txt", &text_of(&init));
    let arguments =
        ["points.ply", "scan.ply", "--init", "init_in_metres.txt", "--init-unit-mm", "1000", "--format", "json"];
    let metres = pose(&last_line(&case.register(&arguments)));
    assert!((plain.to_homogeneous() - metres.to_homogeneous()).amax() < 1e-6);
    // Without its unit the scan is a speck, and a note names the option that mends it.
    let stderr = case.fault(3, &["points.ply", "scan_in_metres.ply", "--init", "init.txt"]);
    assert!(stderr.contains("note: scan_in_metres.ply: the points span 0."), "{stderr}");
    assert!(stderr.contains("is the file in metres? then give --source-unit-mm 1000"), "{stderr}");
}

#[test]
fn every_way_of_writing_the_start_is_the_same_start() {
    let case = Case::new();
    let rows = format!("{:?}", matrix_rows(&case.init));
    case.write("rows.json", &rows);
    case.write("object.json", &format!("{{\"T\": {rows}}}"));
    let inverse = case.init.inverse();
    let (r, t) = (inverse.rotation.to_rotation_matrix().into_inner(), inverse.translation.vector);
    let parameters: Vec<_> = r.transpose().iter().chain(t.iter()).map(|c| format!("{c:?}")).collect();
    let head = "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n";
    case.write("init.tfm", &format!("{head}Parameters: {}\nFixedParameters: 0 0 0\n", parameters.join(" ")));
    let plain = case.answer("points.ply", "scan.ply", &[]);
    for file in ["rows.json", "object.json", "init.tfm"] {
        let output = case.register(&["points.ply", "scan.ply", "--init", file, "--format", "json"]);
        let answer = last_line(&output);
        assert!((pose(&answer).to_homogeneous() - pose(&plain).to_homogeneous()).amax() < 1e-6, "{file}");
        assert_eq!(answer["init"]["file"], file);
    }
    // What was written is a start, too: nothing is left to go from there.
    for file in ["pose.txt", "pose.json"] {
        case.answer("points.ply", "scan.ply", &["--out", file]);
        let output = case.register(&["points.ply", "scan.ply", "--init", file, "--format", "json"]);
        let moved = (pose(&last_line(&output)).to_homogeneous() - pose(&plain).to_homogeneous()).amax();
        assert!(moved < 0.005, "{file}: {moved} mm, both within the stop rule of 0.001 mm");
    }
}

#[test]
fn the_answer_holds_timings_report_and_version() {
    let case = Case::new();
    let output = case.register(&["points.ply", "scan.ply", "--init", "init.txt", "--repeat", "3", "--format", "json"]);
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 1, "one JSON value on one line");
    let answer = last_line(&output);
    for key in ["prep_target_ms", "prep_source_ms", "align_ms", "cpu_ms"] {
        let ms = answer[key].as_array().unwrap_or_else(|| panic!("{key}: {answer}"));
        assert_eq!(ms.len(), 3, "{key}");
        assert!(ms.iter().all(|ms| ms.as_f64().is_some_and(|ms| ms >= 0.0)), "{key}: {ms:?}");
    }
    assert!(answer["load_ms"].as_f64().unwrap() > 0.0);
    assert_eq!(answer["outcome"]["exit_code"], 0);
    assert_eq!(answer["method"], "point_to_plane");
    assert_eq!(answer["stop_reason"], answer["report"]["stop_reason"]);
    assert_eq!(answer["same_bits"], true);
    assert_eq!(answer["warnings"].as_array().unwrap().len(), 0, "{answer}");
    assert_eq!(answer["undetermined"].as_array().unwrap().len(), 0);
    assert!(answer["iterations"].as_u64().unwrap() > 0 && answer["rms_mm"].as_f64().unwrap() < 0.05);
    assert_eq!(answer["n_pairs"], answer["source"]["n_points"]);
    assert!(answer["remaining_mm"].as_f64().unwrap() <= answer["params"]["stop_step_mm"].as_f64().unwrap());
    assert_eq!(answer["command"]["version"], env!("CARGO_PKG_VERSION"));
    assert!(answer.get("trace").is_none(), "only with -v");
}

/// Every method, and how far from the truth the built-in bone's chords and samples let it come, mm.
const METHODS: [(&str, f64); 5] = [
    ("point_to_plane", 0.05),
    // Held back along the bone by samples 0.5 mm apart.
    ("point_to_point", 0.5),
    ("symmetric", 0.05),
    ("generalized", 0.05),
    ("point_to_mesh", 0.05),
];

#[test]
fn every_method_finds_the_bone_with_every_pairing_and_the_same_bits_on_any_number_of_threads() {
    let case = Case::new();
    for (method, tolerance_mm) in METHODS {
        for pairing in ["cached", "tree"] {
            let answer = |workers: &str| {
                let more = ["--workers", workers, "--method", method, "--pairing", pairing, "--target-points", "20000"];
                case.answer("bone.stl", "scan.ply", &more)
            };
            let alone = answer("1");
            let off_mm = case.off_mm(&alone);
            assert!(off_mm < tolerance_mm, "{method}, {pairing}: {off_mm} mm");
            assert_eq!((&alone["method"], &alone["pairing"]), (&method.into(), &pairing.into()));
            let others: &[_] = match (is_slow_run(), pairing) {
                (true, _) => &["2", "8"],
                (false, "cached") => &["8"],
                (false, _) => &[],
            };
            for workers in others {
                assert_eq!(answer(workers)["T"], alone["T"], "{method}, {pairing}, {workers} workers");
            }
        }
    }
    let stderr = case.fault(3, &["points.ply", "scan.ply", "--init", "init.txt", "--method", "point_to_mesh"]);
    assert_eq!(stderr, "refused: the target has no triangles, which point_to_mesh needs; prepare it from a mesh\n");
    let stderr = case.fault(2, &["points.ply", "scan.ply", "--init", "init.txt", "--pairing", "cach"]);
    assert!(stderr.contains("did you mean \"cached\"?"), "{stderr}");
}

#[test]
fn a_fixed_number_of_steps_is_taken_with_all_points() {
    let case = Case::new();
    for (method, _) in METHODS {
        let fixed = ["--method", method, "--stop", "fixed", "--max-iterations", "6", "-v"];
        let answer = case.answer("bone.stl", "scan.ply", &fixed);
        assert_eq!(answer["iterations"], 6, "{method}");
        let trace = answer["trace"].as_array().unwrap();
        assert_eq!(trace.len(), 6);
        assert!(trace.iter().all(|step| step["every"] == 1), "{answer}");
        // Not to have converged is what was asked for.
        let warnings = answer["warnings"].to_string();
        assert!(!warnings.contains("not converged"), "{method}: {warnings}");
    }
}

#[test]
fn the_published_method_stops_by_the_reading_it_is_given() {
    let case = Case::new();
    let published = ["--method", "published", "--no-verdict", "--set"];
    let steps = |sets: &[&str], reason: &str| {
        let answer = case.answer("points.ply", "scan.ply", &[&published, sets].concat());
        assert_eq!((&answer["stop_reason"], &answer["converged"]), (&reason.into(), &false.into()), "{sets:?}");
        answer["iterations"].as_u64().unwrap()
    };
    assert_eq!(steps(&["reading=iterations", "--max-iterations", "7"], "iterations"), 7);
    assert_eq!(steps(&["max_iterations=9", "--stop", "fixed"], "iterations"), 9);
    let (coarse, fine) = (steps(&["reading=change_0.01"], "residual"), steps(&["reading=change_1e-5"], "residual"));
    assert!(coarse < fine, "{coarse} and {fine} steps");
    let files = ["points.ply", "scan.ply", "--init", "init.txt"];
    let fault = |more: &[&str]| case.fault(2, &[&files, more].concat());
    assert!(fault(&["--method", "published"]).contains("parameter \"reading\" is missing"));
    assert!(fault(&["--method", "published", "--pairing", "tree"]).contains("no parameter \"pairing\""));
}

#[test]
fn the_command_line_of_the_comparison_with_other_libraries_works() {
    let case = Case::new();
    for stop in ["converge", "fixed"] {
        let line = format!(
            "points.ply scan.ply --init init.txt --max-pair-distance-mm 10.0 --max-iterations 20 --step-mm 0.001 \
             --step-rad 1e-05 --workers 1 --repeat 2 --stop {stop} --format json"
        );
        let output = case.register(&line.split(' ').collect::<Vec<_>>());
        assert_eq!(output.status.code(), Some(0), "{}", stderr_of(&output));
        let answer = last_line(&output);
        assert_eq!(answer["stop"], stop);
        assert_eq!(answer["params"]["stop_step_rad"], if stop == "fixed" { 0.0 } else { 1e-5 });
        assert_eq!(answer["cpu_ms"].as_array().unwrap().len(), 2);
    }
}

#[test]
fn a_doubtful_pose_has_warnings() {
    let case = Case::new();
    let arguments = ["points.ply", "scan.ply", "--init", "init.txt", "--max-iterations", "1", "--format", "json"];
    let output = case.register(&arguments);
    assert_eq!(output.status.code(), Some(0));
    assert!(
        stderr_of(&output).starts_with("warning: not converged: max_iterations are used up; about "),
        "{}",
        stderr_of(&output)
    );
    let answer = last_line(&output);
    assert_eq!(answer["converged"], false);
    assert!(answer["warnings"][0].as_str().unwrap().starts_with("not converged"), "{answer}");

    // Half a turn about the bone is another stationary point.
    let centre = case.t_target_source * Point3::from(mean(&case.scan));
    let axis = bone::anatomy(&BoneParams::default()).proximal.scale(2.2);
    let half = Isometry3::from(centre.coords) * Isometry3::rotation(axis) * Isometry3::from(-centre.coords);
    case.write("turned.txt", &text_of(&(half * case.t_target_source)));
    let output = case.register(&["points.ply", "scan.ply", "--init", "turned.txt"]);
    let stderr = stderr_of(&output);
    assert!(
        stderr.contains("warning: it turned the source by "),
        "{stderr}\n{}",
        String::from_utf8_lossy(&output.stdout)
    );
    assert!(stderr.contains(" degrees from the start, so it may have converged to another minimum"), "{stderr}");

    // A plane slides in itself and turns about its normal.
    let mut plane = String::new();
    for k in 0..10_000 {
        writeln!(plane, "{} {} 0 0 0 1", f64::from(k % 100) * 0.5, f64::from(k / 100) * 0.5).unwrap();
    }
    case.write("plane.xyz", &plane);
    let output = case.register(&["plane.xyz", "plane.xyz", "--init", "identity", "--format", "json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr_of(&output));
    let answer = last_line(&output);
    assert_eq!(answer["undetermined"].as_array().unwrap().len(), 3, "{answer}");
    let loud = stderr_of(&output);
    assert_eq!(loud.matches("warning: the surfaces leave ").count(), 3, "{loud}");
    assert!(loud.contains("undetermined: along it the pose is that of the start"), "{loud}");
}

#[test]
fn without_an_answer_there_is_no_pose() {
    let case = Case::new();
    case.write("two.xyz", "0 0 0\n1 1 1\n");
    case.write("line.xyz", &(0..300).map(|k| format!("{k} 0 0\n")).collect::<String>());
    case.write("empty.xyz", "nan nan nan\n");
    for (arguments, expected) in [
        (
            &["line.xyz", "scan.ply", "--init", "init.txt"][..],
            "and its nearest lie on a line or in one place, so there is no normal; is this a surface?\n",
        ),
        (
            &["points.ply", "two.xyz", "--init", "identity"],
            "refused: 2 source points, 10 are needed; is the crop empty?\n",
        ),
        (
            &["empty.xyz", "scan.ply", "--init", "identity"],
            "refused: the target has no points; is the surface empty, or was nothing sampled from it?\n",
        ),
        (
            &["points.ply", "empty.xyz", "--init", "identity"],
            "refused: there are no points to crop; is the scan empty, or none of its points finite?\n",
        ),
        (
            &["points.ply", "two.xyz"],
            "refused: the scan has 2 points, 12 are needed to tell its shape; is the region of interest around the bone?\n",
        ),
    ] {
        let stderr = case.fault(3, arguments);
        assert!(stderr.ends_with(expected), "{arguments:?}: {stderr}");
    }
    let far = case.fault(3, &["points.ply", "scan.ply", "--init", "identity"]);
    assert!(
        far.contains("source points lie within 5 mm of the target, 10 are needed; the nearest target point is"),
        "{far}"
    );
    let output =
        case.register(&["points.ply", "two.xyz", "--init", "identity", "--format", "json", "--out", "pose.txt"]);
    let answer = last_line(&output);
    assert_eq!((answer["outcome"]["status"].as_str(), answer.get("T")), (Some("refused"), None));
    assert_eq!(answer["refused"]["reason"], "2 source points, 10 are needed; is the crop empty?");
    assert!(!case.path("pose.txt").exists());
}

#[test]
fn a_damaged_file_is_named_with_the_position_of_the_fault() {
    let case = Case::new();
    case.write("scaled.txt", "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n");
    case.write("mirror.txt", "1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1\n");
    case.write("nan.txt", "1 0 0 0\n0 1 0 nan\n0 0 1 0\n0 0 0 1\n");
    case.write("transposed.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n12 5 7 1\n");
    case.write("short.txt", "1 0 0 0\n");
    case.write("words.xyz", "0 0 0\n1 one 1\n");
    for (arguments, expected) in [
        (
            &["points.ply", "scan.ply", "--init", "scaled.txt"][..],
            "scaled.txt: matrix: the upper left 3 x 3 is not a rotation: it is off by 1.0e0 where 1e-3 is allowed, and its \
             columns have lengths 2.0000, 2.0000, 2.0000; is there a scale in it?",
        ),
        (
            &["points.ply", "scan.ply", "--init", "mirror.txt"],
            "mirror.txt: matrix: the matrix is a mirror image (determinant -1.000); are two axes swapped, or is it RAS where \
             LPS is meant?",
        ),
        (&["points.ply", "scan.ply", "--init", "nan.txt"], "nan.txt: matrix: the matrix is not finite"),
        (
            &["points.ply", "scan.ply", "--init", "transposed.txt"],
            "transposed.txt: matrix: the last row of a rigid motion is 0 0 0 1; is the matrix written column by column?",
        ),
        (
            &["points.ply", "scan.ply", "--init", "short.txt"],
            "short.txt: matrix: 16 numbers are expected, a 4 x 4 matrix row by row, but there are 4",
        ),
        (&["no.stl", "scan.ply"], "no.stl: cannot be read: there is no such file"),
    ] {
        assert_eq!(case.fault(1, arguments), format!("error: {expected}\n"), "{arguments:?}");
    }
    // What the graph reads is refused by it, and leaves an answer.
    let stderr = case.fault(3, &["points.ply", "words.xyz"]);
    assert!(stderr.ends_with("refused: words.xyz: line 2: \"one\" is not a number\n"), "{stderr}");
    let answer = last_line(&case.register(&["points.ply", "words.xyz", "--format", "json"]));
    assert_eq!((&answer["verdict"]["answer"], answer.get("T")), (&"refused".into(), None), "{answer}");
}

#[test]
fn a_fault_of_the_command_line_suggests_the_right_name() {
    let case = Case::new();
    let files = ["points.ply", "scan.ply", "--init", "init.txt"];
    let with = |more: &[&str]| case.fault(2, &[&files, more].concat());
    let stderr = with(&["--set", "max_pair_distance=3", "--max-iterations", "0"]);
    for expected in [
        "register: icp.point_to_plane has no parameter \"max_pair_distance\"",
        "help: write max_pair_distance_mm",
        "1 | --max-iterations 0",
        "register: max_iterations takes a whole number from 1 to 100000, found 0",
        "2 errors",
    ] {
        assert!(stderr.contains(expected), "{expected}\n{stderr}");
    }
    assert!(with(&["--method", "point_to_plain"]).contains("point_to_plane"));
    assert!(with(&["--camera", "1,2"]).contains("3 finite numbers in mm are expected, such as 0,0,0"));
    assert!(with(&["--unit-mm", "0"]).contains("1 for millimetres, 1000 for metres"));
    let json = case.register(&[&files[..], &["--set", "trim=1", "--format", "json"]].concat());
    let faults: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!((json.status.code(), faults["faults"].as_array().unwrap().len()), (Some(2), 1));
}

#[test]
fn parameters_are_those_of_the_node_and_settings_outrank_options() {
    let case = Case::new();
    let more = ["--max-pair-distance-mm", "8", "--set", "trim_fraction=0.1", "--set", "max_pair_distance_mm=7"];
    let answer = case.answer("points.ply", "scan.ply", &more);
    assert_eq!(
        (&answer["params"]["max_pair_distance_mm"], &answer["params"]["trim_fraction"]),
        (&7.0.into(), &0.1.into())
    );
    let share = answer["n_pairs"].as_f64().unwrap() / answer["source"]["n_points"].as_f64().unwrap();
    assert!((share - 0.9).abs() < 1e-3, "{share}");
}

#[test]
fn two_files_need_no_start_and_what_comes_out_is_named_by_its_ending() {
    let case = Case::new();
    let output = case.register(&["bone.stl", "scan.ply", "--out", "found", "--space", "RAS", "--format", "json"]);
    let answer = last_line(&output);
    assert_eq!((output.status.code(), &answer["verdict"]["answer"]), (Some(0), &"trusted".into()), "{answer}");
    assert!(case.off_mm(&answer) < 0.1, "{} mm", case.off_mm(&answer));
    assert_eq!(answer["start"]["by"], "shape");
    let clearness = answer["start"]["report"]["clearness"].as_f64().unwrap();
    assert!(clearness > 0.3, "{clearness}");

    let found = |name: &str| case.path("found").join(name);
    let read = |name: &str| read_pose(&found(name), 1.0).unwrap().isometry.to_homogeneous();
    let expected = pose(&answer).to_homogeneous();
    for name in ["pose.txt", "pose.json"] {
        assert!((read(name) - expected).amax() < 1e-9, "{name}");
    }
    // RAS numbers of the scan turned to LPS, as the file must hold; the bone states LPS.
    let flip = Matrix4::from_diagonal(&Vector4::new(-1.0, -1.0, 1.0, 1.0));
    assert!((read("pose.tfm") - expected * flip).amax() < 1e-9);
    let moved = read_cloud(&found("source.ply"), 1.0, "target").unwrap().cloud;
    let place = |k: usize| pose(&answer) * case.scan[k];
    // A PLY for others has 32-bit floats, which keep this much.
    assert!((0..moved.len()).all(|k| (moved.points()[k] - place(k)).amax() < KEPT));
    let text = fs::read(found("source.ply")).unwrap();
    assert!(String::from_utf8_lossy(&text[..400]).contains("property float residual_mm"));

    for (file, expected) in [
        (
            "pose.ply",
            "no pose is written so; end it with .txt (the matrix), .json (the whole answer), .tfm or .mrb (3D",
        ),
        (
            "pose.tfm",
            "pose.tfm: a .tfm is always LPS, and scan.ply does not state the space of its numbers; give --space",
        ),
    ] {
        let stderr = case.fault(2, &["bone.stl", "scan.ply", "--out", file]);
        assert!(stderr.contains(expected), "{stderr}");
        assert!(!case.path(file).exists());
    }
    let stderr = case.fault(2, &["bone.stl", "scan.ply", "--write-source", "moved.txt"]);
    assert!(stderr.contains("moved.txt cannot be written: end it with .ply, .pcd or .csv"), "{stderr}");
    let stderr = case.fault(2, &["bone.stl", "scan.ply", "--out", "found"]);
    assert!(stderr.contains("pose.txt exists already; name another file, nothing is overwritten"), "{stderr}");
}

#[test]
fn a_start_that_another_place_serves_as_well_is_doubted_and_the_other_ways_are_named() {
    let case = Case::new();
    let another = BoneParams { shape_seed: 5, ..BoneParams::default() };
    write_stl(&case.path("another.stl"), &bone::fibula(&another)).unwrap();
    let ways = "start from landmarks or from a known pose";

    let answer = last_line(&case.register(&["another.stl", "scan.ply", "--format", "json"]));
    let clearness = answer["start"]["report"]["clearness"].as_f64().unwrap();
    assert!(clearness < 0.3, "{clearness}: the bone of another subject has no clear place for the scan");
    assert_ne!(answer["verdict"]["answer"], "trusted", "{}", answer["verdict"]);
    let reasons = answer["verdict"]["reasons"].as_array().unwrap();
    let start = reasons.iter().find(|reason| reason["rule"] == "start").unwrap();
    assert!(start["remedy"].as_str().unwrap().starts_with(ways), "{start}");

    let unjudged = last_line(&case.register(&["another.stl", "scan.ply", "--no-verdict", "--format", "json"]));
    let warning = "the scan fits elsewhere nearly as well";
    assert!(unjudged["warnings"].to_string().contains(warning), "{}", unjudged["warnings"]);
    let clear = last_line(&case.register(&["bone.stl", "scan.ply", "--no-verdict", "--format", "json"]));
    assert!(!clear["warnings"].to_string().contains(warning), "{}", clear["warnings"]);
}

#[test]
fn options_that_would_change_nothing_are_refused() {
    let case = Case::new();
    for (option, parameter, value) in [("--threshold-hu", "threshold_hu", "600"), ("--series", "series", "2")] {
        let stderr = case.fault(2, &["bone.stl", "scan.ply", option, value]);
        assert!(stderr.contains(&format!("{parameter} is for a CT, and bone.stl is none; leave it out")), "{stderr}");
    }
    for (name, points) in [("lps_bone.csv", &case.scan), ("lps_scan.csv", &case.scan)] {
        let rows: String = points.iter().map(|p| format!("{:?},{:?},{:?}\n", p.x, p.y, p.z)).collect();
        case.write(name, &format!("# SPACE=LPS\nx,y,z\n{rows}"));
    }
    let stderr = case.fault(2, &["lps_bone.csv", "lps_scan.csv", "--space", "RAS"]);
    assert!(stderr.contains("lps_bone.csv and lps_scan.csv state their space; leave out --space"), "{stderr}");
}

/// Picked points as CSV.
fn picks(names: &[&str], points: &[Point3<f64>]) -> String {
    let mut text = String::from("label,x,y,z\n");
    names.iter().zip(points).for_each(|(name, p)| writeln!(text, "{name},{:?},{:?},{:?}", p.x, p.y, p.z).unwrap());
    text
}

#[test]
fn picked_points_are_matched_by_name_and_doubted_where_they_are_off_the_surface_or_in_another_order() {
    let case = Case::new();
    let n = case.scan.len();
    let in_scan: Vec<Point3<f64>> = [n / 7, n / 3, n / 2, 4 * n / 5].map(|k| case.scan[k]).to_vec();
    let on_bone: Vec<Point3<f64>> = in_scan.iter().map(|p| case.t_target_source * p).collect();
    case.write("bone.csv", &picks(&["a", "b", "c", "d"], &on_bone));
    // In another order, and with a point that is not on the bone.
    let order: Vec<Point3<f64>> = [2, 0, 3, 1].map(|k| in_scan[k]).into_iter().chain([Point3::origin()]).collect();
    case.write("scan_points.csv", &picks(&["c", "a", "d", "b", "other"], &order));
    let register = |target: &str, source: &str| {
        case.register(&["bone.stl", "scan.ply", "--landmarks", target, source, "--format", "json"])
    };
    let answer = last_line(&register("bone.csv", "scan_points.csv"));
    assert!(case.off_mm(&answer) < 0.1, "{} mm", case.off_mm(&answer));
    assert_eq!((&answer["start"]["by"], &answer["verdict"]["answer"]), (&"landmarks".into(), &"trusted".into()));
    assert!(answer["start"]["report"]["fre_mm"].as_f64().unwrap() < 1e-6, "{answer}");
    assert!(
        answer["notes"].to_string().contains("a, b, c, d are in both files and used; the 1 others are not"),
        "{answer}"
    );

    case.write("unnamed.xyz", &in_scan.iter().map(|p| format!("{:?} {:?} {:?}\n", p.x, p.y, p.z)).collect::<String>());
    let answer = last_line(&register("bone.csv", "unnamed.xyz"));
    assert!(answer["notes"].to_string().contains("matched by their order: a, b, c, d with 1, 2, 3, 4"), "{answer}");
    assert!(case.off_mm(&answer) < 0.1, "{} mm", case.off_mm(&answer));

    // Two names exchanged: right or not, it is not trusted.
    case.write("exchanged.csv", &picks(&["a", "d", "c", "b"], &in_scan));
    let answer = last_line(&register("bone.csv", "exchanged.csv"));
    assert_ne!(answer["verdict"]["answer"], "trusted", "{}", answer["verdict"]);

    // The right start does not excuse points that belong to a flipped bone.
    let flipped: Vec<Point3<f64>> = on_bone.iter().map(|p| Point3::new(-p.x, -p.y, p.z)).collect();
    case.write("flipped.csv", &picks(&["a", "b", "c", "d"], &flipped));
    let output = register("flipped.csv", "scan_points.csv");
    let answer = last_line(&output);
    assert_ne!(answer["verdict"]["answer"], "trusted", "{}", answer["verdict"]);
    if answer.get("T").is_some() {
        assert!(answer["warnings"].to_string().contains("RAS and LPS are mixed up"), "{answer}");
    }

    // Markups are in mm, whatever the unit of the surface.
    let in_metres: Vec<Point3<f64>> = on_bone.iter().map(|p| p / 1000.0).collect();
    case.write("metres.csv", &picks(&["a", "b", "c", "d"], &in_metres));
    let named = |points: &[Point3<f64>]| -> Vec<NamedPoint> {
        ["a", "b", "c", "d"].into_iter().zip(points).map(|(name, p)| NamedPoint::new(name, *p)).collect()
    };
    write_mrk_json(&case.path("bone.mrk.json"), &named(&on_bone), Space::Lps).unwrap();
    let target = sample::surface(&bone::fibula(&BoneParams::default()), N_TARGET, &mut ChaCha8Rng::seed_from_u64(1));
    write_ply(&case.path("bone_in_metres.ply"), &Cloud::new("ct", target.points).unwrap(), 1000.0).unwrap();
    for points in ["metres.csv", "bone.mrk.json"] {
        let landmarks = ["--target-unit-mm", "1000", "--landmarks", points, "scan_points.csv", "--format", "json"];
        let answer = last_line(&case.register(&[&["bone_in_metres.ply", "scan.ply"], &landmarks[..]].concat()));
        assert!(answer["start"]["report"]["fre_mm"].as_f64().is_some_and(|mm| mm < 1e-3), "{points}: {answer}");
    }

    case.write("two.csv", &picks(&["a", "b", "x"], &in_scan));
    let stderr = case.fault(1, &["bone.stl", "scan.ply", "--landmarks", "bone.csv", "two.csv"]);
    assert!(
        stderr.contains("3 points with the same names are needed in both files; bone.csv has a, b, c, d, two.csv has"),
        "{stderr}"
    );
    let stderr = case.fault(2, &["bone.stl", "scan.ply", "--landmarks", "bone.csv", "two.csv", "--init", "init.txt"]);
    assert!(stderr.contains("cannot be used with"), "{stderr}");
}

/// What the verdict says of landmarks that contradict the surface.
fn contradiction(answer: &Value) -> Option<String> {
    let reasons = answer["verdict"]["reasons"].as_array()?;
    let found = reasons.iter().find(|reason| reason["rule"] == "landmarks_contradict")?;
    Some(found["reason"].to_string())
}

#[test]
fn fiducials_off_the_surface_are_no_sign_and_contradict_it_where_all_are_shifted() {
    let case = Case::new();
    let n = case.scan.len();
    let out = Vector3::new(3.0, -14.0, 8.0);
    let on_bone = [n / 7, n / 3, n / 2, 4 * n / 5].map(|k| case.t_target_source * case.scan[k] + out);
    let names = ["a", "b", "c", "d"];
    let touched = |shift: Vector3<f64>| on_bone.map(|p| case.t_target_source.inverse() * p + shift);
    case.write("bone.csv", &picks(&names, &on_bone));
    case.write("touched.csv", &picks(&names, &touched(Vector3::zeros())));
    case.write("shifted.csv", &picks(&names, &touched(Vector3::new(0.0, 0.0, 8.0))));
    let register = |option: &str, source: &str| {
        last_line(&case.register(&["bone.stl", "scan.ply", option, "bone.csv", source, "--format", "json"]))
    };
    let sound = register("--fiducials", "touched.csv");
    assert_eq!(sound["verdict"]["answer"], "trusted", "{}", sound["verdict"]);
    assert!(!sound["warnings"].to_string().contains("off its surface"), "{sound}");
    let shifted = register("--fiducials", "shifted.csv");
    assert_eq!(shifted["verdict"]["answer"], "doubtful", "{}", shifted["verdict"]);
    let text = contradiction(&shifted).expect("a contradiction");
    assert!(text.contains("fiducials and surface contradict each other by 8.0 mm at the scan"), "{text}");
    // Not said to be fiducials, they are doubted for where they lie.
    assert_ne!(register("--landmarks", "touched.csv")["verdict"]["answer"], "trusted");
}

#[test]
fn the_error_is_predicted_at_targets_near_and_far_and_on_the_surface_or_not() {
    let case = Case::new();
    let centre = case.t_target_source * Point3::from(mean(&case.scan));
    let at = [0.0, 25.0, 400.0].map(|mm| centre + Vector3::new(0.0, mm, 0.0));
    case.write("targets.csv", &picks(&["near", "beside", "far"], &at));
    case.write("near.csv", &picks(&["near"], &at[..1]));
    let register =
        |file: &str| last_line(&case.register(&["bone.stl", "scan.ply", "--targets", file, "--format", "json"]));
    let answer = register("targets.csv");
    let predicted = &answer["verdict"]["predicted"];
    let of = |k: usize, key: &str| predicted["points"][k][key].clone();
    assert_eq!([0, 1, 2].map(|k| of(k, "name")), ["near", "beside", "far"].map(Value::from), "{predicted}");
    let rms = [0, 1, 2].map(|k| of(k, "tre_mm").as_f64().unwrap());
    // 400 mm away a turn counts many times as much as at the scan.
    assert!(rms[0] < rms[1] && 3.0 * rms[0] < rms[2], "{rms:?} mm");
    assert!(of(2, "semi_axes_mm")[0].as_f64() > of(2, "semi_axes_mm")[2].as_f64(), "{predicted}");
    let rules = answer["verdict"]["reasons"].to_string();
    assert!(!rules.contains("planned points lie off the surface"), "{rules}");
    // The true error of each, from the pose that made the scan, is within three times its RMS.
    let off = pose(&answer) * case.t_target_source.inverse();
    for (p, rms_mm) in at.iter().zip(rms) {
        assert!(
            (off * p - p).norm() < 3.0 * rms_mm,
            "{:.3} mm off, {rms_mm:.3} mm (RMS) predicted",
            (off * p - p).norm()
        );
    }
    // The limits hold at the targets: what is right at the scan may be wrong far away.
    let near = register("near.csv");
    let chance = |answer: &Value| answer["verdict"]["predicted"]["beyond_limits"].as_f64().unwrap();
    assert_eq!(near["verdict"]["answer"], "trusted", "{}", near["verdict"]);
    case.write("remote.csv", &picks(&["remote"], &[centre + Vector3::new(0.0, 4000.0, 0.0)]));
    let remote = register("remote.csv");
    assert!(chance(&near) < 0.05 && chance(&remote) > 0.5, "{} and {}", chance(&near), chance(&remote));
    assert_ne!(remote["verdict"]["answer"], "trusted", "{}", remote["verdict"]);
    assert!(remote["notes"].to_string().contains("--targets: remote lies "), "{}", remote["notes"]);
    assert!(!near["notes"].to_string().contains("--targets: near lies"), "{}", near["notes"]);
    // The pose is that without targets, and the graph gives the same with the settings of the answer.
    let plain = last_line(&case.register(&["bone.stl", "scan.ply", "--format", "json"]));
    assert_eq!((&plain["T"], &plain["verdict"]["predicted"]), (&answer["T"], &Value::Null));
    let file = toml::Value::from(case.path("targets.csv").display().to_string());
    let keys = ["kind=\"acquire.points\"".to_owned(), "frame=\"ct\"".to_owned(), format!("path={file}")];
    let mut sets: Vec<String> = keys.iter().map(|key| format!("node.targets.{key}")).collect();
    sets.extend(["node.verdict.in.assessment=\"targets.points\"".into(), "verdict.assessment_on_surface=false".into()]);
    for (node, name) in [("bone", "bone.stl"), ("scan", "scan.ply")] {
        sets.push(format!("{node}.path={}", toml::Value::from(case.path(name).display().to_string())));
    }
    let (_, stderr, results) = run_two_files(&case, &sets);
    assert_eq!(&results["verdict"]["predicted"], predicted, "{stderr}");
    let text = case.register(&["bone.stl", "scan.ply", "--targets", "targets.csv"]);
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("predicted, mm") && text.contains("beside"), "{text}");
    case.write("none.csv", "label,x,y,z\n");
    assert!(case.fault(1, &["bone.stl", "scan.ply", "--targets", "none.csv"]).contains("none.csv"));
    let fault = case.fault(2, &["bone.stl", "scan.ply", "--targets", "near.csv", "--no-verdict"]);
    assert!(fault.contains("--no-verdict"), "{fault}");
}

#[test]
fn a_trace_of_few_points_is_registered_from_landmarks_and_by_shape_and_its_mirror_image_is_not_trusted() {
    let Some(folder) = common::data("trace_of_few_points", "real/skull") else { return };
    let case = Case::new();
    let file = |name: &str| folder.join(name).display().to_string();
    let (face, planned, touched) = (file("face.ply"), file("planned.txt"), file("touched.txt"));
    let trace = file("trace2.xyz");
    let from_landmarks =
        [&*face, &*trace, "--fiducials", &*planned, &*touched, "--targets", &*planned, "--format", "json"];
    let answer = last_line(&case.register(&from_landmarks));
    assert!(answer["T"].is_array(), "{answer}");
    let points = answer["verdict"]["predicted"]["points"].as_array().expect("a prediction");
    let read = |name: &str| -> Vec<Point3<f64>> {
        let text = fs::read_to_string(folder.join(name)).unwrap();
        let row = |row: &str| Vector3::from_iterator(row.split_whitespace().map(|cell| cell.parse::<f64>().unwrap()));
        text.lines().map(|line| Point3::from(row(line))).collect()
    };
    // Up to 145 mm away; a touch has an error of 0.5 mm of its own.
    let (planned_mm, touched_mm) = (read("planned.txt"), read("touched.txt"));
    let held = points.iter().zip(planned_mm.iter().zip(&touched_mm)).filter(|(point, (planned, touched))| {
        let error = (pose(&answer) * **touched - **planned).norm();
        let interval = &point["interval_mm"];
        error < interval[1].as_f64().unwrap() + 0.5 && error > interval[0].as_f64().unwrap() - 0.5
    });
    assert!(held.count() >= 9, "{}", answer["verdict"]["predicted"]);
    let mirrored: String = read("trace2.xyz").iter().map(|p| format!("{:?} {:?} {:?}\n", -p.x, p.y, p.z)).collect();
    case.write("mirrored.xyz", &mirrored);
    for source in [&*trace, "mirrored.xyz"] {
        let answer = last_line(&case.register(&[&face, source, "--format", "json"]));
        // Twenty points tell no place on a face.
        assert_ne!(answer["verdict"]["answer"], "trusted", "{source}: {}", answer["verdict"]);
    }
}

#[test]
fn measured_fiducials_that_contradict_the_surface_of_a_pelvis_are_named_and_moved_ones_that_agree_are_trusted() {
    let Some(folder) = common::data("measured_fiducials", "real/pelvis") else { return };
    let case = Case::new();
    let file = |name: &str| folder.join(name).display().to_string();
    let (bone, scan) = (file("pelvis_cropped_decimated.vtk"), file("Tracker_Surface_Scan.txt"));
    let (in_ct, touched) = (file("pelvis_cropped_ct_fiducial_markers.txt"), file("Tracker_Fiducial_Markers.txt"));
    let register =
        |points: &str| last_line(&case.register(&[&bone, &scan, "--fiducials", &in_ct, points, "--format", "json"]));
    let answer = register(&touched);
    assert_ne!(answer["verdict"]["answer"], "trusted", "{}", answer["verdict"]);
    let text = contradiction(&answer).expect("a contradiction");
    assert!(text.contains("contradict each other by 8."), "{text}");
    // Simulated: as the surface says, with 0.4 mm of error each.
    let to_source = pose(&answer).inverse();
    let rows = fs::read_to_string(&in_ct).unwrap();
    let numbers = |row: &str| {
        Point3::from(Vector3::from_iterator(row.split_whitespace().map(|cell| cell.parse::<f64>().unwrap())))
    };
    let errors = [[0.3, -0.2, 0.1], [-0.2, 0.2, 0.2], [0.0, 0.3, -0.2], [0.1, -0.3, 0.2]].map(Vector3::from);
    let moved = rows.lines().zip(errors).map(|(row, error)| to_source * numbers(row) + error);
    let text = moved.map(|p| format!("{:?} {:?} {:?}\n", p.x, p.y, p.z)).collect::<String>();
    case.write("moved.txt", &text);
    let answer = register("moved.txt");
    assert_eq!(answer["verdict"]["answer"], "trusted", "{}", answer["verdict"]);
}

#[test]
fn a_ct_is_registered_onto_as_its_surface_is() {
    let Some(mesh) = common::data("registering onto a CT", "bones/TLEM2_CT_fibula_r.stl") else { return };
    let Some(volume) = common::data("registering onto a CT", "medical/tlem2r_distal_ct.nii.gz") else { return };
    let mesh = read_mesh(&mesh, 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
    let seen = sample::surface(&mesh, 90_000, &mut ChaCha8Rng::seed_from_u64(8));
    let side = seen.points.iter().zip(&seen.normals).filter(|(p, n)| (-1000.0..-900.0).contains(&p.z) && n.x > 0.2);
    let scan: Vec<Point3<f64>> = side.map(|(p, _)| *p).collect();
    let case = Case::new();
    let motion = Isometry3::new(Vector3::new(40.0, -20.0, 300.0), Vector3::new(1.0, -0.6, 0.9));
    let moved: Vec<Point3<f64>> = scan.iter().map(|p| motion.inverse() * p).collect();
    write_ply(&case.path("ct_scan.ply"), &Cloud::new("camera", moved.clone()).unwrap(), 1.0).unwrap();
    let dicom = volume.with_file_name("tlem2r_distal_ct_dicom");
    for volume in [volume, dicom] {
        let output = case.register(&[volume.to_str().unwrap(), "ct_scan.ply", "--format", "json"]);
        let answer = last_line(&output);
        assert_eq!(output.status.code(), Some(0), "{}", stderr_of(&output));
        let found = pose(&answer);
        let off_mm = moved.iter().zip(&scan).map(|(a, b)| (found * a - b).norm()).fold(0.0, f64::max);
        assert!(off_mm < 0.3 || answer["verdict"]["answer"] != "trusted", "{off_mm} mm off and trusted: {answer}");
        assert!(off_mm < 0.3, "{off_mm} mm off: {}", answer["verdict"]);
        let notes = answer["notes"].to_string();
        assert!(
            notes.contains("the threshold is 620 HU") && notes.contains("the volume's border cuts the bone"),
            "{notes}"
        );
    }
    // An image without a unit needs a threshold, and is not guessed at.
    let Some(other) = common::data("an image that is no CT", "medical/nibabel_anatomical.nii") else { return };
    let stderr = case.fault(3, &[other.to_str().unwrap(), "ct_scan.ply"]);
    assert!(stderr.contains("refused: threshold_hu is not given, and the values are not HU"), "{stderr}");
}

/// `run graphs/two_files.toml` with the settings: exit code, stderr and the content of `results.json`.
fn run_two_files(case: &Case, sets: &[String]) -> (Option<i32>, String, Value) {
    let out = tempfile::tempdir_in(case.dir.path()).unwrap();
    let mut command = osteoflow();
    command.current_dir(case.dir.path()).env("OSTEOFLOW_CACHE", case.path("store"));
    command.arg("run").arg(common::root().join("graphs/two_files.toml")).args(["--no-record", "--force", "--out"]);
    command.arg(out.path());
    command.args(sets.iter().flat_map(|set| ["--set", set]));
    let output = command.output().unwrap();
    let results = fs::read(out.path().join("results.json")).unwrap_or_else(|_| panic!("{}", stderr_of(&output)));
    (output.status.code(), stderr_of(&output), serde_json::from_slice(&results).unwrap())
}

/// Registers by the command and by the graph, and holds that they answer alike.
fn the_same_both_ways(case: &Case, [target, source]: [&str; 2], more: &[(&str, &str, &str)]) -> Value {
    let options = more.iter().flat_map(|(option, value, _)| [*option, *value]);
    let arguments: Vec<_> = [target, source, "--format", "json"].into_iter().chain(options).collect();
    let output = case.register(&arguments);
    let answer = last_line(&output);
    let quoted = |file: &str| toml::Value::from(file).to_string();
    let mut sets = vec![format!("bone.path={}", quoted(target)), format!("scan.path={}", quoted(source))];
    sets.extend(more.iter().map(|(_, _, set)| (*set).to_owned()));
    let (code, stderr, results) = run_two_files(case, &sets);
    assert_eq!(output.status.code(), code, "{arguments:?}: {}{stderr}", stderr_of(&output));
    let of_register = answer["T"].as_array().cloned().unwrap_or_default();
    let rows = results["poses"]["t_ct_camera"]["matrix"].as_array().into_iter().flatten();
    let of_graph: Vec<Value> = rows.flat_map(|row| row.as_array().unwrap()).cloned().collect();
    // Numbers are printed with all their digits.
    assert_eq!(of_register, of_graph, "{arguments:?}");
    assert_eq!(results["poses"].as_object().map_or(0, |poses| poses.len()), usize::from(code == Some(0)));
    assert_eq!(answer["refused"]["reason"], results["refused"]["reason"], "{arguments:?}");
    for key in ["answer", "sentence", "assumptions", "predicted", "measured"] {
        assert_eq!(answer["verdict"][key], results["verdict"][key], "{arguments:?}: {key}");
    }
    let reasons = |verdict: &Value| {
        let reasons = verdict["reasons"].as_array().unwrap().iter();
        reasons.map(|r| [&r["rule"], &r["answer"], &r["reason"]].map(Value::clone)).collect::<Vec<_>>()
    };
    assert_eq!(reasons(&answer["verdict"]), reasons(&results["verdict"]), "{arguments:?}");
    answer
}

#[test]
fn register_and_the_graph_of_two_files_give_the_same_bits_reasons_and_assumptions_or_the_same_refusal() {
    let case = Case::new();
    case.write("words.xyz", "0 0 0\n1 one 1\n");
    case.write("two.xyz", "0 0 0\n1 1 1\n");
    for (target, source, answer) in [
        ("bone.stl", "scan.ply", "trusted"),
        ("bone.ply", "scan.csv", "trusted"),
        ("points.ply", "scan.ply", "trusted"),
        ("bare.ply", "scan.ply", "trusted"),
        ("bone.stl", "two.xyz", "refused"),
        ("words.xyz", "scan.ply", "refused"),
        ("bone.stl", "words.xyz", "refused"),
    ] {
        let both = the_same_both_ways(&case, [target, source], &[]);
        assert_eq!(both["verdict"]["answer"], answer, "{target}, {source}: {}", both["verdict"]);
        let assumptions = both["verdict"]["assumptions"].to_string();
        assert_eq!(assumptions.contains("were estimated"), target == "bare.ply", "{assumptions}");
        assert!(!assumptions.contains("is predicted"), "nothing is predicted: {assumptions}");
    }
    let camera = case.t_target_source.inverse() * Point3::new(0.0, -300.0, 0.0);
    let (option, set) = (
        format!("{:?},{:?},{:?}", camera.x, camera.y, camera.z),
        format!("scan.camera=[{:?}, {:?}, {:?}]", camera.x, camera.y, camera.z),
    );
    let more = [
        ("--camera", option.as_str(), set.as_str()),
        ("--seed", "7", "graph.seed=7"),
        ("--target-points", "30000", "ct_surface.n_points=30000"),
        ("--method", "symmetric", "icp.kind=icp.symmetric"),
        ("--set", "trim_fraction=0.1", "icp.trim_fraction=0.1"),
        ("--max-iterations", "3", "icp.max_iterations=3"),
        ("--require", "trusted", "results.require=trusted"),
    ];
    for n in if is_slow_run() { 1..=more.len() } else { more.len()..=more.len() } {
        let both = the_same_both_ways(&case, ["bone.stl", "scan.ply"], &more[..n]);
        assert!(!both["verdict"]["assumptions"].to_string().contains("where the camera was"), "{both}");
    }
    for (option, value, set) in
        [("--target-unit-mm", "1000.0", "bone.unit_mm=1000"), ("--source-unit-mm", "0.5", "scan.unit_mm=0.5")]
    {
        the_same_both_ways(&case, ["points.ply", "scan.ply"], &[(option, value, set)]);
    }
}

/// The scan with the error of a depth camera towards the side that it is seen from: 0.3 mm of noise, and waves of 1 mm that are 20 to 30 mm
/// long.
fn coarse(case: &Case) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    // Uniform, of a standard deviation of 0.3 mm.
    let mut noise = || (f64::from(rng.next_u32()) / f64::from(u32::MAX) - 0.5) * 1.04;
    let towards = case.t_target_source.inverse() * bone::anatomy(&BoneParams::default()).lateral.into_inner();
    let mut text = String::new();
    for p in &case.scan {
        let wave = (0.31 * p.x).sin() + (0.27 * p.y + 1.0).sin() + (0.23 * p.z + 2.0).sin();
        let at = p + towards * (0.8 * wave + noise());
        writeln!(text, "{:?} {:?} {:?}", at.x, at.y, at.z).unwrap();
    }
    text
}

#[test]
fn a_scan_of_a_coarse_sensor_is_trusted_once_the_sensor_is_stated_as_the_message_advises() {
    let case = Case::new();
    case.write("coarse.xyz", &coarse(&case));
    let unstated = case.register(&["bone.stl", "coarse.xyz", "--init", "init.txt", "--format", "json"]);
    let unstated = last_line(&unstated);
    let reasons = unstated["verdict"]["reasons"].to_string();
    assert!(reasons.contains("as of a ") && reasons.contains("(register: --sensor;"), "{reasons}");
    let stated = [("--sensor", "depth_camera", "ct_surface.sensor.like=depth_camera")];
    let answer = case.answer("bone.stl", "coarse.xyz", &["--sensor", "depth_camera"]);
    assert_eq!(answer["verdict"]["answer"], "trusted", "{}", answer["verdict"]);
    assert!(case.off_mm(&answer) < 2.0, "{}", case.off_mm(&answer));
    assert_eq!(answer["verdict"]["measured"]["sensor"]["name"], "depth_camera");
    // What is believed of it is told, and nothing of a sensor that changes nothing.
    let assumption = "the scan was measured with a depth camera, as stated: errors of 1.5 mm";
    assert!(answer["verdict"]["assumptions"].to_string().contains(assumption), "{}", answer["verdict"]);
    let laser = case.answer("bone.stl", "scan.ply", &["--sensor", "laser"]);
    assert!(!laser["verdict"]["assumptions"].to_string().contains("as stated"), "{}", laser["verdict"]);
    // By shape, the graph of two files takes the same.
    the_same_both_ways(&case, ["bone.stl", "coarse.xyz"], &stated);
    // A file states the same; its numbers count, and a wrong key is named with its line.
    case.write("camera.toml", "like = \"depth_camera\"\n");
    assert_eq!(case.answer("bone.stl", "coarse.xyz", &["--sensor", "camera.toml"])["T"], answer["T"]);
    case.write("fine.toml", "patch_mm = 0.1\nnoise_mm = 0.1\n");
    let fine =
        case.register(&["bone.stl", "coarse.xyz", "--init", "init.txt", "--sensor", "fine.toml", "--format", "json"]);
    assert_ne!(last_line(&fine)["verdict"]["answer"], "trusted");
    case.write("wrong.toml", "like = \"depth_camera\"\npach_mm = 0.1\n");
    let fault = case.fault(1, &["bone.stl", "coarse.xyz", "--sensor", "wrong.toml"]);
    assert!(fault.contains("wrong.toml: line 2") && fault.contains("pach_mm"), "{fault}");
    let fault = case.fault(2, &["bone.stl", "coarse.xyz", "--sensor", "kinect"]);
    assert!(fault.contains("\"kinect\", which is no file and none of structured_light, laser"), "{fault}");
    // Limits that a graph sets to less than the sensor attains make it doubtful by name; `register` sets none.
    let files = [("bone", "bone.stl"), ("scan", "coarse.xyz")];
    let path = |name: &str| toml::Value::from(case.path(name).display().to_string());
    let mut sets: Vec<String> = files.map(|(node, name)| format!("{node}.path={}", path(name))).to_vec();
    sets.extend(["ct_surface.sensor.like=depth_camera".into(), "verdict.rules.limits.max_tre_mm=3.0".into()]);
    let (_, _, results) = run_two_files(&case, &sets);
    let reasons = results["verdict"]["reasons"].to_string();
    assert!(reasons.contains("the limits ask for 3.0 mm, and a depth camera errs by 5.0 mm (95 %)"), "{reasons}");
    assert_eq!(results["verdict"]["answer"], "doubtful", "{reasons}");
    // What was measured finely is not excused, and another bone is none of the sensor's errors.
    let fine = case.answer("bone.stl", "scan.ply", &["--sensor", "depth_camera"]);
    let rules = fine["verdict"]["reasons"].to_string();
    assert!(fine["verdict"]["answer"] == "doubtful" && rules.contains("\"sensor\""), "{rules}");
}

#[test]
fn the_ball_of_a_tip_is_taken_off_where_it_is_stated() {
    let case = Case::new();
    let seen = sample::surface(&bone::fibula(&BoneParams::default()), 24_000, &mut ChaCha8Rng::seed_from_u64(2));
    let height_mm = |p: &Point3<f64>| {
        let anatomy = bone::anatomy(&BoneParams::default());
        (p - anatomy.malleolus_tip).dot(&anatomy.proximal)
    };
    let mut text = String::new();
    for (p, normal) in seen.points.iter().zip(&seen.normals).filter(|(p, _)| (0.0..150.0).contains(&height_mm(p))) {
        let at = case.t_target_source.inverse() * (p + normal * 1.0);
        writeln!(text, "{:?} {:?} {:?}", at.x, at.y, at.z).unwrap();
    }
    case.write("touched.xyz", &text);
    let median = |tip: &str| {
        let answer = case.answer("bone.stl", "touched.xyz", &["--sensor", "stylus", "--tip-radius-mm", tip]);
        (answer["verdict"]["measured"]["median_mm"].as_f64().unwrap(), case.off_mm(&answer))
    };
    let (stated, off_mm) = median("1.0");
    assert!(stated < 0.05 && off_mm < 0.2, "{stated}, {off_mm}");
    let [(unstated, _), (inverse, _)] = ["0", "-1.0"].map(median);
    assert!((unstated - 1.0).abs() < 0.1 && (inverse - 2.0).abs() < 0.2, "{unstated}, {inverse}");
}

#[test]
fn a_ct_is_read_alike_by_register_and_by_the_graph_with_a_threshold_and_without() {
    let Some(volume) = common::data("a CT both ways", "medical/tlem2r_distal_ct.nii.gz") else { return };
    let Some(mr) = common::data("a CT both ways", "medical/nibabel_anatomical.nii") else { return };
    let Some(mesh) = common::data("a CT both ways", "bones/TLEM2_CT_fibula_r.stl") else { return };
    let case = Case::new();
    let mesh = read_mesh(&mesh, 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
    let seen = sample::surface(&mesh, 90_000, &mut ChaCha8Rng::seed_from_u64(8));
    let side = seen.points.iter().zip(&seen.normals).filter(|(p, n)| (-1000.0..-900.0).contains(&p.z) && n.x > 0.2);
    let side: Vec<Point3<f64>> = side.map(|(p, _)| *p).collect();
    write_ply(&case.path("ct_scan.ply"), &Cloud::new("camera", side).unwrap(), 1.0).unwrap();
    let [volume, mr] = [volume, mr].map(|path| path.to_str().unwrap().to_owned());
    let suggested = the_same_both_ways(&case, [&volume, "ct_scan.ply"], &[]);
    let assumption = "bone begins at 620 HU, which the volume suggests and nobody gave; the surface moves with it";
    assert!(suggested["verdict"]["assumptions"].to_string().contains(assumption), "{}", suggested["verdict"]);
    let given = [("--threshold-hu", "600", "bone.threshold_hu=600.0")];
    let given = the_same_both_ways(&case, [&volume, "ct_scan.ply"], &given);
    assert!(!given["verdict"]["assumptions"].to_string().contains("bone begins at"), "{}", given["verdict"]);
    let refused = the_same_both_ways(&case, [&mr, "ct_scan.ply"], &[]);
    assert!(refused["refused"]["reason"].as_str().unwrap().starts_with("threshold_hu is not given"), "{refused}");
}

#[test]
fn nothing_is_overwritten() {
    let case = Case::new();
    for option in ["--out", "--trace"] {
        case.write("mine.txt", "mine");
        let stderr = case.fault(2, &["points.ply", "scan.ply", "--init", "init.txt", option, "mine.txt"]);
        assert_eq!(stderr, "error: mine.txt exists already; name another file, nothing is overwritten\n");
        assert_eq!(fs::read_to_string(case.path("mine.txt")).unwrap(), "mine");
    }
}

#[test]
fn a_trace_holds_every_step_and_ends_at_the_pose() {
    let case = Case::new();
    let answer = case.answer("points.ply", "scan.ply", &["--trace", "steps.csv", "--out", "pose.txt"]);
    let text = fs::read_to_string(case.path("steps.csv")).unwrap();
    let lines: Vec<_> = text.lines().collect();
    assert!(lines[0].starts_with("iteration,every,n_pairs,rms_mm,step_mm,step_rad,"), "{}", lines[0]);
    assert!(lines[0].ends_with("t_00,t_01,t_02,t_03,t_10,t_11,t_12,t_13,t_20,t_21,t_22,t_23"), "{}", lines[0]);
    assert_eq!(lines.len() as u64, answer["iterations"].as_u64().unwrap() + 1);
    let columns = lines[0].split(',').count();
    assert!(lines.iter().all(|line| line.split(',').count() == columns));
    let pose = fs::read_to_string(case.path("pose.txt")).unwrap();
    assert!(pose.starts_with("# takes scan.ply to points.ply: 4 x 4, row by row, mm\n"), "{pose}");
    let written: Vec<f64> = pose.lines().skip(2).flat_map(str::split_whitespace).map(|c| c.parse().unwrap()).collect();
    assert_eq!(Value::from(written), answer["T"]);
}

#[test]
fn the_text_holds_pose_convergence_and_timings() {
    let case = Case::new();
    let output = case.register(&["points.ply", "scan.ply", "--init", "init.txt", "-v"]);
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    for expected in [
        "steps  every  n_pairs",
        "research use only, not for clinical use\n",
        "target  points.ply, 30000 points with normals\n",
        "method  point_to_plane, pairing ",
        "t_target_source, mm\n",
        "  converged     yes: the remaining distance is below stop_step_mm\n",
        "  undetermined  nothing; weakest is ",
        "  prep_target ",
    ] {
        assert!(text.contains(expected), "{expected}\n{text}");
    }
    assert_eq!(stderr_of(&output), "");
    let quiet = case.register(&["points.ply", "scan.ply", "--init", "init.txt", "-q", "--max-iterations", "1"]);
    assert_eq!(stderr_of(&quiet), "", "-q leaves answers and errors");
    assert!(String::from_utf8(quiet.stdout).unwrap().contains("converged     NO: max_iterations are used up"));
}

#[test]
fn with_a_camera_points_pair_only_with_the_side_that_it_saw() {
    let case = Case::new();
    let anatomy = bone::anatomy(&BoneParams::default());
    let camera = anatomy.malleolus_tip + anatomy.proximal.scale(75.0) + anatomy.lateral.scale(300.0);
    let camera = case.t_target_source.inverse() * camera;
    let camera = format!("{},{},{}", camera.x, camera.y, camera.z);
    let answer = case.answer("points.ply", "scan.ply", &["--camera", &camera, "--max-pair-distance-mm", "10"]);
    assert!(case.off_mm(&answer) < 0.05, "{} mm", case.off_mm(&answer));
    assert!(answer["source"]["camera"].is_array());
}

/// A socket with an overhanging rim, open towards z and wound towards a camera there, and a scan of its bottom.
fn socket() -> (Mesh, Vec<Point3<f64>>) {
    let (rings, around) = (80_u32, 160_u32);
    let place = |tilt: f64, turn: f64| {
        let radius = 25.0
            + 1.2 * (3.0 * turn + 0.4).sin() * tilt.sin().powi(2)
            + 0.9 * (2.0 * turn - 1.0).cos() * (2.0 * tilt).sin()
            + 0.5 * (5.0 * tilt).sin();
        Point3::from(Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), -tilt.cos()) * radius)
    };
    let turn = |j: u32| f64::from(j) / f64::from(around) * std::f64::consts::TAU;
    let vertices: Vec<_> =
        (0..rings * around).map(|k| place(0.02 + f64::from(k / around) * 0.0244, turn(k % around))).collect();
    let mut faces = Vec::new();
    for (i, j) in (0..rings - 1).flat_map(|i| (0..around).map(move |j| (i, j))) {
        let [a, b] = [i * around + j, i * around + (j + 1) % around];
        faces.extend([[a, a + around, b], [b, a + around, b + around]]);
    }
    let mesh = Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap();
    assert!(mesh.area_vector(0).z > 0.0, "towards the camera");
    let n = 6000;
    let scan = (0..n).map(|k| {
        let share = (f64::from(k) + 0.5) / f64::from(n);
        place((1.0 - share * (1.0 - 1.1_f64.cos())).acos(), 2.399_963 * f64::from(k))
    });
    (mesh, scan.collect())
}

#[test]
fn a_big_scan_is_thinned_with_a_note_and_its_pose_moves_by_less_than_its_standard_error() {
    let case = Case::new();
    let (mesh, _) = socket();
    let seen = sample::surface(&mesh, 260_000, &mut ChaCha8Rng::seed_from_u64(7));
    let mut noise = 0.5_f64;
    let mut next = || {
        // Evenly spread, as the square root of 3 is irrational.
        noise = (noise + 3_f64.sqrt()).fract();
        0.2 * (noise - 0.5)
    };
    let points: Vec<_> = seen.points.iter().zip(&seen.normals).map(|(p, n)| p + n * next()).collect();
    write_stl(&case.path("socket.stl"), &mesh).unwrap();
    write_ply(&case.path("big.ply"), &Cloud::new("camera", points.clone()).unwrap(), 1.0).unwrap();
    let answer = |more: &[&str]| {
        let all = [&["socket.stl", "big.ply", "--init", "identity", "--format", "json"], more].concat();
        let output = case.register(&all);
        assert_eq!(output.status.code(), Some(0), "{all:?}: {}", stderr_of(&output));
        last_line(&output)
    };
    let (few, all) = (answer(&[]), answer(&["--max-points", "0"]));
    let note = "big.ply: 1 in 3 of 260000 points is used, 86667 in all: more would move the pose by less than its standard error; \
                --max-points 0 takes all";
    assert!(few["notes"].as_array().unwrap().contains(&note.into()), "{}", few["notes"]);
    assert!(!all["notes"].to_string().contains("is used"), "{}", all["notes"]);
    let spread_mm = few["verdict"]["measured"]["spread_mm"].as_f64().unwrap();
    let apart_mm = points.iter().map(|p| (pose(&few) * p - pose(&all) * p).norm()).fold(0.0, f64::max);
    assert!(apart_mm > 0.0 && apart_mm < spread_mm, "{apart_mm} mm apart, standard error {spread_mm} mm");
}

#[test]
fn points_picked_above_a_surface_through_the_origin_are_not_said_to_be_in_micrometres() {
    let case = Case::new();
    let height = |x: f64, y: f64| 3.0 * (x / 9.0).sin() * (y / 11.0).cos();
    let at = |k: i32| (f64::from(k % 81 - 40), f64::from(k / 81 - 40));
    let sheet: Vec<_> = (0..6561).map(at).map(|(x, y)| Point3::new(x, y, height(x, y))).collect();
    write_ply(&case.path("sheet.ply"), &Cloud::new("ct", sheet.clone()).unwrap(), 1.0).unwrap();
    let rows = |dz: f64, unit: f64| {
        let row = |(name, k): (usize, &usize)| {
            let p = sheet[*k];
            format!("P{name},{},{},{}\n", p.x * unit, p.y * unit, (p.z + dz) * unit)
        };
        "label,x,y,z\n".to_owned() + &[400, 2000, 4100, 6000].iter().enumerate().map(row).collect::<String>()
    };
    let message = |target: &str| {
        fs::write(case.path("target.csv"), target).unwrap();
        fs::write(case.path("source.csv"), rows(0.0, 1.0)).unwrap();
        let output =
            case.register(&["sheet.ply", "sheet.ply", "--landmarks", "target.csv", "source.csv", "--no-cache"]);
        stderr_of(&output)
    };
    let off = message(&rows(4.0, 1.0));
    assert!(off.contains("off its surface; were they picked on this surface?"), "{off}");
    assert!(message(&rows(0.0, 1000.0)).contains("they are in micrometres"), "{}", message(&rows(0.0, 1000.0)));
}

#[test]
fn the_true_camera_keeps_the_right_answer_on_a_socket_and_names_one_that_is_inside_out() {
    let case = Case::new();
    let (mesh, scan) = socket();
    let turned: Vec<[u32; 3]> = mesh.faces().iter().map(|&[a, b, c]| [a, c, b]).collect();
    let turned = Mesh::new("ct", SurfaceOrigin::Exact, mesh.vertices().to_vec(), turned).unwrap();
    write_stl(&case.path("socket.stl"), &mesh).unwrap();
    write_stl(&case.path("turned.stl"), &turned).unwrap();
    write_ply(&case.path("socket.ply"), &Cloud::new("ct", mesh.vertices().to_vec()).unwrap(), 1.0).unwrap();
    let t_scan = Isometry3::new(Vector3::new(40.0, 90.0, 600.0), Vector3::new(2.0, 0.3, -0.5));
    let moved: Vec<_> = scan.iter().map(|p| t_scan * p).collect();
    write_ply(&case.path("socket_scan.ply"), &Cloud::new("camera", moved.clone()).unwrap(), 1.0).unwrap();
    let camera = t_scan * Point3::new(0.0, 0.0, 150.0);
    let camera = format!("{},{},{}", camera.x, camera.y, camera.z);
    for target in ["socket.stl", "turned.stl", "socket.ply"] {
        for with_camera in [false, true] {
            let camera: &[&str] = if with_camera { &["--camera", &camera] } else { &[] };
            let all = [&[target, "socket_scan.ply", "--no-cache", "--format", "json"], camera].concat();
            let output = case.register(&all);
            if target == "turned.stl" && with_camera {
                assert_eq!(output.status.code(), Some(3), "{all:?}: {}", stderr_of(&output));
                let message = stderr_of(&output);
                let remedy = "Flip its faces (in MeshLab: Invert Faces Orientation), or leave the camera out";
                assert!(
                    message.contains("an open surface that is inside out") && message.contains(remedy),
                    "{message}"
                );
                continue;
            }
            assert_eq!(output.status.code(), Some(0), "{all:?}: {}", stderr_of(&output));
            let registered = pose(&last_line(&output)) * t_scan;
            let off_mm = scan.iter().map(|p| (registered * p - p).norm()).fold(0.0, f64::max);
            assert!(off_mm < 0.2, "{all:?}: {off_mm} mm");
        }
    }
    // As large as a room in metres would be, in its own frame and on itself.
    write_ply(&case.path("at_origin.ply"), &Cloud::new("ct", scan).unwrap(), 1.0).unwrap();
    for target in ["socket.stl", "socket.ply"] {
        let message = stderr_of(&case.register(&[target, "at_origin.ply", "--no-cache"]));
        assert!(!message.contains("metres"), "{target}: {message}");
    }
}

#[test]
fn a_prepared_target_is_read_from_the_store_and_gives_the_same_bits() {
    let case = Case::new();
    let answer = |target: &str, more: &[&str]| {
        let answer = case.answer(target, "scan.ply", &[&["--target-points", "20000"], more].concat());
        (answer["target"]["from_store"].as_bool().unwrap(), answer)
    };
    for target in ["bone.stl", "points.ply", "bare.ply"] {
        let (cold, warm) = (answer(target, &[]), answer(target, &[]));
        assert_eq!((cold.0, warm.0), (false, true), "{target}");
        for key in ["T", "rms_mm", "n_pairs", "report", "notes"] {
            assert_eq!(cold.1[key], warm.1[key], "{target}: {key}");
        }
        for key in ["n_points", "n_faces", "normals", "normals_estimated"] {
            assert_eq!(cold.1["target"][key], warm.1["target"][key], "{target}: {key}");
        }
    }
    for (more, from_store, why) in [
        (&["--no-cache"][..], false, "it was not to be asked"),
        (&["--seed", "3"], false, "other points"),
        (&["--target-unit-mm", "1.01", "--max-pair-distance-mm", "1000"], false, "another size"),
        (&["--method", "point_to_mesh"], true, "the triangles are kept, too"),
        (&["--pairing", "tree"], true, "the same, but for the tree"),
    ] {
        assert_eq!(answer("bone.stl", more).0, from_store, "{why}");
    }
    let mut bytes = fs::read(case.path("bone.stl")).unwrap();
    // The lowest bit of a coordinate.
    bytes[84 + 12] ^= 1;
    fs::write(case.path("bone.stl"), bytes).unwrap();
    assert!(!answer("bone.stl", &[]).0, "another file of that name");

    let drawn = sample::surface(&bone::fibula(&BoneParams::default()), 5000, &mut ChaCha8Rng::seed_from_u64(1));
    let mut odd = String::from("x,y,z\nnan,nan,nan\n");
    drawn.points.iter().for_each(|p| writeln!(odd, "{:?},{:?},{:?}", p.x, p.y, p.z).unwrap());
    case.write("odd.csv", &odd);
    for is_second in [false, true] {
        let (from_store, answer) = answer("odd.csv", &[]);
        assert_eq!(from_store, is_second);
        assert!(answer["notes"].to_string().contains("not finite"), "it is said every time");
    }
}
