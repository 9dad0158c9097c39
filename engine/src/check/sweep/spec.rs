//! What `[sweep]` says: which values a graph is run with, and which numbers are taken out of each run.

use crate::graph::{SetKey, keys_set};
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

/// The table `[sweep]` of a graph file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spec {
    /// How often every setting is run.
    pub repeat: usize,
    /// What a repeat is, such as `procedure`.
    pub repeat_name: String,
    /// Whether all repeats have the graph's seed, so that only what is drawn tells them apart.
    pub same_seed: bool,
    /// What is varied by a list of values, in the order of the file: the first varies slowest.
    pub factors: Vec<Factor>,
    /// Factors that go together, value by value; all others are crossed.
    pub pair: Vec<Vec<String>>,
    /// What is drawn anew for each repeat, and is the same under all factors.
    pub draws: Vec<Draw>,
    /// What is resampled and counted, the highest first: names of factors, and of the repeats.
    pub units: Vec<String>,
    /// Numbers and words taken out of the results of each run.
    pub columns: Vec<Column>,
    /// Lists of points taken out of the results of each run.
    pub points: Vec<PointColumn>,
    /// Limits of columns: the share of runs below is told.
    pub limits: Vec<(String, f64)>,
    /// What is compared: the values of a factor, paired by all else.
    pub compare: Vec<Compare>,
}

/// Something that is varied by a list of values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Factor {
    /// Its name, and that of its column.
    pub name: String,
    /// Its values.
    pub levels: Vec<Level>,
}

/// A value of a factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// What stands in the table.
    pub label: Json,
    /// What it sets in the graph, as `--set` takes it.
    pub sets: Vec<String>,
}

/// Something that is drawn at random.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Draw {
    /// Its name, and that of its column.
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
        // Whatever the value: it is the keys that are asked for.
        keys_set(&self.keys.iter().map(|key| format!("{key}=0")).collect::<Vec<_>>())
            .into_iter()
            .map(|(key, _)| key)
            .collect()
    }
}

impl Level {
    /// The keys that it sets.
    pub(crate) fn keys_set(&self) -> Vec<SetKey> {
        keys_set(&self.sets).into_iter().map(|(key, _)| key).collect()
    }
}

/// How a value is distributed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Evenly from the first number to the second.
    Uniform([f64; 2]),
    /// Normally, by mean and standard deviation.
    Normal([f64; 2]),
    /// Evenly in the logarithm, from the first number to the second, both above zero.
    LogUniform([f64; 2]),
    /// A whole number from the first to the second, both included.
    Integers([i64; 2]),
    /// One of a list.
    Choice(Vec<Json>),
}

/// A number or word of each run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Its name, which ends in its unit: `tre_z_mm`.
    pub name: String,
    /// Where it stands in `results.json`: `metrics.tre_true_mm.mean_signed.z`.
    pub path: String,
}

/// A list of points of each run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PointColumn {
    /// What is measured at the points, with its unit: `tre_mm`.
    pub name: String,
    /// Where the list stands in `results.json`.
    pub path: String,
    /// The key of a point's name; its number where it has none.
    pub label: String,
    /// The keys of its values.
    pub axes: Vec<String>,
}

/// What is compared with what.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Compare {
    /// The factor whose values are compared.
    pub factor: String,
    /// The value that all others are compared with.
    pub to: Json,
    /// For a column, the largest difference that does not matter: for the test of equivalence.
    pub margins: Vec<(String, f64)>,
}

impl Spec {
    /// How many runs there are; `None` if nobody can count them.
    pub(crate) fn n_runs(&self) -> Option<usize> {
        let blocks = self.blocks();
        let n = |block: &Vec<usize>| self.factors[block[0]].levels.len();
        blocks.iter().map(n).try_fold(self.repeat, usize::checked_mul)
    }

    /// The factors by index, those that go together in one block, in the order of the file.
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
