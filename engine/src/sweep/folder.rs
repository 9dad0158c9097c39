//! The folder of a sweep: its specification, and one file for each run that ended.
//!
//! A run's file is written under another name, synced and renamed, so that it is complete or absent whenever the program
//! or the machine is stopped. The folder may come from elsewhere: its files are written inside it only, through no link.

use super::{
    Unsteady,
    design::SweepRow,
    table::{write_points, write_runs},
    times::{RunTimes, write_times},
};
use crate::{
    check::sweep::Spec,
    durable,
    graph::difference::{self, EntryDifference},
    plan::PlanPlugin,
    run::{Answer, Verdict},
};
use serde_json::{Value as Json, json};
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// The frozen graph, without the settings of a run.
pub const GRAPH: &str = "sweep.toml";
/// Specification, hash and versions.
pub const DESIGN: &str = "sweep.json";
/// Folder of the runs.
pub const RUNS_DIR: &str = "runs";
/// One row for each run.
pub const RUNS: &str = "runs.csv";
/// One row for each run, point and axis.
pub const POINTS: &str = "points.csv";
/// One row for each run and node.
pub const TIMES: &str = "times.csv";
/// Folder of the times of the runs.
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
    /// It holds another part of the sweep.
    #[error(
        "{path} holds {}, not {}; go on with {}, or begin in another folder",
        part(.there), part(.asked), option(.there)
    )]
    Part {
        /// The folder.
        path: String,
        /// Its part; all if none is given.
        there: Option<String>,
        /// The requested part.
        asked: Option<String>,
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

fn part(shard: &Option<String>) -> String {
    shard.as_ref().map_or_else(|| "the whole sweep".into(), |shard| format!("part {shard} of the sweep"))
}

fn option(shard: &Option<String>) -> String {
    shard.as_ref().map_or_else(|| "--resume without --shard".into(), |shard| format!("--shard {shard} --resume"))
}

/// A run that ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Done {
    /// Number of the run.
    pub run: usize,
    /// Seed of the run.
    pub seed: u64,
    /// The values of factors, draws and repeat.
    pub values: Vec<(String, Json)>,
    /// `complete`, `refused` or `failed`.
    pub status: String,
    /// Why there are no results.
    pub reason: Option<String>,
    /// Warnings of nodes.
    pub warnings: Vec<String>,
    /// Values of the graph's `[results]`, as in `results.json`.
    pub results: Json,
    /// If it was computed twice: the nodes that answered otherwise the second time.
    pub twice: Option<Vec<Unsteady>>,
}

impl Done {
    /// Value of a factor, a draw or the repeat, by name.
    pub fn value(&self, name: &str) -> Option<&Json> {
        self.values.iter().find(|(known, _)| known == name).map(|(_, value)| value)
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
        let (values, status) = (row.values.clone(), status.to_owned());
        Self { run: row.run, seed: row.seed, values, status, reason, warnings, results, twice: None }
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
        for name in [RUNS_DIR, TIMES_DIR] {
            fs::create_dir_all(dir.join(name)).map_err(|source| folder.cannot_write(name, source))?;
        }
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
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(FolderError::NoSweep { path: dir.display().to_string() });
            }
            text => text.map_err(|source| FolderError::Read { path: path.display().to_string(), source })?,
        };
        let form = |what: String| FolderError::Form { path: path.display().to_string(), what };
        let about: Json = serde_json::from_str(&text).map_err(|error| form(error.to_string()))?;
        match about["format"].as_u64() {
            Some(FORMAT) => {
                let folder = Self { dir: dir.into(), about };
                folder.check_folders()?;
                Ok(folder)
            }
            Some(other) => Err(form(format!("format {other}, this program reads {FORMAT}"))),
            None => Err(form("it does not say its format".into())),
        }
    }

    /// Refuses a link: runs would be written outside of the folder.
    fn check_folders(&self) -> Result<(), FolderError> {
        for name in [RUNS_DIR, TIMES_DIR] {
            let path = self.dir.join(name);
            let form = |what: String| FolderError::Form { path: path.display().to_string(), what };
            match fs::symlink_metadata(&path) {
                Ok(found) if found.is_dir() => {}
                Ok(_) => return Err(form("it is a link or a file, not a folder".into())),
                // Sweeps of earlier versions have no times.
                Err(error) if name == TIMES_DIR && error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(form(error.to_string())),
            }
        }
        Ok(())
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
        let path = self.dir.join(DESIGN).display().to_string();
        serde_json::from_value(self.about["sweep"].clone()).map_err(|e| FolderError::Form { path, what: e.to_string() })
    }

    /// Numbers of the stored runs, ascending. An empty file is what a full disk or a power cut may leave of a run that
    /// did not end, which then counts as missing.
    ///
    /// # Errors
    /// If the folder cannot be read, or a file is named as another one would be of the same run.
    pub fn runs(&self) -> Result<Vec<usize>, FolderError> {
        let dir = self.dir.join(RUNS_DIR);
        let cannot = |source| FolderError::Read { path: dir.display().to_string(), source };
        let mut runs = Vec::new();
        for entry in fs::read_dir(&dir).map_err(cannot)? {
            let entry = entry.map_err(cannot)?;
            let name = entry.file_name();
            let number = name.to_str().and_then(|name| name.strip_suffix(".json")?.parse::<usize>().ok());
            let Some(run) = number else { continue };
            if *name != *file_name(run) {
                let path = entry.path().display().to_string();
                let what = format!("run {run} is read from {} only; remove one of the two", file_name(run));
                return Err(FolderError::Form { path, what });
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
        let path = self.dir.join(RUNS_DIR).join(file_name(run));
        let text = fs::read_to_string(&path);
        let text = text.map_err(|source| FolderError::Read { path: path.display().to_string(), source })?;
        let form = |what: String| FolderError::Form { path: path.display().to_string(), what };
        let json: Json = serde_json::from_str(&text).map_err(|error| form(error.to_string()))?;
        if json["run"].as_u64() != Some(run as u64) {
            return Err(form(format!("it holds run {}", json["run"])));
        }
        let values = json["values"].as_object().ok_or_else(|| form("no values".into()))?;
        let warnings = json["warnings"].as_array().into_iter().flatten();
        Ok(Done {
            run,
            seed: json["seed"].as_u64().ok_or_else(|| form("no seed".into()))?,
            values: values.iter().map(|(name, value)| (name.clone(), value.clone())).collect(),
            status: json["status"].as_str().ok_or_else(|| form("no status".into()))?.into(),
            reason: json["reason"].as_str().map(str::to_owned),
            warnings: warnings.filter_map(Json::as_str).map(str::to_owned).collect(),
            results: json["results"].clone(),
            twice: serde_json::from_value(json["twice"].clone()).map_err(|error| form(error.to_string()))?,
        })
    }

    /// How long a run took; `None` if it was run by a version that did not measure it.
    ///
    /// # Errors
    /// If the times cannot be read.
    pub fn times(&self, run: usize) -> Result<Option<RunTimes>, FolderError> {
        let path = self.dir.join(TIMES_DIR).join(file_name(run));
        let shown = || path.display().to_string();
        match fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text)
                .map(Some)
                .map_err(|error| FolderError::Form { path: shown(), what: error.to_string() }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(FolderError::Read { path: shown(), source }),
        }
    }

    /// The frozen graph.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn graph(&self) -> Result<String, FolderError> {
        let path = self.dir.join(GRAPH);
        fs::read_to_string(&path).map_err(|source| FolderError::Read { path: path.display().to_string(), source })
    }

    /// What makes `other` another sweep than this one; `None` if it is the same.
    ///
    /// # Errors
    /// If a graph cannot be read.
    pub fn difference(&self, other: &Self) -> Result<Option<String>, FolderError> {
        difference(&self.about, &self.graph()?, other)
    }

    /// Settings of a run, in the form of `--set`.
    pub(super) fn sets(&self, run: usize) -> Result<Vec<String>, FolderError> {
        let path = self.dir.join(RUNS_DIR).join(file_name(run)).display().to_string();
        let text = fs::read_to_string(&path).map_err(|source| FolderError::Read { path: path.clone(), source })?;
        let json: Json = serde_json::from_str(&text)
            .map_err(|error| FolderError::Form { path: path.clone(), what: error.to_string() })?;
        let sets = json["set"].as_array().ok_or(FolderError::Form { path, what: "no settings".into() })?;
        Ok(sets.iter().filter_map(Json::as_str).map(str::to_owned).collect())
    }

    /// Stores a run that ended, with its settings and times.
    pub(super) fn keep(&self, done: &Done, sets: &[String], times: Option<&RunTimes>) -> Result<(), FolderError> {
        if let Some(times) = times {
            fs::create_dir_all(self.dir.join(TIMES_DIR)).map_err(|source| self.cannot_write(TIMES_DIR, source))?;
            let name = format!("{TIMES_DIR}/{}", file_name(done.run));
            self.write(&name, format!("{}\n", json!(times)).as_bytes())?;
        }
        let values: serde_json::Map<_, _> = done.values.iter().cloned().collect();
        let mut json = json!({
            "run": done.run, "seed": done.seed, "values": values, "set": sets, "status": done.status,
            "reason": done.reason, "warnings": done.warnings, "results": done.results,
        });
        if let Some(unsteady) = &done.twice {
            json["twice"] = json!(unsteady);
        }
        self.write(&format!("{RUNS_DIR}/{}", file_name(done.run)), format!("{json}\n").as_bytes())
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
        durable::write(&self.dir.join(name), bytes).map_err(|source| self.cannot_write(name, source))
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
    for other in &shards[1..] {
        if let Some(what) = first.difference(other)? {
            return Err(FolderError::Other { path: other.dir.display().to_string(), what });
        }
    }
    let mut about = first.about.clone();
    let of_shard = |shard: &Folder| json!({ "dir": shard.dir.display().to_string(), "shard": shard.about["shard"], "command": shard.about["command"] });
    about["merged"] = shards.iter().map(of_shard).collect();
    about["shard"] = Json::Null;
    let mut from = std::collections::BTreeMap::new();
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
        for inside in [TIMES_DIR, RUNS_DIR] {
            let name = format!("{inside}/{}", file_name(run));
            let path = shard.dir.join(&name);
            match fs::read(&path) {
                Ok(bytes) => folder.write(&name, &bytes)?,
                Err(error) if inside == TIMES_DIR && error.kind() == io::ErrorKind::NotFound => {}
                Err(source) => return Err(FolderError::Read { path: path.display().to_string(), source }),
            }
        }
    }
    folder.write_tables()?;
    Ok(folder)
}

/// What makes `folder` another sweep than the one of this description and frozen graph; `None` if it is the same.
///
/// # Errors
/// If the folder's graph cannot be read.
pub(super) fn difference(about: &Json, graph: &str, folder: &Folder) -> Result<Option<String>, FolderError> {
    let text = |about: &Json, key: &str| about[key].as_str().unwrap_or("unknown").to_owned();
    let both = |key: &str| (text(about, key), text(&folder.about, key));
    let mut differences = Vec::new();
    let (hash, other_hash) = both("hash");
    if hash != other_hash || hash == "unknown" {
        let (version, other) = both("engine_version");
        let (program, other_program) = both("program_sha256");
        if version != other {
            differences.push(format!("it is of version {other} of the program, the first of {version}"));
        } else if program != other_program {
            differences.push(format!("it is of another build of version {version} of the program"));
        }
        for (key, what) in [("inputs", "input file"), ("plugins", "plugin")] {
            let of = |about: &Json| about[key].as_array().cloned().unwrap_or_default();
            let (ours, others) = (of(about), of(&folder.about));
            // Equal files may have other paths.
            let lacks = |all: &[Json], entry: &Json| all.iter().all(|other| other["sha256"] != entry["sha256"]);
            let differs: Vec<_> = others.iter().filter(|entry| lacks(&ours, entry)).map(shown).collect();
            differences.extend(differs.iter().map(|name| format!("its {what} {name} is another")));
            let missing = ours.iter().filter(|entry| lacks(&others, entry)).map(shown);
            differences
                .extend(missing.filter(|name| !differs.contains(name)).map(|name| format!("it has no {what} {name}")));
        }
        differences.extend(graph_difference(&folder.graph()?, graph));
        if about["sweep"] != folder.about["sweep"] {
            differences.push("its table [sweep] differs".into());
        }
    }
    let is_same = |ours: &PlanPlugin, plugin: &PlanPlugin| ours.name == plugin.name && ours.sha256 == plugin.sha256;
    differences.extend(plugin_differences(&folder.about, about, is_same));
    if hash != other_hash || hash == "unknown" {
        if differences.is_empty() {
            differences.push("its settings differ".into());
        }
        differences.push(format!("its hash is {other_hash}, not {hash}"));
    }
    Ok((!differences.is_empty()).then(|| differences.join("; ")))
}

/// How the plugins `now` differ from those of the same names in `then`, and what they have loaded: both are `sweep.json` or
/// `manifest.json`.
pub fn difference_of_plugins(then: &Json, now: &Json) -> Vec<String> {
    plugin_differences(then, now, |now, then| now.name == then.name)
}

fn plugin_differences(then: &Json, now: &Json, is_same: impl Fn(&PlanPlugin, &PlanPlugin) -> bool) -> Vec<String> {
    let of = |about: &Json| serde_json::from_value::<Vec<PlanPlugin>>(about["plugins"].clone()).unwrap_or_default();
    let now = of(now);
    let difference = |then: &PlanPlugin| then.difference(now.iter().find(|now| is_same(now, then))?);
    of(then).iter().filter_map(difference).collect()
}

/// The first entry by which two frozen graphs differ, with its table.
fn graph_difference(graph: &str, other: &str) -> Option<String> {
    if graph == other {
        return None;
    }
    let first = difference::differences(graph, other).and_then(|differences| differences.into_iter().next());
    let Some(EntryDifference { table, key, values }) = first else { return Some("its graph is another text".into()) };
    let shown = |value: &Option<String>| match value {
        Some(value) if !key.is_empty() => format!("`{key} = {value}`"),
        Some(_) => "it".into(),
        None => "nothing".into(),
    };
    Some(format!("its graph has {} in {table}, the other {}", shown(&values[0]), shown(&values[1])))
}

/// Name of an input file or a plugin in `sweep.json`.
fn shown(entry: &Json) -> String {
    let name = ["path", "file", "name"].iter().find_map(|key| entry[*key].as_str());
    name.map_or_else(|| entry.to_string(), str::to_owned)
}

fn file_name(run: usize) -> String {
    format!("{run:06}.json")
}
