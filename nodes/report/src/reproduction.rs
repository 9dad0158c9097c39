//! The page that sets the paper's numbers beside ours: each with its n and the command, and whether it lies outside the
//! paper's spread.
//!
//! The paper's numbers, and where ours are found, stand in `reproduction/published.toml`.

mod ours;
mod page;
mod published;
mod reasons;

use crate::{
    ReportError,
    summary::{self, between, with_holm},
};
use osteoflow_engine::sweep::Folder;
use ours::Ours;
use published::{Judged, Published, Row, Setting};
use reasons::Reasons;
use serde_json::Value;

/// The experiments, in the order of the paper, then ours: names of graphs in graphs/paper/.
pub const EXPERIMENTS: [&str; 12] = [
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
];

/// The experiments that are about fragments, whose reports have maps of them (Fig. 7); elsewhere two runs more for their
/// maps would take the most of a report's time.
pub const WITH_MAPS: [&str; 2] = ["cutting", "sensitivity"];

/// The experiments that were run, ready to be told.
pub struct Reproduction {
    published: Published,
    /// In the order given.
    experiments: Vec<Experiment>,
    /// Of each meeting in `published` whose experiments are there: the comparisons, or why there are none.
    met: Vec<(usize, Result<Vec<Value>, String>)>,
}

/// An experiment that was run.
struct Experiment {
    name: String,
    summary: Value,
    reasons: Reasons,
}

impl Reproduction {
    /// Of finished sweeps, by the name of their experiment.
    ///
    /// # Errors
    /// If a file of theirs cannot be read.
    pub fn new(sweeps: &[(String, Folder)]) -> Result<Self, ReportError> {
        let published = Published::new();
        let read = |(name, folder): &(String, Folder)| {
            let runs = folder.done()?.collect::<Result<Vec<_>, _>>()?;
            Ok(Experiment { name: name.clone(), summary: summary::read(folder)?, reasons: Reasons::of(&runs) })
        };
        let experiments = sweeps.iter().map(read).collect::<Result<_, ReportError>>()?;
        let mut met = Vec::new();
        for (index, meeting) in published.meeting.iter().enumerate() {
            let folder = |of: &str| sweeps.iter().find(|(name, _)| name == of).map(|(_, folder)| folder);
            let (Some(first), Some(second)) = (folder(&meeting.first), folder(&meeting.second)) else { continue };
            let done = |folder: &Folder| folder.done()?.collect::<Result<Vec<_>, _>>();
            let (mut spec, a, b) = (first.spec()?, done(first)?, done(second)?);
            spec.columns.retain(|column| meeting.columns.contains(&column.name));
            let margins: Vec<_> = meeting.columns.iter().map(|name| (name.clone(), meeting.margin_mm)).collect();
            let compared = between((&meeting.first, &spec, &a), (&meeting.second, &second.spec()?, &b), &margins);
            met.push((index, compared.map(with_holm).map_err(|none| none.to_string())));
        }
        Ok(Self { published, experiments, met })
    }

    /// The rows whose number of ours lies outside the paper's spread, a line each.
    pub fn outside(&self) -> Vec<String> {
        let told = |row: &Row| {
            let ours = self.of_row(row)?;
            let Some(Judged::Outside(side)) = row.judged(ours.value?) else { return None };
            Some(format!("{} ({}): paper {}, ours {}, {side}", row.what, row.section, row.theirs, ours.text))
        };
        self.published.row.iter().filter_map(told).collect()
    }

    /// The experiments none of whose runs has results, a line each with the first reason.
    pub fn without_results(&self) -> Vec<String> {
        let told = |of: &Experiment| {
            let (run, reason) = of.reasons.first.as_ref()?;
            let none = of.summary["n_runs"].as_u64() == Some(of.reasons.n as u64);
            none.then(|| format!("{}: none of its {} runs has results; run {run}: {reason}", of.name, of.reasons.n))
        };
        self.experiments.iter().filter_map(told).collect()
    }

    /// The page in Markdown; `command` is what it was made by, `of_experiment` what makes the numbers of one experiment again.
    pub fn page(&self, command: &str, of_experiment: &dyn Fn(&str) -> String) -> String {
        page::text(self, command, of_experiment)
    }

    fn of_row(&self, row: &Row) -> Option<Ours> {
        self.ours(&row.experiment, &row.ours, &row.setting, row.show.as_deref())
    }

    fn ours(&self, experiment: &str, path: &str, setting: &Setting, show: Option<&str>) -> Option<Ours> {
        Ours::find(&self.experiment(experiment)?.summary, path, setting, show)
    }

    fn experiment(&self, name: &str) -> Option<&Experiment> {
        self.experiments.iter().find(|of| of.name == name)
    }
}
