//! The page that compares the paper's numbers with ours: each with its n, the command that computes it, and whether it is
//! outside the paper's spread.
//!
//! `reproduction/page.md` is the page with a request instead of each number of ours.

mod ours;
mod page;
mod reasons;
mod template;

use crate::{
    ReportError,
    summary::{self, between, with_holm},
};
use osteoflow_engine::{run::NodeStats, sweep::Folder};
use ours::Ours;
use reasons::Reasons;
use serde_json::Value;
use template::{Number, Pair, Row};

/// The experiments: names of graphs in graphs/paper/, first those of the paper in its order, then ours.
pub const EXPERIMENTS: [&str; 13] = [
    "calibration",
    "accuracy_camera",
    "accuracy_stylus",
    "cutting",
    "sensitivity",
    "point_count",
    "laser_spot",
    "in_vivo",
    "variants",
    "roi_extent",
    "readings",
    "error_terms",
    "laser_detectors",
];

/// The experiments about fragments, whose reports have maps of them (Fig. 7); elsewhere the two repeated runs for the maps
/// would take most of a report's time.
pub const WITH_MAPS: [&str; 2] = ["cutting", "sensitivity"];

/// The experiments of which one procedure is timed, node by node, for the page.
pub const TIMED: [&str; 2] = ["accuracy_camera", "accuracy_stylus"];

/// The experiments that were run, in the order given.
pub struct Reproduction {
    experiments: Vec<Experiment>,
}

/// An experiment that was run.
struct Experiment {
    name: String,
    folder: Folder,
    summary: Value,
    reasons: Reasons,
}

impl Experiment {
    fn has_results(&self) -> bool {
        self.summary["n_runs"].as_u64() != Some(self.reasons.n as u64)
    }
}

impl Reproduction {
    /// Reads finished sweeps, by the names of their experiments.
    ///
    /// # Errors
    /// If a file of a sweep cannot be read.
    pub fn new(sweeps: &[(String, Folder)]) -> Result<Self, ReportError> {
        let read = |(name, folder): &(String, Folder)| {
            let runs = folder.done()?.collect::<Result<Vec<_>, _>>()?;
            let (summary, reasons) = (summary::read(folder)?, Reasons::of(&runs));
            Ok(Experiment { name: name.clone(), folder: folder.clone(), summary, reasons })
        };
        Ok(Self { experiments: sweeps.iter().map(read).collect::<Result<_, ReportError>>()? })
    }

    /// A line for each of our numbers that is outside the paper's spread.
    pub fn outside(&self) -> Vec<String> {
        let line = |row: Row| {
            let ours = self.ours(&row.number)?;
            let judgement = row.judgement(ours.value?).filter(|judgement| !judgement.is_within)?;
            let Row { section, what, theirs, .. } = row;
            Some(format!("{what} ({}): paper {theirs}, ours {}, {}", section?, ours.text, judgement.text))
        };
        template::rows().filter_map(line).collect()
    }

    /// A line for each row whose experiment was run and has no such number.
    pub fn missing(&self) -> Vec<String> {
        let was_run = |row: &Row| self.experiment(&row.number.of).is_some_and(Experiment::has_results);
        let missing = template::rows().filter(was_run).filter(|row| self.ours(&row.number).is_none());
        missing.map(|row| format!("{}: {} has no {}", row.what, row.number.of, row.number.path)).collect()
    }

    /// A line for each experiment without any result, with the first reason.
    pub fn without_results(&self) -> Vec<String> {
        let line = |of: &Experiment| {
            let (run, reason) = of.reasons.first.as_ref().filter(|_| !of.has_results())?;
            Some(format!("{}: none of its {} runs has results; run {run}: {reason}", of.name, of.reasons.n))
        };
        self.experiments.iter().filter_map(line).collect()
    }

    /// The page in Markdown; `command` made the page, `command_of` returns the command that computes an experiment's numbers.
    /// `times` are those of the nodes that compute in one procedure of [`TIMED`] experiments, without those that simulate or
    /// measure.
    ///
    /// # Errors
    /// If a file of a sweep cannot be read.
    pub fn page(
        &self,
        command: &str,
        command_of: &dyn Fn(&str) -> String,
        times: &[(String, Vec<NodeStats>)],
    ) -> Result<String, ReportError> {
        page::Page { reproduction: self, command, command_of, times }.text()
    }

    fn ours(&self, number: &Number) -> Option<Ours> {
        Ours::find(&self.experiment(&number.of)?.summary, &number.path, &number.setting, number.show.as_deref())
    }

    fn experiment(&self, name: &str) -> Option<&Experiment> {
        self.experiments.iter().find(|of| of.name == name)
    }

    /// The paired comparisons of two experiments, or the reason why there are none.
    fn compared(&self, pair: &Pair) -> Result<Result<Vec<Value>, String>, ReportError> {
        let [Some(first), Some(second)] = [&pair.of, &pair.against].map(|name| self.experiment(name)) else {
            return Ok(Err("one of them was not run".into()));
        };
        let (mut spec, other) = (first.folder.spec()?, second.folder.spec()?);
        let [a, b] = [first, second].map(|of| of.folder.done().and_then(Iterator::collect::<Result<Vec<_>, _>>));
        spec.columns.retain(|column| pair.columns.contains(&column.name));
        let margins: Vec<_> = pair.columns.iter().map(|name| (name.clone(), pair.margin_mm)).collect();
        let compared = between((&pair.of, &spec, &a?), (&pair.against, &other, &b?), &margins);
        Ok(compared.map(with_holm).map_err(|none| none.to_string()))
    }
}
