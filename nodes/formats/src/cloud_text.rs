//! Points as text: XYZ and CSV files.

use crate::{FileError, cloud_file::CloudFileRead, normals::NormalReader};
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Cloud, Frame};
use std::path::Path;

/// The columns that are read, by their names in a heading.
const NAMES: [&str; 6] = ["x", "y", "z", "nx", "ny", "nz"];

/// Lengths of unit normals written with few digits.
const UNIT: std::ops::Range<f64> = 0.99..1.01;

/// Reads points from a text of one point a line, its numbers between blanks, commas or semicolons.
///
/// If the first line holds words, they name the columns: `x`, `y`, `z`, and optionally `nx`, `ny`, `nz`, in any order and
/// case. Otherwise the first three columns are the coordinates, and three more are the normals if each is of unit length.
/// Further columns are skipped, as are blank lines and lines that begin with `#` or `//`. Points
/// that are not finite are left out and counted. `O(n)`.
///
/// # Errors
/// [`FileError`], naming the line: a word instead of a number, or a line with fewer columns than the first.
pub(crate) fn parse(path: &Path, text: &str, unit_mm: f64, frame: Frame) -> Result<CloudFileRead, FileError> {
    let mut lines = text.trim_start_matches('\u{feff}').lines().zip(1..).filter(|(line, _)| {
        let line = line.trim_start();
        !line.is_empty() && !line.starts_with('#') && !line.starts_with("//")
    });
    let Some(first) = lines.next() else {
        return Err(FileError::content(path, "line 1", "there is no point in it"));
    };
    let heading = words(first.0).any(|word| word.parse::<f64>().is_err());
    let columns = if heading { named(path, &first)? } else { counted(path, &first)? };
    let has_normals = columns[3..].iter().all(Option::is_some);
    let most = columns.iter().flatten().max().map_or(0, |last| last + 1);
    let mut cells = Vec::with_capacity(most);
    let (mut points, mut normals, mut n_points_in_file) = (Vec::new(), NormalReader::default(), 0);
    // Without a heading, columns of other lengths are no normals.
    let mut are_normals = has_normals;
    for (line, number) in (!heading).then_some(first).into_iter().chain(lines) {
        n_points_in_file += 1;
        let place = || format!("line {number}");
        cells.clear();
        for word in words(line).take(most) {
            let cell: f64 =
                word.parse().map_err(|_| FileError::content(path, place(), format!("\"{word}\" is not a number")))?;
            cells.push(cell);
        }
        if cells.len() < most {
            let message = format!("{most} numbers are expected, this line has {}", cells.len());
            return Err(FileError::content(path, place(), message));
        }
        let [x, y, z, nx, ny, nz] = columns.map(|column| column.map_or(f64::NAN, |k| cells[k]));
        let point = Point3::new(x, y, z) * unit_mm;
        if !point.iter().all(|c| c.is_finite()) {
            continue;
        }
        points.push(point);
        let normal = Vector3::new(nx, ny, nz);
        are_normals &= heading || UNIT.contains(&normal.norm());
        if are_normals {
            normals.push(normal);
        }
    }
    let n_dropped = n_points_in_file - points.len();
    let mut cloud = Cloud::new(frame, points).expect("points that are not finite were left out");
    let mut notes = Vec::new();
    if are_normals {
        let (normals, normal_notes) = normals.finish();
        notes = normal_notes;
        if let Some(normals) = normals {
            cloud = cloud.with_normals(normals).expect("each kept point has its unit normal");
        }
    }
    Ok(CloudFileRead { cloud, n_points_in_file, n_dropped, notes })
}

fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split(|c: char| c.is_whitespace() || c == ',' || c == ';').filter(|word| !word.is_empty())
}

/// The columns that a heading names.
fn named(path: &Path, (heading, line): &(&str, i32)) -> Result<[Option<usize>; 6], FileError> {
    let found: Vec<_> = words(heading).map(|word| word.trim_matches('"').to_lowercase()).collect();
    let columns = NAMES.map(|name| found.iter().position(|word| word == name));
    match columns[..3].iter().position(Option::is_none) {
        None => Ok(columns),
        Some(missing) => {
            let message = format!("no column is called \"{}\"; there are: {}", NAMES[missing], found.join(", "));
            Err(FileError::content(path, format!("line {line}"), message))
        }
    }
}

/// The columns of a text without a heading, as many as its first line has.
fn counted(path: &Path, (first, line): &(&str, i32)) -> Result<[Option<usize>; 6], FileError> {
    match words(first).count() {
        n @ ..3 => {
            let message = format!("a point has three numbers, this line has {n}");
            Err(FileError::content(path, format!("line {line}"), message))
        }
        6 => Ok(std::array::from_fn(Some)),
        _ => Ok(std::array::from_fn(|k| (k < 3).then_some(k))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<CloudFileRead, FileError> {
        parse("cloud.csv".as_ref(), text, 1.0, "camera".into())
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
        let found = parse("a.xyz".as_ref(), "nan nan nan\n0 0 1\ninf 0 0\n", 1000.0, "camera".into()).unwrap();
        assert_eq!((found.n_points_in_file, found.n_dropped), (3, 2));
        assert_eq!(found.cloud.points(), [Point3::new(0.0, 0.0, 1000.0)]);
    }

    #[test]
    fn a_broken_text_names_its_line() {
        for (text, expected) in [
            ("", "line 1: there is no point in it"),
            ("1 2\n", "line 1: a point has three numbers, this line has 2"),
            ("1 2 3\n\n1 2\n", "line 3: 3 numbers are expected, this line has 2"),
            ("1 2 3\n1 two 3\n", "line 2: \"two\" is not a number"),
            ("a,b,z\n1,2,3\n", "line 1: no column is called \"x\"; there are: a, b, z"),
        ] {
            assert_eq!(read(text).unwrap_err().to_string(), format!("cloud.csv: {expected}"), "{text}");
        }
    }
}
