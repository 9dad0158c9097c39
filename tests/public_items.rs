//! The public items of the crates that are published, as text in tests/golden/public: a change of one is seen in the diff, and belongs into
//! CHANGELOG.md. Read from the sources, so that no compiler but the one of the workspace is needed; items that a macro makes are not
//! seen. What `cargo package` would publish.

mod source;

use crate::common::{assert_golden, root};
use source::Crate;
use std::process::Command;

/// The crates that are published, with their folders: each after those that it needs.
const PUBLISHED: [(&str, &str); 9] = [
    ("osteoflow-libm", "engine/libm"),
    ("osteoflow-verdict", "engine/verdict"),
    ("osteoflow-geometry", "nodes/bone/geometry"),
    ("osteoflow-algorithms", "nodes/bone/algorithms"),
    ("osteoflow-container", "engine/container"),
    ("osteoflow-node-macros", "engine/node/macros"),
    ("osteoflow-node", "engine/node"),
    ("osteoflow-runtime", "engine/runtime"),
    ("osteoflow-engine", "engine"),
];

#[test]
fn the_public_items_of_the_published_crates_are_those_that_were_read_last() {
    for (name, folder) in PUBLISHED {
        let items = Crate::read(&root().join(folder).join("src")).public_items();
        // One has symbols alone.
        assert!(items.len() >= 3 || name == "osteoflow-libm", "{name}: {items:?}");
        assert_golden(&root().join(format!("tests/golden/public/{name}.txt")), &(items.join("\n") + "\n"));
    }
}

#[test]
fn items_are_public_by_their_path_and_by_what_is_exported_again() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("lib.rs"),
        "mod inner; pub mod outer { pub fn seen(a: &[u8]) -> Option<u8> { None } fn unseen() {} } \
         pub use inner::{Thing, Other as Renamed}; pub use outer::*; #[doc(hidden)] pub fn hidden() {} \
         #[cfg(test)] pub mod tests { pub fn no() {} }",
    )
    .unwrap();
    std::fs::write(
        folder.path().join("inner.rs"),
        "#[derive(Debug, Clone)] pub struct Thing { pub a: f64, b: u8 } pub enum Other { One, Two(u8) } pub struct Unseen; \
         impl Thing { pub const N: usize = 3; pub fn new() -> Self { todo!() } fn private() {} } \
         impl std::fmt::Display for Thing { fn fmt(&self) {} } impl Unseen { pub fn f() {} }",
    )
    .unwrap();
    assert_eq!(
        Crate::read(folder.path()).public_items(),
        [
            "pub enum Renamed",
            "pub Renamed::One",
            "pub Renamed::Two(u8)",
            "pub fn outer::seen(a: &[u8]) -> Option<u8>",
            "pub fn seen(a: &[u8]) -> Option<u8>",
            "pub mod outer",
            "pub struct Thing",
            "#[derive(Debug, Clone)] Thing",
            "impl std::fmt::Display for Thing",
            "pub Thing::a: f64",
            "pub const Thing::N: usize",
            "pub fn Thing::new() -> Self",
        ]
        .map(String::from)
    );
}

/// What cargo says of packaging all published crates, without compiling them again.
fn package(arguments: &[&str]) -> (bool, String) {
    let mut command = Command::new(env!("CARGO"));
    command.args(["package", "--no-verify", "--allow-dirty", "--locked", "--offline"]).args(arguments);
    for (name, _) in PUBLISHED {
        command.args(["--package", name]);
    }
    let output = command.arg("--target-dir").arg(env!("CARGO_TARGET_TMPDIR")).current_dir(root()).output().unwrap();
    (output.status.success(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
}

#[test]
fn cargo_packages_the_published_crates_without_a_fault() {
    let (done, said) = package(&[]);
    assert!(done, "{said}");
    // Tests and benches are of the workspace, and cargo says so of each.
    let is_of_workspace = |line: &&str| line.contains("is not included in the published package");
    let warnings: Vec<_> =
        said.lines().filter(|line| line.contains("warning")).filter(|l| !is_of_workspace(l)).collect();
    assert!(warnings.is_empty(), "{warnings:#?}");
    for (name, folder) in PUBLISHED {
        let manifest: toml::Table =
            std::fs::read_to_string(root().join(folder).join("Cargo.toml")).unwrap().parse().unwrap();
        let about = manifest["package"].as_table().unwrap();
        for key in ["description", "readme", "keywords", "categories", "include"] {
            assert!(about.contains_key(key), "{name} states no {key}");
        }
        let readme = std::fs::read_to_string(root().join(folder).join("README.md")).unwrap();
        assert!(
            readme.starts_with(&format!("# {name}\n")) && readme.contains("not a medical device"),
            "{name}: README"
        );
        for licence in ["LICENSE-MIT", "LICENSE-APACHE"] {
            let theirs = std::fs::read(root().join(folder).join(licence)).unwrap();
            assert!(
                theirs == std::fs::read(root().join(licence)).unwrap(),
                "{name}: {licence} is a link to the workspace's"
            );
        }
    }
}

#[test]
fn a_package_holds_sources_examples_readme_and_licences_alone() {
    for (name, _) in PUBLISHED {
        let mut list = Command::new(env!("CARGO"));
        list.args(["package", "--list", "--allow-dirty", "--locked", "--offline", "--package", name]);
        let output = list.current_dir(root()).output().unwrap();
        let files = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && files.contains("src/lib.rs"), "{name}: {files}");
        let fixed = ["Cargo.toml", "Cargo.toml.orig", "Cargo.lock", ".cargo_vcs_info.json", "README.md", "build.rs"];
        let is_wanted = |file: &&str| {
            fixed.contains(file)
                || file.starts_with("LICENSE-")
                || (file.starts_with("src/") && file.ends_with(".rs"))
                || file.starts_with("include/")
                || file.starts_with("examples/")
        };
        let others: Vec<_> = files.lines().filter(|file| !is_wanted(file)).collect();
        assert!(others.is_empty(), "{name}: {others:?}");
    }
}

#[test]
fn all_crates_have_the_version_that_the_citation_and_the_changelog_name() {
    let version = env!("CARGO_PKG_VERSION");
    let text = |file: &str| std::fs::read_to_string(root().join(file)).unwrap();
    let manifest: toml::Table = text("Cargo.toml").parse().unwrap();
    let dependencies = manifest["workspace"]["dependencies"].as_table().unwrap();
    for (name, _) in PUBLISHED {
        assert_eq!(dependencies[name]["version"].as_str(), Some(version), "{name}");
    }
    assert!(text("CITATION.cff").contains(&format!("\nversion: {version}\n")));
    let changes = text("CHANGELOG.md");
    let first = changes.lines().find(|line| line.starts_with("## ") && *line != WHAT_STAYS).unwrap();
    assert!(first.starts_with(&format!("## {version}")), "CHANGELOG.md begins with {first}");
}

/// The heading of the table of promises.
const WHAT_STAYS: &str = "## What stays";

#[test]
fn each_promise_of_the_changelog_names_a_test_that_is_there() {
    let text = |file: &str| std::fs::read_to_string(root().join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
    let changes = text("CHANGELOG.md");
    let table = changes.split(WHAT_STAYS).nth(1).unwrap().split("\n## ").next().unwrap();
    let rows: Vec<&str> = table.lines().filter(|line| line.starts_with("| a ")).collect();
    assert_eq!(rows.len(), 6, "{rows:#?}");
    for row in rows {
        let tests = row.trim_end_matches(" |").rsplit(" | ").next().unwrap();
        for named in tests.split("; ") {
            let mut quoted = named.split('`').skip(1).step_by(2);
            let (file, test) = (quoted.next().unwrap(), quoted.next().unwrap());
            let text = text(file);
            let is_there = [format!("fn {test}()"), format!("def {test}(")].iter().any(|head| text.contains(head));
            assert!(is_there, "CHANGELOG.md names {test} of {file}");
        }
    }
}
