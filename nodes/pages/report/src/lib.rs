//! Reports of runs and sweeps: one self-contained page each.
//!
//! [`of_run`] reads the folder that `osteoflow run` writes (results, manifest, recording), [`of_sweep`] that of
//! `osteoflow sweep`. A page holds figures as SVG, views in three dimensions with the scripts of the live page, tables, a methods paragraph,
//! provenance and BibTeX. It fetches nothing, so it opens without a network. What cannot be shown is listed with the reason,
//! such as a wire that was not recorded. Every figure and table is marked "research use only", and SIMULATED if no measured
//! data was registered.
//!
//! [`summary`] computes the statistics of a sweep and formats them as rows for pages and terminals; [`reproduction`]
//! compares the paper's numbers with those of its experiments; [`diagram`] converts plans and runs for `osteoflow-draw`.
//!
//! ```no_run
//! let report = osteoflow_report::of_run("runs/fibula".as_ref(), &osteoflow_standard::registry())?;
//! report.write("runs/fibula".as_ref(), "runs/fibula/report.html".as_ref())?;
//! # Ok::<(), osteoflow_report::ReportError>(())
//! ```

mod cell;
mod chart;
mod citations;
pub mod diagram;
pub mod format;
mod html;
mod methods;
mod modules;
mod provenance;
pub mod reproduction;
mod run;
mod run_folder;
mod scene;
pub mod summary;
mod sweep;
mod tables;

pub use cell::Cell;
pub use chart::RESEARCH;
pub use html::Figure;
pub use run::of_run;
pub use sweep::of_sweep;

use osteoflow_engine::durable;
use std::{fs, io, path::Path};

/// A report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// The page as HTML.
    pub html: String,
    /// The figures.
    pub figures: Vec<Figure>,
    /// The literature as BibTeX.
    pub bibliography: String,
    /// What is wrong with the files that it was made from; also at the top of the page.
    pub fault: Option<String>,
}

/// Folder for the figures, inside the folder of the run or sweep.
pub const FIGURES: &str = "figures";
/// Default file name of the page.
pub const PAGE: &str = "report.html";
/// File name of the literature.
pub const BIBLIOGRAPHY: &str = "citations.bib";

/// An error that prevents a report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A file could not be read.
    #[error("{path} cannot be read: {source}")]
    Read {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
    /// A file does not have the form that a run or a sweep writes.
    #[error("{path} was not written by a run or a sweep: {what}")]
    Form {
        /// The file.
        path: String,
        /// What is wrong.
        what: String,
    },
    /// A file could not be written.
    #[error("{path} cannot be written: {source}")]
    Write {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
    /// The folder of a sweep cannot be used.
    #[error(transparent)]
    Sweep(#[from] osteoflow_engine::sweep::FolderError),
}

impl Report {
    /// Writes the page to `page`, and figures and literature into `dir`. Figures of an earlier report are replaced; views that
    /// this report does not have are removed.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, dir: &Path, page: &Path) -> Result<(), ReportError> {
        let to = |path: &Path, text: &str| {
            durable::write(path, text.as_bytes())
                .map_err(|source| ReportError::Write { path: path.display().to_string(), source })
        };
        let figures = dir.join(FIGURES);
        let failed = |source| ReportError::Write { path: figures.display().to_string(), source };
        fs::create_dir_all(&figures).map_err(failed)?;
        if figures.is_symlink() {
            return Err(failed(io::Error::other("it is a link, and figures are written into the folder itself")));
        }
        for figure in &self.figures {
            // Names come from graphs: no separator may lead out of the folder.
            let name = figure.name.replace(['/', '\\'], "_");
            to(&figures.join(format!("{name}.svg")), &figure.svg)?;
        }
        self.remove_stale(&figures)?;
        to(&dir.join(BIBLIOGRAPHY), &self.bibliography)?;
        to(page, &self.html)
    }

    /// Removes views of an earlier report that this one does not have.
    fn remove_stale(&self, figures: &Path) -> Result<(), ReportError> {
        let failed = |source| ReportError::Write { path: figures.display().to_string(), source };
        for entry in fs::read_dir(figures).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
            let ours = stem.starts_with(html::VIEW) && path.extension().is_some_and(|end| end == "svg");
            if ours && self.figures.iter().all(|figure| figure.name != stem) {
                fs::remove_file(&path).map_err(failed)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_of_an_earlier_report_are_removed_and_other_files_stay() {
        let dir = tempfile::tempdir().unwrap();
        let figures = dir.path().join(FIGURES);
        let report = |name: &str| Report {
            html: String::new(),
            figures: vec![Figure { name: name.into(), svg: String::new() }],
            bibliography: String::new(),
            fault: None,
        };
        report("view-fragment-run-7").write(dir.path(), &dir.path().join(PAGE)).unwrap();
        fs::write(figures.join("mine.svg"), "").unwrap();
        report("view-fragment-run-8").write(dir.path(), &dir.path().join(PAGE)).unwrap();
        let left = |name: &str| figures.join(name).is_file();
        assert!(left("view-fragment-run-8.svg") && left("mine.svg") && !left("view-fragment-run-7.svg"));
    }
}
