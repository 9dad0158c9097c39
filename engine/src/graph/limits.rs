//! Bounds on names and texts of a graph file, far beyond what anyone writes, so that absurd input is refused at once and by
//! name, instead of filling memory, messages and file names.

use super::tree::{Spanned, Table, Value};
use crate::fault::{Fault, Span};

/// Longest key, such as the name of a node or port, bytes: names become parts of file names, whose limit this is.
pub(super) const MAX_NAME_BYTES: usize = 255;

/// Longest text, bytes: several pages of documentation; a path has at most 4096.
const MAX_TEXT_BYTES: usize = 1 << 14;

/// Most files of which each extends the next: shipped variants have four, and each file is a layer to look through.
pub(super) const MAX_EXTENDS: usize = 32;

/// Most modules within each other: shipped graphs have one level.
pub(super) const MAX_MODULE_DEPTH: usize = 32;

/// Removes keys and texts that are too long, each with a fault that quotes their beginning only.
pub(super) fn enforce(table: &mut Table, faults: &mut Vec<Fault>) {
    table.0.retain_mut(|entry| {
        let is_short = entry.key.len() <= MAX_NAME_BYTES;
        if !is_short {
            faults.push(too_long("a name", &entry.key, &entry.key_at, MAX_NAME_BYTES));
        }
        is_short && enforce_value(&mut entry.value, faults)
    });
}

fn enforce_value(value: &mut Spanned, faults: &mut Vec<Fault>) -> bool {
    match &mut value.value {
        Value::Text(text) if text.len() > MAX_TEXT_BYTES => {
            faults.push(too_long("a text", text, &value.at, MAX_TEXT_BYTES));
            return false;
        }
        Value::Table(table) => enforce(table, faults),
        Value::Array(items) => items.retain_mut(|item| enforce_value(item, faults)),
        _ => {}
    }
    true
}

/// A fault without an excerpt, whose line would be as long.
fn too_long(what: &str, text: &str, at: &Span, limit: usize) -> Fault {
    let (location, start) = (at.location(), beginning(text));
    let place = format!("{}:{}", location.file.display(), location.line);
    let message =
        format!("{place}: {what} has {} bytes, at most {limit} are read; it begins with \"{start}\"", text.len());
    Fault::new(message).help("was something else pasted into the file?")
}

/// The first characters of a text.
pub(super) fn beginning(text: &str) -> String {
    text.chars().take(20).collect()
}

#[cfg(test)]
mod tests {
    use crate::graph;

    fn said(text: &str) -> Vec<String> {
        let mut faults = Vec::new();
        graph::load_text(text.into(), "absurd.toml".as_ref(), &[], &mut faults);
        faults.iter().map(|fault| fault.render(false)).collect()
    }

    #[test]
    fn names_and_texts_of_100_kb_are_refused_by_their_beginning_and_line() {
        let long = "n".repeat(100_000);
        let start = "begins with \"nnnnnnnnnnnnnnnnnnnn\"";
        for (text, what) in [
            (format!("[graph]\nformat = 1\n[node.{long}]\nkind = \"a\"\n"), "absurd.toml:3: a name has 100000 bytes"),
            (format!("[graph]\nformat = 1\nname = \"{long}\"\n"), "absurd.toml:3: a text has 100000 bytes"),
            (
                format!("[graph]\nformat = 1\n[node.a]\nin = {{ b = \"{long}\" }}\n"),
                "absurd.toml:4: a text has 100000 bytes",
            ),
            (format!("[graph]\nformat = 1\n[node.a]\nin.{long} = \"b.c\"\n"), "absurd.toml:4: a name has 100000 bytes"),
            (
                format!("[graph]\nformat = 1\n[record]\nwires = [\"{long}\"]\n"),
                "absurd.toml:4: a text has 100000 bytes",
            ),
            (format!("[graph]\nformat = 1\n[results]\n{long} = \"a.b\"\n"), "absurd.toml:4: a name has 100000 bytes"),
        ] {
            let faults = said(&text);
            assert!(faults[0].contains(what) && faults[0].contains(start), "{:.300}", faults[0]);
            assert!(faults.iter().all(|fault| fault.len() < 1000), "no fault repeats the text");
        }
    }

    #[test]
    fn a_chain_of_6000_files_that_extend_each_other_is_refused_at_its_limit() {
        let dir = tempfile::tempdir().unwrap();
        let file = |k: usize| dir.path().join(format!("{k}.toml"));
        for k in 0..6000 {
            std::fs::write(file(k), format!("extends = \"{}.toml\"\n", k + 1)).unwrap();
        }
        let mut faults = Vec::new();
        graph::load(&file(0), &[], &mut faults);
        assert_eq!(faults.len(), 1);
        let message = faults[0].render(false);
        assert!(message.contains("more than 32 files extend each other") && message.contains("31.toml:1"), "{message}");
    }

    #[test]
    fn modules_nested_too_deep_are_refused_at_the_limit() {
        let dir = tempfile::tempdir().unwrap();
        let file = |k: usize| dir.path().join(format!("{k}.toml"));
        let node = |k: usize| format!("[graph]\nformat = 1\n[node.m]\nkind = \"module\"\nfile = \"{k}.toml\"\n");
        std::fs::write(file(0), node(1)).unwrap();
        for k in 1..1002 {
            std::fs::write(file(k), node(k + 1) + "[module]\ndoc = \"deep\"\n").unwrap();
        }
        let mut faults = Vec::new();
        graph::load(&file(0), &[], &mut faults);
        let message = faults[0].render(false);
        assert!(message.contains("modules are nested more than 32 deep") && message.contains("32.toml:5"), "{message}");
    }

    #[cfg(unix)]
    #[test]
    fn a_device_or_pipe_is_no_graph_file_and_is_not_read() {
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for (path, kind) in [("/dev/zero".as_ref(), "a device"), (pipe.as_path(), "a pipe")] {
            let mut faults = Vec::new();
            assert!(graph::load(path, &[], &mut faults).is_none());
            let message = faults[0].render(false);
            assert!(message.contains(&format!("{} is {kind}; a graph file is needed", path.display())), "{message}");
        }
    }
}
