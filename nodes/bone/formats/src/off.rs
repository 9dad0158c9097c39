//! OFF, the Object File Format of Geomview, with colours (COFF) and normals (NOFF, CNOFF).

use crate::{
    FileError,
    cursor::{Cursor, first_line},
    shape::{Places, Shape, UNIT, fan, of_colours},
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Whether the first word that is no comment marks an OFF file.
pub(crate) fn is_off(bytes: &[u8]) -> bool {
    first_line(bytes, |line| {
        let word = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        // Prefixes: texture, colour, normal, a fourth coordinate, another dimension.
        word.strip_suffix(b"OFF").is_some_and(|prefix| prefix.iter().all(|b| b"STCN4n".contains(b)))
    })
}

/// The surface in an OFF file, or the cloud if it has no faces.
///
/// Of normals and colours Geomview has the normals first and MeshLab the colours: those are normals that are of unit length.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut cursor = Cursor::text(path, bytes)?;
    let mut stated = StatedSpace::default();
    let mut next = |cursor: &mut Cursor, k: usize, n: usize, what: &str| {
        cursor.uncommented_line(&mut stated)?.ok_or_else(|| cursor.cut_short(k, n, what))
    };
    let first = next(&mut cursor, 0, 2, "lines of its head")?;
    let (mark, counts) = first.split_once(char::is_whitespace).unwrap_or((&first, ""));
    let prefix = mark.strip_suffix("OFF").unwrap_or_default();
    let (has_colours, has_normals) = (prefix.contains('C'), prefix.contains('N'));
    if let Some(other) = prefix.chars().find(|c| !matches!(c, 'C' | 'N')) {
        return Err(cursor.fault(format!("\"{mark}\" with \"{other}\" is not read; OFF, COFF, NOFF and CNOFF are")));
    }
    // The counts are on the line of the mark or on the next.
    let counts = match counts.trim() {
        "BINARY" => return Err(cursor.fault("a binary OFF is not read; write it as ASCII, or as PLY")),
        "" => next(&mut cursor, 1, 2, "lines of its head")?,
        counts => counts.to_owned(),
    };
    let parsed: Option<Vec<usize>> = counts.split_ascii_whitespace().map(|word| word.parse().ok()).collect();
    let Some(&[n_vertices, n_faces, ..]) = parsed.as_deref().filter(|counts| matches!(counts.len(), 2 | 3)) else {
        return Err(cursor.fault(format!("\"{counts}\" is not the number of vertices, faces and edges")));
    };
    // A vertex takes at least "0 0 0\n", a face "3 0 1 2\n" or, without corners, "0\n".
    cursor.promised(n_vertices, 6, "vertices")?;
    cursor.promised(n_faces, 2, "faces")?;
    let (mut points, mut places) = (Vec::with_capacity(n_vertices), Vec::with_capacity(n_vertices));
    let (mut normals, mut colours, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
    let fixed = if has_normals { 6 } else { 3 };
    for k in 0..n_vertices {
        let line = next(&mut cursor, k, n_vertices, "vertices")?;
        numbers.clear();
        for word in line.split_ascii_whitespace() {
            numbers.push(cursor.number(word)?);
        }
        let n_colours = numbers.len().checked_sub(fixed);
        if !(n_colours == Some(0) && !has_colours || matches!(n_colours, Some(3 | 4)) && has_colours) {
            let expected = if has_colours { format!("{} or {}", fixed + 3, fixed + 4) } else { fixed.to_string() };
            let message = format!("a vertex of {mark} has {expected} numbers, this one has {}", numbers.len());
            return Err(cursor.fault(message));
        }
        points.push(Point3::from_slice(&numbers[..3]));
        places.push(cursor.line);
        let last = numbers.len() - 3;
        if has_normals {
            normals.push([3, last].map(|k| Vector3::from_column_slice(&numbers[k..k + 3])));
        }
        if has_colours {
            colours.push([fixed, 3].map(|k| [0, 1, 2].map(|of| numbers[k + of])));
        }
    }
    let n_units = |k: usize| normals.iter().filter(|both| UNIT.contains(&both[k].norm())).count();
    let colours_first = usize::from(has_colours && has_normals && n_units(1) > n_units(0));
    let mut notes = Vec::new();
    if colours_first == 1 {
        notes.push(
            "colours come before the normals, as MeshLab writes them: only the last numbers are of unit length".into(),
        );
    }
    let normals = normals.into_iter().map(|both| both[colours_first]).collect();
    let colours: Vec<_> = colours.into_iter().map(|both| both[colours_first]).collect();
    let (mut faces, mut corners) = (Vec::with_capacity(n_faces), Vec::new());
    for k in 0..n_faces {
        let line = next(&mut cursor, k, n_faces, "faces")?;
        face(&cursor, &line, n_vertices, &mut corners)?;
        fan(&mut faces, &corners);
    }
    if cursor.uncommented_line(&mut stated)?.is_some() {
        return Err(cursor.more("more lines"));
    }
    let (faces, extras) = match n_faces {
        0 => (None, of_colours(&colours, &mut notes)),
        _ => (Some(faces), Vec::new()),
    };
    let normals = has_normals.then_some(normals);
    Ok(Shape { points, normals, extras, faces, stated, notes, places: Places::Lines(places) })
}

/// The corners of a face; colours behind them are passed over.
fn face(cursor: &Cursor, line: &str, n_vertices: usize, corners: &mut Vec<u32>) -> Result<(), FileError> {
    let mut words = line.split_ascii_whitespace();
    let mut index = |what: &str| {
        let word = words.next().ok_or_else(|| cursor.fault(format!("the face has no {what}")))?;
        word.parse::<usize>().map_err(|_| cursor.fault(format!("\"{word}\" is not {what}")))
    };
    let n = index("number of corners")?;
    corners.clear();
    for _ in 0..n {
        let corner = index("corner for each that it counts")?;
        if corner >= n_vertices {
            return Err(cursor.fault(format!("the face names vertex {corner}, but there are {n_vertices}")));
        }
        corners.push(corner as u32);
    }
    words.try_for_each(|word| {
        cursor.number(word).map(drop).map_err(|_| cursor.fault(format!("\"{word}\" is not a number of a colour")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Space, shape::MeshRead};
    use osteoflow_geometry::SurfaceOrigin;

    fn mesh(text: &str) -> Result<MeshRead, FileError> {
        let path = "a.off".as_ref();
        shape(path, text.as_bytes())?.into_mesh(path, 1.0, "ct".into(), SurfaceOrigin::User)
    }

    #[test]
    fn normals_and_colours_are_told_apart_in_both_orders() {
        for vertex in ["0 0 255 255 -0.6 0.8 0", "-0.6 0.8 0 0 0 255 255", "0 0 255 -0.6 0.8 0", "-0.6 0.8 0 0 0 1 1"] {
            let text = format!("NCOFF\n2 0 0\n1 2 3 {vertex}\n4 5 6 {vertex}\n");
            let path = "a.off".as_ref();
            let read = shape(path, text.as_bytes()).unwrap().into_cloud(path, 1.0, "ct".into()).unwrap();
            assert_eq!(read.cloud.normals().unwrap(), [Vector3::new(-0.6, 0.8, 0.0); 2], "{vertex}");
            let colours: Vec<_> = read.cloud.extras().iter().map(|(_, values)| values[1]).collect();
            assert_eq!(colours, [0.0, 0.0, 255.0], "{vertex}");
            assert_eq!(
                read.notes.len(),
                usize::from(vertex.starts_with('0') || vertex.ends_with("1 1")),
                "{:?}",
                read.notes
            );
        }
    }

    #[test]
    fn the_same_square_is_read_from_every_variant() {
        for text in [
            "OFF\n4 1 0\n0 0 0\n9 0 0\n9 9 0\n0 9 0\n4 0 1 2 3\n",
            "# SPACE=LPS\nOFF 4 2 5 # counts\n\n0 0 0\n9 0 0 # second\n9 9 0\n0 9 0\n3 0 1 2 255 0 0\n3 0 2 3 0.5 0.5 0.5 1\n",
            "COFF\n4 1\n0 0 0 1 0 0 1\n9 0 0 1 0 0 1\n9 9 0 1 0 0 1\n0 9 0 1 0 0 1\n4 0 1 2 3\n",
            "NOFF\r\n4 1 0\r\n0 0 0 0 0 1\r\n9 0 0 0 0 1\r\n9 9 0 0 0 1\r\n0 9 0 0 0 1\r\n4 0 1 2 3\r\n",
        ] {
            let content = mesh(text).unwrap_or_else(|e| panic!("{e}\n{text}"));
            assert_eq!(content.mesh.faces(), [[0, 1, 2], [0, 2, 3]], "{text}");
            assert_eq!(content.mesh.vertices()[2], Point3::new(9.0, 9.0, 0.0), "{text}");
            assert_eq!(content.space == Space::Lps, text.contains("LPS"));
        }
    }

    #[test]
    fn vertices_alone_are_a_cloud_with_normals_and_colours() {
        let path = "a.off".as_ref();
        let text = "CNOFF\n2 0 0\n1 2 3 0 0 1 10 20 30\n4 5 6 0 1 0 11 21 31\n";
        let content = shape(path, text.as_bytes()).unwrap().into_cloud(path, 1.0, "camera".into()).unwrap();
        assert_eq!(content.cloud.normals().unwrap(), [Vector3::z(), Vector3::y()]);
        assert_eq!((&*content.cloud.extras()[2].0, &*content.cloud.extras()[2].1), ("blue", &[30.0, 31.0][..]));
    }

    #[test]
    fn a_broken_file_names_its_line() {
        for (text, expected) in [
            ("OFF\n", "line 1: the file ends after 1 of 2 lines of its head; was it cut short?"),
            ("OFF BINARY\n", "line 1: a binary OFF is not read"),
            ("4OFF\n1 0 0\n1 2 3 4\n", "line 1: \"4OFF\" with \"4\" is not read"),
            ("OFF\n9999999999 1 0\n", "line 2: 9999999999 vertices are promised, but 0 bytes are left"),
            ("OFF\n2 0 0\n1 2 3     \n   \n", "line 4: the file ends after 1 of 2 vertices"),
            ("OFF\n1 0 0\n1 2 3 4\n", "line 3: a vertex of OFF has 3 numbers, this one has 4"),
            ("OFF\n1 0 0\n1 2 3\n4 5 6\n", "line 4: more lines follow than the header counts"),
            ("OFF\n1 1 0\n1 2 3\n3 0 0 1\n", "line 4: the face names vertex 1, but there are 1"),
            ("OFF\n1 1 0\n1 2 3\n3 0 0\n", "line 4: the face has no corner for each that it counts"),
            ("OFF\n1 x 0\n1 2 3\n3 0 0\n", "line 2: \"1 x 0\" is not the number of vertices"),
        ] {
            let message = mesh(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{expected}\n{message}");
        }
    }
}
