//! The surgical plan on the CT: landmarks, assessment points, cutting planes.

pub mod file;
pub mod landmarks;
mod ports;
pub mod simulated;

pub use ports::Out;
