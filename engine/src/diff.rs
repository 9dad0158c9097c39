//! Compares two recordings: the first divergence, and a summary for each wire.
//!
//! Wires come in the topological order of the graph in the first recording, items by number. Two recordings are equal
//! if their wires hold the same bits under the same numbers; order and compression in the files, and records of the
//! run, do not matter.

mod compare;
mod numbers;
mod order;

pub use compare::{Difference, Largest};

use crate::{
    graph::difference,
    names::glob,
    recording::provenance::Provenance,
    recording::{
        RecordingError, codec,
        format::Outcome,
        index::{Index, IndexEntry, Indexed},
    },
};
use compare::{Compare, ItemDifference, Units};
use osteoflow_container::Progress;
use serde::Serialize;
use std::{cmp::Ordering, collections::BTreeSet, path::Path};

/// The entries in which two graphs differ, as texts of graph files: each with its key as of `--set`, and its value as TOML in either;
/// a table that only one of them has is an empty text.
pub fn entries_that_differ(a: &str, b: &str) -> Vec<(String, [Option<String>; 2])> {
    let key = |table: &str, key: &str| {
        let table = table.trim_matches(['[', ']']);
        let table = table.strip_prefix("node.").unwrap_or(table);
        [table, key].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(".")
    };
    let entries = difference::differences(a, b).into_iter();
    entries.map(|entry| (key(&entry.table, &entry.key), entry.values)).collect()
}

/// Which wires to compare, and the tolerance.
#[derive(Debug, Clone, Default)]
pub struct DiffOptions {
    /// Patterns of wires, with `*` and `?`; empty for all wires.
    pub wires: Vec<String>,
    /// Numbers that differ by at most this, each in its own unit, count as equal.
    pub tolerance: f64,
}

/// Properties of one recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Side {
    /// Name of the graph; `None` if the recording lacks it.
    pub graph: Option<String>,
    /// The run's seed.
    pub seed: Option<u64>,
    /// The version of the program that wrote it.
    pub version: Option<String>,
    /// Why it may lack items.
    pub incomplete: Option<String>,
}

/// The first divergence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Divergence {
    /// The wire.
    pub wire: String,
    /// The item's number.
    pub item: u64,
    /// First difference of the item.
    pub what: Difference,
}

/// Comparison of a wire.
#[derive(Debug, Clone, PartialEq)]
pub struct WireDiff {
    /// `node.port`.
    pub wire: String,
    /// `payload@version` in each recording.
    pub payloads: [String; 2],
    /// Number of items in each recording.
    pub n_items: [u64; 2],
    /// Whether each recording has the wire at all.
    pub present: [bool; 2],
    /// Number of items in both that differ by more than the tolerance.
    pub n_differ: u64,
    /// Number of items in both that differ by no more than the tolerance.
    pub n_within: u64,
    /// Number of items that only the first or only the second recording has.
    pub n_only: [u64; 2],
    /// Number of items whose stamps differ.
    pub n_stamps: u64,
    /// Number of items that are a value in one recording and an empty in the other, or empties with different reasons.
    pub n_empties: u64,
    /// The largest differences of numbers.
    pub largest: Largest,
    /// First item that differs, and its first difference.
    pub first: Option<(u64, Difference)>,
}

impl WireDiff {
    /// Whether nothing differs by more than the tolerance, including that both recordings have the wire. A wire without
    /// items is ignored.
    pub fn is_equal(&self) -> bool {
        self.first.is_none()
    }
}

/// Report of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct DiffReport {
    /// Properties of each recording.
    pub sides: [Side; 2],
    /// What differs in what made them, in words: graph, seed, program, plugins, input files.
    pub made: Vec<String>,
    /// Whether the graphs are the same text.
    pub same_graph: Option<bool>,
    /// Whether the results are the same; `None` if a recording has none.
    pub same_results: Option<bool>,
    /// The first divergence.
    pub first: Option<Divergence>,
    /// The wires, in the topological order of the graph.
    pub wires: Vec<WireDiff>,
    /// Size of both files in bytes.
    pub n_bytes: u64,
}

impl DiffReport {
    /// Whether nothing that was compared differs by more than the tolerance.
    pub fn is_equal(&self) -> bool {
        self.wires.iter().all(WireDiff::is_equal)
    }
}

/// First difference of any bit between the messages of two items; `units` are those of the payload's fields and columns.
pub(crate) fn first_difference(a: &[u8], b: &[u8], units: &[(&str, &str)]) -> Option<Difference> {
    compare_messages(a, b, &Units::given(units), 0.0).first
}

/// Compares two recordings. Memory: an index of both, and some decompressed chunks.
///
/// # Errors
/// [`RecordingError`] if a recording cannot be read, has no exact channel, or has a number twice.
pub fn diff(a: &Path, b: &Path, options: &DiffOptions, progress: Progress<'_>) -> Result<DiffReport, RecordingError> {
    let n_b = std::fs::metadata(b).map_or(0, |m| m.len());
    let mut a = Index::of(a, &mut |at, of| progress(at, of + n_b))?.without_doubles()?;
    let n_a = a.n_bytes();
    let mut b = Index::of(b, &mut |at, of| progress(n_a + at, n_a + of))?.without_doubles()?;
    let wires = compared(&a, &b, options);
    let mut diffs: Vec<WireDiff> = wires.iter().map(|wire| missing(wire, &a, &b)).collect();
    let mut pairs = Vec::new();
    for (index, wire) in wires.iter().enumerate() {
        if let (Some(x), Some(y)) = (a.wires.get(wire), b.wires.get(wire)) {
            pairs.extend(differing(x, y).map(|(x, y)| (index, x, y)));
        }
    }
    // In the order of the first file, so that each of its chunks is decompressed once.
    pairs.sort_by_key(|(_, x, _)| x.place);
    let units: Vec<Units> = wires.iter().map(|wire| a.wires.get(wire).map_or_else(Units::default, units_of)).collect();
    for (index, x, y) in pairs {
        let differences = compare_messages(&a.message(&x)?, &b.message(&y)?, &units[index], options.tolerance);
        diffs[index].add(x.number, differences);
    }
    let first = diffs.iter().find_map(|diff| {
        let (item, what) = diff.first.clone()?;
        Some(Divergence { wire: diff.wire.clone(), item, what })
    });
    let both = |get: fn(&Index) -> Option<String>| Some((get(&a)?, get(&b)?));
    let mut made = match (&a.run, &b.run) {
        (Some(of_a), Some(of_b)) => {
            let name = (of_a.name != of_b.name).then(|| format!("graph: A {}, B {}", of_a.name, of_b.name));
            name.into_iter().chain(difference::in_words(&of_a.graph, &of_b.graph, ["A", "B"])).collect()
        }
        _ => Vec::new(),
    };
    let [of_a, of_b] = [&a, &b].map(|index| Provenance::of_recording(&index.metadata).unwrap_or_default());
    made.extend(of_a.differences(&of_b, ["A", "B"]));
    Ok(DiffReport {
        same_graph: both(|i| Some(i.run.as_ref()?.graph.clone())).map(|(a, b)| a == b),
        same_results: both(|i| Some(i.metadata.sound::<Outcome>()?.results.to_string())).map(|(a, b)| a == b),
        made,
        sides: [side(&a), side(&b)],
        first,
        wires: diffs,
        n_bytes: a.n_bytes() + b.n_bytes(),
    })
}

fn side(index: &Index) -> Side {
    let run = index.run.as_ref();
    Side {
        graph: run.map(|run| run.name.clone()),
        seed: run.map(|run| run.seed),
        version: run.map(|run| run.version.clone()),
        incomplete: index.incomplete(),
    }
}

fn units_of(wire: &Indexed) -> Units {
    Units::of(&wire.about.header.units)
}

/// Wires to compare, in the topological order of the first recording's graph.
fn compared(a: &Index, b: &Index, options: &DiffOptions) -> Vec<String> {
    let graph = a.run.as_ref().or(b.run.as_ref()).map_or("", |run| run.graph.as_str());
    let ranks = order::ranks(graph);
    let names: BTreeSet<&String> = a.wires.keys().chain(b.wires.keys()).collect();
    let wanted = |name: &str| options.wires.is_empty() || options.wires.iter().any(|p| glob::fits(p, name));
    let mut names: Vec<_> = names.into_iter().filter(|name| wanted(name)).cloned().collect();
    names.sort_by_key(|name| (ranks.get(order::node_of(name)).copied().unwrap_or(usize::MAX), name.clone()));
    names
}

/// Merges both lists by number: items in both, or in one.
fn merged<'a>(
    a: &'a [IndexEntry],
    b: &'a [IndexEntry],
) -> impl Iterator<Item = (Option<&'a IndexEntry>, Option<&'a IndexEntry>)> {
    let (mut i, mut j) = (0, 0);
    std::iter::from_fn(move || {
        let (x, y) = (a.get(i), b.get(j));
        let order = match (x, y) {
            (Some(x), Some(y)) => x.number.cmp(&y.number),
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (None, None) => return None,
        };
        i += usize::from(order.is_le());
        j += usize::from(order.is_ge());
        Some((x.filter(|_| order.is_le()), y.filter(|_| order.is_ge())))
    })
}

fn differing<'a>(a: &'a Indexed, b: &'a Indexed) -> impl Iterator<Item = (IndexEntry, IndexEntry)> + 'a {
    let both = merged(&a.entries, &b.entries).filter_map(|(x, y)| Some((*x?, *y?)));
    both.filter(|(x, y)| x.digest != y.digest)
}

/// Compares numbers of items and payloads of a wire.
fn missing(wire: &str, a: &Index, b: &Index) -> WireDiff {
    let (x, y) = (a.wires.get(wire), b.wires.get(wire));
    let payload = |wire: Option<&Indexed>| {
        wire.map_or("none".into(), |wire| format!("{}@{}", wire.about.header.payload, wire.about.header.version))
    };
    let entries = |wire: Option<&'_ Indexed>| wire.map_or(&[] as &[IndexEntry], |wire| &wire.entries).to_vec();
    let (of_a, of_b) = (entries(x), entries(y));
    let mut diff = WireDiff {
        wire: wire.into(),
        payloads: [payload(x), payload(y)],
        n_items: [of_a.len() as u64, of_b.len() as u64],
        present: [x.is_some(), y.is_some()],
        n_differ: 0,
        n_within: 0,
        n_only: [0, 0],
        n_stamps: 0,
        n_empties: 0,
        largest: Largest::default(),
        first: None,
    };
    for (x, y) in merged(&of_a, &of_b) {
        let (number, side) = match (x, y) {
            (Some(x), None) => (x.number, 0),
            (None, Some(y)) => (y.number, 1),
            _ => continue,
        };
        diff.n_only[side] += 1;
        let presence = |there: bool| if there { "an item" } else { "none" };
        diff.keep_first(number, Difference::other("presence", presence(side == 0), presence(side == 1)));
    }
    let lowest = of_a.iter().chain(&of_b).map(|entry| entry.number).min();
    if let Some(number) = lowest.filter(|_| x.is_some() && y.is_some() && diff.payloads[0] != diff.payloads[1]) {
        let [a, b] = diff.payloads.clone();
        diff.keep_first(number, Difference::other("payload", a, b));
    }
    diff
}

/// Compares the messages of two items with the same number.
fn compare_messages(x: &[u8], y: &[u8], units: &Units, tolerance: f64) -> ItemDifference {
    let damaged =
        |item: Result<_, codec::CodecError>| item.map_or_else(|error| error.to_string(), |_| "an item".into());
    let mut differences = match (codec::decode(x), codec::decode(y)) {
        (Ok(x), Ok(y)) => Compare::items(&x, &y, units, tolerance),
        (x, y) => {
            let first = Some(Difference::other("message", damaged(x), damaged(y)));
            ItemDifference { first, other: true, ..ItemDifference::default() }
        }
    };
    // Bits without a meaning, such as padding, count as a difference too.
    if differences.first.is_none() && differences.n_numbers == 0 {
        let at = x.iter().zip(y).position(|(x, y)| x != y).unwrap_or_else(|| x.len().min(y.len()));
        differences.other = true;
        differences.first = Some(Difference::other(format!("byte {at} of the message"), byte(x, at), byte(y, at)));
    }
    differences
}

fn byte(message: &[u8], at: usize) -> String {
    message.get(at).map_or("none".into(), |byte| format!("{byte:#04x}"))
}

impl WireDiff {
    fn keep_first(&mut self, number: u64, what: Difference) {
        if self.first.as_ref().is_none_or(|(first, _)| number < *first) {
            self.first = Some((number, what));
        }
    }

    fn add(&mut self, number: u64, differences: ItemDifference) {
        self.n_stamps += u64::from(differences.stamp);
        self.n_empties += u64::from(differences.emptiness);
        self.largest.merge(&differences.largest);
        if differences.counts() {
            self.n_differ += 1;
            if let Some(what) = differences.first {
                self.keep_first(number, what);
            }
        } else {
            self.n_within += 1;
        }
    }
}
