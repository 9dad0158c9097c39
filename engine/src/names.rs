//! Names: the known one that is nearest to an unknown one, and patterns over them.

pub(crate) mod glob;
pub(crate) mod nearest;

/// The known name that was probably meant by `found`.
pub fn nearest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    nearest::name(found, known)
}
