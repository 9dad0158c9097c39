//! Provenance: program, machine, inputs with their licences, and the command that repeats the run.

use crate::{cell::Cell, format::shell_word, html::Page};
use serde_json::Value as Json;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// A folder as it was named, or without the folders above it, whose names are nobody's business.
pub(crate) fn folder_name(dir: &Path) -> String {
    let name = dir.file_name().filter(|_| dir.is_absolute());
    name.map_or_else(|| dir.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// The provenance of a run, from its manifest.
pub(crate) fn of_run(page: &mut Page, dir: &Path, manifest: &Json) {
    let keys = ["began", "ended", "workers"].map(|key| row(key, word(&manifest[key])));
    page.table("Provenance of this run.", &HEADS, &rows(dir, manifest, keys));
    again(page, &manifest["command"]);
    let base = Path::new(manifest["graph"]["file"].as_str().unwrap_or_default()).parent().unwrap_or(Path::new(""));
    inputs(page, base, &manifest["inputs"], &manifest["plugins"]);
    if let Some(graph) = manifest["resolved_graph"].as_str() {
        page.folded("The graph as it ran, with every default", graph);
    }
}

/// The provenance of a sweep, from its `sweep.json`.
pub(crate) fn of_sweep(page: &mut Page, dir: &Path, about: &Json) {
    let hash = row("hash of everything that determines the tables", word(&about["hash"]));
    let mut rows = rows(dir, about, [hash, row("runs", word(&about["n_runs"]))]);
    if let Some([began, ended]) = dates(dir) {
        rows.push(row("began, by the time of sweep.json", began));
        rows.push(row("latest table, by the time of summary.json", ended));
    }
    page.table("Provenance of this sweep.", &HEADS, &rows);
    again(page, &about["command"]);
    inputs(page, Path::new(""), &about["inputs"], &about["plugins"]);
    if let Ok(graph) = osteoflow_engine::regular(dir.join(osteoflow_engine::sweep::GRAPH)).and_then(fs::read_to_string)
    {
        page.folded("The frozen graph (sweep.toml), without the settings of any run", &graph);
    }
}

/// When a sweep began and when its summary was written, by the times of its files: what determines the tables has no time.
pub(crate) fn dates(dir: &Path) -> Option<[String; 2]> {
    let time = |name: &str| fs::metadata(dir.join(name)).ok()?.modified().ok();
    let (began, ended) = (time(osteoflow_engine::sweep::DESIGN)?, time(crate::summary::SUMMARY)?);
    let shown = |time| jiff::Timestamp::try_from(time).ok().map(minute);
    Some([shown(began)?, shown(ended)?])
}

/// A time of a manifest as people write it; as it is where it is none.
pub(crate) fn date(of_manifest: &str) -> String {
    of_manifest.parse().map_or_else(|_| of_manifest.to_owned(), minute)
}

fn minute(time: jiff::Timestamp) -> String {
    time.strftime("%Y-%m-%d %H:%M UTC").to_string()
}

const HEADS: [&str; 2] = ["what", "value"];

/// Rows about the graph, what is `own` to a run or a sweep, the program and the folder.
fn rows<const N: usize>(dir: &Path, about: &Json, own: [Vec<Cell>; N]) -> Vec<Vec<Cell>> {
    let graph =
        ["name", "file", "seed"].map(|key| row(if key == "name" { "graph" } else { key }, word(&about["graph"][key])));
    let program = program(&about["command"]);
    graph.into_iter().chain(own).chain(program).chain([row("folder", folder_name(dir))]).collect()
}

/// Rows about the program and the machine.
fn program(command: &Json) -> Vec<Vec<Cell>> {
    let words = |keys: &[&str]| {
        let words = keys.iter().map(|key| word(&command[*key])).filter(|word| !word.is_empty());
        words.collect::<Vec<_>>().join(", ")
    };
    vec![
        row("program", format!("{} {}", word(&command["name"]), word(&command["version"]))),
        row("git revision", word(&command["git_revision"])),
        row("compiler", words(&["compiler", "target", "profile"])),
        row("machine", words(&["os", "architecture"])),
        row("processor", format!("{} cores, {}", word(&command["cpus"]), word(&command["cpu_features"]))),
    ]
}

fn again(page: &mut Page, command: &Json) {
    let Some(arguments) = command["arguments"].as_array() else { return };
    let words: Vec<_> = arguments.iter().filter_map(Json::as_str).map(shell_word).collect();
    page.text("The command that made it; in another folder it gives the same numbers:");
    page.code(&format!("osteoflow {}", words.join(" ")));
}

/// A table of inputs and plugins with their hashes and licences; relative paths are those of the graph's folder `base`.
fn inputs(page: &mut Page, base: &Path, inputs: &Json, plugins: &Json) {
    let inputs = inputs.as_array().into_iter().flatten().map(|input| [&input["path"], &input["sha256"]].map(word));
    let rows: Vec<_> = inputs
        .map(|[path, hash]| vec![Cell::Code(path.clone()), Cell::Code(hash), Cell::word(licence(&base.join(&path)))])
        .chain(plugins.as_array().into_iter().flatten().map(|plugin| {
            let hash = word(&plugin["sha256"]);
            vec![
                Cell::Code(word(&plugin["path"])),
                Cell::Code(hash),
                Cell::word(format!("plugin {}", word(&plugin["version"]))),
            ]
        }))
        .collect();
    if rows.is_empty() {
        return page.text(
            "No input file was read. The simulated data come from formulas of this program, without any measured data, \
             and its licence is the program's (MIT or Apache-2.0).",
        );
    }
    let head = ["file", "SHA-256", "licence, according to a file in its folder or above"];
    page.table("Input files and plugins.", &head, &rows);
}

/// Number of folders above an input that are searched for a README or a licence file.
const FOLDERS_UP: usize = 2;

/// The licence of an input. In this order: the first line of `FILE.license`; a line of a README or licence file that names
/// the file, in its folder or up to two above; the first line of a licence file in its folder, or the line of the README there
/// that mentions a licence; a line further up that names its folder.
fn licence(path: &Path) -> String {
    // The folders above a relative path are found from the working directory.
    let path = &fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let Some(folder) = path.parent() else { return String::new() };
    let mut own = path.as_os_str().to_owned();
    own.push(".license");
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (file, inside) = (name(path), format!("{}/", name(folder)));
    let above = || folder.ancestors().take(1 + FOLDERS_UP).flat_map(about);
    let speaks = |line: &str| ["licen", "LICEN", "CC BY", "CC0"].iter().any(|word| line.contains(word));
    first(&PathBuf::from(own), &|_| true)
        .or_else(|| above().find_map(|path| first(&path, &|line| names(line, &file))))
        .or_else(|| about(folder).iter().filter(|path| !is_readme(path)).find_map(|path| first(path, &|_| true)))
        .or_else(|| about(folder).iter().filter(|path| is_readme(path)).find_map(|path| first(path, &speaks)))
        .or_else(|| above().find_map(|path| first(&path, &|line| line.contains(&inside) && speaks(line))))
        .unwrap_or_else(|| "not stated by any file in its folder or up to two folders above; ask its provider".into())
}

/// Whether a line names this file, rather than one whose name ends the same.
fn names(line: &str, file: &str) -> bool {
    line.match_indices(file).any(|(at, _)| {
        let part = |c: char| c.is_alphanumeric() || "_-.".contains(c);
        !line[..at].ends_with(part) && !line[at + file.len()..].starts_with(|c: char| c.is_alphanumeric() || c == '_')
    })
}

/// The licence files of a folder, then its READMEs.
fn about(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let starts = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        name.starts_with("LICEN") || is_readme(path)
    };
    let mut files: Vec<_> = entries.filter(|path| starts(path) && path.is_file()).collect();
    files.sort();
    files
}

fn is_readme(path: &Path) -> bool {
    path.file_name().unwrap_or_default().to_string_lossy().to_uppercase().starts_with("README")
}

/// The first line of a file that satisfies `wanted`, with the file's name.
fn first(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Option<String> {
    let text = osteoflow_engine::regular(path).and_then(fs::read_to_string).ok()?;
    let lines = text.lines().map(|line| line.trim_matches([' ', '#', '|', '*', '\t']));
    let line = lines.filter(|line| !line.is_empty()).find(|line| wanted(line))?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let whole: String = line.chars().take(MAX_CHARACTERS).collect();
    let cut = if whole.len() < line.len() { "\u{2026}" } else { "" };
    Some(format!("{name}: {whole}{cut}"))
}

/// Longer lines are truncated.
const MAX_CHARACTERS: usize = 400;

fn row(what: &str, value: String) -> Vec<Cell> {
    vec![Cell::word(what), Cell::word(if value.is_empty() { "not known".into() } else { value })]
}

/// A value as text; empty for null.
fn word(value: &Json) -> String {
    match value {
        Json::Null => String::new(),
        Json::String(text) => text.clone(),
        Json::Array(items) => items.iter().map(word).collect::<Vec<_>>().join(", "),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_licence_is_found_up_to_two_folders_above_in_the_line_that_names_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("data/bones");
        fs::create_dir_all(&folder).unwrap();
        let bone = folder.join("fibula.stl");
        fs::write(&bone, "").unwrap();
        assert!(licence(&bone).contains("ask its provider"));
        fs::write(
            dir.path().join("README.md"),
            "| bones/left_fibula.stl | CC0 |\n| bones/fibula.stl | CC BY-NC 4.0 |\n",
        )
        .unwrap();
        assert_eq!(licence(&bone), "README.md: bones/fibula.stl | CC BY-NC 4.0");
        fs::write(folder.join("LICENSE"), "\nApache License\n").unwrap();
        assert_eq!(
            licence(&bone),
            "README.md: bones/fibula.stl | CC BY-NC 4.0",
            "a line with the name of the file comes first"
        );
        fs::write(folder.join("fibula.stl.license"), "CC0\n").unwrap();
        assert_eq!(licence(&bone), "fibula.stl.license: CC0");
        assert_eq!(licence(&folder.join("other.stl")), "LICENSE: Apache License");
    }
}
