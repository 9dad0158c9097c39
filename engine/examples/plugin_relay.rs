//! Two nodes of `osteoflow_toy::stream` as a plugin: tests and benches compare them with the built-in ones.

use osteoflow_toy::stream;

osteoflow_node::export!(stream::Relay, stream::Next);
