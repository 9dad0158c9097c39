//! The documentation as a site: it is built from these pages, and what is dead in it is a fault. Skipped where mdBook is not installed.

use crate::common::root;
use std::{
    fs,
    os::unix::fs::symlink,
    path::Path,
    process::{Command, Output},
};

/// Builds the site of a repository; `None` without mdBook, which the script would install.
fn build(repository: &Path, out: &Path, test: &str) -> Option<Output> {
    if !root().join("target/site-tools/bin/mdbook").is_file() {
        println!("skipped: {test}: no mdBook in target/site-tools; docs/site/build installs it");
        return None;
    }
    let output = Command::new(repository.join("docs/site/build")).arg("--out").arg(out).output();
    Some(output.expect("python3 runs docs/site/build"))
}

#[test]
fn the_site_has_all_pages_and_a_search_and_nothing_dead() {
    let out = tempfile::tempdir().unwrap();
    let test = "the_site_has_all_pages_and_a_search_and_nothing_dead";
    let Some(output) = build(root(), out.path(), test) else { return };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&[output.stdout, output.stderr].concat()));
    for page in ["index.html", "docs/begin/can-i-trust-it.html", "docs/nodes/icp.html", "docs/project/size.html"] {
        let text = fs::read_to_string(out.path().join(page)).unwrap();
        assert!(text.contains("<h1") && !text.contains("https://cdn"), "{page}");
    }
    let names = fs::read_dir(out.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert!(names.into_iter().any(|name| name.starts_with("searchindex")), "no search");
}

#[test]
fn a_dead_link_anchor_picture_or_path_and_a_page_out_of_the_index_fail_it() {
    let repository = tempfile::tempdir().unwrap();
    let at = repository.path();
    let ours = "target/site-tools";
    for folder in ["docs/site", "docs/begin", "target"] {
        fs::create_dir_all(at.join(folder)).unwrap();
    }
    fs::copy(root().join("docs/site/build"), at.join("docs/site/build")).unwrap();
    symlink(root().join(ours), at.join(ours)).unwrap();
    for (page, text) in [
        ("README.md", "# Top\n\n[The index](docs/README.md)\n"),
        ("docs/README.md", "# Index\n\n## Begin\n\n| | |\n|---|---|\n| [Words](begin/glossary.md) | words |\n"),
        ("docs/begin/glossary.md", "# Words\n\n**clearness**: a word. `docs/site/build` is there.\n"),
    ] {
        fs::write(at.join(page), text).unwrap();
    }
    assert!(Command::new("git").args(["init", "--quiet"]).current_dir(at).status().unwrap().success());
    let run = || build(at, &at.join("out"), "a_dead_link_anchor_picture_or_path_and_a_page_out_of_the_index_fail_it");
    let Some(output) = run() else { return };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&[output.stdout, output.stderr].concat()));

    let glossary = at.join("docs/begin/glossary.md");
    let text = fs::read_to_string(&glossary).unwrap();
    for (more, fault) in [
        ("[a](gone.md)", "docs/begin/glossary.md: the link gone.md leads nowhere"),
        ("[a](../../README.md#gone)", "leads to no heading"),
        ("![a](gone.png)", "the link gone.png leads nowhere"),
        ("`graphs/gone.toml`", "docs/begin/glossary.md:5: there is no graphs/gone.toml"),
    ] {
        fs::write(&glossary, format!("{text}\n{more}\n")).unwrap();
        let output = run().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && stderr.contains(fault), "{more}: {stderr}");
    }
    fs::write(&glossary, text).unwrap();
    fs::write(glossary.with_file_name("alone.md"), "# Alone\n").unwrap();
    let stderr = String::from_utf8(run().unwrap().stderr).unwrap();
    assert!(stderr.contains("alone.md: it is not in the index"), "{stderr}");
}
