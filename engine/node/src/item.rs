//! The things that travel on a wire, and what a firing takes and gives.

use crate::{NodeError, Payload, StampNs, Value};
use std::sync::Arc;

/// Why an activation has no result; travels in the place of the value.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Empty {
    /// The node that could not answer.
    pub node: String,
    /// Why.
    pub reason: String,
}

/// A numbered, stamped item of a wire.
#[derive(Debug, Clone)]
pub struct Item {
    /// Its place on the wire, from 0, without holes.
    pub number: u64,
    /// When what it tells held; never decreases along a wire.
    pub stamp_ns: StampNs,
    /// A value, or why there is none.
    pub body: Body,
}

/// A value, or why there is none.
#[derive(Debug, Clone)]
pub enum Body {
    /// A payload.
    Value(Value),
    /// No result.
    Empty(Arc<Empty>),
}

/// What a node or source answers on one port.
#[derive(Debug, Clone)]
pub enum Emission {
    /// A payload.
    Value(Value),
    /// No result, for this reason.
    Empty(String),
    /// No result, for the reason of a node upstream: how a recorded empty is played.
    PassedOn(Arc<Empty>),
    /// Nothing: only a source may leave a port silent, which then gets progress.
    Silent,
}

impl Emission {
    /// An emission of a payload.
    pub fn value<T: Payload<By>, By: 'static>(payload: T) -> Self {
        Self::Value(Value::new(payload))
    }
}

/// What one port brings to a firing.
#[derive(Debug, Clone)]
pub enum Slot {
    /// The item that the port's join chose.
    Item(Item),
    /// The items that were collected.
    Items(Vec<Item>),
    /// There is none: the port is not wired, or nothing came at or before the firing stamp, for this reason.
    Absent(Arc<Empty>),
}

/// What all ports bring to a firing, in the order in which they are declared; lent to the node, so that a firing that
/// fails still has its items.
#[derive(Debug, Default)]
pub struct Joined {
    /// One slot for each declared port.
    pub slots: Vec<Slot>,
    /// Nobody needs the values afterwards, so they may be taken out; else what a node takes is a handle more on each.
    pub is_spent: bool,
}

impl Joined {
    /// The value of the port at `index`, if it brings one and values may be taken out; the slot is left without items.
    pub(crate) fn take_out(&mut self, index: usize) -> Option<Value> {
        let slot = self.slots.get_mut(index).filter(|_| self.is_spent)?;
        if !matches!(slot, Slot::Item(Item { body: Body::Value(_), .. })) {
            return None;
        }
        match std::mem::replace(slot, Slot::Items(Vec::new())) {
            Slot::Item(Item { body: Body::Value(value), .. }) => Some(value),
            _ => None,
        }
    }

    /// What the port at `index` brings.
    ///
    /// # Errors
    /// [`NodeError`] if the engine joined fewer ports than the node declares.
    #[inline]
    pub fn slot(&self, index: usize) -> Result<&Slot, NodeError> {
        self.slots.get(index).ok_or_else(|| NodeError::new("the engine joined too few ports"))
    }
}
