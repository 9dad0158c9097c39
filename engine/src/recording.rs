//! What a recording is, and how it is read: items as bytes, the wires they are of, what a run record says.

pub(crate) mod codec;
pub mod digest;
pub(crate) mod number_set;
mod read;
mod types;
pub(crate) mod wires;

pub use read::{About, RecordedFailure, RecordedWire, Recording, RecordingError};
pub(crate) use read::{MetadataRecords, counts, known};
pub(crate) use types::RecordedTypes;
