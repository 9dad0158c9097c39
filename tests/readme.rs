//! README.md and .ci/run: both run the same two commands.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod common;

use std::{fs, path::Path, process::Command};

fn text(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

fn lines_that_begin<'a>(text: &'a str, with: &str) -> Vec<&'a str> {
    text.lines().filter(|line| line.starts_with(with)).collect()
}

#[test]
fn the_readme_has_each_of_its_two_commands_once() {
    let readme = text("README.md");
    assert_eq!(lines_that_begin(&readme, "cargo run "), ["cargo run --release -- run graphs/fibula.toml"]);
    assert_eq!(lines_that_begin(&readme, "cargo test "), ["cargo test --release --workspace"]);
}

/// The table of the ICP swap: kind, mean TRE in mm.
fn icp_swap_table() -> Vec<(String, f64)> {
    let readme = text("README.md");
    let rows = lines_that_begin(&readme, "| `icp.point_").into_iter().map(|row| {
        let cells: Vec<_> = row.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        (cells[1].to_owned(), cells[2].trim_end_matches(" mm").parse().unwrap())
    });
    rows.collect()
}

#[test]
fn the_numbers_of_the_icp_swap_are_those_of_this_program() {
    let table = icp_swap_table();
    assert_eq!(table.len(), 2, "{table:?}");
    for (kind, stated_mm) in table {
        let ran = common::run_whole("graphs/fibula.toml", &["--no-record", "--set", &format!("icp.kind={kind}")]);
        let found_mm = ran.results["metrics"]["tre_true_mm"]["mean_abs"]["norm"].as_f64().unwrap();
        // The README rounds to 0.01 mm; a change that moves results further is worth a new line there.
        assert!((found_mm - stated_mm).abs() < 0.02, "{kind}: README.md says {stated_mm} mm, it is {found_mm:.3} mm");
    }
}

#[test]
fn ci_takes_both_commands_from_the_readme_and_parses() {
    let script = text(".ci/run");
    assert!(script.contains("command_of_readme 'cargo test '") && script.contains("command_of_readme 'cargo run '"));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(".ci/run");
    let checked = Command::new("bash").arg("-n").arg(&path).output().unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
}

#[test]
fn links_in_the_documentation_point_to_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pages = vec![root.join("README.md"), root.join("CONTRIBUTING.md"), root.join("CHANGELOG.md")];
    let mut folders = vec![root.join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                pages.push(path);
            }
        }
    }
    let mut dead = Vec::new();
    for page in pages {
        let text = fs::read_to_string(&page).unwrap();
        for target in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let file = target.split('#').next().unwrap_or_default();
            let local = !target.contains("://") && !target.starts_with("mailto:") && !file.is_empty();
            if local && !page.parent().unwrap().join(file).exists() {
                dead.push(format!("{}: {target}", page.strip_prefix(root).unwrap().display()));
            }
        }
    }
    assert!(dead.is_empty(), "{dead:#?}");
}
