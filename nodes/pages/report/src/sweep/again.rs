//! Repeats runs of a sweep, because a sweep's folder holds no surfaces to draw on.

use super::{SweepResults, number_of};
use crate::{
    diagram,
    format::number,
    html::Page,
    methods,
    run::{
        fragments::{self, Maps},
        graph,
    },
    run_folder::RunFolder,
};
use osteoflow_engine::{
    Checked, Faults, RunOptions,
    plugin::Kinds,
    run,
    sweep::{Column, Done, Folder, again},
};
use serde_json::Value as Json;

/// The graphs that ran: one for each combination of kinds, with the settings of the first run that had it.
pub(super) fn graphs(sweep: &SweepResults, folder: &Folder, kinds: &Kinds) -> Result<Vec<Checked>, String> {
    let mut combinations = Vec::new();
    let mut graphs = Vec::new();
    for run in &sweep.runs {
        let combination = sweep.kinds_set(run);
        if !combinations.contains(&combination) {
            graphs.push(checked(folder, run, &[], kinds)?);
            combinations.push(combination);
        }
    }
    Ok(graphs)
}

/// The nodes of these graphs: each once for each of its kinds, with the parameters of the first that has it.
pub(super) fn steps(graphs: &[Checked]) -> Vec<(String, toml::Table)> {
    let mut steps: Vec<(String, toml::Table)> = Vec::new();
    for (name, table) in graphs.iter().flat_map(|checked| methods::nodes_of(&checked.plan.resolved)) {
        let is_known = |step: &&(String, toml::Table)| step.0 == name && step.1.get("kind") == table.get("kind");
        if steps.iter().find(is_known).is_none() {
            let after = steps.iter().rposition(|step| step.0 == name).map_or(steps.len(), |last| last + 1);
            steps.insert(after, (name, table));
        }
    }
    steps
}

/// The graph with the settings of the first run.
pub(super) fn picture(page: &mut Page, sweep: &SweepResults, graphs: &Result<Vec<Checked>, String>) {
    let Some(first) = sweep.runs.first() else { return };
    let caption = format!(
        "The graph with the settings of run {}: nodes with kinds, wires with payloads. What a factor sets differs \
         in other runs.",
        first.run
    );
    match graphs {
        Ok(graphs) => graph(page, diagram::of_plan(&graphs[0].plan), &caption),
        Err(why) => page.missing("The graph", why),
    }
}

/// Maps of the fragments of the median run and the worst run, in the setting with the largest fragment error.
pub(super) fn maps(page: &mut Page, sweep: &SweepResults, folder: &Folder, kinds: &Kinds) {
    let numeric = sweep.numeric();
    let names: Vec<_> = numeric.iter().map(|column| column.name.as_str()).collect();
    let Some(column) = mapped(&names).map(|at| numeric[at]) else { return };
    let settings = sweep.settings();
    let mean = |runs: &[&Done]| {
        let sizes: Vec<f64> = runs.iter().filter_map(|run| Some(number_of(run, column)?.abs())).collect();
        sizes.iter().sum::<f64>() / sizes.len().max(1) as f64
    };
    let Some(setting) = settings.iter().max_by(|a, b| mean(&a.runs).total_cmp(&mean(&b.runs))) else { return };
    let within = match settings.len() {
        1 => String::new(),
        _ => format!(" within the setting {}, which has its greatest mean", setting.name),
    };
    let mut drawn = Vec::new();
    for (which, run) in chosen(&setting.runs, column) {
        let value = number_of(run, column).map(number).unwrap_or_default();
        let of = format!(" of run {} ({which} by the size of {}, {value} mm,{within})", run.run, column.name);
        let of = of.replace(",)", ")");
        match recomputed(folder, run, kinds) {
            Ok(None) => return,
            Ok(Some((repeated, _dir))) => drawn.push((run.run, of, Maps::of(&repeated))),
            Err(why) => drawn.push((run.run, of, Err(why))),
        }
    }
    // One colour range for all maps, so that they can be compared.
    let range_mm = drawn.iter().filter_map(|(.., maps)| Some(maps.as_ref().ok()?.range_mm)).fold(0.0, f64::max);
    for (run, of, maps) in drawn {
        match maps {
            Ok(maps) => maps.draw(page, range_mm, &of, &format!("-run-{run}")),
            Err(why) => page.missing(&format!("The fragment{of} against the planned one"), &why),
        }
    }
}

/// The index of the column to choose runs by: the greatest distance of an aligned fragment, otherwise another column about
/// fragments, otherwise the first in mm.
fn mapped(names: &[&str]) -> Option<usize> {
    let find = |wanted: &dyn Fn(&str) -> bool| names.iter().position(|name| name.ends_with("_mm") && wanted(name));
    find(&|name| name == "aligned_max_mm")
        .or_else(|| find(&|name| name.starts_with("aligned") || name.starts_with("fragment")))
        .or_else(|| find(&|_| true))
}

/// The median run and the worst run.
fn chosen<'a>(runs: &[&'a Done], column: &Column) -> Vec<(&'static str, &'a Done)> {
    let mut runs: Vec<(f64, &Done)> =
        runs.iter().filter_map(|run| Some((number_of(run, column)?.abs(), *run))).collect();
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    match runs.len() {
        0 => Vec::new(),
        1 => vec![("the only one", runs[0].1)],
        n => vec![("the median", runs[(n - 1) / 2].1), ("the worst", runs[n - 1].1)],
    }
}

fn checked(folder: &Folder, done: &Done, more: &[String], kinds: &Kinds) -> Result<Checked, String> {
    let checked = again(folder, done.run, more, kinds).map_err(|e| e.to_string())?;
    checked.map_err(|faults| format!("its graph has faults: {}", first(&faults)))
}

/// Repeats a run with the wires recorded that its maps need, in a temporary folder that is returned too; `None` if the graph
/// has no cuts.
fn recomputed(folder: &Folder, done: &Done, kinds: &Kinds) -> Result<Option<(RunFolder, tempfile::TempDir)>, String> {
    let plan = checked(folder, done, &[], kinds)?.plan;
    let Some(wires) = fragments::wires(&plan) else { return Ok(None) };
    let with_record = checked(folder, done, &[format!("record.wires={}", Json::from(wires))], kinds)?;
    let dir = tempfile::tempdir().map_err(|e| format!("no temporary folder: {e}"))?;
    let notice = done.results["notice"].clone();
    let options = RunOptions {
        workers: std::thread::available_parallelism().map_or(1, usize::from),
        out_dir: Some(dir.path().into()),
        record: true,
        fixed_results: if notice.is_null() { Vec::new() } else { vec![("notice".into(), notice)] },
        ..RunOptions::default()
    };
    run(&with_record.plan, &with_record.registry, &options, &())
        .map_err(|e| format!("the repeated run failed: {e}"))?;
    let repeated = RunFolder::open(dir.path(), &with_record.registry).map_err(|e| e.to_string())?;
    if !done.gave(&repeated.results) {
        return Err(
            "the repeated run of the frozen graph gives other results; has the program or an input changed?".into()
        );
    }
    Ok(Some((repeated, dir)))
}

fn first(faults: &Faults) -> String {
    faults.0.first().map_or_else(|| "unknown".into(), |fault| fault.message.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_choose_runs_by_the_column_of_fragment_distances() {
        let of = |names: &[&str]| mapped(names).map(|at| names[at].to_owned());
        assert_eq!(of(&["tre_x_mm", "aligned_mm", "aligned_max_mm"]).as_deref(), Some("aligned_max_mm"));
        assert_eq!(of(&["iterations", "tre_x_mm", "aligned_mm"]).as_deref(), Some("aligned_mm"));
        assert_eq!(of(&["iterations", "tre_x_mm", "fre_mm"]).as_deref(), Some("tre_x_mm"));
        assert_eq!(of(&["iterations"]), None);
    }
}
