//! What a file or folder is: one table of formats, which every reader and command asks first, and whose words they use.
//!
//! A format is recognised by its content, never by its name. What is not read is named, with the program that makes of it what is.

pub use crate::kind::{Kind, Probe};

use crate::{
    FileError, cloud_text,
    cursor::{Cursor, is_text, without_byte_order_mark},
    input,
    kind::{LogFormat, TEXT, has, has_line, head, is_binary_stl, marked},
    obj, off, picked_points, plan_file, pose_file,
    pose_log::{format_of, is_sequence},
    region_file, stl, volume,
};
use serde_json::{Map, Value};
use std::{fs, path::Path};

/// The file of a folder that says which of its files are what.
pub(crate) const PROCEDURE: &str = "procedure.toml";

/// Bytes that tell what is too large to be read for that alone.
const N_HEAD: u64 = 1 << 16;

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

/// Whether the path is a CT, or a folder that may hold one.
pub fn is_ct(path: &Path) -> bool {
    probe(path).is_ok_and(|found| found.kind == Kind::Ct)
}

/// What the bytes of a file are; `path` is used in messages only.
pub(crate) fn of(path: &Path, bytes: &[u8]) -> Result<Probe, FileError> {
    if let Some(empty) = marked(path, bytes).filter(|_| bytes.is_empty()) {
        return Err(empty.refusal(path, ""));
    }
    // The 80 bytes that a binary STL begins with may hold anything.
    let bytes = if is_binary_stl(bytes) { bytes } else { without_byte_order_mark(bytes) };
    if let Some(probe) = volume_or_recording(path, bytes).or_else(|| marked(path, bytes)) {
        return Ok(probe);
    }
    if !is_text(bytes) {
        return Ok(Probe::new(Kind::Unknown, "", path));
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
    let (kind, format) = match () {
        () if stl::is_ascii(bytes) => (Kind::Mesh, "STL"),
        () if obj::is_obj(bytes) => (if has_line(bytes, &["f "]) { Kind::Mesh } else { Kind::Cloud }, "OBJ"),
        () if off::is_off(bytes) => (if counts_faces(bytes) { Kind::Mesh } else { Kind::Cloud }, "OFF"),
        () => match picked_points::format_of(path, bytes) {
            Some(format) => (Kind::Points, format),
            None if cloud_text::begins_with_points(bytes) => (Kind::Cloud, TEXT),
            None => (Kind::Unknown, TEXT),
        },
    };
    Ok(Probe::new(kind, format, path))
}

/// A recording, a sequence of poses or a volume, of which the first bytes tell what they are.
fn volume_or_recording(path: &Path, head: &[u8]) -> Option<Probe> {
    let Some(format) = volume::format_of(head) else {
        return marked(path, head).filter(|found| found.kind == Kind::Recording);
    };
    let is_log = [volume::METAIMAGE, volume::NRRD].contains(&format) && is_sequence(head);
    Some(Probe::new(if is_log { Kind::Poses(LogFormat::IgsMha) } else { Kind::Ct }, format, path))
}

/// What a folder is: that of a procedure, a bag of ROS 2, or of a DICOM series.
fn folder_kind(path: &Path) -> Kind {
    let is_recording =
        |entry: fs::DirEntry| entry.path().extension().is_some_and(|ending| ending == "mcap" || ending == "db3");
    let has_recording =
        || fs::read_dir(path).is_ok_and(|mut entries| entries.any(|entry| entry.is_ok_and(is_recording)));
    match () {
        () if path.join(PROCEDURE).is_file() => Kind::Procedure,
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

/// Whether the head of an OFF counts faces, behind the vertices.
fn counts_faces(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head(bytes));
    let mut words = text.lines().flat_map(|line| line.split('#').next().unwrap_or_default().split_whitespace());
    words.nth(2).is_some_and(|n_faces| n_faces != "0")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kind::{CSV, PICTURE, POINTS, SURFACE};

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
            (at(0, b"PK\x03\x04....experiment.json inputs/1/a.npy"), "an archive of osteoflow export", "run or sweep"),
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
            (b"<VTKFile type=\"ImageData\">".into(), "XML of VTK that is no poly data (.vtu, .vti)", ".vtp"),
            (b"<html>".into(), "XML or HTML", SURFACE),
            (b"  0\r\nSECTION\r\n  2\r\nENTITIES\r\n".into(), "DXF", SURFACE),
            (ptx.into(), "PTX", "CloudCompare"),
            (at(0, b"\x02P\x01\0"), "C3D", "as CSV"),
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
            ("some words\non the columns qx, qy, qz and qw\nof a log\n".into(), Kind::Unknown),
        ] {
            assert_eq!(kind(text.as_bytes()), expected, "{text}");
        }
        assert_eq!(kind(&[7; 300]), Kind::Unknown);
    }
}
