//! The benchmark on public sets, on pairs that are generated in their layouts.

use crate::common::{osteoflow, python::python, root, shared_folder};
use osteoflow_algorithms::sample;
use osteoflow_formats::write::{write_ply, write_stl};
use osteoflow_geometry::{
    Cloud,
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
