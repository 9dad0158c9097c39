//! Each field of a NIfTI header changes the volume as it says, or is refused by its name.

use nalgebra::{Matrix4, Point3};
use osteoflow_formats::volume::{VolumeRead, VoxelUnit, read_volume};

/// Eight voxels of 16 bits, 2 x 3 x 4 mm, shifted by (10, 20, 30) mm in RAS, with changes at places of the file.
fn bytes(changes: &[(usize, &[u8])]) -> Vec<u8> {
    let mut bytes = vec![0; 352];
    let shorts = |at: usize, values: &[i16]| -> Vec<(usize, [u8; 2])> {
        values.iter().enumerate().map(|(k, v)| (at + 2 * k, v.to_le_bytes())).collect()
    };
    let floats = |at: usize, values: &[f32]| -> Vec<(usize, [u8; 4])> {
        values.iter().enumerate().map(|(k, v)| (at + 4 * k, v.to_le_bytes())).collect()
    };
    bytes[..4].copy_from_slice(&348_i32.to_le_bytes());
    for (at, two) in [shorts(40, &[3, 2, 2, 2, 1, 1, 1, 1]), shorts(70, &[4, 16]), shorts(252, &[0, 1])].concat() {
        bytes[at..at + 2].copy_from_slice(&two);
    }
    let rows = [2.0, 0.0, 0.0, 10.0, 0.0, 3.0, 0.0, 20.0, 0.0, 0.0, 4.0, 30.0];
    for (at, four) in [floats(76, &[1.0, 2.0, 3.0, 4.0]), floats(108, &[352.0, 1.0, 0.0]), floats(280, &rows)].concat()
    {
        bytes[at..at + 4].copy_from_slice(&four);
    }
    bytes[123] = 2;
    bytes[344..348].copy_from_slice(b"n+1\0");
    bytes.extend((0..8_i16).flat_map(i16::to_le_bytes));
    for (at, new) in changes {
        bytes[*at..at + new.len()].copy_from_slice(new);
    }
    bytes
}

fn read(bytes: &[u8]) -> Result<VolumeRead, String> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let name = file.path().display().to_string();
    read_volume(file.path(), None).map_err(|error| error.to_string().replace(&name, "ct.nii"))
}

fn with(changes: &[(usize, &[u8])]) -> VolumeRead {
    read(&bytes(changes)).unwrap()
}

fn at(read: &VolumeRead, voxel: [f64; 3]) -> [f64; 3] {
    read.volume.t_lps_voxel.transform_point(&Point3::from(voxel)).into()
}

#[test]
fn the_plain_file_has_its_voxels_places_and_no_note() {
    let content = with(&[]);
    assert_eq!(content.volume.voxels, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!((at(&content, [0.0; 3]), at(&content, [1.0; 3])), ([-10.0, -20.0, 30.0], [-12.0, -23.0, 34.0]));
    assert_eq!(
        (content.source.as_str(), content.volume.unit, content.volume.is_oriented),
        ("NIfTI-1", VoxelUnit::Unknown, true)
    );
    assert_eq!(content.notes, [""; 0]);
}

#[test]
fn voxels_of_one_byte_are_read_with_and_without_sign() {
    for (datatype, expected) in [(2_u8, [255.0, 1.0]), (0, [-1.0, 1.0])] {
        // 256 is a signed byte: its high byte is 1.
        let signed = u8::from(datatype == 0);
        let content = with(&[(70, &[datatype, signed]), (72, &[8, 0]), (352, &[0xff, 1])]);
        assert_eq!(content.volume.voxels[..2], expected);
        assert_eq!(content.notes, ["8 bytes or more follow the 360 bytes of the volume and were not read"]);
    }
}

#[test]
fn values_are_scaled_by_a_slope_that_is_a_number() {
    let scaled = |slope: f32, intercept: f32| {
        let content = with(&[(112, &slope.to_le_bytes()), (116, &intercept.to_le_bytes())]);
        (content.volume.voxels[3], content.notes)
    };
    assert_eq!(scaled(2.0, -5.0), (1.0, vec![]));
    // A slope of 0 says that values are not scaled.
    assert_eq!(scaled(0.0, 9.0), (3.0, vec![]));
    let note = || vec!["scl_slope or scl_inter is not finite; values were not scaled".to_owned()];
    assert_eq!((scaled(f32::NAN, 0.0), scaled(1.0, f32::INFINITY)), ((3.0, note()), (3.0, note())));
}

#[test]
fn lengths_are_in_the_stated_unit() {
    let unit = |code: u8| {
        let content = with(&[(123, &[code])]);
        (at(&content, [0.0; 3])[2], content.notes)
    };
    let hardly = |size: &str| format!("voxels of {size} mm are hardly a CT's; is the unit of length right?");
    assert_eq!(unit(1), (30_000.0, vec![hardly("2000 x 3000 x 4000")]));
    assert_eq!(unit(3), (0.03, vec![hardly("0.002 x 0.003 x 0.004")]));
    // The unit of time, in the upper bits, does not matter.
    assert_eq!(unit(2 | 8), (30.0, vec![]));
    let assumed = "the unit of length is not stated (xyzt_units); millimetres were assumed";
    assert_eq!(unit(0), (30.0, vec![assumed.to_owned()]));
}

#[test]
fn a_quaternion_places_the_volume_where_there_is_no_matrix() {
    let float = |x: f32| x.to_le_bytes();
    let (half, five, six, seven) = (float(0.5), float(5.0), float(6.0), float(7.0));
    // (1/2, 1/2, 1/2, 1/2) takes x to y, y to z, z to x.
    let quaternion: [(usize, &[u8]); 8] = [
        (252, &[1, 0, 0, 0]),
        (256, &half),
        (260, &half),
        (264, &half),
        (268, &five),
        (272, &six),
        (276, &seven),
        (123, &[2]),
    ];
    let content = with(&quaternion);
    assert_eq!((at(&content, [0.0; 3]), content.volume.is_oriented), ([-5.0, -6.0, 7.0], true));
    let found_at = at(&content, [1.0, 1.0, 1.0]);
    // x of 2 mm along y, y of 3 mm along z, z of 4 mm along x, in RAS.
    assert!((Point3::from(found_at) - Point3::new(-9.0, -8.0, 10.0)).norm() < 1e-6, "single precision: {found_at:?}");
    let mirrored = with(&[&quaternion[..], &[(76, &float(-1.0))]].concat());
    let found_at = at(&mirrored, [1.0, 1.0, 1.0]);
    assert!((Point3::from(found_at) - Point3::new(-1.0, -8.0, 10.0)).norm() < 1e-6, "single precision: {found_at:?}");
    // Without a spacing, a quaternion says nothing.
    let flat = read(&bytes(&[&quaternion[..], &[(80, &float(0.0))]].concat())).unwrap_err();
    assert!(
        flat.ends_with("pixdim: neither sform, qform nor three positive pixdim say how large a voxel is"),
        "{flat}"
    );
}

#[test]
fn a_matrix_and_a_quaternion_may_differ_by_a_tenth_of_a_voxel() {
    let shifted = |x: f32| {
        let (shift, y, z) = (x.to_le_bytes(), 20_f32.to_le_bytes(), 30_f32.to_le_bytes());
        with(&[(252, &[1, 0, 1, 0]), (268, &shift), (272, &y), (276, &z)]).notes
    };
    assert_eq!(shifted(10.19), [""; 0]);
    assert_eq!(shifted(10.25), ["sform and qform place the volume up to 0.25 mm apart; the sform was taken"]);
}

#[test]
fn without_either_the_volume_is_not_oriented() {
    let content = with(&[(254, &[0, 0])]);
    let mut expected = Matrix4::from_diagonal(&[-2.0, -3.0, 4.0, 1.0].into());
    expected[(3, 3)] = 1.0;
    assert_eq!((content.volume.t_lps_voxel, content.volume.is_oriented), (expected, false));
    let note = "no orientation is stated (sform_code and qform_code are 0): how the volume lies in the patient is unknown, and the \
                surface may be mirrored";
    assert_eq!(content.notes, [note]);
}

#[test]
fn every_field_that_cannot_be_is_named() {
    let float = |x: f32| x.to_le_bytes();
    let message = |changes: &[(usize, &[u8])]| read(&bytes(changes)).unwrap_err();
    let type_of = |code: i16| message(&[(70, &code.to_le_bytes())]);
    for (code, name) in [
        (1, "single bits"),
        (32, "complex numbers"),
        (1792, "complex numbers"),
        (2048, "complex numbers"),
        (128, "colours"),
        (2304, "colours"),
        (1536, "128-bit floats"),
        (3, "unknown"),
    ] {
        let expected = format!(
            "ct.nii: datatype: datatype {code} ({name}) is not read; save the volume as 16-bit integers or floats"
        );
        assert_eq!(type_of(code), expected);
    }
    for (content, expected) in [
        (message(&[(40, &[0, 0])]), "dim[0]: 0 dimensions; 1 to 7 are possible"),
        (message(&[(40, &[8, 0])]), "dim[0]: 8 dimensions; 1 to 7 are possible"),
        (message(&[(44, &[0, 0])]), "dim[2]: 0 voxels along this axis; at least 1 is needed"),
        (message(&[(72, &[32, 0])]), "bitpix: 32 bits per voxel, but datatype 4 has 16"),
        (message(&[(108, &float(347.0))]), "vox_offset: voxels begin at byte 347, but the header has 348 bytes"),
        (message(&[(108, &float(352.5))]), "vox_offset: voxels begin at byte 352.5, but the header has 348 bytes"),
        (message(&[(123, &[4])]), "xyzt_units: 4 is no unit of length; 1 (m), 2 (mm) and 3 (um) are"),
        (
            message(&[(108, &float(353.0))]),
            "dim: cut short: 2 x 2 x 2 voxels need 369 bytes, the file has 368; copy the file again",
        ),
        (
            message(&[(344, b"\0\0\0\0")]),
            "magic: the magic is not \"n+1\" or \"n+2\"; an ANALYZE 7.5 header states no orientation: convert the DICOM to NIfTI",
        ),
        (read(&bytes(&[])[..347]).unwrap_err(), "header: the header has 348 bytes, but the file ends after 347"),
        (
            message(&[(40, &[5, 0]), (48, &[2, 0, 3, 0])]),
            "dim: 5 dimensions: 6 frames of 2 x 2 x 2 voxels; save the one frame that shows the bone as a volume of its own",
        ),
    ] {
        assert_eq!(content, format!("ct.nii: {expected}"));
    }
    // Fewer dimensions leave out axes of one voxel; whatever the header has for them.
    assert_eq!(with(&[(40, &[2, 0]), (46, &[9, 0])]).volume.size, [2, 2, 1]);
    assert_eq!(with(&[(40, &[4, 0]), (46, &[1, 0, 1, 0])]).volume.size, [2, 2, 1]);
}

#[test]
fn values_with_air_and_bone_are_taken_as_hounsfield_units() {
    let unit = |values: [i16; 8]| {
        let values: Vec<u8> = values.into_iter().flat_map(i16::to_le_bytes).collect();
        let content = with(&[(352, &values)]);
        assert_eq!(content.notes.is_empty(), content.volume.unit == VoxelUnit::Unknown, "{:?}", content.notes);
        content.volume.unit == VoxelUnit::Hu
    };
    assert!(unit([-1000, 0, 40, 300, 0, 0, 0, 0]) && unit([-500, 0, 40, 1200, 0, 0, 0, 0]));
    assert!(!unit([-499, 0, 40, 1200, 0, 0, 0, 0]) && !unit([-1000, 0, 40, 299, 0, 0, 0, 0]));
    assert!(!unit([-10_001, 0, 40, 1200, 0, 0, 0, 0]) && unit([-10_000, 0, 40, 1200, 0, 0, 0, 0]));
    // Half of the values or more are those of tissue, -1100 to 3100.
    assert!(unit([-5000, -1101, 3101, 9000, -1100, 3100, 0, 0]));
    assert!(!unit([-5000, -1101, 3101, 9000, 9000, 3100, 0, 0]));
}
