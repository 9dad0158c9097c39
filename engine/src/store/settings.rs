use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};

/// Environment variable with the store's folder, or `off`.
const DIR_VARIABLE: &str = "OSTEOFLOW_CACHE";
/// Environment variable with the store's maximum size.
const SIZE_VARIABLE: &str = "OSTEOFLOW_CACHE_MAX_MB";
/// The value that turns the store off.
const OFF: &str = "off";

/// Folder and size of the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// Its folder.
    pub dir: PathBuf,
    /// Maximum size, headers included.
    pub max_bytes: u64,
}

/// An environment variable with an invalid value.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{SIZE_VARIABLE} is \"{found}\", but a whole number of megabytes was expected, such as 1024")]
pub struct SettingsError {
    /// The value found.
    pub found: String,
}

impl Settings {
    /// 1 GiB: a hundred prepared surfaces of 10 MB, and less than a day of recordings.
    pub const MAX_BYTES: u64 = 1 << 30;

    /// Settings for a folder with [`Settings::MAX_BYTES`].
    pub fn in_dir(dir: impl Into<PathBuf>) -> Self {
        Self { dir: dir.into(), max_bytes: Self::MAX_BYTES }
    }

    /// Reads the environment: `OSTEOFLOW_CACHE` is the folder, or `off`; `OSTEOFLOW_CACHE_MAX_MB` the size. By default,
    /// the folder `osteoflow` in the platform's cache directory. `None` if the store is off, or there is no such
    /// directory.
    ///
    /// # Errors
    /// [`SettingsError`] if the size is not a number.
    pub fn from_env() -> Result<Option<Self>, SettingsError> {
        Self::of(|name| std::env::var_os(name))
    }

    pub(super) fn of(variable: impl Fn(&str) -> Option<OsString>) -> Result<Option<Self>, SettingsError> {
        let said = |name: &str| variable(name).filter(|value| !value.is_empty());
        let max_bytes = match said(SIZE_VARIABLE).map(|value| value.to_string_lossy().into_owned()) {
            None => Self::MAX_BYTES,
            Some(found) => match found.trim().parse::<u64>() {
                Ok(megabytes) => megabytes.saturating_mul(1_000_000),
                Err(_) => return Err(SettingsError { found }),
            },
        };
        let dir = match said(DIR_VARIABLE) {
            Some(word) if word == OFF => None,
            Some(dir) => Some(std::path::absolute(&dir).unwrap_or_else(|_| dir.into())),
            None => of_platform(said),
        };
        Ok(dir.map(|dir| Self { dir, max_bytes }))
    }
}

/// The platform's cache directory.
fn of_platform(said: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    // The XDG specification ignores relative paths.
    let dir = |name: &str| said(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let caches = if cfg!(windows) {
        dir("LOCALAPPDATA")
    } else if cfg!(target_os = "macos") {
        dir("HOME").map(|home| home.join("Library/Caches"))
    } else {
        dir("XDG_CACHE_HOME").or_else(|| dir("HOME").map(|home| home.join(".cache")))
    };
    caches.map(|caches| caches.join(Path::new("osteoflow")))
}
