//! Checks a sweep before it starts: every run, and the hash of everything that determines the tables.

use super::{Draw, Factor, Folder, FolderError, GRAPH, Run, Spec, Sweep, SweepRow, input_files, rows, share};
use crate::{
    check::{self, Checked},
    fault::{Fault, Faults},
    graph::{SetKey, Variant, keys_set},
    hash::{Digest, files::hashes, program},
    plan::Plan,
    plugin::Kinds,
    replay::exchange::without_old_defaults,
    runtime::on_workers,
    store::Key,
    watch::Stamps,
};
use osteoflow_node::{Registry, Role};
use serde_json::{Value as Json, json};
use std::{
    path::Path,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

/// A graph whose rows are checked one by one.
#[derive(Debug)]
pub(super) struct Base {
    pub(super) plan: Plan,
    pub(super) warnings: Vec<Fault>,
    sets: Vec<String>,
    kinds: Kinds,
    variants: Vec<Variant>,
    /// The kinds of the graph, and those of variants that name other plugins. The processes of nodes are kept with them.
    registries: Mutex<Vec<Arc<Registry>>>,
}

impl Base {
    /// Checks the graph file at `path` with settings; `None` instead of a specification if it has no `[sweep]`.
    pub(super) fn check(path: &Path, sets: &[String], kinds: impl Into<Kinds>) -> Result<(Self, Option<Spec>), Faults> {
        let kinds = kinds.into().held().map_err(|error| {
            Faults(vec![Fault::new(format!("no folder for copies of the plugins can be made: {error}"))])
        })?;
        let Checked { plan, warnings, registry, sweep } = check::check_sweep(path, sets, &kinds)?;
        if let Some(live) = plan.nodes.iter().find(|node| node.role == Role::LiveSource) {
            let fault = Fault::new(format!("node \"{}\" is a live source, which gives what it gives once", live.name));
            return Err(Faults(vec![fault.help("record it, and sweep over the recording")]));
        }
        let spec = sweep.map(|spec| *spec);
        let (sets, variants) = (sets.to_vec(), spec.as_ref().map(Spec::variants).unwrap_or_default());
        let registries = Mutex::new(vec![Arc::new(registry)]);
        Ok((Self { plan, warnings, sets, kinds, variants, registries }, spec))
    }

    /// The graph itself as a run.
    pub(super) fn run(&self) -> Run {
        let row = SweepRow { run: 0, values: Vec::new(), seed: self.plan.seed, sets: Vec::new() };
        let registry = self.registries.lock().unwrap_or_else(PoisonError::into_inner)[0].clone();
        Run { row, plan: self.plan.clone(), registry, keys: Vec::new(), asked: None }
    }

    /// The sweep of these runs.
    pub(super) fn sweep(&self, spec: Spec, runs: Vec<Run>, files: Stamps) -> Sweep {
        let (plan, warnings, hash) = (self.plan.clone(), self.warnings.clone(), Digest([0; 32]));
        Sweep { spec, warnings, plan, runs, files, hash }
    }

    /// The graph file and the specification of its sweep, or that of an earlier one.
    fn swept(
        path: &Path,
        sets: &[String],
        kinds: impl Into<Kinds>,
        earlier: Option<Spec>,
    ) -> Result<(Self, Spec), Faults> {
        let (mut base, spec) = Self::check(path, sets, kinds)?;
        if let Some(earlier) = &earlier {
            base.variants = earlier.variants();
        }
        let Some(spec) = earlier.or(spec) else {
            let fault = Fault::new(format!("{} has no table [sweep]", path.display()));
            let help =
                "say what is varied, such as [sweep] repeat = 10, and which numbers are wanted in [sweep.columns]";
            return Err(Faults(vec![fault.help(help)]));
        };
        let overridden = overridden(&spec, sets);
        if overridden.is_empty() { Ok((base, spec)) } else { Err(Faults(overridden)) }
    }

    /// The plans of rows, each with its faults in place of it; the input files that are not in `files` yet are added. The rows are
    /// checked in parallel. After a row with faults, others may be left out if `stops`.
    pub(super) fn rows(
        &self,
        rows: Vec<SweepRow>,
        workers: usize,
        stops: bool,
        files: &mut Stamps,
    ) -> Vec<Result<Run, (SweepRow, Faults)>> {
        let (next, places) = (AtomicUsize::new(0), rows.iter().map(|_| Mutex::new(None)).collect::<Vec<_>>());
        let stop = AtomicBool::new(false);
        let path = &self.plan.path;
        let look = |_| {
            while !stop.load(Ordering::Relaxed)
                && let index = next.fetch_add(1, Ordering::Relaxed)
                && let Some(row) = rows.get(index)
            {
                let checked = check::check_row(path, &self.sets, &row.sets, &self.variants, &self.kinds);
                stop.fetch_or(stops && checked.is_err(), Ordering::Relaxed);
                *places[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(checked);
            }
        };
        on_workers(workers.min(rows.len()).max(1), &look, &|_, error| tracing::warn!("one thread less: {error}"));
        let mut runs = Vec::with_capacity(rows.len());
        for (row, place) in rows.into_iter().zip(places) {
            let checked = match place.into_inner().unwrap_or_else(PoisonError::into_inner) {
                Some(Ok(checked)) => checked,
                Some(Err(faults)) => {
                    runs.push(Err((row, faults)));
                    continue;
                }
                // Another row has faults.
                None => continue,
            };
            let Checked { mut plan, registry, .. } = checked;
            let new: Vec<_> = plan.input_files.iter().filter(|file| files.get(file).is_none()).cloned().collect();
            *files = std::mem::take(files).and(&Stamps::of(new));
            let keys = share::keys(&plan, files);
            plan.path = path.clone();
            let registry = self.registry(&plan, registry);
            runs.push(Ok(Run { row, plan, keys, registry, asked: None }));
        }
        runs
    }

    /// Rows without faults, or those of the first that has some, with its settings.
    fn checked(&self, rows: Vec<SweepRow>, workers: usize, files: &mut Stamps) -> Result<Vec<Run>, Faults> {
        let with_settings = |(row, mut faults): (SweepRow, Faults)| {
            let setting = |(name, value): &(String, Json)| format!("{name} = {value}");
            let settings: Vec<_> = row.values.iter().map(setting).collect();
            let note = format!("in run {} of the sweep: {}", row.run, settings.join(", "));
            faults.0.iter_mut().for_each(|fault| fault.notes.push(note.clone()));
            faults
        };
        self.rows(rows, workers, true, files).into_iter().map(|run| run.map_err(with_settings)).collect()
    }

    /// The registry that has all kinds of a plan: that of another run if there is one, whose processes are kept.
    fn registry(&self, plan: &Plan, own: Registry) -> Arc<Registry> {
        let mut registries = self.registries.lock().unwrap_or_else(PoisonError::into_inner);
        let has = |registry: &&Arc<Registry>| {
            plan.nodes.iter().all(|node| registry.kind(&node.kind).is_some_and(|kind| kind.plugin == node.plugin))
        };
        if let Some(registry) = registries.iter().find(has) {
            return registry.clone();
        }
        registries.push(Arc::new(own));
        registries[registries.len() - 1].clone()
    }
}

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
    let (base, spec) = Base::swept(path, sets, kinds, spec)?;
    let mut files = Stamps::default();
    let runs = base.checked(rows(&spec, base.plan.seed), workers, &mut files)?;
    let hash = hash(&spec, &runs.iter().collect::<Vec<_>>(), &mut |file| hashes(&[file.into()]));
    Ok(Sweep { spec, warnings: base.warnings, plan: base.plan, runs, files, hash })
}

/// Checks these runs of a sweep only, or of the earlier one with this specification.
///
/// # Errors
/// As [`check`], and if the sweep has no run of a number.
pub fn check_only(
    path: &Path,
    sets: &[String],
    kinds: impl Into<Kinds>,
    numbers: &[usize],
    workers: usize,
    spec: Option<Spec>,
) -> Result<Vec<Run>, Faults> {
    let (base, spec) = Base::swept(path, sets, kinds, spec)?;
    let rows = rows(&spec, base.plan.seed);
    let row = |number: &usize| {
        let fault = || Fault::new(format!("{} has no run {number}", path.display()));
        let help = || format!("its sweep has the runs 0 to {}; --dry-run lists them", rows.len() - 1);
        rows.get(*number).cloned().ok_or_else(|| Faults(vec![fault().help(help())]))
    };
    let rows = numbers.iter().map(row).collect::<Result<Vec<_>, _>>()?;
    base.checked(rows, workers, &mut Stamps::default())
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
    let (graph, row, variants) = (folder.graph()?, folder.read(run)?.sets, folder.spec()?.variants());
    // The frozen graph states the defaults of its kinds, which go with them.
    let of_row = variants.iter().filter(|variant| row.contains(&variant.setting()));
    let keys = of_row.flat_map(Variant::keys).map(|key| format!("{key}="));
    let all: Vec<String> = row.iter().chain(sets).cloned().chain(keys).collect();
    let graph = without_old_defaults(&graph, &folder.written()?, &all).unwrap_or(graph);
    Ok(check::check_frozen(graph, path, &row, &variants, sets, kinds))
}

/// Hash of the sweep, the graph of each run with the contents of its input files, and the program.
pub(super) fn hash(spec: &Spec, runs: &[&Run], hashes: &mut dyn FnMut(&Path) -> Vec<Json>) -> Digest {
    let mut key = Key::of("sweep").json("spec", &json!(spec));
    if let Some(program) = program::digest() {
        key = key.digest("program", program);
    }
    // The same files at another path give the same sweep.
    let mut names = Vec::new();
    for (index, file) in input_files(runs).iter().enumerate() {
        names.push((Json::from(file.to_string_lossy()).to_string(), format!("\"file {index}\"")));
        for entry in hashes(file) {
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
