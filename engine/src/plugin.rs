//! Kinds provided by shared libraries: described, built and fired through the C interface of `osteoflow_node::abi`.
//!
//! A library is loaded once and never unloaded: its descriptions and threads may outlive any use.

#[cfg(unix)]
mod apart;
mod carried;
mod copies;
mod description;
mod host;
mod kinds;
mod late;
mod lent_check;
mod library;
mod load;
mod log_lines;
mod moved;
mod node;
mod probe;
mod provide;
#[cfg(unix)]
mod worker;

pub use crate::process::Launcher;
#[cfg(unix)]
pub use crate::process::child::signal_name;
#[cfg(unix)]
#[doc(hidden)]
pub use crate::process::hostile;
pub(crate) use carried::{carried, texts};
pub use description::{InputDescription, KindDescription, OutputsDescription, PluginDescription, PortDescription};
pub use kinds::{Finder, Held, Kinds, Known, Plugin, Refused, Scripts};
pub(crate) use late::{late_difference, with_late_loads};
pub use lent_check::check_lent_memory;
pub use library::{Library, LibraryError, Why};
pub use probe::{Prober, answer};
pub use provide::{ProvideError, provide};
#[cfg(unix)]
pub use worker::serve;

/// Serves one node until the connection on standard input is closed.
///
/// # Errors
/// Always: nodes have processes of their own on Unix only.
#[cfg(not(unix))]
pub fn serve(_: osteoflow_node::Registry) -> std::io::Result<()> {
    Err(std::io::ErrorKind::Unsupported.into())
}
