//! Outliers at one end of a log.

/// Whether these indices are the first or the last of `n`, but for a tenth of them.
pub(super) fn is_at_one_end(indices: &[usize], n: usize) -> bool {
    let (Some(first), Some(last)) = (indices.first(), indices.last()) else { return false };
    let span = indices.len() + indices.len() / 10;
    *last < span || n - first <= span
}
