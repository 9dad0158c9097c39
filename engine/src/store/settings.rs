use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};

/// The variable that names the store's folder, or turns it off.
const DIR_VARIABLE: &str = "OSTEOFLOW_CACHE";
/// The variable that says how much it may hold.
const SIZE_VARIABLE: &str = "OSTEOFLOW_CACHE_MAX_MB";
/// The word that turns it off.
const OFF: &str = "off";

/// Where the store lies and how much it may hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// Its folder.
    pub dir: PathBuf,
    /// The most it may hold, heads and all.
    pub max_bytes: u64,
}

/// A variable that cannot be understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{SIZE_VARIABLE} is \"{found}\", but a whole number of megabytes was expected, such as 1024")]
pub struct SettingsError {
    /// What it says.
    pub found: String,
}

impl Settings {
    /// 1 GiB: a hundred prepared surfaces of 10 MB, or sixty with their closest-point fields, and less than one day of
    /// recordings takes.
    pub const MAX_BYTES: u64 = 1 << 30;

    /// A folder that holds [`Settings::MAX_BYTES`].
    pub fn in_dir(dir: impl Into<PathBuf>) -> Self {
        Self { dir: dir.into(), max_bytes: Self::MAX_BYTES }
    }

    /// What the environment says: `OSTEOFLOW_CACHE` is the folder, or `off`; `OSTEOFLOW_CACHE_MAX_MB` the size. Without
    /// them, a folder `osteoflow` where the platform keeps caches. `None`: it is off, or there is no such place.
    ///
    /// # Errors
    /// [`SettingsError`] if the size is no number.
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

/// Where caches lie on this platform.
fn of_platform(said: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    // A relative path there is no setting, says the XDG specification, and is none of a home either.
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
