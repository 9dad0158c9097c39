//! Digests of recorded wires, independent of the file's layout.
//!
//! The digest of an item is the SHA-256 of its exact message: number, stamp and body. The digest of a wire is the
//! SHA-256 of its items' digests, one after the other by number. The digest of a recording is the SHA-256 over its wires
//! by name, of those that have items: the length of the name (u32, little-endian) and the name, the same of
//! `payload@version`, and the digest of the wire.
//!
//! A digest does not depend on the order of messages in the file, chunks, compression, log times, pictures for viewers
//! or messages about the run. Items are hashed one by one, so they may come in any order and need not be kept.

use super::{
    codec,
    format::{Recovered, WireCounts},
    number_set::NumberSet,
    read::RecordingError,
    scan::{Carried, Gather, PassState, Scanned, scan},
    wires::{Carries, Wire},
};
use crate::hash::Digest;
use osteoflow_container::Progress;
use sha2::{Digest as _, Sha256};
use std::{
    collections::BTreeMap,
    ops::{ControlFlow, RangeInclusive},
    path::Path,
};

/// Computes the digest of a wire. Items may come in any order: the digest of an item that comes early is kept until its
/// turn.
#[derive(Default)]
struct WireHasher {
    hasher: Sha256,
    numbers: NumberSet,
    /// The number of the next item to hash.
    next: u64,
    n_items: u64,
    early: BTreeMap<u64, Digest>,
    /// A number that was added twice; such a wire has no digest.
    doubled: Option<u64>,
}

impl WireHasher {
    /// Adds the item with this number; `message` is its message on the exact channel.
    fn add(&mut self, number: u64, message: &[u8]) {
        let digest = Digest::of(message);
        self.n_items += 1;
        if !self.numbers.insert(number) {
            self.doubled.get_or_insert(number);
        } else if number > self.next {
            self.early.insert(number, digest);
        } else {
            self.take(number, digest);
            while let Some(digest) = self.early.remove(&self.next) {
                self.take(self.next, digest);
            }
        }
    }

    fn take(&mut self, number: u64, digest: Digest) {
        self.hasher.update(digest.0);
        // There is no number, and no gap, after the last one.
        self.next = number.saturating_add(1);
    }

    /// The wire's digest; `None` if a number was added twice.
    fn finish(mut self) -> Option<Digest> {
        self.early.values().for_each(|digest| self.hasher.update(digest.0));
        self.doubled.is_none().then(|| Digest(self.hasher.finalize().into()))
    }
}

/// The digest of all wires, from each one's name, payload and digest, in any order. Leave out wires without items.
fn total<'a>(wires: impl IntoIterator<Item = (&'a str, &'a str, u32, Digest)>) -> Digest {
    let mut wires: Vec<_> = wires.into_iter().collect();
    wires.sort();
    let mut hasher = Sha256::new();
    for (name, payload, version, digest) in wires {
        for text in [name, &format!("{payload}@{version}")] {
            hasher.update((text.len() as u32).to_le_bytes());
            hasher.update(text);
        }
        hasher.update(digest.0);
    }
    Digest(hasher.finalize().into())
}

/// A recorded wire and its digest.
#[derive(Debug, Clone, PartialEq)]
pub struct WireDigest {
    /// `node.port`.
    pub wire: String,
    /// The payload's name.
    pub payload: String,
    /// The version of its view.
    pub version: u32,
    /// Number of items.
    pub n_items: u64,
    /// Number of values; the other items are empties.
    pub n_values: u64,
    /// Missing numbers.
    pub missing: Vec<RangeInclusive<u64>>,
    /// A number that occurs twice.
    pub doubled: Option<u64>,
    /// The digest; `None` if a number occurs twice.
    pub digest: Option<Digest>,
}

/// The digests of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct DigestReport {
    /// The wires, by name.
    pub wires: Vec<WireDigest>,
    /// The digest of the recording; `None` if a wire has none.
    pub digest: Option<Digest>,
    /// Why it does not cover everything that was recorded.
    pub incomplete: Option<String>,
    /// Notes, for example that the recording was recovered from a damaged file and is incomplete.
    pub partial: Option<String>,
    /// Size of the file in bytes.
    pub n_bytes: u64,
}

/// Digests of the recorded wires, with a note if the file is incomplete. Memory: one chunk,
/// and what comes out of order.
///
/// # Errors
/// [`RecordingError`] if the file cannot be read or holds no exact channel.
pub fn digest(path: &Path, progress: Progress<'_>) -> Result<DigestReport, RecordingError> {
    let mut hashing = Hashing::default();
    let scanned = scan(path, &mut hashing, progress)?;
    scanned.refuse_foreign(path, !hashing.wires.is_empty())?;
    let Scanned { reader, metadata, damage, unsound, n_unknown } = scanned;
    let Hashing { wires, n_no_items } = hashing;
    let mut notes: Vec<String> = damage.or(unsound).into_iter().collect();
    if n_unknown > 0 {
        notes.push(format!("{n_unknown} messages belong to channels that nothing in the file describes"));
    }
    if n_no_items > 0 {
        notes.push(format!("{n_no_items} messages on exact channels are no items"));
    }
    let recovered = metadata.has::<Recovered>();
    if notes.is_empty() && !recovered && !metadata.has::<WireCounts>() {
        notes.push("the run did not finish it".into());
    }
    let wires: Vec<WireDigest> = wires.into_values().map(Hashed::finish).collect();
    for wire in &wires {
        if let Some(number) = wire.doubled {
            notes.push(format!("wire {} holds item {number} twice, so it has no digest", wire.wire));
        }
        if !recovered && let Some(hole) = wire.missing.first() {
            notes.push(format!("wire {} lacks item {}", wire.wire, hole.start()));
        }
    }
    let with_items = wires.iter().filter(|wire| wire.n_items > 0);
    let digests: Option<Vec<_>> =
        with_items.map(|w| Some((w.wire.as_str(), w.payload.as_str(), w.version, w.digest?))).collect();
    Ok(DigestReport {
        digest: digests.map(total),
        wires,
        incomplete: (!notes.is_empty()).then(|| notes.join("; ")),
        partial: recovered.then(|| "it was recovered from a damaged file and is a part of what was recorded".into()),
        n_bytes: reader.n_bytes(),
    })
}

/// The hasher and the counts of a wire.
struct Hashed {
    about: Wire,
    hasher: WireHasher,
    n_values: u64,
}

impl Hashed {
    fn finish(self) -> WireDigest {
        WireDigest {
            wire: self.about.name,
            payload: self.about.header.payload,
            version: self.about.header.version,
            n_items: self.hasher.n_items,
            n_values: self.n_values,
            missing: self.hasher.numbers.missing(None),
            doubled: self.hasher.doubled,
            digest: self.hasher.finish(),
        }
    }
}

#[derive(Default)]
struct Hashing {
    wires: BTreeMap<String, Hashed>,
    n_no_items: u64,
}

impl Gather for Hashing {
    fn wire(&mut self, wire: &Wire) {
        let hashed = || Hashed { about: wire.clone(), hasher: WireHasher::default(), n_values: 0 };
        self.wires.entry(wire.name.clone()).or_insert_with(hashed);
    }

    fn message(&mut self, carried: Carried<'_>, state: &mut PassState) -> ControlFlow<()> {
        let Carried { carries, message, .. } = carried;
        let Carries::Exact(wire) = carries else { return ControlFlow::Continue(()) };
        match (codec::head(message.data), self.wires.get_mut(&wire.name)) {
            (Some(head), Some(hashed)) => {
                hashed.n_values += u64::from(!head.is_empty);
                // Items out of order are kept until their turn.
                if head.number > hashed.hasher.n_items {
                    state.allowance.take(0)?;
                }
                hashed.hasher.add(head.number, message.data);
            }
            _ => self.n_no_items += 1,
        }
        ControlFlow::Continue(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_gap_changes_the_digest_and_is_named() {
        let of = |numbers: &[u64]| {
            let mut hasher = WireHasher::default();
            numbers.iter().for_each(|n| hasher.add(*n, b"item"));
            (hasher.numbers.missing(None), hasher.doubled, hasher.finish())
        };
        assert_eq!(of(&[0, 1, 5, 6, 9]).0, [2..=4, 7..=8]);
        assert_eq!(of(&[3, 0]).0, [1..=2]);
        assert_eq!(of(&[1, 0, 1]).1, Some(1));
        assert_eq!(of(&[1, 0, 1]).2, None);
        assert_eq!(of(&[u64::MAX, 0]).0, [1..=u64::MAX - 1]);
    }

    proptest! {
        #[test]
        fn the_digest_does_not_depend_on_the_order_of_items(
            order in Just((0..40_u64).collect::<Vec<_>>()).prop_shuffle(), left_out in 0..60_u64,
        ) {
            let of = |numbers: &mut dyn Iterator<Item = u64>| {
                let mut hasher = WireHasher::default();
                numbers.filter(|n| *n != left_out).for_each(|n| hasher.add(n, &n.to_le_bytes()));
                hasher.finish().unwrap()
            };
            prop_assert_eq!(of(&mut order.iter().copied()), of(&mut (0..40)));
        }
    }
}
