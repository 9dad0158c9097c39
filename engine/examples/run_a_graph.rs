//! Checks a graph, runs it and reads its results. Its kinds are those of the tests of this crate, in a `Registry`; the page of
//! `osteoflow_node` shows how to write and register one.
use osteoflow_engine::{check_text, run, run::RunOptions};
use std::{error::Error, path::Path};

const GRAPH: &str = r#"
[graph]
format = 1

[node.numbers]
kind  = "toy.script"
calls = [{ stamp_ns = 1, give = [[0, 0.5]] }, { stamp_ns = 2, give = [[0, 2.0]] }]
out   = { number = { type = "toy/Number", calls = [] } }

[node.sum]
kind = "toy.sum"
in   = { all = { from = "numbers.number", n = 2 } }

[results]
sum = "sum.out"
"#;

fn main() -> Result<(), Box<dyn Error>> {
    let registry = osteoflow_toy::registry();
    let checked = check_text(GRAPH, Path::new("example.toml"), &[], &registry)?;
    let report = run(&checked.plan, &registry, &RunOptions::default(), &())?;
    println!("{}: {}", report.outcome.status(), report.results);
    assert_eq!(report.results["sum"], 2.5);
    Ok(())
}
