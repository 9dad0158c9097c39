//! Tables of a run's results: the verdict, and the known keys of `results.json` in mm and degrees.

use super::{global::Global, other_numbers, text_table::TextTable, verdict_lines};
use crate::app::{NOTICE, judged};
use osteoflow_geometry::{isometry_from_matrix, nalgebra::Matrix4};
use osteoflow_report::summary::word;
use serde::Deserialize;
use serde_json::Value;

/// The verdict, the tables of the known keys in `results`, and all other numbers.
pub(crate) fn text(results: &Value, global: &Global) -> String {
    blocks(results, tables(results), &[], global)
}

/// The verdict and the tables of the known keys, with the values of an earlier run below those that have changed.
pub(crate) fn text_beside(results: &Value, earlier: &Value, global: &Global) -> String {
    let mut now = tables(results);
    let earlier = tables(earlier);
    let mut changed = Vec::new();
    for table in &mut now {
        if let Some(was) = earlier.iter().find(|was| was.title() == table.title()) {
            let before = table.lines();
            table.beside(was);
            if table.lines() != before {
                changed.push(table.title().to_owned());
            }
        }
    }
    blocks(results, now, &changed, global)
}

/// `changed` are the titles of tables that are shown in any case.
fn blocks(results: &Value, mut tables: Vec<TextTable>, changed: &[String], global: &Global) -> String {
    let is_brief = global.verbose == 0;
    let mut blocks: Vec<_> = verdict_lines::text(results, global).into_iter().collect();
    blocks.push(banner(results));
    // Without a verdict the reports of the steps are all that speaks for the result.
    let shows_steps = !is_brief || judged(results).is_none();
    let numbers = other_numbers::text(results, shows_steps);
    let mut hidden = Vec::new();
    if is_brief {
        let is_answer = |title: &str| ANSWERS.contains(&title);
        let has_planes = tables.iter().any(|table| table.title() == PLANES);
        let has_answer = tables.iter().any(|table| is_answer(table.title()));
        tables.retain(|table| {
            let title = table.title();
            let is_first = is_answer(title) && !(title == PLANES_AT_SCAN && has_planes);
            let is_shown = is_first || title == POSES && !has_answer || title == ICP && shows_steps;
            let is_shown = is_shown || changed.iter().any(|of| of == title);
            if !is_shown {
                hidden.push(title.to_owned());
            }
            is_shown
        });
    } else {
        // Before the tables, which are then above the prompt.
        blocks.extend(numbers.lines());
    }
    blocks.extend(tables.iter().map(TextTable::lines));
    if is_brief {
        blocks.extend(numbers.lines());
        if numbers.n_left_out > 0 {
            hidden.push(format!("{} numbers of steps", numbers.n_left_out));
        }
        if !hidden.is_empty() {
            blocks.push(format!("with --verbose: {}", hidden.join(", ")));
        }
    }
    blocks.join("\n")
}

const POSES: &str = "poses";
const ICP: &str = "icp";
const PLANES: &str = "planes, latest";
const PLANES_AT_SCAN: &str = "planes at the scan";
const CUTS: &str = "cuts, error";
const TRE: &str = "TRE";
const TRE_TRUE: &str = "TRE, true";
const TRE_MEASURED: &str = "TRE, measured by stylus";
/// The tables that a reader asks for first; the others are for --verbose.
const ANSWERS: [&str; 6] = [TRE, TRE_TRUE, TRE_MEASURED, CUTS, PLANES, PLANES_AT_SCAN];

/// The tables, those with the answers first.
fn tables(results: &Value) -> Vec<TextTable> {
    let tables = [
        both_target_errors(results),
        target_errors(results, "tre_true_mm", TRE_TRUE).filter(|_| both_target_errors(results).is_none()),
        target_errors(results, "tre_measured_mm", TRE_MEASURED).filter(|_| both_target_errors(results).is_none()),
        cuts(results),
        planes(results, "planes", PLANES),
        planes(results, "planes_at_scan", PLANES_AT_SCAN),
        poses(results),
        points(results),
        icp(results),
    ];
    tables.into_iter().flatten().collect()
}

/// The notice, whether the data are simulated, and the origin of the surface.
fn banner(results: &Value) -> String {
    let mut words = Vec::new();
    if results.get("simulated") == Some(&Value::Bool(true)) {
        words.push("SIMULATED".to_owned());
    }
    if let Some(surface) = results.get("ct_surface") {
        words.push(format!("ct_surface = {}", word(surface)));
    }
    words.push(NOTICE.to_owned());
    format!("{}\n", words.join(", "))
}

fn poses(results: &Value) -> Option<TextTable> {
    let mut table = TextTable::new(POSES, &["x", "y", "z mm", "rx", "ry", "rz deg"]);
    for (name, pose) in results.get("poses")?.as_object()? {
        table.row(name, pose_cells(&pose["matrix"]));
    }
    some(table)
}

/// The origin, and the rotation vector.
fn pose_cells(matrix: &Value) -> Vec<String> {
    let Some(t) = matrix4(matrix).and_then(|m| isometry_from_matrix(&m).ok()) else { return vec!["unknown".into()] };
    let turn = t.rotation.scaled_axis().map(f64::to_degrees);
    let origin = t.translation.vector;
    origin.iter().chain(turn.iter()).map(|&v| fixed(v, 2)).collect()
}

fn points(results: &Value) -> Option<TextTable> {
    let mut table = TextTable::new("laser points", &["x", "y", "z mm", "confidence"]);
    for point in results.get("laser_points")?.as_array()? {
        let mut cells: Vec<_> = point["position_mm"].as_array().into_iter().flatten().map(|c| number(c, 2)).collect();
        cells.push(number(&point["confidence"], 2));
        cells.extend(point["frame"].as_str().map(|frame| format!("in {frame}")));
        table.row(word(&point["name"]), cells);
    }
    some(table)
}

fn icp(results: &Value) -> Option<TextTable> {
    let icp = results.get("icp")?;
    let mut table = TextTable::new(ICP, &["iterations", "pairs", "rms mm", "leaves mm"]);
    let how = if icp["converged"] == Value::Bool(true) { "converged" } else { "not converged" };
    let stop = format!("stopped by {}", word(&icp["stop_reason"]));
    let leaves = number(if icp["left_mm"].is_number() { &icp["left_mm"] } else { &icp["remaining_mm"] }, 3);
    table.row(how, [word(&icp["iterations"]), word(&icp["n_pairs"]), number(&icp["rms_mm"], 4), leaves, stop]);
    some(table)
}

fn planes(results: &Value, key: &str, title: &str) -> Option<TextTable> {
    let mut table = TextTable::new(title, &["x", "y", "z mm", "nx", "ny", "nz"]);
    for plane in results.get(key)?.as_array()? {
        let cells = match (plane.get("unknown"), matrix4(&plane["matrix"])) {
            (None, Some(m)) => {
                let mut cells: Vec<_> = (0..3).map(|k| fixed(m[(k, 3)], 2)).collect();
                cells.extend((0..3).map(|k| fixed(m[(k, 2)], 4)));
                cells.extend(plane["frame"].as_str().map(|frame| format!("in {frame}")));
                cells
            }
            (reason, _) => {
                let reason = reason.map_or_else(|| "no matrix".into(), word);
                // Beyond the last column, so that a long reason does not widen it.
                [vec!["-".into(); 6], vec![format!("unknown: {reason}")]].concat()
            }
        };
        table.row(word(&plane["name"]), cells);
    }
    some(table)
}

/// Errors of the cuts: along the normal, about the bone's axis and across it, and of the point that is farthest off.
fn cuts(results: &Value) -> Option<TextTable> {
    let report = results.get("metrics")?.get("cuts")?;
    let mut table = TextTable::new(CUTS, &["offset mm", "tilt deg", "roll deg", "moved mm"]);
    let degrees = |of: &Value| of.as_f64().map_or_else(|| "-".into(), |v| fixed(v.to_degrees(), 2));
    for cut in report["cuts"].as_array()? {
        let cells = [number(&cut["offset_mm"], 3), degrees(&cut["tilt_rad"]), degrees(&cut["roll_rad"])];
        table.row(word(&cut["name"]), cells.into_iter().chain([number(&cut["moved_mm"], 3)]));
    }
    some(table)
}

fn target_errors(results: &Value, key: &str, title: &str) -> Option<TextTable> {
    let tre = results.get("metrics")?.get(key)?;
    let mut table = TextTable::new(title, &["x", "y", "z", "norm mm"]);
    for point in tre["points"].as_array()? {
        table.row(word(&point["name"]), components(point));
    }
    let mean = tre.get("mean_abs").map(components)?;
    table.row("mean |.|", mean.into_iter().chain([format!("n = {}", word(&tre["n"]))]));
    some(table)
}

/// The true error of each target beside the one that was measured by stylus; `None` if they are of other targets.
fn both_target_errors(results: &Value) -> Option<TextTable> {
    let both = ["tre_true_mm", "tre_measured_mm"].map(|key| &results["metrics"][key]);
    let points = both.map(|tre| tre["points"].as_array());
    let [Some(of_true), Some(measured)] = points else { return None };
    let is_same = |(a, b): (&Value, &Value)| a["name"] == b["name"];
    if of_true.len() != measured.len() || !of_true.iter().zip(measured).all(is_same) {
        return None;
    }
    let heads = ["true x", "y", "z", "norm mm", "by stylus x", "y", "z", "norm mm"];
    let mut table = TextTable::new(TRE, &heads);
    for (a, b) in of_true.iter().zip(measured) {
        table.row(word(&a["name"]), components(a).into_iter().chain(components(b)));
    }
    let [Some(a), Some(b)] = both.map(|tre| tre.get("mean_abs").map(components)) else { return None };
    table.row("mean |.|", a.into_iter().chain(b).chain([format!("n = {}", word(&both[0]["n"]))]));
    Some(table)
}

fn components(of: &Value) -> Vec<String> {
    ["x", "y", "z", "norm"].iter().map(|k| number(&of[k], 3)).collect()
}

fn number(of: &Value, digits: usize) -> String {
    of.as_f64().map_or_else(|| "-".into(), |v| fixed(v, digits))
}

fn matrix4(rows: &Value) -> Option<Matrix4<f64>> {
    let rows = <[[f64; 4]; 4]>::deserialize(rows).ok()?;
    Some(Matrix4::from_fn(|row, column| rows[row][column]))
}

/// Formats with fixed decimals, without a minus sign before zero.
fn fixed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    if text.starts_with('-') && text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.')) { text[1..].into() } else { text }
}

fn some(table: TextTable) -> Option<TextTable> {
    (!table.is_empty()).then_some(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::common::global::Format;
    use clap::ColorChoice;
    use serde_json::json;

    fn shown(results: &Value) -> String {
        shown_with(results, 0)
    }

    fn shown_with(results: &Value, verbose: u8) -> String {
        text(results, &Global { format: Format::Text, quiet: false, verbose, color: ColorChoice::Never })
    }

    #[test]
    fn the_banner_has_simulation_surface_and_intended_use() {
        let tables = shown(&json!({ "simulated": true, "ct_surface": "simulated_ct" }));
        assert_eq!(tables, "SIMULATED, ct_surface = simulated_ct, research use only, not for clinical use\n");
    }

    #[test]
    fn the_verdict_comes_before_the_banner() {
        let verdict = json!({ "answer": "trusted", "sentence": "it holds", "reasons": [] });
        let tables = shown(&json!({ "verdict": verdict, "simulated": true }));
        assert_eq!(tables, "verdict  trusted: it holds\n\nSIMULATED, research use only, not for clinical use\n");
    }

    #[test]
    fn known_keys_become_tables_in_mm_and_degrees() {
        let quarter_turn = [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 3.5], [0.0, 0.0, 0.0, 1.0]];
        let point = json!({ "name": "M1", "x": -0.0001, "y": 0.25, "z": -1.5, "norm": 1.52 });
        let results = json!({
            "poses": { "t_ct_world": { "to": "ct", "from": "world", "matrix": quarter_turn } },
            "planes": [
                { "name": "cut_1", "frame": "world", "stamp_ns": 1, "matrix": quarter_turn },
                { "name": "cut_2", "unknown": "bone_marker lost at 3 s" },
            ],
            "metrics": { "tre_true_mm": { "points": [point], "mean_abs": point, "n": 1 } },
        });
        let tables = shown_with(&results, 1);
        for expected in [
            "poses            x      y  z mm    rx    ry  rz deg\n  t_ct_world  1.00  -2.00  3.50  0.00  0.00   90.00\n",
            "  cut_1         1.00  -2.00  3.50  0.0000  0.0000  1.0000  in world\n",
            "  cut_2            -      -     -       -       -       -  unknown: bone_marker lost at 3 s\n",
            "  M1        0.000  0.250  -1.500    1.520\n",
            "  mean |.|  0.000  0.250  -1.500    1.520  n = 1\n",
        ] {
            assert!(tables.contains(expected), "{tables}\nlacks\n{expected}");
        }
    }
}
