//! The nodes of `osteoflow_toy::context` as a plugin: a test compares them with the built-in ones.

use osteoflow_toy::context;

osteoflow_node::export!(
    context::Count,
    context::Always,
    context::Declare,
    context::Draw,
    context::Clock,
    context::Perhaps,
    context::Four,
    context::Panic,
);
