//! Opens files for reading: every reader of this crate does so here.
//!
//! A pipe or a socket would be waited for, and a device may never end, so what is not a regular file is refused before it is
//! opened.

use crate::FileError;
use std::{
    fs::{self, File, FileType},
    path::Path,
};

/// Checks that the path leads to a regular file.
///
/// # Errors
/// [`FileError::Io`] if it is missing, [`FileError::Kind`] if it is a folder, device, pipe or socket.
pub fn check(path: &Path) -> Result<(), FileError> {
    let file_type = fs::metadata(path).map_err(FileError::read(path))?.file_type();
    if file_type.is_file() {
        return Ok(());
    }
    Err(FileError::Kind { path: path.into(), kind: kind(file_type) })
}

/// Opens a regular file.
///
/// # Errors
/// As [`check`], or if it may not be read.
pub fn open(path: &Path) -> Result<File, FileError> {
    check(path)?;
    File::open(path).map_err(FileError::read(path))
}

/// The bytes of a regular file.
///
/// # Errors
/// As [`open`].
pub fn read(path: &Path) -> Result<Vec<u8>, FileError> {
    check(path)?;
    fs::read(path).map_err(FileError::read(path))
}

/// The text of a regular file.
///
/// # Errors
/// As [`open`], or [`FileError::Content`] with the first byte that is not UTF-8.
pub fn read_text(path: &Path) -> Result<String, FileError> {
    String::from_utf8(read(path)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        FileError::content(path, format!("byte {at}"), "the file is no text in UTF-8; save it as UTF-8")
    })
}

#[cfg(unix)]
fn kind(file_type: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    match file_type {
        t if t.is_dir() => "a folder",
        t if t.is_char_device() || t.is_block_device() => "a device",
        t if t.is_fifo() => "a pipe",
        t if t.is_socket() => "a socket",
        _ => "no regular file",
    }
}

#[cfg(not(unix))]
fn kind(file_type: FileType) -> &'static str {
    if file_type.is_dir() { "a folder" } else { "no regular file" }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::{
        cloud_file, folder, mcap_read, mesh_file, picked_points, plan_file, pose_file, poses_csv, region_file, volume,
    };
    use osteoflow_geometry::SurfaceOrigin;
    use std::{os::unix::net::UnixListener, path::PathBuf, process::Command};

    #[test]
    fn every_reader_refuses_devices_pipes_sockets_and_folders_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let (pipe, socket, folder) = (at("pipe"), at("socket"), at("folder"));
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let _listener = UnixListener::bind(&socket).unwrap();
        fs::create_dir(&folder).unwrap();
        type Reader = (&'static str, fn(&Path) -> Result<(), String>);
        let readers: [Reader; 10] = [
            ("cloud", |p| cloud_file::read_cloud(p, 1.0, "camera").map(drop).map_err(|e| e.to_string())),
            ("ply", |p| cloud_file::read_cloud_ply(p, 1.0, "camera").map(drop).map_err(|e| e.to_string())),
            ("mesh", |p| mesh_file::read_mesh(p, 1.0, "ct", SurfaceOrigin::User).map(drop).map_err(|e| e.to_string())),
            ("points", |p| picked_points::read_picked_points(p).map(drop).map_err(|e| e.to_string())),
            ("plan", |p| plan_file::read_plan(p).map(drop).map_err(|e| e.to_string())),
            ("pose", |p| pose_file::read_pose(p, 1.0).map(drop).map_err(|e| e.to_string())),
            ("poses", |p| poses_csv::read_poses(p, 1.0).map(drop).map_err(|e| e.to_string())),
            ("region", |p| region_file::read_region(p).map(drop).map_err(|e| e.to_string())),
            ("tips", |p| folder::read_tips(p, 1.0).map(drop).map_err(|e| e.to_string())),
            ("plan of a bone", |p| plan_file::read_plan_of(p, "a").map(drop).map_err(|e| e.to_string())),
        ];
        let zero = PathBuf::from("/dev/zero");
        let kinds = [(&zero, "a device"), (&pipe, "a pipe"), (&socket, "a socket"), (&folder, "a folder")];
        for (name, reader) in readers {
            for (path, kind) in kinds {
                let said = reader(path).unwrap_err();
                let expected = format!("{}: it is {kind}, but a regular file is needed", path.display());
                assert!(said.starts_with(&expected), "{name}: {said}");
            }
        }
        // These take a folder, too.
        for (path, kind) in &kinds[..3] {
            for said in [
                volume::read_volume(path, &Default::default()).unwrap_err().to_string(),
                mcap_read::Recording::open(path, false).unwrap_err().to_string(),
                folder::ProcedureFolder::open(path).unwrap_err().to_string(),
            ] {
                assert!(said.contains(&format!("it is {kind}, but a regular file is needed")), "{said}");
            }
        }
    }
}
