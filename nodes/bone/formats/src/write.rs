//! Surfaces and clouds to files, in the format that the ending of the name says.

use crate::{FileError, Space};
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Cloud, Mesh};
use std::{fmt::Write as _, path::Path};

const MESH_ENDINGS: &str = "a surface is written as .ply, .stl or .obj";
const CLOUD_ENDINGS: &str = "a cloud is written as .ply, .pcd, .vtk, .obj or .csv";

/// What every file for other programs says in its header or in a comment, where its format has one.
pub const NOTICE: &str = "research use only, not for clinical use";

/// The precision of the numbers in a PLY or PCD.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit floats, which all programs read, where they keep the numbers to [`KEPT`]; else doubles.
    #[default]
    Single,
    /// Doubles, which keep every bit. PCL reads none of them, nor does Open3D from a PCD.
    Double,
}

/// How far a 32-bit float may be from the number that it stands for: 1e-4 mm, a hundredth of what a tracker resolves. Floats keep it
/// up to 2 m from the origin.
pub const KEPT: f64 = 1e-4;

/// Writes a surface, mm: `.ply` (binary), `.stl` (binary, always 32-bit floats) or `.obj`, and returns what the reader of the file
/// should know.
///
/// `mesh` is LPS if `space` is known; the file then states `space`, and for RAS x and y are negated. It has [`NOTICE`].
///
/// # Errors
/// [`FileError`] if the ending is another, or the file cannot be written.
pub fn write_mesh(path: &Path, mesh: &Mesh, space: Space, precision: Precision) -> Result<Vec<String>, FileError> {
    let coordinates = || mesh.vertices().iter().flat_map(|p| p.iter().copied());
    let mut notes = Vec::new();
    let bytes = match ending(path).as_str() {
        "ply" => {
            let width = width_of_points(coordinates(), precision, "a PLY", &mut notes);
            mesh_ply(mesh, space, width)
        }
        "stl" => {
            let off = largest_rounding(coordinates());
            if off > KEPT {
                notes.push(format!("the coordinates are 32-bit floats, as always in an STL, which move points by up to {off:.1e} mm; write .ply or .obj"));
            }
            stl(mesh, space, Some(NOTICE))
        }
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
    osteoflow_container::durable::write(path, bytes).map_err(FileError::write(path))?;
    Ok(notes)
}

/// Writes a cloud, mm: `.ply`, `.pcd` and `.vtk` (legacy; all binary), `.csv` or `.obj`, and returns what the reader of the file
/// should know.
///
/// 3D Slicer draws a `.vtk`, whose points are vertices, and nothing of a `.ply` without faces. Columns `red`, `green` and `blue` of
/// whole numbers up to 255 are the colours of the points in `.ply` and `.pcd`.
///
/// Normals are written if the cloud has them, further columns by all but `.obj`. `cloud` is LPS if `space` is known; the file
/// then states `space`, and for RAS x and y of points and normals are negated. It has [`NOTICE`], a `.csv` if it has comments.
///
/// # Errors
/// [`FileError`] if the ending is another, a column's name is one of a coordinate or given twice, an `.obj` would lose
/// further columns, or the file cannot be written.
pub fn write_cloud(path: &Path, cloud: &Cloud, space: Space, precision: Precision) -> Result<Vec<String>, FileError> {
    let mut notes = Vec::new();
    let mut packing = |format: &str| Packing::new(cloud, precision, format, &mut notes);
    let bytes = match ending(path).as_str() {
        "ply" => cloud_ply(path, cloud, 1.0, space, Some(NOTICE), &packing("a PLY"))?,
        "vtk" => vtk(path, cloud, space)?,
        "pcd" => pcd(path, cloud, space, &packing("a PCD"))?,
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
    osteoflow_container::durable::write(path, bytes).map_err(FileError::write(path))?;
    Ok(notes)
}

/// Writes a surface as binary STL, mm, in single precision; in frame `ct` it states LPS.
///
/// # Errors
/// [`FileError::Io`] if the file cannot be written.
pub fn write_stl(path: &Path, mesh: &Mesh) -> Result<(), FileError> {
    osteoflow_container::durable::write(path, stl(mesh, Space::of(&mesh.frame), None)).map_err(FileError::write(path))
}

/// Writes a cloud's points, and its normals and further columns if it has them, as little-endian PLY in double precision, so
/// that reading gives the same bits back for `unit_mm` = 1; 1000 writes metres (of the points, not of further columns).
///
/// # Errors
/// [`FileError`] if the file cannot be written, or a further column has the name of a coordinate.
pub fn write_ply(path: &Path, cloud: &Cloud, unit_mm: f64) -> Result<(), FileError> {
    let doubles = Packing::doubles(cloud);
    osteoflow_container::durable::write(path, cloud_ply(path, cloud, unit_mm, Space::Unknown, None, &doubles)?)
        .map_err(FileError::write(path))
}

/// The type of a number in a PLY or PCD.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Width {
    /// A 32-bit float.
    Single,
    /// A double.
    Double,
    /// A byte, of a colour.
    Byte,
}

impl Width {
    const fn ply(self) -> &'static str {
        match self {
            Self::Single => "float",
            Self::Double => "double",
            Self::Byte => "uchar",
        }
    }

    fn push(self, value: f64, bytes: &mut Vec<u8>) {
        match self {
            Self::Single => bytes.extend((value as f32).to_le_bytes()),
            Self::Double => bytes.extend(value.to_le_bytes()),
            Self::Byte => bytes.push(value as u8),
        }
    }
}

/// The types of the columns of a cloud: coordinates, normals, further columns.
pub(crate) struct Packing {
    columns: Vec<Width>,
    /// The places of red, green and blue in a row.
    colour: Option<[usize; 3]>,
}

impl Packing {
    fn new(cloud: &Cloud, precision: Precision, format: &str, notes: &mut Vec<String>) -> Self {
        let points = cloud.points().iter().flat_map(|p| p.iter().copied());
        let mut columns = vec![width_of_points(points, precision, format, notes); 3];
        // A normal is a direction, whose rounding is 6e-8 rad.
        let normals = if precision == Precision::Double { Width::Double } else { Width::Single };
        columns.extend(cloud.normals().iter().flat_map(|_| [normals; 3]));
        let first = columns.len();
        let of = |name: &str| cloud.extras().iter().position(|(column, _)| &**column == name);
        let is_byte = |k: &usize| cloud.extras()[*k].1.iter().all(|v| v.fract() == 0.0 && (0.0..=255.0).contains(v));
        let colour = [of("red"), of("green"), of("blue")];
        let colour = colour.into_iter().flatten().filter(is_byte).map(|k| k + first).collect::<Vec<_>>();
        let colour: Option<[usize; 3]> = colour.try_into().ok();
        for (k, (_, values)) in cloud.extras().iter().enumerate() {
            let is_colour = colour.is_some_and(|colour| colour.contains(&(k + first)));
            let narrow = precision == Precision::Single && largest_rounding(values.iter().copied()) <= KEPT;
            columns.push(if is_colour {
                Width::Byte
            } else if narrow {
                Width::Single
            } else {
                Width::Double
            });
        }
        Self { columns, colour }
    }

    /// All columns as doubles.
    pub(crate) fn doubles(cloud: &Cloud) -> Self {
        let n = if cloud.normals().is_some() { 6 } else { 3 };
        Self { columns: vec![Width::Double; n + cloud.extras().len()], colour: None }
    }
}

/// The largest distance of a finite number from the 32-bit float next to it.
fn largest_rounding(values: impl Iterator<Item = f64>) -> f64 {
    let off = |value: f64| if value.is_finite() { (f64::from(value as f32) - value).abs() } else { 0.0 };
    values.map(off).fold(0.0, f64::max)
}

/// The type of coordinates, with a note where it is double.
fn width_of_points(
    coordinates: impl Iterator<Item = f64>,
    precision: Precision,
    format: &str,
    notes: &mut Vec<String>,
) -> Width {
    let off = largest_rounding(coordinates);
    if precision == Precision::Single && off <= KEPT {
        return Width::Single;
    }
    let why = match precision {
        Precision::Single => format!("since 32-bit floats would move points by up to {off:.1e} mm"),
        Precision::Double => "as requested".into(),
    };
    let readers = if format == "a PCD" { "PCL and Open3D read" } else { "PCL reads" };
    notes.push(format!("the coordinates are doubles, {why}; {readers} zeros from such {format}"));
    Width::Double
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

/// A cloud as little-endian PLY.
pub(crate) fn cloud_ply(
    path: &Path,
    cloud: &Cloud,
    unit_mm: f64,
    space: Space,
    notice: Option<&str>,
    packing: &Packing,
) -> Result<Vec<u8>, FileError> {
    let names = column_names(path, cloud)?;
    let mut header = ply_head("cloud", cloud.frame.as_str(), space, notice);
    writeln!(header, "element vertex {}", cloud.len()).expect(ANY_TEXT);
    for (name, width) in names.iter().zip(&packing.columns) {
        writeln!(header, "property {} {name}", width.ply()).expect(ANY_TEXT);
    }
    header.push_str("end_header\n");
    let mut bytes = header.into_bytes();
    bytes.reserve(8 * names.len() * cloud.len());
    for k in 0..cloud.len() {
        for (column, value) in row(cloud, k, space).enumerate() {
            let value = if column < 3 { value / unit_mm } else { value };
            packing.columns[column].push(value, &mut bytes);
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

fn mesh_ply(mesh: &Mesh, space: Space, width: Width) -> Vec<u8> {
    let mut header = ply_head("surface", mesh.frame.as_str(), space, Some(NOTICE));
    let float = width.ply();
    write!(
        header,
        "element vertex {}\nproperty {float} x\nproperty {float} y\nproperty {float} z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.vertices().len(),
        mesh.faces().len()
    )
    .expect(ANY_TEXT);
    let mut bytes = header.into_bytes();
    for &vertex in mesh.vertices() {
        placed(vertex, space).into_iter().for_each(|c| width.push(c, &mut bytes));
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

fn pcd(path: &Path, cloud: &Cloud, space: Space, packing: &Packing) -> Result<Vec<u8>, FileError> {
    let mut names = column_names(path, cloud)?;
    if cloud.normals().is_some() {
        // The names of PCL.
        names.splice(3..6, ["normal_x", "normal_y", "normal_z"].map(String::from));
    }
    if let Some(name) = names.iter().find(|name| matches!(name.as_str(), "rgb" | "rgba")) {
        let message = format!("column \"{name}\" would be read as a packed colour in a PCD; rename it");
        return Err(FileError::content(path, "columns", message));
    }
    let is_colour = |column: usize| packing.colour.is_some_and(|colour| colour.contains(&column));
    let mut fields: Vec<(&str, &str)> = Vec::new();
    for (k, (name, width)) in names.iter().zip(&packing.columns).enumerate().filter(|(k, _)| !is_colour(*k)) {
        fields.push((name, if *width == Width::Double { "8" } else { "4" }));
        debug_assert!(*width != Width::Byte, "column {k} is a part of a colour");
    }
    // The colour of PCL: 0x00rrggbb in the bits of a float.
    fields.extend(packing.colour.map(|_| ("rgb", "4")));
    let joined = |words: Vec<&str>| words.join(" ");
    let tag = space.tag().map_or_else(String::new, |tag| format!("# {tag}\n"));
    let n = cloud.len();
    let header = format!(
        "# .PCD v0.7 - Point Cloud Data file format\n# {NOTICE}\n{tag}VERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {n}\n\
         HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n",
        joined(fields.iter().map(|(name, _)| *name).collect()),
        joined(fields.iter().map(|(_, size)| *size).collect()),
        joined(vec!["F"; fields.len()]),
        joined(vec!["1"; fields.len()]),
    );
    let mut bytes = header.into_bytes();
    for k in 0..n {
        let mut rgb = [0; 3];
        for (column, value) in row(cloud, k, space).enumerate() {
            match packing.colour.and_then(|colour| colour.iter().position(|&of| of == column)) {
                Some(part) => rgb[part] = value as u8,
                None => packing.columns[column].push(value, &mut bytes),
            }
        }
        let [red, green, blue] = rgb;
        bytes.extend(packing.colour.iter().flat_map(|_| [blue, green, red, 0]));
    }
    Ok(bytes)
}

/// A cloud as legacy VTK poly data, each point a vertex; normals and further columns as attributes, of which programs show the first
/// scalars.
///
/// Binary: VTK up to 9.5 takes a NaN in a text for 0, and loses what follows it.
pub(crate) fn vtk(path: &Path, cloud: &Cloud, space: Space) -> Result<Vec<u8>, FileError> {
    fn section(bytes: &mut Vec<u8>, head: &str, values: impl Iterator<Item = f64>) {
        bytes.extend(head.bytes().chain([b'\n']));
        bytes.extend(values.flat_map(f64::to_be_bytes).chain([b'\n']));
    }
    let names = column_names(path, cloud)?;
    let tag = space.tag().map_or_else(String::new, |tag| format!(", {tag}"));
    let n = cloud.len();
    let mut bytes = format!("# vtk DataFile Version 3.0\nosteoflow cloud, mm{tag}, {NOTICE}\n").into_bytes();
    let points = cloud.points().iter().flat_map(|&p| placed(p, space));
    section(&mut bytes, &format!("BINARY\nDATASET POLYDATA\nPOINTS {n} double"), points);
    bytes.extend(format!("VERTICES {n} {}\n", 2 * n).bytes());
    bytes.extend((0..n as u32).flat_map(|k| [1, k]).flat_map(u32::to_be_bytes).chain([b'\n']));
    if cloud.normals().is_some() || !cloud.extras().is_empty() {
        bytes.extend(format!("POINT_DATA {n}\n").bytes());
    }
    if let Some(normals) = cloud.normals() {
        section(&mut bytes, "NORMALS normals double", normals.iter().flat_map(|&normal| turned(normal, space)));
    }
    let further = names.iter().skip(if cloud.normals().is_some() { 6 } else { 3 });
    for (name, (_, values)) in further.zip(cloud.extras()) {
        section(&mut bytes, &format!("SCALARS {name} double 1\nLOOKUP_TABLE default"), values.iter().copied());
    }
    Ok(bytes)
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
    fn a_vtk_keeps_what_is_missing_in_a_column_and_the_column_behind_it() {
        let file = tempfile::NamedTempFile::with_suffix(".vtk").unwrap();
        let columns = cloud().with_extra("first", vec![f64::NAN, 1.5]).unwrap().with_extra("second", vec![2.0, 3.0]);
        write_cloud(file.path(), &columns.unwrap(), Space::Lps, Precision::Single).unwrap();
        let back = read_cloud(file.path(), 1.0, "ct").unwrap().cloud;
        let [(_, first), (name, second)] = back.extras() else { panic!("{:?}", back.extras()) };
        assert!(first[0].is_nan() && first[1] == 1.5 && (&**name, &second[..]) == ("second", &[2.0, 3.0]));
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
                        let message = write_cloud(&path, &cloud, space, Precision::Double).unwrap_err().to_string();
                        assert!(message.contains("an OBJ cannot hold the column \"intensity\""), "{message}");
                        continue;
                    }
                    write_cloud(&path, &cloud, space, Precision::Double).unwrap();
                    let back = read_cloud(&path, 1.0, "ct").unwrap();
                    assert_eq!((&back.cloud, back.space, back.n_dropped), (&cloud, space, 0), "{ending} {space}");
                    assert_eq!(back.notes.len(), usize::from(space == Space::Ras), "{:?}", back.notes);
                }
            }
        }
    }

    #[test]
    fn numbers_are_32_bit_floats_where_these_keep_them_and_doubles_elsewhere() {
        let dir = tempfile::tempdir().unwrap();
        let near =
            Cloud::new("ct", vec![Point3::new(1.0 / 3.0, -1999.9999, 7.0), Point3::new(-0.1, 0.2, 1.0)]).unwrap();
        let near = near.with_normals(vec![Vector3::z(), Vector3::new(0.6, 0.0, -0.8)]).unwrap();
        let columns = [("time", [1.6e9 + 0.25, 0.0]), ("red", [0.0, 255.0]), ("heat", [0.1, f64::NAN])];
        let columns = columns.into_iter().chain([("blue", [7.0, 8.0]), ("green", [1.0, 2.0])]);
        let near = columns.fold(near, |cloud, (name, values)| cloud.with_extra(name, values.to_vec()).unwrap());
        for (ending, float, double) in [
            ("ply", "property float x\n", "property double x\n"),
            ("pcd", "\nSIZE 4 4 4 4 4 4 8 4 4\n", "\nSIZE 8 8 8\n"),
        ] {
            let path = dir.path().join(format!("cloud.{ending}"));
            assert_eq!(write_cloud(&path, &near, Space::Lps, Precision::Single).unwrap(), [""; 0]);
            let text = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
            assert!(text.contains(float), "{text}");
            let back = read_cloud(&path, 1.0, "ct").unwrap().cloud;
            let off = near.points().iter().zip(back.points()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!(off < KEPT, "{off} mm");
            for (name, values) in near.extras() {
                let (_, found) = back.extras().iter().find(|(other, _)| other == name).unwrap();
                let same = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-7 || a.is_nan() && b.is_nan();
                assert!(values.iter().zip(found.iter()).all(same), "{name}: {values:?} {found:?}");
            }
            let farther = Cloud::new("ct", vec![Point3::new(9000.1, 0.0, 0.0)]).unwrap();
            let notes = write_cloud(&path, &farther, Space::Lps, Precision::Single).unwrap();
            assert!(
                notes[0].starts_with("the coordinates are doubles, since 32-bit floats would move points by up to"),
                "{notes:?}"
            );
            assert!(String::from_utf8_lossy(&std::fs::read(&path).unwrap()).contains(double));
            assert_eq!(read_cloud(&path, 1.0, "ct").unwrap().cloud, farther, "bit for bit, and not shifted");
        }
        let path = dir.path().join("far.stl");
        let vertices =
            vec![Point3::new(9000.1, 0.0, 0.0), Point3::new(9000.2, 1.0, 0.0), Point3::new(9000.1, 0.0, 1.0)];
        let mesh = Mesh::new("ct", SurfaceOrigin::User, vertices, vec![[0, 1, 2]]).unwrap();
        let notes = write_mesh(&path, &mesh, Space::Lps, Precision::Single).unwrap();
        assert!(notes[0].contains("as always in an STL") && notes[0].ends_with("write .ply or .obj"), "{notes:?}");
        let path = dir.path().join("far.ply");
        assert_eq!(write_mesh(&path, &mesh, Space::Lps, Precision::Single).unwrap().len(), 1);
        assert_eq!(read_mesh(&path, 1.0, "ct", SurfaceOrigin::User).unwrap().mesh.vertices(), mesh.vertices());
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
                write_mesh(&path, &mesh, space, Precision::Single).unwrap();
                let back = read_mesh(&path, 1.0, "ct", SurfaceOrigin::User).unwrap();
                assert_eq!(back.space, space, "{ending}");
                let corners = |mesh: &Mesh| (0..4).map(|face| mesh.corners(face)).collect::<Vec<_>>();
                assert_eq!(corners(&back.mesh), corners(&mesh), "{ending} {space}: the numbers fit single precision");
            }
        }
    }

    #[test]
    fn an_unknown_ending_or_a_name_that_is_taken_is_refused() {
        let message =
            write_cloud("a.xyzrgb".as_ref(), &cloud(), Space::Lps, Precision::Single).unwrap_err().to_string();
        assert_eq!(
            message,
            "a.xyzrgb: name: nothing is written as \".xyzrgb\"; a cloud is written as .ply, .pcd, .vtk, .obj or .csv"
        );
        let mesh = Mesh::new("ct", SurfaceOrigin::User, vec![Point3::origin(); 3], vec![[0, 1, 2]]).unwrap();
        let message = write_mesh("a.pcd".as_ref(), &mesh, Space::Lps, Precision::Single).unwrap_err().to_string();
        assert_eq!(message, "a.pcd: name: nothing is written as \".pcd\"; a surface is written as .ply, .stl or .obj");
        let twice = cloud().with_extra("X", vec![0.0; 2]).unwrap();
        let message = write_cloud("a.ply".as_ref(), &twice, Space::Lps, Precision::Single).unwrap_err().to_string();
        assert!(message.contains("columns: a further column is called \"X\", which is taken"), "{message}");
    }
}
