//! How a sensor errs, from scans of a part whose shape is known.
//!
//! [`ScanErrors::of`] fits one scan to the part, [`SensorErrors::of`] says what several scans have in common.

mod device;
mod scan;
#[cfg(test)]
mod tests;

pub use device::{SensorErrors, TableRow, Told};
pub use scan::{Estimate, Part, ScanErrors};
