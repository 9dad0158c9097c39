//! Digests of recorded wires, independent of the file's layout.
//!
//! The digest of an item is the SHA-256 of its exact message: number, stamp and body. The digest of a wire is the
//! SHA-256 of its items' digests, one after the other by number. The digest of a recording is the SHA-256 over its wires
//! by name, of those that have items: the length of the name (u32, little-endian) and the name, the same of
//! `payload@version`, and the digest of the wire.
//!
//! A digest does not depend on the order of messages in the file, chunks, compression, log times, pictures for viewers
//! or messages about the run.

use super::{
    index::{Index, Indexed},
    read::RecordingError,
};
use crate::hash::Digest;
use osteoflow_container::Progress;
use sha2::{Digest as _, Sha256};
use std::{ops::RangeInclusive, path::Path};

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

/// Digests of the recorded wires, with a note if the file is incomplete. Memory: 72 bytes an item.
///
/// # Errors
/// [`RecordingError`] if the file cannot be read or holds no exact channel.
pub fn digest(path: &Path, progress: Progress<'_>) -> Result<DigestReport, RecordingError> {
    let index = Index::of(path, progress)?;
    let mut notes: Vec<String> = index.damage.clone().into_iter().collect();
    let unread = ["belong to channels that nothing in the file describes", "on exact channels are no items"];
    let unread = index.n_unread.iter().zip(unread).filter(|(n, _)| **n > 0);
    notes.extend(unread.map(|(n, what)| format!("{n} messages {what}")));
    let recovered = index.is_recovered();
    if notes.is_empty() && !recovered {
        notes.extend(index.incomplete());
    }
    let wires: Vec<WireDigest> = index.wires.values().map(WireDigest::of).collect();
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
        n_bytes: index.n_bytes(),
    })
}

impl WireDigest {
    fn of(wire: &Indexed) -> Self {
        let (mut hasher, mut missing, mut next) = (Sha256::new(), Vec::new(), 0);
        for entry in &wire.entries {
            hasher.update(entry.digest.0);
            if entry.number > next {
                missing.push(next..=entry.number - 1);
            }
            // There is no number, and no gap, after the last one.
            next = entry.number.saturating_add(1);
        }
        let (header, doubled) = (&wire.about.header, wire.doubled());
        Self {
            wire: wire.about.name.clone(),
            payload: header.payload.clone(),
            version: header.version,
            n_items: wire.entries.len() as u64,
            n_values: wire.n_values,
            missing,
            doubled,
            digest: doubled.is_none().then(|| Digest(hasher.finalize().into())),
        }
    }
}
