//! The `osteoflow` command.
fn main() {}
