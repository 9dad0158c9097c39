//! docs/project/dependencies.md lists the libraries that the workspace names, and no others; tests and Python package ask the program's
//! libraries for no further features.

use std::{collections::BTreeSet, fs, path::Path, process::Command};

#[test]
fn each_dependency_has_its_reason_and_its_upkeep_on_one_page() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest: toml::Table = fs::read_to_string(root.join("Cargo.toml")).unwrap().parse().unwrap();
    let named = manifest["workspace"]["dependencies"].as_table().unwrap().iter();
    let named = named.filter(|(_, entry)| entry.get("path").is_none());
    let named: BTreeSet<String> =
        named.map(|(name, entry)| entry.get("package").and_then(|p| p.as_str()).unwrap_or(name).into()).collect();
    let page = fs::read_to_string(root.join("docs/project/dependencies.md")).unwrap();
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.split('|').map(str::trim).collect())
        .collect();
    let listed: BTreeSet<String> = rows.iter().map(|row| row[1].trim_matches('`').into()).collect();
    assert_eq!(named, listed);
    for row in rows {
        assert!(row.len() == 7 && row[2..6].iter().all(|cell| !cell.is_empty()), "{row:?}");
    }
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
