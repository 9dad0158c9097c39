//! Where the landmarks are taken to be: how far from the plan a surgeon marks them.

pub mod ruled;
