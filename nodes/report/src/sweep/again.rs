//! A run of a sweep once more: a sweep's folder holds no surfaces, so what is drawn on one comes from the graph again.

use super::{Swept, number_of};
use crate::{cell::number, evidence::Evidence, html::Page, run::fragments};
use osteoflow_engine::{
    Faults, RunOptions,
    plugin::Kinds,
    run,
    sweep::{Column, Done, Folder, again},
};
use serde_json::Value as Json;

/// The fragments of the run in the middle and of the worst one, by the first column in mm.
pub(super) fn maps(page: &mut Page, sweep: &Swept, folder: &Folder, kinds: &Kinds) {
    let Some(column) = sweep.numeric().into_iter().find(|column| column.name.ends_with("_mm")) else { return };
    for (which, run) in chosen(sweep, column) {
        let value = number_of(run, column).map(number).unwrap_or_default();
        let of = format!(" of run {} ({which} by the size of {}, {value} mm)", run.run, column.name);
        match recomputed(folder, run, kinds) {
            Ok(None) => return,
            Ok(Some((evidence, _dir))) => fragments::maps(page, &evidence, &of, &format!("-run-{}", run.run)),
            Err(why) => page.missing(&format!("The fragment{of} against the planned one"), &why),
        }
    }
}

/// The run in the middle and the worst.
fn chosen<'a>(sweep: &'a Swept, column: &Column) -> Vec<(&'static str, &'a Done)> {
    let complete = sweep.runs.iter().filter(|run| run.status == "complete");
    let mut runs: Vec<(f64, &Done)> = complete.filter_map(|run| Some((number_of(run, column)?.abs(), run))).collect();
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    match runs.len() {
        0 => Vec::new(),
        1 => vec![("the only one", runs[0].1)],
        n => vec![("the median", runs[(n - 1) / 2].1), ("the worst", runs[n - 1].1)],
    }
}

/// Runs a run of the sweep once more with the wires recorded that its maps need, into a folder that goes with the answer;
/// nothing if its graph has no cuts.
fn recomputed(folder: &Folder, done: &Done, kinds: &Kinds) -> Result<Option<(Evidence, tempfile::TempDir)>, String> {
    let checked = |more: &[String]| {
        let checked = again(folder, done.run, more, kinds).map_err(|e| e.to_string())?;
        checked.map_err(|faults| format!("its graph has faults now: {}", first(&faults)))
    };
    let plan = checked(&[])?.plan;
    let Some(wires) = fragments::wires(&plan) else { return Ok(None) };
    let with_record = checked(&[format!("record.wires={}", Json::from(wires))])?;
    let dir = tempfile::tempdir().map_err(|e| format!("no folder for running it again: {e}"))?;
    let notice = done.results["notice"].clone();
    let options = RunOptions {
        workers: std::thread::available_parallelism().map_or(1, usize::from),
        out_dir: Some(dir.path().into()),
        record: true,
        fixed_results: if notice.is_null() { Vec::new() } else { vec![("notice".into(), notice)] },
        ..RunOptions::default()
    };
    run(&with_record.plan, &with_record.registry, &options, &()).map_err(|e| format!("run again it failed: {e}"))?;
    let evidence = Evidence::open(dir.path(), &with_record.registry).map_err(|e| e.to_string())?;
    if evidence.results != done.results {
        return Err(
            "run again from the frozen graph it gives other results; has the program or an input changed since?".into(),
        );
    }
    Ok(Some((evidence, dir)))
}

fn first(faults: &Faults) -> String {
    faults.0.first().map_or_else(|| "unknown".into(), |fault| fault.message.clone())
}
