//! docs/project/dependencies.md lists the libraries that the workspace names, and no others; tests and Python package ask the program's
//! libraries for no further features.

use crate::{arrows::ARROWS, common::root};
use std::{collections::BTreeSet, fs, process::Command};

#[test]
fn each_dependency_has_its_reason_and_its_upkeep_on_one_page() {
    let manifest: toml::Table = fs::read_to_string(root().join("Cargo.toml")).unwrap().parse().unwrap();
    let named = manifest["workspace"]["dependencies"].as_table().unwrap().iter();
    let named = named.filter(|(_, entry)| entry.get("path").is_none());
    let named: BTreeSet<String> =
        named.map(|(name, entry)| entry.get("package").and_then(|p| p.as_str()).unwrap_or(name).into()).collect();
    let page = fs::read_to_string(root().join("docs/project/dependencies.md")).unwrap();
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.split('|').map(str::trim).collect())
        .collect();
    let listed: BTreeSet<String> = rows.iter().map(|row| row[1].trim_matches('`').into()).collect();
    assert_eq!(named, listed);
    for row in &rows {
        assert!(row.len() == 7 && row[2..6].iter().all(|cell| !cell.is_empty()), "{row:?}");
    }
    for row in rows.iter().filter(|row| row[3] != "most crates") {
        let said: BTreeSet<&str> = row[3].split(", ").collect();
        let [program, with_tests] = [false, true].map(|with_tests| users(row[1].trim_matches('`'), with_tests));
        let missing: Vec<_> = program.iter().filter(|name| !said.contains(name.as_str())).collect();
        let others: Vec<_> = said.iter().filter(|name| !with_tests.contains(**name)).collect();
        assert!(missing.is_empty() && others.is_empty(), "{row:?}: it lacks {missing:?}; {others:?} do not name it");
    }
}

/// The crates whose manifest names a library as a dependency, also of their tests where these are asked for.
fn users(library: &str, with_tests: bool) -> BTreeSet<String> {
    let names_it = |folder: &str| {
        let manifest = fs::read_to_string(root().join(folder).join("Cargo.toml")).unwrap();
        let tables = manifest.split("\n[").filter_map(|table| table.split_once(']'));
        let mut tables = tables.filter(|(name, _)| name.ends_with("dependencies") && !name.starts_with("workspace"));
        tables.any(|(name, table)| {
            let mut keys = table.lines().filter_map(|line| line.split(['.', ' ']).next());
            (with_tests || name != "dev-dependencies") && keys.any(|key| key == library)
        })
    };
    let crates = ARROWS.map(|(name, folder, _)| (name, folder)).into_iter().chain([("osteoflow", ".")]);
    crates
        .filter(|(_, folder)| names_it(folder))
        .map(|(name, _)| name.trim_start_matches("osteoflow-").into())
        .collect()
}

/// The libraries with their features that cargo compiles for a command.
fn compiled(arguments: &[&str]) -> BTreeSet<String> {
    let mut tree = Command::new(env!("CARGO"));
    tree.args(["tree", "--locked", "--offline", "--prefix", "none", "--no-dedupe", "--format", "{p} [{f}]"])
        .args(arguments);
    let output = tree.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
}

#[test]
fn no_library_of_the_program_is_compiled_a_second_time_for_the_tests_or_the_python_package() {
    let program = compiled(&["--edges", "normal,build"]);
    for (other, arguments) in [
        ("the tests", &["--workspace", "--edges", "normal,build,dev"][..]),
        ("the Python package", &["--package", "osteoflow-python", "--edges", "normal,build"]),
    ] {
        let other_tree = compiled(arguments);
        let twice: Vec<_> = program.difference(&other_tree).collect();
        assert!(
            twice.is_empty(),
            "with the dependencies of {other} these libraries have more features, so that they are compiled, and all that use \
             them, once more; state the features in Cargo.toml: {twice:#?}"
        );
    }
}
