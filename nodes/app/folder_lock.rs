//! Exclusive use of an output folder by one process.

use super::{error::UsageError, host};
use anyhow::{Context, Result};
use jiff::Timestamp;
use serde_json::{Value, json};
use std::{
    fs::{self, File, TryLockError},
    io::{self, Write},
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

/// File that says which process writes into the folder. It is removed when that process is done; one that a killed process
/// leaves is ignored, because the system releases the lock.
pub(crate) const HOLDER: &str = ".osteoflow-running";

/// How often, and after which time, a file that is being written is read again.
const N_LOOKS: usize = 20;
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// A folder that no other process writes into.
#[derive(Debug)]
pub(crate) struct FolderLock {
    dir: PathBuf,
    /// The locked folder, where the system can lock folders.
    _locked: Option<File>,
}

impl FolderLock {
    /// Locks an existing folder.
    ///
    /// # Errors
    /// If another process has it, which the message names, or the folder cannot be written.
    pub(crate) fn take(dir: &Path) -> Result<Self> {
        let opened = File::open(dir);
        let locked = match opened.as_ref().map(File::try_lock) {
            Ok(Ok(())) => opened.ok(),
            Ok(Err(TryLockError::WouldBlock)) => return Err(in_use(dir, "")),
            // Windows opens no folders, and some network file systems lock none.
            Ok(Err(TryLockError::Error(_))) | Err(_) => None,
        };
        let path = dir.join(HOLDER);
        if locked.is_some() {
            let _ = fs::remove_file(&path);
        }
        match File::options().write(true).create_new(true).open(&path) {
            Ok(mut file) => {
                let text = json!({
                    "process": std::process::id(),
                    "began": Timestamp::now().to_string(),
                    "arguments": host::arguments(),
                });
                let _ = writeln!(file, "{text}");
                Ok(Self { dir: dir.into(), _locked: locked })
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                Err(in_use(dir, &format!("; if that process has been killed, remove {}", path.display())))
            }
            Err(error) => Err(error).with_context(|| format!("{} cannot be written", path.display())),
        }
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // Before the lock is released, so that the file of the next process is not removed.
        let _ = fs::remove_file(self.dir.join(HOLDER));
    }
}

/// Content of the file that names the holder, which writes it after it has locked the folder.
fn holder(dir: &Path) -> Value {
    for _ in 0..N_LOOKS {
        let text = fs::read_to_string(dir.join(HOLDER)).unwrap_or_default();
        if let Ok(holder) = serde_json::from_str(&text) {
            return holder;
        }
        thread::sleep(LOOK_AGAIN);
    }
    Value::Null
}

fn in_use(dir: &Path, note: &str) -> anyhow::Error {
    let holder = holder(dir);
    let who = match (&holder["process"], holder["began"].as_str()) {
        (Value::Number(process), Some(began)) => {
            let arguments: Vec<_> =
                holder["arguments"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
            format!("process {process} (osteoflow {}), since {began}", arguments.join(" "))
        }
        _ => "another process".into(),
    };
    let message = format!("{} is in use by {who}; wait for its end, or name another folder{note}", dir.display());
    UsageError(message).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_is_refused_by_name_of_the_first_until_it_ends() {
        let dir = tempfile::tempdir().unwrap();
        let first = FolderLock::take(dir.path()).unwrap();
        let refused = FolderLock::take(dir.path()).unwrap_err().to_string();
        assert!(refused.contains(&format!("in use by process {}", std::process::id())), "{refused}");
        drop(first);
        assert!(!dir.path().join(HOLDER).exists());
        // What a killed process leaves.
        fs::write(dir.path().join(HOLDER), "{}").unwrap();
        if cfg!(unix) {
            FolderLock::take(dir.path()).unwrap();
        }
    }
}
