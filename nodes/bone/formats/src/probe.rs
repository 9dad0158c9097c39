//! What a file or folder is: one table of formats, which every reader and command asks first, and whose words they use.
//!
//! A format is recognised by its content, never by its name. What is not read is named, with the program that makes of it what is.

use crate::{
    FileError, cloud_text,
    cursor::{Cursor, is_text, without_byte_order_mark},
    folder, foreign_recording, input, obj, off, pcd, picked_points, plan_file, ply, pose_file,
    pose_log::{LogFormat, format_of, is_sequence},
    region_file,
    shape::Shape,
    stl, volume, vtk,
};
use serde_json::{Map, Value};
use std::{fmt, fs, path::Path};

/// What a file or folder holds; it is written as every command names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Triangles.
    Mesh,
    /// Points.
    Cloud,
    /// Named points that were picked by hand.
    Points,
    /// Voxels of a CT, or of another scanner.
    Ct,
    /// One rigid motion.
    Pose,
    /// Poses over time.
    Poses(LogFormat),
    /// A surgical plan.
    Plan,
    /// A region of interest.
    Region,
    /// The results of a run or a registration.
    Results,
    /// An MCAP recording, or a folder of such.
    Recording,
    /// A folder with a procedure in files.
    Procedure,
    /// A format that is not read, by its name.
    Unread(&'static str),
    /// None of the known formats.
    Unknown,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mesh => "a surface",
            Self::Cloud => "a cloud of points",
            Self::Points => "picked points",
            Self::Ct => "a CT",
            Self::Pose => "a rigid motion",
            Self::Poses(format) => return format.fmt(f),
            Self::Plan => "a surgical plan",
            Self::Region => "a region of interest",
            Self::Results => "results of a run",
            Self::Recording => "a recording",
            Self::Procedure => "a folder with a procedure in files",
            Self::Unread(name) => name,
            Self::Unknown => "of no known format",
        })
    }
}

/// What a file or folder is.
#[derive(Debug, Clone)]
pub struct Probe {
    /// What it holds.
    pub kind: Kind,
    /// The name of its format, where the kind has several.
    pub format: &'static str,
    /// What to do with it, where it is not read or something else is needed.
    pub advice: String,
    /// Reads it as a surface or a cloud.
    pub(crate) reader: Option<Reader>,
}

/// Reads a surface or a cloud.
pub(crate) type Reader = fn(&Path, &[u8]) -> Result<Shape, FileError>;

/// The format of clouds, picked points and unknown words in lines of text.
pub(crate) const TEXT: &str = "text";

/// Bytes that tell what is too large to be read for that alone.
const N_HEAD: u64 = 1 << 16;

/// A surface or a cloud: its name, whether bytes are of it, whether they have faces, its reader.
type Shaped = (&'static str, fn(&[u8]) -> bool, fn(&[u8]) -> bool, Reader);

/// The surfaces and clouds with a mark that no other file has.
const MARKED: &[Shaped] = &[
    (
        "PLY",
        ply::is_ply,
        |bytes| has_line(head(bytes), &["element face "]) && !has_line(head(bytes), &["element face 0"]),
        ply::shape,
    ),
    ("STL", stl::is_binary, |_| true, stl::binary),
    ("VTK", vtk::is_vtk, |bytes| has_line(bytes, &["POLYGONS ", "TRIANGLE_STRIPS "]), vtk::shape),
    ("PCD", pcd::is_pcd, |_| false, pcd::shape),
];

/// The others, which are text, in the order in which they are tried.
const UNMARKED: &[Shaped] = &[
    ("STL", stl::is_ascii, |_| true, stl::ascii),
    ("OBJ", obj::is_obj, |bytes| has_line(bytes, &["f "]), obj::shape),
    ("OFF", off::is_off, counts_faces, off::shape),
    (TEXT, cloud_text::begins_with_points, |_| false, cloud_text::shape),
];

/// What is not read: how it begins, words in its head, its name, and what makes of it what is read.
type Unread = (&'static [&'static [u8]], &'static str, &'static str, &'static str);

const SURFACE: &str = "export the surface as STL, PLY or OBJ";
const POINTS: &str = "export the points as PLY, PCD or text";
const PICTURE: &str = "a picture shows a surface and does not hold it; export it as STL, PLY or OBJ";
const CSV: &str = "save the table as CSV";
const UNPACK: &str = "unpack it, and give the file that is needed";
const NUMPY: &str = "write its points by numpy.savetxt(\"points.xyz\", array)";
const PANDAS: &str = "write it by to_csv(\"points.csv\", index=False) of pandas";
const MATLAB: &str = "write its points by writematrix(points, \"points.csv\")";
const FREESURFER: &str = "convert it by `mris_convert FILE bone.stl` of FreeSurfer";
const BODIES: &str = "export the poses of its bodies as CSV, with one heading, which --columns describes";

/// In the order in which they are tried.
const UNREAD: &[Unread] = &[
    (&[b"glTF"], "", "GLB (binary glTF)", SURFACE),
    (&[b"ASTM-E57"], "", "E57", POINTS),
    (&[b"LASF"], "", "LAS or LAZ", POINTS),
    (&[b"\x1f\x8b"], "", "gzip data", UNPACK),
    (&[b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf"], "", "compressed data", UNPACK),
    (&[b"PK\x03\x04"], "xl/", "an Excel workbook", CSV),
    (&[b"PK\x03\x04"], "3dmodel.model", "3MF (a ZIP archive)", SURFACE),
    (&[b"PK\x03\x04"], "[Content_Types].xml", "3MF (a ZIP archive)", SURFACE),
    (&[b"PK\x03\x04"], ".npy", "NumPy arrays (.npz)", NUMPY),
    (&[b"PK\x03\x04"], "", "a ZIP archive", UNPACK),
    (&[b"\xd0\xcf\x11\xe0"], "", "a document of an older Office (.xls)", CSV),
    (&[b"\x93NUMPY"], "", "a NumPy array (.npy)", NUMPY),
    (&[b"\x80\x03", b"\x80\x04\x95", b"\x80\x05\x95"], "", "a pickle of Python", NUMPY),
    (&[b"PAR1"], "", "Parquet", PANDAS),
    (&[b"ARROW1"], "", "Arrow (Feather)", PANDAS),
    (&[b"MATLAB "], "MAT-file", "a MAT-file of MATLAB", MATLAB),
    (&[b"\x89HDF\r\n"], "", "HDF5", "export a surface as STL, points as CSV, a transform as .tfm"),
    (&[b"%PDF"], "", "a PDF document", PICTURE),
    (&[b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"II*\0", b"MM\0*"], "", "a picture", PICTURE),
    (&[b"Kaydara FBX"], "", "FBX", SURFACE),
    (&[b"CCB2"], "", "CloudCompare's own format (.bin)", "save it there as PLY, a surface or a cloud"),
    (&[b"#VRML"], "", "VRML", SURFACE),
    (&[b"\xff\xff\xfe", b"\xff\xff\xff", b"#!ascii version of"], "", "a surface of FreeSurfer", FREESURFER),
    (&[b"BLENDER"], "", "a Blender scene", SURFACE),
    (&[b"ISO-10303-21"], "", "STEP", SURFACE),
    (&[b"3D Geometry File Format"], "", "3DM of Rhino", SURFACE),
    (&[b"PXR-USDC"], "", "USD", SURFACE),
    (&[b"AutoCAD Binary DXF", b"0\nSECTION", b"0\r\nSECTION"], "", "DXF", SURFACE),
    (&[b"999"], "SECTION", "DXF", SURFACE),
    (&[b"AC10"], "", "DWG", SURFACE),
    (&[b"\x02P"], "", "C3D", BODIES),
    (&[b"Format Version,"], "", "a table of OptiTrack's Motive", BODIES),
    (&[b"NO_OF_FRAMES"], "", "a table of Qualisys", BODIES),
    (&[b"\xff\xfe", b"\xfe\xff"], "", "UTF-16 text", "save it as UTF-8"),
    (&[b"<"], "<VTKFile", "XML of VTK (.vtp, .vtu)", "write the surface as legacy .vtk, PLY or STL"),
    (&[b"<"], "<GIFTI", "GIFTI", FREESURFER),
    (&[b"<"], "<COLLADA", "COLLADA", SURFACE),
    (&[b"<"], "", "XML or HTML", SURFACE),
];

/// What a file or folder is.
///
/// A recording or a volume is told by its first bytes; other files are read.
///
/// # Errors
/// [`FileError`] if it cannot be read, is empty, is a JSON that is none, or may be two things.
pub fn probe(path: &Path) -> Result<Probe, FileError> {
    if path.is_dir() {
        return Ok(Probe::new(folder_kind(path), "", path));
    }
    match volume_or_recording(path, &input::head(path, N_HEAD)?) {
        Some(probe) => Ok(probe),
        None => of(path, &input::read(path)?),
    }
}

/// What the bytes of a file are; `path` is used in messages only.
pub(crate) fn of(path: &Path, bytes: &[u8]) -> Result<Probe, FileError> {
    if bytes.is_empty() {
        return Err(FileError::content(path, "byte 0", "the file is empty; was it written to the end?"));
    }
    // The 80 bytes that a binary STL begins with may hold anything.
    let bytes = if stl::is_binary(bytes) { bytes } else { without_byte_order_mark(bytes) };
    let found = volume_or_recording(path, bytes).or_else(|| shaped(MARKED, path, bytes));
    if let Some(probe) = found.or_else(|| unread(path, bytes)) {
        return Ok(probe);
    }
    if !is_text(bytes) {
        // A binary STL that was cut short has no other mark.
        return Ok(Probe { reader: Some(stl::binary), ..Probe::new(Kind::Unknown, "", path) });
    }
    if bytes.trim_ascii_start().starts_with(b"{") {
        return object(path, bytes);
    }
    Cursor::text(path, bytes)?;
    if pose_file::is_pose(bytes) {
        return Ok(Probe::new(Kind::Pose, "", path));
    }
    if let Some(format) = format_of(path, bytes)? {
        return Ok(Probe::new(Kind::Poses(format), "", path));
    }
    if let Some(format) = picked_points::format_of(path, bytes) {
        let reader = (format == TEXT).then_some(cloud_text::shape as Reader);
        return Ok(Probe { reader, ..Probe::new(Kind::Points, format, path) });
    }
    let unknown = || Probe { reader: Some(cloud_text::shape), ..Probe::new(Kind::Unknown, TEXT, path) };
    Ok(shaped(UNMARKED, path, bytes).unwrap_or_else(unknown))
}

/// A recording, a sequence of poses or a volume, of which the first bytes tell what they are.
fn volume_or_recording(path: &Path, head: &[u8]) -> Option<Probe> {
    if head.starts_with(b"\x89MCAP0") {
        return Some(Probe::new(Kind::Recording, "MCAP", path));
    }
    if let Some(name) = foreign_recording::kind(head) {
        let advice = foreign_recording::advice(path);
        return Some(Probe { advice, ..Probe::new(Kind::Unread(name), "", path) });
    }
    if volume::is_mgh(head) {
        let advice = "convert it by `mri_convert FILE ct.nii.gz` of FreeSurfer".into();
        return Some(Probe { advice, ..Probe::new(Kind::Unread("MGH of FreeSurfer"), "", path) });
    }
    let format = volume::format_of(head)?;
    let is_log = format == volume::METAIMAGE && is_sequence(head);
    Some(Probe::new(if is_log { Kind::Poses(LogFormat::IgsMha) } else { Kind::Ct }, format, path))
}

fn shaped(formats: &[Shaped], path: &Path, bytes: &[u8]) -> Option<Probe> {
    let (format, _, has_faces, reader) = *formats.iter().find(|(_, is_it, ..)| is_it(bytes))?;
    let kind = if has_faces(bytes) { Kind::Mesh } else { Kind::Cloud };
    Some(Probe { reader: Some(reader), ..Probe::new(kind, format, path) })
}

fn unread(path: &Path, bytes: &[u8]) -> Option<Probe> {
    let bytes = bytes.trim_ascii_start();
    let head = head(bytes);
    let is_it = |(starts, words, ..): &&Unread| starts.iter().any(|start| head.starts_with(start)) && has(head, words);
    let (name, advice) = match UNREAD.iter().find(is_it) {
        Some(_) if has(head, "<PickedPoints") => return None,
        Some((.., name, advice)) => (*name, *advice),
        None if is_ptx(head) => ("PTX", "save it by CloudCompare as PLY"),
        None => return None,
    };
    Some(Probe { advice: advice.into(), ..Probe::new(Kind::Unread(name), "", path) })
}

/// What a folder is: that of a procedure, a bag of ROS 2, or of a DICOM series.
fn folder_kind(path: &Path) -> Kind {
    let is_recording =
        |entry: fs::DirEntry| entry.path().extension().is_some_and(|ending| ending == "mcap" || ending == "db3");
    let has_recording =
        || fs::read_dir(path).is_ok_and(|mut entries| entries.any(|entry| entry.is_ok_and(is_recording)));
    match () {
        () if path.join(folder::FILE_NAME).is_file() => Kind::Procedure,
        () if path.join("metadata.yaml").is_file() || has_recording() => Kind::Recording,
        () => Kind::Ct,
    }
}

/// A JSON object, by its keys.
fn object(path: &Path, bytes: &[u8]) -> Result<Probe, FileError> {
    let head = head(bytes);
    let root: Map<String, Value> = match serde_json::from_slice(bytes) {
        Ok(root) => root,
        // Its reader names the place in its own words.
        Err(_) if has(head, "\"markups\"") => return Ok(Probe::new(Kind::Points, "markups of 3D Slicer", path)),
        Err(error) => {
            return Err(FileError::content(path, format!("line {}", error.line()), format!("no JSON: {error}")));
        }
    };
    let has_key = |keys: &[&str]| keys.iter().any(|key| root.contains_key(*key));
    let (kind, format) = match () {
        () if has_key(&pose_file::KEYS) => (Kind::Pose, "JSON"),
        () if has_key(&["verdict"]) && has_key(&["notice"]) => (Kind::Results, ""),
        () if has_key(&["markups"]) || has(head, "markups-schema") => (Kind::Points, "markups of 3D Slicer"),
        () if root.get("format").is_some_and(|format| format == region_file::FORMAT) => (Kind::Region, ""),
        () if plan_file::is_plan(&root) => (Kind::Plan, ""),
        () if has_key(&["asset", "glTF", "meshes"]) => (Kind::Unread("glTF"), ""),
        () => (Kind::Unread("JSON"), ""),
    };
    Ok(Probe::new(kind, format, path))
}

/// As many bytes as have the words that tell a format.
fn head(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(4096)]
}

fn has_line(bytes: &[u8], starts: &[&str]) -> bool {
    bytes.split(|b| *b == b'\n').any(|line| starts.iter().any(|start| line.starts_with(start.as_bytes())))
}

/// Whether the head of an OFF counts faces, behind the vertices.
fn counts_faces(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head(bytes));
    let mut words = text.lines().flat_map(|line| line.split('#').next().unwrap_or_default().split_whitespace());
    words.nth(2).is_some_and(|n_faces| n_faces != "0")
}

fn has(head: &[u8], word: &str) -> bool {
    word.is_empty() || head.windows(word.len()).any(|window| window == word.as_bytes())
}

/// Whether a text begins as a PTX: columns, rows, the place of the scanner and its axes, and a 4 x 4 matrix.
fn is_ptx(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let widths = text.lines().take(10).map(|line| {
        let numbers = line.split_whitespace().map(|word| word.parse::<f64>().ok());
        numbers.collect::<Option<Vec<_>>>().map_or(0, |numbers| numbers.len())
    });
    widths.eq([1, 1, 3, 3, 3, 3, 4, 4, 4, 4])
}

impl Probe {
    fn new(kind: Kind, format: &'static str, path: &Path) -> Self {
        let advice = match kind {
            Kind::Ct => "segment the bone and export its surface as STL or PLY".into(),
            Kind::Points => "export the bone's model as STL or PLY".into(),
            Kind::Pose => format!("osteoflow register BONE SCAN --init {} starts from it", path.display()),
            Kind::Poses(_) => format!(
                "osteoflow info {} says what takes it; if these are points, name the columns in a first line that begins with x y z",
                path.display()
            ),
            Kind::Unknown => "is it damaged?".into(),
            Kind::Unread("JSON") => "it has none of the keys of a plan, a pose, markups, a region or results".into(),
            Kind::Unread(_) => SURFACE.into(),
            _ => format!("osteoflow info {} says what takes it", path.display()),
        };
        Self { kind, format, advice, reader: None }
    }

    /// The refusal of a reader that needs something else.
    pub(crate) fn refusal(&self, path: &Path, wanted: &str) -> FileError {
        let Self { kind, format, advice, .. } = self;
        let format = if format.is_empty() { String::new() } else { format!(" ({format})") };
        let message = match kind {
            Kind::Unread(name) => format!("{name} is not read; {advice}"),
            Kind::Unknown => format!("it is {kind}, and {wanted} is needed; {advice}"),
            kind => format!("it holds {kind}{format}, and {wanted} is needed; {advice}"),
        };
        FileError::content(path, "byte 0", message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(place: usize, mark: &[u8]) -> Vec<u8> {
        [&vec![0; place][..], mark, &[0; 8]].concat()
    }

    fn kind(bytes: &[u8]) -> Kind {
        of("a.file".as_ref(), bytes).unwrap_or_else(|error| panic!("{error}")).kind
    }

    fn refused(bytes: &[u8]) -> String {
        let path = "a.file".as_ref();
        match of(path, bytes) {
            Ok(probe) => probe.refusal(path, "a surface or a cloud").to_string(),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn what_is_not_read_is_named_with_what_makes_of_it_what_is() {
        let ptx = "2\n1\n1 2 3\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n1 2 3 1\n-5 6 7 0.5\n-5 6 8 0.5\n";
        for (bytes, name, advice) in [
            (at(0, b"glTF"), "GLB (binary glTF)", SURFACE),
            (at(0, b"ASTM-E57"), "E57", POINTS),
            (at(0, b"LASF"), "LAS or LAZ", POINTS),
            (at(0, b"\x93NUMPY\x01\0"), "a NumPy array (.npy)", "numpy.savetxt"),
            (at(0, b"PK\x03\x04....points.npy"), "NumPy arrays (.npz)", "numpy.savetxt"),
            (at(0, b"\x80\x04\x95"), "a pickle of Python", "numpy.savetxt"),
            (at(0, b"MATLAB 5.0 MAT-file, Platform"), "a MAT-file of MATLAB", "writematrix"),
            (at(0, b"MATLAB 7.3 MAT-file, Platform"), "a MAT-file of MATLAB", "writematrix"),
            (at(0, b"\x89HDF\r\n\x1a\n"), "HDF5", "a transform as .tfm"),
            (at(0, b"PAR1"), "Parquet", "to_csv"),
            (at(0, b"ARROW1"), "Arrow (Feather)", "to_csv"),
            (at(0, b"PK\x03\x04[Content_Types].xml xl/workbook.xml"), "an Excel workbook", CSV),
            (at(0, b"PK\x03\x04....3D/3dmodel.model"), "3MF (a ZIP archive)", SURFACE),
            (at(0, b"PK\x03\x04"), "a ZIP archive", "unpack it"),
            (at(0, b"\x1f\x8b\x08"), "", "gzip of nothing is taken for a damaged volume"),
            (at(0, b"7z\xbc\xaf"), "compressed data", "unpack it"),
            (at(0, b"\xff\xd8\xff\xe0"), "a picture", PICTURE),
            (at(0, b"II*\0"), "a picture", PICTURE),
            (at(0, b"CCB22\0"), "CloudCompare's own format (.bin)", "save it there as PLY"),
            (at(0, b"\xff\xff\xfecreated by"), "a surface of FreeSurfer", "mris_convert"),
            (b"#!ascii version of lh.white\n4 2\n".into(), "a surface of FreeSurfer", "mris_convert"),
            (
                [1, 8, 9, 10, 1, 3, 0].iter().flat_map(|n: &i32| n.to_be_bytes()).collect(),
                "MGH of FreeSurfer",
                "mri_convert",
            ),
            (b"<?xml version=\"1.0\"?>\n<!DOCTYPE GIFTI>\n<GIFTI Version=\"1.0\">".into(), "GIFTI", "mris_convert"),
            (b"<VTKFile type=\"PolyData\">".into(), "XML of VTK (.vtp, .vtu)", "legacy .vtk"),
            (b"<html>".into(), "XML or HTML", SURFACE),
            (b"  0\r\nSECTION\r\n  2\r\nENTITIES\r\n".into(), "DXF", SURFACE),
            (ptx.into(), "PTX", "CloudCompare"),
            (at(0, b"\x02P\x01\0"), "C3D", "as CSV"),
            (b"Format Version,1.23,Take Name,a\n".into(), "a table of OptiTrack's Motive", "one heading"),
            (at(0, b"\xff\xfe1\0"), "UTF-16 text", "save it as UTF-8"),
            (at(0, b"#ROSBAG V2.0\n"), "a ROS 1 bag", "rosbags-convert --src a.file"),
            (br#"{"asset":{"version":"2.0"}}"#.into(), "glTF", SURFACE),
            (br#"{"points":[]}"#.into(), "JSON", "none of the keys"),
        ] {
            if name.is_empty() {
                assert_eq!(kind(&bytes), Kind::Ct, "{advice}");
                continue;
            }
            let said = refused(&bytes);
            assert!(
                said.starts_with(&format!("a.file: byte 0: {name} is not read; ")) && said.contains(advice),
                "{said}"
            );
        }
        assert!(refused(b"").contains("the file is empty; was it written to the end?"));
        assert!(refused(b"{\n\"a\": ").contains("line 2: no JSON: "), "{}", refused(b"{\n\"a\": "));
    }

    #[test]
    fn what_is_read_by_others_is_named_with_what_takes_it() {
        for (bytes, expected) in [
            (
                at(0, b"\x89MCAP0\r\n"),
                "it holds a recording (MCAP), and a surface or a cloud is needed; osteoflow info a.file says",
            ),
            (
                at(0, &348_i32.to_le_bytes()),
                "it holds a CT (NIfTI), and a surface or a cloud is needed; segment the bone",
            ),
            (at(0, b"NRRD0005\n"), "it holds a CT (NRRD), "),
            (at(128, b"DICM"), "it holds a CT (DICOM), "),
            (b"ObjectType = Image\nNDims = 3\n".into(), "it holds a CT (MetaImage), "),
            (br#"{"markups":[]}"#.into(), "it holds picked points (markups of 3D Slicer), "),
            (b"# Markups fiducial file version = 4.11\n".into(), "it holds picked points (fiducials of 3D Slicer), "),
            (b"<!DOCTYPE PickedPoints>\n<PickedPoints>".into(), "it holds picked points (a list of MeshLab), "),
            (br#"{"landmarks":{}}"#.into(), "it holds a surgical plan, "),
            (br#"{"left":{"landmarks":{}}}"#.into(), "it holds a surgical plan, "),
            (br#"{"format":"osteoflow-region"}"#.into(), "it holds a region of interest, "),
            (br#"{"verdict":{},"notice":""}"#.into(), "it holds results of a run, "),
            (br#"{"T":[]}"#.into(), "it holds a rigid motion (JSON), "),
        ] {
            let said = refused(&bytes);
            assert!(said.starts_with(&format!("a.file: byte 0: {expected}")), "{said}");
        }
    }

    #[test]
    fn sixteen_numbers_in_any_separator_are_a_rigid_motion() {
        let rows = "1 0 0 10\n0 1 0 20\n0 0 1 30\n0 0 0 1\n";
        for text in [
            rows.to_owned(),
            rows.replace(' ', ","),
            rows.replace(' ', ", "),
            rows.replace(' ', ";"),
            rows.replace(' ', "\t"),
            rows.replace('\n', " "),
            rows.replace(['\n', ' '], "\n"),
            format!("# 4x4\n{}", rows.replace(' ', ";")),
            rows.replace(' ', ";").replace("10", "10,5"),
            rows.replace("10", "10,5"),
            "[[1, 0, 0, 10],\n [0, 1, 0, 20],\n [0, 0, 1, 30],\n [0, 0, 0, 1]]\n".into(),
            "#Insight Transform File V1.0\n".into(),
        ] {
            assert_eq!(kind(text.as_bytes()), Kind::Pose, "{text}");
            assert!(
                refused(text.as_bytes()).contains("osteoflow register BONE SCAN --init a.file starts from it"),
                "{text}"
            );
        }
        assert_eq!(
            kind(b"0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n"),
            Kind::Poses(LogFormat::Tum),
            "two rows of a trajectory"
        );
        assert_eq!(kind(b"1 0 0 10\n0 1 0 20\n0 0 1 30\n4 5 6 7\n"), Kind::Cloud);
    }

    #[test]
    fn rows_of_a_stamp_and_a_pose_are_a_log_unless_a_heading_says_that_they_are_points() {
        let rows = |step: f64, quaternion: &str, separator: &str| -> String {
            let row = |k: usize| format!("{} {}.5 20 200 {quaternion}\n", step * k as f64, k % 7);
            (0..40).map(row).collect::<String>().replace(' ', separator)
        };
        let (tum, euroc) = (Kind::Poses(LogFormat::Tum), Kind::Poses(LogFormat::Euroc));
        for (text, expected) in [
            (rows(0.05, "0 0 0 1", " "), tum),
            (rows(0.05, "0 0 0 1", ","), tum),
            (rows(1e6, "1 0 0 0", ","), euroc),
            (rows(1e6, "1 0 0 0", " "), euroc),
            (format!("x y z a b c d e\n{}", rows(0.05, "0 0 0 1", " ")), Kind::Cloud),
            (format!("# x y z a b c d e\n{}", rows(0.05, "0 0 0 1", " ")), Kind::Cloud),
            (format!("time,x,y,z,q0,q1,q2,q3\n{}", rows(0.05, "1 0 0 0", ",")), Kind::Poses(LogFormat::Table)),
            (
                format!("time,px,py,pz,qx,qy,qz,qw,err\n{}", rows(0.05, "0 0 0 1 0.1", ",")),
                Kind::Poses(LogFormat::Table),
            ),
            (rows(0.05, "0 0 0 2", " "), Kind::Cloud),
        ] {
            assert_eq!(kind(text.as_bytes()), expected, "{}", &text[..60]);
        }
        for quaternion in ["0 0 0 1", "0.5 0.5 0.5 0.5", "0.8 0 0 0.6"] {
            let said = refused(rows(1e6, quaternion, ",").as_bytes());
            assert!(
                said.contains("line 1: these are poses with stamps in whole numbers, but whether w is the first"),
                "{said}"
            );
        }
    }

    #[test]
    fn surfaces_clouds_and_picked_points_are_told_apart_without_being_read() {
        let ply = |faces: usize| {
            format!(
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
            )
        };
        let vtk = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\n";
        for (text, expected) in [
            (ply(1), Kind::Mesh),
            (ply(0), Kind::Cloud),
            (vtk.into(), Kind::Cloud),
            (format!("{vtk}POLYGONS 1 4\n"), Kind::Mesh),
            ("# .PCD v0.7\n".into(), Kind::Cloud),
            ("solid a\nfacet".into(), Kind::Mesh),
            ("v 1 2 3\n".into(), Kind::Cloud),
            ("v 1 2 3\nf 1 1 1\n".into(), Kind::Mesh),
            ("OFF\n3 1 0\n".into(), Kind::Mesh),
            ("OFF\n# none\n3 0 0\n".into(), Kind::Cloud),
            ("1 2 3\n".into(), Kind::Cloud),
            ("3\n1,5 2 3\n".into(), Kind::Cloud),
            ("//X,Y,Z\n".into(), Kind::Cloud),
            ("label,x,y,z\nP1,1,2,3\n".into(), Kind::Points),
            ("0,1,2,3\n1,4,5,6\n2,7,8,10\n".into(), Kind::Points),
            ("some words\nof a reader\n".into(), Kind::Unknown),
        ] {
            assert_eq!(kind(text.as_bytes()), expected, "{text}");
        }
        assert_eq!(kind(&[7; 300]), Kind::Unknown);
    }
}
