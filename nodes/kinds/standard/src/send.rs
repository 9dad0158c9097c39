//! Streams to other programs while a run lasts.

pub mod openigtlink;
