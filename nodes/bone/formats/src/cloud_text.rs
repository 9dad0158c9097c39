//! Points as text: XYZ, ASC, PTS, CSV and TXT files.

use crate::{
    FileError,
    columns::{Heading, Lines, Row, Split, axes, has_words, heading_names, is_missing, name_axes, place, twice},
    cursor::Cursor,
    scalar,
    shape::{Places, Shape, UNIT, normal_columns},
};
use nalgebra::Vector3;
use std::path::Path;

/// Reads points from a text of one point a line.
///
/// The separator is found: a semicolon, a tab, a comma or blanks. With each but the comma, numbers may have a decimal comma.
/// If the first line holds words, or a comment before it is `# x y z` or `//X,Y,Z`, they name the columns: `x`, `y`, `z`,
/// and optionally `nx`, `ny`, `nz`, in any order and case. Otherwise the first three columns are the coordinates, and three
/// more are the normals if each is of unit length. Further columns of numbers are kept, under their name or as `column_4`;
/// columns of words are left out with a note, and so are columns without a name, as of row names that pandas and R write, also where R
/// leaves them out of the heading. Without a heading a first of four or more columns that counts the lines is an index. Cells that are
/// empty, `NA`, `N/A` or `null` are NaN.
/// `x_mm` and the like state the unit. A first line of a single number is the count of points, as in PTS, and is
/// checked. Blank lines and lines that begin with `#` or `//` are passed over, but for a `SPACE=` in them. `O(n)`.
///
/// # Errors
/// [`FileError`], naming the line: a word instead of a number, a line with more or fewer columns than the first, a heading
/// with one column twice, another count of points than the file states, decimal commas between commas.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let cursor = Cursor::text(path, bytes)?;
    // Only the count of points may precede a heading.
    let is_count = |(row, _): &Row| row.parse::<usize>().is_ok();
    // A value that Excel has not is no comment.
    let mut lines = Lines::read(
        cursor,
        |comment| comment.starts_with("N/A"),
        |names, rows| is_heading(names) && rows.iter().all(is_count),
    )?;
    let mut stated = std::mem::take(&mut lines.stated);
    let Head { rows, heading, count } = Head::of(&lines);
    let Some((first, first_line)) = rows.first() else {
        return Err(cursor.fault_at(heading.map_or(1, |(_, line)| line), "there is no point in it"));
    };
    let split = Split::of(&cursor, rows, heading.as_ref().map(|(names, _)| names.len()))?;
    let mut cells = Vec::new();
    split.cells(first, &mut cells);
    let index = if heading.is_none() { index_note(rows, &split) } else { None };
    let unnamed = || unnamed(cells.len(), *first_line, usize::from(index.is_some()));
    let (has_heading, (mut names, line)) = (heading.is_some(), heading.unwrap_or_else(unnamed));
    if has_heading && names.len() + 1 == cells.len() && has_row_names(rows, &split) {
        names.insert(0, String::new());
    }
    name_axes(&mut names, &mut stated).map_err(|message| cursor.fault_at(line, message))?;
    name_colours(&mut names);
    let is_same = |a: &str, b: &str| !a.is_empty() && a.eq_ignore_ascii_case(b);
    twice(&names, is_same).map_err(|message| cursor.fault_at(line, message))?;
    if names.len() != cells.len() {
        let comma = decimal_commas(names.len(), cells.len());
        let message =
            format!("the heading on line {line} names {} columns, this line has {}{comma}", names.len(), cells.len());
        return Err(cursor.fault_at(*first_line, message));
    }
    if !has_heading && cells.len() < 3 {
        let message = format!("a point has three numbers, this line has {}", cells.len());
        return Err(cursor.fault_at(*first_line, message));
    }
    let places = axes(&cursor, &names, line)?;
    let normals = normal_columns(|name| place(&names, name));
    let is_needed = |k: usize| places.contains(&k) || normals.is_some_and(|normals| normals.contains(&k));
    let columns = columns(&cursor, rows, &split, has_heading, names.len(), is_needed)?;
    if let Some((n, line)) = count
        && n != rows.len()
    {
        let message = format!("{n} points are stated, but {} follow; was the file cut short?", rows.len());
        return Err(cursor.fault_at(line, message));
    }
    let (mut notes, mut named) = (Vec::from_iter(index), Vec::new());
    for (k, (name, column)) in names.into_iter().zip(columns).enumerate() {
        match column.word {
            None if name == INDEX => {}
            _ if is_unnamed(&name) => {
                notes.push(format!("column {} has no name, as the row names of pandas and R, and was left out", k + 1));
            }
            None => named.push((name, column.values)),
            Some((word, line)) => {
                notes.push(format!("column \"{name}\" holds words (\"{word}\" on line {line}) and was left out"));
            }
        }
    }
    let places = ["x", "y", "z"].map(|axis| {
        let is_axis = |(name, _): &(String, Vec<f64>)| name.eq_ignore_ascii_case(axis);
        named.iter().position(is_axis).expect("coordinates are numbers")
    });
    if !has_heading && colours_may_be_first(&named) {
        let message = "the first three columns may be colours, and the next three coordinates; name the columns in a first line: \
                       red green blue x y z, or x y z and names of the others";
        return Err(cursor.fault_at(*first_line, message));
    }
    if !has_heading && named.len() == 6 {
        let is_unit = |k: usize| UNIT.contains(&Vector3::new(named[3].1[k], named[4].1[k], named[5].1[k]).norm());
        if (0..rows.len()).filter(|&k| named[..3].iter().all(|(_, c)| c[k].is_finite())).all(is_unit) {
            named[3..].iter_mut().zip(["nx", "ny", "nz"]).for_each(|((name, _), normal)| *name = normal.into());
        }
    }
    let lines_of_points = Places::Lines(rows.iter().map(|(_, line)| *line).collect());
    Ok(Shape { stated, notes, places: lines_of_points, ..Shape::of_columns(named, places) })
}

/// Whether one of the first lines is a heading of points, or has three numbers.
pub(crate) fn begins_with_points(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]);
    let of_points = |line: &str| {
        let names = heading_names(line.trim_start_matches(['#', '/']).trim());
        let words = line.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty()).take(3);
        let n_numbers = words.filter(|word| scalar::number(word.trim()).is_some() || is_missing(word.trim())).count();
        n_numbers == 3 || ["x", "y", "z"].iter().all(|axis| place(&names, axis).is_some())
    };
    text.lines().any(of_points)
}

/// The likely cause of a line with twice the cells: a comma within each number, too.
pub(crate) fn decimal_commas(n_columns: usize, n_cells: usize) -> &'static str {
    let is_twice = n_columns > 1 && n_cells == 2 * n_columns;
    if is_twice { "; decimal commas? write 1.5, or separate the columns by semicolons" } else { "" }
}

/// What precedes the points, and their rows.
struct Head<'a> {
    rows: &'a [Row<'a>],
    heading: Option<Heading>,
    /// The count of the points and its line.
    count: Option<(usize, usize)>,
}

impl<'a> Head<'a> {
    fn of(lines: &'a Lines) -> Self {
        let mut head = Self { rows: &lines.rows, heading: lines.heading.clone(), count: None };
        // The count of points comes before or behind the heading.
        for may_be_heading in [true, false] {
            if let [(first, line), rest @ ..] = head.rows
                && head.count.is_none()
                && let Ok(n) = first.trim().parse::<usize>()
            {
                (head.count, head.rows) = (Some((n, *line)), rest);
            }
            if let [(first, line), rest @ ..] = head.rows
                && may_be_heading
                && has_words(first)
                // Below a heading in a comment words are labels.
                && (lines.heading.is_none() || is_heading(&heading_names(first)))
            {
                (head.heading, head.rows) = (Some((heading_names(first), *line)), rest);
            }
        }
        head
    }
}

/// The name of a column that counts the lines.
const INDEX: &str = "#";

/// The names of columns without a heading, behind `n_index` that count the lines, for messages on the first of their lines.
fn unnamed(width: usize, line: usize, n_index: usize) -> Heading {
    let name = |k: usize| match k.checked_sub(n_index) {
        None => INDEX.into(),
        Some(place) => ["x", "y", "z"].get(place).map_or(format!("column_{}", k + 1), |&axis| axis.into()),
    };
    ((0..width).map(name).collect(), line)
}

/// A note, if the first of at least four columns counts the lines from 0 or 1 on, in whole numbers, while the next have fractions.
fn index_note(rows: &[Row], split: &Split) -> Option<String> {
    let mut cells = Vec::new();
    let mut first = None;
    let mut has_fractions = false;
    for (k, (row, _)) in rows.iter().enumerate() {
        split.cells(row, &mut cells);
        let count: usize = cells.first()?.parse().ok()?;
        if cells.len() < 4 || count != *first.get_or_insert(count) + k {
            return None;
        }
        has_fractions |= cells[1..4].iter().any(|cell| cell.contains(['.', ',', 'e', 'E']));
    }
    let is_count = rows.len() >= 3 && first.is_some_and(|first| first <= 1) && has_fractions;
    is_count.then(|| {
        "the first column counts the lines; it is taken for an index, and the next three for x, y and z".into()
    })
}

/// Whether rows that have one cell more than the heading begin with names of rows, as R writes them: in quotes, or as a count.
fn has_row_names(rows: &[Row], split: &Split) -> bool {
    rows.iter().all(|(row, _)| row.starts_with('"')) || index_note(rows, split).is_some()
}

/// Whether a column has no name, or the one that pandas gives to such.
fn is_unnamed(name: &str) -> bool {
    name.is_empty() || name.starts_with("Unnamed: ")
}

/// Calls columns of colours by their names in other formats.
fn name_colours(names: &mut [String]) {
    for short in [["r", "g", "b"], ["rf", "gf", "bf"]] {
        let places = short.map(|name| names.iter().position(|other| other.eq_ignore_ascii_case(name)));
        let ([Some(r), Some(g), Some(b)], None) = (places, place(names, "red")) else { continue };
        for (k, name) in [(r, "red"), (g, "green"), (b, "blue")] {
            names[k] = name.into();
        }
    }
}

/// Whether the first three of six or seven unnamed columns look like colours (whole numbers up to 255, or numbers from 0 to 1), and the
/// next three like neither colours nor unit normals.
fn colours_may_be_first(columns: &[(String, Vec<f64>)]) -> bool {
    let finite = |k: usize| columns[k].1.iter().copied().filter(|value| value.is_finite());
    let are = |is_it: fn(f64) -> bool, from: usize| (from..from + 3).all(|k| finite(k).all(is_it));
    let is_byte = |value: f64| value.fract() == 0.0 && (0.0..=255.0).contains(&value);
    let is_share = |value: f64| (0.0..=1.0).contains(&value);
    matches!(columns.len(), 6 | 7)
        && (3..6).all(|k| finite(k).any(|value| value.fract() != 0.0))
        && (are(is_byte, 0) || are(is_share, 0))
        && !are(|value| value.abs() <= 1.0, 3)
}

/// Whether names are those of columns: x, y and z come first, alone or with further words.
pub(crate) fn is_heading(names: &[String]) -> bool {
    let first = names.iter().skip_while(|name| is_unnamed(name)).take(3).cloned().collect::<Vec<_>>();
    ["x", "y", "z"].iter().all(|axis| place(&first, axis).is_some())
}

/// A column as it is read.
#[derive(Clone, Default)]
struct Column {
    values: Vec<f64>,
    /// The first word that is no number, and its line.
    word: Option<(String, usize)>,
}

/// The columns of the rows. Only where a heading names the columns may those that are not needed hold words or nothing.
fn columns(
    cursor: &Cursor,
    rows: &[Row],
    split: &Split,
    has_heading: bool,
    width: usize,
    is_needed: impl Fn(usize) -> bool,
) -> Result<Vec<Column>, FileError> {
    let (mut columns, mut cells) = (vec![Column::default(); width], Vec::new());
    for (row, line) in rows {
        split.cells(row, &mut cells);
        if cells.len() != width {
            let what = if has_heading { "columns" } else { "numbers" };
            return Err(cursor.fault_at(*line, format!("{width} {what} are expected, this line has {}", cells.len())));
        }
        for (k, (cell, column)) in cells.iter().zip(&mut columns).enumerate() {
            let value = match split.number(cell) {
                Some(value) => value,
                None if is_missing(cell) => f64::NAN,
                None if is_needed(k) || !has_heading => {
                    let message = format!("\"{cell}\" is not a number{}", split.advice(cell));
                    return Err(cursor.fault_at(*line, message));
                }
                None => {
                    column.word.get_or_insert_with(|| ((*cell).to_owned(), *line));
                    f64::NAN
                }
            };
            column.values.push(value);
        }
    }
    Ok(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Space, shape::CloudFileRead};
    use nalgebra::Point3;
    use osteoflow_geometry::Cloud;

    fn read(text: &str) -> Result<CloudFileRead, FileError> {
        let path = "cloud.csv".as_ref();
        shape(path, text.as_bytes())?.into_cloud(path, 1.0, "camera".into())
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
            let content = read(text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!((content.cloud.points(), content.cloud.normals()), (&expected[..], None), "{text}");
            assert_eq!((content.n_points_in_file, content.n_dropped), (2, 0), "{text}");
        }
    }

    #[test]
    fn normals_are_read_where_they_are_named_or_of_unit_length() {
        let expected = [Vector3::z(), Vector3::new(0.6, 0.0, -0.8)];
        for text in ["x,y,z,nx,ny,nz\n0,0,0,0,0,2\n1,0,0,3,0,-4\n", "0 0 0 0 0 1\n1 0 0 .6 0 -.8\n"] {
            let content = read(text).unwrap();
            let normals = content.cloud.normals().unwrap();
            assert!(normals.iter().zip(&expected).all(|(a, b)| (a - b).norm() < 1e-15), "{normals:?}");
        }
        let content = read("x,y,z,nx,ny,nz\n0,0,0,0,0,0\n1,0,0,3,0,-4\n").unwrap();
        assert_eq!(content.cloud.normals(), None);
        assert_eq!(content.notes, ["1 of 2 normals are zero or not finite, so the cloud goes without normals"]);
    }

    #[test]
    fn points_without_depth_are_left_out_and_counted() {
        let content = shape("a.xyz".as_ref(), b"nan nan nan\n0 0 1\ninf 0 0\n").unwrap();
        let content = content.into_cloud("a.xyz".as_ref(), 1000.0, "camera".into()).unwrap();
        assert_eq!((content.n_points_in_file, content.n_dropped), (3, 2));
        assert_eq!(content.cloud.points(), [Point3::new(0.0, 0.0, 1000.0)]);
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
    fn a_log_of_poses_whose_rotation_is_called_w_x_y_z_is_no_cloud() {
        let log = read("time;px;py;pz;w;x;y;z\n0;1;2;3;1;0;0;0\n1;1;2;3;1;0;0;0\n").unwrap_err().to_string();
        assert!(
            log.contains("x, y and z beside w are a quaternion, and px, py, pz a place") && log.contains("--columns"),
            "{log}"
        );
        for cloud in ["x,y,z,w\n1,2,3,4\n", "x,y,z,nx,ny,nz\n1,2,3,0,0,1\n"] {
            assert_eq!(read(cloud).unwrap().cloud.points(), [Point3::new(1.0, 2.0, 3.0)], "{cloud}");
        }
    }

    #[test]
    fn further_columns_of_numbers_are_kept_and_those_of_words_noted() {
        let content = read("label,x,y,z,q\nP1,1,2,3,\nP2,4,5,nan,9\nP3,4,5,6,8\n").unwrap();
        assert_eq!(content.notes, ["column \"label\" holds words (\"P1\" on line 2) and was left out"]);
        assert_eq!((content.cloud.len(), content.n_dropped), (2, 1));
        let (name, values) = extra(&content.cloud, 0);
        assert!(name == "q" && values[0].is_nan() && values[1] == 8.0, "{name} {values:?}");
        let content = read("2\n1 2 3 -500 10 20 30\n1 2 3 -600 11 21 31\n").unwrap();
        assert_eq!(extra(&content.cloud, 0), ("column_4", &[-500.0, -600.0][..]));
        assert_eq!(content.cloud.extras().len(), 4);
    }

    #[test]
    fn row_names_of_pandas_and_r_are_left_out() {
        let expected = [Point3::new(1.5, 2.5, -3.5), Point3::new(4.5, 5.5, 6.5), Point3::new(7.5, 8.5, 9.5)];
        let rows = |begin: [&str; 3], separator: &str| {
            let row = |(begin, p): (&str, &Point3<f64>)| format!("{begin},{},{},{}\n", p.x, p.y, p.z);
            begin.into_iter().zip(&expected).map(row).collect::<String>().replace(',', separator)
        };
        let quoted = ["\"1\"", "\"2\"", "\"3\""];
        for text in [
            String::from(",x,y,z\n") + &rows(["0", "1", "2"], ","),
            String::from("Unnamed: 0,x,y,z\n") + &rows(["0", "5", "7"], ","),
            String::from("\"\",\"x\",\"y\",\"z\"\n") + &rows(quoted, ","),
            String::from("\"\";\"x\";\"y\";\"z\"\n") + &rows(["\"a\"", "\"b\"", "\"c\""], ";"),
            String::from("\"x\" \"y\" \"z\"\n") + &rows(quoted, " "),
            String::from("\"x\"\t\"y\"\t\"z\"\n") + &rows(["\"a\"", "\"b\"", "\"c\""], "\t"),
            String::from("x y z\n") + &rows(["1", "2", "3"], " "),
        ] {
            let read = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!(read.cloud.points(), expected, "{text}");
            assert_eq!(
                read.notes,
                ["column 1 has no name, as the row names of pandas and R, and was left out"],
                "{text}"
            );
            assert!(read.cloud.extras().is_empty(), "{text}");
            let probe = crate::probe::of("a.csv".as_ref(), text.as_bytes()).unwrap();
            assert_eq!(probe.kind, crate::probe::Kind::Cloud, "{text}");
        }
        // A further value is no row name.
        for text in ["x,y,z\n1.5,2,3,4\n2.5,2,3,4\n3.5,2,3,4\n", "x,y,z\n3,2.5,3.5,4.5\n4,2.5,3.5,4.5\n5,2.5,3.5,4.5\n"]
        {
            assert!(read(text).unwrap_err().to_string().contains("names 3 columns, this line has 4"), "{text}");
        }
    }

    #[test]
    fn values_that_are_missing_leave_their_row_out() {
        for word in ["NA", "N/A", "nan", "null", "NULL", "", "#N/A", "<NA>", "None", "NaN"] {
            for separator in [",", ";", "\t", " "] {
                // Blanks alone are a blank line.
                if word.is_empty() && [" ", "\t"].contains(&separator) {
                    continue;
                }
                for missing in [format!("{word},{word},{word}"), format!("1.5,{word},2.5")] {
                    for heading in ["x,y,z\n", ""] {
                        let text = format!("{heading}4.5,5.5,6.5\n{missing}\n7.5,8.5,9.5\n").replace(',', separator);
                        let read = read(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
                        assert_eq!((read.n_points_in_file, read.n_dropped), (3, 1), "{text}");
                        assert_eq!(read.cloud.points()[1], Point3::new(7.5, 8.5, 9.5), "{text}");
                    }
                }
            }
        }
        let first = read("NA NA NA\n1 2 3\n").unwrap();
        assert_eq!((first.n_dropped, first.cloud.len()), (1, 1), "no heading");
        let labelled = read("x,y,z,nx,ny,nz,part\n1,2,3,0,0,1,bone\n4,5,6,0,0,1,skin\n").unwrap();
        assert_eq!(labelled.cloud.normals().unwrap(), [Vector3::z(); 2]);
        assert_eq!(labelled.notes, ["column \"part\" holds words (\"bone\" on line 2) and was left out"]);
    }

    #[test]
    fn colours_before_coordinates_are_asked_about_and_named_ones_are_colours() {
        for text in [
            "255 0 128 10.5 20.25 30.75\n254 3 120 11.5 21.25 31.75\n",
            "1,0,0.5,10.5,20.25,30.75\n0.25,0,0.5,11.5,21.25,31.75\n",
            "255 0 128 10.5 20.25 30.75 9\n254 3 120 11.5 21.25 31.75 8\n",
        ] {
            let said = read(text).unwrap_err().to_string();
            assert!(
                said.contains("line 1: the first three columns may be colours")
                    && said.contains("red green blue x y z"),
                "{said}"
            );
        }
        for text in [
            "10.5 20.25 30.75 255 0 128\n11.5 21.25 31.75 254 3 120\n",
            "//X;Y;Z;R;G;B\n10.5;20.25;30.75;255;0;128\n11.5;21.25;31.75;254;3;120\n",
            "red green blue x y z\n255 0 128 10.5 20.25 30.75\n254 3 120 11.5 21.25 31.75\n",
            "//X,Y,Z,Rf,Gf,Bf\n10.5,20.25,30.75,1,0,0.50196\n11.5,21.25,31.75,0.99608,0.011765,0.470588\n",
        ] {
            let read = read(text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!(read.cloud.points()[1], Point3::new(11.5, 21.25, 31.75), "{text}");
            let colours: Vec<_> = read.cloud.extras().iter().map(|(_, values)| values[1]).collect();
            assert_eq!(colours, [254.0, 3.0, 120.0], "{text}");
            let is_named = read.cloud.extras()[0].0.as_ref() == "red";
            assert_eq!(is_named, text.contains(['R', 'r']), "{text}");
        }
        // Whole coordinates beside normals are no colours.
        assert_eq!(read("1 2 3 0.6 0 0.8\n4 5 6 0 0.6 0.8\n").unwrap().cloud.normals().unwrap().len(), 2);
    }

    #[test]
    fn a_stated_space_turns_the_points_to_lps() {
        let content = read("# SPACE=RAS\nx,y,z,nx,ny,nz\n1,2,3,0,1,0\n").unwrap();
        assert_eq!((content.cloud.points()[0], content.space), (Point3::new(-1.0, -2.0, 3.0), Space::Ras));
        assert_eq!(content.cloud.normals().unwrap()[0], -Vector3::y());
        assert_eq!(content.notes, ["the file states SPACE=RAS; x and y were negated, which gives LPS"]);
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
