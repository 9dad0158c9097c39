//! Names of the files in the folder of a run.

pub use crate::repro::{BUNDLE as REPRO_BUNDLE, FOLDER as REPRO, INPUTS as REPRO_INPUTS};

/// The recording: the items of the recorded wires, exactly, and their views.
pub const RECORDING: &str = "run.mcap";
/// The layout of Foxglove and Lichtblick for the recording.
pub const LAYOUT: &str = crate::record::LAYOUT;
/// The verdict on the results, and the values that the graph's `[results]` names or the reason why there are none.
pub const RESULTS: &str = "results.json";
/// The provenance of the results: graph, versions, hashes, machine, times and counts.
pub const MANIFEST: &str = "manifest.json";
