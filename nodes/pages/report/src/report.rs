//! A report, and the files that it is written to.

use crate::{
    chart::NUMBERS,
    error::ReportError,
    html::{Figure, VIEW},
};
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
            let (table, head) = (figures.join(format!("{name}.csv")), NUMBERS.join(","));
            if table.exists() && !fs::read(&table).map_err(failed)?.starts_with(head.as_bytes()) {
                let why = format!("{name}.csv does not begin with {head}, so no report wrote it; move it or rename it");
                return Err(failed(io::Error::other(why)));
            }
            if !figure.csv.is_empty() {
                to(&table, &figure.csv)?;
            }
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
            let ours = stem.starts_with(VIEW) && path.extension().is_some_and(|end| end == "svg");
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
            figures: vec![Figure { name: name.into(), svg: String::new(), csv: format!("{},x\n", NUMBERS.join(",")) }],
            bibliography: String::new(),
            fault: None,
        };
        report("view-fragment-run-7").write(dir.path(), &dir.path().join(PAGE)).unwrap();
        fs::write(figures.join("mine.svg"), "").unwrap();
        report("view-fragment-run-8").write(dir.path(), &dir.path().join(PAGE)).unwrap();
        let left = |name: &str| figures.join(name).is_file();
        assert!(left("view-fragment-run-8.svg") && left("mine.svg") && !left("view-fragment-run-7.svg"));
        let table = figures.join("view-fragment-run-8.csv");
        report("view-fragment-run-8").write(dir.path(), &dir.path().join(PAGE)).unwrap();
        fs::write(&table, "run,tre_mm\n1,0.5\n").unwrap();
        let error = report("view-fragment-run-8").write(dir.path(), &dir.path().join(PAGE)).unwrap_err().to_string();
        assert!(error.contains("view-fragment-run-8.csv does not begin with panel,"), "{error}");
        assert_eq!(fs::read_to_string(&table).unwrap(), "run,tre_mm\n1,0.5\n", "a table of the user stays");
    }
}
