//! Tracked sequences of PLUS and SlicerIGSIO: a MetaImage or an NRRD whose header has fields for each frame.
//!
//! # Source
//! `vtkIGSIOMetaImageSequenceIO`, `vtkIGSIONrrdSequenceIO`, `igsioTrackedFrame` and `igsioTransformName` of IGSIO.

use super::{Log, Sample, Turn, stamp::nanoseconds};
use crate::{
    FileError, LostPose, input,
    metaimage_header::{Field, Header},
};
use nalgebra::Matrix3;
use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader},
    path::Path,
};

/// Before the number of a frame.
const FRAME: &str = "Seq_Frame";

/// Whether the header of a MetaImage or an NRRD has transforms of frames.
pub(crate) fn is_sequence(head: &[u8]) -> bool {
    let has = |word: &[u8]| head.windows(word.len()).any(|window| window == word);
    has(b"Seq_Frame") && has(b"Transform")
}

/// The fields of one frame.
#[derive(Default)]
struct FrameFields<'a> {
    stamp: Option<&'a Field>,
    /// The matrix and the status of each transform.
    transforms: BTreeMap<&'a str, (Option<&'a Field>, Option<&'a Field>)>,
}

/// Reads the poses of all frames; pixels are not read.
pub(super) fn read(path: &Path, unit_mm: f64, log: &mut Log) -> Result<(), FileError> {
    let mut reader = BufReader::new(input::open(path)?);
    let is_nrrd = reader.fill_buf().map_err(FileError::read(path))?.starts_with(b"NRRD");
    let header = if is_nrrd { Header::of_nrrd(path, &mut reader) } else { Header::read(path, &mut reader) }?;
    let mut frames: BTreeMap<u64, FrameFields> = BTreeMap::new();
    for field in header.fields() {
        let Some((number, name)) = field.key.strip_prefix(FRAME).and_then(|rest| rest.split_once('_')) else {
            continue;
        };
        let number = number.parse().map_err(|_| header.fault(field, "a frame has a number behind Seq_Frame"))?;
        let frame = frames.entry(number).or_default();
        if name == "Timestamp" {
            frame.stamp = Some(field);
        } else if let Some(name) = name.strip_suffix("TransformStatus") {
            frame.transforms.entry(name).or_default().1 = Some(field);
        } else if let Some(name) = name.strip_suffix("Transform") {
            frame.transforms.entry(name).or_default().0 = Some(field);
        }
    }
    if let Some(field) = header.get(&["DimSize", "sizes"]) {
        // In an NRRD the axis of the frames may be the first.
        let axes = || field.value.split_whitespace();
        let [first, last] = [axes().next(), axes().last()].map(|n| n.and_then(|n| n.parse::<usize>().ok()));
        if let Some(size) = last.filter(|size| *size != frames.len() && !(is_nrrd && first == Some(frames.len()))) {
            log.notes.push(format!(
                "{} states {size} frames, but the header has fields of {}",
                field.key,
                frames.len()
            ));
        }
    }
    let mut names: BTreeMap<&str, Name> = BTreeMap::new();
    for name in frames.values().flat_map(|frame| frame.transforms.keys()) {
        names.entry(name).or_insert_with(|| Name::of(name));
    }
    for (name, of) in &mut names {
        of.has_status =
            frames.values().any(|frame| frame.transforms.get(name).is_some_and(|(_, status)| status.is_some()));
        match &of.frames {
            None => log
                .notes
                .push(format!("{name}Transform does not say from what to what, as StylusToTracker does; left out")),
            Some(_) if !of.has_status => {
                log.notes.push(format!("{name}Transform has no status; all its poses are taken as seen"))
            }
            Some(_) => {}
        }
    }
    for (number, frame) in &frames {
        let stamp = frame.stamp.ok_or_else(|| {
            FileError::content(path, format!("frame {number}"), "no Timestamp; record the sequence with its stamps")
        })?;
        let stamp_ns = nanoseconds(&stamp.value, 9).map_err(|message| header.fault(stamp, message))?;
        for (name, of) in &names {
            let Some((from, to)) = &of.frames else { continue };
            let (matrix, status) = frame.transforms.get(name).copied().unwrap_or_default();
            let lost =
                |reason: String| LostPose { to: to.as_str().into(), from: from.as_str().into(), stamp_ns, reason };
            let pose = match (matrix, status) {
                (_, Some(status)) if status.value != "OK" => Err(lost(format!("the status {}", status.value))),
                (Some(_), None) if of.has_status => Err(lost("no status, which other frames have".into())),
                (None, _) => Err(lost("no transform in this frame".into())),
                (Some(field), _) => {
                    let fault = |message: String| header.fault(field, message);
                    let numbers = header.numbers(field)?;
                    let [a, b, c, x, d, e, f, y, g, h, i, z, 0.0, 0.0, 0.0, 1.0] = numbers[..] else {
                        let message = format!(
                            "16 numbers are expected, a matrix row by row that ends with 0 0 0 1, but there are {}",
                            field.value
                        );
                        return Err(fault(message));
                    };
                    let sample = Sample {
                        to: to.as_str().into(),
                        from: from.as_str().into(),
                        stamp_ns,
                        translation_mm: [x, y, z].map(|c| c * unit_mm),
                        turn: Turn::Matrix(Matrix3::new(a, b, c, d, e, f, g, h, i)),
                    };
                    sample.pose().map_err(fault)?
                }
            };
            log.push(pose, || format!("frame {number}"));
        }
    }
    Ok(())
}

/// A transform of a sequence.
struct Name {
    /// From which frame to which; none if the name does not say.
    frames: Option<(String, String)>,
    has_status: bool,
}

impl Name {
    /// `StylusToTracker` leads from `Stylus` to `Tracker`: by the one `To` that a capital, or no letter, follows.
    fn of(name: &str) -> Self {
        let is_split = |at: usize| {
            let next = name[at + 2..].chars().next();
            at > 0 && next.is_some_and(|c| !c.is_lowercase())
        };
        let mut splits = name.match_indices("To").map(|(at, _)| at).filter(|at| is_split(*at));
        let frames = match (splits.next(), splits.next()) {
            (Some(at), None) => Some((name[..at].to_owned(), name[at + 2..].to_owned())),
            _ => None,
        };
        Self { frames, has_status: false }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        pose_log::{LogFormat, LogOptions, PoseLog, read_log},
        probe::{Kind, probe},
    };
    use nalgebra::Point3;

    fn read_text(text: &str) -> Result<PoseLog, FileError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        assert_eq!(probe(file.path()).unwrap().kind, Kind::Poses(LogFormat::IgsMha));
        read_log(file.path(), &LogOptions::default())
    }

    /// A frame with a quarter turn about z and a translation, as PLUS writes it.
    fn frame(k: usize, status: &str) -> String {
        let name = format!("Seq_Frame{k:04}_StylusToTrackerTransform");
        format!(
            "{name} = 0 -1 0 10 1 0 0 20 0 0 1 {k} 0 0 0 1 \n{name}Status = {status}\nSeq_Frame{k:04}_Timestamp = {k}.25\n"
        )
    }

    fn sequence(frames: &str) -> String {
        format!(
            "ObjectType = Image\nNDims = 3\nDimSize = 0 0 3\nElementType = MET_OTHER\n{frames}ElementDataFile = LOCAL\n"
        )
    }

    #[test]
    fn a_transform_takes_points_of_the_tool_to_the_tracker_and_a_status_other_than_ok_is_a_lost_tool() {
        let log = read_text(&sequence(&[frame(0, "OK"), frame(1, "MISSING"), frame(2, "OK")].concat())).unwrap();
        assert_eq!(log.notes, [""; 0]);
        let pose = &log.poses[2].as_ref().unwrap().value;
        assert_eq!((pose.to.as_str(), pose.from.as_str(), pose.stamp_ns), ("Tracker", "Stylus", 2_250_000_000));
        assert!((pose.isometry * Point3::new(1.0, 0.0, 0.0) - Point3::new(10.0, 21.0, 2.0)).norm() < 1e-12);
        let lost = log.poses[1].as_ref().unwrap_err();
        assert_eq!((lost.stamp_ns, lost.reason.as_str()), (1_250_000_000, "the status MISSING"));
    }

    #[test]
    fn an_nrrd_has_the_same_poses_in_its_keys_and_is_no_ct() {
        let frames = [frame(0, "OK"), frame(1, "MISSING"), frame(2, "OK")].concat();
        let of = |head: &str, sizes: &str| {
            format!("NRRD0004\n# poses\ntype: uchar\ndimension: 3\nsizes: {sizes}\n{head}\n\u{1}pixels = 3\n")
        };
        let keys = frames.replace(" = ", ":=");
        let expected = read_text(&sequence(&frames)).unwrap();
        for sizes in ["3 640 480", "640 480 3"] {
            let log = read_text(&of(&keys, sizes)).unwrap();
            assert_eq!((&log.poses, &log.notes), (&expected.poses, &expected.notes));
        }
        let log = read_text(&of(&keys, "640 480 4")).unwrap();
        assert_eq!(log.notes, ["sizes states 4 frames, but the header has fields of 3"]);
        let twice = read_text(&of(&keys.replace("Frame0001", "Frame0000"), "3 1 1")).unwrap_err().to_string();
        assert!(twice.contains("line 9: the field is given once more"), "{twice}");
    }

    #[test]
    fn a_frame_without_a_transform_or_without_its_status_is_a_lost_tool_and_pixels_are_passed_over() {
        let no_status =
            frame(1, "OK").lines().filter(|line| !line.contains("Status")).fold(String::new(), |a, l| a + l + "\n");
        let text = sequence(&[frame(0, "OK"), no_status, "Seq_Frame0002_Timestamp = 3\n".into()].concat());
        let log = read_text(&(text + "\u{1}\u{2}pixels = 3\n")).unwrap();
        let reasons: Vec<_> =
            log.poses.iter().map(|pose| pose.as_ref().map_or_else(|lost| lost.reason.as_str(), |_| "seen")).collect();
        assert_eq!(reasons, ["seen", "no status, which other frames have", "no transform in this frame"]);
    }

    #[test]
    fn names_are_split_as_plus_splits_them() {
        for (name, frames) in [
            ("StylusToTracker", Some(("Stylus", "Tracker"))),
            ("TestToolToTracker", Some(("TestTool", "Tracker"))),
            ("TorsoToTracker", Some(("Torso", "Tracker"))),
            ("ProbeToToolTop", Some(("Probe", "ToolTop"))),
            ("AToBToC", None),
            ("ToTracker", None),
            ("Probe", None),
            ("ProbeTo", None),
        ] {
            let of = Name::of(name).frames;
            assert_eq!(of.as_ref().map(|(a, b)| (a.as_str(), b.as_str())), frames, "{name}");
        }
    }

    #[test]
    fn identities_and_positions_in_metres_are_told() {
        let still = frame(1, "OK").replace("0 -1 0 10 1 0 0 20 0 0 1 1", "1 0 0 0 0 1 0 0 0 0 1 0");
        let log = read_text(&sequence(&[frame(0, "OK"), still, frame(2, "OK")].concat())).unwrap();
        let expected = "t_Tracker_Stylus: 1 of 3 poses are the identity to the last bit, as programs write for a tool that was not seen";
        assert_eq!(log.signs, [("identity_poses", expected.to_owned())]);
        let metres = sequence(&[0, 1, 2].map(|k| frame(k, "OK").replace("10 1 0 0 20", "0.1 1 0 0 0.2")).concat());
        let signs = read_text(&metres).unwrap().signs;
        let expected = "all positions are within 2.012 mm of the origin; are they in metres?";
        assert!(signs[0].0 == "length_unit" && signs[0].1.contains(expected), "{signs:?}");
    }

    #[test]
    fn what_is_no_pose_is_refused_with_its_line() {
        let whole = sequence(&[frame(0, "OK"), frame(1, "OK"), frame(2, "OK")].concat());
        for (text, expected) in [
            (
                whole.replace("0 -1 0 10", "0 1 0 10"),
                "line 5 (Seq_Frame0000_StylusToTrackerTransform): the matrix is a mirror image",
            ),
            (whole.replace("0 -1 0 10", "0 -2 0 10"), "the upper left 3 x 3 is not a rotation"),
            (
                whole.replace("0 0 1 2 0 0 0 1", "0 0 1 2"),
                "line 11 (Seq_Frame0002_StylusToTrackerTransform): 16 numbers are expected",
            ),
            (whole.replace("= 1.25", "= now"), "line 10 (Seq_Frame0001_Timestamp): the stamp \"now\" is not a number"),
            (
                whole.replace("ElementDataFile = LOCAL\n", ""),
                "the header ends without ElementDataFile; was the file cut short?",
            ),
        ] {
            let error = read_text(&text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}\n{expected}");
        }
        let error = read_text(&whole.replace("StylusToTracker", "Stylus")).unwrap_err().to_string();
        let expected = "there is no pose in the file; StylusTransform does not say from what to what, as StylusToTracker does; left out";
        assert!(error.contains(expected), "{error}");
        let log = read_text(&whole.replace("DimSize = 0 0 3", "DimSize = 0 0 4")).unwrap();
        assert_eq!(log.notes, ["DimSize states 4 frames, but the header has fields of 3"]);
    }
}
