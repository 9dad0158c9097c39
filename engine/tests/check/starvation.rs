//! Which joins are warned of because they never fire, or fire once on a stream.

use super::own_nodes::registry;
use osteoflow_engine::check_text;
use std::path::Path;

const SOURCES: &str = "[graph]\nformat = 1\n[node.live]\nkind = \"from.live\"\n[node.live_two]\nkind = \"from.live_two\"\n\
    [node.constant]\nkind = \"from.constant\"\n[node.file]\nkind = \"from.file\"\n";

/// The warnings of nodes, each given as `name: kind, port = wire, port = wire by join`.
fn warnings(nodes: &[&str]) -> Vec<String> {
    let mut text = SOURCES.to_owned();
    for node in nodes {
        let (name, rest) = node.split_once(": ").unwrap();
        let mut parts = rest.split(", ");
        text += &format!("[node.{name}]\nkind = \"to.{}\"\n", parts.next().unwrap());
        for part in parts {
            let (port, wire) = part.split_once(" = ").unwrap();
            let (wire, join) = wire.split_once(" by ").unwrap_or((wire, ""));
            let join = match join.strip_prefix("collect ") {
                Some(n) => format!(", n = {n}"),
                None if join.is_empty() => String::new(),
                None => format!(", join = \"{join}\""),
            };
            text += &format!("in.{port} = {{ from = \"{wire}.out\"{join} }}\n");
        }
    }
    let checked = check_text(&text, Path::new("x.toml"), &[], &registry()).unwrap_or_else(|faults| panic!("{faults}"));
    let warning = |warning: &osteoflow_engine::Fault| format!("{} ({})", warning.message, warning.notes.join("; "));
    checked.warnings.iter().map(warning).collect()
}

const STEP: &str = "fires once: input \"b\" takes each item of \"constant.out\", which gives one";
const LEFT: &str = "inputs that join by each go in step, so all but one of \"live.out\" are left over";
const STREAM: &str = "takes one item for the whole run, but";
const SECOND: &str = "a second item on an input that joins by once fails the run";
const STAMP: &str = "no item of a stream that follows a clock has that stamp";

#[test]
fn a_constant_in_step_with_a_stream_leaves_the_stream_over() {
    let expected = [format!("node \"x\": {STEP} ({LEFT})")];
    assert_eq!(warnings(&["x: pair, a = live, b = constant"]), expected);
    // Nothing is known of a recording, and two constants go in step.
    assert_eq!(warnings(&["x: pair, a = file, b = constant"]), [""; 0]);
    assert_eq!(warnings(&["x: pair, a = constant, b = constant"]), [""; 0]);
    assert_eq!(warnings(&["x: pair, a = live, b = live"]), [""; 0]);
    assert_eq!(warnings(&["x: pair, a = live, b = constant by once"]), [""; 0]);
    // An optional input that has ended is left out of the firings.
    assert_eq!(warnings(&["x: maybe, a = live, b = constant"]), [""; 0]);
    // Several outputs of a live source may give one item each.
    assert_eq!(warnings(&["x: pair, a = live_two, b = constant"]), [""; 0]);
}

#[test]
fn a_stream_that_is_taken_once_fails_the_run() {
    let once = |x: &str| format!("node \"x\": input \"b\" {STREAM} \"{x}.out\" is a stream ({SECOND})");
    assert_eq!(warnings(&["x: pair, a = constant, b = live by once"]), [once("live")]);
    for fine in ["constant", "file", "live_two"] {
        assert_eq!(warnings(&[&format!("x: pair, a = constant, b = {fine} by once")]), [""; 0]);
    }
    // An output is a stream if every trigger of its node takes each item of one.
    let y = |y: &str| warnings(&[y, "x: pair, a = constant, b = y by once"]);
    assert_eq!(y("y: pair, a = live, b = live"), [once("y")]);
    assert_eq!(y("y: pair, a = live, b = constant by once"), [once("y")]);
    assert_eq!(y("y: pair, a = live, b = live by stamp"), [""; 0], "stamps may never meet");
    assert_eq!(y("y: pair, a = live, b = file"), [""; 0]);
    assert_eq!(y("y: list, list = live by collect 2"), [""; 0]);
    assert_eq!(y("y: list, list = live"), [""; 0], "the list of all items is one");
    assert_eq!(y("y: spare, a = live, spare = constant"), [once("y")], "an unused input does not bound it");
    assert_eq!(y("y: maybe, a = live"), [once("y")]);
}

#[test]
fn a_list_of_several_items_of_one_never_comes() {
    let list = |n: u32, x: &str| {
        format!(
            "node \"x\": input \"list\" collects {n} items, but \"{x}.out\" gives one (the node never has a result: \
             1 of {n} items came before the end)"
        )
    };
    assert_eq!(warnings(&["x: list, list = constant by collect 2"]), [list(2, "constant")]);
    for fine in ["constant by collect 1", "constant", "live by collect 2", "file by collect 2"] {
        assert_eq!(warnings(&[&format!("x: list, list = {fine}")]), [""; 0], "{fine}");
    }
    // An output gives one item if a trigger that is needed does, or every one.
    let y = |y: &str| warnings(&[y, "x: list, list = y by collect 2"]);
    for one in [
        "y: pair, a = constant, b = file",
        "y: pair, a = file, b = constant",
        "y: list, list = file",
        "y: list_and, list = file, b = file",
        "y: maybe, a = constant, b = file",
        "y: maybe, a = constant, b = constant",
        "y: spare, a = constant, spare = file",
        "y: pair, a = constant by once, b = constant by once",
        "y: pair, a = file by once, b = live_two by once",
    ] {
        assert_eq!(y(one), [list(2, "y")], "{one}");
    }
    for many in ["y: pair, a = file, b = file", "y: maybe, a = file, b = constant", "y: list, list = file by collect 1"]
    {
        assert_eq!(y(many), [""; 0], "{many}");
    }
}

#[test]
fn a_constant_has_no_stamp_that_a_stream_meets() {
    let stamp = |x: &str, never: &str| {
        format!(
            "node \"x\": input \"b\" joins by stamp, but \"{x}.out\" is a constant without a time ({never}: {STAMP})"
        )
    };
    let node = "the node never has a result";
    assert_eq!(warnings(&["x: pair, a = live, b = constant by stamp"]), [stamp("constant", node)]);
    assert_eq!(warnings(&["x: maybe, a = live, b = constant by stamp"]), [stamp("constant", "it never has a value")]);
    for fine in [
        "a = file, b = constant by stamp",
        "a = constant, b = constant by stamp",
        "a = live, b = file by stamp",
        "a = live, b = live by stamp",
    ] {
        assert_eq!(warnings(&[&format!("x: pair, {fine}")]), [""; 0], "{fine}");
    }
    // An output is timeless if all that makes its node fire is.
    let y = |y: &str| warnings(&[y, "x: pair, a = live, b = y by stamp"]);
    for timeless in ["y: pair, a = constant, b = constant", "y: pair, a = constant by once, b = constant by once"] {
        assert_eq!(y(timeless), [stamp("y", node)], "{timeless}");
    }
    for timed in ["y: pair, a = constant, b = file", "y: pair, a = constant by once, b = file by once"] {
        assert_eq!(y(timed), [""; 0], "{timed}");
    }
}

#[test]
fn a_constant_has_no_neighbours_to_interpolate_between() {
    let expected = "node \"x\": input \"b\" joins by interpolate, but \"constant.out\" is a constant without a time (the node \
                    never has a result: a constant has no neighbours to read between)";
    assert_eq!(warnings(&["x: pair, a = live, b = constant by interpolate"]), [expected]);
    for fine in ["a = file, b = constant by interpolate", "a = live, b = file by interpolate"] {
        assert_eq!(warnings(&[&format!("x: pair, {fine}")]), [""; 0], "{fine}");
    }
}

/// The faults of a pair whose `a` is a constant and whose `b` is joined to a port with or without constants.
fn looked_up(a: &str, join: &str, has_constants: bool, kind: &str) -> String {
    let text = format!(
        "{SOURCES}[node.timed]\nkind = \"from.timed\"\nout.out = {{ type = \"toy/Pose\", device = \"x\", has_constants = \
         {has_constants} }}\n[node.average]\nkind = \"to.pair\"\nin = {{ a = \"timed.out\", b = {{ from = \"timed.out\", join = \
         \"latest\" }} }}\n[node.x]\nkind = \"to.{kind}\"\nin = {{ a = \"{a}.out\", b = {{ from = \"average.out\", join = \"{join}\" }} }}\n"
    );
    match check_text(&text, Path::new("x.toml"), &[], &registry()) {
        Ok(_) => String::new(),
        Err(faults) => faults.0.iter().map(|fault| fault.message.as_str()).collect::<Vec<_>>().join("\n"),
    }
}

#[test]
fn a_stream_that_is_looked_up_at_the_time_of_a_constant_is_a_fault_through_the_nodes_between() {
    let expected = "node \"x\": input \"b\" takes \"average.out\" at the time of \"constant.out\", which has none";
    for join in ["interpolate", "latest"] {
        assert_eq!(looked_up("constant", join, false, "pair"), expected);
        assert_eq!(looked_up("constant", join, true, "pair"), "", "one of its constants may be there");
        assert_eq!(looked_up("file", join, false, "pair"), "", "the other may have a time");
        assert_eq!(looked_up("constant", join, false, "maybe"), "", "the node does without it");
    }
}
