//! Volumes written by the tests in every format give the same voxels at the same places; damaged ones are refused.

use flate2::{Compression, write::DeflateEncoder, write::GzEncoder};
use nalgebra::{Matrix3, Matrix4, Point3, Rotation3, Vector3, Vector4};
use osteoflow_formats::volume::{Volume, VolumeRead, VoxelUnit, read_volume};
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::{
    io::Write as _,
    path::{Path, PathBuf},
};

const SIZE: [usize; 3] = [7, 6, 5];
const SPACING: [f64; 3] = [0.5, 0.6, 1.25];
const FIRST: [f64; 3] = [-110.25, 33.5, 402.125];

/// Values as a CT has them: air, soft tissue, bone.
fn value(k: usize) -> i16 {
    [-1000, 40, 1250, -80, 300][k % 5] + (k as i16 % 37)
}

fn values() -> Vec<i16> {
    (0..SIZE.iter().product()).map(value).collect()
}

/// Directions of the axes, oblique; right-handed, or left-handed.
fn axes(mirrored: bool) -> Matrix3<f64> {
    let mut axes = *Rotation3::new(Vector3::new(0.3, -0.5, 0.8)).matrix();
    if mirrored {
        axes.column_mut(2).neg_mut();
    }
    axes
}

fn truth(mirrored: bool) -> Matrix4<f64> {
    let mut t = (axes(mirrored) * Matrix3::from_diagonal(&SPACING.into())).to_homogeneous();
    t.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::from(FIRST));
    t
}

fn read(path: &Path) -> Result<VolumeRead, String> {
    read_volume(path, None).map_err(|error| error.to_string())
}

fn read_bytes(bytes: &[u8]) -> Result<VolumeRead, String> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    read(file.path())
}

fn refusal(bytes: &[u8]) -> String {
    read_bytes(bytes).unwrap_err()
}

/// Every voxel has its value, and its place within 1e-4 mm.
fn assert_is_truth(content: &Volume, mirrored: bool, what: &str) {
    assert_eq!(content.size, SIZE, "{what}");
    let expected: Vec<f32> = values().iter().map(|v| f32::from(*v)).collect();
    assert_eq!(content.voxels, expected, "{what}");
    assert_at(content, &truth(mirrored), what);
    assert_eq!(content.t_lps_voxel.fixed_view::<3, 3>(0, 0).into_owned().determinant() < 0.0, mirrored, "{what}");
}

fn assert_at(content: &Volume, truth: &Matrix4<f64>, what: &str) {
    for corner in 0..8 {
        let at = |k: usize| if corner >> k & 1 == 0 { 0.0 } else { (SIZE[k] - 1) as f64 };
        let at = Vector4::new(at(0), at(1), at(2), 1.0);
        let off = (content.t_lps_voxel * at - truth * at).norm();
        assert!(off < 1e-4, "{what}: corner {corner} is {off} mm off");
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A NIfTI file of the test's volume.
#[derive(Clone, Copy)]
struct Nifti {
    version: u8,
    is_big: bool,
    mirrored: bool,
    /// Whether the map is a quaternion instead of a matrix.
    qform: bool,
    datatype: i16,
}

const PLAIN: Nifti = Nifti { version: 1, is_big: false, mirrored: false, qform: false, datatype: 4 };

impl Nifti {
    fn bytes(&self) -> Vec<u8> {
        let header_bytes = if self.version == 1 { 348 } else { 540 };
        let mut bytes = vec![0u8; header_bytes + 4];
        let two = self.version == 2;
        let big = self.is_big;
        let put = |bytes: &mut Vec<u8>, at: usize, little: &[u8]| {
            let mut ordered = little.to_vec();
            if big {
                ordered.reverse();
            }
            bytes[at..at + ordered.len()].copy_from_slice(&ordered);
        };
        let float = |bytes: &mut Vec<u8>, one: usize, at_two: usize, value: f64| {
            if two {
                put(bytes, at_two, &value.to_le_bytes());
            } else {
                put(bytes, one, &(value as f32).to_le_bytes());
            }
        };
        put(&mut bytes, 0, &(header_bytes as i32).to_le_bytes());
        for (k, d) in [3, SIZE[0], SIZE[1], SIZE[2], 1, 1, 1, 1].into_iter().enumerate() {
            if two {
                put(&mut bytes, 16 + 8 * k, &(d as i64).to_le_bytes());
            } else {
                put(&mut bytes, 40 + 2 * k, &(d as i16).to_le_bytes());
            }
        }
        let bits: i16 = match self.datatype {
            2 | 256 => 8,
            4 | 512 => 16,
            8 | 16 | 768 => 32,
            _ => 64,
        };
        put(&mut bytes, if two { 12 } else { 70 }, &self.datatype.to_le_bytes());
        put(&mut bytes, if two { 14 } else { 72 }, &bits.to_le_bytes());
        for (k, s) in SPACING.into_iter().enumerate() {
            float(&mut bytes, 80 + 4 * k, 112 + 8 * k, s);
        }
        float(&mut bytes, 76, 104, if self.mirrored { -1.0 } else { 1.0 });
        if two {
            put(&mut bytes, 168, &544i64.to_le_bytes());
            put(&mut bytes, 500, &10i32.to_le_bytes());
        } else {
            put(&mut bytes, 108, &352f32.to_le_bytes());
            bytes[123] = 10;
        }
        // Unsigned types hold the values 2000 higher.
        let lift = if matches!(self.datatype, 512 | 768 | 1280) { 2000.0 } else { 0.0 };
        float(&mut bytes, 112, 176, 1.0);
        float(&mut bytes, 116, 184, -lift);
        // From LPS back to RAS.
        let ras = Matrix4::new_nonuniform_scaling(&Vector3::new(-1.0, -1.0, 1.0)) * truth(self.mirrored);
        let code = |bytes: &mut Vec<u8>, one: usize, at_two: usize| {
            if two { put(bytes, at_two, &1i32.to_le_bytes()) } else { put(bytes, one, &1i16.to_le_bytes()) }
        };
        if self.qform {
            code(&mut bytes, 252, 344);
            let mut turn = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0)) * axes(self.mirrored);
            if self.mirrored {
                turn.column_mut(2).neg_mut();
            }
            let q = nalgebra::UnitQuaternion::from_matrix(&turn);
            let side = if q.w < 0.0 { -1.0 } else { 1.0 };
            for (k, c) in [q.i, q.j, q.k].into_iter().enumerate() {
                float(&mut bytes, 256 + 4 * k, 352 + 8 * k, side * c);
                float(&mut bytes, 268 + 4 * k, 376 + 8 * k, ras[(k, 3)]);
            }
        } else {
            code(&mut bytes, 254, 348);
            for r in 0..3 {
                for c in 0..4 {
                    float(&mut bytes, 280 + 16 * r + 4 * c, 400 + 32 * r + 8 * c, ras[(r, c)]);
                }
            }
        }
        if two {
            bytes[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
        } else {
            bytes[344..348].copy_from_slice(b"n+1\0");
        }
        for v in values() {
            let lifted = f64::from(v) + lift;
            let mut little = match self.datatype {
                4 => v.to_le_bytes().to_vec(),
                8 => i32::from(v).to_le_bytes().to_vec(),
                16 => f32::from(v).to_le_bytes().to_vec(),
                64 => f64::from(v).to_le_bytes().to_vec(),
                512 => (lifted as u16).to_le_bytes().to_vec(),
                768 => (lifted as u32).to_le_bytes().to_vec(),
                1024 => i64::from(v).to_le_bytes().to_vec(),
                _ => (lifted as u64).to_le_bytes().to_vec(),
            };
            if big {
                little.reverse();
            }
            bytes.extend(little);
        }
        bytes
    }
}

#[test]
fn nifti_of_every_version_order_and_type_gives_the_voxels_at_their_places() {
    for version in [1, 2] {
        for is_big in [false, true] {
            for mirrored in [false, true] {
                for qform in [false, true] {
                    for datatype in [4, 8, 16, 64, 512, 768, 1024, 1280] {
                        let file = Nifti { version, is_big, mirrored, qform, datatype };
                        let what = format!("NIfTI-{version}, big {is_big}, qform {qform}, type {datatype}");
                        let content = read_bytes(&file.bytes()).unwrap();
                        assert_is_truth(&content.volume, mirrored, &what);
                        assert!(content.volume.is_oriented && content.volume.unit == VoxelUnit::Hu);
                        assert_eq!(content.notes.len(), 1, "{:?}", content.notes);
                        let zipped = read_bytes(&gzip(&file.bytes())).unwrap();
                        assert_eq!(zipped, content, "{what}");
                    }
                }
            }
        }
    }
}

#[test]
fn nifti_in_metres_or_without_orientation_is_read_as_what_it_is() {
    let mut metres = Nifti { version: 2, ..PLAIN }.bytes();
    metres[500] = 1;
    let t = read_bytes(&metres).unwrap();
    let mut expected = truth(false);
    expected.fixed_view_mut::<3, 4>(0, 0).scale_mut(1000.0);
    assert!((t.volume.t_lps_voxel - expected).norm() < 1e-6);
    assert!(t.notes.iter().any(|n| n.contains("is the unit of length right?")), "{:?}", t.notes);
    let mut bare = PLAIN.bytes();
    bare[254] = 0;
    let read = read_bytes(&bare).unwrap();
    assert!(!read.volume.is_oriented && read.notes[0].contains("no orientation is stated"), "{:?}", read.notes);
    let lengths: Vec<f64> = (0..3).map(|k| read.volume.t_lps_voxel.column(k).norm()).collect();
    assert!((0..3).all(|k| (lengths[k] - SPACING[k]).abs() < 1e-6), "{lengths:?}");
    let mut both = Nifti { qform: true, ..PLAIN }.bytes();
    both[254] = 1;
    both[280..328].copy_from_slice(&PLAIN.bytes()[280..328]);
    assert_eq!(read_bytes(&both).unwrap().notes.len(), 1, "they agree");
    both[292..296].copy_from_slice(&0f32.to_le_bytes());
    let read = read_bytes(&both).unwrap();
    assert!(read.notes[0].contains("sform and qform place the volume up to 110.25 mm apart"), "{:?}", read.notes);
}

#[test]
fn nifti_that_is_cut_has_frames_or_holds_no_density_is_refused_with_the_reason() {
    let bytes = PLAIN.bytes();
    let message = refusal(&bytes[..bytes.len() - 1]);
    assert!(message.contains("7 x 6 x 5 voxels need 772 bytes, the file has 771"), "{message}");
    let zipped = gzip(&bytes);
    let message = refusal(&zipped[..zipped.len() / 2]);
    assert!(message.contains("cut short") || message.contains("gzip"), "{message}");
    let message = refusal(&gzip(&bytes[..bytes.len() - 10]));
    assert!(message.contains("420 bytes, but only 410 are there"), "{message}");
    let mut wrong = gzip(&bytes);
    let n = wrong.len();
    wrong[n - 6] ^= 1;
    assert!(refusal(&wrong).contains("gzip"), "the checksum is verified");
    let with = |at: usize, new: &[u8]| {
        let mut bytes = PLAIN.bytes();
        bytes[at..at + new.len()].copy_from_slice(new);
        refusal(&bytes)
    };
    let frames = with(40, &[4, 0, 7, 0, 6, 0, 5, 0, 9, 0]);
    assert!(frames.contains("9 frames of 7 x 6 x 5 voxels; save the one frame"), "{frames}");
    let huge = with(42, &[0xff, 0x7f, 0xff, 0x7f, 0xff, 0x7f]);
    assert!(huge.contains("the file has 772"), "{huge}");
    assert!(with(42, &[0, 0]).contains("dim[1]: 0 voxels"), "no voxels");
    assert!(with(70, &[128, 0]).contains("datatype 128 (colours)"), "colours");
    assert!(with(72, &[8, 0]).contains("bitpix"), "bits");
    assert!(with(344, b"ni1").contains("pair .hdr/.img"), "a pair");
    assert!(with(108, &0f32.to_le_bytes()).contains("vox_offset"), "offset");
    assert!(with(123, &[5]).contains("5 is no unit of length"), "unit");
    assert!(with(280, &[0; 48]).contains("do not span space"), "flat");
    assert!(refusal(b"").contains("the file is empty"), "nothing");
    let mut nan = Nifti { datatype: 16, ..PLAIN }.bytes();
    nan[352..356].copy_from_slice(&f32::NAN.to_le_bytes());
    let read = read_bytes(&nan).unwrap();
    let note = "1 voxels without a number (NaN) or of -infinity were set to -1000, the lowest value of the others";
    assert!(read.notes.iter().any(|n| n == note), "{:?}", read.notes);
    assert_eq!(read.volume.voxels[0], -1000.0 + 0.0, "the lowest of the others");
    nan[352..356].copy_from_slice(&f32::INFINITY.to_le_bytes());
    nan[356..360].copy_from_slice(&f32::NEG_INFINITY.to_le_bytes());
    let read = read_bytes(&nan).unwrap();
    let highest = values().iter().skip(2).max().map(|v| f32::from(*v)).unwrap();
    assert_eq!((read.volume.voxels[0], read.volume.voxels[1]), (highest, -1000.0), "{:?}", read.notes);
}

/// A NRRD header of the test's volume in a space, without the blank line.
fn nrrd_header(space: &str, signs: [f64; 3], encoding: &str, more: &str) -> String {
    let t = Matrix4::new_nonuniform_scaling(&signs.into()) * truth(true);
    let vector = |k: usize| format!("({},{},{})", t[(0, k)], t[(1, k)], t[(2, k)]);
    format!(
        "NRRD0004\n# A comment: of any kind\ntype: short\ndimension: 3\nspace: {space}\nsizes: 7 6 5\nspace directions: {} {} \
         {}\nkinds: domain domain domain\nendian: little\nencoding: {encoding}\nspace origin: {}\nDicom_name:=nobody\n{more}",
        vector(0),
        vector(1),
        vector(2),
        vector(3)
    )
}

fn raw() -> Vec<u8> {
    values().iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn nrrd(encoding: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = nrrd_header("left-posterior-superior", [1.0; 3], encoding, "\n").into_bytes();
    bytes.extend(data);
    bytes
}

fn text() -> Vec<u8> {
    values().chunks(11).map(|c| c.iter().map(|v| format!("{v} ")).collect::<String>() + "\n").collect::<String>().into()
}

#[test]
fn nrrd_of_every_encoding_space_and_place_of_the_data_gives_the_voxels_at_their_places() {
    for (encoding, data) in [("raw", raw()), ("gzip", gzip(&raw())), ("ascii", text())] {
        let content = read_bytes(&nrrd(encoding, &data)).unwrap();
        assert_is_truth(&content.volume, true, encoding);
        assert!(content.volume.is_oriented && content.notes.len() == 1, "{:?}", content.notes);
        let folder = tempfile::tempdir().unwrap();
        let header = folder.path().join("ct.nhdr");
        std::fs::write(folder.path().join("ct.data"), &data).unwrap();
        std::fs::write(&header, nrrd_header("LPS", [1.0; 3], encoding, "data file: ct.data\n")).unwrap();
        assert_is_truth(&read(&header).unwrap().volume, true, "detached");
    }
    for (space, signs) in [("RAS", [-1.0, -1.0, 1.0]), ("left-anterior-superior", [1.0, -1.0, 1.0])] {
        let mut bytes = nrrd_header(space, signs, "raw", "\n").into_bytes();
        bytes.extend(raw());
        assert_is_truth(&read_bytes(&bytes).unwrap().volume, true, space);
    }
    let big: Vec<u8> = values().iter().flat_map(|v| v.to_be_bytes()).collect();
    let header = nrrd_header("LPS", [1.0; 3], "raw", "byte skip: -1\n\n").replace("endian: little", "endian: big");
    let bytes = [header.into_bytes(), b"junk".to_vec(), big].concat();
    assert_is_truth(&read_bytes(&bytes).unwrap().volume, true, "big, data at the end");
    let header = nrrd_header("LPS", [1.0; 3], "raw", "line skip: 1\nbyte skip: 3\n\n");
    let bytes = [header.into_bytes(), b"a line\nabc".to_vec(), raw()].concat();
    assert_is_truth(&read_bytes(&bytes).unwrap().volume, true, "skips");
}

#[test]
fn nrrd_without_space_says_so_and_other_doubts_are_refused() {
    let bare =
        "NRRD0001\ntype: short\ndimension: 3\nsizes: 7 6 5\nspacings: 0.5 0.6 1.25\nendian: little\nencoding: raw\n\n";
    let read = read_bytes(&[bare.as_bytes(), &raw()].concat()).unwrap();
    assert!(!read.volume.is_oriented && read.notes[0].starts_with("orientation unknown"), "{:?}", read.notes);
    let with = |old: &str, new: &str| {
        let header = nrrd_header("LPS", [1.0; 3], "raw", "\n");
        assert!(header.contains(old), "{old}");
        refusal(&[header.replace(old, new).into_bytes(), raw()].concat())
    };
    for (old, new, message) in [
        ("dimension: 3", "dimension: 4", "(sizes): 3 sizes for 4 dimensions"),
        ("dimension: 3", "dimension: 2", "(sizes): 3 sizes for 2 dimensions"),
        ("sizes: 7 6 5", "sizes: 7 6 -5", "whole numbers from 1"),
        ("sizes: 7 6 5", "sizes: 7 6 500", "cut short: 7 x 6 x 500 short are 42000 bytes, but only 420 are there"),
        ("sizes: 7 6 5", "sizes: 900000000 900000000 900000000", "more than can be counted"),
        ("type: short", "type: block", "\"block\" is not read"),
        ("space: LPS", "space: left-posterior-superior-time", "this space is not read"),
        ("endian: little", "endian: middle", "neither little nor big"),
        ("endian: little\n", "", "no field \"endian\""),
        ("encoding: raw", "encoding: bzip2", "\"bzip2\" is not read"),
        ("kinds: domain domain domain", "sizes: 7 6 5", "is given once more; line 6 has it"),
        ("kinds: domain domain domain", "kinds", "line 8: neither"),
        ("kinds: domain domain domain", "space units: \"mm\" \"mm\" \"s\"", "three equal units"),
        ("kinds: domain domain domain", "data file: ../ct.raw", "a file beside the header"),
        ("kinds: domain domain domain", "data file: /etc/passwd", "a file beside the header"),
        ("kinds: domain domain domain", "data file: LIST", "in several files"),
        ("kinds: domain domain domain", "data file: gone.raw", "gone.raw: cannot be read"),
    ] {
        let content = with(old, new);
        assert!(content.contains(message), "{new}: {content}");
    }
    let message = refusal(&nrrd("ascii", b"1 2 x"));
    assert!(message.contains("cannot hold 210 numbers"), "{message}");
    let mut words = text();
    words[3] = b'x';
    assert!(refusal(&nrrd("ascii", &words)).contains("is no number"), "{}", refusal(&nrrd("ascii", &words)));
    #[cfg(unix)]
    {
        let (inside, outside) = (tempfile::tempdir().unwrap(), tempfile::NamedTempFile::new().unwrap());
        std::os::unix::fs::symlink(outside.path(), inside.path().join("ct.raw")).unwrap();
        let header = inside.path().join("ct.nhdr");
        std::fs::write(&header, nrrd_header("LPS", [1.0; 3], "raw", "data file: ct.raw\n")).unwrap();
        assert!(self::read(&header).unwrap_err().contains("a link out of the header's folder"));
    }
}

/// How a DICOM file of the test is written.
#[derive(Clone)]
struct Dicom {
    syntax: &'static str,
    series: &'static str,
    number: &'static str,
    modality: &'static str,
    /// Shift of each layer along the rows, mm: a tilted gantry.
    shear_mm: f64,
    slope: f64,
    intercept: f64,
    is_signed: bool,
    more: Vec<(u32, &'static str, Vec<u8>)>,
}

fn dicom() -> Dicom {
    Dicom {
        syntax: "1.2.840.10008.1.2.1",
        series: "1.2.3.4.55555.100001",
        number: "3",
        modality: "CT",
        shear_mm: 0.0,
        slope: 1.0,
        intercept: -1024.0,
        is_signed: false,
        more: Vec::new(),
    }
}

const PATIENT: &str = "Doe^Jane";

impl Dicom {
    fn layer(&self, k: usize) -> Vec<u8> {
        let t = truth(false);
        let r = axes(false);
        let at = (t * Vector4::new(0.0, 0.0, k as f64, 1.0)).xyz() + r.column(0) * (self.shear_mm * k as f64);
        let join =
            |numbers: &[f64]| numbers.iter().map(|n| format!("{n:.10}")).collect::<Vec<_>>().join("\\").into_bytes();
        let short = |v: u16| if self.is_big() { v.to_be_bytes().to_vec() } else { v.to_le_bytes().to_vec() };
        let per_layer = SIZE[0] * SIZE[1];
        let cells: Vec<[u8; 2]> = values()[k * per_layer..(k + 1) * per_layer]
            .iter()
            .map(|v| {
                let stored = ((f64::from(*v) - self.intercept) / self.slope).round() as i32 as u16;
                if self.is_big() { stored.to_be_bytes() } else { stored.to_le_bytes() }
            })
            .collect();
        let stored = if self.is_signed { 16 } else { 12 };
        let mut elements = vec![
            (0x0008_0016, "UI", b"1.2.840.10008.5.1.4.1.1.2".to_vec()),
            (0x0008_0060, "CS", self.modality.into()),
            (0x0010_0010, "PN", PATIENT.into()),
            (0x0018_0050, "DS", b"1.25".to_vec()),
            (0x0020_000e, "UI", self.series.into()),
            (0x0020_0011, "IS", self.number.into()),
            (0x0020_0032, "DS", join(at.as_slice())),
            (0x0020_0037, "DS", join(&[r[(0, 0)], r[(1, 0)], r[(2, 0)], r[(0, 1)], r[(1, 1)], r[(2, 1)]])),
            (0x0028_0002, "US", short(1)),
            (0x0028_0004, "CS", b"MONOCHROME2".to_vec()),
            (0x0028_0010, "US", short(SIZE[1] as u16)),
            (0x0028_0011, "US", short(SIZE[0] as u16)),
            (0x0028_0030, "DS", join(&[SPACING[1], SPACING[0]])),
            (0x0028_0100, "US", short(16)),
            (0x0028_0101, "US", short(stored)),
            (0x0028_0102, "US", short(stored - 1)),
            (0x0028_0103, "US", short(self.is_signed.into())),
            (0x0028_1052, "DS", join(&[self.intercept])),
            (0x0028_1053, "DS", join(&[self.slope])),
            (0x0028_1054, "LO", b"HU".to_vec()),
        ];
        for more in &self.more {
            elements.retain(|e| e.0 != more.0);
            elements.push(more.clone());
        }
        elements.retain(|e| !e.2.is_empty());
        elements.sort_by_key(|e| e.0);
        let mut set = Vec::new();
        for (tag, vr, value) in &elements {
            // A private sequence of undefined length with a sequence in it, and one of unknown representation.
            if *tag == 0x0018_0050 {
                self.put_nested(&mut set, 0x0009_1001, "SQ");
                self.put_nested(&mut set, 0x0009_1002, "UN");
            }
            self.put(&mut set, *tag, vr, value);
        }
        let frame = match self.syntax {
            "1.2.840.10008.1.2.5" => Some(packed(&cells)),
            "1.2.840.10008.1.2.1.98" => Some(cells.concat()),
            "1.2.840.10008.1.2.8.1" => Some(deflated(&cells.concat())),
            _ => None,
        };
        if let Some(frame) = frame {
            self.put_header(&mut set, 0x7fe0_0010, "OB", u32::MAX);
            for mut item in [Vec::new(), frame] {
                item.resize(item.len().next_multiple_of(2), 0);
                set.extend([0xfe, 0xff, 0x00, 0xe0]);
                set.extend((item.len() as u32).to_le_bytes());
                set.extend(item);
            }
            set.extend([0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0]);
        } else {
            self.put(&mut set, 0x7fe0_0010, "OW", &cells.concat());
        }
        if self.syntax.ends_with(".1.99") {
            set = deflated(&set);
        }
        let meta = Dicom { syntax: "1.2.840.10008.1.2.1", ..self.clone() };
        let mut bytes = vec![0u8; 128];
        bytes.extend(b"DICM");
        meta.put(&mut bytes, 0x0002_0010, "UI", self.syntax.as_bytes());
        bytes.extend(set);
        bytes
    }

    fn is_big(&self) -> bool {
        self.syntax == "1.2.840.10008.1.2.2"
    }

    fn u16(&self, out: &mut Vec<u8>, v: u16) {
        out.extend(if self.is_big() { v.to_be_bytes() } else { v.to_le_bytes() });
    }

    fn u32(&self, out: &mut Vec<u8>, v: u32) {
        out.extend(if self.is_big() { v.to_be_bytes() } else { v.to_le_bytes() });
    }

    fn put_header(&self, out: &mut Vec<u8>, tag: u32, vr: &str, length: u32) {
        self.u16(out, (tag >> 16) as u16);
        self.u16(out, tag as u16);
        if self.syntax == "1.2.840.10008.1.2" {
            return self.u32(out, length);
        }
        out.extend(vr.as_bytes());
        if ["OB", "OW", "SQ", "UN"].contains(&vr) {
            out.extend([0, 0]);
            self.u32(out, length);
        } else {
            self.u16(out, length as u16);
        }
    }

    fn put(&self, out: &mut Vec<u8>, tag: u32, vr: &str, value: &[u8]) {
        let mut value = value.to_vec();
        if value.len() % 2 == 1 {
            value.push(if vr == "UI" { 0 } else { b' ' });
        }
        self.put_header(out, tag, vr, value.len() as u32);
        out.extend(value);
    }

    fn put_nested(&self, out: &mut Vec<u8>, tag: u32, vr: &str) {
        let mark = |out: &mut Vec<u8>, tag: u32, length: u32| {
            self.u16(out, (tag >> 16) as u16);
            self.u16(out, tag as u16);
            self.u32(out, length);
        };
        self.put_header(out, tag, vr, u32::MAX);
        mark(out, 0xfffe_e000, u32::MAX);
        // Inside UN there is no value representation.
        let inside = if vr == "UN" && !self.is_big() {
            Dicom { syntax: "1.2.840.10008.1.2", ..self.clone() }
        } else {
            self.clone()
        };
        if !(vr == "UN" && self.is_big()) {
            inside.put_header(out, 0x0008_1111, "SQ", u32::MAX);
            mark(out, 0xfffe_e000, 4);
            out.extend([1, 2, 3, 4]);
            mark(out, 0xfffe_e0dd, 0);
            inside.put(out, 0x0020_0032, "DS", b"9\\9\\9");
        }
        mark(out, 0xfffe_e00d, 0);
        mark(out, 0xfffe_e0dd, 0);
    }

    /// A folder with the layers under shuffled names, and a file that is not DICOM.
    fn folder(&self, layers: impl IntoIterator<Item = usize>) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        self.write(folder.path(), layers);
        std::fs::write(folder.path().join("README"), "not DICOM").unwrap();
        folder
    }

    fn write(&self, folder: &Path, layers: impl IntoIterator<Item = usize>) {
        let layers: Vec<usize> = layers.into_iter().collect();
        let mut names: Vec<usize> = (0..layers.len()).collect();
        names.shuffle(&mut ChaCha8Rng::seed_from_u64(4));
        let deeper = folder.join("S0");
        std::fs::create_dir_all(&deeper).unwrap();
        for (k, name) in layers.into_iter().zip(names) {
            let place = if name % 2 == 0 { folder } else { &deeper };
            let uid = &self.series[self.series.len() - 4..];
            std::fs::write(place.join(format!("I{uid}{name}")), self.layer(k)).unwrap();
        }
    }
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// Run-length encoding of 16-bit cells: high bytes as repeats where they are, low bytes as literals.
fn packed(cells: &[[u8; 2]]) -> Vec<u8> {
    let high: Vec<u8> = cells.iter().map(|c| c[1]).collect();
    let mut segments = [Vec::new(), Vec::new()];
    for run in high.chunk_by(|a, b| a == b) {
        for part in run.chunks(128) {
            if part.len() == 1 {
                segments[0].extend([0, part[0]]);
            } else {
                segments[0].extend([(1 - part.len() as i32) as i8 as u8, part[0]]);
            }
        }
    }
    for part in cells.chunks(128) {
        segments[1].push(part.len() as u8 - 1);
        segments[1].extend(part.iter().map(|c| c[0]));
    }
    let mut frame = vec![0u8; 64];
    frame[0] = 2;
    frame[4] = 64;
    frame[8..12].copy_from_slice(&(64 + segments[0].len() as u32).to_le_bytes());
    frame.extend(segments.concat());
    frame
}

const SYNTAXES: [&str; 7] = [
    "1.2.840.10008.1.2",
    "1.2.840.10008.1.2.1",
    "1.2.840.10008.1.2.2",
    "1.2.840.10008.1.2.5",
    "1.2.840.10008.1.2.1.99",
    "1.2.840.10008.1.2.1.98",
    "1.2.840.10008.1.2.8.1",
];

#[test]
fn a_dicom_series_in_any_order_and_syntax_gives_the_voxels_at_their_places() {
    for syntax in SYNTAXES {
        for (is_signed, slope, intercept) in [(false, 1.0, -1024.0), (true, 1.0, 0.0), (true, 0.5, 100.0)] {
            let series = Dicom { syntax, is_signed, slope, intercept, ..dicom() };
            let content = read(series.folder(0..5).path()).unwrap();
            assert_is_truth(&content.volume, false, syntax);
            assert_eq!((content.volume.unit, content.volume.is_oriented), (VoxelUnit::Hu, true));
            assert_eq!(content.notes, ["1 files that are not DICOM were left out"], "{syntax}");
            assert_eq!(content.source, "CT series 3, identifier ..55555.100001, 5 images of 7 x 6");
        }
    }
}

#[test]
fn a_tilted_gantry_is_in_the_map_and_each_layer_has_its_own_scale() {
    let tilted = Dicom { shear_mm: 0.2, ..dicom() };
    let content = read(tilted.folder(0..5).path()).unwrap();
    let mut expected = truth(false);
    let shear = axes(false).column(0) * 0.2;
    expected.fixed_view_mut::<3, 1>(0, 2).add_assign(&shear);
    assert_at(&content.volume, &expected, "tilted");
    // atan(0.2 / 1.25)
    assert!(content.notes.iter().any(|n| n.contains("sheared by 9.09 degrees")), "{:?}", content.notes);
    let folder = dicom().folder(0..4);
    Dicom { intercept: -500.0, is_signed: true, ..dicom() }.write(&folder.path().join("more"), [4]);
    assert_is_truth(&read(folder.path()).unwrap().volume, false, "two intercepts");
}

use std::ops::AddAssign as _;

#[test]
fn the_frame_of_reference_is_that_of_all_images_or_of_none() {
    let with = |uid: &[u8]| Dicom { more: vec![(0x0020_0052, "UI", uid.to_vec())], ..dicom() };
    let of = |folder: &tempfile::TempDir| read(folder.path()).unwrap().frame_of_reference_uid;
    assert_eq!(of(&dicom().folder(0..SIZE[2])), None);
    let folder = with(b"1.2.3.99\0").folder(0..SIZE[2]);
    assert_eq!(of(&folder).as_deref(), Some("1.2.3.99"));
    assert_eq!(of(&with(b"my CT").folder(0..SIZE[2])), None, "a unique identifier has digits and dots");
    let mixed = with(b"1.2.3.99").folder(0..4);
    with(b"1.2.3.98").write(&mixed.path().join("more"), [4]);
    assert_eq!(of(&mixed), None);
}

fn folder_refusal(folder: &tempfile::TempDir) -> String {
    let message = read(folder.path()).unwrap_err();
    assert!(!message.contains("Doe") && !message.contains("Jane"), "{message}");
    message
}

#[test]
fn several_series_are_listed_and_chosen_by_number_or_identifier() {
    let folder = dicom().folder(0..5);
    Dicom { series: "1.2.3.4.55555.200002", number: "7", ..dicom() }.write(folder.path(), 0..3);
    let message = folder_refusal(&folder);
    assert!(
        message.contains("2 series; choose one by its number or the ending of its identifier, --series"),
        "{message}"
    );
    assert!(message.contains("CT series 3, identifier ..55555.100001, 5 images of 7 x 6; CT series 7"), "{message}");
    let choose = |series: &str| read_volume(folder.path(), Some(series)).map_err(|e| e.to_string());
    for series in ["3", "100001", ".55555.100001"] {
        assert_is_truth(&choose(series).unwrap().volume, false, series);
    }
    assert_eq!(choose("200002").unwrap().volume.size, [7, 6, 3]);
    let message = choose("12").unwrap_err();
    assert!(message.contains("no series has the number, or an identifier that ends in, \"12\""), "{message}");
    let second = Dicom { intercept: -900.0, more: vec![(0x0020_0012, "IS", b"2".to_vec())], ..dicom() };
    let phases = dicom().folder(0..5);
    Dicom { slope: 2.0, ..second }.write(&phases.path().join("more"), 0..5);
    let message = folder_refusal(&phases);
    assert!(message.contains("5 images of 7 x 6, acquisition not stated; CT series 3#2"), "{message}");
    assert!(message.contains("5 images of 7 x 6, acquisition 2"), "{message}");
    assert_is_truth(&read_volume(phases.path(), Some("3#1")).unwrap().volume, false, "the first of two acquisitions");
    Dicom { series: "1.2.9.100001", number: "9", ..dicom() }.write(folder.path(), 0..3);
    assert!(choose("100001").unwrap_err().contains("names 2 series"));
}

#[test]
fn a_stack_with_gaps_duplicates_or_other_images_is_refused_with_the_position() {
    let height = |k: f64| axes(false).column(2).dot(&Vector3::from(FIRST)) + SPACING[2] * k;
    let message = folder_refusal(&dicom().folder([0, 1, 2, 4]));
    assert!(message.contains("about 1 of the layers are missing"), "{message}");
    assert!(message.contains(&format!("at {:.3} mm", height(2.0))), "{message}");
    let twice = dicom().folder(0..5);
    Dicom { intercept: -1000.0, ..dicom() }.write(&twice.path().join("more"), [2]);
    assert_is_truth(&read(twice.path()).unwrap().volume, false, "values that are equal after their own scale");
    let other = Dicom { slope: 2.0, ..dicom() };
    let phases = dicom().folder(0..5);
    other.write(&phases.path().join("more"), [2]);
    let message = folder_refusal(&phases);
    assert!(
        message.contains("with different pixels; put the layers of one scan into a folder of their own"),
        "{message}"
    );
    assert!(message.contains(&format!("are both at {:.3} mm", height(2.0))), "{message}");
    let uneven = dicom().folder(0..4);
    let at = (truth(false) * Vector4::new(0.0, 0.0, 4.3, 1.0)).xyz();
    let text = format!("{:.6}\\{:.6}\\{:.6}", at.x, at.y, at.z).into_bytes();
    Dicom { more: vec![(0x0020_0032, "DS", text)], ..dicom() }.write(&uneven.path().join("more"), [4]);
    assert!(folder_refusal(&uneven).contains("not evenly spaced"), "{}", folder_refusal(&uneven));
    // A layer that does not fit is named and refused, or it is no layer of the stack, and is left out by name.
    for (tag, vr, value, expected) in [
        (0x0028_0030, "DS", &b"0.602\\0.502"[..], "pixels of [0.602, 0.502] mm"),
        (0x0020_0037, "DS", b"1\\0\\0\\0\\0.9\\0", "off unit length or a right angle"),
        (0x0020_0037, "DS", b"1\\0\\0", "holds 3 numbers; 6 are needed"),
        (0x0020_0032, "DS", b"", "ImagePositionPatient is missing"),
        (0x0020_0032, "DS", b"Doe\\Jane\\1", "(0020,0032) holds no decimal numbers"),
        (0x0028_0030, "DS", b"", "PixelSpacing is missing"),
        (0x0028_0008, "IS", b"12", "a multi-frame image of 12 frames without (5200,9230)"),
        (0x5200_9229, "SQ", b"\xfe\xff\x00\xe0\0\0\0\0", "(5200,9230) says where 0 frames are"),
        (0x0008_0016, "UI", b"1.2.840.10008.5.1.4.1.1.2.1", "an Enhanced CT Image of 1 frames without (5200,9230)"),
        (0x0008_0016, "UI", b"1.2.840.10008.5.1.4.1.1.2.2", "a Legacy Converted Enhanced CT Image of 1 frames"),
        (0x0028_0010, "US", &[0, 0], "7 columns and 0 rows; at least one of each is needed"),
        (0x0028_0100, "US", &[12, 0], "of 12: 8, 16 or 32 bits are read"),
        (0x0028_0101, "US", &[17, 0], "17 bits stored up to bit"),
        (0x0028_0101, "US", &[0, 0], "0 bits stored up to bit"),
        (0x0028_0102, "US", &[16, 0], "up to bit 16 of 16"),
        (0x0028_0102, "US", &[3, 0], "up to bit 3 of 16"),
        (0x0028_0030, "DS", b"0.5\\-0.6", "PixelSpacing is not positive"),
        (0x0028_1053, "DS", b"0", "RescaleSlope is 0"),
    ] {
        let folder = dicom().folder(0..4);
        Dicom { more: vec![(tag, vr, value.to_vec())], ..dicom() }.write(&folder.path().join("more"), [4]);
        let message = folder_refusal(&folder);
        assert!(message.contains(expected), "{expected}: {message}");
    }
    for (tag, vr, value, expected) in [
        (0x0028_0004, "CS", &b"RGB"[..], "a picture in colours holds no density"),
        (0x0028_0002, "US", &[3, 0], "3 samples per pixel"),
        (0x0008_0008, "CS", b"ORIGINAL\\PRIMARY\\LOCALIZER", "1 image of 7 x 6 (a localizer)"),
        (0x0028_0030, "DS", b"0.7\\0.7", "1 image of 7 x 6 (one layer, which has no surface)"),
        (0x0020_0037, "DS", b"1\\0\\0\\0\\1\\0", "1 image of 7 x 6 (one layer, which has no surface)"),
    ] {
        let folder = dicom().folder(0..5);
        Dicom { more: vec![(tag, vr, value.to_vec())], ..dicom() }.write(&folder.path().join("more"), [4]);
        let read = read(folder.path()).unwrap();
        assert_is_truth(&read.volume, false, expected);
        let note = read.notes.iter().find(|n| n.starts_with("left out, as no CT: CT series 3"));
        assert!(note.is_some_and(|n| n.contains(expected)), "{expected}: {:?}", read.notes);
    }
    let empty = tempfile::tempdir().unwrap();
    std::fs::write(empty.path().join("ct.nrrd"), "NRRD0004\n").unwrap();
    let message = folder_refusal(&empty);
    assert!(
        message.contains("no DICOM image in it (0 DICOM files without image, 1 other files); give the file"),
        "{message}"
    );
    let mut cut = dicom().layer(0);
    cut.truncate(cut.len() - 3);
    let message = refusal(&cut);
    assert!(message.contains("cut short: 84 bytes are needed, 81 are left"), "{message}");
}

/// The transfer syntaxes of PS3.6, annex A, that are not read, and private ones; those that are read are in [`SYNTAXES`] and among the
/// files of other programs.
#[test]
fn a_transfer_syntax_that_is_not_read_is_refused_by_its_name_with_what_converts_it() {
    let dcmtk = |program: &str| format!("convert the whole series with {program} of dcmtk: mkdir RAW; for f in ");
    let pydicom =
        "with pydicom (pip install pydicom numpy pylibjpeg pylibjpeg-openjpeg): mkdir RAW; python3 -c 'import"
            .to_owned();
    let export = "are not read; export the series uncompressed".to_owned();
    for (ends, name, remedy) in [
        (&["4.50"][..], "JPEG, lossy, of 8 bits (baseline)", &dcmtk("dcmdjpeg")),
        (&["4.51"], "JPEG, lossy, of 8 or 12 bits (extended)", &dcmtk("dcmdjpeg")),
        (&["4.53"], "JPEG, lossy, of spectral selection", &dcmtk("dcmdjpeg")),
        (&["4.55"], "JPEG, lossy, of full progression", &dcmtk("dcmdjpeg")),
        (&["4.52", "4.54", "4.56", "4.58"], "JPEG in arithmetic coding", &export),
        (&["4.59", "4.60", "4.61", "4.62", "4.63", "4.64", "4.65", "4.66"], "hierarchical JPEG", &export),
        (&["4.80"], "JPEG-LS lossless", &dcmtk("dcmdjpls")),
        (&["4.81"], "JPEG-LS near-lossless", &dcmtk("dcmdjpls")),
        (&["4.92", "4.93"], "JPEG 2000 of several components", &export),
        (&["4.94", "4.204"], "a reference to another server (JPIP)", &export),
        (&["4.100", "4.100.1", "4.101", "4.101.1", "4.102", "4.102.1", "4.103", "4.103.1"], "MPEG video", &export),
        (&["4.104", "4.104.1", "4.105", "4.105.1", "4.106", "4.106.1"], "MPEG video", &export),
        (&["4.107", "4.108"], "HEVC video", &export),
        (&["4.110", "4.111", "4.112"], "JPEG XL", &export),
        (&["4.201", "4.202", "4.203"], "high-throughput JPEG 2000", &pydicom),
        (&["4.300"], "a compression that is not known here", &export),
    ] {
        for end in ends {
            let syntax = String::leak(format!("1.2.840.10008.1.2.{end}"));
            let message = folder_refusal(&Dicom { syntax, ..dicom() }.folder(0..2));
            assert!(message.contains(&format!("pixels in {name}")) && message.contains(remedy), "{syntax}: {message}");
        }
    }
    for (syntax, expected) in [
        ("1.2.840.10008.1.2.4.90", "the pixels are not in fragments, as this transfer syntax has them"),
        ("1.2.840.10008.1.2.4.95", "1.2.840.10008.1.2.4.95 (references to another server, JPIP, deflated) is not read"),
        ("1.2.840.10008.1.2.4.205", "(references to another server, JPIP, deflated) is not read"),
        ("1.2.840.10008.1.2.6.1", "(MIME, retired) is not read"),
        ("1.2.840.10008.1.2.6.2", "(XML, retired) is not read"),
        ("1.2.840.10008.1.2.7.1", "(a stream of SMPTE ST 2110) is not read"),
        ("1.2.840.10008.1.2.7.2", "(a stream of SMPTE ST 2110) is not read"),
        ("1.2.840.10008.1.2.7.3", "(a stream of SMPTE ST 2110) is not read"),
        ("1.2.840.10008.1.20", "(Papyrus 3, retired) is not read"),
        ("1.2.840.113619.5.2", "(private, of GE: implicit, pixels big-endian) is not read"),
        ("1.2.3", "transfer syntax 1.2.3 is not read; export the series uncompressed"),
    ] {
        let message = folder_refusal(&Dicom { syntax, ..dicom() }.folder(0..2));
        assert!(message.contains(expected), "{syntax}: {message}");
    }
    // The commands take a folder with blanks.
    let folder = tempfile::tempdir().unwrap();
    let blank = folder.path().join("my CT");
    for (syntax, ending) in [("1.2.840.10008.1.2.4.80", "/*; do "), ("1.2.840.10008.1.2.4.201", "]' ")] {
        Dicom { syntax, ..dicom() }.write(&blank, [0]);
        let message = read(&blank).unwrap_err();
        let path = format!("'{}'", blank.display());
        assert!(message.contains(&path) && message.contains(ending), "{message}");
    }
}

#[test]
fn a_gzip_file_of_a_text_is_no_volume() {
    for (bytes, is_one) in
        [(&b"1 2 3\n4 5 6\n7 8 9\n1 2 3\n"[..], false), (&[92, 1, 0, 0, 0, 0, 0, 0][..], true), (b"", true)]
    {
        let file = tempfile::NamedTempFile::new().unwrap();
        let head = [bytes, &[0; 40][..if bytes.is_empty() { 0 } else { 40 }]].concat();
        std::fs::write(file.path(), gzip(&head)).unwrap();
        assert_eq!(osteoflow_formats::probe::is_ct(file.path()), is_one, "{bytes:?}");
    }
}

#[test]
fn a_single_file_an_mr_and_bright_padding_are_read_as_what_they_are() {
    let one = read_bytes(&dicom().layer(0)).unwrap();
    assert_eq!(one.volume.size, [7, 6, 1]);
    assert!(one.notes[0].contains("a surface needs the folder"), "{:?}", one.notes);
    let mr = read(Dicom { modality: "MR", ..dicom() }.folder(0..5).path()).unwrap();
    assert_eq!(mr.volume.unit, VoxelUnit::Unknown);
    let unscaled = Dicom { more: vec![(0x0028_1053, "DS", Vec::new())], ..dicom() };
    assert_eq!(read(unscaled.folder(0..5).path()).unwrap().volume.unit, VoxelUnit::Unknown);
    // The first voxel of the second layer is 42: 82 + 2 * 1 ... its stored value is taken for padding.
    let stored = (i32::from(value(2)) + 1024) as u16;
    let padded = Dicom { more: vec![(0x0028_0120, "US", stored.to_le_bytes().to_vec())], ..dicom() };
    let content = read(padded.folder(0..5).path()).unwrap();
    assert_eq!(content.volume.voxels[2], -1024.0);
    assert!(content.notes.iter().any(|n| n.contains("padding value (0028,0120)")), "{:?}", content.notes);
    // A range, in either order.
    let beyond = (stored + 20).to_le_bytes().to_vec();
    for [first, last] in [[beyond.clone(), padded.more[0].2.clone()], [padded.more[0].2.clone(), beyond]] {
        let more = vec![(0x0028_0120, "US", first), (0x0028_0121, "US", last)];
        let ranged = read(Dicom { more, ..dicom() }.folder(0..5).path()).unwrap().volume.voxels;
        let set = |voxels: &[f32]| voxels.iter().filter(|v| **v == -1024.0).count();
        assert!(ranged[2] == -1024.0 && set(&ranged) > set(&content.volume.voxels));
    }
}

/// Flips, cuts, doubles and inserts bytes of a file, `n` times; what is read or said must not be a panic.
pub(crate) fn mutate(original: &[u8], n: u64, what: &str, mut check: impl FnMut(&[u8])) {
    for seed in 0..n {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut bytes = original.to_vec();
        for _ in 0..rng.random_range(1..4) {
            // Headers are at the beginning.
            let end = if rng.random() { bytes.len() } else { bytes.len().min(700) };
            let at = rng.random_range(0..end.max(1)).min(bytes.len().saturating_sub(1));
            match rng.random_range(0..5) {
                _ if bytes.is_empty() => {}
                0 => bytes[at] ^= 1 << rng.random_range(0..8),
                1 => bytes[at] = rng.random(),
                2 => bytes.truncate(at),
                3 => bytes.insert(at, rng.random()),
                _ => {
                    let part = bytes[at..(at + rng.random_range(1..40)).min(bytes.len())].to_vec();
                    bytes.splice(at..at, part);
                }
            }
        }
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| check(&bytes)));
        assert!(caught.is_ok(), "{what}: mutant {seed} panics");
    }
}

#[test]
fn no_damaged_file_panics_or_names_the_patient() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one");
    let check = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        match read(&path) {
            Ok(read) => {
                assert_eq!(read.volume.voxels.len(), read.volume.size.iter().product::<usize>());
                assert!(read.volume.voxels.iter().all(|v| v.is_finite()));
                assert!(!format!("{:?}{}", read.notes, read.source).contains("Doe"));
            }
            Err(message) => assert!(!message.contains("Doe") && !message.contains("Jane"), "{message}"),
        }
    };
    for version in [1, 2] {
        for is_big in [false, true] {
            mutate(&Nifti { version, is_big, ..PLAIN }.bytes(), 300, "NIfTI", check);
        }
    }
    mutate(&gzip(&PLAIN.bytes()), 300, "NIfTI gzip", check);
    for (encoding, data) in [("raw", raw()), ("gzip", gzip(&raw())), ("ascii", text())] {
        mutate(&nrrd(encoding, &data), 400, encoding, check);
    }
    for syntax in SYNTAXES {
        mutate(&Dicom { syntax, ..dicom() }.layer(0), 400, syntax, check);
    }
    // One damaged layer in a series.
    let series = dicom().folder(0..5);
    let target = series.path().join("S0").read_dir().unwrap().next().unwrap().unwrap().path();
    let original = std::fs::read(&target).unwrap();
    mutate(&original, 200, "a layer", |bytes| {
        std::fs::write(&target, bytes).unwrap();
        if let Err(message) = read(series.path()) {
            assert!(!message.contains("Doe") && !message.contains("Jane"), "{message}");
        }
    });
}

fn data(test: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../shared/data");
    let folder =
        std::env::var_os("OSTEOFLOW_DATA").map_or_else(|| PathBuf::from(beside), PathBuf::from).join("medical");
    if !folder.is_dir() {
        println!("skipped: {test}: no development data");
        return None;
    }
    Some(folder)
}

#[test]
fn samples_of_other_programs_are_read() {
    let Some(data) = data("samples of other programs") else { return };
    let nifti = read(&data.join("nibabel_anatomical.nii")).unwrap();
    assert_eq!(nifti.volume.size, [33, 41, 25]);
    // Its sform in RAS: -2 x + 32, 2 y - 40, 2 z - 16.
    let first = nifti.volume.t_lps_voxel * Vector4::new(0.0, 0.0, 0.0, 1.0);
    assert_eq!(Point3::from(first.xyz()), Point3::new(-32.0, 40.0, -16.0));
    assert_eq!(nifti.volume.unit, VoxelUnit::Unknown);
    let ct = read(&data.join("pydicom_CT_small.dcm")).unwrap();
    assert_eq!((ct.volume.size, ct.volume.unit), ([128, 128, 1], VoxelUnit::Hu));
    let mr = read(&data.join("pydicom_MR_small_implicit.dcm")).unwrap();
    assert_eq!((mr.volume.size, mr.volume.unit), ([64, 64, 1], VoxelUnit::Unknown));
    let (fine, coarse) =
        (read(&data.join("tlem2r_distal_ct.nii.gz")).unwrap(), read(&data.join("tlem2r_distal_ct_dicom")).unwrap());
    for (read, size, step, z) in
        [(&fine, [112, 112, 180], 1.0, -1014.3760986328125), (&coarse, [112, 112, 90], 2.0, -1013.8760986328125)]
    {
        let mut expected = Matrix4::from_diagonal(&Vector4::new(0.5, 0.5, step, 1.0));
        let first = Vector4::new(-114.32979032023502, -116.1457686658429, z, 1.0);
        expected.set_column(3, &first);
        assert_eq!(read.volume.size, size);
        // A NIfTI-1 header is in single precision.
        assert!((read.volume.t_lps_voxel - expected).abs().max() < 1e-4, "{}", read.volume.t_lps_voxel);
        assert_eq!(read.volume.unit, VoxelUnit::Hu, "{:?}", read.notes);
        println!("{}: {:?}", read.source, read.notes);
    }
}
