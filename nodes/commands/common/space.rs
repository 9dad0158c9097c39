use clap::ValueEnum;
use osteoflow_formats::Space;

/// The anatomical space of coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum SpaceOption {
    /// Left, posterior, superior: DICOM's, and that of STL and PLY files in 3D Slicer.
    Lps,
    /// Right, anterior, superior: NIfTI's, and what 3D Slicer shows.
    Ras,
}

impl From<SpaceOption> for Space {
    fn from(space: SpaceOption) -> Self {
        match space {
            SpaceOption::Lps => Self::Lps,
            SpaceOption::Ras => Self::Ras,
        }
    }
}
