//! A graph whose recording has values, empty items, constants, columns, text and a wire that accepts any payload.

use osteoflow_engine::{Checked, RunOptions, check_text, run};
pub(crate) use osteoflow_toy::wave::registry;
use std::path::{Path, PathBuf};

pub(crate) const GRAPH: &str = r#"
[graph]
format = 1
name   = "toy"
seed   = 5

[node.beat]
kind = "toy.beat"
n    = 40

[node.constant]
kind     = "toy.beat"
n        = 1
first_ns = 0

[node.cut]
kind = "toy.cut"
in   = { wave = "beat.wave" }

[node.pass]
kind = "bench.relay"
in   = { value = "cut.short" }

[record]
wires = ["*"]

[results]
"last" = "beat.wave"
"#;

pub(crate) fn checked(sets: &[&str]) -> Checked {
    let sets: Vec<String> = sets.iter().map(|set| (*set).into()).collect();
    match check_text(GRAPH, Path::new("/graphs/toy.toml"), &sets, &registry()) {
        Ok(checked) => checked,
        Err(faults) => panic!("{faults}"),
    }
}

/// Runs the graph into the folder and returns the recording.
pub(crate) fn record(dir: &Path, sets: &[&str], workers: usize) -> PathBuf {
    let options = RunOptions { out_dir: Some(dir.into()), record: true, workers, ..RunOptions::default() };
    run(&checked(sets).plan, &registry(), &options, &()).unwrap();
    dir.join("run.mcap")
}
