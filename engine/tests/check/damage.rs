use osteoflow_engine::check_text;
use osteoflow_toy::stages;
use std::{fs, path::Path};

/// Checks the text and renders its faults; asserts that each has a message and a line within the text.
fn survive(text: &str) {
    let path = Path::new("tests/graphs/everything.toml");
    let faults = match check_text(text, path, &[], &stages::registry()) {
        Ok(checked) => osteoflow_engine::Faults(checked.warnings),
        Err(faults) => {
            assert!(!faults.0.is_empty(), "refused without a fault:\n{text}");
            faults
        }
    };
    assert!(faults.render(true).len() >= faults.to_string().len());
    let n_lines = text.lines().count() + 1;
    for fault in &faults.0 {
        let line = fault.location().map_or(1, |location| location.line);
        assert!((1..=n_lines).contains(&line), "line {line} of {n_lines}: {fault}");
    }
    faults.to_json();
}

fn graph() -> String {
    fs::read_to_string("tests/graphs/everything.toml").unwrap()
}

#[test]
fn a_truncated_graph_never_panics() {
    let text = graph();
    text.char_indices().for_each(|(end, _)| survive(&text[..end]));
}

#[test]
fn a_graph_without_one_character_never_panics() {
    let text = graph();
    for (at, c) in text.char_indices() {
        survive(&format!("{}{}", &text[..at], &text[at + c.len_utf8()..]));
    }
}

/// Inserts every character at every place with `SLOW_TESTS`, otherwise one character per place.
#[test]
fn a_graph_with_an_inserted_character_never_panics() {
    let text = graph();
    let characters = ['"', '[', ']', '{', '}', '=', '.', ',', '\n', '#', 'ü', '-', '9', '\u{0}', '\''];
    let slow = std::env::var_os("SLOW_TESTS").is_some();
    for (place, (at, _)) in text.char_indices().enumerate() {
        for (turn, c) in characters.into_iter().enumerate() {
            if slow || place % characters.len() == turn {
                survive(&format!("{}{c}{}", &text[..at], &text[at..]));
            }
        }
    }
}

#[test]
fn a_graph_with_a_removed_or_repeated_line_never_panics() {
    let text = graph();
    let lines: Vec<_> = text.lines().collect();
    for skipped in 0..lines.len() {
        let rest: Vec<_> = lines.iter().enumerate().filter(|(i, _)| *i != skipped).map(|(_, line)| *line).collect();
        survive(&rest.join("\n"));
        survive(&rest.join("\r\n"));
        let mut twice = lines.clone();
        twice.insert(skipped, lines[skipped]);
        survive(&twice.join("\n"));
    }
}

#[test]
fn arbitrary_settings_never_panic() {
    let text = graph();
    let values = ["", "=", "x", "[", "{", "\"", "1", "nan", "[1, 2]", "{ a = 1 }", "ü", "2020-01-01", "a.b", "'"];
    let keys = [
        "",
        "graph",
        "node",
        "record",
        "results",
        "remove",
        "extends",
        "icp",
        "icp.in",
        "icp.in.source",
        "icp.kind",
        "icp.out",
        "recording.out.scan",
        "recording.out",
        "graph.frames",
        "graph.format",
        "record.wires",
        "results.report",
        "results.report.all",
        "crop.region",
        "crop.half_mm",
        "node.icp",
        "node.icp.on_error",
        "\"a.b\".c",
        ".",
        "a..b",
        "ü.ö",
        "'",
    ];
    for key in keys {
        for value in values {
            for set in [format!("{key}={value}"), format!("{key}{value}"), format!(" {key} = {value} ")] {
                let path = Path::new("tests/graphs/everything.toml");
                if let Err(faults) = check_text(&text, path, &[set.clone(), set], &stages::registry()) {
                    assert!(!faults.render(true).is_empty());
                }
            }
        }
    }
}
