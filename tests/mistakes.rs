//! What a newcomer gets wrong, command by command, and what the program says to it: one text that must read well. `UPDATE=1`
//! rewrites it, and the diff is what you read.

use crate::common::{assert_golden, copy_folder, data, osteoflow, root};
use std::{fmt::Write, fs, path::Path};

/// Most lines of an answer, and characters of a line, that the text keeps.
const MAX_LINES: usize = 24;
const MAX_CHARACTERS: usize = 420;

/// Commands by what is mistaken. `~` begins a line that makes a file before the next command.
const MISTAKES: &str = include_str!("data/mistakes.txt");

/// The text with what differs from machine to machine and from run to run replaced.
fn steady(text: &str, dir: &Path, max_lines: usize) -> String {
    let text = text.replace(&format!("{}/", dir.display()), "").replace(&format!("{}/", root().display()), "CHECKOUT/");
    // What a slow machine adds.
    let is_time =
        |line: &str| line.starts_with("time ") || line.contains(" nodes have worked, ") || line.contains(" after ");
    let lines = text.lines().filter(|line| !is_time(line));
    let lines: Vec<_> = lines.collect();
    // What follows from a mistake in a registration has numbers of another machine.
    let follows = |line: &&&str| line.starts_with("  - ") || line.starts_with("  assumed: ");
    let max_lines = lines.iter().position(|line| follows(&line)).map_or(max_lines, |at| at.min(max_lines));
    let kept = lines.iter().take(max_lines).map(|line| match line.char_indices().nth(MAX_CHARACTERS) {
        Some((at, _)) => format!("{} ..", line[..at].trim_end()),
        None => line.trim_end().to_owned(),
    });
    let mut out: String = kept.map(|line| line + "\n").collect();
    if lines.len() > max_lines {
        let _ = writeln!(out, ".. and {} more lines", lines.len() - max_lines);
    }
    out
}

/// Makes a file: `osteoflow ARGUMENTS` that succeed, `copy FROM TO`, `text FILE CONTENT` with `\n`, `replace FILE FROM TO` in every line, or `scale FILE TO FACTOR`
/// of a binary STL.
fn make(dir: &Path, line: &str) {
    let words: Vec<&str> = line.splitn(4, ' ').collect();
    let at = |name: &str| dir.join(name);
    let made = match words[..] {
        ["osteoflow", ..] => {
            let output = osteoflow().args(line.split(' ').skip(1)).current_dir(dir).output().unwrap();
            assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
            Ok(())
        }
        ["copy", from, to] => fs::copy(at(from), at(to)).map(drop),
        ["folder", from, to] => {
            copy_folder(&at(from), &at(to));
            Ok(())
        }
        ["text", file, ..] => {
            let content = line.splitn(3, ' ').nth(2).unwrap_or_default();
            fs::create_dir_all(at(file).parent().unwrap())
                .and_then(|()| fs::write(at(file), content.replace("\\n", "\n")))
        }
        ["cut", file, to] => fs::read(at(file)).and_then(|bytes| fs::write(at(to), &bytes[..bytes.len() / 2])),
        ["replace", file, from, to] => {
            let text = fs::read_to_string(at(file)).unwrap();
            assert!(text.contains(from), "{line}: {file} lacks it");
            fs::write(at(file), text.replace(from, to))
        }
        ["columns", file, names, ..] => reordered(&at(file), names),
        ["times", file, by] => divided(&at(file), &["t_ns"], by.parse().unwrap()),
        ["lengths", file, by] => divided(&at(file), &["x", "y", "z"], by.parse().unwrap()),
        ["scale", file, to, factor] => {
            let mut bytes = fs::read(at(file)).unwrap();
            let factor: f32 = factor.parse().unwrap();
            for triangle in bytes[84..].chunks_exact_mut(50) {
                for number in triangle[12..48].chunks_exact_mut(4) {
                    let scaled = f32::from_le_bytes(number.try_into().unwrap()) * factor;
                    number.copy_from_slice(&scaled.to_le_bytes());
                }
            }
            fs::write(at(to), bytes)
        }
        _ => panic!("{line}: no such preparation"),
    };
    made.unwrap_or_else(|error| panic!("{line}: {error}"));
}

/// Writes the cells of a CSV in another order of the columns, below the heading as it was.
fn reordered(file: &Path, names: &str) -> std::io::Result<()> {
    let text = fs::read_to_string(file)?;
    let head: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let order: Vec<usize> = names.split(',').map(|name| head.iter().position(|h| *h == name).unwrap()).collect();
    let rows = text.lines().enumerate().map(|(k, line)| {
        let cells: Vec<&str> = line.split(',').collect();
        if k == 0 { line.to_owned() } else { order.iter().map(|&c| cells[c]).collect::<Vec<_>>().join(",") }
    });
    fs::write(file, rows.collect::<Vec<_>>().join("\n") + "\n")
}

/// Divides the numbers of some columns of a CSV.
fn divided(file: &Path, names: &[&str], by: f64) -> std::io::Result<()> {
    let text = fs::read_to_string(file)?;
    let head: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let rows = text.lines().enumerate().map(|(k, line)| {
        let cells =
            line.split(',').zip(&head).map(|(cell, name)| match (k, names.contains(name), cell.parse::<i64>()) {
                (1.., true, Ok(whole)) if by > 1e6 => (whole / by as i64).to_string(),
                (1.., true, _) => (cell.parse::<f64>().unwrap() / by).to_string(),
                _ => cell.to_owned(),
            });
        cells.collect::<Vec<_>>().join(",")
    });
    fs::write(file, rows.collect::<Vec<_>>().join("\n") + "\n")
}

#[test]
fn each_mistake_of_a_newcomer_is_answered_by_its_cause_and_the_next_step() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().canonicalize().unwrap();
    copy_folder(&root().join("tests/data/folder"), &dir.join("data"));
    copy_folder(&root().join("tests/data/picks"), &dir.join("picks"));
    copy_folder(&root().join("graphs"), &dir.join("graphs"));
    let mut text = String::new();
    let (mut n_commands, mut no_mistakes) = (0, Vec::new());
    for line in MISTAKES.lines().filter(|line| !line.is_empty()) {
        if let Some(heading) = line.strip_prefix("# ") {
            let _ = writeln!(text, "=== {heading}\n");
            continue;
        }
        if let Some(preparation) = line.strip_prefix("~ ") {
            make(&dir, preparation);
            continue;
        }
        n_commands += 1;
        let output = osteoflow().args(line.split(' ')).current_dir(&dir).output().unwrap();
        // What is on stderr is read first.
        let answer = [&output.stderr, &output.stdout].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
        if output.status.success() && !line.starts_with("info ") && !answer.contains("doubtful") {
            no_mistakes.push(line);
        }
        let code = output.status.code().unwrap();
        let _ = writeln!(text, "$ osteoflow {line}\n{}[exit code {code}]\n", steady(&answer, &dir, MAX_LINES));
    }
    assert!(no_mistakes.is_empty(), "no mistakes: {no_mistakes:#?}\n{text}");
    assert!(n_commands >= 150, "{n_commands} mistakes");
    for word in ["panicked", "os error 2)\nerror", "thread '"] {
        assert!(!text.contains(word), "{word}:\n{text}");
    }
    assert_golden(&root().join("tests/golden/mistakes.txt"), &text);
}

/// Files with which an earlier version failed, made elsewhere, and what each is.
const OF_OTHERS: [&str; 10] = [
    "info text/bom.ply",
    "info text/decimal_comma_40_rows.csv",
    "info text/index_first.xyz",
    "info text/own_output.csv",
    "info text/string_field_array.vtk",
    "info study/dicom_scout_and_series",
    "info cup",
    "register text/string_field_array.vtk text/own_output.csv",
    "run stamps/stamp0.toml --out OUT/stamp0",
    "run stamps/dup_i.toml --out OUT/dup_i",
];

#[test]
fn files_that_others_made_are_read_or_refused_by_their_cause() {
    let Some(cases) = data("files_that_others_made_are_read_or_refused_by_their_cause", "../cases") else { return };
    let (cases, out) = (cases.canonicalize().unwrap(), tempfile::tempdir().unwrap());
    let at = out.path().display().to_string();
    let mut text = String::new();
    for line in OF_OTHERS {
        let words = line.split(' ').map(|word| word.replace("OUT", &at));
        let output = osteoflow().args(words).current_dir(&cases).output().unwrap();
        let answer = [&output.stderr, &output.stdout].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
        let answer = steady(&answer.replace(&at, "OUT"), &cases, MAX_LINES);
        let _ = writeln!(text, "$ osteoflow {line}\n{answer}[exit code {}]\n", output.status.code().unwrap());
    }
    assert_golden(&root().join("tests/golden/mistakes_of_others.txt"), &text);
}
