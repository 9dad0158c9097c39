//! Regular files: opening a pipe waits for a writer and a device may never end, so they are refused before they are opened.

use std::{fs, io, path::Path};

/// The path, to be opened.
///
/// # Errors
/// If it leads to a device, pipe or socket.
pub fn regular<P: AsRef<Path>>(path: P) -> io::Result<P> {
    let message = |kind| io::Error::other(format!("it is {kind}, but a regular file is needed"));
    irregular(path.as_ref()).map_or(Ok(path), |kind| Err(message(kind)))
}

/// What the path leads to, if it is there and neither a regular file nor a folder: `a pipe`.
pub fn irregular(path: &Path) -> Option<&'static str> {
    let file_type = fs::metadata(path).ok()?.file_type();
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if file_type.is_char_device() || file_type.is_block_device() {
            return Some("a device");
        }
        if file_type.is_fifo() || file_type.is_socket() {
            return Some(if file_type.is_fifo() { "a pipe" } else { "a socket" });
        }
    }
    (!file_type.is_file() && !file_type.is_dir()).then_some("no regular file")
}
