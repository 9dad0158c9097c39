//! Trajectories of TUM, as evo and others read them.

use crate::{FileError, LostPose};
use osteoflow_geometry::{MM_PER_M, Pose};
use std::{fmt::Write as _, path::Path};

/// Writes the poses of one moving frame as a TUM trajectory: seconds with nine digits, metres, the quaternion's w last. What was lost is
/// left out, since the format has no word for it; their number is returned.
///
/// # Errors
/// [`FileError`] if the poses are of several frames, or the file cannot be written.
pub fn write_tum(path: &Path, poses: &[Result<Pose, LostPose>]) -> Result<usize, FileError> {
    let mut text = String::from("# timestamp tx ty tz qx qy qz qw\n");
    let mut frames = None;
    for pose in poses.iter().flatten() {
        let first = *frames.get_or_insert((&pose.to, &pose.from));
        if first != (&pose.to, &pose.from) {
            let message = format!(
                "a TUM trajectory has one moving frame, and there are t_{}_{} and t_{}_{}; choose one by --parent and --child",
                first.0, first.1, pose.to, pose.from
            );
            return Err(FileError::content(path, "frames", message));
        }
        let (t, q) = (pose.isometry.translation.vector / MM_PER_M, pose.isometry.rotation);
        let (sign, ns) = (if pose.stamp_ns < 0 { "-" } else { "" }, pose.stamp_ns.unsigned_abs());
        let (whole, fraction) = (ns / 1_000_000_000, ns % 1_000_000_000);
        let _ = writeln!(text, "{sign}{whole}.{fraction:09} {} {} {} {} {} {} {}", t.x, t.y, t.z, q.i, q.j, q.k, q.w);
    }
    osteoflow_container::durable::write(path, text).map_err(FileError::write(path))?;
    Ok(poses.iter().filter(|pose| pose.is_err()).count())
}
