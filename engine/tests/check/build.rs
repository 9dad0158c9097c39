//! What nodes refuse when they are built is found by a check, in the words of a run.

use super::own_nodes;
use osteoflow_engine::{Checked, Fault, Faults, RunError, RunOptions, check_recorded, check_text, run};
use osteoflow_node::Registry;
use std::path::Path;

const PATH: &str = "x.toml";

/// The faults of a graph: message, line, and label.
fn faults(text: &str, registry: &Registry) -> Vec<(String, usize, String)> {
    let Faults(faults) = check_text(text, Path::new(PATH), &[], registry).unwrap_err();
    let shown = |fault: &Fault| {
        let line = fault.location().expect("a fault of a text has a place").line;
        (fault.message.clone(), line, fault.at.as_ref().expect("as above").1.clone())
    };
    faults.iter().map(shown).collect()
}

/// A sum, whose next parameter is on line 10.
const SUM: &str = "[graph]\nformat = 1\n[node.one]\nkind = \"toy.script\"\ncalls = []\n\
                   out.p0 = { type = \"toy/Number\", calls = [] }\n[node.sum]\nkind = \"toy.add\"\nin.a = \"one.p0\"\n";

#[test]
fn a_parameter_that_a_node_refuses_is_a_fault_at_its_line_in_the_words_of_a_run() {
    let registry = osteoflow_toy::registry();
    let message = "node \"sum\": parameter \"bad\": expected false, found true";
    assert_eq!(faults(&format!("{SUM}bad = true\n"), &registry), [(message.into(), 10, "refused".into())]);
    let checked = check_text(&format!("{SUM}bad = false\n"), Path::new(PATH), &[], &registry);
    let Checked { mut plan, .. } = checked.unwrap_or_else(|faults| panic!("{faults}"));
    plan.nodes.iter_mut().find(|node| &*node.name == "sum").unwrap().params["bad"] = true.into();
    match run(&plan, &registry, &RunOptions::default(), &()) {
        Err(error @ RunError::Build(_)) => assert_eq!(error.to_string(), format!("{PATH}:10: {message}")),
        other => panic!("{:?}", other.map(|report| report.outcome)),
    }
}

/// A graph with a declared port of these parameters, on line 6.
fn port(params: &str) -> String {
    format!(
        "[graph]\nformat = 1\n[node.a]\nkind = \"from.timed\"\n# A port.\nout.p = {{ type = \"toy/Pose\", {params} }}\n"
    )
}

#[test]
fn a_port_that_a_source_refuses_is_a_fault_at_the_key_or_at_the_port_that_lacks_it() {
    let registry = own_nodes::registry();
    let faults = |params| faults(&port(params), &registry);
    let message = |why: &str| format!("node \"a\": parameter \"out.p.device\": {why}");
    let refused = message("there is no device \"none\"");
    assert_eq!(faults("device = \"none\", has_constants = false"), [(refused, 6, "refused".into())]);
    let missing = message("no device is given");
    assert_eq!(faults("has_constants = false"), [(missing, 6, "no device here".into())]);
}

#[test]
fn a_source_that_a_recording_replaces_is_not_refused_and_a_node_that_it_feeds_is() {
    let ports = check_recorded(&port("has_constants = true"), Path::new(PATH), &[], &own_nodes::registry());
    ports.unwrap_or_else(|faults| panic!("{faults}"));
    let node = check_recorded(&format!("{SUM}bad = true\n"), Path::new(PATH), &[], &osteoflow_toy::registry());
    assert!(node.unwrap_err().to_string().contains("expected false, found true"));
}
