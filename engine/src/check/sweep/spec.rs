//! The contents of `[sweep]`: the values a graph is run with, and the numbers extracted from each run.

use crate::graph::{SetKey, Variant, keys_set};
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

/// The table `[sweep]` of a graph file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    /// Number of runs of each setting.
    pub repeat: usize,
    /// Name of a repeat, such as `procedure`.
    pub repeat_name: String,
    /// Whether all repeats use the graph's seed, so that they differ only by the draws.
    pub same_seed: bool,
    /// Share of the runs that are computed twice.
    #[serde(default)]
    pub twice: f64,
    /// The factors in the order of the file; the first varies slowest.
    pub factors: Vec<Factor>,
    /// Groups of factors that vary together, value by value; all others are crossed.
    pub pair: Vec<Vec<String>>,
    /// Random values drawn for each repeat, equal under all factors.
    pub draws: Vec<Draw>,
    /// Units of resampling, the outermost first: names of factors and of the repeats.
    pub units: Vec<String>,
    /// Numbers and words extracted from the results of each run.
    pub columns: Vec<Column>,
    /// Lists of points extracted from the results of each run.
    pub points: Vec<PointColumn>,
    /// Limits of columns; the share of runs below each limit is reported.
    pub limits: Vec<(String, f64)>,
    /// Comparisons between the values of a factor, paired by all other factors.
    pub compare: Vec<Compare>,
}

/// A quantity that is varied over a list of values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Factor {
    /// Its name, which is also its column.
    pub name: String,
    /// Its values.
    pub levels: Vec<Level>,
}

/// A value of a factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// Its value in the tables.
    pub label: Json,
    /// The settings that it applies to the graph, in the form of `--set`.
    pub sets: Vec<String>,
    /// The file of changes that it merges over the graph.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variant: Option<Variant>,
}

/// A quantity that is drawn at random.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Draw {
    /// Its name, which is also its column.
    pub name: String,
    /// The keys that it sets.
    pub keys: Vec<String>,
    /// How it is distributed.
    #[serde(flatten)]
    pub distribution: Distribution,
}

impl Draw {
    /// The keys that it sets.
    pub(crate) fn keys_set(&self) -> Vec<SetKey> {
        // The keys do not depend on the value.
        keys_set(&self.keys.iter().map(|key| format!("{key}=0")).collect::<Vec<_>>())
            .into_iter()
            .map(|(key, _)| key)
            .collect()
    }
}

impl Level {
    /// The keys that it sets.
    pub(crate) fn keys_set(&self) -> Vec<SetKey> {
        let of_sets = keys_set(&self.sets).into_iter().map(|(key, _)| key);
        of_sets.chain(self.variant.iter().flat_map(Variant::keys)).collect()
    }
}

/// The distribution of a drawn value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Uniform between two numbers.
    Uniform([f64; 2]),
    /// Normal, by mean and standard deviation.
    Normal([f64; 2]),
    /// Uniform in the logarithm between two numbers, both above zero.
    LogUniform([f64; 2]),
    /// Uniform over the whole numbers from the first to the second, both included.
    Integers([i64; 2]),
    /// One of a list, with equal probability.
    Choice(Vec<Json>),
}

/// A number or word of each run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Its name, which ends in its unit: `tre_z_mm`.
    pub name: String,
    /// Its path in `results.json`: `metrics.tre_true_mm.mean_signed.z`.
    pub path: String,
}

/// What is measured of the time of a run and of each of its nodes.
pub(super) const TIMES: [&str; 3] = ["busy_ms", "cpu_ms", "wall_ms"];

impl Column {
    /// Whether it is a time of a node or of the run, which differs each time the run is computed.
    pub fn is_time(&self) -> bool {
        let of_run = self.path.strip_prefix("run.").filter(|time| TIMES.contains(time));
        of_run.is_some() || Self::node_of(&self.path).is_some()
    }

    /// The node and the time of which a path tells: `nodes.icp.cpu_ms`.
    pub(crate) fn node_of(path: &str) -> Option<(&str, &str)> {
        path.strip_prefix("nodes.")?.rsplit_once('.').filter(|(_, time)| TIMES.contains(time))
    }
}

/// A list of points in the results of each run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PointColumn {
    /// The quantity measured at the points, with its unit: `tre_mm`.
    pub name: String,
    /// The path of the list in `results.json`.
    pub path: String,
    /// The key of a point's name; its number if it has none.
    pub label: String,
    /// The keys of its values.
    pub axes: Vec<String>,
}

/// A comparison of a factor's values with a reference value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Compare {
    /// The factor whose values are compared.
    pub factor: String,
    /// The reference value.
    pub to: Json,
    /// Equivalence margins by column: the largest difference that does not matter.
    pub margins: Vec<(String, f64)>,
}

impl Default for Spec {
    /// One run, of which nothing is taken out.
    fn default() -> Self {
        Self {
            repeat: 1,
            repeat_name: super::REPEAT.into(),
            same_seed: false,
            twice: super::TWICE,
            factors: Vec::new(),
            pair: Vec::new(),
            draws: Vec::new(),
            units: vec![super::REPEAT.into()],
            columns: Vec::new(),
            points: Vec::new(),
            limits: Vec::new(),
            compare: Vec::new(),
        }
    }
}

impl Spec {
    /// What is drawn and taken out of each run, without what is varied.
    pub(crate) fn without_factors(self) -> Self {
        let units = vec![self.repeat_name.clone()];
        Self { repeat: 1, factors: Vec::new(), pair: Vec::new(), compare: Vec::new(), units, ..self }
    }

    /// The variants among the values of the factors.
    pub(crate) fn variants(&self) -> Vec<Variant> {
        self.factors.iter().flat_map(|factor| &factor.levels).filter_map(|level| level.variant.clone()).collect()
    }

    /// Number of runs; `None` on overflow.
    pub(crate) fn n_runs(&self) -> Option<usize> {
        let blocks = self.blocks();
        let n = |block: &Vec<usize>| self.factors[block[0]].levels.len();
        blocks.iter().map(n).try_fold(self.repeat, usize::checked_mul)
    }

    /// The factors by index, in the order of the file; paired factors form one block.
    pub(crate) fn blocks(&self) -> Vec<Vec<usize>> {
        let mut blocks: Vec<Vec<usize>> = Vec::new();
        let index = |name: &String| self.factors.iter().position(|factor| factor.name == *name);
        for (k, factor) in self.factors.iter().enumerate() {
            if blocks.iter().any(|block| block.contains(&k)) {
                continue;
            }
            let group = self.pair.iter().find(|group| group.contains(&factor.name));
            blocks.push(group.map_or_else(|| vec![k], |group| group.iter().filter_map(index).collect()));
        }
        blocks
    }
}
