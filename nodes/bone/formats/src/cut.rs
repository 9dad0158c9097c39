//! A text that may have been cut short within its last number.

use crate::{FileError, cursor::is_text};
use std::path::Path;

/// As many lines before the last one are looked at.
const N_LINES: usize = 64;

/// As many numbers of equally many decimals show that they are written so.
const N_ALIKE: usize = 5;

/// The note on a text whose last line has no end, so that its last number may be another; none of a text that ends, or of binary data.
///
/// # Errors
/// [`FileError`] if its last number has fewer decimals than all before it, of which each has as many.
pub(crate) fn last_number(path: &Path, bytes: &[u8]) -> Result<Option<String>, FileError> {
    let ends_within = bytes.last().is_some_and(|last| last.is_ascii_digit() || *last == b'.');
    let tail = &bytes[bytes.len().saturating_sub(256)..];
    if !ends_within || !is_text(bytes) || !is_text(tail) {
        return Ok(None);
    }
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text.lines().rev().map(cells).take(N_LINES);
    let last = lines.next().unwrap_or_default();
    let is_row = |cells: &[&str]| cells.iter().rev().take(3).all(|cell| cell.replace(',', ".").parse::<f64>().is_ok());
    let before: Vec<_> = lines.filter(|cells| cells.len() == last.len() && is_row(cells)).collect();
    // A column as it is written, or all coordinates.
    let is_cut = [1, 3].into_iter().find_map(|n| {
        let numbers = || before.iter().flat_map(|cells| cells.iter().rev().take(n)).map(|cell| decimals(cell));
        let written = numbers().next().flatten().filter(|written| *written >= 2)?;
        let are_alike = numbers().count() >= N_ALIKE && numbers().all(|n| n == Some(written));
        (are_alike && decimals(last.last()?)? < written).then_some(written)
    });
    match is_cut.zip(last.last()) {
        Some((written, number)) => {
            let message = format!(
                "the last line has no end, and its last number, {number}, has fewer decimals than all before it ({written}); was the file \
                 cut short? write it again, or remove the line"
            );
            Err(FileError::content(path, format!("line {}", text.lines().count()), message))
        }
        None => Ok(Some("the last line has no end; was the file cut short?".into())),
    }
}

/// The cells of a line, whatever separates them.
fn cells(line: &str) -> Vec<&str> {
    let separator = [';', '\t', ','].into_iter().find(|separator| line.contains(*separator));
    let cells = line.split(|c: char| separator.map_or(c == ' ', |separator| c == separator));
    cells.map(str::trim).filter(|cell| !cell.is_empty()).collect()
}

/// The number of decimals of a number without an exponent.
fn decimals(cell: &str) -> Option<usize> {
    let number = cell.trim_start_matches(['-', '+']);
    let (whole, decimals) = number.split_once(['.', ',']).unwrap_or((number, ""));
    let are_digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    (!number.is_empty() && are_digits(whole) && are_digits(decimals)).then_some(decimals.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_last_number_with_fewer_decimals_than_all_others_is_refused_and_another_without_an_end_noted() {
        let note = |text: &str| last_number("a.xyz".as_ref(), text.as_bytes()).map_err(|error| error.to_string());
        let open = Ok(Some("the last line has no end; was the file cut short?".to_owned()));
        for separator in [" ", ",", ";", "\t", ", "] {
            let rows = |last: &str| {
                let rows: String = (0..6).map(|k| format!("{k}.50 -2.25 {k}3.00\n")).collect();
                (rows + "1.50 2.50 " + last).replace(' ', separator)
            };
            for cut in ["41", "41.", "41.3", "4"] {
                let said = note(&rows(cut)).unwrap_err();
                let expected = format!("a.xyz: line 7: the last line has no end, and its last number, {cut}, has");
                assert!(said.starts_with(&expected) && said.contains("than all before it (2)"), "{said}");
            }
            assert_eq!(note(&rows("41.30")), open);
            assert_eq!(note(&rows("41.30\n")), Ok(None));
        }
        assert!(note("a;1,50;2,50;3,00\nb;1,25;2,25;4,00\nc;3,00;4,00;5,0").is_err(), "coordinates of few points");
        for text in [
            "name,x,y,z\nP1,1,2,3\nP2,4,5,6\nP3,7,8,1",
            "31.08 7.5 195.4\n3.7 58.7 191\n1.7 6.4 376\n17.6 7.3 7",
            "1.5 2.5\n1.5 3.5\n2.5 4.5\n1.5 2.5\n2.5 3.5\n2.5 4",
            "1.50e3 1.25\n1.50e3 1.25\n1.50e3 1.25\n1.50e3 1.25\n1.50e3 1.25\n1.50e3 1.25",
        ] {
            assert_eq!(note(text), open, "{text}");
        }
        for text in ["", "\n", "endsolid bone", "1 2 3 nan"] {
            assert_eq!(note(text), Ok(None), "{text}");
        }
        assert_eq!(last_number("a.ply".as_ref(), b"ply\0\0\x01\x021").unwrap(), None, "binary");
    }
}
