//! The format of recordings and how they are read: items as bytes, wires, and records of the run.

pub(crate) mod codec;
pub mod digest;
pub mod format;
pub(crate) mod number_set;
mod read;
mod types;
pub(crate) mod wires;

pub use format::RecordedFailure;
pub use read::{RecordedWire, Recording, RecordingError};
pub(crate) use read::{known, run_record};
pub(crate) use types::RecordedTypes;
