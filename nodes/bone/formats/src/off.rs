//! OFF, the Object File Format of Geomview, with colours (COFF) and normals (NOFF, CNOFF).

use crate::{
    FileError, scalar,
    shape::{Places, Shape, fan},
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Whether the first word that is no comment marks an OFF file.
pub(crate) fn is_off(bytes: &[u8]) -> bool {
    let mut lines = bytes.split(|&b| b == b'\n').map(<[u8]>::trim_ascii);
    let Some(line) = lines.find(|line| !(line.is_empty() || line.starts_with(b"#"))) else { return false };
    let word = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
    // Prefixes: texture, colour, normal, a fourth coordinate, another dimension.
    word.strip_suffix(b"OFF").is_some_and(|prefix| prefix.iter().all(|b| b"STCN4n".contains(b)))
}

/// The surface in an OFF file, or the cloud if it has no faces.
pub(crate) fn shape(path: &Path, text: &str) -> Result<Shape, FileError> {
    let mut stated = StatedSpace::default();
    let mut lines = Vec::new();
    for (line, number) in text.trim_start_matches('\u{feff}').lines().zip(1..) {
        let (content, comment) = line.split_once('#').unwrap_or((line, ""));
        stated.take(comment).map_err(|message| fault(path, number, message))?;
        if !content.trim().is_empty() {
            lines.push((content.trim(), number));
        }
    }
    let mut lines = lines.into_iter();
    let n_lines = text.lines().count();
    let mut next = |what: &str| {
        lines.next().ok_or_else(|| fault(path, n_lines, format!("the file ends before {what}; was it cut short?")))
    };
    let (first, number) = next("its mark")?;
    let (mark, rest) = first.split_once(char::is_whitespace).unwrap_or((first, ""));
    let prefix = mark.strip_suffix("OFF").unwrap_or_default();
    let (has_colours, has_normals) = (prefix.contains('C'), prefix.contains('N'));
    if let Some(other) = prefix.chars().find(|c| !matches!(c, 'C' | 'N')) {
        return Err(fault(
            path,
            number,
            format!("\"{mark}\" with \"{other}\" is not read; OFF, COFF, NOFF and CNOFF are"),
        ));
    }
    if rest.trim() == "BINARY" {
        return Err(fault(path, number, "a binary OFF is not read; write it as ASCII, or as PLY"));
    }
    // The counts are on the line of the mark or on the next.
    let (counts, number) = if rest.trim().is_empty() { next("the counts")? } else { (rest.trim(), number) };
    let parsed: Option<Vec<usize>> = counts.split_ascii_whitespace().map(|word| word.parse().ok()).collect();
    let Some(&[n_vertices, n_faces, ..]) = parsed.as_deref().filter(|counts| matches!(counts.len(), 2 | 3)) else {
        return Err(fault(path, number, format!("\"{counts}\" is not the number of vertices, faces and edges")));
    };
    // A vertex takes at least "0 0 0\n", a face "3 0 1 2\n" or, without corners, "0\n".
    if n_vertices.saturating_mul(6).saturating_add(n_faces.saturating_mul(2)) > text.len() + 1 {
        let message =
            format!("{n_vertices} vertices and {n_faces} faces are promised, but the file has {} bytes", text.len());
        return Err(fault(path, number, message + "; was it cut short?"));
    }
    let mut shape = Shape { points: Vec::with_capacity(n_vertices), ..Shape::default() };
    let (mut normals, mut places) = (Vec::new(), Vec::with_capacity(n_vertices));
    let mut colours: [Vec<f64>; 3] = Default::default();
    let fixed = if has_normals { 6 } else { 3 };
    let mut numbers = Vec::new();
    for k in 0..n_vertices {
        let (line, number) = next(&format!("vertex {k} of {n_vertices}"))?;
        numbers.clear();
        for word in line.split_ascii_whitespace() {
            let value =
                scalar::number(word).ok_or_else(|| fault(path, number, format!("\"{word}\" is not a number")))?;
            numbers.push(value);
        }
        let n_colours = numbers.len().checked_sub(fixed);
        if !(n_colours == Some(0) && !has_colours || matches!(n_colours, Some(3 | 4)) && has_colours) {
            let expected = if has_colours { format!("{} or {}", fixed + 3, fixed + 4) } else { fixed.to_string() };
            let message = format!("a vertex of {mark} has {expected} numbers, this one has {}", numbers.len());
            return Err(fault(path, number, message));
        }
        shape.points.push(Point3::new(numbers[0], numbers[1], numbers[2]));
        places.push(number);
        if has_normals {
            normals.push(Vector3::new(numbers[3], numbers[4], numbers[5]));
        }
        if has_colours {
            colours.iter_mut().zip(&numbers[fixed..]).for_each(|(column, &value)| column.push(value));
        }
    }
    let (mut faces, mut corners) = (Vec::with_capacity(n_faces), Vec::new());
    for k in 0..n_faces {
        let (line, number) = next(&format!("face {k} of {n_faces}"))?;
        let mut words = line.split_ascii_whitespace();
        let mut index = |what: &str| {
            let word = words.next().ok_or_else(|| fault(path, number, format!("the face has no {what}")))?;
            word.parse::<usize>().map_err(|_| fault(path, number, format!("\"{word}\" is not {what}")))
        };
        let n = index("number of corners")?;
        if n > line.len() {
            return Err(fault(path, number, format!("the face claims {n} corners")));
        }
        corners.clear();
        for _ in 0..n {
            let corner = index("corner for each that it counts")?;
            if corner >= n_vertices {
                return Err(fault(path, number, format!("the face names vertex {corner}, but there are {n_vertices}")));
            }
            corners.push(corner as u32);
        }
        if let Some(word) = words.find(|word| scalar::number(word).is_none()) {
            return Err(fault(path, number, format!("\"{word}\" is not a number of a colour")));
        }
        fan(&mut faces, &corners);
    }
    if let Some((_, number)) = lines.next() {
        return Err(fault(path, number, format!("more follows than the {n_faces} faces that the file counts")));
    }
    shape.stated = stated;
    shape.places = Places::Lines(places);
    shape.normals = has_normals.then_some(normals);
    if n_faces > 0 {
        shape.faces = Some(faces);
    } else if has_colours {
        shape.extras = ["red", "green", "blue"].into_iter().map(String::from).zip(colours).collect();
    }
    Ok(shape)
}

fn fault(path: &Path, line: usize, message: impl Into<String>) -> FileError {
    FileError::content(path, format!("line {line}"), message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Space, mesh_file::MeshRead};
    use osteoflow_geometry::SurfaceOrigin;

    fn mesh(text: &str) -> Result<MeshRead, FileError> {
        let path = "a.off".as_ref();
        shape(path, text)?.into_mesh(path, 1.0, "ct".into(), SurfaceOrigin::User)
    }

    #[test]
    fn the_same_square_is_read_from_every_variant() {
        for text in [
            "OFF\n4 1 0\n0 0 0\n9 0 0\n9 9 0\n0 9 0\n4 0 1 2 3\n",
            "# SPACE=LPS\nOFF 4 2 5 # counts\n\n0 0 0\n9 0 0 # second\n9 9 0\n0 9 0\n3 0 1 2 255 0 0\n3 0 2 3 0.5 0.5 0.5 1\n",
            "COFF\n4 1\n0 0 0 1 0 0 1\n9 0 0 1 0 0 1\n9 9 0 1 0 0 1\n0 9 0 1 0 0 1\n4 0 1 2 3\n",
            "NOFF\r\n4 1 0\r\n0 0 0 0 0 1\r\n9 0 0 0 0 1\r\n9 9 0 0 0 1\r\n0 9 0 0 0 1\r\n4 0 1 2 3\r\n",
        ] {
            let found = mesh(text).unwrap_or_else(|e| panic!("{e}\n{text}"));
            assert_eq!(found.mesh.faces(), [[0, 1, 2], [0, 2, 3]], "{text}");
            assert_eq!(found.mesh.vertices()[2], Point3::new(9.0, 9.0, 0.0), "{text}");
            assert_eq!(found.space == Space::Lps, text.contains("LPS"));
        }
    }

    #[test]
    fn vertices_alone_are_a_cloud_with_normals_and_colours() {
        let path = "a.off".as_ref();
        let text = "CNOFF\n2 0 0\n1 2 3 0 0 1 10 20 30\n4 5 6 0 1 0 11 21 31\n";
        let found = shape(path, text).unwrap().into_cloud(path, 1.0, "camera".into()).unwrap();
        assert_eq!(found.cloud.normals().unwrap(), [Vector3::z(), Vector3::y()]);
        assert_eq!((&*found.cloud.extras()[2].0, &*found.cloud.extras()[2].1), ("blue", &[30.0, 31.0][..]));
    }

    #[test]
    fn a_broken_file_names_its_line() {
        for (text, expected) in [
            ("OFF\n", "line 1: the file ends before the counts"),
            ("OFF BINARY\n", "line 1: a binary OFF is not read"),
            ("4OFF\n1 0 0\n1 2 3 4\n", "line 1: \"4OFF\" with \"4\" is not read"),
            (
                "OFF\n9999999999 1 0\n",
                "line 2: 9999999999 vertices and 1 faces are promised, but the file has 19 bytes",
            ),
            ("OFF\n2 0 0\n1 2 3     \n   \n", "line 4: the file ends before vertex 1 of 2"),
            ("OFF\n1 0 0\n1 2 3 4\n", "line 3: a vertex of OFF has 3 numbers, this one has 4"),
            ("OFF\n1 0 0\n1 2 3\n4 5 6\n", "line 4: more follows than the 0 faces"),
            ("OFF\n1 1 0\n1 2 3\n3 0 0 1\n", "line 4: the face names vertex 1, but there are 1"),
            ("OFF\n1 1 0\n1 2 3\n3 0 0\n", "line 4: the face has no corner for each that it counts"),
            ("OFF\n1 x 0\n1 2 3\n3 0 0\n", "line 2: \"1 x 0\" is not the number of vertices"),
        ] {
            let said = mesh(text).unwrap_err().to_string();
            assert!(said.contains(expected), "{expected}\n{said}");
        }
    }
}
