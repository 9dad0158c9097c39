//! The surgical plan on the CT: landmarks, assessment points, cutting planes.

pub mod file;
pub mod landmarks;
mod moved;
mod ports;
pub mod simulated;

pub(crate) use moved::Moved;
pub use ports::Out;
