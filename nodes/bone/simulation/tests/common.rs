//! The development data, where they are at hand, bones that are made once, exact procedures, white noise, and scans of a phantom.

pub(crate) mod bench;
pub(crate) mod exact;
mod measured;
pub(crate) mod phantom_scan;
pub(crate) mod shared;
pub(crate) mod white;

pub(crate) use measured::{data_folder, measured_bone, stl};
use osteoflow_simulation::ProcedureParams;
