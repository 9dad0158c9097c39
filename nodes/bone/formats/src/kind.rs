//! What a file may be: the kinds, their names, and the formats that a mark at their beginning tells.

use crate::{FileError, foreign_recording, metaimage_header::is_metaimage, scene_header};
use osteoflow_geometry::MM_PER_M;
use schemars::JsonSchema;
use serde::Deserialize;
use std::{fmt, path::Path};

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
}

/// The format of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// A MetaImage or NRRD with a transform for each frame of a sequence.
    IgsMha,
    /// TUM: `timestamp x y z qx qy qz qw`.
    Tum,
    /// EuRoC: `timestamp,x,y,z,qw,qx,qy,qz`.
    Euroc,
    /// KITTI: twelve numbers.
    Kitti,
    /// `t_ns,parent,child,x,y,z,qx,qy,qz,qw`.
    Poses,
    /// A table of NDI's Track, whose heading begins with `Tools,Port`, or of the sample program of NDI's API, with `ToolInfo`.
    Ndi,
    /// A table of OptiTrack's Motive, or of Vicon's Tracker, whose heading is several lines.
    MotionCapture,
    /// A table whose heading is described.
    Table,
}

impl LogFormat {
    /// The unit of length of the format, mm.
    pub fn unit_mm(self) -> f64 {
        match self {
            Self::Tum | Self::Euroc | Self::Kitti => MM_PER_M,
            Self::IgsMha | Self::Poses | Self::Ndi | Self::MotionCapture | Self::Table => 1.0,
        }
    }

    /// Whether a file of the format names the frames of its poses.
    pub fn names_frames(self) -> bool {
        !matches!(self, Self::Tum | Self::Euroc | Self::Kitti)
    }
}

impl fmt::Display for LogFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::IgsMha => "a tracked sequence (.igs.mha, .igs.nrrd)",
            Self::Tum => "a TUM trajectory",
            Self::Euroc => "a EuRoC trajectory",
            Self::Kitti => "a KITTI trajectory",
            Self::Poses => "poses (t_ns, parent, child, ..)",
            Self::Ndi => "a table of NDI's programs",
            Self::MotionCapture => "a table of motion capture (Motive, Vicon)",
            Self::Table => "a table of poses",
        })
    }
}

/// The format of clouds, picked points and unknown words in lines of text.
pub(crate) const TEXT: &str = "text";

/// A surface or a cloud: its name, whether bytes are of it, whether they have faces.
type Shaped = (&'static str, fn(&[u8]) -> bool, fn(&[u8]) -> bool);

const SHAPES: [Shaped; 5] = [
    ("PLY", |bytes| bytes.starts_with(b"ply"), has_ply_faces),
    ("STL", is_binary_stl, |_| true),
    ("VTK", |bytes| bytes.starts_with(b"# vtk DataFile"), |bytes| has_line(bytes, &["POLYGONS ", "TRIANGLE_STRIPS "])),
    ("VTK XML", is_vtp, has_vtp_faces),
    ("PCD", is_pcd, |_| false),
];

const EMPTY: &str = "the file is empty";

/// What is not read: how it begins, words in its head, its name, and what makes of it what is read.
type Unread = (&'static [&'static [u8]], &'static str, &'static str, &'static str);

pub(crate) const SURFACE: &str = "export the surface as STL, PLY or OBJ";
pub(crate) const POINTS: &str = "export the points as PLY, PCD or text";
pub(crate) const PICTURE: &str = "a picture shows a surface and does not hold it; export it as STL, PLY or OBJ";
pub(crate) const CSV: &str = "save the table as CSV";
const UNPACK: &str = "unpack it, and give the file that is needed";
const ARCHIVE: &str = "osteoflow run or sweep runs what is in it again; unpack it, and give the file that is needed";
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
    (&[b"PK\x03\x04"], "experiment.json", "an archive of osteoflow export", ARCHIVE),
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
    (&[b"NO_OF_FRAMES"], "", "a table of Qualisys", BODIES),
    (&[b"\xff\xfe", b"\xfe\xff"], "", "UTF-16 text", "save it as UTF-8"),
    (
        &[b"<"],
        "<VTKFile",
        "XML of VTK that is no poly data (.vtu, .vti)",
        "extract the surface and write it as .vtp, PLY or STL",
    ),
    (&[b"<"], "<GIFTI", "GIFTI", FREESURFER),
    (&[b"<"], "<COLLADA", "COLLADA", SURFACE),
    (&[b"<"], "", "XML or HTML", SURFACE),
];

/// What a mark at the beginning of a file says that it is; none if there is no such.
pub(crate) fn marked(path: &Path, bytes: &[u8]) -> Option<Probe> {
    let at = |place: usize, mark: &[u8]| bytes.get(place..).is_some_and(|rest| rest.starts_with(mark));
    let (kind, format) = match () {
        () if bytes.is_empty() => (Kind::Unread(EMPTY), ""),
        () if at(0, b"\x89MCAP0") => (Kind::Recording, "MCAP"),
        () if at(0, b"NRRD") => (Kind::Ct, "NRRD"),
        () if at(128, b"DICM") => (Kind::Ct, "DICOM"),
        () if is_metaimage(bytes) => (Kind::Ct, "MetaImage"),
        () if scene_header::is_scene(bytes) || scene_header::is_bundle(bytes) => (Kind::Points, "scene of 3D Slicer"),
        () => {
            if let Some(name) = foreign_recording::kind(bytes) {
                let advice = foreign_recording::advice(path);
                return Some(Probe { advice, ..Probe::new(Kind::Unread(name), "", path) });
            }
            let Some((format, _, has_faces)) = SHAPES.iter().find(|(_, is_it, _)| is_it(bytes)) else {
                return unread(path, bytes);
            };
            (if has_faces(bytes) { Kind::Mesh } else { Kind::Cloud }, *format)
        }
    };
    Some(Probe::new(kind, format, path))
}

fn unread(path: &Path, bytes: &[u8]) -> Option<Probe> {
    let bytes = bytes.trim_ascii_start();
    let head = head(bytes);
    let is_it = |(starts, words, ..): &&Unread| starts.iter().any(|start| head.starts_with(start)) && has(head, words);
    let (name, advice) = match UNREAD.iter().find(is_it) {
        Some(_) if has(head, "<PickedPoints") => return None,
        Some((.., name, advice)) => (*name, *advice),
        None if is_mgh(bytes) => ("MGH of FreeSurfer", "convert it by `mri_convert FILE ct.nii.gz` of FreeSurfer"),
        None if is_ptx(head) => ("PTX", "save it by CloudCompare as PLY"),
        None => return None,
    };
    Some(Probe { advice: advice.into(), ..Probe::new(Kind::Unread(name), "", path) })
}

/// As many bytes as have the words that tell a format.
pub(crate) fn head(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(4096)]
}

pub(crate) fn has_line(bytes: &[u8], starts: &[&str]) -> bool {
    bytes.split(|b| *b == b'\n').any(|line| starts.iter().any(|start| line.starts_with(start.as_bytes())))
}

pub(crate) fn has(head: &[u8], word: &str) -> bool {
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

/// Whether the bytes begin as an MGH volume: version 1, four sizes and a type of voxels, in big-endian order.
pub(crate) fn is_mgh(bytes: &[u8]) -> bool {
    let number =
        |k: usize| bytes.get(4 * k..4 * k + 4).map(|four| i32::from_be_bytes([four[0], four[1], four[2], four[3]]));
    let is_size = |k: usize| number(k).is_some_and(|n| (1..1 << 16).contains(&n));
    number(0) == Some(1) && (1..5).all(is_size) && number(5).is_some_and(|kind| (0..=10).contains(&kind))
}

/// Whether the length is that of a binary STL with as many triangles as its header counts.
pub(crate) fn is_binary_stl(bytes: &[u8]) -> bool {
    let n = bytes.get(80..).and_then(|rest| rest.first_chunk()).map_or(0, |n| u64::from(u32::from_le_bytes(*n)));
    n > 0 && 84 + 50 * n == bytes.len() as u64
}

/// Whether the first line that is no comment begins a header.
fn is_pcd(bytes: &[u8]) -> bool {
    let mut lines = bytes.split(|&b| b == b'\n').map(<[u8]>::trim_ascii).take(50);
    let first = lines.find(|line| line.starts_with(b"# .PCD") || !(line.is_empty() || line.starts_with(b"#")));
    first.is_some_and(|line| [&b"# .PCD"[..], b"VERSION ", b"FIELDS "].iter().any(|word| line.starts_with(word)))
}

/// Whether a file begins as poly data of VTK in XML.
pub(crate) fn is_vtp(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]);
    head.trim_start().starts_with('<') && head.contains("<VTKFile") && head.contains("type=\"PolyData\"")
}

/// Whether a piece counts polygons or strips.
pub(crate) fn has_vtp_faces(bytes: &[u8]) -> bool {
    ["NumberOfPolys=\"", "NumberOfStrips=\""].iter().any(|name| {
        let n = name.len();
        bytes.windows(n + 1).any(|window| window.starts_with(name.as_bytes()) && window[n] != b'0')
    })
}

/// Whether the header of a PLY counts faces.
fn has_ply_faces(bytes: &[u8]) -> bool {
    has_line(head(bytes), &["element face "]) && !has_line(head(bytes), &["element face 0"])
}

impl Probe {
    pub(crate) fn new(kind: Kind, format: &'static str, path: &Path) -> Self {
        let advice = match kind {
            Kind::Ct => "segment the bone and export its surface as STL or PLY".into(),
            Kind::Points => "export the bone's model as STL or PLY".into(),
            Kind::Pose => format!("osteoflow register BONE SCAN --init {} starts from it", path.display()),
            Kind::Poses(format) if !format.names_frames() || format == LogFormat::Table => format!(
                "osteoflow info {} says what takes it; if these are points, name the columns in a first line that begins with x y z",
                path.display()
            ),
            Kind::Unknown => "is it damaged?".into(),
            Kind::Unread("JSON") => "it has none of the keys of a plan, a pose, markups, a region or results".into(),
            Kind::Unread(_) => SURFACE.into(),
            _ => format!("osteoflow info {} says what takes it", path.display()),
        };
        Self { kind, format, advice }
    }

    /// The refusal of a reader that needs something else.
    pub(crate) fn refusal(&self, path: &Path, wanted: &str) -> FileError {
        let Self { kind, format, advice, .. } = self;
        let format = if format.is_empty() { String::new() } else { format!(" ({format})") };
        let message = match kind {
            Kind::Unread(EMPTY) => format!("{EMPTY}; was it written to the end?"),
            Kind::Unread(name) => format!("{name} is not read; {advice}"),
            Kind::Unknown => format!("it is {kind}, and {wanted} is needed; {advice}"),
            kind => format!("it holds {kind}{format}, and {wanted} is needed; {advice}"),
        };
        FileError::content(path, "byte 0", message)
    }
}
