//! Registration from the result of another, which checks or improves it. All kinds have the ports of an ICP.

pub mod slide;
