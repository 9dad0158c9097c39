//! Reports of runs and sweeps: one self-contained page each.
//!
//! [`of_run`] reads the folder that `osteoflow run` writes (results, manifest, recording), [`of_sweep`] that of
//! `osteoflow sweep`. A page holds figures as SVG, views in three dimensions with the scripts of the live page, tables, a methods paragraph,
//! provenance and BibTeX. It fetches nothing, so it opens without a network. What cannot be shown is listed with the reason,
//! such as a wire that was not recorded. Every figure and table is marked "research use only", and SIMULATED if no measured
//! data was registered.
//!
//! [`summary`] computes the statistics of a sweep and formats them as rows for pages and terminals;
//! [`diagram`] converts plans and runs for `osteoflow-draw`.
//!
//! ```no_run
//! let report = osteoflow_report::of_run("runs/fibula".as_ref(), &osteoflow_standard::registry())?;
//! report.write("runs/fibula".as_ref(), "runs/fibula/report.html".as_ref())?;
//! # Ok::<(), osteoflow_report::ReportError>(())
//! ```

mod cell;
mod chart;
mod citations;
mod degrees;
pub mod diagram;
mod error;
pub mod format;
mod html;
mod methods;
mod modules;
mod paths;
mod provenance;
mod report;
mod run;
mod run_folder;
mod scene;
mod sensor;
pub mod summary;
mod sweep;
mod tables;

pub use cell::Cell;
pub use chart::RESEARCH;
pub use error::ReportError;
pub use html::Figure;
pub use report::{BIBLIOGRAPHY, FIGURES, PAGE, Report};
pub use run::of_run;
pub use sensor::of_sensor;
pub use sweep::of_sweep;
