//! Which channel is which wire's.

use crate::record::{EXACT_ENCODING, EXACT_TOPIC, VIEW_TOPIC};
use osteoflow_container::{Channel, Damage, Location, ReadError, Reader, Record, Visitor};
use std::{collections::BTreeMap, ops::ControlFlow};

/// What a channel of a recording carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Carries {
    /// A wire's items, exactly.
    Exact(Wire),
    /// Pictures of a wire's values, for viewers.
    View(String),
    /// Something else, such as what the run says of itself.
    Other,
}

/// A wire as its exact channel describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Wire {
    /// `node.port`.
    pub(crate) name: String,
    /// The payload's name.
    pub(crate) payload: String,
    /// The version of its view.
    pub(crate) version: u32,
    /// Whether its node is a source.
    pub(crate) source: bool,
    /// The units of fields and columns whose names do not say them.
    pub(crate) units: String,
    /// What the payload's views hold, as JSON; `None` where the channel does not say it.
    pub(crate) schema: Option<String>,
}

/// What the channel carries.
pub(crate) fn carries(channel: &Channel) -> Carries {
    let about = |key: &str| channel.metadata.get(key).cloned().unwrap_or_default();
    if let Some(name) = channel.topic.strip_prefix(EXACT_TOPIC).filter(|_| channel.message_encoding == EXACT_ENCODING) {
        return Carries::Exact(Wire {
            name: name.into(),
            payload: about("payload"),
            version: about("version").parse().unwrap_or(0),
            source: about("source") == "true",
            units: about("units"),
            schema: channel.metadata.get("schema").cloned(),
        });
    }
    match channel.topic.strip_prefix(VIEW_TOPIC) {
        Some(name) => Carries::View(name.into()),
        None => Carries::Other,
    }
}

/// The channels of a file, as far as they have been met.
#[derive(Debug, Default)]
pub(crate) struct Channels {
    by_id: BTreeMap<u16, (Channel, Carries)>,
}

impl Channels {
    /// The channels that the summary repeats: with them a message whose channel was described in a damaged chunk only is
    /// not lost.
    pub(crate) fn of_summary<R: std::io::Read + std::io::Seek>(reader: &mut Reader<R>) -> Result<Self, ReadError> {
        let mut channels = Self::default();
        reader.summary(&mut channels)?;
        Ok(channels)
    }

    /// Takes a description; the first one of an id stands.
    pub(crate) fn add(&mut self, channel: Channel) -> &Carries {
        let entry = self.by_id.entry(channel.id);
        &entry.or_insert_with(|| (channel.clone(), carries(&channel))).1
    }

    pub(crate) fn get(&self, id: u16) -> Option<&Carries> {
        self.by_id.get(&id).map(|(_, carries)| carries)
    }

    /// The topic of a channel that has been met.
    pub(crate) fn topic(&self, id: u16) -> Option<&str> {
        self.by_id.get(&id).map(|(channel, _)| &*channel.topic)
    }

    /// The wires of exact channels.
    pub(crate) fn wires(&self) -> impl Iterator<Item = &Wire> {
        self.by_id.values().filter_map(|(_, carries)| match carries {
            Carries::Exact(wire) => Some(wire),
            _ => None,
        })
    }
}

impl Visitor for Channels {
    fn record(&mut self, _: Location, record: Record<'_>) -> ControlFlow<()> {
        if let Record::Channel(channel) = record {
            self.add(channel);
        }
        ControlFlow::Continue(())
    }

    fn damage(&mut self, _: Damage) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}
