//! The page that compares the paper's numbers with ours: each with its n, the command that computes it, and whether it is
//! outside the paper's spread.
//!
//! `reproduction/published.toml` holds the paper's numbers and the paths of ours.

mod ours;
mod page;
mod published;
mod reasons;

use crate::{
    ReportError,
    summary::{self, between, with_holm},
};
use osteoflow_engine::{run::NodeStats, sweep::Folder};
use ours::Ours;
use published::{Judged, Published, PublishedNumber, Setting};
use reasons::Reasons;
use serde_json::Value;
use std::collections::BTreeSet;

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

/// The experiments that were run.
pub struct Reproduction {
    published: Published,
    /// In the order given.
    experiments: Vec<Experiment>,
    /// The paired comparisons of each pair of experiments in `published` that was run, or the reason why there are none.
    paired: Vec<(usize, Result<Vec<Value>, String>)>,
    /// Computing times of one procedure, by experiment.
    times: Vec<(String, Vec<NodeStats>)>,
}

/// An experiment that was run.
struct Experiment {
    name: String,
    summary: Value,
    reasons: Reasons,
}

impl Reproduction {
    /// Reads finished sweeps, by the names of their experiments.
    ///
    /// # Errors
    /// If a file of a sweep cannot be read.
    pub fn new(sweeps: &[(String, Folder)]) -> Result<Self, ReportError> {
        let published = Published::new();
        let read = |(name, folder): &(String, Folder)| {
            let runs = folder.done()?.collect::<Result<Vec<_>, _>>()?;
            Ok(Experiment { name: name.clone(), summary: summary::read(folder)?, reasons: Reasons::of(&runs) })
        };
        let experiments = sweeps.iter().map(read).collect::<Result<_, ReportError>>()?;
        let mut paired = Vec::new();
        for (index, pair) in published.pair.iter().enumerate() {
            let folder = |of: &str| sweeps.iter().find(|(name, _)| name == of).map(|(_, folder)| folder);
            let (Some(first), Some(second)) = (folder(&pair.first), folder(&pair.second)) else { continue };
            let done = |folder: &Folder| folder.done()?.collect::<Result<Vec<_>, _>>();
            let (mut spec, a, b) = (first.spec()?, done(first)?, done(second)?);
            spec.columns.retain(|column| pair.columns.contains(&column.name));
            let margins: Vec<_> = pair.columns.iter().map(|name| (name.clone(), pair.margin_mm)).collect();
            let compared = between((&pair.first, &spec, &a), (&pair.second, &second.spec()?, &b), &margins);
            paired.push((index, compared.map(with_holm).map_err(|none| none.to_string())));
        }
        Ok(Self { published, experiments, paired, times: Vec::new() })
    }

    /// The experiments of which one procedure is to be timed, node by node, for [`Reproduction::with_times`].
    pub fn timed(&self) -> BTreeSet<String> {
        let times = self.published.time.iter().map(|time| time.experiment.clone());
        times.filter(|name| self.experiment(name).is_some()).collect()
    }

    /// Adds the times of the nodes that compute in one procedure of an experiment, without those that simulate or measure.
    #[must_use]
    pub fn with_times(mut self, experiment: &str, nodes: Vec<NodeStats>) -> Self {
        self.times.push((experiment.to_owned(), nodes));
        self
    }

    /// A line for each of our numbers that is outside the paper's spread.
    pub fn outside(&self) -> Vec<String> {
        let line = |row: &PublishedNumber| {
            let ours = self.of_row(row)?;
            let Some(Judged::Outside(side)) = row.judged(ours.value?) else { return None };
            Some(format!("{} ({}): paper {}, ours {}, {side}", row.what, row.section, row.theirs, ours.text))
        };
        self.published.row.iter().filter_map(line).collect()
    }

    /// A line for each row whose experiment was run and has no such number.
    pub fn missing(&self) -> Vec<String> {
        let rows = self.published.row.iter().chain(&self.published.independent);
        let has_results = |of: &Experiment| of.summary["n_runs"].as_u64() != Some(of.reasons.n as u64);
        let was_run = |row: &&PublishedNumber| self.experiment(&row.experiment).is_some_and(has_results);
        let missing = rows.filter(was_run).filter(|row| self.of_row(row).is_none());
        missing.map(|row| format!("{}: {} has no {}", row.what, row.experiment, row.ours)).collect()
    }

    /// A line for each experiment without any result, with the first reason.
    pub fn without_results(&self) -> Vec<String> {
        let line = |of: &Experiment| {
            let (run, reason) = of.reasons.first.as_ref()?;
            let none = of.summary["n_runs"].as_u64() == Some(of.reasons.n as u64);
            none.then(|| format!("{}: none of its {} runs has results; run {run}: {reason}", of.name, of.reasons.n))
        };
        self.experiments.iter().filter_map(line).collect()
    }

    /// The page in Markdown; `command` made the page, `of_experiment` returns the command that computes an experiment's numbers.
    pub fn page(&self, command: &str, of_experiment: &dyn Fn(&str) -> String) -> String {
        page::text(self, command, of_experiment)
    }

    fn of_row(&self, row: &PublishedNumber) -> Option<Ours> {
        self.ours(&row.experiment, &row.ours, &row.setting, row.show.as_deref())
    }

    fn ours(&self, experiment: &str, path: &str, setting: &Setting, show: Option<&str>) -> Option<Ours> {
        Ours::find(&self.experiment(experiment)?.summary, path, setting, show)
    }

    fn experiment(&self, name: &str) -> Option<&Experiment> {
        self.experiments.iter().find(|of| of.name == name)
    }
}
