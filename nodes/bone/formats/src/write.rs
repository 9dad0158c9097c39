//! Surfaces and clouds to files, in the format that the ending of the name says.

use crate::{FileError, Space};
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Cloud, Mesh};
use std::{fmt::Write as _, path::Path};

const MESH_ENDINGS: &str = "a surface is written as .ply, .stl or .obj";
const CLOUD_ENDINGS: &str = "a cloud is written as .ply, .pcd, .vtk, .obj or .csv";

/// What every file for other programs says in its header or in a comment, where its format has one.
pub const NOTICE: &str = "research use only, not for clinical use";

/// Writes a surface, mm: `.ply` (binary, double precision), `.stl` (binary, single precision) or `.obj`.
///
/// `mesh` is LPS if `space` is known; the file then states `space`, and for RAS x and y are negated. It has [`NOTICE`].
///
/// # Errors
/// [`FileError`] if the ending is another, or the file cannot be written.
pub fn write_mesh(path: &Path, mesh: &Mesh, space: Space) -> Result<(), FileError> {
    let bytes = match ending(path).as_str() {
        "ply" => mesh_ply(mesh, space),
        "stl" => stl(mesh, space, Some(NOTICE)),
        "obj" => {
            let mut text = obj_head(mesh.frame.as_str(), space);
            mesh.vertices().iter().for_each(|&p| line(&mut text, "v", placed(p, space)));
            for face in mesh.faces() {
                let [a, b, c] = face.map(|corner| u64::from(corner) + 1);
                writeln!(text, "f {a} {b} {c}").expect(ANY_TEXT);
            }
            text.into_bytes()
        }
        other => return Err(unknown(path, other, MESH_ENDINGS)),
    };
    std::fs::write(path, bytes).map_err(FileError::write(path))
}

/// Writes a cloud, mm: `.ply` and `.pcd` (binary, double precision), `.vtk` (legacy, text), `.csv` or `.obj`.
///
/// 3D Slicer draws a `.vtk`, whose points are vertices, and nothing of a `.ply` without faces.
///
/// Normals are written if the cloud has them, further columns by all but `.obj`. `cloud` is LPS if `space` is known; the file
/// then states `space`, and for RAS x and y of points and normals are negated. It has [`NOTICE`], a `.csv` if it has comments.
///
/// # Errors
/// [`FileError`] if the ending is another, a column's name is one of a coordinate or given twice, an `.obj` would lose
/// further columns, or the file cannot be written.
pub fn write_cloud(path: &Path, cloud: &Cloud, space: Space) -> Result<(), FileError> {
    let bytes = match ending(path).as_str() {
        "ply" => cloud_ply(path, cloud, 1.0, space, Some(NOTICE))?,
        "vtk" => vtk(path, cloud, space)?.into_bytes(),
        "pcd" => pcd(path, cloud, space)?,
        "csv" => csv(path, cloud, space)?.into_bytes(),
        "obj" => {
            if let Some((name, _)) = cloud.extras().first() {
                let message = format!("an OBJ cannot hold the column \"{name}\"; write .ply, .pcd or .csv");
                return Err(FileError::content(path, "columns", message));
            }
            let mut text = obj_head(cloud.frame.as_str(), space);
            cloud.points().iter().for_each(|&p| line(&mut text, "v", placed(p, space)));
            cloud.normals().unwrap_or_default().iter().for_each(|&n| line(&mut text, "vn", turned(n, space)));
            text.into_bytes()
        }
        other => return Err(unknown(path, other, CLOUD_ENDINGS)),
    };
    std::fs::write(path, bytes).map_err(FileError::write(path))
}

/// Writes a surface as binary STL, mm, in single precision; in frame `ct` it states LPS.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_stl(path: &Path, mesh: &Mesh) -> Result<(), FileError> {
    std::fs::write(path, stl(mesh, Space::of(&mesh.frame), None)).map_err(FileError::write(path))
}

/// Writes a cloud's points, and its normals and further columns if it has them, as little-endian PLY in double precision, so
/// that reading gives the same bits back for `unit_mm` = 1; 1000 writes metres (of the points, not of further columns).
///
/// # Errors
/// [`FileError`] if the file cannot be written, or a further column has the name of a coordinate.
pub fn write_ply(path: &Path, cloud: &Cloud, unit_mm: f64) -> Result<(), FileError> {
    std::fs::write(path, cloud_ply(path, cloud, unit_mm, Space::Unknown, None)?).map_err(FileError::write(path))
}

const ANY_TEXT: &str = "a string takes any text";

/// The ending of a file, in lower case; empty if it has none.
pub fn ending(path: &Path) -> String {
    path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default()
}

fn unknown(path: &Path, ending: &str, endings: &str) -> FileError {
    FileError::content(path, "name", format!("nothing is written as \".{ending}\"; {endings}"))
}

fn placed(point: Point3<f64>, space: Space) -> [f64; 3] {
    turned(point.coords, space)
}

fn turned(vector: Vector3<f64>, space: Space) -> [f64; 3] {
    let sign = space.x_y_sign();
    [sign * vector.x, sign * vector.y, vector.z]
}

fn one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

fn obj_head(frame: &str, space: Space) -> String {
    let tag = space.tag().map_or_else(String::new, |tag| format!(", {tag}"));
    format!("# osteoflow, mm, frame {}{tag}\n# {NOTICE}\n", one_line(frame))
}

fn line(text: &mut String, key: &str, [x, y, z]: [f64; 3]) {
    writeln!(text, "{key} {x} {y} {z}").expect(ANY_TEXT);
}

/// The columns of a row of a cloud: coordinates, normals, further columns; their names hold no blank.
fn column_names(path: &Path, cloud: &Cloud) -> Result<Vec<String>, FileError> {
    let n = if cloud.normals().is_some() { 6 } else { 3 };
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"][..n].iter().map(|&name| name.into()).collect();
    for (name, _) in cloud.extras() {
        let name = name.replace(|c: char| c.is_whitespace() || c.is_control() || matches!(c, ',' | ';' | '"'), "_");
        let reserved = ["x", "y", "z", "nx", "ny", "nz", "normal_x", "normal_y", "normal_z", "_", ""];
        if names.contains(&name) || reserved.iter().any(|other| name.eq_ignore_ascii_case(other)) {
            let message = format!("a further column is called \"{name}\", which is taken; rename it");
            return Err(FileError::content(path, "columns", message));
        }
        names.push(name);
    }
    Ok(names)
}

/// The numbers of a row, in the order of the names.
fn row(cloud: &Cloud, k: usize, space: Space) -> impl Iterator<Item = f64> {
    let normal = cloud.normals().map(|normals| turned(normals[k], space));
    let extras = cloud.extras().iter().map(move |(_, values)| values[k]);
    placed(cloud.points()[k], space).into_iter().chain(normal.into_iter().flatten()).chain(extras)
}

/// A cloud as little-endian PLY in double precision.
pub(crate) fn cloud_ply(
    path: &Path,
    cloud: &Cloud,
    unit_mm: f64,
    space: Space,
    notice: Option<&str>,
) -> Result<Vec<u8>, FileError> {
    let names = column_names(path, cloud)?;
    let mut header = ply_head("cloud", cloud.frame.as_str(), space, notice);
    writeln!(header, "element vertex {}", cloud.len()).expect(ANY_TEXT);
    names.iter().for_each(|name| writeln!(header, "property double {name}").expect(ANY_TEXT));
    header.push_str("end_header\n");
    let mut bytes = header.into_bytes();
    bytes.reserve(8 * names.len() * cloud.len());
    for k in 0..cloud.len() {
        for (column, value) in row(cloud, k, space).enumerate() {
            let value = if column < 3 { value / unit_mm } else { value };
            bytes.extend(value.to_le_bytes());
        }
    }
    Ok(bytes)
}

fn ply_head(what: &str, frame: &str, space: Space, notice: Option<&str>) -> String {
    let notice = notice.map_or_else(String::new, |notice| format!("comment {notice}\n"));
    let tag = space.tag().map_or_else(String::new, |tag| format!("comment {tag}\n"));
    let frame = one_line(frame);
    format!("ply\nformat binary_little_endian 1.0\ncomment osteoflow {what}, frame {frame}\n{notice}{tag}")
}

fn mesh_ply(mesh: &Mesh, space: Space) -> Vec<u8> {
    let mut header = ply_head("surface", mesh.frame.as_str(), space, Some(NOTICE));
    write!(
        header,
        "element vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices().len(),
        mesh.faces().len()
    )
    .expect(ANY_TEXT);
    let mut bytes = header.into_bytes();
    for &vertex in mesh.vertices() {
        bytes.extend(placed(vertex, space).iter().flat_map(|c| c.to_le_bytes()));
    }
    for face in mesh.faces() {
        bytes.push(3);
        bytes.extend(face.iter().flat_map(|corner| corner.to_le_bytes()));
    }
    bytes
}

/// A surface as binary STL; its header of 80 bytes has the first part of the notice.
pub(crate) fn stl(mesh: &Mesh, space: Space, notice: Option<&str>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(84 + 50 * mesh.faces().len());
    let tag = space.tag().map_or_else(String::new, |tag| format!("{tag}, "));
    let notice = notice.and_then(|notice| notice.split(',').next()).map_or_else(String::new, |n| format!("{n}, "));
    let header = format!("osteoflow surface, {tag}{notice}mm, frame {}", mesh.frame);
    bytes.extend(header.bytes().chain(std::iter::repeat(0)).take(80));
    bytes.extend((mesh.faces().len() as u32).to_le_bytes());
    for face in 0..mesh.faces().len() {
        let normal = mesh.area_vector(face).try_normalize(0.0).unwrap_or_default();
        let corners = mesh.corners(face).map(|p| p.coords);
        for vector in std::iter::once(normal).chain(corners) {
            bytes.extend(turned(vector, space).iter().flat_map(|&c| (c as f32).to_le_bytes()));
        }
        bytes.extend([0, 0]);
    }
    bytes
}

fn pcd(path: &Path, cloud: &Cloud, space: Space) -> Result<Vec<u8>, FileError> {
    let mut names = column_names(path, cloud)?;
    if cloud.normals().is_some() {
        // The names of PCL.
        names.splice(3..6, ["normal_x", "normal_y", "normal_z"].map(String::from));
    }
    if let Some(name) = names.iter().find(|name| matches!(name.as_str(), "rgb" | "rgba")) {
        let message = format!("column \"{name}\" would be read as a packed colour in a PCD; rename it");
        return Err(FileError::content(path, "columns", message));
    }
    let same = |word: &str| vec![word; names.len()].join(" ");
    let tag = space.tag().map_or_else(String::new, |tag| format!("# {tag}\n"));
    let n = cloud.len();
    let header = format!(
        "# .PCD v0.7 - Point Cloud Data file format\n# {NOTICE}\n{tag}VERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {n}\n\
         HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n",
        names.join(" "),
        same("8"),
        same("F"),
        same("1"),
    );
    let mut bytes = header.into_bytes();
    (0..n).for_each(|k| row(cloud, k, space).for_each(|value| bytes.extend(value.to_le_bytes())));
    Ok(bytes)
}

/// A cloud as legacy VTK poly data in text, each point a vertex; normals and further columns as attributes.
fn vtk(path: &Path, cloud: &Cloud, space: Space) -> Result<String, FileError> {
    let names = column_names(path, cloud)?;
    let tag = space.tag().map_or_else(String::new, |tag| format!(", {tag}"));
    let n = cloud.len();
    let title = format!("osteoflow cloud, mm{tag}, {NOTICE}");
    let mut text = format!("# vtk DataFile Version 3.0\n{title}\nASCII\nDATASET POLYDATA\nPOINTS {n} double\n");
    let triple = |text: &mut String, [x, y, z]: [f64; 3]| writeln!(text, "{x} {y} {z}").expect(ANY_TEXT);
    cloud.points().iter().for_each(|&p| triple(&mut text, placed(p, space)));
    writeln!(text, "VERTICES {n} {}", 2 * n).expect(ANY_TEXT);
    (0..n).for_each(|k| writeln!(text, "1 {k}").expect(ANY_TEXT));
    if cloud.normals().is_some() || !cloud.extras().is_empty() {
        writeln!(text, "POINT_DATA {n}").expect(ANY_TEXT);
    }
    if let Some(normals) = cloud.normals() {
        text.push_str("NORMALS normals double\n");
        normals.iter().for_each(|&normal| triple(&mut text, turned(normal, space)));
    }
    let further = names.iter().skip(if cloud.normals().is_some() { 6 } else { 3 });
    for (name, (_, values)) in further.zip(cloud.extras()) {
        writeln!(text, "SCALARS {name} double 1\nLOOKUP_TABLE default").expect(ANY_TEXT);
        values.iter().for_each(|value| writeln!(text, "{value}").expect(ANY_TEXT));
    }
    Ok(text)
}

fn csv(path: &Path, cloud: &Cloud, space: Space) -> Result<String, FileError> {
    let mut text = space.tag().map_or_else(String::new, |tag| format!("# {tag}\n# {NOTICE}\n"));
    text.push_str(&column_names(path, cloud)?.join(","));
    text.push('\n');
    for k in 0..cloud.len() {
        for (column, value) in row(cloud, k, space).enumerate() {
            let comma = if column > 0 { "," } else { "" };
            write!(text, "{comma}{value}").expect(ANY_TEXT);
        }
        text.push('\n');
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_or_cloud::{read_cloud, read_mesh};
    use osteoflow_geometry::SurfaceOrigin;

    const SPACES: [Space; 3] = [Space::Lps, Space::Ras, Space::Unknown];

    fn cloud() -> Cloud {
        let points = vec![Point3::new(1.0 / 3.0, -2e-9, 210.123456789), Point3::new(-0.5, 5e3, 1.0)];
        Cloud::new("ct", points).unwrap()
    }

    #[test]
    fn a_cloud_survives_each_format_bit_for_bit_in_each_space() {
        let dir = tempfile::tempdir().unwrap();
        let with_normals = cloud().with_normals(vec![Vector3::z(), Vector3::new(0.6, 0.0, -0.8)]).unwrap();
        let with_extras = with_normals.clone().with_extra("intensity", vec![7.5, -1.0]).unwrap();
        for ending in ["ply", "PCD", "vtk", "csv", "obj"] {
            let path = dir.path().join(format!("cloud.{ending}"));
            for cloud in [cloud(), with_normals.clone(), with_extras.clone()] {
                for space in SPACES {
                    if ending == "obj" && !cloud.extras().is_empty() {
                        let message = write_cloud(&path, &cloud, space).unwrap_err().to_string();
                        assert!(message.contains("an OBJ cannot hold the column \"intensity\""), "{message}");
                        continue;
                    }
                    write_cloud(&path, &cloud, space).unwrap();
                    let back = read_cloud(&path, 1.0, "ct").unwrap();
                    assert_eq!((&back.cloud, back.space, back.n_dropped), (&cloud, space, 0), "{ending} {space}");
                    assert_eq!(back.notes.len(), usize::from(space == Space::Ras), "{:?}", back.notes);
                }
            }
        }
    }

    #[test]
    fn a_surface_survives_each_format_in_each_space() {
        let dir = tempfile::tempdir().unwrap();
        let vertices = vec![
            Point3::origin(),
            Point3::new(40.5, 0.0, 0.0),
            Point3::new(0.0, 40.25, 1.0),
            Point3::new(1.0, 2.0, 50.0),
        ];
        let faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        let mesh = Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap();
        for ending in ["ply", "stl", "obj"] {
            let path = dir.path().join(format!("mesh.{ending}"));
            for space in SPACES {
                write_mesh(&path, &mesh, space).unwrap();
                let back = read_mesh(&path, 1.0, "ct", SurfaceOrigin::User).unwrap();
                assert_eq!(back.space, space, "{ending}");
                let corners = |mesh: &Mesh| (0..4).map(|face| mesh.corners(face)).collect::<Vec<_>>();
                assert_eq!(corners(&back.mesh), corners(&mesh), "{ending} {space}: the numbers fit single precision");
            }
        }
    }

    #[test]
    fn an_unknown_ending_or_a_name_that_is_taken_is_refused() {
        let message = write_cloud("a.xyzrgb".as_ref(), &cloud(), Space::Lps).unwrap_err().to_string();
        assert_eq!(
            message,
            "a.xyzrgb: name: nothing is written as \".xyzrgb\"; a cloud is written as .ply, .pcd, .vtk, .obj or .csv"
        );
        let mesh = Mesh::new("ct", SurfaceOrigin::User, vec![Point3::origin(); 3], vec![[0, 1, 2]]).unwrap();
        let message = write_mesh("a.pcd".as_ref(), &mesh, Space::Lps).unwrap_err().to_string();
        assert_eq!(message, "a.pcd: name: nothing is written as \".pcd\"; a surface is written as .ply, .stl or .obj");
        let twice = cloud().with_extra("X", vec![0.0; 2]).unwrap();
        let message = write_cloud("a.ply".as_ref(), &twice, Space::Lps).unwrap_err().to_string();
        assert!(message.contains("columns: a further column is called \"X\", which is taken"), "{message}");
    }
}
