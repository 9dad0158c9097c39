//! Standard output and error without control sequences from files.
//!
//! Names and messages may come from files of strangers. Control characters in them would move the cursor, rewrite lines or
//! hide text; they are printed as escapes, such as `\u{1b}`, as are characters that reverse the direction of text. Only the
//! colours that this program uses pass.

use serde_json::Value;
use std::{
    fmt,
    io::{self, Stderr, StderrLock, Stdout, StdoutLock, Write},
};

/// Codes of the styles and colours that pass: reset, bold, dim, italic, underlined, their ends, and foregrounds.
const STYLES: [&str; 26] = [
    "", "0", "1", "2", "3", "4", "22", "23", "24", "31", "32", "33", "34", "35", "36", "39", "91", "92", "93", "94",
    "95", "96", "38;5;9", "38;5;11", "38;5;12", "38;5;14",
];

/// A stream that escapes control characters.
#[derive(Debug)]
pub(crate) struct Escaped<W>(W);

/// Standard output.
pub(crate) fn stdout() -> Escaped<Stdout> {
    Escaped(io::stdout())
}

/// Standard error.
pub(crate) fn stderr() -> Escaped<Stderr> {
    Escaped(io::stderr())
}

impl Escaped<Stdout> {
    pub(crate) fn lock(self) -> Escaped<StdoutLock<'static>> {
        Escaped(self.0.lock())
    }
}

impl Escaped<Stderr> {
    pub(crate) fn lock(self) -> Escaped<StderrLock<'static>> {
        Escaped(self.0.lock())
    }
}

impl<W: Write> Write for Escaped<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match std::str::from_utf8(bytes) {
            Ok(text) if !text.contains(is_control) => self.0.write_all(bytes)?,
            _ => self.0.write_all(escape(&String::from_utf8_lossy(bytes)).as_bytes())?,
        }
        Ok(bytes.len())
    }

    /// Writes a formatted line at once, so that lines of several threads do not mix.
    fn write_fmt(&mut self, text: fmt::Arguments<'_>) -> io::Result<()> {
        self.write_all(text.to_string().as_bytes())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// The text with control characters as escapes.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        if let Some(style) = style(rest) {
            out += style;
            rest = &rest[style.len()..];
            continue;
        }
        if is_control(c) {
            out.extend(c.escape_unicode());
        } else {
            out.push(c);
        }
        rest = &rest[c.len_utf8()..];
    }
    out
}

/// The sequence of a style that passes, at the start of `text`.
fn style(text: &str) -> Option<&str> {
    let codes = text.strip_prefix("\x1b[")?;
    let codes = &codes[..codes.find('m')?];
    let all_pass = STYLES.contains(&codes) || codes.split(';').all(|code| STYLES.contains(&code));
    all_pass.then(|| &text[.."\x1b[m".len() + codes.len()])
}

/// Control characters but for line ends and tabs, and characters that change the direction of text.
fn is_control(c: char) -> bool {
    c.is_control() && c != '\n' && c != '\t'
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Prints the JSON value of a command.
pub(crate) fn print_json(value: &Value) -> anyhow::Result<()> {
    writeln!(stdout(), "{}", serde_json::to_string_pretty(value)?)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_shown_and_colours_pass() {
        for (text, shown) in [
            ("a\tb\n", "a\tb\n"),
            ("\x1b[1;31merror\x1b[0m", "\x1b[1;31merror\x1b[0m"),
            ("\x1b[38;5;12mnote\x1b[m", "\x1b[38;5;12mnote\x1b[m"),
            ("\x1b[8mhidden", "\\u{1b}[8mhidden"),
            ("\x1b[30;40mhidden", "\\u{1b}[30;40mhidden"),
            ("\x1b[2J\x1b[H", "\\u{1b}[2J\\u{1b}[H"),
            ("\x1b]0;title\x07", "\\u{1b}]0;title\\u{7}"),
            ("one\rtwo\u{8}\u{9b}1m", "one\\u{d}two\\u{8}\\u{9b}1m"),
            ("a\u{202e}b", "a\\u{202e}b"),
            ("\x1b[1", "\\u{1b}[1"),
        ] {
            let mut out = Escaped(Vec::new());
            out.write_all(text.as_bytes()).unwrap();
            assert_eq!(String::from_utf8(out.0).unwrap(), shown);
        }
        let mut out = Escaped(Vec::new());
        out.write_all(b"\xff\x1bx").unwrap();
        assert_eq!(String::from_utf8(out.0).unwrap(), "\u{fffd}\\u{1b}x");
    }
}
