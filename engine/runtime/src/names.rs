//! Nearest known names, and patterns over names.

pub mod glob;
pub mod nearest;

/// The known name that was probably meant by `found`.
pub fn nearest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    nearest::name(found, known)
}
