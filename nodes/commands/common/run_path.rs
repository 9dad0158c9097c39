//! A run by its folder or by its recording: commands that read runs take either.

use crate::app::{UsageError, files::Data};
use osteoflow_engine::{run::files, sweep};
use osteoflow_formats::probe::Kind;
use std::path::{Path, PathBuf};

/// The recording that `path` names: itself, or that of the run whose folder it is.
///
/// # Errors
/// [`UsageError`] for a folder without a recording, with what to name instead.
pub(crate) fn recording(path: &Path) -> Result<PathBuf, UsageError> {
    let other = |data: Data| {
        let commands = data.commands(path).join("\n  ");
        let message =
            format!("{} is {data}, and the folder of a run or a recording is needed\n  {commands}", path.display());
        Err(UsageError(message))
    };
    if !path.is_dir() {
        let data = Data::of(path).filter(|data| data.kind() != Some(Kind::Recording));
        return data.map_or_else(|| Ok(path.into()), other);
    }
    let inside = path.join(files::RECORDING);
    if inside.is_file() {
        return Ok(inside);
    }
    let why = if path.join(files::MANIFEST).is_file() {
        "this run was not recorded (--no-record); run it again without that"
    } else if path.join(sweep::DESIGN).is_file() {
        "it is the folder of a sweep; name the recording of one run"
    } else if path.join("metadata.yaml").is_file() {
        "it is the bag of another program; name one of its .mcap files"
    } else if let Some(data) = Data::of(path) {
        return other(data);
    } else {
        "name the folder of a run, or a recording"
    };
    Err(UsageError(format!("{}: the folder holds no {}: {why}", path.display(), files::RECORDING)))
}

/// The folder that `path` names: itself, or that of the run whose recording it is.
pub(crate) fn folder(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if path.is_file() && path.file_name().is_some_and(|name| name == files::RECORDING) => {
            if folder.as_os_str().is_empty() { Path::new(".").into() } else { folder.into() }
        }
        _ => path.into(),
    }
}
