//! The files of the repository that README and documentation name, for those who have the program alone: graphs, and the examples
//! below `tests/data`, at the same paths. `osteoflow new examples` writes them.

use super::error::UsageError;
use std::path::Path;

macro_rules! files {
    ($($path:literal,)*) => { &[$(($path, include_str!(concat!("../../", $path)))),*] };
}

/// Path and content of every file that is not generated.
pub(crate) const FILES: &[(&str, &str)] = files![
    "graphs/calibration.toml",
    "graphs/fibula.toml",
    "graphs/fibula_folder.toml",
    "graphs/fibula_no_points.toml",
    "graphs/fibula_recorded.toml",
    "graphs/fibula_tracking.toml",
    "graphs/modules/laser_point.toml",
    "graphs/paper/accuracy_camera.toml",
    "graphs/paper/accuracy_stylus.toml",
    "graphs/paper/bench.toml",
    "graphs/paper/calibration.toml",
    "graphs/paper/cutting.toml",
    "graphs/paper/error_terms.toml",
    "graphs/paper/in_vivo.toml",
    "graphs/paper/laser_detectors.toml",
    "graphs/paper/laser_spot.toml",
    "graphs/paper/page.md",
    "graphs/paper/point_count.toml",
    "graphs/paper/readings.toml",
    "graphs/paper/reproduce.py",
    "graphs/paper/roi_extent.toml",
    "graphs/paper/sensitivity.toml",
    "graphs/paper/variants.toml",
    "graphs/plan.schema.json",
    "graphs/plugins/cpd.py",
    "graphs/real/benchmark.py",
    "graphs/real/chance.py",
    "graphs/real/peers.py",
    "graphs/real/recover.toml",
    "graphs/real/trustbench.py",
    "graphs/trust/check_piece.toml",
    "graphs/trust/curves.py",
    "graphs/trust/curves.toml",
    "graphs/trust/intervals.toml",
    "graphs/trust/mistakes.toml",
    "graphs/trust/slow_scans.toml",
    "graphs/trust/sound.toml",
    "graphs/two_files.toml",
    "graphs/variants/fibula_export.toml",
    "graphs/variants/fibula_folder_untracked.toml",
    "graphs/variants/fibula_live.toml",
    "graphs/variants/fibula_live_foxglove.toml",
    "graphs/variants/fibula_live_openigtlink.toml",
    "graphs/variants/fibula_modules.toml",
    "graphs/variants/fibula_point_to_point.toml",
    "graphs/variants/fibula_range_image.toml",
    "graphs/variants/fibula_recorded_point_to_point.toml",
    "graphs/variants/fibula_recorded_range_image.toml",
    "graphs/variants/fibula_rgb_spot.toml",
    "graphs/variants/fibula_ruled.toml",
    "graphs/variants/fibula_slide.toml",
    "graphs/variants/fibula_stylus.toml",
    "graphs/variants/two_files_picked.toml",
    "tests/data/picks/README.md",
    "tests/data/picks/bone_points.mrk.json",
    "tests/data/picks/scan_points.mrk.json",
    "tests/data/register/init.txt",
];

/// The folders of the procedure of README, which is simulated: as files, and as a recording.
pub(crate) const FOLDER: &str = "tests/data/folder";
pub(crate) const RECORDING: &str = "tests/data/procedure";

/// Refuses a file that is not there, but is one of these.
///
/// # Errors
/// The command that writes it.
pub(crate) fn check_is_here(file: &Path) -> Result<(), UsageError> {
    let of_procedure = |path: &&str| [FOLDER, RECORDING].iter().any(|folder| path.starts_with(folder));
    let is_shipped = |path: &&str| FILES.iter().any(|(shipped, _)| shipped == path) || of_procedure(path);
    match file.to_str().filter(is_shipped) {
        Some(path) if !file.exists() => Err(UsageError(format!(
            "{path} is not in this folder; `osteoflow new examples DIR` writes it and all other files that the documentation \
             names, then `cd DIR`"
        ))),
        _ => Ok(()),
    }
}
