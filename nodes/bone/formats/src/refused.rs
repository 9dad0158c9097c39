//! Files of other kinds, recognised by their first bytes to say what to export instead.

use crate::foreign_recording;
use std::path::Path;

/// What the file is and what to do, for a file that is neither a surface nor a cloud; none if it is not recognised.
pub(crate) fn refusal(path: &Path, bytes: &[u8]) -> Option<String> {
    if let Some(kind) = foreign_recording::kind(bytes) {
        return Some(format!("{kind} is not read; {}", foreign_recording::advice(path)));
    }
    const SURFACE: &str = "export the surface as STL, PLY or OBJ";
    const IMAGE: &str = "is an image, not a surface; segment the bone and export its surface as STL or PLY";
    const POINTS: &str = "export the points as PLY, PCD or text";
    let at = |place: usize, magic: &[u8]| bytes.get(place..).is_some_and(|rest| rest.starts_with(magic));
    let (kind, advice) = match bytes {
        [] => return Some("the file is empty; was it written to the end?".into()),
        _ if at(0, b"glTF") => ("GLB (binary glTF)", SURFACE),
        _ if at(0, b"ASTM-E57") => ("E57", POINTS),
        _ if at(0, b"LASF") => ("LAS or LAZ", POINTS),
        _ if at(0, b"PK\x03\x04") => zip(bytes),
        _ if at(0, b"\x1f\x8b") => {
            ("gzip data", "unpack it; a .nii.gz holds an image, of which the segmented surface is needed as STL or PLY")
        }
        _ if at(0, b"BZh") || at(0, b"\xfd7zXZ") || at(0, b"\x28\xb5\x2f\xfd") || at(0, b"7z\xbc\xaf") => {
            ("compressed data", "unpack it")
        }
        _ if at(344, b"n+1\0") || at(344, b"ni1\0") || at(4, b"n+2\0") || at(4, b"ni2\0") => ("NIfTI", IMAGE),
        _ if at(0, b"NRRD00") => ("NRRD", IMAGE),
        _ if at(128, b"DICM") => ("DICOM", IMAGE),
        _ if at(0, b"ObjectType = Image") => ("MetaImage", IMAGE),
        _ if at(0, b"\x89MCAP0") => ("an MCAP recording", "give it to a node that reads recordings"),
        _ if at(0, b"\x89HDF\r\n") => ("HDF5", SURFACE),
        _ if at(0, b"%PDF") => ("a PDF document", SURFACE),
        _ if at(0, b"\x89PNG") || at(0, b"\xff\xd8\xff") || at(0, b"GIF8") => ("a picture", SURFACE),
        _ if at(0, b"Kaydara FBX") => ("FBX", SURFACE),
        _ if at(0, b"CCB2") => ("CloudCompare's own format (.bin)", "save it there as PLY, a surface or a cloud"),
        _ if at(0, b"#VRML") => ("VRML", SURFACE),
        _ if is_mgh(bytes) => ("MGH of FreeSurfer", IMAGE),
        _ if at(0, b"BLENDER") => ("a Blender scene", SURFACE),
        _ if at(0, b"ISO-10303-21") => ("STEP", SURFACE),
        _ if at(0, b"\xff\xfe") || at(0, b"\xfe\xff") => ("UTF-16 text", "save it as UTF-8"),
        _ => return text(bytes),
    };
    Some(sentence(kind, advice))
}

/// Whether the bytes begin as an MGH volume: version 1, four sizes and a type of voxels, in big-endian order.
pub(crate) fn is_mgh(bytes: &[u8]) -> bool {
    let number =
        |k: usize| bytes.get(4 * k..4 * k + 4).map(|four| i32::from_be_bytes([four[0], four[1], four[2], four[3]]));
    let is_size = |k: usize| number(k).is_some_and(|n| (1..1 << 16).contains(&n));
    number(0) == Some(1) && (1..5).all(is_size) && number(5).is_some_and(|kind| (0..=10).contains(&kind))
}

fn sentence(kind: &str, advice: &str) -> String {
    if advice.starts_with("is an image") { format!("{kind} {advice}") } else { format!("{kind} is not read; {advice}") }
}

fn zip(bytes: &[u8]) -> (&'static str, &'static str) {
    // Entries begin with their names, the first at byte 30.
    let head = &bytes[..bytes.len().min(4096)];
    let has = |name: &[u8]| head.windows(name.len()).any(|window| window == name);
    if has(b"3dmodel.model") || has(b"[Content_Types].xml") {
        ("3MF (a ZIP archive)", "export the surface as STL, PLY or OBJ")
    } else if has(b".npy") {
        ("NPZ (a ZIP archive)", "export the points as PLY, PCD or text")
    } else {
        ("a ZIP archive", "unpack it and give the file of the surface or cloud")
    }
}

fn text(bytes: &[u8]) -> Option<String> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let head = &bytes[..bytes.len().min(4096)];
    let has = |word: &str| head.windows(word.len()).any(|window| window == word.as_bytes());
    let (kind, advice) = match bytes.first()? {
        b'<' if has("<VTKFile") => ("XML of VTK (.vtp, .vtu)", "write the surface as legacy .vtk, PLY or STL"),
        b'<' if has("<PickedPoints") => ("a list of picked points (.pp)", "a surface or a cloud is needed here"),
        b'<' if has("<COLLADA") => ("COLLADA", "export the surface as STL, PLY or OBJ"),
        b'<' => ("XML or HTML", "export the surface as STL, PLY or OBJ"),
        b'{' if has("\"markups\"") || has("markups-schema") => {
            ("Slicer markups", "these are points, not a surface; export the bone's model as STL or PLY")
        }
        b'{' if has("\"asset\"") || has("\"glTF\"") || has("\"meshes\"") => {
            ("glTF", "export the surface as STL, PLY or OBJ")
        }
        b'{' => ("JSON", "export the surface as STL, PLY or OBJ"),
        b'#' if has("# Markups fiducial file") => {
            ("Slicer markups", "these are points, not a surface; export the bone's model as STL or PLY")
        }
        _ => return None,
    };
    Some(sentence(kind, advice))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(place: usize, magic: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; place];
        bytes.extend(magic);
        bytes.extend([0; 8]);
        bytes
    }

    const SURFACE: &str = "is not read; export the surface as STL, PLY or OBJ";
    const POINTS: &str = "is not read; export the points as PLY, PCD or text";
    const IMAGE: &str = "is an image, not a surface; segment the bone and export its surface as STL or PLY";
    const MARKUPS: &str = "is not read; these are points, not a surface; export the bone's model as STL or PLY";

    #[test]
    fn each_kind_is_named_with_what_to_export() {
        for (bytes, kind, advice) in [
            (at(0, b"glTF"), "GLB (binary glTF)", SURFACE),
            (at(0, b"ASTM-E57"), "E57", POINTS),
            (at(0, b"LASF"), "LAS or LAZ", POINTS),
            (at(0, b"\x89HDF\r\n\x1a\n"), "HDF5", SURFACE),
            (at(0, b"%PDF-1.7"), "a PDF document", SURFACE),
            (at(0, b"\x89PNG"), "a picture", SURFACE),
            (at(0, b"\xff\xd8\xff\xe0"), "a picture", SURFACE),
            (at(0, b"GIF89a"), "a picture", SURFACE),
            (at(0, b"Kaydara FBX Binary"), "FBX", SURFACE),
            (at(0, b"BLENDER-v404"), "a Blender scene", SURFACE),
            (
                at(0, b"CCB22\0"),
                "CloudCompare's own format (.bin)",
                "is not read; save it there as PLY, a surface or a cloud",
            ),
            (at(0, b"#VRML V2.0 utf8\n"), "VRML", SURFACE),
            ([1, 8, 9, 10, 1, 3, 0].iter().flat_map(|n: &i32| n.to_be_bytes()).collect(), "MGH of FreeSurfer", IMAGE),
            (at(0, b"ISO-10303-21;"), "STEP", SURFACE),
            (at(0, b"\xff\xfe1\0"), "UTF-16 text", "is not read; save it as UTF-8"),
            (at(0, b"\xfe\xff\x001"), "UTF-16 text", "is not read; save it as UTF-8"),
            (at(0, b"\x89MCAP0\r\n"), "an MCAP recording", "is not read; give it to a node that reads recordings"),
            (at(0, b"BZh9"), "compressed data", "is not read; unpack it"),
            (at(0, b"\xfd7zXZ"), "compressed data", "is not read; unpack it"),
            (at(0, b"\x28\xb5\x2f\xfd"), "compressed data", "is not read; unpack it"),
            (at(0, b"7z\xbc\xaf"), "compressed data", "is not read; unpack it"),
            (
                at(0, b"\x1f\x8b"),
                "gzip data",
                "is not read; unpack it; a .nii.gz holds an image, of which the segmented surface is needed as STL or PLY",
            ),
            (at(344, b"n+1\0"), "NIfTI", IMAGE),
            (at(344, b"ni1\0"), "NIfTI", IMAGE),
            (at(4, b"n+2\0"), "NIfTI", IMAGE),
            (at(4, b"ni2\0"), "NIfTI", IMAGE),
            (at(0, b"NRRD0005\n"), "NRRD", IMAGE),
            (at(128, b"DICM"), "DICOM", IMAGE),
            (at(0, b"ObjectType = Image\n"), "MetaImage", IMAGE),
            (at(0, b"PK\x03\x04....3D/3dmodel.model"), "3MF (a ZIP archive)", SURFACE),
            (at(0, b"PK\x03\x04....[Content_Types].xml"), "3MF (a ZIP archive)", SURFACE),
            (at(0, b"PK\x03\x04....points.npy"), "NPZ (a ZIP archive)", POINTS),
            (at(0, b"PK\x03\x04"), "a ZIP archive", "is not read; unpack it and give the file of the surface or cloud"),
            (
                b"<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\">".into(),
                "XML of VTK (.vtp, .vtu)",
                "is not read; write the surface as legacy .vtk, PLY or STL",
            ),
            (
                b"\xef\xbb\xbf <!DOCTYPE PickedPoints>\n<PickedPoints>".into(),
                "a list of picked points (.pp)",
                "is not read; a surface or a cloud is needed here",
            ),
            (b"<COLLADA version=\"1.4.1\">".into(), "COLLADA", SURFACE),
            (b"<html>".into(), "XML or HTML", SURFACE),
            (br#"{"markups":[]}"#.into(), "Slicer markups", MARKUPS),
            (br#"{"@schema":"https://..markups-schema-v1.0.3.json#"}"#.into(), "Slicer markups", MARKUPS),
            (b"# Markups fiducial file version = 4.11\n".into(), "Slicer markups", MARKUPS),
            (br#"{"asset":{"version":"2.0"}}"#.into(), "glTF", SURFACE),
            (br#"{"glTF":1}"#.into(), "glTF", SURFACE),
            (br#"{"meshes":[]}"#.into(), "glTF", SURFACE),
            (br#"{"points":[]}"#.into(), "JSON", SURFACE),
        ] {
            assert_eq!(refusal("a.file".as_ref(), &bytes).unwrap_or_default(), format!("{kind} {advice}"));
        }
        assert_eq!(refusal("a.file".as_ref(), b"").unwrap(), "the file is empty; was it written to the end?");
        for read in ["1 2 3\n", "# a scan\n1 2 3\n", "Markups fiducial file", " \n", "v 1 2 3 # <COLLADA"] {
            assert_eq!(refusal("a.file".as_ref(), read.as_bytes()), None, "{read}");
        }
    }
}
