//! Checks a sweep before it starts: every run, and the hash of everything that determines the tables.

use super::{Draw, Factor, Folder, FolderError, GRAPH, Run, Spec, Sweep, SweepRow, input_files, rows, share};
use crate::{
    check::{self, Checked},
    fault::{Fault, Faults},
    graph::{SetKey, keys_set},
    hash::{Digest, files::hashes, program},
    plugin::Kinds,
    runtime::on_workers,
    store::Key,
    watch::Stamps,
};
use osteoflow_node::Role;
use serde_json::{Value as Json, json};
use std::{
    path::Path,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

/// Checks the graph file at `path` and every run of its sweep, on `workers` threads.
///
/// # Errors
/// [`Faults`] of the graph, or of the first run that has any, with the settings of that run; and if the graph has no
/// `[sweep]`.
pub fn check(path: &Path, sets: &[String], kinds: impl Into<Kinds>, workers: usize) -> Result<Sweep, Faults> {
    check_as(path, sets, kinds, workers, None)
}

/// As [`check`], with the specification of an earlier sweep in place of the graph's `[sweep]`.
///
/// # Errors
/// As [`check`].
pub fn check_as(
    path: &Path,
    sets: &[String],
    kinds: impl Into<Kinds>,
    workers: usize,
    spec: Option<Spec>,
) -> Result<Sweep, Faults> {
    let kinds = kinds.into().held().map_err(|error| {
        Faults(vec![Fault::new(format!("no folder for copies of the plugins can be made: {error}"))])
    })?;
    let Checked { plan, warnings, registry, sweep } = check::check_sweep(path, sets, &kinds)?;
    let Some(spec) = spec.map(Box::new).or(sweep) else {
        let fault = Fault::new(format!("{} has no table [sweep]", path.display()));
        let help = "say what is varied, such as [sweep] repeat = 10, and which numbers are wanted in [sweep.columns]";
        return Err(Faults(vec![fault.help(help)]));
    };
    if let Some(live) = plan.nodes.iter().find(|node| node.role == Role::LiveSource) {
        let fault = Fault::new(format!("node \"{}\" is a live source, which gives what it gives once", live.name));
        return Err(Faults(vec![fault.help("record it, and sweep over the recording")]));
    }
    let overridden = overridden(&spec, sets);
    if !overridden.is_empty() {
        return Err(Faults(overridden));
    }
    let rows = rows(&spec, plan.seed);
    let (runs, files) = check_rows(path, sets, &kinds, rows, workers)?;
    let hash = hash(&spec, &runs);
    Ok(Sweep { spec: *spec, warnings, plan, registry, runs, files, hash })
}

/// Settings of the command line that no run would use, because a factor or a draw sets their key in all of them. If
/// some values of a factor do not set the key, the runs with those values use the setting.
fn overridden(spec: &Spec, sets: &[String]) -> Vec<Fault> {
    let sets_it = |keys: Vec<SetKey>, asked: &SetKey| keys.iter().any(|key| key.overrides(asked));
    let of_all = |factor: &Factor, asked: &SetKey| factor.levels.iter().all(|level| sets_it(level.keys_set(), asked));
    let mut faults = Vec::new();
    for (key, at) in keys_set(sets) {
        let factor = spec.factors.iter().find(|factor| of_all(factor, &key));
        let (by, help) = match (factor, spec.draws.iter().find(|draw| sets_it(draw.keys_set(), &key))) {
            (Some(Factor { name, .. }), _) => {
                let help = format!("set sweep.factor.{name}.values='[..]' instead");
                (format!("the factor \"{name}\""), help)
            }
            (_, Some(Draw { name, .. })) => {
                (format!("the draw \"{name}\""), format!("set sweep.draw.{name} instead, such as its distribution"))
            }
            _ => continue,
        };
        let fault = Fault::new(format!("{key} is set by {by} of the sweep")).at(&at, "no run would take it");
        faults.push(fault.help(help));
    }
    faults
}

/// Checks one run of a sweep again, from its folder: the frozen graph with the run's settings, and with `sets` in
/// addition. Program and input files may have changed, so compare the results with the stored ones.
///
/// # Errors
/// If the folder cannot be read; inner: the faults that the graph has now.
pub fn again(
    folder: &Folder,
    run: usize,
    sets: &[String],
    kinds: &Kinds,
) -> Result<Result<Checked, Faults>, FolderError> {
    let path = Path::new(folder.about["graph"]["file"].as_str().unwrap_or(GRAPH));
    Ok(check::check_frozen(folder.graph()?, path, &folder.sets(run)?, sets, kinds))
}

/// The plans of all rows, with the current state of their input files. Rows are checked in parallel; the first with
/// faults is reported.
fn check_rows(
    path: &Path,
    sets: &[String],
    kinds: &Kinds,
    rows: Vec<SweepRow>,
    workers: usize,
) -> Result<(Vec<Run>, Stamps), Faults> {
    let (next, places) = (AtomicUsize::new(0), rows.iter().map(|_| Mutex::new(None)).collect::<Vec<_>>());
    let stop = AtomicBool::new(false);
    let look = |_| {
        while !stop.load(Ordering::Relaxed)
            && let index = next.fetch_add(1, Ordering::Relaxed)
            && let Some(row) = rows.get(index)
        {
            let checked = check::check_row(path, sets, &row.sets, kinds);
            stop.fetch_or(checked.is_err(), Ordering::Relaxed);
            *places[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(checked);
        }
    };
    on_workers(workers.min(rows.len()).max(1), &look, &|_, error| tracing::warn!("one thread less: {error}"));
    let mut runs = Vec::with_capacity(rows.len());
    let mut files = Stamps::default();
    for (row, place) in rows.iter().zip(places) {
        let checked = match place.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(Ok(checked)) => checked,
            Some(Err(mut faults)) => {
                let setting = |(name, value): &(String, Json)| format!("{name} = {value}");
                let settings: Vec<_> = row.values.iter().map(setting).collect();
                let note = format!("in run {} of the sweep: {}", row.run, settings.join(", "));
                faults.0.iter_mut().for_each(|fault| fault.notes.push(note.clone()));
                return Err(faults);
            }
            // Another row has faults; the first is reported.
            None => continue,
        };
        let mut plan = checked.plan;
        let new: Vec<_> = plan.input_files.iter().filter(|file| files.get(file).is_none()).cloned().collect();
        files = files.and(&Stamps::of(new));
        let keys = share::keys(&plan, &files);
        plan.path = path.into();
        runs.push(Run { row: row.clone(), plan, keys });
    }
    Ok((runs, files))
}

/// Hash of the sweep, the graph of each run with the contents of its input files, and the program.
fn hash(spec: &Spec, runs: &[Run]) -> Digest {
    let mut key = Key::of("sweep").json("spec", &json!(spec));
    if let Some(program) = program::digest() {
        key = key.digest("program", program);
    }
    // The same files at another path give the same sweep.
    let mut names = Vec::new();
    for (index, file) in input_files(runs).iter().enumerate() {
        names.push((Json::from(file.to_string_lossy()).to_string(), format!("\"file {index}\"")));
        for entry in hashes(std::slice::from_ref(file)) {
            key = key.number("file", index as u64).text("sha256", &entry["sha256"].to_string());
        }
    }
    for run in runs {
        let text = names.iter().fold(run.plan.resolved.clone(), |text, (name, short)| text.replace(name, short));
        key = run.plan.plugins.iter().fold(key, |key, plugin| key.text("plugin", &plugin.sha256));
        key = key.text("graph", &text);
    }
    key.done().digest()
}
