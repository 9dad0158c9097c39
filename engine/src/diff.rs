//! Where two recordings part: the first divergence, and a summary for each wire.
//!
//! First is what a graph computes first: wires come in the topological order of the graph in the first recording, items
//! by number. Two recordings are equal where their wires hold the same bits under the same numbers; in what order the
//! files hold them, how they are packed, and what they say of the run does not matter.

mod compare;
mod index;
mod numbers;
mod order;

pub use compare::{Difference, Largest};

use crate::{
    names::glob,
    recording::{
        RecordingError,
        codec::{self, RecordedItem},
        format::Outcome,
    },
};
use compare::{Compare, ItemDifference, Units};
use index::{Entry, Index, Indexed};
use osteoflow_container::Progress;
use std::{cmp::Ordering, collections::BTreeSet, path::Path};

/// What is compared, and how closely.
#[derive(Debug, Clone, Default)]
pub struct DiffOptions {
    /// Patterns of wires, with `*` and `?`; all wires where there is none.
    pub wires: Vec<String>,
    /// Numbers that differ by no more than this, each in its own unit, count as equal.
    pub tolerance: f64,
}

/// What is true of a whole recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Side {
    /// The graph's name; none where the recording no longer says it.
    pub graph: Option<String>,
    /// The run's seed.
    pub seed: Option<u64>,
    /// The version of the program that wrote it.
    pub version: Option<String>,
    /// Why it may lack items.
    pub incomplete: Option<String>,
}

/// The first divergence.
#[derive(Debug, Clone, PartialEq)]
pub struct Divergence {
    /// The wire.
    pub wire: String,
    /// The item's number.
    pub item: u64,
    /// What differs there.
    pub what: Difference,
}

/// A wire in both recordings.
#[derive(Debug, Clone, PartialEq)]
pub struct WireDiff {
    /// `node.port`.
    pub wire: String,
    /// `payload@version` in each.
    pub payloads: [String; 2],
    /// Items in each.
    pub n_items: [u64; 2],
    /// Whether the recording has the wire at all.
    pub there: [bool; 2],
    /// Items in both that differ by more than the tolerance.
    pub n_differ: u64,
    /// Items in both that differ by no more than the tolerance.
    pub n_within: u64,
    /// Items that only the one or only the other has.
    pub n_only: [u64; 2],
    /// Items whose stamps differ.
    pub n_stamps: u64,
    /// Items of which one is a value and one an empty, or two empties with different reasons.
    pub n_empties: u64,
    /// The largest differences of numbers.
    pub largest: Largest,
    /// The first item that differs, and in what.
    pub first: Option<(u64, Difference)>,
}

impl WireDiff {
    /// Whether it is in both and nothing differs by more than the tolerance. A wire without items says nothing.
    pub fn is_equal(&self) -> bool {
        self.first.is_none()
    }
}

/// What came of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct DiffReport {
    /// What is true of each recording.
    pub sides: [Side; 2],
    /// Whether the graphs are the same text.
    pub same_graph: Option<bool>,
    /// Whether the results are the same; none where one has none.
    pub same_results: Option<bool>,
    /// The first divergence.
    pub first: Option<Divergence>,
    /// The wires, in the order in which the graph computes them.
    pub wires: Vec<WireDiff>,
    /// Bytes of both files.
    pub n_bytes: u64,
}

impl DiffReport {
    /// Whether nothing that was compared differs by more than the tolerance.
    pub fn is_equal(&self) -> bool {
        self.wires.iter().all(WireDiff::is_equal)
    }
}

/// The first thing in which two items differ in any bit; `units` are those of the payload's fields and columns.
pub(crate) fn first_difference(a: &RecordedItem, b: &RecordedItem, units: &[(&str, &str)]) -> Option<Difference> {
    Compare::items(a, b, &Units::given(units), 0.0).first
}

/// Compares two recordings. Memory: an index of both, and some unpacked chunks.
///
/// # Errors
/// [`RecordingError`] if one of them cannot be read, holds no exact channel, or holds a number twice.
pub fn diff(a: &Path, b: &Path, options: &DiffOptions, progress: Progress<'_>) -> Result<DiffReport, RecordingError> {
    let n_b = std::fs::metadata(b).map_or(0, |m| m.len());
    let mut a = Index::of(a, &mut |at, of| progress(at, of + n_b))?;
    let n_a = a.n_bytes();
    let mut b = Index::of(b, &mut |at, of| progress(n_a + at, n_a + of))?;
    let wires = compared(&a, &b, options);
    let mut diffs: Vec<WireDiff> = wires.iter().map(|wire| missing(wire, &a, &b)).collect();
    let mut pairs = Vec::new();
    for (index, wire) in wires.iter().enumerate() {
        if let (Some(x), Some(y)) = (a.wires.get(wire), b.wires.get(wire)) {
            pairs.extend(differing(x, y).map(|(x, y)| (index, x, y)));
        }
    }
    // In the order of the first file, so that each of its chunks is unpacked once.
    pairs.sort_by_key(|(_, x, _)| x.place);
    let units: Vec<Units> = wires.iter().map(|wire| a.wires.get(wire).map_or_else(Units::default, units_of)).collect();
    for (index, x, y) in pairs {
        let found = items(&mut a, &mut b, &x, &y, &units[index], options.tolerance)?;
        diffs[index].add(x.number, found);
    }
    let first = diffs.iter().find_map(|diff| {
        let (item, what) = diff.first.clone()?;
        Some(Divergence { wire: diff.wire.clone(), item, what })
    });
    let both = |get: fn(&Index) -> Option<String>| Some((get(&a)?, get(&b)?));
    Ok(DiffReport {
        same_graph: both(|i| Some(i.run.as_ref()?.graph.clone())).map(|(a, b)| a == b),
        same_results: both(|i| Some(i.metadata.sound::<Outcome>()?.results.to_string())).map(|(a, b)| a == b),
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
        incomplete: index.incomplete.clone(),
    }
}

fn units_of(wire: &Indexed) -> Units {
    Units::of(&wire.about.header.units)
}

/// The wires to compare, in the order in which the first recording's graph computes them.
fn compared(a: &Index, b: &Index, options: &DiffOptions) -> Vec<String> {
    let graph = a.run.as_ref().or(b.run.as_ref()).map_or("", |run| run.graph.as_str());
    let ranks = order::ranks(graph);
    let names: BTreeSet<&String> = a.wires.keys().chain(b.wires.keys()).collect();
    let wanted = |name: &str| options.wires.is_empty() || options.wires.iter().any(|p| glob::fits(p, name));
    let mut names: Vec<_> = names.into_iter().filter(|name| wanted(name)).cloned().collect();
    names.sort_by_key(|name| (ranks.get(order::node_of(name)).copied().unwrap_or(usize::MAX), name.clone()));
    names
}

/// Walks along both lists by number: items in both, or in one.
fn merged<'a>(a: &'a [Entry], b: &'a [Entry]) -> impl Iterator<Item = (Option<&'a Entry>, Option<&'a Entry>)> {
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

fn differing<'a>(a: &'a Indexed, b: &'a Indexed) -> impl Iterator<Item = (Entry, Entry)> + 'a {
    let both = merged(&a.entries, &b.entries).filter_map(|(x, y)| Some((*x?, *y?)));
    both.filter(|(x, y)| x.digest != y.digest)
}

/// The wire as far as numbers and payloads tell it.
fn missing(wire: &str, a: &Index, b: &Index) -> WireDiff {
    let (x, y) = (a.wires.get(wire), b.wires.get(wire));
    let payload = |wire: Option<&Indexed>| {
        wire.map_or("none".into(), |wire| format!("{}@{}", wire.about.header.payload, wire.about.header.version))
    };
    let entries = |wire: Option<&'_ Indexed>| wire.map_or(&[] as &[Entry], |wire| &wire.entries).to_vec();
    let (of_a, of_b) = (entries(x), entries(y));
    let mut diff = WireDiff {
        wire: wire.into(),
        payloads: [payload(x), payload(y)],
        n_items: [of_a.len() as u64, of_b.len() as u64],
        there: [x.is_some(), y.is_some()],
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
        let told = |there: bool| if there { "an item".to_owned() } else { "none".into() };
        diff.keep_first(number, plain("presence", told(side == 0), told(side == 1)));
    }
    let lowest = of_a.iter().chain(&of_b).map(|entry| entry.number).min();
    if let Some(number) = lowest.filter(|_| x.is_some() && y.is_some() && diff.payloads[0] != diff.payloads[1]) {
        let [a, b] = diff.payloads.clone();
        diff.keep_first(number, plain("payload", a, b));
    }
    diff
}

fn plain(field: &str, a: String, b: String) -> Difference {
    Difference { field: field.into(), a, b, ulp: None, distance: None, unit: None, note: None }
}

/// What differs between two items of one number.
fn items(
    a: &mut Index,
    b: &mut Index,
    x: &Entry,
    y: &Entry,
    units: &Units,
    tolerance: f64,
) -> Result<ItemDifference, RecordingError> {
    let [x, y] = [a.message(x)?, b.message(y)?];
    let damaged = |item: &Result<codec::RecordedItem, codec::CodecError>| match item {
        Ok(_) => "an item".to_owned(),
        Err(error) => error.to_string(),
    };
    let mut found = match (codec::decode(&x), codec::decode(&y)) {
        (Ok(x), Ok(y)) => Compare::items(&x, &y, units, tolerance),
        (x, y) => {
            let first = Some(plain("message", damaged(&x), damaged(&y)));
            ItemDifference { first, other: true, ..ItemDifference::default() }
        }
    };
    // Bits that mean nothing, such as padding, differ all the same.
    if found.first.is_none() && found.n_numbers == 0 {
        let at = x.iter().zip(&y).position(|(x, y)| x != y).unwrap_or_else(|| x.len().min(y.len()));
        found.other = true;
        found.first = Some(plain(&format!("byte {at} of the message"), byte(&x, at), byte(&y, at)));
    }
    Ok(found)
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

    fn add(&mut self, number: u64, found: ItemDifference) {
        self.n_stamps += u64::from(found.stamp);
        self.n_empties += u64::from(found.emptiness);
        self.largest.merge(&found.largest);
        if found.counts() {
            self.n_differ += 1;
            if let Some(what) = found.first {
                self.keep_first(number, what);
            }
        } else {
            self.n_within += 1;
        }
    }
}
