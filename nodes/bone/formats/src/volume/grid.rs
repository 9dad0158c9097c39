//! A grid of voxels, and where it is in space.

use nalgebra::{Matrix3, Matrix4, Vector3};

/// What the values of voxels mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VoxelUnit {
    /// Hounsfield units, by the file or by its values (then a note says so).
    Hu,
    /// Unknown: an MR, or values that were not scaled.
    Unknown,
}

/// A regular grid of voxels.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Number of voxels along x (fastest), y and z.
    pub size: [usize; 3],
    /// Their values after the file's slope and intercept, `x × y × z`, finite. Single precision: exact for 24 bits.
    pub voxels: Vec<f32>,
    /// From a voxel's index (its centre) to LPS, mm. It may be oblique, anisotropic, sheared and left-handed.
    pub t_lps_voxel: Matrix4<f64>,
    /// What the values mean.
    pub unit: VoxelUnit,
    /// Whether the file says how the volume lies in the patient. If not, its surface may be turned or mirrored.
    pub is_oriented: bool,
}

/// A volume read from a file or a folder.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeRead {
    /// The volume.
    pub volume: Volume,
    /// What was read, in a few words: format, modality, series.
    pub source: String,
    /// Suspicious properties of the files, one sentence each.
    pub notes: Vec<String>,
    /// FrameOfReferenceUID, where a DICOM series has one and all its images the same.
    pub frame_of_reference_uid: Option<String>,
}

/// The map of voxels whose axes (per voxel) and first centre are given in a space that differs from LPS by `signs`.
pub(super) fn affine(axes: [[f64; 3]; 3], first: [f64; 3], signs: [f64; 3]) -> Matrix4<f64> {
    let turn = Matrix3::from_diagonal(&Vector3::from(signs));
    let mut t = (turn * Matrix3::from_columns(&axes.map(Vector3::from))).to_homogeneous();
    t.fixed_view_mut::<3, 1>(0, 3).copy_from(&(turn * Vector3::from(first)));
    t
}

/// Whether values without a stated unit look like Hounsfield units: air below, bone above, most of them between.
fn looks_like_hu(voxels: &[f32]) -> bool {
    let start = (f32::MAX, f32::MIN, 0usize, 0usize);
    let (low, high, n_tissue, n) =
        voxels.iter().filter(|v| v.is_finite()).fold(start, |(low, high, n_tissue, n), v| {
            (low.min(*v), high.max(*v), n_tissue + usize::from((-1100.0..=3100.0).contains(v)), n + 1)
        });
    (-10_000.0..=-500.0).contains(&low) && high >= 300.0 && 2 * n_tissue >= n
}

/// The unit of values whose file states none, with a note.
pub(super) fn assumed_unit(voxels: &[f32], format: &str, notes: &mut Vec<String>) -> VoxelUnit {
    if looks_like_hu(voxels) {
        notes
            .push(format!("{format} states no unit of its values; with air and bone among them they were taken as HU"));
        VoxelUnit::Hu
    } else {
        VoxelUnit::Unknown
    }
}

/// The number of voxels of a size, and of their bytes, if both can be counted.
pub(super) fn n_voxels_and_bytes(size: [usize; 3], bytes_each: usize) -> Option<(usize, u64)> {
    let n = size.iter().try_fold(1usize, |n, s| n.checked_mul(*s))?;
    Some((n, (n as u64).checked_mul(bytes_each as u64)?))
}
