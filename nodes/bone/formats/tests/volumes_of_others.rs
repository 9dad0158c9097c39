//! Volumes that other programs wrote, in tests/data/volumes, are read as those programs read them: voxel by voxel and place by place.

use crate::volumes::mutate;
use nalgebra::{Matrix4, Vector4};
use osteoflow_formats::{
    input::sha256_of,
    probe::is_ct,
    volume::{VolumeRead, VoxelUnit, data_files, list_series, read_volume},
};
use serde::Deserialize;
use std::{collections::BTreeMap, fs, path::PathBuf};

/// What another program read.
#[derive(Deserialize)]
struct Truth {
    size: [usize; 3],
    sha256: String,
    t_lps_voxel: [[f64; 4]; 4],
}

/// Single precision of NIfTI-1; the others have 1e-8.
const TOLERANCE_MM: f64 = 1e-4;

fn folder() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/volumes"))
}

fn truths() -> BTreeMap<String, Truth> {
    serde_json::from_slice(&fs::read(folder().join("truth.json")).unwrap()).unwrap()
}

fn read(name: &str) -> Result<VolumeRead, String> {
    read_volume(&folder().join(name), None).map_err(|error| error.to_string())
}

fn assert_is(read: &VolumeRead, truth: &Truth, what: &str) {
    let volume = &read.volume;
    assert_eq!(volume.size, truth.size, "{what}");
    let bytes: Vec<u8> = volume.voxels.iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(sha256_of(&bytes), truth.sha256, "{what}: other voxels");
    let expected = Matrix4::from_fn(|r, c| truth.t_lps_voxel[r][c]);
    for corner in 0..8 {
        let at = |k: usize| if corner >> k & 1 == 0 { 0.0 } else { (truth.size[k] - 1) as f64 };
        let at = Vector4::new(at(0), at(1), at(2), 1.0);
        let off = (volume.t_lps_voxel * at - expected * at).norm();
        assert!(off < TOLERANCE_MM, "{what}: corner {corner} is {off} mm off");
    }
    assert!(volume.is_oriented && volume.unit == VoxelUnit::Hu, "{what}: {:?}", read.notes);
}

#[test]
fn each_is_read_as_its_writer_reads_it_or_refused_by_name() {
    for (name, truth) in truths() {
        assert!(is_ct(&folder().join(&name)), "{name}");
        match name.as_str() {
            "jpeg_ls" => {
                let message = read(&name).unwrap_err();
                let expected = "pixels in JPEG-LS lossless are not read; convert the whole series with dcmdjpls of dcmtk: mkdir RAW; for f in ";
                assert!(message.contains(expected) && message.contains("jpeg_ls/I0: (0002,0010)"), "{message}");
            }
            _ => assert_is(&read(&name).unwrap_or_else(|error| panic!("{error}")), &truth, &name),
        }
    }
    for (name, expected) in [
        ("jpeg_lossless_point", "JPEG lossless with a point transform are not read; convert"),
        (
            "jpeg_12_bits",
            "JPEG, lossy, of 8 or 12 bits (extended) are not read; convert the whole series with dcmdjpeg of dcmtk",
        ),
        (
            "jpeg_2000_high_throughput",
            "high-throughput JPEG 2000, lossless are not read; convert the whole series with pydicom",
        ),
    ] {
        let message = read(name).unwrap_err();
        assert!(message.contains(expected), "{message}");
    }
    assert_eq!(data_files(&folder().join("detached.mhd")), [folder().join("detached.zraw")]);
    assert!(data_files(&folder().join("oblique.mha")).is_empty());
}

#[test]
fn a_study_is_read_without_its_other_pages_and_says_which() {
    let read = read("study").unwrap();
    assert_eq!(read.source, "CT series 3, identifier ..3.10.1337.".to_owned() + &read.source[36..]);
    let [files, index, left] = &read.notes[..] else { panic!("{:?}", read.notes) };
    assert_eq!(files, "1 files that are not DICOM were left out");
    assert_eq!(index, "1 DICOM files without image were left out");
    for words in [
        "left out, as no CT: CT series 401, ",
        "a picture in colours holds no density",
        "2 images of 8 x 8 (a localizer)",
        "CT series 999, ",
        "no place in the patient is stated",
    ] {
        assert!(left.contains(words), "{words}: {left}");
    }
    assert!(!left.contains("Doe") && !left.contains("4711"), "{left}");
    let of = |series: &str| read_volume(&folder().join("study"), Some(series)).map_err(|error| error.to_string());
    assert_is(&of("3").unwrap(), &truths()["study"], "by number");
    let message = of("401").unwrap_err();
    assert!(message.contains("no CT: CT series 401") && message.contains("choose another: CT series 3"), "{message}");
    let all = list_series(&folder().join("study")).unwrap();
    let choices: Vec<_> = all.iter().map(|s| (s.choice.as_str(), s.why_not.is_none())).collect();
    assert_eq!(choices, [("3", true), ("401", false), ("1", false), ("999", false)]);
}

/// Cut anywhere: no voxel may come from nowhere.
#[test]
fn a_file_that_is_cut_is_refused() {
    let truths = truths();
    let dir = tempfile::tempdir().unwrap();
    for name in [
        "jpeg_2000",
        "jpeg_lossless",
        "rle",
        "plain",
        "without_preamble",
        "enhanced.dcm",
        "oblique.mha",
        "left_handed.mha",
    ] {
        let source = folder().join(name);
        let file = if source.is_dir() { source.join("I1") } else { source };
        let bytes = fs::read(&file).unwrap();
        for cut in 1..40 {
            let n = bytes.len() * cut / 40;
            let path = dir.path().join("cut");
            fs::write(&path, &bytes[..n]).unwrap();
            if let Ok(read) = read_volume(&path, None) {
                panic!("{name}: {n} of {} bytes give {:?}", bytes.len(), read.volume.size);
            }
        }
        assert!(truths.contains_key(name));
    }
}

#[test]
fn no_damaged_file_of_another_program_panics_or_names_the_patient() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("one");
    for name in [
        "jpeg_2000/I1",
        "jpeg_lossless/I1",
        "jpeg_lossless_predictor_6/I1",
        "rle/I1",
        "enhanced.dcm",
        "left_handed.mha",
        "four_axes.nrrd",
    ] {
        mutate(&fs::read(folder().join(name)).unwrap(), 300, name, |bytes| {
            fs::write(&path, bytes).unwrap();
            match read_volume(&path, None) {
                Ok(read) => {
                    assert_eq!(read.volume.voxels.len(), read.volume.size.iter().product::<usize>());
                    assert!(read.volume.voxels.iter().all(|v| v.is_finite()));
                }
                Err(error) => {
                    assert!(!error.to_string().contains("Doe") && !error.to_string().contains("4711"), "{error}")
                }
            }
        });
    }
}
