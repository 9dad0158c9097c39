//! What `osteoflow register` says of a mistake with the camera, a unit, the side or a file, and the exit code with which it ends.

use crate::common::{data, osteoflow, root};
use osteoflow_algorithms::sample;
use osteoflow_formats::{
    mesh_or_cloud::read_mesh,
    write::{write_ply, write_stl},
};
use osteoflow_geometry::{
    Cloud, Mesh, SurfaceOrigin,
    nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3},
};
use osteoflow_node::rand::RngExt;
use osteoflow_simulation::{BoneParams, Subject};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::Value;
use std::{fmt::Write as _, fs};

/// Distance of the camera from the middle of what it sees, mm.
const FAR_MM: f64 = 500.0;

fn built_in(params: BoneParams) -> Mesh {
    Subject::built_in(&params).unwrap().surface.mesh().clone()
}

/// A bone of the shared data; none where they are missing.
fn measured(path: &str) -> Option<Mesh> {
    let path = data("register_messages", path)?;
    Some(read_mesh(&path, 1.0, "ct", SurfaceOrigin::User).unwrap().mesh)
}

/// The middle fifths of a bone along z as seen along `view` by a camera at the origin, which looks along z, with noise of 0.1 mm; and
/// where the camera is.
fn seen(bone: &Mesh, view: [f64; 3], fifths: [f64; 2]) -> (Vec<Point3<f64>>, Isometry3<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let drawn = sample::surface(bone, 40_000, &mut rng);
    let zs = || drawn.points.iter().map(|p| p.z);
    let (low, high) = (zs().fold(f64::INFINITY, f64::min), zs().fold(f64::NEG_INFINITY, f64::max));
    let stretch = fifths.map(|fifth| low + fifth / 5.0 * (high - low));
    let view = Vector3::from(view).normalize();
    let there = |p: &Point3<f64>, n: &Vector3<f64>| (stretch[0]..stretch[1]).contains(&p.z) && n.dot(&view) < -0.2;
    let pairs = drawn.points.iter().zip(&drawn.normals).filter(|(p, n)| there(p, n));
    let points: Vec<Point3<f64>> = pairs.map(|(p, _)| p + view * (0.2 * rng.random::<f64>() - 0.1)).collect();
    let middle = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let turn = Rotation3::face_towards(&view, &Vector3::new(0.3, 0.5, 0.81));
    let t = Isometry3::from_parts((middle - view * FAR_MM).into(), UnitQuaternion::from_rotation_matrix(&turn));
    (points.iter().map(|p| t.inverse_transform_point(p)).collect(), t)
}

/// Files in a folder.
struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn bone(&self, name: &str, mesh: &Mesh) {
        write_stl(&self.0.path().join(name), mesh).unwrap();
    }

    fn scan(&self, name: &str, points: &[Point3<f64>]) {
        write_ply(&self.0.path().join(name), &Cloud::new("camera", points.to_vec()).unwrap(), 1.0).unwrap();
    }

    /// Named points, times a factor.
    fn picks(&self, name: &str, points: &[Point3<f64>], factor: f64) {
        let mut text = String::from("label,x,y,z\n");
        for (k, p) in points.iter().map(|p| p * factor).enumerate() {
            writeln!(text, "P{},{:?},{:?},{:?}", k + 1, p.x, p.y, p.z).unwrap();
        }
        fs::write(self.0.path().join(name), text).unwrap();
    }

    /// Exit code and stderr of a registration, and its answer if it is one.
    fn register(&self, arguments: &str) -> (Option<i32>, String, Value) {
        let mut command = osteoflow();
        command.current_dir(self.0.path()).env("OSTEOFLOW_CACHE", self.0.path().join("store")).arg("register");
        let output = command.args(arguments.split(' ')).args(["--format", "json"]).output().unwrap();
        let answer = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code(), String::from_utf8(output.stderr).unwrap(), answer)
    }
}

/// The rule, the reason and the remedy of the first sign.
fn first(answer: &Value) -> [&str; 3] {
    ["rule", "reason", "remedy"].map(|key| answer["verdict"]["reasons"][0][key].as_str().unwrap_or_default())
}

fn has_rule(answer: &Value, rule: &str) -> bool {
    answer["verdict"]["reasons"].as_array().unwrap().iter().any(|reason| reason["rule"] == rule)
}

#[test]
fn a_camera_on_the_far_side_is_named_with_where_it_may_be_and_one_of_another_bone_is_not() {
    let files = Files::new();
    let measured_bones = [
        ("bones/MC22_fibula_r.stl", [1.0, 0.3, 0.0], [1.0, 3.0]),
        ("real/hip/preoperative_specimen01_right_femur.stl", [0.2, -1.0, 0.4], [0.0, 5.0]),
        ("bones/myosim_jaw.stl", [-0.4, 0.5, -1.0], [0.0, 5.0]),
    ];
    let measured_bones =
        measured_bones.into_iter().filter_map(|(path, view, fifths)| Some((measured(path)?, view, fifths)));
    let bones = [(built_in(BoneParams::default()), [0.3, 1.0, 0.0], [0.5, 2.5])].into_iter().chain(measured_bones);
    for (k, (bone, view, fifths)) in bones.enumerate() {
        files.bone("bone.stl", &bone);
        let (points, _) = seen(&bone, view, fifths);
        files.scan("scan.ply", &points);
        let (code, stderr, answer) = files.register("bone.stl scan.ply --camera 0,0,0");
        assert!(code == Some(0) && !has_rule(&answer, "camera"), "bone {k}: {stderr}{}", answer["verdict"]);
        // A scan about its own middle, whose camera is at z = -500 mm.
        let centred: Vec<Point3<f64>> = points.iter().map(|p| p - Vector3::z() * FAR_MM).collect();
        files.scan("centred.ply", &centred);
        for (scan, camera, other) in [("scan.ply", "0,0,1000", "0,0,0"), ("centred.ply", "0,0,500", "0,0,-500")] {
            let (code, stderr, answer) = files.register(&format!("bone.stl {scan} --camera {camera}"));
            let [rule, reason, remedy] = first(&answer);
            assert_eq!((code, rule), (Some(3), "camera"), "bone {k}, {scan}: {stderr}{}", answer["verdict"]);
            let begins = format!("the camera, stated at {camera} mm, lies on the far side of the scan: ");
            assert!(reason.starts_with(&begins) && reason.contains("Without it the scan fits"), "bone {k}: {reason}");
            let advice = format!("state where it was, such as {other}, or leave it out (register: --camera;");
            assert!(remedy.starts_with(&advice), "bone {k}: {remedy}");
        }
        // A start near the right pose does not hide it.
        if k == 0 {
            let (_, t) = seen(&bone, view, fifths);
            let text = t.to_homogeneous().transpose().iter().map(|c| format!("{c:?} ")).collect::<String>();
            fs::write(files.0.path().join("init.txt"), text).unwrap();
            let (code, _, answer) = files.register("bone.stl scan.ply --camera 0,0,1000 --init init.txt");
            assert_eq!((code, first(&answer)[0]), (Some(3), "camera"), "{}", answer["verdict"]);
        }
    }
}

#[test]
fn a_right_camera_is_not_blamed_for_another_bone_nor_for_the_wrong_part_of_one() {
    let files = Files::new();
    let fibulas = [
        ("bones/MC22_fibula_r.stl", "bones/TLEM2_CT_fibula_r.stl"),
        ("bones/TLEM2_CT_fibula_r.stl", "bones/MC22_fibula_r.stl"),
    ];
    let femur = "real/hip/preoperative_specimen01_right_femur.stl";
    let pairs = fibulas
        .into_iter()
        .chain([(femur, "real/hip/preoperative_specimen00_left_femur.stl"), (femur, "bones/myosim_jaw.stl")]);
    let measured_pairs = pairs.filter_map(|(bone, other)| Some((measured(bone)?, measured(other)?)));
    let all = [
        (built_in(BoneParams::default()), built_in(BoneParams { shape_seed: 5, ..BoneParams::default() })),
        (built_in(BoneParams::default()), built_in(BoneParams { mirrored: true, ..BoneParams::default() })),
    ]
    .into_iter()
    .chain(measured_pairs);
    for (k, (bone, other)) in all.enumerate() {
        files.bone("bone.stl", &bone);
        let (points, _) = seen(&other, [1.0, 0.4, 0.1], [1.0, 4.0]);
        files.scan("scan.ply", &points);
        let (_, _, answer) = files.register("bone.stl scan.ply --camera 0,0,0");
        let verdict = &answer["verdict"];
        assert!(verdict["answer"] != "trusted" && !has_rule(&answer, "camera"), "pair {k}: {verdict}");
    }
}

#[test]
fn a_mirrored_bone_is_named_first_with_what_to_do() {
    let files = Files::new();
    let paths = ["bones/TLEM2_CT_fibula_r.stl", "real/hip/preoperative_specimen00_left_femur.stl"];
    for (k, bone) in
        [built_in(BoneParams::default())].into_iter().chain(paths.into_iter().filter_map(measured)).enumerate()
    {
        let negated: Vec<_> = bone.vertices().iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect();
        let faces = bone.faces().iter().map(|&[a, b, c]| [a, c, b]).collect::<Vec<_>>();
        files.bone("mirrored.stl", &Mesh::new("ct", SurfaceOrigin::User, negated, faces).unwrap());
        files.scan("scan.ply", &seen(&bone, [1.0, 0.6, 0.1], [0.5, 4.0]).0);
        for camera in ["", " --camera 0,0,0"] {
            let (code, stderr, answer) = files.register(&format!("mirrored.stl scan.ply{camera}"));
            let [rule, reason, remedy] = first(&answer);
            assert_eq!((code, rule), (Some(3), "mirrored"), "bone {k}{camera}: {stderr}{}", answer["verdict"]);
            assert!(reason.starts_with("the scan's mirror image fits better"), "{reason}");
            assert!(remedy.starts_with("take the CT of the side that was scanned"), "{remedy}");
        }
    }
}

/// The built-in bone, a scan of it with the camera at the origin, and points of the scan that lie far apart, in both frames.
fn picked() -> (Files, [Vec<Point3<f64>>; 2], Isometry3<f64>) {
    let (files, bone) = (Files::new(), built_in(BoneParams::default()));
    let (points, t) = seen(&bone, [0.3, 1.0, 0.0], [0.5, 2.5]);
    files.bone("bone.stl", &bone);
    files.scan("scan.ply", &points);
    let extreme = |of: fn(&Point3<f64>) -> f64| *points.iter().max_by(|a, b| of(a).total_cmp(&of(b))).unwrap();
    let in_scan = vec![extreme(|p| p.x), extreme(|p| -p.x), extreme(|p| p.y), extreme(|p| -p.y)];
    let on_bone = in_scan.iter().map(|p| t * p).collect();
    (files, [on_bone, in_scan], t)
}

#[test]
fn landmarks_in_another_unit_are_named_with_what_was_seen_and_the_command_that_mends_them() {
    let (files, [on_bone, in_scan], _) = picked();
    files.picks("bone.csv", &on_bone, 1.0);
    files.picks("scan.csv", &in_scan, 1.0);
    for (unit_mm, name) in [(1000.0, "metres"), (10.0, "cm"), (25.4, "inches")] {
        files.picks("small_bone.csv", &on_bone, 1.0 / unit_mm);
        files.picks("small_scan.csv", &in_scan, 1.0 / unit_mm);
        let mends = format!("osteoflow convert POINTS OUT.csv --scale {unit_mm}");
        for (target, source, side) in
            [("small_bone.csv", "scan.csv", "target"), ("bone.csv", "small_scan.csv", "source")]
        {
            let (code, stderr, _) = files.register(&format!("bone.stl scan.ply --landmarks {target} {source}"));
            let line = stderr.lines().last().unwrap();
            assert_eq!(code, Some(3), "{name}: {stderr}");
            assert!(line.starts_with("refused: the target points lie ") && line.ends_with(&mends), "{name}: {stderr}");
            assert!(line.contains(&format!(" mm: are the {side} points in {name}? ")), "{name}: {stderr}");
        }
        // Both lists in one unit have equal distances, but lie off the surface.
        let (code, stderr, _) = files.register("bone.stl scan.ply --landmarks small_bone.csv small_scan.csv");
        let expected =
            format!("{unit_mm} times as large they lie on it: they are in {name}; write them in mm: {mends}");
        assert!(code == Some(3) && stderr.contains(&expected), "{name}: {stderr}");
        // And what the message advises works.
        let mut convert = osteoflow();
        convert.current_dir(files.0.path()).args(["convert", "small_bone.csv", "mended.csv", "--scale"]);
        assert!(convert.arg(unit_mm.to_string()).output().unwrap().status.success());
        let (code, stderr, answer) = files.register("bone.stl scan.ply --landmarks mended.csv scan.csv");
        assert_eq!((code, &answer["verdict"]["answer"]), (Some(0), &"trusted".into()), "{name}: {stderr}");
        fs::remove_file(files.0.path().join("mended.csv")).unwrap();
    }
}

#[test]
fn landmarks_and_targets_that_the_scan_does_not_show_are_named_with_what_follows() {
    let (files, [mut on_bone, mut in_scan], t) = picked();
    files.picks("bone.csv", &on_bone, 1.0);
    files.picks("scan.csv", &in_scan, 1.0);
    let notes = |arguments: &str| {
        let (code, stderr, answer) = files.register(&format!("bone.stl scan.ply {arguments}"));
        assert_eq!(code, Some(0), "{stderr}");
        answer["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let is_unseen = |note: &String| note.starts_with("the scan shows no bone at ");
    let seen_only = notes("--landmarks bone.csv scan.csv --targets bone.csv");
    assert!(!seen_only.iter().any(is_unseen), "{seen_only:?}");
    // The far end of the bone, and the side that the camera did not see.
    let mesh = built_in(BoneParams::default());
    let far = mesh.vertices().iter().max_by(|a, b| a.z.total_cmp(&b.z)).unwrap();
    let from_camera = mesh.vertices().iter().map(|p| t.inverse_transform_point(p));
    let beside = from_camera.filter(|p| p.xy().coords.norm() < 20.0);
    let behind = beside.max_by(|a, b| a.z.total_cmp(&b.z)).unwrap();
    on_bone.extend([*far, t * behind]);
    in_scan.extend([t.inverse() * far, behind]);
    files.picks("bone.csv", &on_bone, 1.0);
    files.picks("scan.csv", &in_scan, 1.0);
    let both = notes("--landmarks bone.csv scan.csv --targets bone.csv");
    let told: Vec<&String> = both.iter().filter(|note| is_unseen(note)).collect();
    let [landmarks, targets] = told[..] else { panic!("{both:?}") };
    for (note, follows) in
        [(landmarks, "only the other landmarks can confirm"), (targets, "the predicted errors hold if")]
    {
        assert!(note.starts_with("the scan shows no bone at P5, P6, up to ") && note.contains(follows), "{note}");
    }
    // Fiducials lie off the scan by nature.
    let fiducials = notes("--fiducials bone.csv scan.csv");
    assert!(!fiducials.iter().any(is_unseen), "{fiducials:?}");
}

#[test]
fn each_exit_code_is_that_of_the_table_in_the_documentation() {
    let (files, [on_bone, in_scan], _) = picked();
    let write = |name: &str, text: &str| fs::write(files.0.path().join(name), text).unwrap();
    files.picks("bone.csv", &on_bone, 1.0);
    files.picks("scan.csv", &in_scan, 1.0);
    let whole = fs::read(files.0.path().join("bone.stl")).unwrap();
    fs::write(files.0.path().join("cut.stl"), &whole[..whole.len() / 2]).unwrap();
    write("empty.stl", "");
    write("words.xyz", "0 0 0\n1 one 1\n");
    write("line.csv", "label,x,y,z\nP1,0,0,0\nP2,0,0,50\nP3,0,0,90\n");
    write("short.txt", "1 0 0 0\n");
    fs::create_dir(files.0.path().join("folder")).unwrap();
    let rows = [
        (0, "bone.stl scan.ply", "there is a pose", ""),
        (1, "no.stl scan.ply", "a file is missing", "no.stl: cannot be read: there is no such file"),
        (1, "bone.stl no.ply", "a file is missing", "no.ply: cannot be read: there is no such file"),
        (1, "bone.stl scan.ply --out no/pose.txt", "cannot be written", "no/pose.txt cannot be written"),
        (1, "bone.stl scan.ply --init short.txt", "`--init`", "short.txt: matrix: 16 numbers"),
        (1, "bone.stl scan.ply --targets words.xyz", "`--targets`", "words.xyz: line 2"),
        (1, "bone.stl scan.ply --sensor words.xyz", "`--sensor`", "words.xyz: line 1"),
        (1, "bone.stl scan.ply --landmarks words.xyz scan.csv", "`--landmarks`", "words.xyz: line 2"),
        (1, "bone.stl scan.ply --fiducials bone.csv words.xyz", "`--fiducials`", "words.xyz: line 2"),
        (2, "bone.stl scan.ply --camera 1,2", "the command line has a fault", "3 finite numbers in mm"),
        (3, "cut.stl scan.ply", "is damaged", "cut.stl: byte 80: no known format, or cut short"),
        (3, "empty.stl scan.ply", "is damaged", "empty.stl: byte 0: the file is empty"),
        (3, "folder scan.ply", "is damaged", "folder: no DICOM image in it"),
        (3, "bone.stl words.xyz", "is damaged", "words.xyz: line 2: \"one\" is not a number"),
        (3, "bone.stl scan.ply --region words.xyz", "`--region` is damaged", "words.xyz: line 1"),
        (3, "bone.stl scan.ply --landmarks line.csv line.csv", "points on a line", ""),
        (3, "bone.stl scan.ply --box 0,0,0,1,1,1", "no points", "none of "),
    ];
    let page = fs::read_to_string(root().join("docs/begin/register.md")).unwrap();
    for (code, arguments, meaning, says) in rows {
        let row = page.lines().find(|line| line.starts_with(&format!("- {code}: "))).unwrap();
        assert!(row.contains(meaning), "{meaning}: {row}");
        let (found, stderr, answer) = files.register(arguments);
        assert_eq!((found, answer.get("T").is_some()), (Some(code), code == 0), "{arguments}: {stderr}");
        assert!(stderr.contains(says), "{arguments}: {stderr}");
    }
}
