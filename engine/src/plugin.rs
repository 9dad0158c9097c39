//! Kinds provided by shared libraries: described, built and fired through the C interface of `osteoflow_node::abi`.
//!
//! A library is loaded once and never unloaded: its descriptions and threads may outlive any use.

mod description;
mod host;
mod kinds;
mod lent_check;
mod library;
mod load;
mod moved;
mod node;
mod probe;
mod provide;

pub use description::{InputDescription, KindDescription, OutputsDescription, PluginDescription, PortDescription};
pub use kinds::{Finder, Kinds, Known, Plugin, Refused};
pub use lent_check::check_lent_memory;
pub use library::{Library, LibraryError, Why};
pub use probe::{Prober, answer};
pub use provide::{ProvideError, provide};
