//! docs/begin/glossary.md: each of its words is used, and the words of the program's own in help, answers and graphs are in it.

use crate::common::{commands, osteoflow, root};
use std::{collections::BTreeSet, fs};

/// The words of the glossary, as written.
fn words() -> Vec<String> {
    let page = fs::read_to_string(root().join("docs/begin/glossary.md")).unwrap();
    let rows = page.lines().filter_map(|line| line.strip_prefix("| **"));
    rows.map(|row| row.split_once("**").unwrap().0.to_owned()).collect()
}

fn printed(arguments: &[&str]) -> String {
    let output = osteoflow().args(arguments).output().unwrap();
    String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned()
}

/// The help of all commands.
pub(crate) fn help() -> String {
    let of_one = commands().into_iter().map(|(name, _)| printed(&[&name, "--help"]));
    of_one.collect::<String>() + &printed(&["--help"])
}

/// Pages of the documentation, without the glossary.
fn pages() -> String {
    let folders = ["", "begin", "use", "method", "extend", "nodes"].map(|folder| root().join("docs").join(folder));
    let files = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()));
    let files = files.filter(|path| path.extension().is_some_and(|end| end == "md") && !path.ends_with("glossary.md"));
    files.map(|path| fs::read_to_string(path).unwrap()).collect()
}

#[test]
fn each_word_of_the_glossary_has_one_row_and_is_used() {
    let words = words();
    let distinct: BTreeSet<_> = words.iter().collect();
    assert!(words.len() > 80 && distinct.len() == words.len() - 1, "source alone has two meanings: {words:?}");
    let answer = printed(&["register", "tests/data/folder/bone.stl", "tests/data/folder/scan.ply"]);
    let used = (help() + &pages() + &answer).to_lowercase();
    let unused: Vec<_> = words.iter().filter(|word| !used.contains(&word.to_lowercase())).collect();
    assert!(unused.is_empty(), "the glossary explains what nothing uses: {unused:?}");
    let page = fs::read_to_string(root().join("docs/begin/glossary.md")).unwrap();
    for row in page.lines().filter(|line| line.starts_with("| **")) {
        let cells: Vec<_> = row.trim_matches('|').split(" | ").collect();
        assert!(cells.len() == 4 && cells[1].ends_with('.') && !cells[2].trim().is_empty(), "{row}");
    }
}

#[test]
fn words_that_are_printed_or_asked_for_are_in_the_glossary() {
    let words: BTreeSet<_> = words().iter().map(|word| word.to_lowercase()).collect();
    let mut missing = BTreeSet::new();
    let mut wants = |word: &str, place: &str| {
        let singular = word.strip_suffix('s').unwrap_or(word);
        if ![word, singular].iter().any(|form| words.contains(*form)) {
            missing.insert(format!("{word} ({place})"));
        }
    };
    // The rows of an answer: two spaces, a word, two spaces.
    let files = ["tests/data/folder/bone.stl", "tests/data/folder/scan.ply"];
    let answer = printed(&["register", files[0], files[1], "-v"]);
    let rows =
        answer.lines().skip_while(|line| !line.starts_with("result")).skip(1).take_while(|line| !line.is_empty());
    let rows: Vec<_> = rows.filter_map(|row| row.split_whitespace().next()).collect();
    assert!(rows.len() > 4, "{answer}");
    rows.iter().for_each(|row| wants(row, "a row of register"));
    for word in ["verdict", "target", "source", "start"] {
        assert!(answer.lines().any(|line| line.starts_with(word)), "{word}: {answer}");
        wants(word, "register");
    }
    // The answers of a verdict, and what its lines begin with.
    let trust = fs::read_to_string(root().join("docs/begin/can-i-trust-it.md")).unwrap();
    for answer in ["trusted", "doubtful", "refused"] {
        assert!(trust.contains(&format!("| {answer} |")), "{answer}");
        wants(answer, "a verdict");
    }
    wants("assumption", "a verdict");
    // The joins, from the page of the graph file.
    let graph_file = fs::read_to_string(root().join("docs/use/graph-file.md")).unwrap();
    let joins = graph_file.lines().skip_while(|line| !line.starts_with("| Join |")).skip(2);
    let joins: Vec<_> =
        joins.map_while(|line| line.strip_prefix("| `")?.split_once('`')).map(|(join, _)| join).collect();
    assert!(joins.len() > 5, "{joins:?}");
    joins.iter().filter(|join| **join != "stamp").for_each(|join| wants(join, "a join"));
    // The tables of a run.
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let tables = printed(&["run", "graphs/two_files.toml", "-v", "--no-record", "--out", out.to_str().unwrap()]);
    for word in ["node", "wire", "item"] {
        assert!(tables.contains(word), "{word}: {tables}");
        wants(word, "the tables of a run");
    }
    // The keys of a sweep and of a graph.
    for word in
        ["factor", "draw", "repeat", "unit", "margin", "few", "policy", "kind", "port", "seed", "plugin", "module"]
    {
        wants(word, "the graph file");
    }
    // What the help speaks of without an explanation.
    let help = help();
    for word in [
        "wire",
        "item",
        "payload",
        "firing",
        "kind",
        "recording",
        "replay",
        "digest",
        "repro",
        "store",
        "sweep",
        "empty",
    ] {
        assert!(help.to_lowercase().contains(word), "{word} is not in the help any more");
        wants(word, "--help");
    }
    assert!(missing.is_empty(), "docs/begin/glossary.md lacks {missing:?}");
}
