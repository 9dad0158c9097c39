//! Kinds that shared libraries bring: read through the C interface of `osteoflow_node::abi`, built and fired through it.
//!
//! A library is loaded once and never unloaded: what it described, and threads that it may have started, stay.

mod about;
mod host;
mod library;
mod node;
mod provide;

pub use about::{InputAbout, KindAbout, OutputsAbout, PluginAbout, PortAbout};
pub use library::{Library, LibraryError, Why};
pub use provide::{ProvideError, provide};
