//! Columns of numbers in a text: their rows, their heading, and how a line is cut into cells.

use crate::{FileError, cursor::Cursor, scalar, space::StatedSpace, unit};
use std::borrow::Cow;

/// Number of rows that are looked at to tell a separator from a decimal comma.
const N_LOOKED_AT: usize = 100;

/// A line that is no comment, and its number.
pub(crate) type Row<'a> = (Cow<'a, str>, usize);

/// The names of columns, and the line of the heading.
pub(crate) type Heading = (Vec<String>, usize);

/// The lines of a text of columns.
#[derive(Default)]
pub(crate) struct Lines<'a> {
    /// The lines that are neither blank nor comments.
    pub(crate) rows: Vec<Row<'a>>,
    /// The last comment that names columns.
    pub(crate) heading: Option<Heading>,
    pub(crate) stated: StatedSpace,
}

impl<'a> Lines<'a> {
    /// Reads a text to its end. A comment begins with `#` or `//`, unless `is_row` takes what follows for a row; it is a
    /// heading if `is_heading` says so of its names and the rows before it.
    pub(crate) fn read(
        mut cursor: Cursor<'a>,
        is_row: impl Fn(&str) -> bool,
        is_heading: impl Fn(&[String], &[Row]) -> bool,
    ) -> Result<Self, FileError> {
        let mut lines = Self::default();
        while let Some(line) = cursor.filled_line() {
            let line = match line {
                Cow::Borrowed(line) => Cow::Borrowed(line.trim_matches(' ').trim_end()),
                Cow::Owned(line) => Cow::Owned(line.trim_matches(' ').trim_end().to_owned()),
            };
            let comment = line.strip_prefix('#').or_else(|| line.strip_prefix("//"));
            let Some(comment) = comment.filter(|comment| !is_row(comment)) else {
                lines.rows.push((line, cursor.line));
                continue;
            };
            lines.stated.take(comment).map_err(|message| cursor.fault(message))?;
            let names = heading_names(comment.trim());
            if is_heading(&names, &lines.rows) {
                lines.heading = Some((names, cursor.line));
            }
        }
        Ok(lines)
    }
}

/// The place of a column, in any case; that of an axis may have a unit in its name, see [`name_axes`].
pub(crate) fn place(names: &[String], name: &str) -> Option<usize> {
    let with_unit = |other: &String| axis_and_unit(other).is_some_and(|(axis, _)| axis.eq_ignore_ascii_case(name));
    let exact = names.iter().position(|other| other.eq_ignore_ascii_case(name));
    exact.or_else(|| names.iter().position(with_unit))
}

/// The cells of a line; quotes enclose a cell that holds the separator, and are doubled within it.
pub(crate) fn quoted_cells(line: &str, separator: char) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut quoted = false;
    let mut chars = line.trim_end_matches(['\r', '\n']).chars().peekable();
    while let Some(c) = chars.next() {
        let last = cells.last_mut().expect("there is one");
        match c {
            '"' if quoted && chars.peek() == Some(&'"') => {
                chars.next();
                last.push('"');
            }
            '"' if quoted || last.trim().is_empty() => quoted = !quoted,
            c if c == separator && !quoted => cells.push(String::new()),
            c => last.push(c),
        }
    }
    cells
}

/// The axis and the unit of a name such as `x_mm`, `X [m]` or `z(mm)`.
fn axis_and_unit(name: &str) -> Option<(&str, &str)> {
    let (axis, unit) = name.split_at_checked(1)?;
    let bare = unit.trim_matches([' ', '_', '[', ']', '(', ')']);
    let is_apart = bare.len() < unit.len() || ["mm", "cm", "m", "um"].contains(&bare);
    (is_apart && unit::length_mm(bare).is_some()).then_some((axis, bare))
}

/// Calls columns with a unit in their names, such as `x_mm`, by their axes, and takes that unit for stated.
///
/// # Errors
/// A message, if an axis is there twice, or the axes have different units.
pub(crate) fn name_axes(names: &mut [String], stated: &mut StatedSpace) -> Result<(), String> {
    for axis in ["x", "y", "z"] {
        let is_axis = |name: &&mut String| axis_and_unit(name).is_some_and(|(of, _)| of.eq_ignore_ascii_case(axis));
        let is_bare = names.iter().any(|name| name.eq_ignore_ascii_case(axis));
        let Some(name) = names.iter_mut().find(is_axis) else { continue };
        if is_bare {
            return Err(format!("columns \"{axis}\" and \"{name}\" are both there; leave out one of them"));
        }
        if let Some((_, unit)) = axis_and_unit(name) {
            stated.take(&format!("UNIT={unit}"))?;
        }
        *name = axis.into();
    }
    Ok(())
}

/// The places of x, y and z, which the line names.
pub(crate) fn axes(cursor: &Cursor, names: &[String], line: usize) -> Result<[usize; 3], FileError> {
    // Names of trackers' tables for parts of a pose.
    let is_pose = ["tx", "qw", "qx", "q0", "r00", "rx"].iter().any(|name| place(names, name).is_some());
    let log = if is_pose { LOG_OF_POSES } else { "" };
    if let Some(prefix) = before_a_quaternion(names) {
        let message =
            format!("x, y and z beside w are a quaternion, and {prefix}x, {prefix}y, {prefix}z a place{LOG_OF_POSES}");
        return Err(cursor.fault_at(line, message));
    }
    let axis = |name: &str| {
        let message = || format!("no column is called \"{name}\"; there are: {}{log}", names.join(", "));
        place(names, name).ok_or_else(|| cursor.fault_at(line, message()))
    };
    Ok([axis("x")?, axis("y")?, axis("z")?])
}

const LOG_OF_POSES: &str = "; is it a log of poses? --columns and acquire.poses describe its heading";

/// What the names of a place begin with, in a table in which `w`, `x`, `y` and `z` are those of a rotation.
fn before_a_quaternion(names: &[String]) -> Option<&str> {
    place(names, "w")?;
    let is_there = |name: String| names.iter().any(|other| other.eq_ignore_ascii_case(&name));
    let prefixes = names.iter().filter_map(|name| name.strip_suffix(['x', 'X'])).filter(|prefix| !prefix.is_empty());
    prefixes.into_iter().find(|prefix| ["y", "z"].iter().all(|axis| is_there(format!("{prefix}{axis}"))))
}

/// A message on the first column with the name of one before it.
pub(crate) fn twice(names: &[String], is_same: impl Fn(&str, &str) -> bool) -> Result<(), String> {
    let is_second = |(k, name): &(usize, &String)| names[..*k].iter().any(|other| is_same(other, name));
    match names.iter().enumerate().find(is_second) {
        Some((k, name)) => Err(format!("column {} is called \"{name}\" as one before it is", k + 1)),
        None => Ok(()),
    }
}

/// The words of a heading, with any separator.
pub(crate) fn heading_names(heading: &str) -> Vec<String> {
    let blank = |c: char| c.is_whitespace();
    let separator = [';', ',', '\t'].into_iter().find(|&c| heading.contains(c));
    let bare = |word: &str| word.trim().trim_matches('"').trim().to_owned();
    match separator {
        Some(c) => heading.trim_end_matches(c).split(c).map(bare).collect(),
        None => heading.split(blank).filter(|word| !word.is_empty()).map(bare).collect(),
    }
}

pub(crate) fn has_words(line: &str) -> bool {
    let is_separator = |c: char| c.is_whitespace() || c == ',' || c == ';';
    line.split(is_separator).filter(|word| !is_missing(word)).any(|word| scalar::number(word).is_none())
}

/// Whether a cell stands for a value that is not there, as pandas, R, Excel and SQL write it.
pub(crate) fn is_missing(cell: &str) -> bool {
    ["", "na", "n/a", "#n/a", "<na>", "null", "none", "nan"].iter().any(|word| cell.eq_ignore_ascii_case(word))
}

/// How lines are cut into numbers.
pub(crate) struct Split {
    /// None for blanks.
    pub(crate) separator: Option<char>,
    decimal_comma: bool,
    /// Whether each line ends with a separator that begins no column.
    trailing: bool,
}

impl Split {
    /// The separator of the rows.
    ///
    /// # Errors
    /// Commas are ambiguous.
    pub(crate) fn of(cursor: &Cursor, rows: &[Row], n_names: Option<usize>) -> Result<Self, FileError> {
        let looked_at = || rows.iter().take(N_LOOKED_AT).map(|(line, _)| &**line);
        let first = &*rows[0].0;
        // Commas between digits, none at an end of a word, and at most one a word, are decimal.
        let is_decimal = |word: &str| {
            let mut parts = word.split(',');
            let (whole, fraction, more) = (parts.next().unwrap_or_default(), parts.next(), parts.next());
            let ends = whole.ends_with(|c: char| c.is_ascii_digit())
                && fraction.is_some_and(|part| part.starts_with(|c: char| c.is_ascii_digit()));
            more.is_none() && (fraction.is_none() || ends)
        };
        let blank_words = first.split_whitespace().count();
        let separator = if first.contains(';') {
            Some(';')
        } else if first.contains('\t') && first.split('\t').filter(|cell| !cell.trim().is_empty()).count() >= 3 {
            Some('\t')
        } else if first.contains(',') && !(blank_words >= 3 && first.split_whitespace().all(is_decimal)) {
            Some(',')
        } else {
            None
        };
        let decimal_comma = separator != Some(',') && looked_at().any(|line| line.contains(','));
        // Words are no numbers, whatever their points and commas are for.
        let is_numeric =
            |line: &str| line.chars().all(|c| c.is_ascii_digit() || c.is_whitespace() || "+-.,;eE".contains(c));
        if decimal_comma
            && let Some((line, number)) =
                rows.iter().take(N_LOOKED_AT).find(|(line, _)| line.contains('.') && is_numeric(line))
        {
            let message = format!("\"{line}\" has decimal points, but other numbers have commas; write all alike");
            return Err(cursor.fault_at(*number, message));
        }
        // Points and commas are one when a program prints a decimal comma into a file of comma-separated values.
        if separator == Some(',') && looked_at().all(|line| line.split(',').count() == 6 && !line.contains('.')) {
            let digits = |line: &str, k: usize| {
                let cell = line.split(',').nth(k).unwrap_or_default();
                cell.bytes().all(|b| b.is_ascii_digit()).then_some(cell.len())
            };
            let is_fraction = |k: usize| {
                looked_at().all(|line| digits(line, k).is_some()) && looked_at().any(|line| digits(line, k) >= Some(4))
            };
            if [1, 3, 5].into_iter().all(is_fraction) {
                let message = "six whole numbers between commas look like three numbers with decimal commas; \
                               separate the numbers by semicolons or write decimal points";
                return Err(cursor.fault_at(rows[0].1, message));
            }
        }
        let trailing = separator.is_some_and(|c| first.ends_with(c) && n_names != Some(first.split(c).count()));
        Ok(Self { separator, decimal_comma, trailing })
    }

    pub(crate) fn cells<'a>(&self, line: &'a str, cells: &mut Vec<&'a str>) {
        cells.clear();
        let Some(separator) = self.separator else {
            cells.extend(line.split_ascii_whitespace().map(|cell| cell.trim_matches('"')));
            return;
        };
        cells.extend(self.without_trailing(line).split(separator).map(|cell| cell.trim().trim_matches('"')));
    }

    /// The line without a separator that begins no column.
    pub(crate) fn without_trailing<'a>(&self, line: &'a str) -> &'a str {
        let separator = self.separator.filter(|_| self.trailing);
        separator.and_then(|separator| line.strip_suffix(separator)).unwrap_or(line)
    }

    pub(crate) fn number(&self, cell: &str) -> Option<f64> {
        if !self.decimal_comma {
            return scalar::number(cell);
        }
        if cell.contains('.') || cell.matches(',').count() > 1 {
            return None;
        }
        scalar::number(&cell.replace(',', "."))
    }

    pub(crate) fn advice(&self, cell: &str) -> &'static str {
        match self.separator {
            Some(',') if cell.contains(char::is_whitespace) => "; are the numbers separated by blanks and commas?",
            None if cell.contains(',') => "; are the numbers separated by blanks and commas?",
            _ if self.decimal_comma && cell.contains('.') => "; other numbers have decimal commas",
            _ => "",
        }
    }
}
