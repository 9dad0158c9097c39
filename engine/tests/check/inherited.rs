//! Wires of an extended file whose producer the file that extends it removes or replaces.

use super::own_nodes::registry;
use osteoflow_engine::{Fault, check, fault::Severity};
use std::fs;

const BASE: &str = r#"
[graph]
format = 1
[node.file]
kind = "from.file"
[node.spare]
kind = "from.live_two"
[node.step]
kind = "to.spare"
in   = { a = "spare.other" }
[node.last]
kind = "to.maybe"
in   = { a = "file.out", b = "step.out" }
[node.end]
kind = "to.maybe"
in   = { a = "file.out", b = { from = "spare.other", capacity = 8 } }
"#;

/// The faults and warnings of a graph that extends the base, with settings, and its wires.
fn said(text: &str, sets: &[&str]) -> (Vec<Fault>, Vec<String>) {
    checked(BASE, text, sets)
}

/// The same for another base.
fn checked(base: &str, text: &str, sets: &[&str]) -> (Vec<Fault>, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("base.toml"), base).unwrap();
    let path = dir.path().join("graph.toml");
    fs::write(&path, format!("extends = \"base.toml\"\n{text}")).unwrap();
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    match check(&path, &sets, &registry()) {
        Ok(checked) => {
            let plan = &checked.plan;
            let wire = |link: &osteoflow_engine::plan::Link| {
                let to = &plan.nodes[link.to_node];
                format!("{} -> {}.{}", plan.wire_name(link.from), to.name, to.inputs[link.to_port].port.name)
            };
            let wires = plan.links.iter().map(wire).collect();
            (checked.warnings, wires)
        }
        Err(faults) => (faults.0, Vec::new()),
    }
}

fn errors(text: &str, sets: &[&str]) -> Vec<String> {
    let errors = said(text, sets).0.into_iter().filter(|fault| fault.severity == Severity::Error);
    errors.map(|fault| fault.message).collect()
}

#[test]
fn an_optional_input_is_left_unwired_where_a_replaced_producer_has_no_such_port() {
    let replaced = "[node.spare]\nkind = \"from.live\"\n[node.step]\nin = { a = \"spare.out\" }\n";
    for (text, sets) in [(replaced, &[][..]), ("", &["spare.kind=from.live", "step.in.a=spare.out"])] {
        let (warnings, wires) = said(text, sets);
        let [warning] = &warnings[..] else { panic!("{warnings:?}") };
        let starts = "node \"end\": input \"b\" is left unwired: it is wired to \"spare.other\" in ";
        assert!(warning.message.starts_with(starts), "{warning}");
        assert!(warning.message.ends_with("base.toml, but from.live has no output \"other\""), "{warning}");
        assert_eq!(warning.help, ["wire another producer to it, or write remove = [\"node.end.in.b\"]"]);
        assert_eq!(warning.location().map(|at| at.line), Some(16));
        assert!(wires.contains(&"file.out -> end.a".to_owned()) && !wires.iter().any(|wire| wire.ends_with("end.b")));
    }
}

#[test]
fn a_node_that_feeds_optional_inputs_alone_is_left_out_with_what_fed_it() {
    let (warnings, wires) = said("remove = [\"node.spare\"]\n", &[]);
    let messages: Vec<_> = warnings.iter().map(|warning| warning.message.as_str()).collect();
    assert_eq!(messages.len(), 3, "{messages:?}");
    assert!(messages[0].starts_with("node \"step\" is left out: it is wired to \"spare.other\" in "), "{messages:?}");
    assert!(messages[0].ends_with("but node \"spare\" is gone"), "{messages:?}");
    assert_eq!(warnings[0].notes, ["the run is without what it gives to last.b"]);
    assert!(messages[1].starts_with("node \"last\": input \"b\" is left unwired: it is wired to \"step.out\""));
    assert!(messages[2].starts_with("node \"end\": input \"b\" is left unwired: it is wired to \"spare.other\""));
    assert_eq!(wires, ["file.out -> last.a", "file.out -> end.a"]);
}

#[test]
fn an_inherited_result_of_a_replaced_producer_says_how_to_go_on_and_is_never_left_out_by_itself() {
    let base = format!("{BASE}[results]\n\"a.spare\" = \"spare.other\"\n");
    let sets = ["spare.kind=from.live", "step.in.a=spare.out"];
    let (faults, _) = checked(&base, "", &sets);
    let errors: Vec<_> = faults.iter().filter(|fault| fault.severity == Severity::Error).collect();
    let [error] = errors[..] else { panic!("{faults:?}") };
    assert!(error.message.starts_with("result \"a.spare\" is gone: it is wired to \"spare.other\" in "), "{error}");
    assert!(error.message.ends_with("base.toml, but from.live has no output \"other\""), "{error}");
    assert_eq!(error.help, ["wire another producer to it, or write remove = [\"results.a.spare\"]"]);
    // What a program removes by itself, as the page does for parameters of another kind.
    assert_eq!(error.removes, None);
    let (warnings, wires) = checked(&base, "", &[&sets[..], &["remove=[\"results.a.spare\"]"]].concat());
    assert!(warnings.iter().all(|fault| fault.severity == Severity::Warning) && !wires.is_empty(), "{warnings:?}");
}

#[test]
fn a_wire_of_ones_own_and_one_to_a_required_input_stay_faults() {
    let own = "remove = [\"node.step\", \"node.spare\"]\n[node.end]\nin = { b = \"spare.other\" }\n";
    let own = errors(own, &[]);
    assert_eq!(own, ["node \"end\": input \"b\" is wired to \"spare.other\", but there is no node \"spare\""]);
    let required = errors("remove = [\"node.file\"]\n[results]\nlast = \"last.out\"\n", &[]);
    assert_eq!(required.len(), 1, "{required:?}");
    assert!(required[0].starts_with("node \"last\": input \"a\" is wired to \"file.out\""), "{required:?}");
    // What a result takes is no spare, nor what is recorded by its name.
    let recorded = errors("remove = [\"node.spare\"]\n[record]\nwires = [\"step.out\"]\n", &[]);
    assert!(recorded[0].starts_with("node \"step\": input \"a\" is wired to \"spare.other\""), "{recorded:?}");
    let result = errors("remove = [\"node.spare\"]\n[results]\nstep = \"step.out\"\n", &[]);
    assert!(result[0].starts_with("node \"step\": input \"a\" is wired to \"spare.other\""), "{result:?}");
    // Nobody replaced a producer that never was there.
    let misspelt = errors("[node.end]\nin = { b = \"spar.other\" }\n", &[]);
    assert_eq!(misspelt.len(), 1, "{misspelt:?}");
}
