//! The page of the paper's numbers: its template has each number of the paper and asks for numbers that there are; what its script
//! says of a number is what the script's own examples show.

use crate::common::root;
use serde_json::Value;
use std::{fs, process::Command};

/// The paper's numbers, typed a second time: section, words of the definition, numbers as shown.
const FACTS: [(&str, &str, &[&str]); 23] = [
    ("3.1", "hole of a printed check piece", &["0.3 ± 0.2 (0.1 to 0.8)"]),
    ("3.2.1", "five holes touched by a stylus, registered by camera", &["0.5 ± 0.1", "0.4 ± 0.04", "0.9 ± 0.1"]),
    ("3.2.1", "SD of the distance within the points", &["0.2 ± 0.1"]),
    ("3.2.1", "SD of the distance within the procedures", &["0.2"]),
    ("3.2.1", "palpation with a tracked stylus", &["0.5 ± 0.1", "0.5 ± 0.2", "1.3 ± 0.03"]),
    ("4", "camera as one number", &["0.9 ± 0.2"]),
    ("4", "stylus as one number", &["1.26 ± 0.4 (0.6 to 1.8)"]),
    ("3.2.1", "a procedure with laser and camera", &["2.5 ± 0.4 min"]),
    ("3.2.1", "a procedure with the stylus", &["2.8 ± 0.4 min"]),
    ("2", "calibration", &["40 s"]),
    ("2", "20,000 points", &["50 ms"]),
    (
        "3.2.2",
        "greatest cloud-to-cloud distance of a fragment cut by slots that the measured assessment points moved, mean; camera",
        &["0.1 ± 0.02"],
    ),
    (
        "3.2.2",
        "greatest cloud-to-cloud distance of a fragment cut by slots that the measured assessment points moved, mean; stylus",
        &["0.2 ± 0.06"],
    ),
    ("3.2.3", "200 simulated placements", &["2 ± 0.1", "1 ± 0.1", "4.6 ± 0.03"]),
    ("3.2.3", "distance of the first point from the malleolus", &["0.98"]),
    ("3.2.3, Fig. 7", "greatest cloud-to-cloud distance of a fragment after such a placement, mean", &["0.8 ± 0.5"]),
    ("3.2.3, Fig. 7", "the greatest of all placements", &["1.9"]),
    ("4, Table 1", "for the same initialisation", &["5.5", "3.1", "2.5", "2.3", "2.2", "1"]),
    ("4", "located 50 times", &["0.8"]),
    ("4", "SD along an axis", &["0.6", "0.7", "0.1"]),
    ("3.3", "ruled and located by the laser", &["1.9, 1.7, 3.6"]),
    ("3.3", "average", &["2.3"]),
    ("4", "wanted by the field", &["at most 2"]),
];

/// A line of the template with a request, and its cells before that.
struct Line {
    cells: Vec<String>,
    request: Value,
}

impl Line {
    /// What the paper gives.
    fn theirs(&self) -> &str {
        self.cells.last().unwrap()
    }
}

fn lines() -> Vec<Line> {
    let page = fs::read_to_string(root().join("graphs/paper/page.md")).unwrap();
    let line = |line: &str| {
        let (from, to) = line.find("{\"of\"").zip(line.rfind('}'))?;
        let before = line[..from].trim_start_matches("| ").trim_end_matches(" | ");
        let cells = before.split(" | ").map(str::to_owned).collect();
        Some(Line { cells, request: serde_json::from_str(&line[from..=to]).unwrap() })
    };
    page.lines().filter_map(line).collect()
}

#[test]
fn the_papers_numbers_and_definitions_are_those_of_a_second_table_and_each_has_a_row() {
    let lines = lines();
    let mut n = 0;
    for (section, words, numbers) in FACTS {
        let of_fact = |line: &&Line| line.cells[0] == section && line.cells[1].contains(words);
        let theirs: Vec<_> = lines.iter().filter(of_fact).map(Line::theirs).collect();
        assert!(!theirs.is_empty(), "{words} has no row");
        assert!(
            theirs.chunks(numbers.len()).all(|shown| shown == numbers),
            "{words}: {theirs:?} instead of {numbers:?}"
        );
        n += theirs.len();
    }
    let is_papers = |line: &&Line| line.cells.len() == 3 && line.theirs() != "not given";
    assert_eq!(n, lines.iter().filter(is_papers).count(), "a number of the paper is not in the second table");
}

#[test]
fn every_request_names_an_experiment_and_every_number_has_one_path() {
    for line in lines() {
        for key in ["of", "against"] {
            let Some(name) = line.request.get(key) else { continue };
            let graph = root().join(format!("graphs/paper/{}.toml", name.as_str().unwrap()));
            assert!(graph.is_file(), "{} is no experiment", graph.display());
        }
        let n_kinds =
            ["path", "nodes", "columns", "margins"].iter().filter(|key| line.request.get(**key).is_some()).count();
        assert_eq!(n_kinds, 1, "{}", line.request);
    }
    // Six counts, by one reading of the stop rule and by ours, carried back and in place.
    let lines = lines();
    let table_1: Vec<_> = lines.iter().filter(|line| line.cells[0] == "4, Table 1").collect();
    assert_eq!(table_1.len(), 24);
    assert_eq!(table_1[0].request["setting"]["n_points"], 100);
}

#[test]
fn the_examples_of_the_script_hold() {
    let script = root().join("graphs/paper/reproduce.py");
    let Ok(output) = Command::new("python3").args(["-B", "-m", "doctest"]).arg(script).output() else {
        eprintln!("skipped: the_examples_of_the_script_hold: no Python");
        return;
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}
