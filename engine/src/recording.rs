//! The format of recordings and how they are read: items as bytes, wires, and records of the run.

pub(crate) mod codec;
pub(crate) mod container;
pub mod digest;
pub(crate) mod findings;
pub mod format;
pub(crate) mod index;
pub(crate) mod number_set;
pub(crate) mod provenance;
mod read;
pub(crate) mod scan;
mod types;
pub(crate) mod wires;

pub use codec::item_bytes;
pub use format::{RecordedFailure, RunRecord};
pub(crate) use read::{Gathered, Gathering, check_version, run_record, typed};
pub use read::{RecordedWire, Recording, RecordingError};
pub(crate) use types::RecordedTypes;
