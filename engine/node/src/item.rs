//! Items on wires, and the inputs and outputs of a firing.

use crate::{NodeError, Payload, StampNs, Value};
use std::sync::Arc;

/// The reason why an activation has no result; sent instead of a value.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Empty {
    /// The node that gave no result.
    pub node: String,
    /// The reason.
    pub reason: String,
}

/// A numbered, stamped item of a wire.
#[derive(Debug, Clone)]
pub struct Item {
    /// Position on the wire, from 0, without gaps.
    pub number: u64,
    /// Time of the measurement; never decreases along a wire.
    pub stamp_ns: StampNs,
    /// A value or an empty.
    pub body: Body,
}

/// The content of an item.
#[derive(Debug, Clone)]
pub enum Body {
    /// A payload.
    Value(Value),
    /// No result.
    Empty(Arc<Empty>),
}

impl Body {
    /// The payload; `None` of an empty.
    pub fn value(&self) -> Option<&Value> {
        if let Self::Value(value) = self { Some(value) } else { None }
    }
}

/// The answer of a node or source on one port.
#[derive(Debug, Clone)]
pub enum Emission {
    /// A payload.
    Value(Value),
    /// No result, for this reason.
    Empty(String),
    /// No result, for the reason of another node: a recorded empty.
    PassedOn(Arc<Empty>),
    /// No item. Allowed for sources only; the port then gets progress.
    Silent,
}

impl Emission {
    /// Wraps a payload.
    pub fn value<T: Payload<By>, By: 'static>(payload: T) -> Self {
        Self::Value(Value::new(payload))
    }
}

/// The input of one port to a firing.
#[derive(Debug, Clone)]
pub enum Slot {
    /// The item that the port's join chose.
    Item(Item),
    /// The items that a collecting port gathered.
    Items(Vec<Item>),
    /// No item, for this reason: the port is not wired, or nothing came at or before the firing stamp.
    Absent(Arc<Empty>),
}

impl Slot {
    /// The items that the port brought.
    pub fn items(&self) -> &[Item] {
        match self {
            Self::Item(item) => std::slice::from_ref(item),
            Self::Items(items) => items,
            Self::Absent(_) => &[],
        }
    }
}

/// The inputs of a firing, in the order of the declared ports. The node borrows them, so the items survive a firing that
/// fails.
#[derive(Debug, Default)]
pub struct Joined {
    /// One slot per declared port.
    pub slots: Vec<Slot>,
    /// Whether values may be moved out. If not, the node gets clones of the handles.
    pub is_spent: bool,
}

impl Joined {
    /// Moves the value of the port at `index` out, if there is one and `is_spent` allows it. The slot is then empty.
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

    /// The slot of the port at `index`.
    ///
    /// # Errors
    /// [`NodeError`] if the engine joined fewer ports than the node declares.
    #[inline]
    pub fn slot(&self, index: usize) -> Result<&Slot, NodeError> {
        self.slots.get(index).ok_or_else(|| NodeError::new("the engine joined too few ports"))
    }
}
