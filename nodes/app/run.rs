//! Runs of a graph.

use super::{
    error::Error,
    out_dir,
    plugins::Plugins,
    program::{self, run_error},
    settings::Settings,
};
use anyhow::Result;
use osteoflow_engine::{
    check::{Checked, check},
    inputs::{WireInputs, output, run_with_inputs},
    plan::{OutputId, Plan},
    run::{Observer, Outcome, Refusal, RunOptions, Verdict},
};
use osteoflow_node::{Item, Registry};
use serde_json::Value;
use std::{
    collections::BTreeMap,
    num::NonZeroUsize,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

/// A run of a graph.
#[derive(Debug, Clone)]
pub struct RunRequest {
    /// The graph file.
    pub graph: PathBuf,
    /// Changes of its keys.
    pub settings: Settings,
    /// Plugins in addition to those of the graph.
    pub plugins: Plugins,
    /// The folder for the files of the run.
    pub out: Option<PathBuf>,
    /// Whether a folder that is not empty is written into, and the files of a run in it are replaced.
    pub force: bool,
    /// Whether a recording is written.
    pub record: bool,
    /// Number of threads that run nodes; by default the number of cores.
    pub workers: Option<NonZeroUsize>,
    /// Whether answers are loaded from the store and saved there.
    pub cache: bool,
}

/// A checked graph.
#[derive(Debug)]
pub struct Graph {
    pub(crate) checked: Checked,
    pub(crate) request: RunRequest,
}

/// A complete run of a graph.
#[derive(Debug)]
pub struct GraphRun {
    /// The content of `results.json`.
    pub results: Value,
    /// The items of the wires that were to be kept.
    pub wires: BTreeMap<String, Vec<Item>>,
    /// Warnings of nodes.
    pub warnings: Vec<String>,
    /// The folder with the files of the run, if it wrote any.
    pub out_dir: Option<PathBuf>,
}

impl RunRequest {
    /// A run of a graph as it is, which writes no files.
    pub fn new(graph: impl Into<PathBuf>) -> Self {
        Self {
            graph: graph.into(),
            settings: Settings::default(),
            plugins: Plugins::default(),
            out: None,
            force: false,
            record: true,
            workers: None,
            cache: true,
        }
    }

    /// Checks the graph.
    ///
    /// # Errors
    /// [`Error::Usage`] with all faults of the graph.
    pub fn check(self) -> Result<Graph, Error> {
        Ok(self.checked()?)
    }

    /// As [`Self::check`]; the error holds the faults.
    pub(crate) fn checked(self) -> Result<Graph> {
        let checked = check(&self.graph, self.settings.texts(), self.plugins.kinds()?)?;
        Ok(Graph { checked, request: self })
    }
}

impl Graph {
    /// Its plan.
    pub fn plan(&self) -> &Plan {
        &self.checked.plan
    }

    /// The kinds and payloads that it was checked with.
    pub fn registry(&self) -> &Registry {
        &self.checked.registry
    }

    /// Warnings about the graph.
    pub fn warnings(&self) -> Vec<String> {
        self.checked.warnings.iter().map(ToString::to_string).collect()
    }

    /// The output with this name.
    ///
    /// # Errors
    /// [`Error::Usage`] if there is none.
    pub fn output(&self, name: &str) -> Result<OutputId, Error> {
        output(self.plan(), name).map_err(Error::Usage)
    }

    /// The options of its run, which writes no files yet.
    pub(crate) fn options(&self, cancelled: &Arc<AtomicBool>) -> Result<RunOptions> {
        Ok(RunOptions {
            record: self.request.record,
            // A recorded run measures the time of every firing in any case.
            latency: self.request.record,
            store: program::store(self.request.cache)?,
            ..program::options(self.request.workers, cancelled)
        })
    }

    /// Runs it with `given` in place of what its nodes would give; files are written if the request names a folder.
    ///
    /// # Errors
    /// [`Error`]; refused if it has no results.
    pub fn run(
        &self,
        given: WireInputs,
        keeps: &(dyn Fn(&str) -> bool + Sync),
        observer: &dyn Observer,
        cancelled: &Arc<AtomicBool>,
    ) -> Result<GraphRun, Error> {
        let (plan, request) = (self.plan(), &self.request);
        let out = request.out.as_deref();
        let mut options = self.options(cancelled)?;
        let dir = out.map(|out| out_dir::make(Some(out), &plan.name, request.force)).transpose()?;
        options.out_dir = dir.as_ref().map(|dir| dir.to_path_buf());
        (options.record, options.latency) = (options.record && dir.is_some(), options.latency && dir.is_some());
        if !given.is_empty() {
            options.command["given_wires"] = given.wires(plan).into();
        }
        let (report, wires) =
            run_with_inputs(plan, self.registry(), &options, observer, given, keeps).map_err(run_error)?;
        let warnings = report.warnings.iter();
        let warnings = warnings.map(|w| format!("node \"{}\", item {}: {}", w.node, w.item, w.message)).collect();
        match &report.outcome {
            Outcome::Complete => Ok(GraphRun { results: report.results, wires, warnings, out_dir: options.out_dir }),
            Outcome::Interrupted => Err(Error::Interrupted),
            Outcome::Refused(refusal) => {
                Err(Error::Refused(refusal_in_short(refusal, &report.results), report.results))
            }
        }
    }
}

/// The verdict, if a node judged the results; a run that failed has its reason on stderr.
pub(crate) fn judged(results: &Value) -> Option<Verdict> {
    Verdict::of(results).filter(Verdict::is_judged)
}

/// The refusal in one sentence: without the remedy that the verdict gives with its reason.
pub(crate) fn refusal_in_short(refusal: &Refusal, results: &Value) -> String {
    let (text, verdict) = (refusal.to_string(), judged(results));
    let reasons = verdict.iter().flat_map(Verdict::reasons);
    let short = reasons.filter_map(|reason| text.strip_suffix(&format!("; {}", reason.remedy))).next();
    short.map(str::to_owned).unwrap_or(text)
}
