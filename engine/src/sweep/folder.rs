//! The folder of a sweep: its specification, and one file for each run that ended.
//!
//! A run's file is written under another name, synced and renamed, so that it is complete or absent whenever the program
//! or the machine is stopped. The folder may come from elsewhere: its files are written inside it only, through no link.

use super::{
    Unsteady,
    design::SweepRow,
    table::{write_points, write_runs, write_times},
    times::{OF_TIMES, RunTimes},
};
use crate::{
    check::sweep::{Factor, Level, Spec},
    durable,
    graph::difference,
    plan::PlanPlugin,
    recording::provenance::Provenance,
    regular,
    replay::exchange::without_old_defaults,
    run::{Answer, Verdict},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::{Map, Value as Json, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
};

/// The frozen graph, without the settings of a run.
pub const GRAPH: &str = "sweep.toml";
/// Specification, hash and versions.
pub const DESIGN: &str = "sweep.json";
/// Folder of the runs.
pub const RUNS_DIR: &str = "runs";
/// Folder of the runs under their new numbers, while the sweep gets more repeats.
const GROWN_DIR: &str = "runs.grown";
/// Folder of the runs under their old numbers, until it is removed.
const BEFORE_DIR: &str = "runs.before";
/// One row for each run.
pub const RUNS: &str = "runs.csv";
/// One row for each run, point and axis.
pub const POINTS: &str = "points.csv";
/// One row for each run and node.
pub const TIMES: &str = "times.csv";

/// Origin of runs that are asked for one by one.
pub(super) const ASKED: &str = "asked";

/// Folder of their times, inside that of the runs.
const TIMES_DIR: &str = "times";

/// Increase when the layout of the files changes.
const FORMAT: u64 = 2;

/// Why a sweep's folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder is not that of a sweep.
    #[error("{path} holds no sweep ({DESIGN} is missing); name the folder that `osteoflow sweep` has left")]
    NoSweep {
        /// The folder.
        path: String,
    },
    /// It holds another sweep.
    #[error(
        "{path} holds another sweep: {what}; restore what has changed (the graph as it was is {path}/{GRAPH}), or begin \
         anew in another folder"
    )]
    Other {
        /// The folder.
        path: String,
        /// What differs.
        what: String,
    },
    /// An input file changed while the sweep ran.
    #[error(
        "{path} has changed while the sweep ran, which was stopped; the runs that are there are of the file as it was: \
         restore it and go on with --resume, or begin anew in another folder"
    )]
    Changed {
        /// The file.
        path: String,
    },
    /// A file does not have the expected format.
    #[error("{path} is not what a sweep writes: {what}")]
    Form {
        /// The file.
        path: String,
        /// What is wrong.
        what: String,
    },
    /// Runs are missing.
    #[error("{n} of {all} runs are in none of the folders, the first is run {first}; run the missing shards too")]
    Missing {
        /// Number of missing runs.
        n: usize,
        /// Number of runs.
        all: usize,
        /// The first of them.
        first: usize,
    },
    /// A file could not be read.
    #[error("{path} cannot be read: {source}")]
    Read {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
    /// A file could not be written.
    #[error("{path} cannot be written: {source}")]
    Write {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
}

impl FolderError {
    fn read(path: &Path, source: io::Error) -> Self {
        Self::Read { path: path.display().to_string(), source }
    }

    fn form(path: &Path, what: impl ToString) -> Self {
        Self::Form { path: path.display().to_string(), what: what.to_string() }
    }

    /// Whether the file is not there.
    fn is_missing(&self) -> bool {
        matches!(self, Self::Read { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, FolderError> {
    let text = regular(path).and_then(fs::read_to_string).map_err(|source| FolderError::read(path, source))?;
    serde_json::from_str(&text).map_err(|error| FolderError::form(path, error))
}

/// What was asked for by settings, instead of by `[sweep]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StudyRow {
    /// The settings, in the form of `--set`.
    pub settings: Vec<String>,
    /// Hash of the run's graph, its input files and plugins; `None` if its settings have a fault.
    pub hash: Option<String>,
}

/// A run that ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// Number of the run.
    pub run: usize,
    /// Seed of the run.
    pub seed: u64,
    /// The values of factors, draws and repeat.
    pub values: Map<String, Json>,
    /// Its settings, in the form of `--set`.
    #[serde(rename = "set")]
    pub sets: Vec<String>,
    /// `complete`, `refused` or `failed`.
    pub status: String,
    /// Why there are no results.
    pub reason: Option<String>,
    /// Warnings of nodes.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// Values of the graph's `[results]`, as in `results.json`.
    #[serde(default)]
    pub results: Json,
    /// If it was computed twice: the nodes that answered otherwise the second time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twice: Option<Vec<Unsteady>>,
    /// What was asked for, in a study.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub asked: Option<StudyRow>,
}

impl Done {
    /// Value of a factor, a draw or the repeat, by name.
    pub fn value(&self, name: &str) -> Option<&Json> {
        self.values.get(name)
    }

    pub(super) const FAILED: &'static str = "failed";

    /// Whether it could not be run, so that it says nothing about its settings.
    pub fn is_failed(&self) -> bool {
        self.status == Self::FAILED
    }

    /// Whether all results are available.
    pub fn is_complete(&self) -> bool {
        self.status == "complete"
    }

    /// Whether these results of a repeated run are the stored ones, but for times that columns asked for.
    pub fn gave(&self, results: &Json) -> bool {
        let mut stored = self.results.clone();
        if let Some(stored) = stored.as_object_mut() {
            stored.retain(|key, _| !OF_TIMES.contains(&key.as_str()) || results.get(key).is_some());
        }
        stored == *results
    }

    /// Answer of the verdict on the results; `None` if nothing judged them.
    pub fn verdict(&self) -> Option<Answer> {
        Verdict::of(&self.results).map(|verdict| verdict.answer())
    }

    pub(super) fn of(
        row: &SweepRow,
        status: &str,
        reason: Option<String>,
        warnings: Vec<String>,
        results: Json,
    ) -> Self {
        let (values, sets) = (row.values.iter().cloned().collect(), row.sets.clone());
        let (run, seed, status, twice, asked) = (row.run, row.seed, status.to_owned(), None, None);
        Self { run, seed, values, sets, status, reason, warnings, results, twice, asked }
    }
}

/// The folder of a sweep.
#[derive(Debug, Clone)]
pub struct Folder {
    dir: PathBuf,
    /// Content of `sweep.json`.
    pub about: Json,
}

impl Folder {
    /// Starts a sweep in an empty folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn begin(dir: &Path, graph: &str, about: Json) -> Result<Self, FolderError> {
        let mut about = about;
        about["format"] = FORMAT.into();
        let folder = Self { dir: dir.into(), about };
        fs::create_dir_all(dir.join(RUNS_DIR)).map_err(|source| folder.cannot_write(RUNS_DIR, source))?;
        folder.write(GRAPH, graph.as_bytes())?;
        // Written last: a folder that has this file is complete.
        folder.write(DESIGN, format!("{:#}\n", folder.about).as_bytes())?;
        Ok(folder)
    }

    /// Opens the folder of a sweep.
    ///
    /// # Errors
    /// If it is not the folder of a sweep, or this program cannot read it.
    pub fn open(dir: &Path) -> Result<Self, FolderError> {
        let path = dir.join(DESIGN);
        let about: Json = match read_json(&path) {
            Err(error) if error.is_missing() => return Err(FolderError::NoSweep { path: dir.display().to_string() }),
            about => about?,
        };
        match about["format"].as_u64() {
            Some(FORMAT) => {
                let folder = Self { dir: dir.into(), about };
                folder.check_runs_folder()?;
                Ok(folder)
            }
            Some(other) => Err(FolderError::form(&path, format!("format {other}, this program reads {FORMAT}"))),
            None => Err(FolderError::form(&path, "it does not say its format")),
        }
    }

    /// Refuses a link: runs would be written outside of the folder.
    fn check_runs_folder(&self) -> Result<(), FolderError> {
        let path = self.runs_path();
        match fs::symlink_metadata(&path) {
            Ok(found) if found.is_dir() => Ok(()),
            Ok(_) => Err(FolderError::form(&path, "it is a link or a file, not a folder")),
            Err(error) => Err(FolderError::form(&path, error)),
        }
    }

    /// The folder of the runs: under their new numbers if more repeats were asked for, and the folder was not renamed yet.
    fn runs_path(&self) -> PathBuf {
        let grown = self.dir.join(GROWN_DIR);
        if self.about["runs_in"] == GROWN_DIR && grown.is_dir() { grown } else { self.dir.join(RUNS_DIR) }
    }

    /// Whether its runs were asked for one by one.
    pub fn is_study(&self) -> bool {
        self.about["origin"] == ASKED
    }

    /// Path of the folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Hash of everything that determines the runs.
    pub fn hash(&self) -> &str {
        self.about["hash"].as_str().unwrap_or_default()
    }

    /// Number of runs of the whole sweep.
    pub fn n_runs(&self) -> usize {
        self.about["n_runs"].as_u64().unwrap_or_default() as usize
    }

    /// The specification, as stored in the folder.
    ///
    /// # Errors
    /// If this program cannot read the specification.
    pub fn spec(&self) -> Result<Spec, FolderError> {
        let path = self.dir.join(DESIGN);
        serde_json::from_value(self.about["sweep"].clone()).map_err(|error| FolderError::form(&path, error))
    }

    /// Numbers of the stored runs, ascending. An empty file is what a full disk or a power cut may leave of a run that
    /// did not end, which then counts as missing.
    ///
    /// # Errors
    /// If the folder cannot be read, or a file is named as another one would be of the same run.
    pub fn runs(&self) -> Result<Vec<usize>, FolderError> {
        let dir = self.runs_path();
        let cannot = |source| FolderError::read(&dir, source);
        let mut runs = Vec::new();
        for entry in fs::read_dir(&dir).map_err(cannot)? {
            let entry = entry.map_err(cannot)?;
            let name = entry.file_name();
            let number = name.to_str().and_then(|name| name.strip_suffix(".json")?.parse::<usize>().ok());
            let Some(run) = number else { continue };
            if *name != *file_name(run) {
                let what = format!("run {run} is read from {} only; remove one of the two", file_name(run));
                return Err(FolderError::form(&entry.path(), what));
            }
            if entry.metadata().map_err(cannot)?.len() > 0 {
                runs.push(run);
            }
        }
        runs.sort_unstable();
        Ok(runs)
    }

    /// The stored runs, without those that failed if these are to be run again.
    ///
    /// # Errors
    /// As [`Self::runs`], and if a run cannot be read.
    pub fn runs_kept(&self, retry_failed: bool) -> Result<Vec<usize>, FolderError> {
        if !retry_failed {
            return self.runs();
        }
        let kept = self.done()?.filter(|done| !done.as_ref().is_ok_and(Done::is_failed));
        kept.map(|done| Ok(done?.run)).collect()
    }

    /// Every stored run, by number.
    ///
    /// # Errors
    /// If the folder cannot be read; a run that cannot be read is an error item of the iterator.
    pub fn done(&self) -> Result<impl Iterator<Item = Result<Done, FolderError>>, FolderError> {
        Ok(self.runs()?.into_iter().map(|run| self.read(run)))
    }

    /// Reads one run.
    ///
    /// # Errors
    /// If it is missing or cannot be parsed.
    pub fn read(&self, run: usize) -> Result<Done, FolderError> {
        let path = self.runs_path().join(file_name(run));
        let done: Done = read_json(&path)?;
        match done.run == run {
            true => Ok(done),
            false => Err(FolderError::form(&path, format!("it holds run {}", done.run))),
        }
    }

    /// How long a run took; `None` if it was run by a version that did not measure it.
    ///
    /// # Errors
    /// If the times cannot be read.
    pub fn times(&self, run: usize) -> Result<Option<RunTimes>, FolderError> {
        match read_json(&self.runs_path().join(times_name(run))) {
            Err(error) if error.is_missing() => Ok(None),
            times => times.map(Some),
        }
    }

    /// The frozen graph.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn graph(&self) -> Result<String, FolderError> {
        let path = self.dir.join(GRAPH);
        regular(&path).and_then(fs::read_to_string).map_err(|source| FolderError::read(&path, source))
    }

    /// The frozen graph to run again with the settings of the rows: nodes that rows give another kind state what the user wrote
    /// only, since the defaults of the kind that they have in the graph itself are not those of another.
    ///
    /// # Errors
    /// If a file of the folder cannot be read.
    pub fn graph_of_rows(&self) -> Result<String, FolderError> {
        let (spec, graph) = (self.spec()?, self.graph()?);
        let of_levels = spec.factors.iter().flat_map(|factor| &factor.levels).flat_map(|level| &level.sets).cloned();
        let of_draws = spec.draws.iter().flat_map(|draw| &draw.keys).map(|key| format!("{key}="));
        let of_variants = spec.variants().into_iter().flat_map(|variant| variant.keys());
        let sets: Vec<_> = of_levels.chain(of_draws).chain(of_variants.map(|key| format!("{key}="))).collect();
        Ok(without_old_defaults(&graph, &self.written()?, &sets).unwrap_or(graph))
    }

    /// The parameters of each node that the user wrote.
    pub(super) fn written(&self) -> Result<BTreeMap<String, BTreeSet<String>>, FolderError> {
        let unread = |error| {
            let what =
                format!("it does not say which parameters were written (`written`): {error}; sweep the graph again");
            FolderError::form(&self.dir.join(DESIGN), what)
        };
        serde_json::from_value(self.about["written"].clone()).map_err(unread)
    }

    /// What makes `other` another sweep than this one; `None` if it is the same.
    ///
    /// # Errors
    /// If a graph cannot be read.
    pub fn difference(&self, other: &Self) -> Result<Option<String>, FolderError> {
        difference(&self.about, &self.graph()?, other)
    }

    /// Stores a run that ended, with its settings and times.
    ///
    /// # Errors
    /// If it cannot be written, or its number is now that of another run.
    pub(super) fn keep(&self, done: &Done, times: Option<&RunTimes>) -> Result<(), FolderError> {
        let now: Json = read_json(&self.dir.join(DESIGN))?;
        if now["hash"] != self.about["hash"] {
            let what = "another process has given it more repeats".into();
            return Err(FolderError::Other { path: self.dir.display().to_string(), what });
        }
        self.keep_in(RUNS_DIR, done, times)
    }

    fn keep_in(&self, folder: &str, done: &Done, times: Option<&RunTimes>) -> Result<(), FolderError> {
        if let Some(times) = times {
            let dir = self.dir.join(folder).join(TIMES_DIR);
            let is_there = || fs::symlink_metadata(&dir).is_ok_and(|found| found.is_dir());
            if let (false, Err(source)) = (is_there(), fs::create_dir(&dir))
                && !is_there()
            {
                return Err(self.cannot_write(&format!("{folder}/{TIMES_DIR}"), source));
            }
            self.write(&format!("{folder}/{}", times_name(done.run)), format!("{}\n", json!(times)).as_bytes())?;
        }
        self.write(&format!("{folder}/{}", file_name(done.run)), format!("{}\n", json!(done)).as_bytes())
    }

    /// Describes the folder anew, with the plugins that are noted in it.
    pub(super) fn describe(&mut self, mut about: Json) -> Result<(), FolderError> {
        about["format"] = FORMAT.into();
        self.about = about;
        self.write(DESIGN, format!("{:#}\n", self.about).as_bytes())
    }

    /// Gives the runs the numbers `number` of a sweep with more repeats, which `about` describes. The new description decides at once
    /// for all runs under which numbers they are read; until then the old files are as they were.
    pub(super) fn grow(&mut self, mut about: Json, number: impl Fn(usize) -> usize) -> Result<(), FolderError> {
        let grown = self.dir.join(GROWN_DIR);
        let cannot = |source| FolderError::Write { path: grown.display().to_string(), source };
        if grown.exists() {
            fs::remove_dir_all(&grown).map_err(cannot)?;
        }
        fs::create_dir(&grown).map_err(cannot)?;
        for run in self.runs()? {
            let (done, times, run) = (self.read(run)?, self.times(run)?, number(run));
            let times = times.map(|times| RunTimes { run, ..times });
            self.keep_in(GROWN_DIR, &Done { run, ..done }, times.as_ref())?;
        }
        about["runs_in"] = GROWN_DIR.into();
        self.describe(about)
    }

    /// Ends what [`Self::grow`] began: the renumbered runs get the folder's usual name.
    pub(super) fn finish_growth(&mut self) -> Result<(), FolderError> {
        if self.about["runs_in"].is_null() {
            return Ok(());
        }
        let [grown, runs, before] = [GROWN_DIR, RUNS_DIR, BEFORE_DIR].map(|name| self.dir.join(name));
        let cannot = |source| FolderError::Write { path: runs.display().to_string(), source };
        if grown.is_dir() {
            if runs.exists() {
                fs::rename(&runs, &before).map_err(cannot)?;
            }
            fs::rename(&grown, &runs).map_err(cannot)?;
            durable::sync_folder_of(&runs).map_err(cannot)?;
        }
        let mut about = self.about.clone();
        about.as_object_mut().map(|about| about.shift_remove("runs_in"));
        self.describe(about)?;
        if before.is_dir() {
            fs::remove_dir_all(&before).map_err(cannot)?;
        }
        Ok(())
    }

    /// Writes `runs.csv`, `points.csv` and `times.csv` from the stored runs.
    ///
    /// # Errors
    /// If a run cannot be read or a table cannot be written.
    pub fn write_tables(&self) -> Result<(), FolderError> {
        let spec = self.spec()?;
        let mut text = Vec::new();
        write_runs(self, &spec, &mut text)?;
        self.write(RUNS, &text)?;
        text.clear();
        write_points(self, &spec, &mut text)?;
        self.write(POINTS, &text)?;
        text.clear();
        write_times(self, &spec, &mut text)?;
        self.write(TIMES, &text)
    }

    /// The plugins, with what they had loaded when the last run ended.
    pub(super) fn plugins(&self) -> Vec<PlanPlugin> {
        serde_json::from_value(self.about["plugins"].clone()).unwrap_or_default()
    }

    /// Writes what plugins have loaded meanwhile.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn note_plugins(&self, plugins: &[PlanPlugin]) -> Result<(), FolderError> {
        let mut about = self.about.clone();
        about["plugins"] = json!(plugins);
        self.write(DESIGN, format!("{about:#}\n").as_bytes())
    }

    /// Writes a file of the folder atomically.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), FolderError> {
        // Two processes may resume the same sweep: each has a side file of its own.
        durable::write(self.dir.join(name), bytes).map_err(|source| self.cannot_write(name, source))
    }

    pub(super) fn cannot_write(&self, name: &str, source: impl Into<io::Error>) -> FolderError {
        FolderError::Write { path: self.dir.join(name).display().to_string(), source: source.into() }
    }
}

/// Merges the runs of shards into a new folder and writes the tables of the whole sweep.
///
/// # Errors
/// If the folders are of different sweeps, or a run is missing from all of them.
pub fn merge(shards: &[Folder], dir: &Path) -> Result<Folder, FolderError> {
    let first = &shards[0];
    if let Some(study) = shards.iter().find(|folder| folder.is_study()) {
        let what = "its runs were asked for one by one, so that numbers of two studies are of different runs".into();
        return Err(FolderError::Other { path: study.dir.display().to_string(), what });
    }
    for other in &shards[1..] {
        if let Some(what) = first.difference(other)? {
            return Err(FolderError::Other { path: other.dir.display().to_string(), what });
        }
    }
    let mut about = first.about.clone();
    let of_shard = |shard: &Folder| {
        let (dir, otherwise) = (shard.dir.display().to_string(), made_otherwise(&first.about, shard));
        json!({ "dir": dir, "shard": shard.about["shard"], "command": shard.about["command"], "otherwise": otherwise })
    };
    about["merged"] = shards.iter().map(of_shard).collect();
    about["shard"] = Json::Null;
    let mut from = BTreeMap::new();
    for shard in shards {
        for run in shard.runs()? {
            from.entry(run).or_insert(shard);
        }
    }
    let all = first.n_runs();
    let mut missing = (0..all).filter(|run| !from.contains_key(run));
    if let Some(run) = missing.next() {
        return Err(FolderError::Missing { n: 1 + missing.count(), all, first: run });
    }
    let folder = Folder::begin(dir, &first.graph()?, about)?;
    for (run, shard) in from {
        folder.keep_in(RUNS_DIR, &shard.read(run)?, shard.times(run)?.as_ref())?;
    }
    folder.write_tables()?;
    Ok(folder)
}

/// Names of the sweep in a folder and of the one that it is compared with.
const NAMES: [&str; 2] = ["it", "the other"];

/// In what else the runs of `folder` may have been made otherwise than by this description: program, machine, and what firings loaded
/// and opened. The sweep is the same.
pub(super) fn made_otherwise(about: &Json, folder: &Folder) -> Vec<String> {
    let [ours, other] = [&folder.about, about].map(Provenance::of);
    [ours.program_differences(&other, NAMES), ours.late_differences(&other, NAMES)].concat()
}

/// What makes `folder` another sweep than the one of this description and frozen graph; `None` if it is the same.
///
/// # Errors
/// If the folder's graph cannot be read.
pub(super) fn difference(about: &Json, graph: &str, folder: &Folder) -> Result<Option<String>, FolderError> {
    let hash = |about: &Json| about["hash"].as_str().unwrap_or("unknown").to_owned();
    let (hash, other_hash) = (hash(about), hash(&folder.about));
    let [ours, other] = [&folder.about, about].map(|about| Provenance::of(about).without_seed());
    let mut differences = Vec::new();
    if hash != other_hash || hash == "unknown" {
        differences.extend(ours.program_differences(&other, NAMES));
        differences.extend(ours.input_differences(&other, NAMES));
        differences.extend(difference::in_words(&folder.graph()?, graph, NAMES).next());
        if about["sweep"] != folder.about["sweep"] {
            let of = |about: &Json| serde_json::from_value::<Spec>(about["sweep"].clone()).ok();
            let named = of(about).zip(of(&folder.about)).map(|(ours, other)| spec_differences(&ours, &other));
            let named = named.filter(|named| !named.is_empty()).map(|named| format!(": {}", named.join(", ")));
            differences.push(format!("its table [sweep] differs{}", named.unwrap_or_default()));
        }
    }
    differences.extend(ours.plugin_differences(&other, NAMES));
    if hash != other_hash || hash == "unknown" {
        if differences.is_empty() {
            differences.push("its settings differ".into());
        }
        differences.push(format!("its hash is {other_hash}, not {hash}"));
    }
    Ok((!differences.is_empty()).then(|| differences.join("; ")))
}

/// By what number of repeats and by which values of factors another table `[sweep]` differs.
fn spec_differences(ours: &Spec, other: &Spec) -> Vec<String> {
    let mut differences = Vec::new();
    if ours.repeat != other.repeat {
        differences.push(format!("its repeat is {}, not {}", other.repeat, ours.repeat));
    }
    for factor in &ours.factors {
        let Some(same) = other.factors.iter().find(|same| same.name == factor.name) else {
            differences.push(format!("it has no factor {}", factor.name));
            continue;
        };
        for level in &factor.levels {
            match same.levels.iter().find(|other| other.label == level.label) {
                None => differences.push(format!("its factor {} has no value {}", factor.name, level.label)),
                Some(other) if other != level => {
                    differences.push(format!("its factor {} has another value {}", factor.name, level.label));
                }
                Some(_) => {}
            }
        }
        let is_more = |level: &&Level| factor.levels.iter().all(|known| known.label != level.label);
        let more = same.levels.iter().filter(is_more);
        differences.extend(more.map(|level| format!("its factor {} has the value {}", factor.name, level.label)));
    }
    let is_more = |factor: &&Factor| ours.factors.iter().all(|known| known.name != factor.name);
    differences.extend(other.factors.iter().filter(is_more).map(|factor| format!("it has the factor {}", factor.name)));
    differences
}

/// Not in the file of the run, whose content is the same each time.
fn times_name(run: usize) -> String {
    format!("{TIMES_DIR}/{run:06}.json")
}

fn file_name(run: usize) -> String {
    format!("{run:06}.json")
}
