//! The built-in procedure as files for other programs, and as the data that the shipped graphs use.

use crate::common::{json, osteoflow, root, run_whole};
use osteoflow_formats::mesh_or_cloud::read_cloud;
use serde_json::Value;
use std::{fs, path::Path};

fn simulate(dir: &Path, arguments: &[&str]) {
    osteoflow().args(["simulate", "--points", "2000", "--out"]).arg(dir).args(arguments).assert().success();
}

#[test]
fn the_same_seed_writes_the_same_bytes_and_another_seed_another_scan() {
    let dir = tempfile::tempdir().unwrap();
    let (first, again, other) = (dir.path().join("1"), dir.path().join("2"), dir.path().join("3"));
    simulate(&first, &["--seed", "5"]);
    simulate(&again, &["--seed", "5"]);
    simulate(&other, &["--seed", "6"]);
    for file in ["procedure.mcap", "bone.stl", "phantom.stl", "plan.json", "truth.json", "README.md"] {
        assert!(fs::read(first.join(file)).unwrap() == fs::read(again.join(file)).unwrap(), "{file}");
    }
    for file in ["procedure.mcap", "truth.json"] {
        assert!(fs::read(first.join(file)).unwrap() != fs::read(other.join(file)).unwrap(), "{file}");
    }
}

#[test]
fn a_folder_in_use_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    simulate(dir.path(), &[]);
    osteoflow().args(["simulate", "--out"]).arg(dir.path()).assert().code(2);
    simulate(dir.path(), &["--force"]);
}

#[test]
fn the_readme_of_the_data_names_the_seed_and_the_command() {
    for (folder, switch) in [("procedure", ""), ("folder", " --as folder")] {
        let readme = fs::read_to_string(root().join("tests/data").join(folder).join("README.md")).unwrap();
        let command = format!("osteoflow simulate --seed 42 --points 10000{switch} --out DIR");
        assert!(readme.contains(&command), "{folder}: {readme}");
        assert!(readme.contains("SIMULATED"));
        let truth = json(&root().join("tests/data").join(folder).join("truth.json"));
        assert_eq!((truth["seed"].as_u64(), truth["simulated"].as_bool()), (Some(42), Some(true)));
    }
}

/// Asserts that all numbers in two JSON values of the same form differ by at most `tolerance`.
fn assert_alike(a: &Value, b: &Value, tolerance: f64, place: &str) {
    match (a, b) {
        (Value::Object(a), Value::Object(b)) => {
            assert_eq!(Vec::from_iter(a.keys()), Vec::from_iter(b.keys()), "{place}");
            a.iter().for_each(|(key, value)| assert_alike(value, &b[key], tolerance, &format!("{place}.{key}")));
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{place}");
            a.iter().zip(b).enumerate().for_each(|(k, (a, b))| assert_alike(a, b, tolerance, &format!("{place}[{k}]")));
        }
        _ => match (a.as_f64(), b.as_f64()) {
            (Some(x), Some(y)) => assert!((x - y).abs() <= tolerance, "{place} is {x}, its command gives {y}"),
            _ => assert_eq!(a, b, "{place}"),
        },
    }
}

#[test]
fn the_data_that_ships_is_what_its_command_makes() {
    for (folder, switches) in [("procedure", &[][..]), ("folder", &["--as", "folder"])] {
        let kept = root().join("tests/data").join(folder);
        let command = |dir: &Path, more: &[&str]| {
            let mut command = osteoflow();
            command.args(["simulate", "--seed", "42", "--points", "10000", "--out"]).arg(dir).args(switches).args(more);
            command.assert().success();
        };
        if std::env::var_os("UPDATE").is_some() {
            command(&kept, &["--force"]);
            continue;
        }
        let fresh = tempfile::tempdir().unwrap();
        command(fresh.path(), &[]);
        let names = |dir: &Path| {
            let mut names: Vec<_> = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name()).collect();
            names.sort();
            names
        };
        assert_eq!(names(&kept), names(fresh.path()), "{folder}: `UPDATE=1 cargo test --release` writes it anew");
        for file in ["truth.json", "plan.json"] {
            // Another machine's sine may differ in the last bit; a stale file differs by much more. What binds a plan to its bone
            // is of the bone's own bytes.
            let [kept, fresh] = [&*kept, fresh.path()].map(|dir| {
                let mut json = json(&dir.join(file));
                json.as_object_mut().unwrap().remove("surface");
                json
            });
            assert_alike(&kept, &fresh, 1e-6, &format!("{folder}/{file}"));
        }
        for dir in [&*kept, fresh.path()] {
            let hash = osteoflow_formats::input::sha256(&dir.join("bone.stl")).unwrap();
            assert_eq!(json(&dir.join("plan.json"))["surface"]["sha256"], hash.as_str(), "{folder}: bound to its bone");
        }
        if folder == "folder" {
            let [kept, fresh] =
                [&*kept, fresh.path()].map(|dir| read_cloud(&dir.join("scan.ply"), 1.0, "camera").unwrap().cloud);
            assert_eq!(kept.len(), fresh.len(), "points of {folder}/scan.ply");
            let apart = kept.points().iter().zip(fresh.points()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(apart < 1e-6, "{folder}/scan.ply is {apart} mm off what its command gives");
        }
        let [size, fresh_size] = [&*kept, fresh.path()].map(|dir| fs::metadata(dir.join("bone.stl")).unwrap().len());
        assert_eq!(size, fresh_size, "{folder}/bone.stl has another number of faces");
    }
}

#[test]
fn a_recording_and_a_folder_of_one_procedure_give_the_same_registration() {
    let poses = ["graphs/fibula_recorded.toml", "graphs/fibula_folder.toml"].map(|graph| {
        let ran = run_whole(graph, &["--no-record", "--set", "icp.kind=icp.point_to_plane"]);
        crate::common::isometry(&ran.results["poses"]["t_ct_world"]["matrix"])
    });
    let truth = json(&root().join("tests/data/procedure/truth.json"));
    for spot in truth["assessment_W_true"].as_array().unwrap() {
        let spot = crate::common::point(spot);
        let apart = (poses[0] * spot - poses[1] * spot).norm();
        // A recording holds coordinates as 32-bit floats, which moves points by 0.00002 mm; point-to-plane converges within its
        // stop rule of 0.01 mm from either side, and points beside the scan move up to twice as far.
        assert!(apart < 0.05, "{apart} mm apart");
    }
}

#[test]
fn settings_are_written_into_the_files_and_wrong_ones_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (plain, changed) = (dir.path().join("plain"), dir.path().join("changed"));
    simulate(&plain, &["--as", "folder"]);
    let sets = [
        r#"laser.swap=["P2","P3"]"#,
        "phantom.marker_cad_wrong_mm=5.0",
        "ct_bone.mirrored=true",
        "ct.smoothing=10",
        "camera.unit_factor=0.001",
    ];
    let arguments: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).chain(["--as", "folder"]).collect();
    simulate(&changed, &arguments);
    let read = |dir: &Path, file: &str| fs::read_to_string(dir.join(file)).unwrap();
    let labels = |dir: &Path| -> Vec<String> {
        let lines = read(dir, "procedure.toml");
        lines.lines().filter_map(|line| line.strip_prefix("label    = ")).map(str::to_owned).collect()
    };
    assert_eq!(labels(&plain), ["\"P1\"", "\"P2\"", "\"P3\""]);
    assert_eq!(labels(&changed), ["\"P1\"", "\"P3\"", "\"P2\""]);
    assert!(read(&changed, "README.md").contains("--set 'ct_bone.mirrored=true' --set 'ct.smoothing=10'"));
    let [before, after] = [&plain, &changed].map(|dir| json(&dir.join("truth.json")));
    assert_eq!(after["settings"], serde_json::json!(sets));
    assert_eq!(before["W_T_CT"], after["W_T_CT"], "the recording is of the bone that is there");
    assert_eq!(before["laser_spots_CT"], after["laser_spots_CT"]);
    let lateral = |dir: &Path| json(&dir.join("plan.json"))["lateral"][0].as_f64().unwrap();
    assert!((lateral(&plain) + lateral(&changed)).abs() < 1e-9, "the plan is of the other leg");
    for (set, words) in [
        ("tissue.shore=0.2", "unknown field `shore`"),
        ("tissue=0.2", "a key is TABLE.PARAMETER"),
        ("tissue.share", "no = between key and value"),
        ("ct_bone.side=left", "unknown field `side`"),
        ("wound.deep=1", "unknown field `wound`"),
    ] {
        let out = dir.path().join("refused");
        let run = osteoflow().args(["simulate", "--set", set, "--out"]).arg(&out).assert().code(2);
        let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(said.contains(words), "{set}: {said}");
    }
}

/// A CT that differs from the bone: its setting, and the offset (mm) and the tilt (degrees) of the second cut that it makes.
const OTHER_CTS: [(&str, f64, f64); 3] = [
    // Of the 95 mm from the middle of the landmarks.
    ("stretch_percent=4.0", 3.8, 0.0),
    ("growth_percent=-3.0", -2.9, 0.0),
    // The cut stays in its slice while the bone tilts.
    ("gantry_deg=10.0", 0.0, 10.0),
];

#[test]
fn a_ct_that_differs_from_the_bone_is_an_error_at_the_cuts_by_the_truth_of_the_recording() {
    let results = |sets: &[String]| {
        let fixed = [
            "recording.camera.n_points=8000",
            r#"remove=["node.verdict", "node.export", "results.verdict", "results.planes"]"#,
        ];
        let sets = fixed.into_iter().chain(sets.iter().map(String::as_str)).flat_map(|set| ["--set", set]);
        run_whole("graphs/fibula.toml", &sets.chain(["--no-record"]).collect::<Vec<_>>()).results
    };
    let offset = |results: &Value| results["metrics"]["cuts"]["cuts"][1]["offset_mm"].as_f64().unwrap();
    for (setting, expected_mm, expected_deg) in OTHER_CTS {
        let found = results(&[format!("plan.bone.{setting}"), format!("bone.bone.{setting}")]);
        let tilt_deg = found["metrics"]["cuts"]["cuts"][1]["tilt_rad"].as_f64().unwrap().to_degrees();
        // The fit to another shape slides by up to a millimetre and turns by up to a degree.
        let offset_mm = offset(&found);
        assert!((offset_mm - expected_mm).abs() < 1.5, "{setting}: the cut is {offset_mm} mm off, not {expected_mm}");
        assert!(
            (tilt_deg - expected_deg).abs() < 1.5,
            "{setting}: the cut is tilted by {tilt_deg}, not {expected_deg}"
        );
    }
    let displaced = results(&["plan.displaced.along_mm=8.0".to_owned()]);
    assert!((offset(&displaced) - 8.0).abs() < 1.0, "the cut is {} mm off", offset(&displaced));
    let tre_mm = displaced["metrics"]["tre_true_mm"]["mean_abs"]["norm"].as_f64().unwrap();
    assert!((tre_mm - 8.0).abs() < 1.0, "{tre_mm} mm at the assessment points");
}

#[test]
fn files_of_a_ct_that_differs_hold_the_plan_drawn_on_it_and_the_truth_of_the_bone() {
    let dir = tempfile::tempdir().unwrap();
    let made = |name: &str, sets: &[&str]| {
        let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
        simulate(&dir.path().join(name), &sets);
        ["plan.json", "truth.json"].map(|file| json(&dir.path().join(name).join(file)))
    };
    let [plan, truth] = made("plain", &[]);
    let [stretched, same] = made("stretched", &["ct_bone.stretch_percent=5.0"]);
    for key in ["W_T_CT", "assessment_W_true", "planes_W_scan", "laser_spots_W"] {
        assert_eq!(truth[key], same[key], "{key} is of the bone");
    }
    let height = |plan: &Value, name: &str| {
        let z = |name: &str| plan["landmarks"][name][2].as_f64().unwrap();
        z(name) - z("P1")
    };
    for name in ["P2", "P3"] {
        let ratio = height(&stretched, name) / height(&plan, name);
        assert!((ratio - 1.05).abs() < 1e-6, "{name} is {ratio} times as far from P1 along the CT's z");
    }
    let [displaced, same] = made("displaced", &["displaced.along_mm=8.0", "displaced.across_mm=6.0"]);
    assert_eq!(truth["planes_W_scan"], same["planes_W_scan"]);
    for name in ["P1", "P2", "P3"] {
        let at = |plan: &Value| crate::common::point(&plan["landmarks"][name]);
        let moved_mm = (at(&displaced) - at(&plan)).norm();
        assert!((moved_mm - 10.0).abs() < 1e-6, "{name} is displaced by {moved_mm} mm");
    }
}

#[test]
fn a_recording_with_swapped_scans_has_each_in_the_topic_of_its_label() {
    let dir = tempfile::tempdir().unwrap();
    let recorded = |name: &str, arguments: &[&str]| {
        let out = dir.path().join(name);
        // Fewer points do not resolve a hole.
        simulate(&out, &[&["--set", "camera.n_points=10000"], arguments].concat());
        // The verdict refuses exchanged landmarks, and withholds them.
        let mut sets =
            vec![r#"remove=["node.verdict", "node.export", "results.verdict", "results.planes"]"#.to_owned()];
        sets.push(format!("recording.path={}", out.join("procedure.mcap").display()));
        for (node, file) in [("bone", "bone.stl"), ("phantom", "phantom.stl"), ("plan", "plan.json")] {
            sets.push(format!("{node}.path={}", out.join(file).display()));
        }
        let arguments: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).chain(["--no-record"]).collect();
        run_whole("graphs/fibula_recorded.toml", &arguments).results
    };
    let spots = |results: &Value| -> Vec<_> {
        ["P1", "P2", "P3"]
            .map(|name| {
                let all = results["laser_points"].as_array().unwrap();
                crate::common::point(&all.iter().find(|spot| spot["name"] == name).unwrap()["position_mm"])
            })
            .to_vec()
    };
    let plain = spots(&recorded("plain", &[]));
    let swapped = spots(&recorded("swapped", &["--set", r#"laser.swap=["P2","P3"]"#]));
    for (name, a, b) in [("P1", plain[0], swapped[0]), ("P2", plain[1], swapped[2]), ("P3", plain[2], swapped[1])] {
        assert!((a - b).norm() < 0.05, "{name} is {} mm from where it was", (a - b).norm());
    }
}

#[test]
fn a_new_procedure_runs_as_it_is_and_its_folder_is_not_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("mine");
    let made = osteoflow().args(["new", "procedure"]).arg(&folder).assert().success();
    let printed = String::from_utf8(made.get_output().stdout.clone()).unwrap();
    assert!(printed.contains("SIMULATED") && printed.contains("osteoflow run run.toml"), "{printed}");
    let ran = osteoflow().current_dir(&folder).args(["run", "run.toml", "--out", "left"]).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let results = crate::common::json(&folder.join("left/results.json"));
    assert_eq!(results["verdict"]["answer"], "trusted", "{}", results["verdict"]);
    let manifest = crate::common::json(&folder.join("left/manifest.json"));
    let paths: Vec<_> = manifest["inputs"].as_array().unwrap().iter().map(|input| input["path"].clone()).collect();
    assert!(paths.contains(&"data/scan.ply".into()), "{paths:?}");
    // The README names every file of the example.
    let readme = std::fs::read_to_string(folder.join("README.md")).unwrap();
    for entry in std::fs::read_dir(folder.join("data")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let is_named =
            readme.contains(&format!("data/{name}")) || name.starts_with("laser_p") || name.starts_with("stylus_");
        assert!(is_named || name == "README.md", "{name} is not in the README");
    }
    osteoflow().args(["new", "procedure"]).arg(&folder).assert().code(2);
}

#[test]
fn the_examples_are_the_files_of_the_repository_that_the_documentation_names() {
    let place = tempfile::tempdir().unwrap();
    let dir = place.path().join("examples");
    osteoflow().args(["new", "examples"]).arg(&dir).assert().success();
    let mut n_files = 0;
    let mut folders =
        ["graphs", "tests/data/picks", "tests/data/register", "tests/data/folder"].map(|f| root().join(f)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(root()).unwrap();
            if path.ends_with("__pycache__") {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if name.starts_with("tests/data/folder") {
                // Simulated anew; its numbers are compared above.
                assert!(dir.join(name).is_file(), "{}", name.display());
            } else {
                n_files += 1;
                assert!(
                    fs::read(dir.join(name)).ok() == fs::read(&path).ok(),
                    "{} is missing or stale",
                    name.display()
                );
            }
        }
    }
    assert!(n_files > 40, "{n_files} files");
    // Into a folder that is in use, nothing is written.
    let refused = osteoflow().args(["new", "examples"]).arg(&dir).assert().code(2);
    assert!(String::from_utf8_lossy(&refused.get_output().stderr).contains("is not empty"));
    // Elsewhere a command that names one of them says how to get it; other files that are missing have no such remedy.
    for arguments in [
        &["run", "graphs/fibula.toml"][..],
        &["sweep", "graphs/paper/sensitivity.toml"],
        &["register", "tests/data/folder/bone.stl", "x"],
    ] {
        let told = osteoflow().args(arguments).current_dir(place.path()).assert().code(2);
        let told = String::from_utf8_lossy(&told.get_output().stderr).into_owned();
        assert!(told.contains("osteoflow new examples DIR"), "{arguments:?}: {told}");
    }
    let other = osteoflow().args(["run", "graphs/mine.toml"]).current_dir(place.path()).assert().code(2);
    assert!(!String::from_utf8_lossy(&other.get_output().stderr).contains("new examples"));
}
