//! The design: every setting with every repeat, in a fixed order.

use crate::check::sweep::{Distribution, Draw, Spec};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde_json::{Value as Json, json};
use sha2::{Digest as _, Sha256};

/// A row of the design: one run of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepRow {
    /// Number of the run, from 0, in the order of the factors in the file, the first varying slowest, then the repeats.
    pub run: usize,
    /// Values of the factors, the draws and the repeat, by name, in the order of the columns.
    pub values: Vec<(String, Json)>,
    /// Seed of the run.
    pub seed: u64,
    /// Settings of the run, in the form of `--set`, including the seed.
    pub sets: Vec<String>,
}

/// Every run of a sweep over a graph with this seed.
pub fn rows(spec: &Spec, seed: u64) -> Vec<SweepRow> {
    let blocks = spec.blocks();
    let sizes: Vec<usize> = blocks.iter().map(|block| spec.factors[block[0]].levels.len()).collect();
    let n_settings: usize = sizes.iter().product();
    let mut rows = Vec::with_capacity(n_settings * spec.repeat);
    for setting in 0..n_settings {
        let mut level_of = vec![0; spec.factors.len()];
        let mut rest = setting;
        for (block, size) in blocks.iter().zip(&sizes).rev() {
            block.iter().for_each(|&factor| level_of[factor] = rest % size);
            rest /= size;
        }
        for repeat in 0..spec.repeat {
            let mut row = SweepRow { run: rows.len(), values: Vec::new(), seed, sets: Vec::new() };
            for (factor, &level) in spec.factors.iter().zip(&level_of) {
                let level = &factor.levels[level];
                row.values.push((factor.name.clone(), level.label.clone()));
                row.sets.extend(level.sets.iter().cloned());
            }
            row.repeat(spec, repeat);
            rows.push(row);
        }
    }
    rows
}

impl SweepRow {
    /// Adds what a repeat sets: the draws and the seed.
    pub(super) fn repeat(&mut self, spec: &Spec, repeat: usize) {
        let seed = self.seed;
        self.values.push((spec.repeat_name.clone(), repeat.into()));
        for draw in &spec.draws {
            let value = draw.value(seed, repeat as u64);
            self.sets.extend(draw.keys.iter().map(|key| format!("{key}={}", toml(&value))));
            self.values.push((draw.name.clone(), value));
        }
        if !spec.same_seed {
            self.seed = seed.wrapping_add(repeat as u64);
            self.sets.push(format!("graph.seed={}", self.seed));
        }
    }
}

impl Draw {
    /// The draw of a repeat; depends only on the seed, the name and the repeat's number.
    fn value(&self, seed: u64, repeat: u64) -> Json {
        let mut hasher = Sha256::new();
        hasher.update(b"osteoflow sweep draw 1\n");
        hasher.update(seed.to_le_bytes());
        hasher.update(repeat.to_le_bytes());
        hasher.update(self.name.as_bytes());
        let mut rng = ChaCha8Rng::from_seed(hasher.finalize().into());
        match &self.distribution {
            Distribution::Uniform([a, b]) => json!(a + rng.random::<f64>() * (b - a)),
            Distribution::Normal([mean, sd]) => json!(mean + sd * rng.sample::<f64, _>(StandardNormal)),
            Distribution::LogUniform([a, b]) => json!((a.ln() + rng.random::<f64>() * (b.ln() - a.ln())).exp()),
            Distribution::Integers([a, b]) => json!(rng.random_range(*a..=*b)),
            Distribution::Choice(values) => values[rng.random_range(0..values.len())].clone(),
        }
    }
}

/// Formats a JSON value as in a graph file.
fn toml(value: &Json) -> String {
    match value {
        Json::Number(number) => match number.as_f64().filter(|_| number.is_f64()) {
            Some(float) => format!("{float:?}"),
            None => number.to_string(),
        },
        Json::Array(items) => format!("[{}]", items.iter().map(toml).collect::<Vec<_>>().join(", ")),
        Json::Object(entries) => {
            let entries = entries.iter().map(|(key, value)| format!("{} = {}", Json::from(key.as_str()), toml(value)));
            format!("{{ {} }}", entries.collect::<Vec<_>>().join(", "))
        }
        other => other.to_string(),
    }
}
