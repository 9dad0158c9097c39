//! Reads the bytes of a file from front to back: lines and words of a text, numbers of a binary.
//!
//! The cursor counts the place for messages, and compares what a file promises with the bytes that are left of it.

use crate::{
    FileError,
    scalar::{self, Scalar},
    space::StatedSpace,
};
use std::{borrow::Cow, path::Path};

/// What some programs put before a text in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// A place in the bytes of a file. A copy of it is a place to return to.
#[derive(Clone, Copy)]
pub(crate) struct Cursor<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    /// The next byte.
    pub(crate) at: usize,
    /// The line that was read last, from 1 on; 0 before the first.
    pub(crate) line: usize,
    /// Whether what follows is binary, so that places in messages are bytes.
    pub(crate) is_binary: bool,
}

impl<'a> Cursor<'a> {
    pub(crate) fn new(path: &'a Path, bytes: &'a [u8]) -> Self {
        Self { path, bytes, at: 0, line: 0, is_binary: false }
    }

    /// At the beginning of a text, behind its byte-order mark.
    ///
    /// # Errors
    /// [`FileError`] if the text is one line to this reader, but many to its writer.
    pub(crate) fn text(path: &'a Path, bytes: &'a [u8]) -> Result<Self, FileError> {
        if bytes.contains(&b'\r') && !bytes.contains(&b'\n') {
            let message = "lines end with CR alone; save the file with LF or CR LF as line ends";
            return Err(FileError::content(path, "byte 0", message));
        }
        Ok(Self::new(path, without_byte_order_mark(bytes)))
    }

    /// The bytes that are left.
    pub(crate) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// The next line without its end; none at the end of the file. Only comments may be in another encoding than UTF-8.
    pub(crate) fn line(&mut self) -> Option<Cow<'a, str>> {
        let rest = self.rest();
        if rest.is_empty() {
            return None;
        }
        let n = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at += (n + 1).min(rest.len());
        self.line += 1;
        let n = rest[..n].iter().rposition(|&b| b != b'\r').map_or(0, |last| last + 1);
        Some(String::from_utf8_lossy(&rest[..n]))
    }

    /// The next line that is not blank; none at the end of the file.
    pub(crate) fn filled_line(&mut self) -> Option<Cow<'a, str>> {
        std::iter::from_fn(|| self.line()).find(|line| !line.trim().is_empty())
    }

    /// The next line with words before its comment, without the comment, whose statements are taken; none at the end of the
    /// file.
    pub(crate) fn uncommented_line(&mut self, stated: &mut StatedSpace) -> Result<Option<String>, FileError> {
        while let Some(line) = self.line() {
            let (content, comment) = line.split_once('#').unwrap_or((&line, ""));
            stated.take(comment).map_err(|message| self.fault(message))?;
            if !content.trim().is_empty() {
                return Ok(Some(content.trim().to_owned()));
            }
        }
        Ok(None)
    }

    /// The error of a file that ends with item `k` of `n` items.
    pub(crate) fn cut_short(&self, k: usize, n: usize, what: &str) -> FileError {
        self.fault(format!("the file ends after {k} of {n} {what}; was it cut short?"))
    }

    /// The next word and its line; none at the end of the file. A word may be anywhere in a line.
    #[inline]
    pub(crate) fn word(&mut self) -> Option<(&'a [u8], usize)> {
        let mut at = self.at;
        // The line that was read last is complete, so the word is on one behind it.
        while let Some(byte) = self.bytes.get(at).filter(|byte| byte.is_ascii_whitespace()) {
            self.line += usize::from(*byte == b'\n');
            at += 1;
        }
        let rest = &self.bytes[at..];
        let n = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.at = at + n;
        (n > 0).then(|| (&rest[..n], self.line + 1))
    }

    /// Passes over blanks and the end of the line behind a word.
    pub(crate) fn end_line(&mut self) {
        let rest = self.rest();
        let blank = rest.iter().position(|&b| !matches!(b, b' ' | b'\t' | b'\r')).unwrap_or(rest.len());
        if rest.get(blank) == Some(&b'\n') {
            self.at += blank + 1;
            self.line += 1;
        }
    }

    /// The next `n` bytes, which are `what`.
    pub(crate) fn take(&mut self, n: usize, what: &str) -> Result<&'a [u8], FileError> {
        let rest = self.rest();
        let taken = rest.get(..n).ok_or_else(|| {
            self.fault(format!("{what} needs {n} bytes, but {} are left; was the file cut short?", rest.len()))
        })?;
        self.at += n;
        Ok(taken)
    }

    /// The next binary number; none if too few bytes are left.
    pub(crate) fn binary_number(&mut self, scalar: Scalar, is_big: bool) -> Option<f64> {
        let value = scalar.first(self.rest(), is_big)?;
        self.at += scalar.n_bytes();
        Some(value)
    }

    /// Checks that `n` items of at least `n_bytes` each may follow, before anything is allocated for them.
    pub(crate) fn promised(&self, n: usize, n_bytes: usize, what: &str) -> Result<(), FileError> {
        // The last item of a text needs no line end.
        let left = self.rest().len();
        if n.saturating_mul(n_bytes) > left + usize::from(!self.is_binary) {
            let message = format!("{n} {what} are promised, but {left} bytes are left; was the file cut short?");
            return Err(self.fault(message));
        }
        Ok(())
    }

    /// Checks that nothing follows the last of the items; `stride` is the bytes of one, if all have as many. Gives a note on
    /// bytes that are no items.
    pub(crate) fn end(mut self, item: &str, items: &str, stride: Option<usize>) -> Result<Option<String>, FileError> {
        let (n, at) = (self.rest().len(), self.at);
        let more = match stride {
            _ if !self.is_binary => self.filled_line().map(|_| "more lines".to_owned()),
            Some(stride) if n.is_multiple_of(stride) => Some(format!("{} more {items}", n / stride)),
            _ => None,
        };
        match more.filter(|_| n > 0) {
            Some(more) => Err(self.more(&more)),
            None if n == 0 || !self.is_binary => Ok(None),
            None => Ok(Some(format!("{n} bytes follow the last {item}, from byte {at} on, and were not read"))),
        }
    }

    /// The error of a file that goes on, with these, behind the last item that its header counts.
    pub(crate) fn more(&self, items: &str) -> FileError {
        self.fault(format!("{items} follow than the header counts; do header and data belong together?"))
    }

    /// A number of a text.
    pub(crate) fn number(&self, word: &str) -> Result<f64, FileError> {
        scalar::number(word).ok_or_else(|| self.fault(format!("\"{word}\" is not a number")))
    }

    /// A count in a text.
    pub(crate) fn count(&self, word: &str) -> Result<usize, FileError> {
        word.parse().map_err(|_| self.fault(format!("\"{word}\" is not a count")))
    }

    /// An error at the line that was read last, or at the next byte of a binary.
    pub(crate) fn fault(&self, message: impl Into<String>) -> FileError {
        match self.is_binary {
            true => FileError::content(self.path, format!("byte {}", self.at), message),
            false => self.fault_at(self.line.max(1), message),
        }
    }

    /// An error at a line.
    pub(crate) fn fault_at(&self, line: usize, message: impl Into<String>) -> FileError {
        FileError::content(self.path, format!("line {line}"), message)
    }

    /// An error of the file's header.
    pub(crate) fn header_fault(&self, message: impl Into<String>) -> FileError {
        FileError::content(self.path, "header", message)
    }
}

/// The bytes behind the byte-order mark that some programs put before a text in UTF-8.
pub(crate) fn without_byte_order_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes)
}

/// Whether the first kilobyte is text: a binary header is mostly zeros, and floats are not text.
pub(crate) fn is_text(bytes: &[u8]) -> bool {
    bytes.iter().take(1024).all(|&b| b >= b' ' || b.is_ascii_whitespace())
}

/// Whether the first line that is neither blank nor a comment satisfies `is_it`.
pub(crate) fn first_line(bytes: &[u8], is_it: impl FnOnce(&[u8]) -> bool) -> bool {
    let mut lines = without_byte_order_mark(bytes).split(|&b| b == b'\n').map(<[u8]>::trim_ascii);
    lines.find(|line| !(line.is_empty() || line.starts_with(b"#"))).is_some_and(is_it)
}
