//! Kinds that shared libraries bring: read through the C interface of `osteoflow_node::abi`, built and fired through it.
//!
//! A library is loaded once and never unloaded: what it described, and threads that it may have started, stay.

mod about;
mod host;
mod kinds;
mod library;
mod load;
mod node;
mod probe;
mod provide;

pub use about::{InputAbout, KindAbout, OutputsAbout, PluginAbout, PortAbout};
pub use kinds::{Finder, Kinds, Known, Plugin, Refused};
pub use library::{Library, LibraryError, Why};
pub use probe::{Prober, answer};
pub use provide::{ProvideError, provide};
