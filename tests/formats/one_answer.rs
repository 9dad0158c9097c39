//! What a file is has one answer, whoever is asked.

use crate::common::{osteoflow, root};
use osteoflow::app::{Content, Error, MeshOrCloud, read};
use osteoflow_formats::{
    pose_log::LogFormat,
    probe::{Kind, probe},
};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// The files of a folder and of the folders in it.
fn files_of(folder: &Path) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.flat_map(|path| if path.is_dir() { files_of(&path) } else { vec![path] }).collect()
}

/// The exit code of a command, and what it prints.
fn said(arguments: &[&str]) -> (Option<i32>, String) {
    let output = osteoflow().args(arguments).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&text).into_owned())
}

/// Asks each command, and the reader of the Python package, what a file is.
fn check(file: &Path, out: &Path) {
    let (kind, name) = (probe(file).unwrap_or_else(|error| panic!("{error}")).kind, file.to_str().unwrap());
    let words = kind.to_string();
    let has = |(code, text): (Option<i32>, String), before: &str| {
        assert!(text.contains(&format!("{before}{words}")), "{name}: {before}{words}, exit {code:?}\n{text}");
    };
    let bone = root().join("tests/data/folder/bone.stl");
    let is_toml = name.ends_with(".toml");
    match kind {
        Kind::Unknown => {
            let (code, text) = said(&["info", name]);
            assert!(code == Some(1) || is_toml, "{text}");
            return;
        }
        // What is wrong with its images is told instead.
        Kind::Ct if said(&["info", name]).0 != Some(0) => {}
        _ => has(said(&["info", name]), ""),
    }
    if !is_toml {
        has(said(&["check", name]), "is no graph, but ");
    }
    if kind != Kind::Recording {
        has(said(&["validate", name]), "is ");
    }
    if !matches!(kind, Kind::Mesh | Kind::Cloud) {
        has(said(&["register", bone.to_str().unwrap(), name]), "");
    }
    match kind {
        Kind::Poses(_) | Kind::Plan | Kind::Region | Kind::Results | Kind::Unread(_) => {
            has(said(&["convert", name, out.join("new.xyz").to_str().unwrap()]), "");
        }
        Kind::Pose => {
            let _ = fs::remove_file(out.join("new.tfm"));
            has(said(&["convert", name, out.join("new.tfm").to_str().unwrap()]), "new.tfm: ");
        }
        _ => {}
    }
    match (kind, read(file, 1.0, "file", None, None)) {
        (Kind::Mesh, Ok(Content::Shape(MeshOrCloud::Mesh(_))))
        | (Kind::Cloud, Ok(Content::Shape(MeshOrCloud::Cloud(..))))
        | (Kind::Points, Ok(Content::Points(_)))
        | (Kind::Pose, Ok(Content::Pose(..)))
        | (Kind::Recording, Ok(Content::Recording))
        | (Kind::Ct, _) => {}
        (_, Err(Error::Failed(reason))) => has((None, reason), ""),
        (kind, other) => panic!("{name}: {kind:?}, but read as {other:?}"),
    }
}

#[test]
fn each_file_of_the_tests_is_one_thing_to_every_command() {
    let dir = tempfile::tempdir().unwrap();
    let data = [root().join("tests/data"), root().join("nodes/bone/formats/tests/data")];
    for file in data.iter().flat_map(|folder| files_of(folder)) {
        check(&file, dir.path());
    }
}

#[test]
fn a_log_without_a_heading_a_matrix_in_any_separator_and_files_that_are_not_read_have_one_name() {
    let dir = tempfile::tempdir().unwrap();
    let matrix = "1 0 0 10\n0 1 0 20\n0 0 1 30\n0 0 0 1\n";
    let rows = |step: usize, quaternion: &str| -> String {
        (0..1000).map(|k| format!("{}.0 {}.5 20.25 200 {quaternion}\n", step * k, k % 97)).collect()
    };
    let tum = Kind::Poses(LogFormat::Tum);
    for (name, bytes, expected) in [
        ("blanks.txt", matrix.into(), Kind::Pose),
        ("semicolons.txt", matrix.replace(' ', ";").into_bytes(), Kind::Pose),
        ("commas.csv", matrix.replace(' ', ",").into_bytes(), Kind::Pose),
        ("log.txt", rows(1, "0 0 0 1").into_bytes(), tum),
        ("log.csv", rows(1, "0 0 0 1").replace(' ', ",").into_bytes(), tum),
        (
            "euroc.csv",
            rows(1_000_000, "1 0 0 0").replace(".0 ", " ").replace(' ', ",").into_bytes(),
            Kind::Poses(LogFormat::Euroc),
        ),
        ("points.csv", format!("x,y,z,a,b,c,d,e\n{}", rows(1, "0 0 0 1").replace(' ', ",")).into_bytes(), Kind::Cloud),
        ("picked.csv", b"label,x,y,z\nP1,1,2,3\nP2,4,5,6\nP3,7,8,10\n".to_vec(), Kind::Points),
        ("array.bin", b"\x93NUMPY\x01\0".to_vec(), Kind::Unread("a NumPy array (.npy)")),
        ("surf.gii", b"<?xml version=\"1.0\"?>\n<GIFTI Version=\"1.0\">".to_vec(), Kind::Unread("GIFTI")),
        ("lh.white", b"\xff\xff\xfecreated by".to_vec(), Kind::Unread("a surface of FreeSurfer")),
        ("points.mat", b"MATLAB 5.0 MAT-file, ..".to_vec(), Kind::Unread("a MAT-file of MATLAB")),
        ("points.parquet", b"PAR1\x15\x04".to_vec(), Kind::Unread("Parquet")),
        ("drawing.dxf", b"0\nSECTION\n2\nENTITIES\n".to_vec(), Kind::Unread("DXF")),
    ] {
        let file = dir.path().join(name);
        fs::write(&file, bytes).unwrap();
        assert_eq!(probe(&file).unwrap().kind, expected, "{name}");
        check(&file, dir.path());
    }
}

/// The files of a review.
#[test]
fn files_that_were_two_things_to_two_commands_are_one() {
    let cases = root().join("../shared/cases");
    if !cases.is_dir() {
        return println!("skipped: files that were two things to two commands are one: no {}", cases.display());
    }
    let dir = tempfile::tempdir().unwrap();
    for (name, expected) in [
        ("answers/m.txt", Kind::Pose),
        ("answers/pose_c.csv", Kind::Pose),
        ("answers/pose_s.txt", Kind::Pose),
        ("answers/rel.tum", Kind::Poses(LogFormat::Tum)),
        ("answers/euroc_no_heading.csv", Kind::Poses(LogFormat::Euroc)),
        ("programs/scan.ptx", Kind::Unread("PTX")),
        ("programs/brp_planes.mrk.json", Kind::Points),
        ("programs/meshlab_ncoff.off", Kind::Cloud),
        ("text/index_first.xyz", Kind::Cloud),
    ] {
        let file = cases.join(name);
        assert_eq!(probe(&file).unwrap().kind, expected, "{name}");
        check(&file, dir.path());
    }
}
