//! Points as text: XYZ, ASC, PTS, CSV and TXT files.

use crate::{
    FileError, scalar,
    shape::{Places, Shape, normal_columns},
    space::StatedSpace,
};
use nalgebra::Vector3;
use std::path::Path;

/// Lengths of unit normals written with few digits.
const UNIT: std::ops::Range<f64> = 0.99..1.01;

/// Number of rows that are looked at to tell a separator from a decimal comma.
const N_LOOKED_AT: usize = 100;

/// Reads points from a text of one point a line.
///
/// The separator is found: a semicolon, a tab, a comma or blanks. With each but the comma, numbers may have a decimal comma.
/// If the first line holds words, or a comment before it is `# x y z` or `//X,Y,Z`, they name the columns: `x`, `y`, `z`,
/// and optionally `nx`, `ny`, `nz`, in any order and case. Otherwise the first three columns are the coordinates, and three
/// more are the normals if each is of unit length. Further columns of numbers are kept, under their name or as `column_4`;
/// columns of words are left out with a note. A first line of a single number is the count of points, as in PTS, and is
/// checked. Blank lines and lines that begin with `#` or `//` are passed over, but for a `SPACE=` in them. `O(n)`.
///
/// # Errors
/// [`FileError`], naming the line: a word instead of a number, a line with more or fewer columns than the first, a heading
/// with one column twice, another count of points than the file states, decimal commas between commas.
pub(crate) fn shape(path: &Path, text: &str) -> Result<Shape, FileError> {
    let mut stated = StatedSpace::default();
    let mut comment_heading = None;
    let mut lines = text.trim_start_matches('\u{feff}').lines().zip(1..);
    let mut rows: Vec<(&str, usize)> = Vec::new();
    for (line, number) in lines.by_ref() {
        let line = line.trim_matches(' ').trim_end();
        match line.strip_prefix('#').or_else(|| line.strip_prefix("//")) {
            Some(comment) => {
                stated.take(comment).map_err(|message| fault(path, number, message))?;
                // Only the count of points may precede it.
                if is_heading(comment) && rows.iter().all(|(row, _)| row.parse::<usize>().is_ok()) {
                    comment_heading = Some((comment.trim(), number));
                }
            }
            None if line.is_empty() => {}
            None => rows.push((line, number)),
        }
    }
    drop(lines);
    let mut rows = &rows[..];
    let mut heading = comment_heading;
    let mut count = None;
    // The count of points comes before or behind the heading.
    for may_be_heading in [true, false] {
        if let [(first, number), rest @ ..] = rows
            && count.is_none()
            && let Ok(n) = first.trim().parse::<usize>()
        {
            (count, rows) = (Some((n, *number)), rest);
        }
        if let [(first, number), rest @ ..] = rows
            && may_be_heading
            && has_words(first)
            // Below a heading in a comment words are labels.
            && (comment_heading.is_none() || is_heading(first))
        {
            (heading, rows) = (Some((*first, *number)), rest);
        }
    }
    let Some(&(first, first_number)) = rows.first() else {
        return Err(FileError::content(
            path,
            format!("line {}", heading.map_or(1, |(_, n)| n)),
            "there is no point in it",
        ));
    };
    let names = heading.map(|(text, number)| (heading_names(text), number));
    let split = Split::of(rows, names.as_ref().map(|(names, _)| names.len()))
        .map_err(|(number, message)| fault(path, number, message))?;
    let mut cells = Vec::new();
    split.cells(first, &mut cells);
    let width = cells.len();
    let names = match names {
        Some((names, number)) => {
            if let Some((k, name)) = names
                .iter()
                .enumerate()
                .find(|(k, name)| names[..*k].iter().any(|other| other.eq_ignore_ascii_case(name)))
            {
                return Err(fault(path, number, format!("column {} is called \"{name}\" as one before it is", k + 1)));
            }
            if names.len() != width {
                let message =
                    format!("the heading on line {number} names {} columns, this line has {width}", names.len());
                return Err(fault(path, first_number, message));
            }
            names
        }
        None if width < 3 => {
            return Err(fault(path, first_number, format!("a point has three numbers, this line has {width}")));
        }
        None => (1..=width).map(|k| ["x", "y", "z"].get(k - 1).map_or(format!("column_{k}"), |&s| s.into())).collect(),
    };
    let place = |name: &str| {
        names.iter().position(|found| found.eq_ignore_ascii_case(name)).ok_or_else(|| {
            let number = heading.map_or(first_number, |(_, number)| number);
            fault(path, number, format!("no column is called \"{name}\"; there are: {}", names.join(", ")))
        })
    };
    let places = [place("x")?, place("y")?, place("z")?];
    let normals = normal_columns(|name| names.iter().position(|found| found.eq_ignore_ascii_case(name)));
    let is_needed = |k: usize| places.contains(&k) || normals.is_some_and(|normals| normals.contains(&k));

    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); width];
    let mut words: Vec<Option<(usize, String)>> = vec![None; width];
    for &(line, number) in rows {
        split.cells(line, &mut cells);
        if cells.len() != width {
            let what = if heading.is_some() { "columns" } else { "numbers" };
            return Err(fault(path, number, format!("{width} {what} are expected, this line has {}", cells.len())));
        }
        for (k, cell) in cells.iter().enumerate() {
            let value = match split.number(cell) {
                Some(value) => value,
                None if cell.is_empty() && !is_needed(k) => f64::NAN,
                None if is_needed(k) || heading.is_none() => {
                    return Err(fault(path, number, format!("\"{cell}\" is not a number{}", split.advice(cell))));
                }
                None => {
                    words[k].get_or_insert_with(|| (number, (*cell).to_owned()));
                    f64::NAN
                }
            };
            columns[k].push(value);
        }
    }
    if let Some((n, number)) = count
        && n != rows.len()
    {
        let message = format!("{n} points are stated, but {} follow; was the file cut short?", rows.len());
        return Err(fault(path, number, message));
    }
    let mut notes = Vec::new();
    let mut named: Vec<(String, Vec<f64>)> = Vec::new();
    let mut final_places = places;
    for (k, (name, column)) in names.into_iter().zip(columns).enumerate() {
        if let Some((number, word)) = &words[k] {
            notes.push(format!("column \"{name}\" holds words (\"{word}\" on line {number}) and was left out"));
            continue;
        }
        if let Some(axis) = places.iter().position(|&place| place == k) {
            final_places[axis] = named.len();
        }
        named.push((name, column));
    }
    if heading.is_none() && width == 6 {
        let is_unit = |k: usize| UNIT.contains(&Vector3::new(named[3].1[k], named[4].1[k], named[5].1[k]).norm());
        if (0..rows.len()).filter(|&k| named[..3].iter().all(|(_, c)| c[k].is_finite())).all(is_unit) {
            named[3..].iter_mut().zip(["nx", "ny", "nz"]).for_each(|((name, _), normal)| *name = normal.into());
        }
    }
    let places = Places::Lines(rows.iter().map(|(_, number)| *number).collect());
    Ok(Shape { stated, notes, places, ..Shape::of_columns(named, final_places) })
}

fn fault(path: &Path, line: usize, message: impl Into<String>) -> FileError {
    FileError::content(path, format!("line {line}"), message)
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

/// Whether a comment names columns: x, y and z come first, alone or with further words.
fn is_heading(comment: &str) -> bool {
    let names = heading_names(comment);
    ["x", "y", "z"].iter().all(|axis| names.iter().take(3).any(|name| name.eq_ignore_ascii_case(axis)))
}

pub(crate) fn has_words(line: &str) -> bool {
    let is_separator = |c: char| c.is_whitespace() || c == ',' || c == ';';
    line.split(is_separator).filter(|word| !word.is_empty()).any(|word| scalar::number(word).is_none())
}

/// How lines are cut into numbers.
pub(crate) struct Split {
    /// None for blanks.
    pub(crate) separator: Option<char>,
    decimal_comma: bool,
    /// Whether each line ends with a separator that begins no column.
    pub(crate) trailing: bool,
}

impl Split {
    /// The separator of the rows.
    ///
    /// # Errors
    /// The line and a message, if commas are ambiguous.
    pub(crate) fn of(rows: &[(&str, usize)], n_names: Option<usize>) -> Result<Self, (usize, String)> {
        let looked_at = || rows.iter().take(N_LOOKED_AT).map(|(line, _)| *line);
        let (first, _) = rows[0];
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
        if decimal_comma
            && let Some((line, number)) = rows.iter().take(N_LOOKED_AT).find(|(line, _)| line.contains('.'))
        {
            let message = format!("\"{line}\" has decimal points, but other numbers have commas; write all alike");
            return Err((*number, message));
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
                return Err((rows[0].1, message.into()));
            }
        }
        let trailing = separator.is_some_and(|c| first.ends_with(c) && n_names != Some(first.split(c).count()));
        Ok(Self { separator, decimal_comma, trailing })
    }

    fn cells<'a>(&self, line: &'a str, cells: &mut Vec<&'a str>) {
        cells.clear();
        let Some(separator) = self.separator else {
            cells.extend(line.split_ascii_whitespace());
            return;
        };
        let line = if self.trailing { line.strip_suffix(separator).unwrap_or(line) } else { line };
        cells.extend(line.split(separator).map(|cell| cell.trim().trim_matches('"')));
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

    fn advice(&self, cell: &str) -> &'static str {
        match self.separator {
            Some(',') if cell.contains(char::is_whitespace) => "; are the numbers separated by blanks and commas?",
            None if cell.contains(',') => "; are the numbers separated by blanks and commas?",
            _ if self.decimal_comma && cell.contains('.') => "; other numbers have decimal commas",
            _ => "",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Space, cloud_file::CloudFileRead};
    use nalgebra::Point3;
    use osteoflow_geometry::Cloud;

    fn read(text: &str) -> Result<CloudFileRead, FileError> {
        let path = "cloud.csv".as_ref();
        shape(path, text)?.into_cloud(path, 1.0, "camera".into())
    }

    fn extra(cloud: &Cloud, k: usize) -> (&str, &[f64]) {
        let (name, values) = &cloud.extras()[k];
        (name, values)
    }

    #[test]
    fn the_same_points_are_read_from_blanks_commas_and_named_columns() {
        let expected = [Point3::new(1.0, 2.5, -3.0), Point3::new(4.0, 5.0, 60.0)];
        for text in [
            "1 2.5 -3\n4 5 6e1\n",
            "# a scan\r\n\r\n1,2.5,-3\r\n4,5,60\r\n",
            "  1;\t2.5;-3;255\n// next\n4; 5; 60; 17",
            "Z,y,X\n-3,2.5,1\n60,5,4\n",
            "\u{feff}\"x\" \"y\" \"z\" \"label\"\n1 2.5 -3 7\n4 5 60 8\n",
            "1 2.5 -3 200 100 50\n4 5 60 0 0 0\n",
        ] {
            let found = read(text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!((found.cloud.points(), found.cloud.normals()), (&expected[..], None), "{text}");
            assert_eq!((found.n_points_in_file, found.n_dropped), (2, 0), "{text}");
        }
    }

    #[test]
    fn normals_are_read_where_they_are_named_or_of_unit_length() {
        let expected = [Vector3::z(), Vector3::new(0.6, 0.0, -0.8)];
        for text in ["x,y,z,nx,ny,nz\n0,0,0,0,0,2\n1,0,0,3,0,-4\n", "0 0 0 0 0 1\n1 0 0 .6 0 -.8\n"] {
            let found = read(text).unwrap();
            let normals = found.cloud.normals().unwrap();
            assert!(normals.iter().zip(&expected).all(|(a, b)| (a - b).norm() < 1e-15), "{normals:?}");
        }
        let found = read("x,y,z,nx,ny,nz\n0,0,0,0,0,0\n1,0,0,3,0,-4\n").unwrap();
        assert_eq!(found.cloud.normals(), None);
        assert_eq!(found.notes, ["1 of 2 normals are zero or not finite, so the cloud goes without normals"]);
    }

    #[test]
    fn points_without_depth_are_left_out_and_counted() {
        let found = shape("a.xyz".as_ref(), "nan nan nan\n0 0 1\ninf 0 0\n").unwrap();
        let found = found.into_cloud("a.xyz".as_ref(), 1000.0, "camera".into()).unwrap();
        assert_eq!((found.n_points_in_file, found.n_dropped), (3, 2));
        assert_eq!(found.cloud.points(), [Point3::new(0.0, 0.0, 1000.0)]);
    }

    #[test]
    fn decimal_commas_are_read_with_every_separator_but_the_comma() {
        let expected = Point3::new(46.8988, -7.7118, 203.0462);
        for text in [
            "46,8988;-7,7118;203,0462\n",
            "46,8988\t-7,7118\t203,0462\n",
            "46,8988 -7,7118  203,0462\n",
            "x;y;z\n46,8988;-7,7118;203,0462\n",
            "46.8988, -7.7118, 203.0462\n",
            "46.8988 ,-7.7118 ,203.0462\n",
            "46,8988; -7,7118; 203,0462;\n",
        ] {
            assert_eq!(read(text).unwrap_or_else(|e| panic!("{e}\n{text}")).cloud.points(), [expected], "{text}");
        }
        assert_eq!(read("1 2,5 3\n").unwrap().cloud.points(), [Point3::new(1.0, 2.5, 3.0)]);
    }

    #[test]
    fn headings_of_cloudcompare_and_of_comments_name_the_columns() {
        for text in [
            "//X,Y,Z,Intensity\n1,2,3,7\n",
            "//X Y Z Intensity\n1\n1 2 3 7\n",
            "# z y x Intensity\n3 2 1 7\n",
            "//X;Y;Z;Name;Intensity\n1,0;2,0;3,0;P1;7\n",
            "# a scan with x and y\n# x y z Intensity\n1 2 3 7\n",
            "Intensity;z;y;x\n7,0;3,0;2,0;1,0\n",
        ] {
            let cloud = read(text).unwrap_or_else(|e| panic!("{e}\n{text}")).cloud;
            assert_eq!(cloud.points(), [Point3::new(1.0, 2.0, 3.0)], "{text}");
            assert_eq!(extra(&cloud, 0), ("Intensity", &[7.0][..]), "{text}");
        }
    }

    #[test]
    fn further_columns_of_numbers_are_kept_and_those_of_words_noted() {
        let found = read("label,x,y,z,q\nP1,1,2,3,\nP2,4,5,nan,9\nP3,4,5,6,8\n").unwrap();
        assert_eq!(found.notes, ["column \"label\" holds words (\"P1\" on line 2) and was left out"]);
        assert_eq!((found.cloud.len(), found.n_dropped), (2, 1));
        let (name, values) = extra(&found.cloud, 0);
        assert!(name == "q" && values[0].is_nan() && values[1] == 8.0, "{name} {values:?}");
        let found = read("2\n1 2 3 -500 10 20 30\n1 2 3 -600 11 21 31\n").unwrap();
        assert_eq!(extra(&found.cloud, 0), ("column_4", &[-500.0, -600.0][..]));
        assert_eq!(found.cloud.extras().len(), 4);
    }

    #[test]
    fn a_stated_space_turns_the_points_to_lps() {
        let found = read("# SPACE=RAS\nx,y,z,nx,ny,nz\n1,2,3,0,1,0\n").unwrap();
        assert_eq!((found.cloud.points()[0], found.space), (Point3::new(-1.0, -2.0, 3.0), Space::Ras));
        assert_eq!(found.cloud.normals().unwrap()[0], -Vector3::y());
        assert_eq!(found.notes, ["the file states SPACE=RAS; x and y were negated, which gives LPS"]);
        assert_eq!(read("1 2 3").unwrap().space, Space::Unknown);
    }

    #[test]
    fn a_broken_text_names_its_line() {
        for (text, expected) in [
            ("", "line 1: there is no point in it"),
            ("1 2\n", "line 1: a point has three numbers, this line has 2"),
            ("1 2 3\n\n1 2\n", "line 3: 3 numbers are expected, this line has 2"),
            ("1 2 3\n1 two 3\n", "line 2: \"two\" is not a number"),
            ("3\n1 2 3\n", "line 1: 3 points are stated, but 1 follow; was the file cut short?"),
            ("x,y,z\n1,2,3\n1,2,3,4\n", "line 3: 3 columns are expected, this line has 4"),
            ("x,y,z\n1,2,3,4\n", "line 2: the heading on line 1 names 3 columns, this line has 4"),
            ("x,y,z,X\n1,2,3,4\n", "line 1: column 4 is called \"X\" as one before it is"),
            ("1 2 3\n1 2 3 4\n", "line 2: 3 numbers are expected, this line has 4"),
            (
                "1,5;2,5;3,5\n1.5;2,5;3\n",
                "line 2: \"1.5;2,5;3\" has decimal points, but other numbers have commas; write all alike",
            ),
            (
                "46,8988,-7,7118,203,0462\n1,5000,2,2500,3,1250\n",
                "line 1: six whole numbers between commas look like three numbers with decimal commas; separate the numbers \
                 by semicolons or write decimal points",
            ),
            ("1 2,3,4\n", "line 1: \"1 2\" is not a number; are the numbers separated by blanks and commas?"),
            (
                &("1,5;2,5;3,5\n".repeat(100) + "1.234;2,5;3,5\n"),
                "line 101: \"1.234\" is not a number; other numbers have decimal commas",
            ),
            ("a,b,z\n1,2,3\n", "line 1: no column is called \"x\"; there are: a, b, z"),
        ] {
            assert_eq!(read(text).unwrap_err().to_string(), format!("cloud.csv: {expected}"), "{text}");
        }
    }
}
