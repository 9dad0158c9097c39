//! The tasks of three readers from their first command to their answer, as the pages and the messages lead: by real commands, mouse and keys.

use crate::common::{browser::Browser, isometry, json, osteoflow, python::Folder, root};
use crate::viewer_hands::{Case, draw_around_bone, pair_side_by_side};
use crate::viewer_next::{simulate_wound, wait_for_line};
use crate::viewer_picking::{press, text};
use osteoflow_formats::mesh_or_cloud::{read_cloud, read_mesh};
use osteoflow_geometry::{
    SurfaceOrigin,
    nalgebra::{Isometry3, Vector3},
};
use serde_json::Value;
use std::{fmt::Write, fs, path::Path, process::Command};

#[test]
fn two_files_with_skin_in_the_scan_lead_by_hand_to_a_trusted_answer_as_the_line_of_the_page_says() {
    let Some(mut browser) = Browser::start("two_files_with_skin_in_the_scan_lead_by_hand") else { return };
    let browser = &mut browser;
    let folder = tempfile::tempdir().unwrap();
    simulate_wound(folder.path());
    let mesh = read_mesh(&folder.path().join("bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
    let scan = read_cloud(&folder.path().join("scan.ply"), 1.0, "camera").unwrap().cloud;
    // What the reader recognises by eye is known by the truth alone.
    let truth = json(&folder.path().join("truth.json"));
    let t_ct_camera = isometry(&truth["CT_T_W"]) * isometry(&truth["W_T_C_scan"]);
    let level = |sign: f64| *mesh.vertices().iter().min_by(|a, b| (sign * a.z).total_cmp(&(sign * b.z))).unwrap();
    let ends = [level(1.0), level(-1.0)];
    let mut case = Case::in_folder(folder, "wound", &mesh, &scan, ends, Some((t_ct_camera, 0.5)));
    let served = case.view(browser);
    browser.wait_until("osteoflow.scene.drawn.has('scan.cloud')");
    wait_for_line(browser, "Crop the scan to the bone: skin or drape is in it", Some("Region"));
    browser.screenshot("wound-1-doubtful");

    press(browser, "#next button");
    browser.wait_until("osteoflow.region.isOpen");
    wait_for_line(browser, "Draw around the bone on the scan", None);
    draw_around_bone(browser, &case);
    browser.screenshot("wound-2-drawn");
    wait_for_line(browser, "Press save and run below the scan, or draw more", None);
    press(browser, "#region-save");
    let ended = |browser: &mut Browser, n: usize| {
        browser.wait_until(&format!(
            "osteoflow.state.run === 'run-{n}' && ['complete', 'refused'].includes(osteoflow.state.state)"
        ));
    };
    ended(browser, 2);
    browser.screenshot("wound-3-cropped");
    let place = "Show where the scan lies: pick three places on the bone, and the same on the scan";
    wait_for_line(browser, place, Some("Pick pairs"));

    press(browser, "#next button");
    browser.wait_until("osteoflow.picking.mode === 'pairs'");
    pair_side_by_side(browser, &case, 3, false);
    ended(browser, 3);
    browser.screenshot("wound-4-trusted");
    let done = "Touch one landmark with a stylus, or scan a check piece, before you use this answer";
    wait_for_line(browser, done, None);
    // What the page says is what the file has; the pose was compared with the truth when the pairs were saved.
    let verdict = &json(&case.run(3).join("results.json"))["verdict"];
    assert_eq!(text(browser, "verdict"), format!("trusted {}", verdict["sentence"].as_str().unwrap()));
    assert_eq!(verdict["answer"], "trusted");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

/// Exit code and words of a command in a folder.
fn command(at: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = osteoflow().current_dir(at).args(arguments).output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
}

fn ends_well(at: &Path, arguments: &[&str]) {
    let (code, said) = command(at, arguments);
    assert_eq!(code, Some(0), "{arguments:?}: {said}");
}

/// A block of a page of the documentation that holds these words.
fn block(page: &str, words: &str) -> String {
    let text = fs::read_to_string(root().join(page)).unwrap();
    let code =
        text.split("```").find(|part| part.contains(words)).map(|part| part.split_once('\n').unwrap().1.to_owned());
    code.unwrap_or_else(|| panic!("{page} has no block with {words}"))
}

#[test]
fn a_table_of_poses_of_a_tracker_of_ones_own_leads_to_cutting_planes_in_the_trackers_frame() {
    let folder = tempfile::tempdir().unwrap();
    ends_well(folder.path(), &["new", "procedure", "my_procedure"]);
    let at = folder.path().join("my_procedure");
    ends_well(&at, &["run", "run.toml", "--out", "first"]);
    // The same poses as a tracker of its own writes them: microseconds, the scalar first, a word for each state, zeros where it saw nothing.
    let ours = at.join("data/poses.csv");
    let mut table = String::from("timestamp_us,marker,status,Q0,Qx,Qy,Qz,Tx,Ty,Tz\n");
    for (k, row) in fs::read_to_string(&ours).unwrap().lines().skip(1).enumerate() {
        let [t_ns, parent, child, x, y, z, qx, qy, qz, qw] = row.split(',').collect::<Vec<_>>().try_into().unwrap();
        let us = t_ns.parse::<u64>().unwrap() / 1000;
        // The tracker knows nothing of the phantom's CAD, which the plan has.
        if parent == "world" {
            writeln!(table, "{us},{child},OK,{qw},{qx},{qy},{qz},{x},{y},{z}").unwrap();
        }
        if k % 100 == 50 {
            writeln!(table, "{},{child},MISSING,0,0,0,0,0,0,0", us + 1).unwrap();
        }
    }
    fs::write(at.join("tracker.csv"), table).unwrap();
    let columns = block("docs/use/formats.md", "child_column").replace("\"tracker\"", "\"world\"");
    fs::write(at.join("tracker.toml"), &columns).unwrap();
    let convert = ["convert", "tracker.csv", "data/poses.csv", "--columns", "tracker.toml"];
    let (code, said) = command(&at, &convert);
    assert!(code == Some(2) && said.contains("exists already; name another file"), "{said}");
    fs::remove_file(&ours).unwrap();
    let (code, said) = command(&at, &convert);
    assert!(code == Some(0) && said.contains("7 of them lost"), "{said}");
    ends_well(&at, &["run", "run.toml", "--out", "own"]);

    let planes = |run: &str| -> Vec<Isometry3<f64>> {
        let results = json(&at.join(run).join("results.json"));
        assert_eq!(results["verdict"]["answer"], "trusted", "{run}");
        let planes = results["planes_at_scan"].as_array().unwrap();
        let in_world = |plane: &Value| {
            assert_eq!(plane["frame"], "world");
            isometry(&plane["matrix"])
        };
        planes.iter().map(in_world).collect()
    };
    let truth = json(&at.join("data/truth.json"));
    let truth = truth["planes_W_scan"].as_array().unwrap();
    assert_eq!(truth.len(), 2);
    for ((own, first), plane) in planes("own").iter().zip(planes("first")).zip(truth) {
        let plane = isometry(plane);
        let normal = |t: &Isometry3<f64>| t.rotation * Vector3::z();
        let off_mm = (own.translation.vector - plane.translation.vector).dot(&normal(&plane)).abs();
        let tilt_deg = normal(own).angle(&normal(&plane)).to_degrees();
        // The limits beyond which a cut counts as wrong are 1.5 mm and 0.5 degrees.
        assert!(off_mm < 0.5 && tilt_deg < 0.5, "{off_mm} mm, {tilt_deg} degrees from the true plane");
        let moved_mm = (own.translation.vector - first.translation.vector).norm();
        assert!(moved_mm < 1e-6, "{moved_mm} mm from the planes by the program's own table");
    }

    // With the scalar last the poses are wrong ones, and there is no plane.
    let columns = columns
        .replace("w = \"Q0\", x = \"Qx\", y = \"Qy\", z = \"Qz\"", "w = \"Qz\", x = \"Q0\", y = \"Qx\", z = \"Qy\"");
    fs::write(at.join("tracker.toml"), columns).unwrap();
    fs::remove_file(&ours).unwrap();
    ends_well(&at, &convert);
    let (code, said) = command(&at, &["run", "run.toml", "--out", "wrong"]);
    assert!(code == Some(3) && said.contains("node \"calibration\""), "{said}");
    assert!(json(&at.join("wrong/results.json"))["planes_at_scan"].is_null());
}

#[test]
fn an_icp_of_ones_own_in_python_leads_from_an_edit_over_a_sweep_of_two_settings_to_a_p_value() {
    let Some(folder) = Folder::new("an_icp_of_ones_own_in_python_leads", &[]) else { return };
    let ends_well = |at: &Path, arguments: &[&str]| {
        let output = osteoflow().current_dir(at).env("OSTEOFLOW_PYTHON", &folder.1).args(arguments).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    };
    ends_well(folder.0.path(), &["new", "plugin", "my_icp", "--lang", "python"]);
    let at = folder.path("my_icp");
    let edit = |file: &str, changes: &[(&str, &str)]| {
        let mut text = fs::read_to_string(at.join(file)).unwrap();
        for (from, to) in changes {
            assert_eq!(text.matches(from).count(), 1, "{file} has one {from}");
            text = text.replace(from, to);
        }
        fs::write(at.join(file), text).unwrap();
    };
    // A parameter as the page on nodes in Python writes one.
    let share = block("docs/extend/python-nodes.md", "share: float");
    let share = share.lines().find(|line| line.contains("share: float")).unwrap().replace("param(0.5", "param(1.0");
    edit(
        "my_icp.py",
        &[
            ("class Params:\n", &format!("class Params:\n{share}\n")),
            (
                "tree_of(target), source.points\n",
                "tree_of(target), source.points[: int(len(source) * self.params.share)]\n",
            ),
        ],
    );
    edit(
        "graphs/study.toml",
        &[
            ("repeat  = 10", "repeat  = 1"),
            ("values = [1, 2] }", "values = [1, 2, 3, 4, 5, 6] }"),
            (
                "{ key = \"icp.kind\", values = [\"icp.point_to_plane\", \"my_icp.point_to_plane\"] }",
                "{ key = \"icp.share\", values = [1.0, 0.5] }",
            ),
            ("to = \"icp.point_to_plane\" }", "to = 1.0 }"),
        ],
    );
    let quick = ["--set", "recording.camera.n_points=8000", "--set", "sweep.twice=0"];
    ends_well(&at, &[&["sweep", "graphs/study.toml", "--out", "S"], &quick[..]].concat());
    ends_well(&at, &["report", "S", "--plugin", "my_icp.py"]);

    // The p-value is that of another program, of the errors in the table.
    let script = "import csv; from scipy.stats import wilcoxon; rows = list(csv.DictReader(open('S/runs.csv'))); \
                  of = lambda share: [float(row['tre_true_mm']) for row in rows if float(row['method']) == share]; \
                  print(len(rows), wilcoxon(of(0.5), of(1.0)).pvalue)";
    let scipy = Command::new(&folder.1).current_dir(&at).args(["-c", script]).output().unwrap();
    let stdout = String::from_utf8_lossy(&scipy.stdout).into_owned();
    let (n, expected) =
        stdout.trim().split_once(' ').unwrap_or_else(|| panic!("{}", String::from_utf8_lossy(&scipy.stderr)));
    let expected: f64 = expected.parse().unwrap();
    let summary = json(&at.join("S/summary.json"));
    let compared =
        summary["comparisons"].as_array().unwrap().iter().find(|one| one["column"] == "tre_true_mm").unwrap();
    let p = compared["wilcoxon"]["p"].as_f64().unwrap();
    assert_eq!((n, compared["n"].as_u64()), ("12", Some(6)), "{compared}");
    assert!(
        (p - expected).abs() < 1e-12 && p < 0.05,
        "p = {p}, by scipy {expected}: half of the scan is worse on each of six bones"
    );
    let report = fs::read_to_string(at.join("S/report.html")).unwrap();
    assert!(report.contains(&format!("{p:.3}")) && report.contains("tre_true_mm"), "p = {p:.3} is in the report");
}
