//! Two kinds of the benches as a plugin: the very nodes that are built in there, loaded.

#[path = "../benches/graph/kinds.rs"]
#[allow(dead_code, reason = "the sources stay in the program")]
mod kinds;

osteoflow_node::export!(kinds::Relay, kinds::Next);
