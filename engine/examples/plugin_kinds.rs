//! The kinds of `tests/plugins/kinds.rs` as a plugin: a test runs them loaded and built in, and holds both equal.

#[path = "../tests/plugins/kinds.rs"]
mod kinds;

osteoflow_node::export!(
    kinds::Count,
    kinds::Always,
    kinds::Declare,
    kinds::Draw,
    kinds::Clock,
    kinds::Perhaps,
    kinds::Four,
    kinds::Panic,
);
