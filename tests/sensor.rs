//! `osteoflow sensor`: the errors of simulated devices and of a depth camera, and what is refused.

use crate::common::{
    data,
    devices::{BALL_MM, CAMERA, Device, Rng, Shape, knob, scan},
    osteoflow, osteoflow_to_spawn, skips_slow,
};
use osteoflow_geometry::{
    Mesh,
    nalgebra::{Isometry3, Matrix4, Point3, Vector3},
};
use serde_json::Value;
use std::{fs, path::Path};
use tempfile::TempDir;

/// A folder with the part and the folder `scans`.
fn folder(shape: Shape, device: &Device, n_scans: usize, of_point: impl Fn(&Point3<f64>) -> Point3<f64>) -> TempDir {
    let (dir, mesh, mut rng) = (tempfile::tempdir().unwrap(), knob(), Rng::seeded(3));
    fs::create_dir(dir.path().join("scans")).unwrap();
    fs::write(dir.path().join("knob.off"), off(&mesh)).unwrap();
    for k in 1..=n_scans {
        let (points, eye, _) = scan(shape, &mesh, device, 4000, &mut rng);
        // As a camera gives them: it stands at the origin, and looks along z.
        let along = Isometry3::look_at_rh(&eye, &points[0], &Vector3::new(0.31, 0.52, 0.79));
        let line = |p: &Point3<f64>| {
            let p = of_point(&(along * p));
            format!("{:.6} {:.6} {:.6}\n", p.x, p.y, p.z)
        };
        let text: String = points.iter().map(line).collect();
        fs::write(dir.path().join(format!("scans/knob_{k}.xyz")), text).unwrap();
    }
    dir
}

fn off(mesh: &Mesh) -> String {
    let mut text = format!("OFF\n{} {} 0\n", mesh.vertices().len(), mesh.faces().len());
    mesh.vertices().iter().for_each(|p| text += &format!("{:.6} {:.6} {:.6}\n", p.x, p.y, p.z));
    mesh.faces().iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    text
}

/// Exit code, stdout and stderr of `osteoflow sensor` in a folder.
fn sensor(dir: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = osteoflow_to_spawn().current_dir(dir).arg("sensor").args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

#[test]
fn a_profile_holds_the_errors_of_the_device_and_is_read_as_a_sensor() {
    let dir = folder(Shape::Knob, &CAMERA, 3, |p| *p);
    let files = ["--out", "me.toml", "--page", "me.html"];
    let arguments = [&["scans", "--part", "knob.off", "--format", "json"], &files[..]].concat();
    let (code, out, err) = sensor(dir.path(), &arguments);
    assert_eq!(code, 0, "{err}");
    let errors = &serde_json::from_str::<Value>(&out).unwrap()["errors"];
    let near = |key: &str, truth: f64, share: f64| {
        let found = errors[key]["value"].as_f64().unwrap();
        assert!((found / truth - 1.0).abs() < share, "{key}: {found} instead of {truth}");
    };
    near("noise_mm", CAMERA.noise_mm, 0.1);
    near("patch_mm", CAMERA.patch_mm, 0.25);
    near("outliers", CAMERA.outliers, 0.35);
    near("scale", CAMERA.scale, 0.02);
    assert!(errors["by_tilt"].as_array().unwrap().len() > 2 && errors["by_distance"].as_array().unwrap().len() > 2);
    let profile = fs::read_to_string(dir.path().join("me.toml")).unwrap();
    for word in
        ["SHA-256", "3 scans", "noise_mm = 0.1", "[", "osteoflow sensor scans", "shift_mm = 0.0000  # not measured"]
    {
        assert!(profile.contains(word), "{word} is missing:\n{profile}");
    }
    let page = fs::read_to_string(dir.path().join("me.html")).unwrap();
    // Scans with map and histogram, and the noise against distance and tilt.
    assert_eq!(page.matches("<figure").count(), 8);
    assert!(page.contains("default-src 'none'") && page.contains("knob_2.xyz: residuals"));
    let (code, _, err) = sensor(dir.path(), &arguments);
    assert!(code == 2 && err.contains("me.toml exists already"), "{code}: {err}");
    // It is read as it is.
    let registered = osteoflow()
        .current_dir(dir.path())
        .args(["register", "knob.off", "scans/knob_1.xyz", "--sensor", "me.toml", "--format", "json"])
        .output()
        .unwrap();
    let answer: Value = serde_json::from_slice(&registered.stdout).unwrap();
    let read = answer["verdict"]["measured"]["sensor"]["noise_mm"].as_f64().unwrap();
    assert!((read / CAMERA.noise_mm - 1.0).abs() < 0.1, "{answer}");
}

#[test]
fn a_ball_shows_the_tip_of_a_stylus_and_a_plane_no_offset() {
    let stylus = Device { mean_bias_mm: 1.5, bias_mm: 0.05, patch_mm: 0.1, scale: 1.0, ..CAMERA };
    let dir = folder(Shape::Ball, &stylus, 6, |p| *p);
    let ball = format!("ball:{BALL_MM}");
    let (code, out, err) = sensor(dir.path(), &["scans", "--part", &ball, "--like", "stylus"]);
    let tip = out
        .lines()
        .find_map(|line| line.trim().strip_prefix("tip_radius_mm = "))
        .unwrap_or_else(|| panic!("{out}{err}"));
    let tip_mm: f64 = tip.split_whitespace().next().unwrap().parse().unwrap();
    assert!(code == 0 && (tip_mm - 1.5).abs() < 0.15, "{out}{err}");
    let dir = folder(Shape::Plane, &CAMERA, 3, |p| *p);
    let (code, out, _) = sensor(dir.path(), &["scans", "--part", "plane"]);
    assert!(code == 0 && out.contains("a plane does not show it"), "{out}");
}

#[test]
fn scans_that_are_not_of_the_part_are_left_out_by_name_with_the_reason() {
    let fails = |dir: &TempDir, arguments: &[&str], words: &[&str]| {
        let (code, out, err) = sensor(dir.path(), arguments);
        assert!(code != 0 && out.is_empty(), "{arguments:?}: {code}, {out}");
        words.iter().for_each(|word| assert!(err.contains(word), "{arguments:?}: {word:?} is missing in {err}"));
        assert!(!dir.path().join("never.toml").exists(), "{arguments:?}");
    };
    let of_knob = ["scans", "--part", "knob.off", "--out", "never.toml"];
    let dir = folder(Shape::Knob, &CAMERA, 2, |p| *p);
    fails(&dir, &["nothing", "--part", "plane"], &["nothing is no folder of scans"]);
    fails(&dir, &["scans", "--part", "nothing.stl"], &["nothing.stl"]);
    fails(&dir, &["scans", "--part", "ball:0"], &["ball:0: a radius in mm is expected"]);
    fails(&dir, &["scans", "--part", "plane", "--out", "never.toml"], &["knob_1.xyz", "another shape"]);
    // A copy tells nothing of how scans differ.
    fs::copy(dir.path().join("scans/knob_1.xyz"), dir.path().join("scans/knob_2.xyz")).unwrap();
    fails(&dir, &of_knob, &["1 scan can be measured by", "knob_2.xyz: it is a copy of knob_1.xyz"]);
    fs::remove_dir_all(dir.path().join("scans")).unwrap();
    fs::create_dir(dir.path().join("scans")).unwrap();
    fails(&dir, &of_knob, &["0 scans can be measured by, and two are needed"]);
    // Another unit, a mirror image, another part.
    let dir = folder(Shape::Knob, &CAMERA, 2, |p| p / 1000.0);
    fails(&dir, &of_knob, &["knob_1.xyz", "knob.off", "is it of this part, and in mm? --unit-mm 1000"]);
    let (code, ..) = sensor(dir.path(), &["scans", "--part", "knob.off", "--unit-mm", "1000"]);
    assert_eq!(code, 0);
    let dir = folder(Shape::Knob, &CAMERA, 2, |p| p / 25.4);
    fails(&dir, &of_knob, &["--unit-mm 25.4"]);
    let dir = folder(Shape::Ball, &CAMERA, 2, |p| *p);
    fails(&dir, &of_knob, &["knob_1.xyz", "knob_2.xyz"]);
    fails(&dir, &["scans", "--part", "ball:20", "--out", "never.toml"], &["times as large as the part"]);
}

#[test]
fn readings_of_divots_have_their_precision_and_the_errors_of_their_distances() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
    write("divots.csv", "name,x,y,z\nA,0,0,0\nB,100,0,0\nC,0,50,0\nD,9,9,9\n");
    // Each is read 0.1 mm to either side; B lies 0.3 mm too far, C 0.1 mm too near.
    write(
        "readings.csv",
        "name,x,y,z\nA,0,0,0.1\nA,0,0,-0.1\nB,100.3,0,0.1\nB,100.3,0,-0.1\nC,0,49.9,0.1\nC,0,49.9,-0.1\n",
    );
    let arguments = ["readings.csv", "--standard", "f2554", "--reference", "divots.csv"];
    let (code, out, err) = sensor(dir.path(), &[&arguments[..], &["--format", "json"]].concat());
    assert_eq!(code, 0, "{err}");
    let found: Value = serde_json::from_str(&out).unwrap();
    let number = |path: &str| found.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path}: {found}"));
    let oblique = 100.3_f64.hypot(49.9) - 100_f64.hypot(50.0);
    let expected = [0.3, -0.1, oblique];
    let mean = expected.iter().sum::<f64>() / 3.0;
    for (path, value) in [
        ("/single_point_mm/rms", 0.1),
        ("/single_point_mm/max", 0.1),
        ("/distance_mm/mean", mean),
        ("/distance_mm/mean_abs", expected.iter().map(|mm| mm.abs()).sum::<f64>() / 3.0),
        ("/distance_mm/rms", (expected.iter().map(|mm| mm * mm).sum::<f64>() / 3.0).sqrt()),
        ("/distance_mm/max", 0.3),
        ("/n_divots", 3.0),
    ] {
        assert!((number(path) - value).abs() < 1e-9, "{path}: {} instead of {value}", number(path));
    }
    let (_, _, err) = sensor(dir.path(), &arguments);
    assert!(err.contains("3 divots (4 in the reference)") && err.contains("are not told apart"), "{err}");
    write("readings.csv", "name,x,y,z\nA,0,0,0\nA,0,0,0\nE,1,2,3\n");
    let (code, _, err) = sensor(dir.path(), &arguments);
    assert!(code != 0 && err.contains("no divot is named E"), "{err}");
    write("readings.csv", "name,x,y,z\nA,0,0,0\nB,1,2,far\n");
    let (code, _, err) = sensor(dir.path(), &arguments);
    assert!(code != 0 && err.contains("readings.csv: a heading, then NAME,x,y,z in mm are expected"), "{err}");
}

#[test]
fn a_profile_of_two_printed_parts_serves_the_third() {
    let test = "a_profile_of_two_printed_parts_serves_the_third";
    if skips_slow(test) {
        return;
    }
    let Some(prints) = data(test, "real/prints") else { return };
    let parts = ["Guitar", "Pendulum", "Square-Peg"];
    let vertices = parts.map(|part| {
        let bytes = fs::read(prints.join(format!("{part}.stl"))).unwrap();
        let float = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
        let corner = |at: usize| Point3::new(float(at), float(at + 4), float(at + 8));
        (84..bytes.len()).step_by(50).flat_map(|face| [12, 24, 36].map(|k| corner(face + k))).collect::<Vec<_>>()
    });
    let [mut n, mut given, mut trusted, mut wrong] = [0; 4];
    for (third, part) in parts.iter().enumerate() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("scans")).unwrap();
        let mut arguments: Vec<String> = ["scans", "--out", "me.toml"].map(String::from).into();
        for other in parts.iter().filter(|other| *other != part) {
            arguments.push(format!("--part={}", prints.join(format!("{other}.stl")).display()));
            for k in 1..=3 {
                let name = format!("{other}_{k}.xyz");
                fs::copy(prints.join(&name), dir.path().join("scans").join(&name)).unwrap();
            }
        }
        let (code, out, err) = sensor(dir.path(), &arguments.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(code, 0, "{err}");
        println!("without {part}:\n{out}{err}");
        for (k, seed) in (1..=3).flat_map(|k| (1..=3).map(move |seed| (k, seed.to_string()))) {
            let of = |ending: &str| prints.join(format!("{part}{ending}"));
            let output = osteoflow_to_spawn()
                .arg("register")
                .args([of(".stl"), of(&format!("_{k}.xyz"))])
                .args(["--sensor".as_ref(), dir.path().join("me.toml").as_os_str()])
                .args(["--format", "json", "--seed", &seed])
                .output()
                .unwrap();
            let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
            let poses: Value = serde_json::from_slice(&fs::read(of(&format!("_{k}.json"))).unwrap()).unwrap();
            let error_mm = |pose: &Value| {
                let rows = |m: &Value| Matrix4::from_fn(|r, c| m[r][c].as_f64().unwrap());
                let flat = |m: &Value| Matrix4::from_fn(|r, c| m[4 * r + c].as_f64().unwrap());
                let motion = flat(&answer["T"]) * rows(pose);
                let square = |p: &Point3<f64>| (motion.transform_point(p) - p).norm_squared();
                (vertices[third].iter().map(square).sum::<f64>() / vertices[third].len() as f64).sqrt()
            };
            let has_pose = answer["T"].is_array();
            let best =
                || poses["t_scan_part_mm"].as_array().unwrap().iter().map(error_mm).fold(f64::INFINITY, f64::min);
            let is_right = has_pose && best() < 10.0;
            let is_trusted = answer["verdict"]["answer"] == "trusted";
            println!("{part}_{k} seed {seed}: {}, right {is_right}", answer["verdict"]["sentence"]);
            n += 1;
            given += usize::from(is_right);
            trusted += usize::from(is_right && is_trusted);
            wrong += usize::from(!is_right && is_trusted);
        }
    }
    println!("{given} of {n} given and right, {trusted} of them trusted, {wrong} wrong and trusted");
    assert!(given as f64 >= 0.95 * n as f64 && wrong == 0, "{given} of {n} right, {wrong} wrong and trusted");
}
