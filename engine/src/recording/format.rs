//! Topics and metadata records of a recording, and their version.
//!
//! Each metadata record is a type; writer and readers share its keys through [`MetadataRecord`]. The format is
//! described in `docs/use/recording.md`.

mod messages;
mod records;

pub(crate) use messages::{Drops, Live, Log, LogLevel, RunMessage, Timing};
pub(crate) use records::{
    INPUT_HASHES, LATE_PLUGIN_TEXTS, LATE_PLUGINS, Outcome, PROGRAM, PluginRecords, PluginTexts, Recovered, WireCount,
    WireCounts, WireHeader, plugins,
};
pub use records::{RecordedFailure, RunRecord};

use std::collections::BTreeMap;

/// Version of topics and metadata records; increased when older readers cannot read them. No release wrote versions 1 and 2.
pub const FORMAT_VERSION: u32 = 3;

/// The encoding of messages on exact channels, which viewers know: bytes in a message of ROS 2.
pub const EXACT_ENCODING: &str = "cdr";
/// The encoding of the schemas of exact channels.
pub const EXACT_SCHEMA_ENCODING: &str = "ros2msg";
/// The sequence number of the transforms that are repeated before everything else, for viewers that begin there.
pub(crate) const OPENING: u32 = u32::MAX;
/// The encoding of messages about the run itself.
pub(crate) const RUN_ENCODING: &str = "json";

/// Profile in the header of a recording's file.
pub(crate) const PROFILE: &str = "osteoflow";
/// Profile in the header of `inputs.mcap`, the input items of a firing.
pub(crate) const REPRO_PROFILE: &str = "osteoflow-repro";

/// Log time of items without a time in a recording that has no other. The transforms of frames are logged one nanosecond
/// earlier, so that viewers know them first.
pub(crate) const FIRST_NS: i64 = 2;

const EXACT: &str = "/exact/";
const VIEW: &str = "/view/";

/// A topic of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topic<'a> {
    /// The items of a wire, bit for bit.
    Exact(&'a str),
    /// The items of a wire as messages for viewers.
    View(&'a str),
    /// Wall-clock times of firings.
    Timing,
    /// Items that policies dropped.
    Drops,
    /// What firings read from the clock.
    Live,
    /// The scan where its registration places it on the surface, for viewers.
    Registered,
    /// The verdict so far, for viewers.
    Verdict,
    /// What nodes say about their items, for viewers.
    Log,
}

impl<'a> Topic<'a> {
    /// Parses a topic; `None` for another program's.
    pub fn parse(topic: &'a str) -> Option<Self> {
        let run = [Self::Timing, Self::Drops, Self::Live, Self::Registered, Self::Verdict, Self::Log]
            .into_iter()
            .find(|run| run.name() == topic);
        run.or_else(|| Some(Self::Exact(topic.strip_prefix(EXACT)?)))
            .or_else(|| Some(Self::View(topic.strip_prefix(VIEW)?)))
    }

    /// Its name.
    pub fn name(self) -> String {
        match self {
            Self::Exact(wire) => format!("{EXACT}{wire}"),
            Self::View(wire) => format!("{VIEW}{wire}"),
            Self::Timing => "/run/timing".into(),
            Self::Drops => "/run/drops".into(),
            Self::Live => "/run/live".into(),
            Self::Registered => "/run/registered".into(),
            Self::Verdict => "/run/verdict".into(),
            Self::Log => "/run/log".into(),
        }
    }
}

/// Entries of a metadata record.
pub(crate) type Entries = BTreeMap<String, String>;

/// A metadata record as a type.
pub(crate) trait MetadataRecord: Sized {
    /// The record's name.
    const NAME: &'static str;

    /// Its entries, as written.
    fn to_metadata(&self) -> Entries;

    /// Parses the entries.
    ///
    /// # Errors
    /// Which entry is missing or wrong.
    fn from_metadata(entries: &Entries) -> Result<Self, String>;
}

/// The metadata records of a file, by name.
#[derive(Debug, Clone, Default)]
pub(crate) struct MetadataRecords(BTreeMap<String, Entries>);

impl MetadataRecords {
    /// Inserts a record, replacing an earlier one of its name; returns whether there was none.
    pub(crate) fn insert(&mut self, name: &str, entries: Entries) -> bool {
        self.0.insert(name.into(), entries).is_none()
    }

    /// Whether the record is there.
    pub(crate) fn has<T: MetadataRecord>(&self) -> bool {
        self.0.contains_key(T::NAME)
    }

    /// The entries of the record of this name.
    pub(crate) fn entries(&self, name: &str) -> Option<&Entries> {
        self.0.get(name)
    }

    /// The record; `None` if it is not there.
    ///
    /// # Errors
    /// As [`MetadataRecord::from_metadata`].
    pub(crate) fn get<T: MetadataRecord>(&self) -> Option<Result<T, String>> {
        self.entries(T::NAME).map(T::from_metadata)
    }

    /// The record, if it is present and can be parsed.
    pub(crate) fn sound<T: MetadataRecord>(&self) -> Option<T> {
        self.get()?.ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_round_trips() {
        for topic in [Topic::Exact("icp.report"), Topic::View("a/b.c"), Topic::Timing, Topic::Drops, Topic::Live] {
            assert_eq!(Topic::parse(&topic.name()), Some(topic));
        }
        assert_eq!(Topic::parse("/camera/scan"), None);
        assert_eq!(Topic::parse("/run/other"), None);
    }
}
