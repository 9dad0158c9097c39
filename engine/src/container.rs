//! Reads MCAP files of any writer, whole or damaged: guards every length before it asks for memory, checks every CRC,
//! and finds the next record behind damage.
//!
//! The `mcap` crate is not used to read them, because it makes room for what a damaged length claims, and stops at the first
//! fault without saying where (`docs/decisions/0010`).

mod chunk;
mod fields;
mod record;
mod resync;
mod walk;
mod wires;

pub(crate) use record::{Attachment, Channel, ChunkHead, ChunkIndex, MESSAGE_HEAD, Message, Record, Statistics};
pub use walk::{Damage, Place};
pub(crate) use walk::{End, Visit, Walk, WalkError};
pub(crate) use wires::{Carries, Channels, Wire, told};
