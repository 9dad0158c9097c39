use std::path::{Path, PathBuf};

/// A file that could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file is missing, may not be read, or the disk is full.
    #[error("{}: cannot be {action}: {}", path.display(), why(path, source))]
    Io {
        /// The file.
        path: PathBuf,
        /// `read` or `written`.
        action: &'static str,
        /// The system's error.
        source: std::io::Error,
    },
    /// The path leads to something else than a file.
    #[error(
        "{}: it is {kind}, but a regular file is needed; {}",
        path.display(), if path.is_dir() { "name a file in it" } else { "copy what it gives into a file" }
    )]
    Kind {
        /// The path.
        path: PathBuf,
        /// What it is.
        kind: &'static str,
    },
    /// The content of the file is invalid.
    #[error("{}: {place}: {message}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Line, byte or key.
        place: String,
        /// Expected, found, and a next step.
        message: String,
    },
}

impl FileError {
    pub(crate) fn content(path: &Path, place: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Content { path: path.into(), place: place.into(), message: message.into() }
    }

    pub(crate) fn read(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.into(), action: "read", source }
    }

    pub(crate) fn write(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { path: path.into(), action: "written", source }
    }
}

/// Why a file cannot be read or written: what is missing, else the words of the system.
fn why(path: &Path, source: &std::io::Error) -> String {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    match (source.kind(), folder) {
        (std::io::ErrorKind::NotFound, Some(folder)) if !folder.exists() => {
            format!("there is no folder {}", folder.display())
        }
        (std::io::ErrorKind::NotFound, _) if !path.exists() => "there is no such file".into(),
        _ => source.to_string(),
    }
}
