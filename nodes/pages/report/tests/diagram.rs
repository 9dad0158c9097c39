//! The diagram of a shipped graph, compared with golden text; `UPDATE=1 cargo test` rewrites the text.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

use osteoflow_draw::{dot, mermaid};
use osteoflow_report::diagram;
use std::{fs, path::Path};

fn compare(found: &str, golden: &str) {
    let path = Path::new("tests").join(golden);
    if std::env::var_os("UPDATE").is_some() {
        fs::write(&path, found).unwrap();
    }
    assert_eq!(found, fs::read_to_string(&path).unwrap(), "{golden}");
}

#[test]
fn the_diagram_of_the_calibration_graph_is_that_of_the_golden_text() {
    let registry = osteoflow_standard::registry();
    let checked = osteoflow_engine::check(Path::new("../../../graphs/calibration.toml"), &[], &registry);
    let diagram = diagram::of_plan(&checked.unwrap_or_else(|faults| panic!("{faults}")).plan);
    compare(&mermaid(&diagram), "calibration.mermaid.txt");
    compare(&dot(&diagram), "calibration.dot.txt");
    let tooltips: Vec<_> = diagram.links.iter().map(|link| format!("{}\n", link.tooltip)).collect();
    compare(&tooltips.concat(), "calibration.tooltips.txt");
}
