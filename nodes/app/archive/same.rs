//! Whether two runs or two sweeps are the same, and what differs.

use super::unpack::results;
use crate::app::error::UsageError;
use anyhow::{Context, Result};
use osteoflow_engine::{
    Provenance,
    hash::Digest,
    names::shortened,
    recording::digest::{DigestReport, digest},
    regular,
    run::files,
    sweep::{self, Column},
    temporary,
};
use serde::Serialize;
use serde_json::Value as Json;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

/// Most characters of a value that are listed.
const MAX_CHARACTERS: usize = 100;
/// Most differences of numbers that are listed.
const MAX_NUMBERS: usize = 20;

/// How two runs or two sweeps compare.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Sameness {
    /// The files that were compared, each with whether they are equal, byte for byte.
    pub files: Vec<(String, bool)>,
    /// The first values that differ, with their places.
    pub values: Vec<String>,
    /// Number of values that differ.
    pub n_values: usize,
    /// What differs of graph, inputs, plugins, packages, interpreter, program and machine.
    pub causes: Vec<String>,
    /// Differences that concern names alone.
    pub notes: Vec<String>,
}

impl Sameness {
    /// Whether all values are equal.
    pub fn is_equal(&self) -> bool {
        self.n_values == 0
    }

    fn differs(&mut self, what: String) {
        self.n_values += 1;
        if self.values.len() < MAX_NUMBERS {
            self.values.push(what);
        }
    }
}

/// Compares two folders or archives, both of runs or both of sweeps.
///
/// # Errors
/// One of them is neither, or cannot be read.
pub fn same(first: &Path, second: &Path) -> Result<Sameness> {
    let temporary = temporary::folder("compare").context("no temporary folder")?;
    let a = results(first, &temporary.path().join("1"))?;
    let b = results(second, &temporary.path().join("2"))?;
    let mut same = Sameness::default();
    match (a.join(sweep::DESIGN).is_file(), b.join(sweep::DESIGN).is_file()) {
        (true, true) => {
            let about = [json(&a.join(sweep::DESIGN))?, json(&b.join(sweep::DESIGN))?];
            let columns: Vec<Column> = serde_json::from_value(about[0]["sweep"]["columns"].clone()).unwrap_or_default();
            let times: Vec<_> = columns.into_iter().filter(Column::is_time).map(|column| column.name).collect();
            for table in [sweep::RUNS, sweep::POINTS] {
                tables(&a.join(table), &b.join(table), table, &times, &mut same)?;
            }
            same.causes = Provenance::of(&about[0]).differences(&Provenance::of(&about[1]), ["first", "second"]);
        }
        (false, false) => {
            let of = |dir: &Path, shown: &Path| {
                let manifest = dir.join(files::MANIFEST);
                json(&manifest).map_err(|_| {
                    UsageError(format!("{} is neither of a run nor of a sweep, nor an archive of one", shown.display()))
                })
            };
            let (about_a, about_b) = (of(&a, first)?, of(&b, second)?);
            runs(&a, &b, &mut same)?;
            same.causes = Provenance::of(&about_a).differences(&Provenance::of(&about_b), ["first", "second"]);
        }
        _ => return Err(UsageError("a run and a sweep cannot be compared with each other".into()).into()),
    }
    Ok(same)
}

fn json(path: &Path) -> Result<Json> {
    let text = regular(path).and_then(std::fs::read).with_context(|| format!("{} cannot be read", path.display()))?;
    serde_json::from_slice(&text).with_context(|| format!("{} is no JSON", path.display()))
}

/// Two tables, cell by cell, but for times.
fn tables(a: &Path, b: &Path, name: &str, times: &[String], same: &mut Sameness) -> Result<()> {
    let read = |path: &Path| {
        regular(path)
            .and_then(std::fs::read_to_string)
            .with_context(|| format!("{} cannot be read; is the sweep finished?", path.display()))
    };
    let (a, b) = (read(a)?, read(b)?);
    same.files.push((name.into(), a == b));
    if a == b {
        return Ok(());
    }
    let rows = |text: &str| -> Vec<Vec<String>> {
        let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(text.as_bytes());
        reader.records().map_while(Result::ok).map(|row| row.iter().map(str::to_owned).collect()).collect()
    };
    let (a, b) = (rows(&a), rows(&b));
    let head = a.first().cloned().unwrap_or_default();
    if b.first() != Some(&head) {
        same.differs(format!(
            "{name} has the columns {} and {}",
            head.join(", "),
            b.first().cloned().unwrap_or_default().join(", ")
        ));
        return Ok(());
    }
    if a.len() != b.len() {
        same.differs(format!("{name} has {} and {} rows", a.len() - 1, b.len() - 1));
    }
    let (mut n_named, mut n_times) = (0, 0);
    for (a, b) in a.iter().zip(&b).skip(1) {
        for ((column, x), y) in head.iter().zip(a).zip(b).filter(|((_, x), y)| x != y) {
            match is_renamed(x, y) {
                _ if times.contains(column) => n_times += 1,
                true => n_named += 1,
                false => same.differs(format!("{name}, run {}: {column} {x} and {y}{}", a[0], difference(x, y))),
            }
        }
    }
    if n_times > 0 {
        same.notes.push(format!("{n_times} cells of {name} are times, which differ each time"));
    }
    if n_named > 0 {
        same.notes.push(format!(
            "{n_named} cells of {name} name the same file in other folders, or another line of the graph"
        ));
    }
    Ok(())
}

/// A reason without the place in its graph file, which is another line of another file there.
fn without_place(text: &str) -> &str {
    match text.find(": node \"") {
        Some(at) if text[..at].contains(".toml:") => &text[at..],
        _ => text,
    }
}

/// Whether two texts are paths of a file of one name, or reasons at other places.
fn is_renamed(a: &str, b: &str) -> bool {
    if without_place(a) == without_place(b) {
        return true;
    }
    let name = |text: &str| Path::new(text).file_name().map(ToOwned::to_owned);
    (a.contains('/') || b.contains('/')) && name(a).is_some() && name(a) == name(b)
}

fn difference(a: &str, b: &str) -> String {
    match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => format!(" ({:+e})", b - a),
        _ => String::new(),
    }
}

fn runs(a: &Path, b: &Path, same: &mut Sameness) -> Result<()> {
    let read = |dir: &Path| {
        regular(dir.join(files::RESULTS))
            .and_then(std::fs::read)
            .with_context(|| format!("{} has no {}", dir.display(), files::RESULTS))
    };
    let (bytes_a, bytes_b) = (read(a)?, read(b)?);
    same.files.push((files::RESULTS.into(), bytes_a == bytes_b));
    if bytes_a != bytes_b {
        let values = |dir: &Path| json(&dir.join(files::RESULTS));
        values_of(&values(a)?, &values(b)?, "", same);
    }
    let recording = |dir: &Path| Some(dir.join(files::RECORDING)).filter(|path| path.is_file());
    if let (Some(a), Some(b)) = (recording(a), recording(b)) {
        recordings(&a, &b, same)?;
    }
    Ok(())
}

fn recordings(a: &Path, b: &Path, same: &mut Sameness) -> Result<()> {
    let (a, b) = (digest(a, &mut |_, _| {})?, digest(b, &mut |_, _| {})?);
    same.files.push((format!("{} (items)", files::RECORDING), a.digest == b.digest));
    if a.digest == b.digest {
        return Ok(());
    }
    let of = |report: &DigestReport| -> BTreeMap<String, Option<Digest>> {
        report.wires.iter().map(|wire| (wire.wire.clone(), wire.digest)).collect()
    };
    let (a, b) = (of(&a), of(&b));
    for wire in a.keys().chain(b.keys()).collect::<BTreeSet<_>>() {
        match (a.get(wire), b.get(wire)) {
            (Some(a), Some(b)) if a == b => {}
            (Some(_), Some(_)) => same.differs(format!("{}: wire {wire}", files::RECORDING)),
            _ => same.differs(format!("{}: wire {wire} is in one of them", files::RECORDING)),
        }
    }
    Ok(())
}

/// The values that differ, by their paths.
fn values_of(a: &Json, b: &Json, at: &str, same: &mut Sameness) {
    let below = |part: &str| if at.is_empty() { part.to_owned() } else { format!("{at}.{part}") };
    match (a, b) {
        (Json::Object(a), Json::Object(b)) => {
            let keys: BTreeSet<_> = a.keys().chain(b.keys()).collect();
            keys.into_iter().for_each(|key| {
                values_of(
                    &a.get(key).cloned().unwrap_or_default(),
                    &b.get(key).cloned().unwrap_or_default(),
                    &below(key),
                    same,
                )
            });
        }
        (Json::Array(a), Json::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().for_each(|(index, (a, b))| values_of(a, b, &below(&index.to_string()), same));
        }
        (Json::String(a), Json::String(b)) if a != b && is_renamed(a, b) => {
            same.notes.push(format!("{at} names the same file in another folder"))
        }
        (a, b) if a != b => {
            let (a, b) = (a.to_string(), b.to_string());
            let shortened = |text| shortened(text, MAX_CHARACTERS);
            same.differs(format!("{at}: {} and {}{}", shortened(&a), shortened(&b), difference(&a, &b)));
        }
        _ => {}
    }
}
