//! Poses over time as trackers and other programs log them.
//!
//! | File | A pose is | Unit | Stamps |
//! |---|---|---|---|
//! | sequence of PLUS and SlicerIGSIO, `.igs.mha` and `.igs.nrrd`, with or without pixels | `StylusToTrackerTransform`, `t_Tracker_Stylus`, a matrix row by row, with its status | mm | seconds |
//! | TUM trajectory | `x y z qx qy qz qw`, the pose of the moving frame in the fixed one | m | seconds |
//! | EuRoC MAV, CSV | `p_RS_R`, `q_RS` with w first, the pose of S in R | m | nanoseconds |
//! | KITTI odometry | the upper three rows of `t_fixed_moving` | m | none: a rate, or a file of times |
//! | [`poses_csv`](crate::poses_csv) | `t_parent_child`, the quaternion's w last | mm | nanoseconds |
//! | table of NDI's Track, or of the sample program of its API, CSV | `Q0 Qx Qy Qz Tx Ty Tz` for each port, the pose of the tool in the tracker, with its state | mm | seconds, or frames |
//! | table of OptiTrack's Motive, or of Vicon's Tracker, CSV | rotation and position of each rigid body, in the tracker | as stated | seconds, or frames of a rate |
//! | any other table, as of Atracsys | as [`Columns`] describes its heading | mm | as described |
//!
//! A tool that the tracker did not see is a [`LostPose`]: a status other than `OK`, numbers that are missing or not finite, an
//! all-zero quaternion. Stamps in text are taken digit by digit, not by a float, which has no nanoseconds left after 1970.

mod columns;
mod motion_capture;
mod ndi;
pub mod poses_csv;
mod sequence;
mod stamp;
mod stamp_unit;
mod trajectory;
mod write_tum;

pub use crate::kind::LogFormat;
pub use columns::{Columns, QuaternionColumns, TimeUnit, Tool};
pub(crate) use sequence::is_sequence;
pub use write_tum::write_tum;

use crate::{
    FileError, LostPose, Sign, Spellings, StampOrder,
    cursor::Cursor,
    input,
    kind::{Kind, Probe, marked},
    metaimage_header::is_metaimage,
    space::check_comments,
};
use nalgebra::{Isometry3, Matrix3, Matrix4, Quaternion, Translation3};
use osteoflow_geometry::{
    Frame, MM_PER_M, Nearest, Pose, RigidError, StampNs, TooFar, nearest_isometry, nearest_rotation,
};
use stamp_unit::Track;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Bytes of a file by which its format is recognised.
const N_HEAD: usize = 1 << 16;

/// A translation beyond this, a kilometre, is a tracker's code for a tool that it does not see.
const FARTHEST_MM: f64 = 1e6;

/// A tracker sees no farther, mm: a hall of motion capture.
const FARTHEST_SEEN_MM: f64 = 1e5;
/// A tracker sees no nearer, mm.
const NEAREST_SEEN_MM: f64 = 10.0;

/// What a log does not say itself.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LogOptions {
    /// The format; none: recognised by the content, or a table, if `columns` are given.
    pub format: Option<LogFormat>,
    /// The unit of length, mm; none: that of the format.
    pub unit_mm: Option<f64>,
    /// The frame that the poses lead to, in formats that name none.
    pub parent: Option<String>,
    /// The frame that moves, in formats that name none.
    pub child: Option<String>,
    /// Poses a second, where the file counts frames or has no stamps.
    pub rate_hz: Option<f64>,
    /// A text of one stamp in seconds for each pose of a KITTI trajectory.
    pub times: Option<PathBuf>,
    /// The heading of a table.
    pub columns: Option<Columns>,
}

/// The poses of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseLog {
    /// What the file is.
    pub format: LogFormat,
    /// The poses in file order; where a tool was not seen, a [`LostPose`].
    pub poses: Vec<Result<Nearest<Pose>, LostPose>>,
    /// What the user should know, one sentence each.
    pub notes: Vec<String>,
    /// Signs that the file is wrong.
    pub signs: Vec<Sign>,
}

/// The format of a text by its content; none if it is no log.
///
/// # Errors
/// [`FileError`] if the order of its quaternions cannot be told.
pub(crate) fn format_of(path: &Path, bytes: &[u8]) -> Result<Option<LogFormat>, FileError> {
    let head = &bytes[..bytes.len().min(N_HEAD)];
    let format = trajectory::format_of(head, head.len() == bytes.len());
    format.map_err(|message| FileError::content(path, "line 1", message))
}

/// Reads a log.
///
/// # Errors
/// [`FileError`] with the line: a matrix or quaternion that is no rotation, a stamp that is none, a line that is cut short, frames,
/// rate or columns that the file does not say and the options do not give.
pub fn read_log(path: &Path, options: &LogOptions) -> Result<PoseLog, FileError> {
    let format = match options.format {
        Some(format) => format,
        None if options.columns.is_some() => LogFormat::Table,
        None => found_format(path)?,
    };
    let unit_mm = options.unit_mm.unwrap_or_else(|| format.unit_mm());
    let mut log = Log::default();
    if !matches!(format, LogFormat::IgsMha | LogFormat::Poses) {
        check_comments(path, &input::read(path)?, unit_mm)?;
    }
    match format {
        LogFormat::IgsMha => sequence::read(path, unit_mm, &mut log)?,
        LogFormat::Tum | LogFormat::Euroc | LogFormat::Kitti => {
            trajectory::read(path, format, unit_mm, options, &mut log)?
        }
        LogFormat::Poses => drop(poses_csv::read(path, unit_mm, &mut log)?),
        LogFormat::Ndi | LogFormat::MotionCapture | LogFormat::Table => {
            columns::read(path, unit_mm, options, &mut log)?
        }
    }
    if log.poses.is_empty() {
        return Err(no_pose(path, &log.notes));
    }
    Ok(log.finish(format))
}

/// That a log has no pose, and why.
fn no_pose(path: &Path, notes: &[String]) -> FileError {
    let why = if notes.is_empty() { "was it cut short?".into() } else { notes.join("; ") };
    FileError::content(path, "poses", format!("there is no pose in the file; {why}"))
}

/// The format of a file by its content.
fn found_format(path: &Path) -> Result<LogFormat, FileError> {
    const WANTED: &str = "a log of poses, .igs.mha with transforms, TUM (timestamp x y z qx qy qz qw), EuRoC, KITTI, \
                          t_ns,parent,child,x,y,z,qx,qy,qz,qw, or a table whose heading columns describe,";
    let head = input::head(path, N_HEAD as u64)?;
    if (is_metaimage(&head) || head.starts_with(b"NRRD")) && is_sequence(&head) {
        return Ok(LogFormat::IgsMha);
    }
    if let Some(found) = marked(path, &head) {
        return Err(found.refusal(path, WANTED));
    }
    let bytes = input::read(path)?;
    Cursor::text(path, &bytes)?;
    format_of(path, &bytes)?.ok_or_else(|| Probe::new(Kind::Unknown, "", path).refusal(path, WANTED))
}

/// A rotation as a file gives it.
enum Turn {
    Quaternion(Quaternion<f64>),
    Matrix(Matrix3<f64>),
}

/// A pose as a file gives it, translation in mm.
struct Sample {
    to: Frame,
    from: Frame,
    stamp_ns: StampNs,
    translation_mm: [f64; 3],
    turn: Turn,
}

impl Sample {
    /// The pose; lost if numbers are missing or mean that the tool was not seen.
    fn pose(self) -> Result<Result<Nearest<Pose>, LostPose>, String> {
        let Self { to, from, stamp_ns, translation_mm, turn } = self;
        let lost =
            |reason: &str| Ok(Err(LostPose { to: to.clone(), from: from.clone(), stamp_ns, reason: reason.into() }));
        let [x, y, z] = translation_mm;
        if !translation_mm.iter().all(|c| c.is_finite()) {
            return lost("a position that is not finite");
        }
        let translation = Translation3::new(x, y, z);
        let isometry = match turn {
            Turn::Quaternion(q) => match nearest_rotation(q) {
                Err(RigidError::NotFinite { .. }) => return lost("a rotation that is not finite"),
                Err(RigidError::Zero { .. }) => return lost("an all-zero quaternion"),
                rotation => rotation
                    .map_err(|error| format!("{error}; are these the columns of the quaternion, in this order?"))?
                    .map(|rotation| Isometry3::from_parts(translation, rotation)),
            },
            Turn::Matrix(rotation) => {
                let mut matrix = Matrix4::identity();
                matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
                match nearest_isometry(&matrix) {
                    Err(RigidError::NotFinite { .. }) => return lost("a rotation that is not finite"),
                    Err(RigidError::Zero { .. }) => return lost("an all-zero rotation"),
                    nearest => nearest
                        .map_err(|error| error.to_string())?
                        .map(|isometry| Isometry3::from_parts(translation, isometry.rotation)),
                }
            }
        };
        TooFar::check(&translation_mm).map_err(|far| format!("the translation: {far}; is its unit right?"))?;
        Ok(Ok(isometry.map(|isometry| Pose::new(to.clone(), from.clone(), isometry).at(stamp_ns))))
    }
}

/// Poses as they are read.
#[derive(Default)]
pub(crate) struct Log {
    poses: Vec<Result<Nearest<Pose>, LostPose>>,
    notes: Vec<String>,
    orders: BTreeMap<[Frame; 2], Stream>,
    spellings: Spellings,
    /// Whether a stamp of 0 is that of a constant.
    pub(crate) has_constants: bool,
}

/// The poses of one tool.
#[derive(Default)]
struct Stream {
    order: StampOrder,
    track: Track,
    n_lost: usize,
    n_at_zero: usize,
    n_identities: usize,
    farthest_mm: f64,
}

impl Log {
    /// Takes a pose; `place` names its line.
    pub(crate) fn push(&mut self, mut pose: Result<Nearest<Pose>, LostPose>, place: impl FnOnce() -> String) {
        let (to, from, stamp_ns) = match &mut pose {
            Ok(pose) => (&mut pose.value.to, &mut pose.value.from, &mut pose.value.stamp_ns),
            Err(lost) => (&mut lost.to, &mut lost.from, &mut lost.stamp_ns),
        };
        (*to, *from) = (self.spellings.take(to), self.spellings.take(from));
        if *stamp_ns == 0 && self.has_constants {
            self.poses.push(pose);
            return;
        }
        let stream = self.orders.entry([to.clone(), from.clone()]).or_default();
        if *stamp_ns == 0 {
            // A stamp of 0 is that of a constant, which a pose of such a log is not.
            *stamp_ns = 1;
            stream.n_at_zero += 1;
        }
        stream.order.take(*stamp_ns, place);
        stream.track.stamps.push(*stamp_ns);
        stream.n_lost += usize::from(pose.is_err());
        if let Ok(Nearest { value: pose, .. }) = &pose {
            let at = pose.isometry.translation.vector;
            stream.track.seen.push((pose.stamp_ns, at));
            stream.n_identities += usize::from(pose.isometry == Isometry3::identity());
            stream.farthest_mm = stream.farthest_mm.max(at.norm());
        }
        self.poses.push(pose);
    }

    pub(crate) fn finish(self, format: LogFormat) -> PoseLog {
        // A pose between two markers may be as short, so those of all tools decide.
        let farthest_mm = self.orders.values().map(|stream| stream.farthest_mm).fold(0.0, f64::max);
        let n = self.orders.values().map(Stream::n).max().unwrap_or_default();
        let (mut signs, notes) = (self.spellings.signs, [self.notes, self.spellings.notes].concat());
        if format.unit_mm() != MM_PER_M && n > 2 && farthest_mm > 0.0 && farthest_mm < NEAREST_SEEN_MM {
            let message = format!(
                "all positions are within {farthest_mm:.3} mm of the origin; are they in metres? then unit_mm = 1000 (--scale 1000)"
            );
            signs.push(("length_unit", message));
        }
        for ([to, from], stream) in &self.orders {
            let what = format!("t_{to}_{from}");
            signs.extend(stream.order.note(&what).map(|note| ("stamp_order", note)));
            signs.extend(stream.signs(format).map(|(rule, sign)| (rule, format!("{what}: {sign}"))));
        }
        PoseLog { format, poses: self.poses, notes, signs }
    }
}

impl Stream {
    fn n(&self) -> usize {
        self.track.stamps.len()
    }

    /// Signs that the poses are not what they are read as.
    fn signs(&self, format: LogFormat) -> impl Iterator<Item = Sign> {
        let n_at_zero = Some(self.n_at_zero).filter(|n| *n > 1);
        let unstamped = n_at_zero.map(|n| format!("{n} poses have the stamp 0; does the file have stamps?"));
        let never = (self.n_lost == self.n()).then(|| format!("the tool was seen in none of {} samples", self.n()));
        [
            ("stamps_missing", unstamped),
            ("never_seen", never),
            ("stamp_unit", self.track.sign()),
            ("length_unit", self.length_sign(format)),
            ("identity_poses", self.identity_sign(format)),
        ]
        .into_iter()
        .filter_map(|(rule, sign)| Some((rule, sign?)))
    }

    /// Positions in metres that are as far as those of no tracker: their unit is another.
    fn length_sign(&self, format: LogFormat) -> Option<String> {
        let is_far = format.unit_mm() == MM_PER_M && self.farthest_mm > FARTHEST_SEEN_MM;
        is_far.then(|| {
            let m = self.farthest_mm / MM_PER_M;
            format!("its positions are up to {m:.0} m away, farther than a tracker sees; are they in mm? then unit_mm = 1 (--scale 0.001)")
        })
    }

    /// Poses that are the identity, which is where a trajectory begins, and no pose of a tracker.
    fn identity_sign(&self, format: LogFormat) -> Option<String> {
        let (n, of) = (self.n_identities, self.n() - self.n_lost);
        let is_odd = format.names_frames() && n > 0 && n < of;
        is_odd.then(|| {
            format!(
                "{n} of {of} poses are the identity to the last bit, as programs write for a tool that was not seen"
            )
        })
    }
}
