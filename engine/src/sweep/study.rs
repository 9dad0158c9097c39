//! A sweep whose rows are asked for one by one, such as by an optimiser, instead of listed in `[sweep]`.
//!
//! It has the folder of a sweep. What `[sweep]` draws for each repeat, and the columns and points that it takes, hold for a study too;
//! its factors are the keys that are asked for. What was asked for before is answered from the folder.

use super::{
    Done, Factor, Folder, FolderError, Level, Run, Spec, StudyRow, Sweep, SweepOptions, SweepRow, Watcher,
    check::{self, Base},
    folder::{ASKED, difference},
    share::Shared,
    twice,
};
use crate::{check as graph_check, fault::Faults, graph, hash::files::hashes, plugin::Kinds, watch::Stamps};
use serde_json::{Value as Json, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

/// Memory for nodes that a later row may share: the clouds and targets of some dozen procedures.
const MAX_SHARED_BYTES: u64 = 1 << 30;

/// Settings that are asked for, and the number of the repeat.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ask {
    /// The settings, in the form of `--set`.
    pub settings: Vec<String>,
    /// The repeat: its seed is that of the graph and this number.
    pub repeat: usize,
}

/// A sweep whose rows are asked for one by one.
pub struct Study {
    base: Base,
    spec: Spec,
    folder: Folder,
    options: SweepOptions,
    shared: Shared,
    /// Number of the stored row of each ask, whose settings are sorted.
    known: BTreeMap<Ask, usize>,
    /// The graph's own files, and input files.
    texts: Stamps,
    files: Stamps,
    hashes: BTreeMap<PathBuf, Vec<Json>>,
}

/// Why no rows are given.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The settings cannot be asked for.
    #[error("{0}")]
    Ask(String),
    /// The folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The user stopped it.
    #[error("the study was interrupted")]
    Interrupted,
}

impl Study {
    /// Begins a study of the graph file at `path` in an empty folder, or goes on with the one there if `resumes`.
    ///
    /// # Errors
    /// Faults of the graph; inner: the folder cannot be written, or is of another study.
    pub fn open(
        path: &Path,
        sets: &[String],
        kinds: impl Into<Kinds>,
        dir: &Path,
        resumes: bool,
        options: SweepOptions,
    ) -> Result<Result<Self, FolderError>, Faults> {
        let kinds = kinds.into();
        // Plugins are held as they were at the start.
        let texts = Stamps::of(graph_check::files(path, sets, kinds.registry()));
        let (base, spec) = Base::check(path, sets, kinds)?;
        Ok(Self::begin(base, spec, dir, resumes, options, texts))
    }

    fn begin(
        base: Base,
        spec: Option<Spec>,
        dir: &Path,
        resumes: bool,
        options: SweepOptions,
        texts: Stamps,
    ) -> Result<Self, FolderError> {
        let spec = spec.map_or_else(Spec::default, Spec::without_factors);
        let mut hashed = BTreeMap::new();
        let run = base.run();
        let hash = check::hash(&spec, &[&run], &mut |file| hashes_once(&mut hashed, file));
        let sweep = Sweep { hash, ..base.sweep(spec.clone(), vec![run], Stamps::default()) };
        let mut about = sweep.about(None, &options.run.command);
        (about["n_runs"], about["origin"]) = (0.into(), ASKED.into());
        let folder = match resumes {
            true => {
                let folder = Folder::open(dir)?;
                let path = dir.display().to_string();
                if !folder.is_study() {
                    let what = "its runs are those of a table [sweep], with which `osteoflow sweep` goes on".into();
                    return Err(FolderError::Other { path, what });
                }
                // What was asked for so far is no part of the study.
                let mut begun = folder.clone();
                begun.about["sweep"] = json!(folder.spec()?.without_factors());
                if let Some(what) = difference(&about, &base.plan.resolved, &begun)? {
                    return Err(FolderError::Other { path, what });
                }
                folder
            }
            false => Folder::begin(dir, &base.plan.resolved, about)?,
        };
        let shared = if options.share { Shared::kept(MAX_SHARED_BYTES) } else { Shared::default() };
        let (known, files, hashes) = (BTreeMap::new(), Stamps::default(), hashed);
        let mut study = Self { base, spec, folder, options, shared, known, texts, files, hashes };
        for done in study.folder.done()? {
            let done = done?;
            let repeat = done.value(&study.spec.repeat_name).and_then(Json::as_u64).unwrap_or_default() as usize;
            if let Some(asked) = done.asked {
                study.known.insert(Ask { settings: asked.settings, repeat }.sorted(), done.run);
            }
        }
        Ok(study)
    }

    /// The folder of the study.
    pub fn folder(&self) -> &Folder {
        &self.folder
    }

    /// What is drawn for each repeat, and taken out of each run.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// The rows of these asks. Those that the folder lacks are run on the workers; a row that cannot be run is one with its reason.
    ///
    /// # Errors
    /// [`StudyError`]: a key that no row may set; the graph, an input or the folder has changed; the user stopped it.
    pub fn run(
        &mut self,
        asks: &[Ask],
        options: &SweepOptions,
        watcher: &dyn Watcher,
    ) -> Result<Vec<Done>, StudyError> {
        self.options = options.clone();
        let (mut numbers, mut rows) = (Vec::with_capacity(asks.len()), Vec::new());
        let mut asked_now: BTreeMap<Ask, usize> = BTreeMap::new();
        let taken: BTreeSet<usize> = self.known.values().copied().collect();
        let mut free = (0..).filter(|number| !taken.contains(number));
        for ask in asks {
            let key = ask.clone().sorted();
            let number = match (asked_now.get(&key), self.known.get(&key)) {
                (Some(number), _) => *number,
                (None, known) => {
                    let number = known.copied().or_else(|| free.next()).unwrap_or_default();
                    rows.push(self.row(number, &key)?);
                    asked_now.insert(key, number);
                    number
                }
            };
            numbers.push(number);
        }
        if let Some(path) = self.texts.changed() {
            return Err(FolderError::Changed { path: path.display().to_string() }.into());
        }
        let asked: BTreeMap<usize, Vec<String>> =
            asked_now.iter().map(|(ask, number)| (*number, ask.settings.clone())).collect();
        let ran = self.run_rows(rows, &asked, watcher);
        // What has ended is stored, and is answered from the folder.
        let stored = self.folder.runs()?;
        let ended = asked_now.into_iter().filter(|(_, number)| stored.binary_search(number).is_ok());
        self.known.extend(ended);
        ran?;
        Ok(numbers.into_iter().map(|number| self.folder.read(number)).collect::<Result<_, _>>()?)
    }

    fn run_rows(
        &mut self,
        rows: Vec<SweepRow>,
        asked: &BTreeMap<usize, Vec<String>>,
        watcher: &dyn Watcher,
    ) -> Result<(), StudyError> {
        let mut runs: Vec<Run> = Vec::new();
        let stored: BTreeSet<usize> = self.known.values().copied().collect();
        let of = |number: usize, hash| StudyRow { settings: asked[&number].clone(), hash };
        for checked in self.base.rows(rows, self.options.workers, false, &mut self.files) {
            let (row, hash) = match &checked {
                Ok(run) => {
                    let hash = check::hash(&self.spec, &[run], &mut |file| hashes_once(&mut self.hashes, file));
                    (&run.row, Some(hash.to_string()))
                }
                Err((row, _)) => (row, None),
            };
            let number = row.run;
            if stored.contains(&number) {
                let done = self.folder.read(number)?;
                if !(self.options.retry_failed && done.is_failed()) {
                    let before = done.asked.and_then(|asked| asked.hash);
                    if before != hash {
                        let what = format!("an input file or a plugin of run {number} is another than when it was run");
                        return Err(FolderError::Other { path: self.folder.dir().display().to_string(), what }.into());
                    }
                    continue;
                }
            }
            match checked {
                Ok(run) => runs.push(Run { asked: Some(of(number, hash)), ..run }),
                Err((row, faults)) => {
                    let reason = faults.0.iter().map(|fault| fault.render(false)).collect::<Vec<_>>().join("; ");
                    let mut done = Done::of(&row, Done::FAILED, Some(reason), Vec::new(), Json::Null);
                    done.asked = Some(of(number, None));
                    self.folder.keep(&done, None)?;
                    watcher.ended(&done);
                }
            }
        }
        if self.options.share {
            self.shared.expect(runs.iter().map(|run| &run.keys[..]));
        }
        let sweep = self.base.sweep(self.spec.clone(), runs, self.files.clone());
        let every = twice::every(self.spec.twice);
        let is_twice = |number: usize| every.is_some_and(|every| number.is_multiple_of(every));
        let order = sweep.order(None);
        let swept = sweep.run_in_order(order, &mut self.shared, &is_twice, &self.folder, &self.options, watcher);
        self.shared.expect_none();
        self.folder = Folder::open(self.folder.dir())?;
        if swept?.n_missing > 0 { Err(StudyError::Interrupted) } else { Ok(()) }
    }

    /// The row of an ask, whose settings are sorted, so that their order changes nothing.
    fn row(&self, number: usize, ask: &Ask) -> Result<SweepRow, StudyError> {
        let draws: Vec<_> = self
            .spec
            .draws
            .iter()
            .flat_map(|draw| draw.keys_set().into_iter().map(move |key| (&draw.name, key)))
            .collect();
        for (key, _) in graph::keys_set(&ask.settings) {
            let parts: Vec<_> = key.parts().iter().map(String::as_str).collect();
            let why = match parts[..] {
                ["sweep", ..] => "set what a run has: parameters of nodes, results".into(),
                ["graph", "seed"] if !self.spec.same_seed => "each repeat has its own; ask for another repeat".into(),
                _ => match draws.iter().find(|(_, drawn)| key.overrides(drawn) || drawn.overrides(&key)) {
                    Some((name, _)) => {
                        format!("the draw {name} of the sweep sets it; remove the draw, or ask for a repeat")
                    }
                    None => continue,
                },
            };
            return Err(StudyError::Ask(format!("{key} cannot be asked for: {why}")));
        }
        let mut row =
            SweepRow { run: number, values: Vec::new(), seed: self.base.plan.seed, sets: ask.settings.clone() };
        for setting in &ask.settings {
            let (key, value) = split(setting)?;
            if row.values.iter().any(|(known, _)| *known == key) {
                return Err(StudyError::Ask(format!("{key} is asked for twice; keep one of them")));
            }
            row.values.push((key, value));
        }
        row.repeat(&self.spec, ask.repeat);
        Ok(row)
    }

    /// Writes into the folder which keys were asked for with which values, as the factors of its tables.
    ///
    /// # Errors
    /// The folder cannot be read or written.
    pub fn close(&mut self) -> Result<(), FolderError> {
        let mut factors: Vec<Factor> = Vec::new();
        let mut n_repeats = 1;
        let done = self.folder.done()?.collect::<Result<Vec<_>, _>>()?;
        for run in &done {
            let repeat = run.value(&self.spec.repeat_name).and_then(Json::as_u64).unwrap_or_default() as usize;
            n_repeats = n_repeats.max(repeat + 1);
            for setting in run.asked.iter().flat_map(|asked| &asked.settings) {
                let Some((name, label)) = split(setting).ok() else { continue };
                let level = Level { label, sets: vec![setting.clone()], variant: None };
                match factors.iter_mut().find(|factor| factor.name == name) {
                    None => factors.push(Factor { name, levels: vec![level] }),
                    Some(factor) if factor.levels.iter().all(|known| known.label != level.label) => {
                        factor.levels.push(level);
                    }
                    Some(_) => {}
                }
            }
        }
        let mut about = self.folder.about.clone();
        let spec = Spec { factors, repeat: n_repeats, ..self.spec.clone() };
        (about["n_runs"], about["sweep"]) = (done.len().into(), json!(spec));
        self.folder.describe(about)
    }
}

impl Ask {
    /// In one order of the settings.
    fn sorted(mut self) -> Self {
        self.settings.sort();
        self
    }
}

/// The key and the value of a setting.
fn split(setting: &str) -> Result<(String, Json), StudyError> {
    let (key, value) = setting
        .split_once('=')
        .ok_or_else(|| StudyError::Ask(format!("\"{setting}\" is no setting; ask for KEY = VALUE")))?;
    Ok((key.trim().into(), graph::setting_value(value.trim())))
}

/// Size and SHA-256 of an input file, or of the files of a folder, which are read once.
fn hashes_once(known: &mut BTreeMap<PathBuf, Vec<Json>>, file: &Path) -> Vec<Json> {
    known.entry(file.into()).or_insert_with(|| hashes(&[file.into()])).clone()
}
