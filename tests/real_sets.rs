//! The benchmark on public sets, on pairs that are generated in their layouts.

use crate::common::{osteoflow, python::python, root, shared_folder};
use osteoflow_algorithms::{
    sample,
    sensor::{Sensor, SensorKind},
};
use osteoflow_formats::{
    mesh_or_cloud::read_mesh,
    write::{write_ply, write_stl},
};
use osteoflow_geometry::{
    Cloud, SurfaceOrigin,
    nalgebra::{Isometry3, Point3, Vector3},
};
use osteoflow_simulation::{BoneParams, bone};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::Value;
use std::{collections::BTreeMap, fmt::Write as _, fs, path::Path, process::Command};

/// Writes a bone and the points of its distal part, where they belong; gives these points.
fn write_pair(surface: &Path, scan: &Path, shape_seed: u64) -> Vec<Point3<f64>> {
    let params = BoneParams { edge_mm: 2.0, shape_seed, ..BoneParams::default() };
    let (mesh, anatomy) = (bone::fibula(&params), bone::anatomy(&params));
    let seen = sample::surface(&mesh, 20_000, &mut ChaCha8Rng::seed_from_u64(shape_seed));
    let is_distal = |p: &&Point3<f64>| (*p - anatomy.malleolus_tip).dot(&anatomy.proximal) < 150.0;
    let points: Vec<Point3<f64>> = seen.points.iter().filter(is_distal).copied().collect();
    write_stl(surface, &mesh).unwrap();
    let mut text = String::new();
    points.iter().for_each(|p| writeln!(text, "{} {} {}", p.x, p.y, p.z).unwrap());
    fs::write(scan, text).unwrap();
    points
}

/// The rows of a table of comma-separated values without quotes, each by the names of its columns; none without the file.
fn rows(file: &Path) -> Vec<BTreeMap<String, String>> {
    let Ok(text) = fs::read_to_string(file) else { return Vec::new() };
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned));
    let head: Vec<String> = lines.next().unwrap().collect();
    lines.map(|cells| head.iter().cloned().zip(cells).collect()).collect()
}

#[test]
fn a_perturbed_scan_is_recovered_with_its_error_time_and_verdict_in_each_row() {
    let dir = tempfile::tempdir_in(shared_folder()).unwrap();
    let (surface, scan, truth) =
        (dir.path().join("bone.stl"), dir.path().join("scan.ply"), dir.path().join("truth.txt"));
    let points = write_pair(&surface, &dir.path().join("in_place.xyz"), 1);
    // The file of the scan is in another frame, and its true pose beside it.
    let t = Isometry3::new(Vector3::new(30.0, -20.0, 100.0), Vector3::new(0.3, 0.2, 2.0));
    let moved: Vec<_> = points.iter().map(|p| t.inverse() * p).collect();
    write_ply(&scan, &Cloud::new("camera", moved).unwrap(), 1.0).unwrap();
    let matrix = t.to_homogeneous();
    let text: Vec<String> = (0..16).map(|k| format!("{:?}", matrix[(k / 4, k % 4)])).collect();
    fs::write(&truth, text.join(" ")).unwrap();
    let sweep = |out: &str, pair: &str, more: &[&str]| {
        let values = format!("sweep.factor.pair.values=[{pair}]");
        let mut command = osteoflow();
        command
            .env("OSTEOFLOW_CACHE", dir.path().join("store"))
            .arg("sweep")
            .arg(root().join("graphs/real/recover.toml"));
        command.args(["--set", &values, "--set", "sweep.repeat=3", "--out"]).arg(dir.path().join(out));
        let output = command.args(more.iter().flat_map(|set| ["--set", set])).output().unwrap();
        (output.status.code(), rows(&dir.path().join(out).join("runs.csv")), String::from_utf8(output.stderr).unwrap())
    };
    let pair = |truth: &str| format!("{{ bone.path = {surface:?}, scan.path = {scan:?}{truth} }}");
    let with_truth = pair(&format!(", perturb.truth = {truth:?}"));
    let (code, found, err) = sweep("first", &with_truth, &[]);
    assert_eq!((code, found.len()), (Some(0), 3), "{err}");
    for row in &found {
        let number = |column: &str| row[column].parse::<f64>().unwrap_or_else(|_| panic!("{column}: {row:?}"));
        assert_eq!(
            (number("right"), row["status"].as_str(), row["answer"].as_str()),
            (1.0, "complete", "trusted"),
            "{row:?}"
        );
        assert!(number("error_mm") < 0.2 && number("error_deg") < 0.2, "{row:?}");
        assert!(number("search_ms") > 0.0 && number("icp_ms") > 0.0, "{row:?}");
    }
    let starts: Vec<String> = (0..3)
        .map(|run| {
            let file = dir.path().join(format!("first/runs/{run:06}.json"));
            let run: Value = serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
            run["results"]["poses"].to_string()
        })
        .collect();
    assert!(starts[0] != starts[1] && starts[1] != starts[2], "each start is another: {starts:?}");
    // The same seed draws the same starts. Without the true pose of the file the scan's place in it is taken for the true one.
    let (_, again, _) = sweep("again", &with_truth, &[]);
    assert_eq!(
        again.iter().map(|r| &r["error_mm"]).collect::<Vec<_>>(),
        found.iter().map(|r| &r["error_mm"]).collect::<Vec<_>>()
    );
    let (_, wrong, _) = sweep("wrong", &pair(""), &[]);
    assert!(wrong.iter().all(|row| row["right"].parse() == Ok(0.0) && row["answer"] == "trusted"), "{wrong:?}");
    let (code, _, err) = sweep("far", &with_truth, &["perturb.max_turn_deg=181"]);
    assert!(code == Some(2) && err.contains("max_turn_deg") && err.contains("180"), "{err}");
}

#[test]
fn the_benchmark_finds_the_pairs_of_each_layout_and_prints_a_row_for_each() {
    let Some(python) = python("the benchmark of public sets") else { return };
    let dir = tempfile::tempdir_in(shared_folder()).unwrap();
    let set = dir.path().join("set");
    ["preoperative", "intraoperative"].iter().for_each(|part| fs::create_dir_all(set.join(part)).unwrap());
    // One scan of a surface, and two cameras' of another.
    let (one, two) = (set.join("preoperative/specimen01_fibula.stl"), set.join("preoperative/specimen02_L1.stl"));
    write_pair(&one, &set.join("intraoperative/specimen01_fibula.xyz"), 1);
    write_pair(&two, &set.join("intraoperative/specimen02_L1_camera0.xyz"), 2);
    fs::copy(
        set.join("intraoperative/specimen02_L1_camera0.xyz"),
        set.join("intraoperative/specimen02_L1_camera1.xyz"),
    )
    .unwrap();
    fs::write(set.join("intraoperative/specimen03_tibia.xyz"), "0 0 0\n").unwrap();
    let benchmark = |folder: &Path, more: &[&str]| {
        let mut command = Command::new(&python);
        command.arg(root().join("graphs/real/benchmark.py")).arg(folder).args(["--repeat", "1", "--program"]);
        command.arg(crate::common::program()).args(more).env("OSTEOFLOW_CACHE", dir.path().join("store"));
        let output = command.output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.success(), text(&output.stdout), text(&output.stderr))
    };
    let kept = dir.path().join("kept");
    let in_kept = ["--out", kept.to_str().unwrap()];
    let (is_done, out, err) = benchmark(&set, &in_kept);
    assert!(is_done && err.contains("specimen03_tibia.xyz: no surface of that name, left out"), "{out}{err}");
    let row =
        |name: &str| out.lines().find(|line| line.starts_with(&format!("| osteoflow | {name} |"))).map(str::to_owned);
    for name in ["specimen01_fibula", "specimen02_L1_camera0", "specimen02_L1_camera1"] {
        let row = row(name).unwrap_or_else(|| panic!("{name}: {out}{err}"));
        assert!(row.contains(&format!("| {name} | 1 | 1 | 1.00 | 0.0")), "{row}");
    }
    assert!(row("all").is_some_and(|row| row.contains("| all | 3 | 3 | 1.00 |")), "{out}");
    // More starts are added to those that are kept, which stay.
    let first = |run: &str| fs::read(kept.join("sweep/runs").join(run)).unwrap();
    let before = first("000000.json");
    let (is_done, out, err) = benchmark(&set, &[in_kept[0], in_kept[1], "--repeat", "2"]);
    assert!(is_done && out.contains("| osteoflow | all | 6 | 6 | 1.00 |"), "{out}{err}");
    assert_eq!(first("000000.json"), before, "a run that is kept is not made again");
    let (is_done, _, err) = benchmark(&set.join("preoperative"), &[]);
    assert!(!is_done && err.contains("no pair of preoperative/NAME.stl and intraoperative/NAME.xyz"), "{err}");
}

/// The page without the last column of its first table, which is processor time.
#[cfg(unix)]
fn without_times(page: &str) -> String {
    let mut is_timed = false;
    let lines = page.lines().map(|line| {
        is_timed = line.starts_with("| Measure | Right |") || (is_timed && line.starts_with('|'));
        if is_timed { line.trim_end_matches('|').rsplit_once('|').unwrap().0 } else { line }
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// The AUROC of the measure in the first table.
#[cfg(unix)]
fn auroc(page: &str, measure: &str) -> f64 {
    let row = page.lines().find(|line| line.starts_with(&format!("| {measure}"))).unwrap_or_else(|| panic!("{page}"));
    row.split('|').nth(5).unwrap().trim().parse().unwrap_or_else(|_| panic!("{row}"))
}

/// A folder with a bone that is simulated, a scan of it in a frame of its own, and the true pose.
#[cfg(unix)]
fn write_set(set: &Path) {
    fs::create_dir_all(set).unwrap();
    let points = write_pair(&set.join("bone.stl"), &set.join("in_place.xyz"), 1);
    let t = Isometry3::new(Vector3::new(30.0, -20.0, 100.0), Vector3::new(0.3, 0.2, 2.0));
    let scan: Vec<_> = points.iter().step_by(8).map(|p| t.inverse() * p / 1000.0).collect();
    write_ply(&set.join("scan.ply"), &Cloud::new("camera", scan).unwrap(), 1.0).unwrap();
    let pair = serde_json::json!({
        "object": "fibula", "scan": "distal", "surface": "bone.stl", "source": "scan.ply", "source_unit_mm": 1000.0,
        "t_surface_scan": [osteoflow_geometry::matrix_rows(&t)], "right_mm": 1.5, "truth_mm": 0.1,
    });
    fs::write(set.join("manifest.json"), serde_json::json!({ "pairs": [pair] }).to_string()).unwrap();
}

#[cfg(unix)]
#[test]
fn the_benchmark_of_verdicts_goes_on_after_an_interruption_and_computes_its_figures_from_the_poses() {
    let Some(python) = python("the benchmark of verdicts") else { return };
    let dir = tempfile::tempdir_in(shared_folder()).unwrap();
    let (set, page, kept) = (dir.path().join("set"), dir.path().join("page.md"), dir.path().join("kept"));
    write_set(&set);
    let benchmark = |arguments: &[&std::ffi::OsStr]| {
        let mut command = Command::new(&python);
        command.arg(root().join("graphs/real/trustbench.py")).args(arguments);
        let output = command.env("OSTEOFLOW_CACHE", dir.path().join("store")).output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.success(), text(&output.stdout), text(&output.stderr))
    };
    let program = crate::common::program();
    let judge = |out: &Path, program: &Path, more: &[&str]| {
        let mut arguments = vec![set.as_os_str(), "--out".as_ref(), out.as_os_str(), "--program".as_ref()];
        arguments.extend([program.as_os_str(), "--poses".as_ref(), "2".as_ref()]);
        arguments.extend(more.iter().map(std::ffi::OsStr::new));
        benchmark(&arguments)
    };
    let figures = |answers: &Value| {
        let file = dir.path().join("answers.json");
        fs::write(&file, answers.to_string()).unwrap();
        benchmark(&["--figures".as_ref(), file.as_os_str()])
    };

    // The sweep of the verdicts is killed, and the same command goes on; it writes what a run in one piece does.
    let killed = dir.path().join("killed");
    let script = format!(
        "#!/bin/sh\ncase \"$*\" in *judged.toml*) timeout -s KILL 1 {program:?} \"$@\"; exit 1;; esac\nexec {program:?} \"$@\"\n"
    );
    fs::write(&killed, script).unwrap();
    fs::set_permissions(&killed, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let (is_done, out, err) = judge(&kept, &killed, &[]);
    assert!(!is_done && err.contains("judged: the sweep ended with code"), "{out}{err}");
    fs::write(&page, "# Page\n<!-- trustbench -->\nold\n<!-- end -->\nrest\n").unwrap();
    let (is_done, out, err) = judge(&kept, &program, &["--page", page.to_str().unwrap()]);
    assert!(is_done, "{err}");
    let written = fs::read_to_string(&page).unwrap();
    assert_eq!(written, format!("# Page\n<!-- trustbench -->\n{out}<!-- end -->\nrest\n"));
    let (is_done, again, err) = judge(&kept, &program, &[]);
    assert!(is_done && again == out, "what is kept is drawn again, its times included: {err}");
    let (_, in_one_piece, err) = judge(&dir.path().join("other"), &program, &["--workers", "2"]);
    assert_eq!(without_times(&in_one_piece), without_times(&out), "{err}");

    // The page: counts of what was asked for, each measure with an AUROC, each table of one width.
    let answers: Value = serde_json::from_slice(&fs::read(kept.join("answers.json")).unwrap()).unwrap();
    let labelled = |answers: &Value, label: &str| -> Vec<usize> {
        let rows = answers["rows"].as_array().unwrap();
        (0..rows.len()).filter(|row| rows[*row]["label"] == label).collect()
    };
    // Two right ones, and of each kind of wrong ones one, of which the search for a neighbouring minimum may end elsewhere.
    let n_asked = answers["rows"].as_array().unwrap().len() as u64 + answers["n_without_pose"].as_u64().unwrap();
    let (right, wrong) = (labelled(&answers, "right"), labelled(&answers, "wrong"));
    assert!(n_asked == 7 && right.len() == 2 && wrong.len() >= 4, "{out}");
    let n_wrong = wrong.len();
    assert!(out.starts_with(&format!("Objects: 1. Scans: 1. Poses: 2 right, {n_wrong} wrong, 0 twins.")), "{out}");
    let limit = format!("**Trusted and wrong: 0 of {n_wrong} (0.0 %), upper 95 % limit 95.0 % by objects.");
    assert!(out.contains(&limit), "{out}");
    for measure in ["osteoflow", "residual RMS", "Open3D fitness", "Open3D inlier RMSE", "CorAl: joint", "NDT score"] {
        assert!((0.0..=1.0).contains(&auroc(&out, measure)), "{measure}: {out}");
    }
    let mut width = None;
    for line in out.lines() {
        let n = line.starts_with('|').then(|| line.matches('|').count());
        assert!(width.is_none() || n.is_none() || n == width, "{line}");
        width = n;
    }
    assert_eq!(auroc(&out, "osteoflow"), 1.0, "sound poses of a simulated bone, and gross errors: {out}");

    // Figures follow the labels: a right pose that is called wrong has the lowest chance of being wrong.
    assert_eq!(figures(&answers).1, out);
    for (measure, number) in [("osteoflow", "/stated_chance"), ("residual RMS", "/scores/residual RMS")] {
        let of = |row: &&usize| answers["rows"][**row].pointer(number).and_then(Value::as_f64).unwrap();
        let best = *right.iter().min_by(|a, b| of(a).total_cmp(&of(b))).unwrap();
        let mut mislabelled = answers.clone();
        mislabelled["rows"][best]["label"] = "wrong".into();
        let (_, fewer, err) = figures(&mislabelled);
        assert!(auroc(&fewer, measure) < auroc(&out, measure), "{measure}: {fewer}{err}");
        assert!(fewer.contains(&format!("**Trusted and wrong: 1 of {} (", n_wrong + 1)), "{fewer}");
    }
    // A stated chance orders the answers, refused ones too; without one the answer does.
    let mut unstated = answers.clone();
    unstated["rows"].as_array_mut().unwrap().iter_mut().for_each(|row| row["stated_chance"] = Value::Null);
    assert_eq!(auroc(&figures(&unstated).1, "osteoflow"), 1.0);
    let mut stated = answers.clone();
    for row in stated["rows"].as_array_mut().unwrap() {
        row["stated_chance"] = f64::from(u8::from(row["label"] == "right")).into();
    }
    let (_, reversed, err) = figures(&stated);
    assert_eq!(auroc(&reversed, "osteoflow"), 0.0, "{reversed}{err}");
    // Of two objects there are intervals, and the regressions, each trained on the other object.
    let mut two = answers.clone();
    let copies: Vec<Value> = answers["rows"].as_array().unwrap().clone();
    two["rows"].as_array_mut().unwrap().extend(copies.into_iter().map(|mut row| {
        row["object"] = "tibia".into();
        row
    }));
    let (_, of_two, err) = figures(&two);
    let twice = format!("Objects: 2. Scans: 2. Poses: 4 right, {} wrong", 2 * n_wrong);
    assert!(of_two.starts_with(&twice), "{of_two}{err}");
    assert!(of_two.contains("upper 95 % limit 77.6 % by objects"), "1 - 0.05^(1/2): {of_two}");
    assert!(of_two.contains("| 1.000 | 1.000 to 1.000 |") && auroc(&of_two, "CorAl: logistic") >= 0.0, "{of_two}");

    // A pose, a scan or a true pose that has changed is named.
    let pose = kept.join("poses/0000.txt");
    let text = fs::read_to_string(&pose).unwrap();
    fs::write(&pose, format!("{text}\n")).unwrap();
    let (is_done, out, err) = judge(&kept, &program, &[]);
    assert!(!is_done && err.contains("poses/0000.txt: changed since it was made"), "{out}{err}");
    fs::write(&pose, text).unwrap();
    fs::OpenOptions::new().append(true).open(set.join("bone.stl")).unwrap().set_len(84 + 50 * 100).unwrap();
    let (is_done, out, err) = judge(&kept, &program, &[]);
    assert!(
        !is_done && err.contains("made of other pairs, files, --poses or --seed; give another --out"),
        "{out}{err}"
    );
}

#[cfg(unix)]
#[test]
fn weights_of_the_chance_are_fitted_to_scans_that_lie_on_their_surface_and_no_sign_speaks_for_an_answer() {
    let Some(python) = python("the weights of the chance of being wrong") else { return };
    let dir = tempfile::tempdir().unwrap();
    let chance = |task: &str, path: &Path, more: &[&Path]| {
        let mut command = Command::new(&python);
        command.arg(root().join("graphs/real/chance.py")).arg(task).arg(path).args(more).args(["--shapes", "1"]);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    // The sensors are those of the program, there and on their page.
    let [script, page] =
        ["graphs/real/chance.py", "docs/method/sensors.md"].map(|file| fs::read_to_string(root().join(file)).unwrap());
    for kind in SensorKind::ALL {
        let Sensor { noise_mm, patch_mm, bias_mm, shift_mm, outliers, .. } = kind.sensor();
        let (word, errors) = (kind.word(), [noise_mm, patch_mm, bias_mm, shift_mm, outliers]);
        let drawn = errors.map(|number| format!("{number:?}, ")).concat();
        assert!(script.contains(&format!("\"{word}\": ({drawn}")), "chance.py has {word} other than ({drawn}");
        let row = errors.map(|number| format!("{number} | ")).concat();
        assert!(page.contains(&format!("| `{word}` | {row}")), "sensors.md has {word} other than {row}");
    }
    let (set, bone) = (dir.path().join("set"), dir.path().join("bone.stl"));
    write_pair(&bone, &dir.path().join("scan.xyz"), 1);
    chance("make", &set, &[&bone]);
    let manifest: Value = serde_json::from_slice(&fs::read(set.join("manifest.json")).unwrap()).unwrap();
    let pairs = manifest["pairs"].as_array().unwrap();
    let objects: Vec<_> = pairs.iter().map(|pair| pair["object"].as_str().unwrap()).collect();
    assert!(pairs.len() == 10 && objects[..5] == ["bone"; 5] && objects[5..] == ["shape_0"; 5], "{objects:?}");
    for pair in pairs {
        let at = |key: &str| set.join(pair[key].as_str().unwrap());
        let corners = read_mesh(&at("surface"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
        let pose: Vec<f64> =
            serde_json::from_value::<Vec<Vec<f64>>>(pair["t_surface_scan"][0].clone()).unwrap().concat();
        let text = fs::read_to_string(at("source")).unwrap();
        let points = text.lines().map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect::<Vec<f64>>());
        let mut far_mm: Vec<f64> = points
            .map(|p| {
                std::array::from_fn(|k| {
                    pose[4 * k..][..3].iter().zip(&p).map(|(a, b)| a * b).sum::<f64>() + pose[4 * k + 3]
                })
            })
            .map(|p: [f64; 3]| corners.vertices().iter().map(|c| (c - Point3::from(p)).norm()).fold(f64::MAX, f64::min))
            .collect();
        far_mm.sort_by(f64::total_cmp);
        let median_mm = far_mm[far_mm.len() / 2];
        assert!(far_mm.len() >= 100 && median_mm < 6.0, "{}: {median_mm}", pair["source"]);
    }

    // What tells has a weight, what speaks for wrong answers has none, and what was not examined has no part.
    let row = |index: usize, signs: Value| {
        let label = if index.is_multiple_of(2) { "right" } else { "wrong" };
        serde_json::json!({ "object": format!("{}", index % 3), "label": label, "signs": signs })
    };
    let signs = |index: usize| {
        let wrong = f64::from(u8::from(index % 2 == 1));
        serde_json::json!({ "far": wrong + 0.01 * index as f64, "refused": 1.0 - wrong, "doubtful": 0.0 })
    };
    let mut rows: Vec<Value> = (0..60).map(|index| row(index, signs(index))).collect();
    rows.push(row(61, serde_json::json!({ "refused": 1.0 })));
    let answers = dir.path().join("answers.json");
    fs::write(&answers, serde_json::json!({ "rows": rows }).to_string()).unwrap();
    let told = chance("fit", &answers, &[]);
    let weight = |name: &str| -> f64 {
        let (_, rest) = told.split_once(&format!("(\"{name}\", ")).unwrap_or_else(|| panic!("{told}"));
        rest.split(')').next().unwrap().parse().unwrap()
    };
    assert!(told.starts_with("30 right and 30 wrong answers of 3 objects\n"), "{told}");
    assert!(weight("far") > 1.0 && weight("refused") == 0.0 && weight("doubtful") == 0.0, "{told}");
    assert!(told.contains("AUROC of objects left out: 1.000"), "{told}");
}
