//! Wavefront OBJ.

use crate::{
    FileError,
    cursor::{Cursor, first_line},
    shape::{Places, Shape, fan, of_colours},
    space::StatedSpace,
};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// The first words of the lines of an OBJ that are read or passed over.
const PASSED_OVER: [&str; 16] = [
    "vt", "vp", "o", "g", "s", "mg", "mtllib", "usemtl", "usemap", "maplib", "l", "p", "lod", "bevel", "c_interp",
    "d_interp",
];

/// Whether the first line that is no comment is one of an OBJ.
pub(crate) fn is_obj(bytes: &[u8]) -> bool {
    first_line(bytes, |line| {
        let word = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        let word = std::str::from_utf8(word).unwrap_or_default();
        word.len() < line.len() && (matches!(word, "v" | "vn" | "f") || PASSED_OVER.contains(&word))
            || matches!(word, "g" | "o" | "s")
    })
}

/// What the lines of an OBJ give.
#[derive(Default)]
struct Obj {
    points: Vec<Point3<f64>>,
    /// The line of each.
    places: Vec<usize>,
    normals: Vec<Vector3<f64>>,
    colours: Vec<[f64; 3]>,
    faces: Option<Vec<[u32; 3]>>,
    corners: Vec<u32>,
    /// The vertex farthest behind the end of those that precede it, and the line that names it.
    farthest: (usize, usize),
    n_lines_or_points: usize,
}

/// The surface in an OBJ file, or the cloud if it has no faces.
///
/// Faces may name a corner as `a`, `a/b`, `a//c` or `a/b/c`, from the first vertex on or, negative, back from the last.
/// Colours behind the coordinates are kept for a cloud; so are normals if there is one for each point.
pub(crate) fn shape(path: &Path, bytes: &[u8]) -> Result<Shape, FileError> {
    let mut cursor = Cursor::text(path, bytes)?;
    let mut stated = StatedSpace::default();
    let (mut obj, mut joined) = (Obj::default(), String::new());
    while let Some(line) = cursor.line() {
        // A backslash joins a line to the next.
        if let Some(start) = line.strip_suffix('\\') {
            joined.push_str(start);
            joined.push(' ');
            continue;
        }
        let line = if joined.is_empty() { line } else { (std::mem::take(&mut joined) + &line).into() };
        let (content, comment) = line.split_once('#').unwrap_or((&line, ""));
        stated.take(comment).map_err(|message| cursor.fault(message))?;
        obj.take(&cursor, content)?;
    }
    let Obj { points, places, normals, colours, faces, farthest, n_lines_or_points, .. } = obj;
    if !joined.is_empty() {
        return Err(cursor.fault("the file ends behind a backslash; was it cut short?"));
    }
    if farthest.0 > points.len() {
        let message = format!("the face names vertex {}, but there are {}", farthest.0, points.len());
        return Err(cursor.fault_at(farthest.1, message));
    }
    if points.is_empty() {
        return Err(cursor.fault("there is no vertex in it"));
    }
    let mut notes = Vec::new();
    if n_lines_or_points > 0 {
        notes.push(format!("{n_lines_or_points} elements \"l\" or \"p\" were left out"));
    }
    let mut shape = Shape { faces, stated, notes, places: Places::Lines(places), ..Shape::default() };
    if shape.faces.is_none() {
        let mut is_whole = |n: usize, what: &str| {
            if n != 0 && n != points.len() {
                shape.notes.push(format!("{n} {what} for {} points were left out", points.len()));
            }
            n == points.len()
        };
        if is_whole(normals.len(), "normals") {
            shape.normals = Some(normals);
        }
        if is_whole(colours.len(), "colours") {
            shape.extras = of_colours(&colours, &mut shape.notes);
        }
    }
    shape.points = points;
    Ok(shape)
}

impl Obj {
    /// Takes a line without its comment.
    fn take(&mut self, cursor: &Cursor, content: &str) -> Result<(), FileError> {
        let fault = |message: String| Err(cursor.fault(message));
        let mut words = content.split_ascii_whitespace();
        let Some(key) = words.next() else { return Ok(()) };
        let mut numbers = [0.0; 8];
        let mut n = 0;
        if matches!(key, "v" | "vn") {
            for word in words.by_ref() {
                let value = cursor.number(word)?;
                if n == numbers.len() {
                    return fault(format!("more than {n} numbers follow \"{key}\""));
                }
                numbers[n] = value;
                n += 1;
            }
        }
        let [x, y, z, ..] = numbers;
        match (key, n) {
            ("v", 3 | 4 | 6 | 7) => {
                if matches!(n, 4 | 7) && numbers[3] != 1.0 {
                    return fault(format!("the vertex has the weight {}; only 1 is read", numbers[3]));
                }
                self.points.push(Point3::new(x, y, z));
                self.places.push(cursor.line);
                if n >= 6 {
                    self.colours.push([numbers[n - 3], numbers[n - 2], numbers[n - 1]]);
                }
            }
            ("v", _) => return fault(format!("a vertex has three numbers, this one has {n}")),
            ("vn", 3) => self.normals.push(Vector3::new(x, y, z)),
            ("vn", _) => return fault(format!("a normal has three numbers, this one has {n}")),
            ("f", _) => {
                self.corners.clear();
                for word in words {
                    let corner = corner(word, self.points.len()).map_err(|message| cursor.fault(message))?;
                    if corner > self.points.len() && corner > self.farthest.0 {
                        self.farthest = (corner, cursor.line);
                    }
                    let Ok(index) = u32::try_from(corner - 1) else {
                        return fault(format!("vertex {corner} is too far"));
                    };
                    self.corners.push(index);
                }
                if self.corners.len() < 3 {
                    let n = self.corners.len();
                    return fault(format!("a face has three corners or more, this one has {n}"));
                }
                fan(self.faces.get_or_insert_default(), &self.corners);
            }
            ("l" | "p", _) => self.n_lines_or_points += 1,
            (key, _) if PASSED_OVER.contains(&key) => {}
            ("cstype" | "deg" | "surf" | "curv" | "curv2" | "end", _) => {
                return fault("free-form surfaces are not read; export the surface as triangles".into());
            }
            _ => return fault(format!("\"{key}\" is no line of an OBJ")),
        }
        Ok(())
    }
}

/// The vertex that a corner of a face names, counted from 1.
fn corner(word: &str, n_vertices: usize) -> Result<usize, String> {
    let mut parts = word.split('/');
    let index = |part: &str| part.parse::<i64>().ok().filter(|&i| i != 0);
    let vertex = index(parts.next().unwrap_or_default()).ok_or_else(|| {
        format!("\"{word}\" is no corner of a face; a vertex is a whole number from 1 on, or below 0")
    })?;
    if parts.clone().count() > 2 || parts.any(|part| !part.is_empty() && index(part).is_none()) {
        return Err(format!("\"{word}\" is no corner of a face; a, a/b, a//c or a/b/c is expected"));
    }
    if vertex > 0 {
        return usize::try_from(vertex).map_err(|_| format!("vertex {vertex} is too far"));
    }
    let back = usize::try_from(vertex.unsigned_abs()).unwrap_or(usize::MAX);
    n_vertices
        .checked_sub(back)
        .map(|place| place + 1)
        .ok_or_else(|| format!("\"{word}\" names the vertex {back} before, but there are {n_vertices} so far"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Space, shape::MeshRead};
    use osteoflow_geometry::SurfaceOrigin;

    #[test]
    fn colours_from_0_to_1_are_scaled_and_others_kept() {
        let colours = |text: &str| {
            let path = "a.obj".as_ref();
            let read = shape(path, text.as_bytes()).unwrap().into_cloud(path, 1.0, "ct".into()).unwrap();
            let values: Vec<_> = read.cloud.extras().iter().flat_map(|(_, values)| values.to_vec()).collect();
            (values, read.notes.len())
        };
        assert_eq!(
            colours("v 1 2 3 1 0 0.996078\nv 4 5 6 0.003922 0 0\n"),
            (vec![255.0, 1.0, 0.0, 0.0, 254.0, 0.0], 1)
        );
        assert_eq!(colours("v 1 2 3 1 0 0\n"), (vec![255.0, 0.0, 0.0], 1), "pure red");
        assert_eq!(colours("v 1 2 3 1 0 200\n"), (vec![1.0, 0.0, 200.0], 0), "bytes");
        assert_eq!(colours("v 1 2 3 0 0 0\n"), (vec![0.0; 3], 0), "black");
    }

    const SQUARE: &str = "mtllib a.mtl\no bone\nv 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nvt 0 0\nvn 0 0 1\n";

    fn mesh(text: &str) -> Result<MeshRead, FileError> {
        let path = "a.obj".as_ref();
        shape(path, text.as_bytes())?.into_mesh(path, 1.0, "ct".into(), SurfaceOrigin::User)
    }

    #[test]
    fn corners_are_read_in_every_form() {
        for face in [
            "f 1 2 3 4",
            "f 1/1 2/1 3/1 4/1",
            "f 1//1 2//1 3//1 4//1",
            "f 1/1/1 2/1/1 3/1/1 4/1/1",
            "f -4 -3 -2 -1",
            "f 1 2 \\\n 3 4",
            "f 1 2 3 # first\nf 1 3 4",
            "usemtl m\ns off\nf 1 2 3 4\r",
        ] {
            let result = mesh(&format!("{SQUARE}{face}\n")).unwrap_or_else(|e| panic!("{e}\n{face}"));
            assert_eq!(result.mesh.faces(), [[0, 1, 2], [0, 2, 3]], "{face}");
            assert_eq!((result.notes, result.space), (vec![], Space::Unknown), "{face}");
        }
    }

    #[test]
    fn faces_may_precede_their_vertices_and_ras_is_turned() {
        let result = mesh("# 3D Slicer output. SPACE=RAS\nf 1 2 3\nv 0 0 0\nv 9 0 0\nv 0 9 1\n").unwrap();
        assert_eq!((result.space, result.mesh.vertices()[2]), (Space::Ras, Point3::new(0.0, -9.0, 1.0)));
        assert!(
            (result.mesh.area_vector(0) - Vector3::new(0.0, 9.0, 81.0)).norm() < 1e-12,
            "a rotation keeps the winding"
        );
    }

    #[test]
    fn vertices_alone_are_a_cloud_with_normals_and_colours() {
        let text = "v 1 2 3 0.5 0.25 1\nvn 0 0 1\nv nan 2 3 0 0 0\nvn 0 1 0\nv 4 5 6 1 0 0\nvn 1 0 0\n";
        let path = "a.obj".as_ref();
        let read = |text: &str| shape(path, text.as_bytes()).unwrap().into_cloud(path, 1.0, "camera".into()).unwrap();
        let result = read(text);
        assert_eq!((result.cloud.len(), result.n_dropped), (2, 1));
        assert_eq!(result.cloud.normals().unwrap(), [Vector3::z(), Vector3::x()]);
        assert_eq!(&*result.cloud.extras()[1].1, [64.0, 0.0]);
        let result = read("v 1 2 3\nv 1 2 4 1 1 1\nvn 0 0 1\np 1\n");
        assert_eq!(result.notes.len(), 3, "{:?}", result.notes);
    }

    #[test]
    fn a_broken_file_names_its_line() {
        for (rest, expected) in [
            ("f 1 2\n", "line 9: a face has three corners or more, this one has 2"),
            ("f 1 2 5\n", "line 9: the face names vertex 5, but there are 4"),
            ("f 1 2 0\n", "line 9: \"0\" is no corner of a face; a vertex"),
            ("f 1 2 -5\n", "line 9: \"-5\" names the vertex 5 before, but there are 4 so far"),
            ("f 1 2 3/x\n", "line 9: \"3/x\" is no corner of a face; a, a/b"),
            ("v 1 2\n", "line 9: a vertex has three numbers, this one has 2"),
            ("v 1 2,5 3\n", "line 9: \"2,5\" is not a number"),
            ("surf 0 1\n", "line 9: free-form surfaces are not read"),
            ("facet\n", "line 9: \"facet\" is no line of an OBJ"),
            ("f 1 2 3 \\\n", "line 9: the file ends behind a backslash"),
            ("", "surface: the file holds 4 points and no faces, but a surface is needed"),
        ] {
            let message = mesh(&format!("{SQUARE}{rest}")).unwrap_err().to_string();
            assert!(message.contains(expected), "{expected}\n{message}");
        }
    }
}
