//! Frames of ports that refer to parameters, to each other and to frames by name.

use super::{golden::compare, own_nodes::registry};
use osteoflow_engine::{check_text, plan::Plan};
use std::{fmt::Write, path::Path};

const SOURCES: &str = r#"
[graph]
format = 1
[node.one]
kind  = "frames.source"
frame = "camera"
to    = "ct"
from  = "camera"
[node.two]
kind  = "frames.source"
frame = "world"
to    = "world"
from  = "tool"
[node.three]
kind  = "frames.source"
frame = "ct"
to    = "ct"
from  = "tool"
"#;

/// The frames of each output, or the faults.
fn frames(nodes: &str) -> String {
    let text = format!("{SOURCES}{nodes}");
    let plan = match check_text(&text, Path::new("x.toml"), &[], &registry()) {
        Ok(checked) => checked.plan,
        Err(faults) => return faults.to_string(),
    };
    of(&plan)
}

fn of(plan: &Plan) -> String {
    let mut out = String::new();
    for node in plan.nodes.iter().filter(|node| !["one", "two", "three"].contains(&&*node.name)) {
        for output in &node.outputs {
            let frames = &output.frames;
            let name = |frame: &Option<String>| frame.clone().unwrap_or_else(|| "?".into());
            let shown = match output.name.as_str() {
                "cloud" => name(&frames.frame),
                _ => format!("{} -> {}", name(&frames.from), name(&frames.to)),
            };
            writeln!(out, "{}.{}: {shown}", node.name, output.name).unwrap();
        }
    }
    out
}

fn moved(cloud: &str, pose: &str) -> String {
    format!("[node.m]\nkind = \"frames.move\"\nin = {{ cloud = \"{cloud}\", pose = \"{pose}\" }}\n")
}

fn want(inputs: &str, more: &str) -> String {
    format!("[node.w]\nkind = \"frames.want\"\nin = {{ {inputs} }}\n{more}\n")
}

#[test]
fn frames_that_meet_propagate() {
    assert_eq!(frames(&moved("one.cloud", "one.pose")), "m.cloud: ct\nm.back: ct -> camera\n");
    // A frame that no wire gives is that which the port declares by another port.
    assert_eq!(frames(&moved("one.unknown", "one.pose")), "m.cloud: ct\nm.back: ct -> camera\n");
    assert_eq!(frames(&want("cloud = \"three.cloud\"", "")), "w.cloud: ct\nw.pose: tool -> ct\n");
    assert_eq!(frames(&want("cloud = \"one.unknown\"", "frame = \"x\"")), "w.cloud: x\nw.pose: tool -> x\n");
    assert_eq!(
        frames(&want("cloud = \"two.cloud\", pose = \"two.pose\"", "frame = \"world\"")),
        "w.cloud: world\nw.pose: tool -> world\n"
    );
    // Two ports whose frames are those of each other, and no wire gives one.
    let unknown = format!("[node.u]\nkind = \"from.file\"\n{}", moved("one.unknown", "u.out"));
    assert_eq!(frames(&unknown), "u.out: ? -> ?\nm.cloud: ?\nm.back: ? -> ?\n");
}

#[test]
fn frames_that_do_not_meet_are_named_with_the_place_that_they_come_from() {
    let mut all = String::new();
    for nodes in [
        moved("two.cloud", "one.pose"),
        moved("one.cloud", "two.pose"),
        want("cloud = \"one.cloud\"", ""),
        want("cloud = \"one.cloud\"", "frame = \"world\""),
        want("cloud = \"three.cloud\", pose = \"one.pose\"", ""),
        want("cloud = \"three.cloud\", pose = \"two.pose\"", ""),
        want("cloud = \"two.cloud\", pose = \"one.pose\"", ""),
        // Nothing downstream of a fault has another one.
        format!("{}{}", moved("two.cloud", "one.pose"), want("cloud = \"m.cloud\", pose = \"m.back\"", "")),
    ] {
        writeln!(all, "{}\n", frames(&nodes)).unwrap();
    }
    compare(&all, Path::new("tests/check/frames.txt")).unwrap();
}

#[test]
fn parameters_that_name_a_frame_name_one_of_the_graph() {
    let text = |frame: &str| {
        let nodes = want("cloud = \"one.unknown\"", &format!("frame = \"{frame}\""));
        let head = SOURCES.replace("format = 1", "format = 1\nframes = [\"camera\", \"ct\", \"world\", \"tool\"]");
        check_text(&format!("{head}{nodes}"), Path::new("x.toml"), &[], &registry())
    };
    assert_eq!(of(&text("world").unwrap().plan), "w.cloud: world\nw.pose: tool -> world\n");
    let said = text("wold").unwrap_err().to_string();
    assert!(said.starts_with("error: node \"w\": frame: there is no frame \"wold\""), "{said}");
    assert!(
        said.contains("did you mean \"world\"?") && said.contains("or add \"wold\" to frames in [graph]"),
        "{said}"
    );
    assert!(said.ends_with("1 error"), "{said}");
}
