//! Which channel is which wire's.

use super::format::{EXACT_ENCODING, Topic, WireHeader};
use osteoflow_container::{Channel, Damage, Location, ReadError, Reader, Record, Visitor};
use std::{collections::BTreeMap, ops::ControlFlow};

/// What a channel of a recording carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Carries {
    /// A wire's items, exactly.
    Exact(Wire),
    /// Pictures of a wire's values, for viewers.
    View(String),
    /// Items that policies dropped.
    Drops,
    /// What firings read from the clock.
    Live,
    /// Something else, such as when nodes fired.
    Other,
}

/// A wire, by name, as its exact channel describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Wire {
    /// `node.port`.
    pub(crate) name: String,
    pub(crate) header: WireHeader,
}

fn carries(channel: &Channel) -> Carries {
    match Topic::parse(&channel.topic) {
        Some(Topic::Exact(name)) if channel.message_encoding == EXACT_ENCODING => {
            Carries::Exact(Wire { name: name.into(), header: WireHeader::from_metadata(&channel.metadata) })
        }
        Some(Topic::View(name)) => Carries::View(name.into()),
        Some(Topic::Drops) => Carries::Drops,
        Some(Topic::Live) => Carries::Live,
        _ => Carries::Other,
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
