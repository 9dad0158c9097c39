//! Nearest known names, patterns over names, and texts that are too long.

pub mod glob;
pub mod nearest;

/// The text if it has at most `n` characters, otherwise its beginning with `..`.
pub fn shortened(text: &str, n: usize) -> String {
    match text.char_indices().nth(n) {
        Some((at, _)) => format!("{}..", &text[..at]),
        None => text.into(),
    }
}
