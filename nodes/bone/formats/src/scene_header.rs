//! What tells a scene of 3D Slicer: XML that names its files, or a ZIP archive that holds them.

use std::io::Cursor;
use zip::ZipArchive;

/// The name of the scene in an archive; none if it is no `.mrb`.
pub(crate) fn scene_in(archive: &ZipArchive<Cursor<&[u8]>>) -> Option<String> {
    let is_scene = |name: &str| name.to_lowercase().ends_with(".mrml");
    archive.file_names().flatten().find(|name| is_scene(name)).map(|name| name.into_owned())
}

/// Whether the bytes of a file are a scene that holds its files.
pub(crate) fn is_bundle(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04") && ZipArchive::new(Cursor::new(bytes)).is_ok_and(|zip| scene_in(&zip).is_some())
}

/// Whether the bytes of a file are a scene that names its files.
pub(crate) fn is_scene(bytes: &[u8]) -> bool {
    let bytes = bytes.trim_ascii_start();
    let head = &bytes[..bytes.len().min(4096)];
    head.starts_with(b"<") && head.windows(5).any(|window| window == b"<MRML")
}
