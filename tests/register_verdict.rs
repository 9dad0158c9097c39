//! The verdict of `osteoflow register`: a sound pose is trusted, and no wrong one is.

use crate::common::{is_slow_run, osteoflow, shared_folder};
use osteoflow_algorithms::sample;
use osteoflow_formats::write::{write_ply, write_stl};
use osteoflow_geometry::{
    Anatomy, Cloud, isometry_from_matrix, matrix_rows,
    nalgebra::{Isometry3, Matrix4, Point3, Translation3, UnitQuaternion, Vector3},
};
use osteoflow_node::rand::RngExt;
use osteoflow_simulation::{BoneParams, Subject, bone};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::Value;
use std::{fs, process::Output, sync::LazyLock};

/// Half the width of the scan's uniform noise, mm: a structured-light camera's.
const NOISE_MM: f64 = 0.1;

/// The built-in bone, its mirror image and another bone as surfaces; a scan of the lateral side of the distal half.
struct Case {
    dir: tempfile::TempDir,
    t_target_source: Isometry3<f64>,
    anatomy: Anatomy,
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
        Self { dir, t_target_source: MADE.t_target_source, anatomy: MADE.anatomy.clone(), scan: MADE.scan.clone() }
    }

    fn made() -> Self {
        let dir = tempfile::tempdir_in(shared_folder()).unwrap();
        let params = BoneParams::default();
        let bones = [
            ("bone.stl", params.clone()),
            ("mirrored.stl", BoneParams { mirrored: true, ..params.clone() }),
            ("another.stl", BoneParams { shape_seed: 5, ..params.clone() }),
        ];
        for (name, params) in bones {
            let subject = Subject::built_in(&params).unwrap();
            write_stl(&dir.path().join(name), subject.surface.mesh()).unwrap();
        }
        let (mesh, anatomy) = (bone::fibula(&params), bone::anatomy(&params));
        let t_target_source = Isometry3::new(Vector3::new(120.0, -340.0, 900.0), Vector3::new(0.4, -1.1, 2.0));
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let seen = sample::surface(&mesh, 40_000, &mut rng);
        let side = seen.points.iter().zip(&seen.normals).filter(|(p, n)| {
            let height_mm = (**p - anatomy.malleolus_tip).dot(&anatomy.proximal);
            (0.0..150.0).contains(&height_mm) && n.dot(&anatomy.lateral) > 0.2
        });
        let scan: Vec<Point3<f64>> = side
            .map(|(p, n)| t_target_source.inverse() * (p + n.scale(NOISE_MM * (2.0 * rng.random::<f64>() - 1.0))))
            .collect();
        let cloud = Cloud::new("camera", scan.clone()).unwrap();
        write_ply(&dir.path().join("scan.ply"), &cloud, 1.0).unwrap();
        write_ply(&dir.path().join("scan_in_metres.ply"), &cloud, 1000.0).unwrap();
        let points = sample::surface(&mesh, 30_000, &mut ChaCha8Rng::seed_from_u64(1)).points;
        write_ply(&dir.path().join("bare.ply"), &Cloud::new("ct", points).unwrap(), 1.0).unwrap();
        let case = Self { dir, t_target_source, anatomy, scan };
        case.start("init.txt", &(case.off(Vector3::new(1.5, -1.0, 2.0), Vector3::new(0.01, -0.02, 0.03))));
        case
    }

    /// The middle of the scan where it belongs.
    fn centre(&self) -> Point3<f64> {
        let sum: Vector3<f64> = self.scan.iter().map(|p| p.coords).sum();
        self.t_target_source * Point3::from(sum / self.scan.len() as f64)
    }

    /// The true pose, shifted and turned about the middle of the scan.
    fn off(&self, shift: Vector3<f64>, turn: Vector3<f64>) -> Isometry3<f64> {
        let centre = Translation3::from(self.centre());
        centre * Isometry3::new(shift, turn) * centre.inverse() * self.t_target_source
    }

    fn start(&self, name: &str, t: &Isometry3<f64>) {
        let text = matrix_rows(t).map(|row| row.map(|c| format!("{c:?}")).join(" ") + "\n").concat();
        fs::write(self.dir.path().join(name), text).unwrap();
    }

    fn register(&self, arguments: &str) -> Output {
        let mut command = osteoflow();
        command.current_dir(self.dir.path()).env("OSTEOFLOW_CACHE", self.dir.path().join("store")).arg("register");
        command.args(arguments.split(' ')).output().unwrap()
    }

    /// Exit code and JSON.
    fn json(&self, arguments: &str) -> (Option<i32>, Value) {
        let output = self.register(&format!("{arguments} --format json"));
        let answer = serde_json::from_slice(&output.stdout);
        (output.status.code(), answer.unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr))))
    }

    /// Mean distance of the scan from its true position, mm.
    fn off_mm(&self, answer: &Value) -> f64 {
        let numbers: Vec<f64> = answer["T"].as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).collect();
        let found = isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap();
        let sum: f64 = self.scan.iter().map(|p| (found * p - self.t_target_source * p).norm()).sum();
        sum / self.scan.len() as f64
    }
}

fn answer_of(answer: &Value) -> &str {
    answer["verdict"]["answer"].as_str().unwrap_or_else(|| panic!("no verdict: {answer}"))
}

fn rules_of(answer: &Value) -> Vec<&str> {
    answer["verdict"]["reasons"].as_array().unwrap().iter().map(|reason| reason["rule"].as_str().unwrap()).collect()
}

#[test]
fn a_sound_pose_is_trusted_by_every_method_and_the_verdict_comes_first() {
    let case = Case::new();
    for (target, method) in [
        ("bone.stl", "point_to_plane"),
        ("bone.stl", "symmetric"),
        ("bone.stl", "generalized"),
        ("bone.stl", "point_to_mesh"),
        ("bare.ply", "point_to_plane"),
    ] {
        let arguments = format!("{target} scan.ply --init init.txt --method {method} --require trusted");
        let (code, answer) = case.json(&arguments);
        assert_eq!((code, answer_of(&answer)), (Some(0), "trusted"), "{arguments}: {}", answer["verdict"]);
        assert!(case.off_mm(&answer) < 0.1, "{arguments}: {} mm; the noise is 0.06 mm RMS", case.off_mm(&answer));
        assert_eq!(answer.as_object().unwrap().keys().next().unwrap(), "verdict");
        assert!(answer["verdict_ms"].is_number() && answer["verdict"]["predicted"].is_null(), "{answer}");
    }
    let text = String::from_utf8(case.register("bone.stl scan.ply --init init.txt").stdout).unwrap();
    assert!(text.starts_with("verdict  trusted: no sign against it was found\n"), "{text}");
    assert!(text.contains(", verdict "), "the time that it took\n{text}");
    let verbose = String::from_utf8(case.register("bone.stl scan.ply --init init.txt -v").stdout).unwrap();
    for assumed in ["the scan shows the bone's surface as segmented.", "the scan does not say where the camera was"] {
        assert!(verbose.contains(&format!("  assumed: {assumed}")), "{assumed}\n{verbose}");
    }
    for of_others in ["marker", "the plan as drawn"] {
        assert!(!verbose.contains(of_others), "{of_others} is assumed, and none was given\n{verbose}");
    }
}

#[test]
fn no_wrong_pose_is_trusted() {
    let case = Case::new();
    let shift = |mm: f64| case.off(case.anatomy.proximal.scale(mm), Vector3::zeros());
    case.start("along_12.txt", &shift(12.0));
    case.start("along_60.txt", &shift(60.0));
    let axis = case.anatomy.proximal.into_inner();
    case.start("turned.txt", &case.off(Vector3::zeros(), axis * 2.2));
    case.start("inverted.txt", &case.t_target_source.inverse());
    // An inverse about the bone itself, which starts near it.
    let about = Translation3::from(case.centre());
    let turn = UnitQuaternion::new(Vector3::new(0.1, 0.3, -0.2));
    case.start("back.txt", &(about * turn * turn * about.inverse() * case.t_target_source));
    // A scan in metres is a speck: here it begins on the bone.
    let speck = Point3::from(case.scan.iter().map(|p| p.coords).sum::<Vector3<f64>>() / case.scan.len() as f64 / 1e3);
    let on_bone = case.t_target_source * case.scan[0];
    let rotation = case.t_target_source.rotation;
    case.start("speck.txt", &Isometry3::from_parts(Translation3::from(on_bone - rotation * speck), rotation));
    for (arguments, answer, rule) in [
        ("mirrored.stl scan.ply --init init.txt", "refused", "inward_misfit"),
        ("another.stl scan.ply --init init.txt", "doubtful", "inside"),
        (
            "bone.stl scan.ply --init along_12.txt --method point_to_point --stop fixed --max-iterations 1",
            "refused",
            "inward_misfit",
        ),
        ("bone.stl scan.ply --init along_12.txt --method published --set reading=change_0.01", "refused", "shape"),
        ("bone.stl scan.ply --init along_60.txt", "refused", "shape"),
        ("bone.stl scan.ply --init turned.txt", "refused", "shape"),
        ("bone.stl scan.ply --init inverted.txt", "refused", "failure"),
        ("bone.stl scan_in_metres.ply --init speck.txt", "refused", "extent"),
        ("bone.stl scan.ply --init init.txt --target-unit-mm 0.001", "refused", "failure"),
        // With `SLOW_TESTS`: the same rules in other ways.
        ("mirrored.stl scan.ply --init init.txt --max-pair-distance-mm 20", "refused", "inward_misfit"),
        ("bare.ply scan.ply --init along_12.txt --method published --set reading=change_0.01", "refused", "shape"),
        ("bone.stl scan.ply --init back.txt --method point_to_point", "refused", "shape"),
        ("bone.stl scan_in_metres.ply --init speck.txt --method point_to_point", "refused", "extent"),
    ]
    .into_iter()
    .take(if is_slow_run() { 13 } else { 9 })
    {
        let (code, found) = case.json(arguments);
        let verdict = &found["verdict"];
        let expected = if answer == "refused" { 3 } else { 0 };
        assert_eq!((answer_of(&found), code), (answer, Some(expected)), "{arguments}: {verdict}");
        assert!(rules_of(&found).contains(&rule), "{arguments}: {verdict}");
        assert_eq!(
            (found.get("T").is_none(), found["refused"]["reason"].is_string()),
            (answer == "refused", answer == "refused"),
            "{arguments}: {found}"
        );
    }
}

#[test]
fn a_refused_pose_is_neither_printed_nor_written() {
    let case = Case::new();
    let output = case.register("mirrored.stl scan.ply --init init.txt --out pose.txt --trace steps.csv -v");
    let (text, stderr) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert_eq!(output.status.code(), Some(3));
    assert!(text.starts_with("verdict  refused: the scan's mirror image fits better"), "{text}");
    assert!(!text.contains("t_target_source") && text.contains("  converged  "), "{text}");
    assert!(stderr.contains("refused: the result is refused\n"), "{stderr}");
    assert_eq!((text + &stderr).matches("parts of the scan lie inside").count(), 1, "a reason is printed once");
    let mut written = ["pose.txt", "steps.csv"].into_iter().filter(|file| case.dir.path().join(file).exists());
    assert_eq!(written.next(), None);
}

#[test]
fn a_doubtful_pose_is_given_unless_a_trusted_one_is_required_and_none_is_judged_if_asked_not_to() {
    let case = Case::new();
    let early = "bone.stl scan.ply --init init.txt --max-iterations 1";
    let (code, answer) = case.json(early);
    assert_eq!((code, answer_of(&answer), rules_of(&answer)), (Some(0), "doubtful", vec!["converged"]), "{answer}");
    assert!(answer["T"].is_array());
    let (code, answer) = case.json(&format!("{early} --require trusted"));
    assert_eq!((code, answer_of(&answer), rules_of(&answer)[0]), (Some(3), "refused", "require"), "{answer}");
    assert!(answer.get("T").is_none());
    let reason = answer["refused"]["reason"].as_str().unwrap();
    assert!(
        reason.starts_with("the result is doubtful, and [results] require = \"trusted\": the registration did not"),
        "{reason}"
    );
    let (code, answer) = case.json("mirrored.stl scan.ply --init init.txt --no-verdict");
    assert_eq!((code, answer.get("verdict"), answer["T"].is_array()), (Some(0), None, true));
    let both = case.register("bone.stl scan.ply --init init.txt --no-verdict --require trusted");
    assert_eq!(both.status.code(), Some(2), "nothing is required of what is not judged");
}

#[test]
fn a_scan_with_surroundings_is_refused_or_doubted_by_that_cause_first_with_the_remedy_to_crop_it() {
    let case = Case::new();
    let anatomy = &case.anatomy;
    let across = anatomy.proximal.cross(&anatomy.lateral).normalize();
    // A drape behind the bone, along it or as wide as long.
    for (name, width_mm) in [("along.ply", 60.0), ("wide.ply", 240.0)] {
        let mut points = case.scan.clone();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..30_000 {
            let [u, v, w] = [(); 3].map(|()| rng.random::<f64>());
            let at = anatomy.malleolus_tip + anatomy.proximal.scale(-20.0 + 200.0 * u) - anatomy.lateral.scale(8.0)
                + across * (width_mm * (v - 0.5))
                + anatomy.lateral.scale(4.0 * (12.0 * v).sin() + 0.1 * w);
            points.push(case.t_target_source.inverse() * at);
        }
        write_ply(&case.dir.path().join(name), &Cloud::new("camera", points).unwrap(), 1.0).unwrap();
        let output = case.register(&format!("bone.stl {name}"));
        let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        let first = said.lines().find(|line| line.contains("verdict  ") || line.contains("times as long as wide"));
        let first = first.unwrap_or_else(|| panic!("{name}: {said}"));
        assert!(!first.contains("trusted"), "{name}: {said}");
        assert!(first.contains("surroundings") && first.contains("crop the scan to the bone"), "{name}: {said}");
    }
}
