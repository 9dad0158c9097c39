//! What a recording is, and how it is read: items as bytes, the wires they are of, the records of the run.

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
