//! CSV with a header; errors name line and column.

use crate::{
    FileError,
    columns::{is_missing, twice},
};
use std::{borrow::Cow, path::Path};

/// A CSV file: between commas, or between semicolons or tabs with a decimal point or comma; columns found by name, blank lines and
/// lines that begin with `#` passed over.
pub(crate) struct Table<'a> {
    path: &'a Path,
    separator: char,
    header: Vec<String>,
    records: Vec<(u64, csv::StringRecord)>,
}

/// One row of a table.
pub(crate) struct Row<'a> {
    table: &'a Table<'a>,
    line: u64,
    record: &'a csv::StringRecord,
}

/// What separates the columns of a heading: the one of comma, semicolon and tab of which there are most.
pub(crate) fn separator(heading: &str) -> char {
    // Of equals the last is taken: a comma.
    ['\t', ';', ','].into_iter().max_by_key(|separator| heading.matches(*separator).count()).unwrap_or(',')
}

impl<'a> Table<'a> {
    pub(crate) fn parse(path: &'a Path, bytes: &[u8]) -> Result<Self, FileError> {
        // Spreadsheets put a byte-order mark in front of the first name.
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let lines = bytes.split(|b| *b == b'\n').map(<[u8]>::trim_ascii);
        let heading = lines.into_iter().find(|line| !line.is_empty() && !line.starts_with(b"#")).unwrap_or_default();
        let separator = separator(&String::from_utf8_lossy(heading));
        let mut builder = csv::ReaderBuilder::new();
        let builder = builder.trim(csv::Trim::All).comment(Some(b'#')).delimiter(separator as u8);
        let mut reader = builder.from_reader(bytes);
        let fault = |error: csv::Error| {
            let line = error.position().map_or(1, csv::Position::line);
            let message = match error.kind() {
                csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                    let more = len.saturating_sub(*expected_len);
                    // Numbers of which some have a decimal comma; a word would not be cut by one.
                    let is_comma = more > 0 && more <= *expected_len;
                    let comma = if is_comma { "; a decimal comma? write 1.5, not 1,5" } else { "" };
                    format!("the header names {expected_len} columns, this line has {len}{comma}")
                }
                _ => error.to_string(),
            };
            FileError::content(path, format!("line {line}"), message)
        };
        let header: Vec<String> = reader.headers().map_err(fault)?.iter().map(String::from).collect();
        twice(&header, |a, b| a == b && !a.is_empty())
            .map_err(|message| FileError::content(path, "line 1", message))?;
        let mut records = Vec::new();
        for record in reader.records() {
            let record = record.map_err(fault)?;
            let line = record.position().map_or(0, csv::Position::line);
            records.push((line, record));
        }
        Ok(Self { path, separator, header, records })
    }

    /// The place of a column.
    pub(crate) fn column(&self, name: &str) -> Result<usize, FileError> {
        self.header.iter().position(|h| h == name).ok_or_else(|| {
            let message = format!("the header has no column \"{name}\"; it reads {}", self.header.join(","));
            FileError::content(self.path, "line 1", message)
        })
    }

    pub(crate) fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        self.records.iter().map(|(line, record)| Row { table: self, line: *line, record })
    }
}

impl<'a> Row<'a> {
    pub(crate) fn text(&self, column: usize) -> &'a str {
        self.record.get(column).unwrap_or_default()
    }

    /// A text that must not be empty.
    pub(crate) fn named(&self, column: usize) -> Result<&'a str, FileError> {
        match self.text(column) {
            "" => Err(self.fault(format!("column \"{}\" is empty", self.table.header[column]))),
            text => Ok(text),
        }
    }

    pub(crate) fn whole(&self, column: usize) -> Result<i64, FileError> {
        let text = self.text(column);
        let name = &self.table.header[column];
        text.parse().map_err(|_| self.fault(format!("{name} is \"{text}\", a whole number is expected")))
    }

    /// A number; NaN if the cell is empty or says that there is none.
    pub(crate) fn number(&self, column: usize) -> Result<f64, FileError> {
        let text = self.text(column);
        let name = &self.table.header[column];
        if is_missing(text) {
            return Ok(f64::NAN);
        }
        self.decimal(text).parse().map_err(|_| self.fault(format!("{name} is \"{text}\", a number is expected")))
    }

    /// A number with a decimal point, where commas do not separate.
    fn decimal(&self, text: &'a str) -> Cow<'a, str> {
        if self.table.separator == ',' { text.into() } else { text.replace(',', ".").into() }
    }

    /// A number that is not NaN.
    pub(crate) fn finite(&self, column: usize) -> Result<f64, FileError> {
        let value = self.number(column)?;
        if value.is_finite() {
            return Ok(value);
        }
        Err(self.fault(format!("{} is \"{}\", a number is expected", self.table.header[column], self.text(column))))
    }

    /// The row's place in the file.
    pub(crate) fn line(&self) -> u64 {
        self.line
    }

    pub(crate) fn fault(&self, message: String) -> FileError {
        FileError::content(self.table.path, format!("line {}", self.line), message)
    }
}
