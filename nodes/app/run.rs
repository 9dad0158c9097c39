//! Runs of a graph.

use super::{
    error::Error,
    options::{GraphArgs, Keep, Leave},
    out_dir,
    program::{self, run_error},
};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    check::Checked,
    inputs::{WireInputs, output, run_with_inputs},
    plan::{OutputId, Plan},
    run::{Answer, GIVEN_NODES, Observer, Outcome, Refusal, RunOptions, Verdict},
};
use osteoflow_node::{Item, Registry};
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

/// A run of a graph.
#[derive(Debug, Clone, Args)]
pub struct RunRequest {
    /// The graph.
    #[command(flatten)]
    pub graph: GraphArgs,

    /// Where the files go, and the number of threads.
    #[command(flatten)]
    pub leave: Leave,

    /// Whether answers are cached.
    #[command(flatten)]
    pub keep: Keep,

    /// Do not write run.mcap.
    #[arg(long)]
    pub no_record: bool,
}

/// A checked graph.
#[derive(Debug)]
pub struct Graph {
    pub(crate) checked: Checked,
    pub(crate) request: RunRequest,
}

/// Functions of the program in place of nodes.
#[derive(Debug)]
pub struct Functions {
    /// The nodes.
    pub nodes: Vec<String>,
    /// The kinds, with a launcher that builds these nodes.
    pub registry: Registry,
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
    /// Checks the graph.
    ///
    /// # Errors
    /// All faults of the graph; [`Error::Usage`] of them.
    pub fn check(self) -> Result<Graph> {
        Ok(Graph { checked: self.graph.checked()?, request: self })
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
            record: !self.request.no_record,
            // A recorded run measures the time of every firing in any case.
            latency: !self.request.no_record,
            store: self.request.keep.store()?,
            ..program::options(self.request.leave.workers, cancelled)
        })
    }

    /// Runs it with `given` in place of what its nodes would give, and `functions` in place of nodes; files are written if the
    /// request names a folder.
    ///
    /// # Errors
    /// [`Error`]; refused if it has no results.
    pub fn run(
        &self,
        given: WireInputs,
        functions: Option<&Functions>,
        keeps: &(dyn Fn(&str) -> bool + Sync),
        observer: &dyn Observer,
        cancelled: &Arc<AtomicBool>,
    ) -> Result<GraphRun, Error> {
        let (plan, Leave { out, force, .. }) = (self.plan(), &self.request.leave);
        let mut options = self.options(cancelled)?;
        let dir = out.as_deref().map(|out| out_dir::make(Some(out), &plan.name, *force)).transpose()?;
        options.out_dir = dir.as_ref().map(|dir| dir.to_path_buf());
        (options.record, options.latency) = (options.record && dir.is_some(), options.latency && dir.is_some());
        if !given.is_empty() {
            options.command["given_wires"] = given.wires(plan).into();
        }
        if let Some(Functions { nodes, .. }) = functions {
            options.command[GIVEN_NODES] = json!(nodes);
            // An answer of the function is none of the kind's.
            options.store = None;
            options.fixed_results.push(("not_reproducible".into(), not_reproducible(nodes).into()));
        }
        let registry = functions.map_or(self.registry(), |functions| &functions.registry);
        let (report, wires) = run_with_inputs(plan, registry, &options, observer, given, keeps).map_err(run_error)?;
        let warnings = report.warnings.iter();
        let warnings = warnings.map(|w| format!("node \"{}\", item {}: {}", w.node, w.item, w.message));
        let warnings =
            functions.map(|functions| not_reproducible(&functions.nodes)).into_iter().chain(warnings).collect();
        match &report.outcome {
            Outcome::Complete => Ok(GraphRun { results: report.results, wires, warnings, out_dir: options.out_dir }),
            Outcome::Interrupted => Err(Error::Interrupted),
            Outcome::Refused(refusal) => {
                Err(Error::Refused(refusal_in_short(refusal, &report.results), report.results))
            }
        }
    }
}

/// What a run says that had functions of its program as nodes.
fn not_reproducible(nodes: &[String]) -> String {
    let nodes = nodes.join(", ");
    format!(
        "{nodes} was computed by a function of the program that ran the graph, which no file holds: the run cannot be repeated"
    )
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

/// The text of a refusal without its reason, which the verdict that is printed gives.
pub(crate) fn without_reason(text: String, results: &Value) -> String {
    let verdict = judged(results);
    let mut reasons = verdict.iter().flat_map(Verdict::reasons);
    let without = reasons.find_map(|reason| {
        let forms = [format!(": {}", reason.reason), format!(": {reason}")];
        forms.iter().find_map(|form| text.strip_suffix(form))
    });
    without.map(str::to_owned).unwrap_or(text)
}

/// The end of the warning of a landmark that counts only if its distances to the others are as planned.
const UNLESS_FITTED: &str = "and nothing else checks it";

/// Whether the run has settled what a warning leaves open: the coarse fit has found the distances between the landmarks as planned, and
/// the verdict trusts the result.
pub(crate) fn is_settled(warning: &str, results: &Value) -> bool {
    let is_fitted = results["coarse"].is_object() && warning.ends_with(UNLESS_FITTED);
    is_fitted && judged(results).is_some_and(|verdict| verdict.answer() == Answer::Trusted)
}

/// Rules, and how the warning of a node begins that says the same.
const SAME: [(&str, &str); 2] = [("start", "the scan fits elsewhere nearly as well"), ("converged", "not converged")];

/// Whether a reason of the verdict says what a warning says.
pub(crate) fn is_said_by_verdict(warning: &str, results: &Value) -> bool {
    let says = |rule: &str, reason: &str| {
        let same = SAME.iter().any(|(of, begins)| *of == rule && warning.starts_with(begins));
        same || (!reason.is_empty() && (warning.contains(reason) || reason.contains(warning)))
    };
    judged(results).is_some_and(|verdict| verdict.against().any(|reason| says(&reason.rule, &reason.reason)))
}
