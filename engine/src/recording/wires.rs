//! Maps channels to wires.

use super::{
    codec,
    format::{EXACT_ENCODING, Topic, WireHeader},
};
use osteoflow_container::Channel;
use std::collections::BTreeMap;

/// Content of a recording's channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Carries {
    /// A wire's items, bit for bit.
    Exact(Wire),
    /// Pictures of a wire's values, for viewers, and their encoding.
    View { wire: String, encoding: String },
    /// Items that policies dropped.
    Drops,
    /// Clock readings of firings.
    Live,
    /// Anything else, such as firing times.
    Other,
}

/// A wire, by name, as its exact channel describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Wire {
    /// `node.port`.
    pub(crate) name: String,
    pub(crate) header: WireHeader,
}

impl Carries {
    /// The item in a message of an exact channel, any other message as it is.
    pub(crate) fn content<'a>(&self, message: &'a [u8]) -> &'a [u8] {
        match self {
            Self::Exact(_) => codec::unframed(message),
            _ => message,
        }
    }
}

fn carries(channel: &Channel) -> Carries {
    match Topic::parse(&channel.topic) {
        Some(Topic::Exact(name)) if channel.message_encoding == EXACT_ENCODING => {
            Carries::Exact(Wire { name: name.into(), header: WireHeader::from_metadata(&channel.metadata) })
        }
        Some(Topic::View(name)) => Carries::View { wire: name.into(), encoding: channel.message_encoding.clone() },
        Some(Topic::Drops) => Carries::Drops,
        Some(Topic::Live) => Carries::Live,
        _ => Carries::Other,
    }
}

/// What the channels of a file carry, by identifier.
#[derive(Debug, Default)]
pub(crate) struct Channels(BTreeMap<u16, Carries>);

impl Channels {
    /// Adds a channel, unless its identifier is known.
    pub(crate) fn add(&mut self, channel: Channel) -> &Carries {
        self.0.entry(channel.id).or_insert_with(|| carries(&channel))
    }

    pub(crate) fn get(&self, id: u16) -> Option<&Carries> {
        self.0.get(&id)
    }
}
