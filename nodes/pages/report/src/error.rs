use std::io;

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
