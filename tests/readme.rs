//! README.md and .ci/run: both run the same two commands. The pages of docs/: what links to them, and what they list.

use crate::common::root;
use std::{fs, path::PathBuf, process::Command};

fn text(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap()
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

/// Poses that are right, those of them that are trusted, mirrored poses, and those of them that are trusted, in a table of
/// docs/method/real-data.md.
fn counts(table: &str) -> [u64; 4] {
    let page = text("docs/method/real-data.md");
    let rows = page.split(&format!("<!-- {table} -->")).nth(1).unwrap().split("<!-- end -->").next().unwrap().lines();
    let mut counts = [0; 4];
    for row in rows.filter(|row| row.starts_with("| ") && !row.starts_with("| Pair")) {
        let cells: Vec<_> = row.split('|').map(str::trim).collect();
        let number = |k: usize| cells[k].parse::<u64>().unwrap();
        if cells[1].contains("mirrored") {
            counts[2] += number(3);
            counts[3] += number(9);
        } else {
            assert_eq!(number(3), number(4), "README.md says that all are right: {row}");
            counts[0] += number(4);
            counts[1] += number(5);
        }
    }
    counts
}

#[test]
fn what_the_readme_says_of_measured_data_is_what_the_page_of_them_counts() {
    let readme = text("README.md");
    let (hips, ranges) = (counts("hips"), counts("ranges"));
    let [right, trusted, ..] = ranges;
    assert_eq!(
        (hips[1], hips[3] + ranges[3]),
        (0, 0),
        "the README says that all are doubtful, and no mirrored one trusted"
    );
    for said in [
        format!("{0} of {0} poses right (within 4 mm and 5 degrees), all doubtful", hips[0]),
        format!("{right} of {right} right (within 1.5 mm), {trusted} of them trusted"),
        format!("of {} mirrored ones none trusted", hips[2] + ranges[2]),
    ] {
        assert!(readme.contains(&said), "README.md does not say: {said}");
    }
}

#[test]
fn ci_takes_both_commands_from_the_readme_and_parses() {
    let script = text(".ci/run");
    assert!(script.contains("command_of_readme 'cargo test '") && script.contains("command_of_readme 'cargo run '"));
    let path = root().join(".ci/run");
    let checked = Command::new("bash").arg("-n").arg(&path).output().unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
}

/// Files below the folders whose name ends so, without build folders.
fn files_below(folders: &[&str], ends: &[&str]) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = folders.iter().map(|folder| root().join(folder)).collect();
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                if !["target", "node_modules"].iter().any(|built| path.ends_with(built)) {
                    folders.push(path);
                }
            } else if ends.iter().any(|end| path.to_string_lossy().ends_with(end)) {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// The pages for people: docs/ and the five beside it.
fn pages() -> Vec<PathBuf> {
    let beside = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "nodes/python/README.md"];
    beside.into_iter().map(|page| root().join(page)).chain(files_below(&["docs"], &[".md"])).collect()
}

/// The lines of a page outside of its blocks of code.
fn prose(page: &str) -> String {
    let mut is_code = false;
    let outside = page.lines().filter(|line| {
        let fence = line.trim_start().starts_with("```");
        is_code ^= fence;
        !is_code && !fence
    });
    outside.collect::<Vec<_>>().join("\n")
}

/// The targets of the links of a text.
fn targets(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split(')').next())
}

/// The anchors of a page: its headings in lower case, without punctuation, with `-` for spaces, as GitHub makes them.
fn anchors(page: &str) -> Vec<String> {
    let headings = prose(page);
    let headings =
        headings.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let kept = |c: &char| c.is_alphanumeric() || " -_".contains(*c);
    headings.map(|heading| heading.to_lowercase().chars().filter(kept).collect::<String>().replace(' ', "-")).collect()
}

#[test]
fn links_in_the_documentation_point_to_files_and_headings() {
    let mut dead = Vec::new();
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        for target in targets(&prose(&text)) {
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            let to = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            let is_there = match to.extension().is_some_and(|end| end == "md") && !anchor.is_empty() {
                true => fs::read_to_string(&to).is_ok_and(|text| anchors(&text).iter().any(|a| a == anchor)),
                false => to.exists(),
            };
            if !is_there {
                dead.push(format!("{}: {target}", page.strip_prefix(root()).unwrap().display()));
            }
        }
    }
    assert!(dead.is_empty(), "{dead:#?}");
}

#[test]
fn pages_that_code_and_messages_name_are_there() {
    let ends = [".rs", ".py", ".h", ".hpp", ".c", ".cpp", ".js", ".toml", ".json", ".md", ".ipynb"];
    let mut missing = Vec::new();
    let mut n_named = 0;
    for file in files_below(&["engine", "nodes", "graphs", "tests", ".cargo"], &ends) {
        let Ok(text) = fs::read_to_string(&file) else { continue };
        for (at, _) in text.match_indices("docs/") {
            let name = text[at..].split(|c: char| !(c.is_ascii_alphanumeric() || "/-_.".contains(c))).next().unwrap();
            if let Some(page) = name.find(".md").map(|end| &name[..end + 3]) {
                n_named += 1;
                if !root().join(page).exists() {
                    missing.push(format!("{}: {page}", file.strip_prefix(root()).unwrap().display()));
                }
            }
        }
    }
    assert!(n_named > 30, "{n_named} names of pages");
    assert!(missing.is_empty(), "{missing:#?}");
}

#[test]
fn files_that_the_documentation_names_are_there() {
    let folders = ["engine/", "nodes/", "graphs/", "tests/", "docs/", ".ci/", ".github/"];
    // Of the folder of a plugin, as `osteoflow new plugin` writes it.
    let of_a_plugin = ["graphs/study.toml"];
    let (mut n_named, mut missing) = (0, Vec::new());
    // The changelog and superseded decisions speak of what was there.
    for page in pages().iter().filter(|page| !page.ends_with("CHANGELOG.md")) {
        let text = prose(&fs::read_to_string(page).unwrap());
        for name in text.split('`').filter(|_| !text.contains("\n**Superseded** by")) {
            let is_path = |c: char| c.is_ascii_alphanumeric() || "/-_.".contains(c);
            if !folders.iter().any(|folder| name.starts_with(folder)) || !name.chars().all(is_path) {
                continue;
            }
            n_named += 1;
            if !root().join(name).exists() && !of_a_plugin.contains(&name) {
                missing.push(format!("{}: {name}", page.strip_prefix(root()).unwrap().display()));
            }
        }
    }
    assert!(n_named > 200, "{n_named} names of files");
    assert!(missing.is_empty(), "{missing:#?}");
}

#[test]
fn every_page_is_in_the_table_of_its_group() {
    let index = text("docs/README.md");
    let listed: Vec<_> = targets(&index).map(|target| root().join("docs").join(target)).collect();
    let beside = ["docs/README.md", "docs/nodes", "docs/decisions"].map(|name| root().join(name));
    for page in files_below(&["docs"], &[".md"]).iter().filter(|page| !beside.iter().any(|b| page.starts_with(b))) {
        let n_rows = listed.iter().filter(|target| *target == page).count();
        assert_eq!(n_rows, 1, "docs/README.md lists {} so often", page.display());
    }
}

#[test]
fn each_decision_is_listed_with_its_title_and_its_successor() {
    let index = text("docs/decisions/README.md");
    let rows: Vec<Vec<&str>> =
        lines_that_begin(&index, "| [0").iter().map(|row| row.split(" | ").map(str::trim).collect()).collect();
    let pages = files_below(&["docs/decisions"], &[".md"]);
    let pages: Vec<_> = pages.iter().filter(|page| !page.ends_with("README.md")).collect();
    assert_eq!(rows.len(), pages.len(), "rows and pages");
    for ((page, row), number) in pages.into_iter().zip(rows).zip(1..) {
        let file = page.file_name().unwrap().to_str().unwrap();
        let text = fs::read_to_string(page).unwrap();
        let mut lines = text.lines();
        let title = lines.next().unwrap().strip_prefix(&format!("# {number}. "));
        let title = title.unwrap_or_else(|| panic!("{file} begins with \"# {number}. \" and its title"));
        assert_eq!(row[0], format!("| [{number:04}]({file})"), "the index is in order");
        assert_eq!(row[1], title, "{file}");
        // What is superseded says so at the top, and names a later page, as does the index.
        let status = lines.nth(1).unwrap_or_default();
        let successor = targets(status).next().filter(|_| status.starts_with("**Superseded")).unwrap_or_default();
        assert_eq!(targets(row[2]).next().unwrap_or_default(), successor, "{file}: its successor in the index");
        assert_eq!(text.matches("uperseded").count(), usize::from(!successor.is_empty()), "{file} names its successor");
        assert!(successor.is_empty() || page.with_file_name(successor).exists(), "{file}: {successor} is no page");
        assert!(successor.is_empty() || successor > file, "{file}: a successor is later than {successor}");
        assert_eq!(row[2].contains("in part"), status.contains("in part**"), "{file}: the whole, or a part");
    }
}
