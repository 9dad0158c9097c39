//! What is wrong in a recording, with the place.

use osteoflow_container::Location;
use std::{collections::BTreeMap, fmt};

/// Maximum number of listed findings of each kind; the others are only counted.
const LISTED: u64 = 100;

/// Something wrong in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// The wire that it concerns, if any.
    pub wire: Option<String>,
    /// Number of the item that it concerns, if any.
    pub item: Option<u64>,
    /// Its place in the file, if known.
    pub place: Option<Location>,
    /// What is wrong.
    pub what: String,
}

impl Finding {
    pub(crate) fn new(place: impl Into<Option<Location>>, what: impl Into<String>) -> Self {
        Self { wire: None, item: None, place: place.into(), what: what.into() }
    }

    pub(crate) fn of(
        wire: &str,
        item: impl Into<Option<u64>>,
        place: impl Into<Option<Location>>,
        what: impl Into<String>,
    ) -> Self {
        Self { wire: Some(wire.into()), item: item.into(), place: place.into(), what: what.into() }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(wire) = &self.wire {
            write!(f, "wire {wire}")?;
            if let Some(item) = self.item {
                write!(f, ", item {item}")?;
            }
            f.write_str(": ")?;
        }
        f.write_str(&self.what)?;
        match self.place {
            Some(place) => write!(f, " ({place})"),
            None => Ok(()),
        }
    }
}

/// Findings, of which at most [`LISTED`] of each kind are stored.
#[derive(Debug, Default)]
pub(crate) struct Findings {
    listed: Vec<(&'static str, Finding)>,
    n_by_kind: BTreeMap<&'static str, u64>,
}

/// Kinds of findings that say no more than that something is missing.
const LOSSES: [&str; 4] = ["statistics", "hole", "count", "view"];

impl Findings {
    /// Adds a finding; `kind` groups findings that differ only in their place.
    pub(crate) fn add(&mut self, kind: &'static str, finding: Finding) {
        let n = self.n_by_kind.entry(kind).or_default();
        *n += 1;
        if *n <= LISTED {
            self.listed.push((kind, finding));
        }
    }

    pub(crate) fn n(&self) -> u64 {
        self.n_by_kind.values().sum()
    }

    /// Removes the findings of these kinds.
    pub(crate) fn take(&mut self, kinds: &[&str]) -> Vec<Finding> {
        self.n_by_kind.retain(|kind, _| !kinds.contains(kind));
        let listed = std::mem::take(&mut self.listed);
        let (taken, rest): (Vec<_>, Vec<_>) = listed.into_iter().partition(|(kind, _)| kinds.contains(kind));
        self.listed = rest;
        taken.into_iter().map(|(_, finding)| finding).collect()
    }

    /// Replaces the findings that follow from damage by one: `lost` and the wires that lack items.
    pub(crate) fn fold_losses(&mut self, lost: &str) {
        let taken = self.take(&LOSSES);
        let mut wires: Vec<&str> = taken.iter().filter_map(|finding| finding.wire.as_deref()).collect();
        wires.dedup();
        if taken.is_empty() {
            return;
        }
        let named = match wires.len() {
            0 => String::new(),
            n @ 1..=6 => format!("; wires that lack items: {}", wires[..n].join(", ")),
            n => format!("; wires that lack items: {}, and {} more", wires[..5].join(", "), n - 5),
        };
        self.add("loss", Finding::new(None, format!("missing with the damage: {lost}{named}")));
    }

    /// The listed findings.
    pub(crate) fn into_listed(self) -> Vec<Finding> {
        self.listed.into_iter().map(|(_, finding)| finding).collect()
    }
}
