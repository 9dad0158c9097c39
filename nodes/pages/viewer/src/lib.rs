//! A live stream of what a run records, or of a recording, and the page that shows it.
//!
//! [`Stream`] is the listener of a run ([`osteoflow_engine::run::RunOptions::listener`]); [`Server`] sends it to viewers by the
//! Foxglove WebSocket protocol and serves the page, both at one address. The server is small and of this crate, because that of
//! the `foxglove` crate looks at the subprotocol of a request only, and needs an asynchronous runtime: here the token, the `Host`
//! and the `Origin` are checked before a request becomes a stream (docs/decisions/0032).

mod access;
mod door;
mod http;
mod indexed;
mod page;
mod playback;
mod protocol;
mod server;
mod still;
mod stream;

pub use door::{Door, Role};
pub use page::{THREE_LICENSE, script};
pub use playback::Playback;
pub use server::{App, NoApp, ServeOptions, Server};
pub use still::last_messages;
pub use stream::{Stream, Totals};
