//! What is suggested for an input without a wire, and when a node without one never fires.

use super::own_nodes::registry;
use osteoflow_engine::{Fault, check_text};
use std::path::Path;

const SOURCES: &str = "[graph]\nformat = 1\n[node.file]\nkind = \"from.file\"\n[node.live]\nkind = \"from.live\"\n";

/// The only fault of these nodes: its message, notes and help.
fn fault(nodes: &str) -> (String, Vec<String>, Vec<String>) {
    let text = format!("{SOURCES}{nodes}");
    let mut faults = check_text(&text, Path::new("x.toml"), &[], &registry()).unwrap_err().0;
    assert_eq!(faults.len(), 1, "{faults:?}");
    let Fault { message, notes, help, .. } = faults.remove(0);
    (message, notes, help)
}

#[test]
fn outputs_of_the_name_of_the_input_are_suggested_first_then_those_of_its_frames() {
    let ranked = "[node.a]\nkind = \"frames.ranked\"\nin.start = \"file.out\"\n\
                  [node.b]\nkind = \"frames.ranked\"\n[node.c]\nkind = \"frames.ranked\"\nin.start = \"b.end\"\n";
    let (message, notes, help) = fault(ranked);
    assert_eq!(message, "node \"b\": input \"start\" is wired to nothing");
    assert_eq!(notes, ["start: Where it starts."]);
    // Those of c come from b.
    assert_eq!(help, ["wire one of these to it: \"a.start\", \"a.end\", \"file.out\", \"live.out\", \"a.other\""]);
}

#[test]
fn at_most_eight_outputs_are_suggested_and_frames_count_only_where_the_input_has_some() {
    let many: String = (0..9).map(|k| format!("[node.n{k}]\nkind = \"from.file\"\n")).collect();
    let (_, _, help) = fault(&format!("{many}[node.a]\nkind = \"to.spare\"\n"));
    let wires: Vec<_> = (0..6).map(|k| format!("\"n{k}.out\"")).collect();
    assert_eq!(help, [format!("wire one of these to it: \"file.out\", \"live.out\", {}", wires.join(", "))]);
    let (_, _, help) = fault("[node.two]\nkind = \"from.live_two\"\n[node.a]\nkind = \"to.spare\"\n");
    assert_eq!(help, ["wire one of these to it: \"file.out\", \"live.out\", \"two.out\", \"two.other\""]);
}

#[test]
fn where_nothing_fits_the_kinds_that_give_it_are_named_if_there_are_some() {
    let (message, notes, help) = fault("[node.a]\nkind = \"to.report\"\n");
    assert_eq!((message.as_str(), notes), ("node \"a\": input \"report\" is wired to nothing", vec![]));
    assert_eq!(help, [""; 0], "no kind gives a report");
    let (_, _, help) = fault("[node.w]\nkind = \"frames.want\"\n");
    assert_eq!(help, ["nothing gives toy/Cloud here; kinds that do: frames.move, frames.source, frames.want"]);
}

#[test]
fn a_node_needs_an_input_that_triggers_or_constants_only() {
    let check = |nodes: &str| {
        let text = format!("{SOURCES}{nodes}");
        let faults = check_text(&text, Path::new("x.toml"), &[], &registry()).err();
        faults.into_iter().flat_map(|faults| faults.0).map(|f| (f.message, f.notes.join("; "))).collect::<Vec<_>>()
    };
    let node = |kind: &str, inputs: &str| check(&format!("[node.a]\nkind = \"to.{kind}\"\nin = {{ {inputs} }}\n"));
    let by = |port: &str, join: &str| format!("{port} = {{ from = \"file.out\", join = \"{join}\" }}");
    let both = |a: &str, b: &str| node("pair", &format!("{}, {}", by("a", a), by("b", b)));
    let never = |note: &str| vec![("node \"a\" never fires: no input of it triggers".to_owned(), note.to_owned())];
    for trigger in ["each", "stamp"] {
        assert_eq!(both(trigger, "latest"), []);
        assert_eq!(both("once", trigger), []);
    }
    assert_eq!(both("once", "once"), []);
    assert_eq!(both("once", "latest"), never("a joins by once, b joins by latest"));
    assert_eq!(both("interpolate", "latest"), never("a joins by interpolate, b joins by latest"));
    // An optional input that is not wired and one that is not used do not trigger.
    assert_eq!(node("maybe", &by("a", "latest")), never("a joins by latest"));
    assert_eq!(node("maybe", &by("a", "once")), []);
    let spare = format!("{}, {}", by("a", "latest"), by("spare", "each"));
    assert_eq!(node("spare", &spare), never("a joins by latest"));
    assert_eq!(check("[node.a]\nkind = \"to.optional\"\n"), never(""));
    assert_eq!(node("optional", &by("b", "each")), []);
    // One fault for inputs that cannot be read.
    let said = check("[node.a]\nkind = \"to.optional\"\nin = 3\n");
    assert_eq!(said.len(), 1, "{said:?}");
}
