//! The units of time and length.

/// Nanoseconds since the Unix epoch; 0 for what has no time, such as a CT surface.
pub type StampNs = i64;

/// Millimetres in a metre, for readers, writers and views; everything else is in millimetres.
pub const MM_PER_M: f64 = 1000.0;
