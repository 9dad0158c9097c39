//! The lines of volumes: files that other programs wrote, in nodes/bone/formats/tests/data/volumes.

use super::Line;
use crate::common::root;
use std::path::PathBuf;

/// A file or folder that another program wrote.
fn of(name: &str) -> PathBuf {
    root().join("nodes/bone/formats/tests/data/volumes").join(name)
}

pub(super) fn lines() -> Vec<Line> {
    let ct = |names: &[&str]| names.iter().map(|name| (of(name), Ok("ct"))).collect::<Vec<_>>();
    let refused = |name: &str, words| vec![(of(name), Err(words))];
    let line = |format, files, confirmed| Line { format, files, written: None, confirmed };
    vec![
        line("NIfTI `.nii`, `.nii.gz`", ct(&["four_axes.nii.gz"]), &["SimpleITK", "nibabel"]),
        line("NRRD `.nrrd`, `.nhdr`", ct(&["four_axes.nrrd"]), &["SimpleITK"]),
        line(
            "MetaImage `.mha`, `.mhd`",
            ct(&["oblique.mha", "left_handed.mha", "detached.mhd", "four_axes.mha"]),
            &["SimpleITK"],
        ),
        line(
            "DICOM series, uncompressed",
            ct(&["plain", "big_endian", "deflated"]),
            &["SimpleITK", "pydicom", "dcmtk"],
        ),
        line("DICOM without preamble", ct(&["without_preamble"]), &["dcmtk"]),
        line("DICOM study with other pages", ct(&["study"]), &["pydicom"]),
        line("DICOM in RLE", ct(&["rle"]), &["pydicom", "dcmtk"]),
        line("DICOM in JPEG lossless", ct(&["jpeg_lossless", "jpeg_lossless_predictor_6"]), &["dcmtk"]),
        line("DICOM in JPEG 2000", ct(&["jpeg_2000", "jpeg_2000_fragments"]), &["OpenJPEG (pylibjpeg)"]),
        line("DICOM, enhanced (multi-frame)", ct(&["enhanced.dcm"]), &["pydicom"]),
        line("DICOM in JPEG-LS", refused("jpeg_ls", "convert the whole series with dcmdjpls of dcmtk"), &["dcmtk"]),
        line(
            "DICOM in lossy JPEG, of 8 or 12 bits",
            refused("jpeg_12_bits", "convert the whole series with dcmdjpeg of dcmtk"),
            &["dcmtk"],
        ),
        line(
            "DICOM in high-throughput JPEG 2000",
            refused("jpeg_2000_high_throughput", "convert the whole series with pydicom"),
            &["OpenJPH"],
        ),
        line(
            "DICOM in JPEG lossless with a point transform",
            refused("jpeg_lossless_point", "convert the whole series with dcmdjpeg of dcmtk"),
            &["dcmtk"],
        ),
    ]
}
