//! Tables of motion capture, whose heading is several lines: OptiTrack's Motive and Vicon's Tracker and Nexus.
//!
//! | Program | Heading |
//! |---|---|
//! | Motive | `Format Version,1.23,..,Rotation Type,Quaternion,Length Units,Meters,..`; lines with type and name of each column's body; `Rotation` or `Position`; `Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,..` |
//! | Vicon | `Objects` or `Segments`; the rate; `,,NAME,,..`; `Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ,..`; a line with the units |
//!
//! # Source
//! OptiTrack's documentation "Data Export: CSV", and exports of both as others published them with their readers.

use super::columns::{Columns, QuaternionColumns, TimeUnit, Tool};
use crate::{columns::quoted_cells, cursor::Cursor, unit::length_mm};

/// The heading is among so many lines.
const N_HEAD_LINES: usize = 12;

/// How a table of either begins.
pub(super) fn is_it(text: &str) -> bool {
    let mut lines = text.trim_start_matches('\u{feff}').lines();
    let first = lines.next().unwrap_or_default().trim();
    first.starts_with("Format Version,")
        || (matches!(first.trim_end_matches(','), "Objects" | "Segments")
            && lines.any(|line| line.starts_with("Frame,Sub Frame")))
}

/// A table's heading as one line, and what its columns are.
pub(super) struct Capture<'a> {
    pub(super) columns: Columns,
    pub(super) names: Vec<String>,
    /// At the line before the first pose.
    pub(super) cursor: Cursor<'a>,
    pub(super) unit_mm: f64,
    pub(super) rate_hz: Option<f64>,
}

impl<'a> Capture<'a> {
    /// Reads the heading.
    ///
    /// # Errors
    /// The line, and what is missing in it, such as quaternions.
    pub(super) fn of(mut cursor: Cursor<'a>) -> Result<Self, (usize, String)> {
        let mut lines: Vec<Vec<String>> = Vec::new();
        while lines.last().is_none_or(|cells| cells[0] != "Frame") && lines.len() < N_HEAD_LINES {
            let line =
                cursor.filled_line().ok_or((cursor.line, "the file ends before the line of Frame".to_owned()))?;
            lines.push(quoted_cells(&line, ',').iter().map(|cell| cell.trim().to_owned()).collect());
        }
        let fault = |message: String| (cursor.line, message);
        let Some((axes, above)) = lines.split_last().filter(|(axes, _)| axes[0] == "Frame") else {
            return Err(fault("no line begins with Frame".into()));
        };
        let is_motive = above[0][0] == "Format Version";
        let read = if is_motive { Self::motive(axes, above, cursor) } else { Self::vicon(axes, above, cursor) };
        let read = read.map_err(fault)?;
        // The poses of one would be taken for the other's.
        let n_of = |tool: &Tool| read.names.iter().filter(|name| **name == tool.translation[0]).count();
        match read.columns.tools.iter().find(|tool| n_of(tool) > 1) {
            Some(twice) => {
                let name = twice.child.as_deref().unwrap_or_default();
                Err(fault(format!("two bodies are called {name}; rename one, and export again")))
            }
            None => Ok(read),
        }
    }

    fn motive(axes: &[String], above: &[Vec<String>], cursor: Cursor<'a>) -> Result<Self, String> {
        let stated = |key: &str| {
            let at = above[0].iter().position(|cell| cell == key)?;
            above[0].get(at + 1).map(String::as_str)
        };
        match stated("Rotation Type") {
            Some("Quaternion") => {}
            other => {
                return Err(format!("the rotations are {}; export them as Quaternion", other.unwrap_or("not stated")));
            }
        }
        let unit = stated("Length Units").unwrap_or("not stated");
        let unit_mm = length_mm(unit).ok_or_else(|| format!("the unit of length (Length Units) is {unit}"))?;
        let has = |cells: &&Vec<String>, word: &str| cells.iter().skip(2).any(|cell| cell == word);
        // A body may have the name of a type.
        let is_type = |cells: &&Vec<String>| ["Rigid Body", "Bone"].iter().any(|kind| has(cells, kind));
        let types = above.get(1).filter(is_type);
        let parts = above.iter().find(|cells| has(cells, "Rotation"));
        let (Some(types), Some(parts)) = (types, parts) else {
            return Err("it has no rigid body with rotations; export rigid bodies, not markers alone".into());
        };
        let cell = |cells: &'_ [String], k: usize| cells.get(k).cloned().unwrap_or_default();
        let bodies = above.get(2).ok_or("no line has the names of the bodies")?;
        let is_body = |k: usize| matches!(&*cell(types, k), "Rigid Body" | "Bone");
        let name = |k: usize| match k {
            0 | 1 => axes[k].clone(),
            k if is_body(k) => format!("{} {} {}", cell(bodies, k), cell(parts, k), axes[k]),
            _ => String::new(),
        };
        let mut found: Vec<String> = Vec::new();
        for k in (2..axes.len()).filter(|k| is_body(*k) && cell(parts, *k) == "Rotation") {
            let body = cell(bodies, k);
            if !found.contains(&body) {
                found.push(body);
            }
        }
        let tools = found.into_iter().map(|body| {
            let of = |part: &str, axis: &str| format!("{body} {part} {axis}");
            let [w, x, y, z] = ["W", "X", "Y", "Z"].map(|axis| of("Rotation", axis));
            Tool {
                translation: ["X", "Y", "Z"].map(|axis| of("Position", axis)),
                quaternion: Some(QuaternionColumns { w, x, y, z }),
                child: Some(body),
                ..Tool::default()
            }
        });
        let time = axes.get(1).filter(|name| name.starts_with("Time")).ok_or("the second column is not the time")?;
        let columns = Columns {
            time: time.clone(),
            time_unit: TimeUnit::S,
            time_ns: None,
            parent: "tracker".into(),
            tools: tools.collect(),
        };
        Ok(Self { columns, names: (0..axes.len()).map(name).collect(), cursor, unit_mm, rate_hz: None })
    }

    fn vicon(axes: &[String], above: &[Vec<String>], mut cursor: Cursor<'a>) -> Result<Self, String> {
        let rate_hz = above.get(1).and_then(|cells| cells[0].parse().ok()).ok_or("the second line is not the rate")?;
        let bodies = above.last().ok_or("no line has the names of the objects")?;
        let mut body = "";
        let (mut names, mut found) = (Vec::new(), Vec::new());
        for (k, axis) in axes.iter().enumerate() {
            if let Some(name) = bodies.get(k).filter(|name| k > 1 && !name.is_empty()) {
                body = name.trim_start_matches("Global Angle ");
                found.push(body);
            }
            names.push(if k > 1 { format!("{body} {axis}") } else { axis.clone() });
        }
        let units = cursor.filled_line().ok_or("the file ends before the line of the units")?.into_owned();
        let units = quoted_cells(&units, ',');
        let unit =
            names.iter().position(|name| name.ends_with(" TX")).and_then(|k| units.get(k)).map(|unit| unit.trim());
        let unit = unit.ok_or("no column is TX, so it has no object")?;
        let unit_mm = length_mm(unit).ok_or_else(|| format!("the unit of TX is \"{unit}\""))?;
        let tools = found.into_iter().map(|body| {
            let [w, x, y, z] = ["RW", "RX", "RY", "RZ"].map(|axis| format!("{body} {axis}"));
            if !names.contains(&w) {
                return Err(format!("the rotations of {body} are angles, whose order the file does not say; export quaternions (RX, RY, RZ, RW)"));
            }
            Ok(Tool {
                translation: ["TX", "TY", "TZ"].map(|axis| format!("{body} {axis}")),
                quaternion: Some(QuaternionColumns { w, x, y, z }),
                child: Some(body.to_owned()),
                ..Tool::default()
            })
        });
        let columns = Columns {
            time: "Frame".into(),
            time_unit: TimeUnit::Frames,
            time_ns: None,
            parent: "tracker".into(),
            tools: tools.collect::<Result<_, _>>()?,
        };
        Ok(Self { columns, names, cursor, unit_mm, rate_hz: Some(rate_hz) })
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        pose_log::{LogFormat, LogOptions, PoseLog, read_log},
        probe::{Kind, probe},
    };

    fn read(text: &str, unit_mm: Option<f64>) -> Result<PoseLog, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        assert_eq!(probe(file.path()).unwrap().kind, Kind::Poses(LogFormat::MotionCapture), "{text}");
        read_log(file.path(), &LogOptions { unit_mm, ..LogOptions::default() }).map_err(|error| error.to_string())
    }

    /// Frame, stamp, position and the turn in degrees about the axis of each pose, or why it is lost.
    fn words(log: &PoseLog) -> Vec<String> {
        let word = |pose: &Result<osteoflow_geometry::Nearest<osteoflow_geometry::Pose>, crate::LostPose>| match pose {
            Ok(pose) => {
                let pose = &pose.value;
                let turn = pose.isometry.rotation.scaled_axis().map(|rad| rad.to_degrees().round());
                let at: [f64; 3] = pose.isometry.translation.vector.into();
                format!("{} {} {at:.1?} {:?}", pose.from, pose.stamp_ns, <[f64; 3]>::from(turn))
            }
            Err(lost) => format!("{} {} {}", lost.from, lost.stamp_ns, lost.reason),
        };
        log.poses.iter().map(word).collect()
    }

    /// As Motive writes two rigid bodies, of which one has a marker beside it.
    const MOTIVE: &str = "Format Version,1.23,Take Name,a,Take Notes,,Capture Frame Rate,120.000000,Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global\r\n\r\n\
        ,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body Marker,Rigid Body Marker,Rigid Body Marker,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\r\n\
        ,Name,Bone,Bone,Bone,Bone,Bone,Bone,Bone,Bone,Bone:Marker1,Bone:Marker1,Bone:Marker1,\"Stylus 2\",\"Stylus 2\",\"Stylus 2\",\"Stylus 2\",\"Stylus 2\",\"Stylus 2\",\"Stylus 2\"\r\n\
        ,ID,1,1,1,1,1,1,1,1,2,2,2,3,3,3,3,3,3,3\r\n\
        ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Position,Position,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\r\n\
        Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,X,Y,Z,W,X,Y,Z\r\n\
        0,0.000000,0,0,0.70710678,0.70710678,0.1,0.2,0.3,0.0002,9,9,9,1,0,0,0,-0.1,0,0.5\r\n\
        1,0.008333,0,0,0.70710678,0.70710678,0.1,0.2,0.31,0.0002,9,9,9,,,,,,,\r\n";

    /// As Vicon's Tracker writes two objects with quaternions.
    const VICON: &str = "Objects\n100\n,,Bone:Bone,,,,,,,Global Angle Probe:Probe,,,,,,\n\
        Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm,,,,,mm,mm,mm\n\
        1,0,0,0.70710678,0,0.70710678,10,20,30,0,0,0,1,-4,5,6\n\
        2,0,,,,,,,,0,0,0,1,-4.5,5,6\n";

    #[test]
    fn rigid_bodies_of_motive_are_read_in_their_unit_and_an_empty_pose_is_a_lost_tool() {
        let log = read(MOTIVE, None).unwrap();
        let expected = [
            "Bone 1 [100.0, 200.0, 300.0] [0.0, 0.0, 90.0]",
            "Stylus 2 1 [-100.0, 0.0, 500.0] [180.0, 0.0, 0.0]",
            "Bone 8333000 [100.0, 200.0, 310.0] [0.0, 0.0, 90.0]",
            "Stylus 2 8333000 a position that is not finite",
        ];
        assert_eq!(words(&log), expected);
        assert_eq!(
            words(&read(&MOTIVE.replace("Meters", "Millimeters"), None).unwrap())[0][..22],
            *"Bone 1 [0.1, 0.2, 0.3]"
        );
        // Older exports have neither words in the second column nor a line of IDs.
        let older: String = MOTIVE
            .replace(",Type,", ",,")
            .replace(",Name,", ",,")
            .lines()
            .filter(|l| !l.starts_with(",ID"))
            .map(|l| format!("{l}\n"))
            .collect();
        assert_eq!(words(&read(&older, None).unwrap()), expected);
    }

    #[test]
    fn objects_of_vicon_are_read_at_their_rate() {
        let expected = [
            "Bone:Bone 10000000 [10.0, 20.0, 30.0] [0.0, 90.0, 0.0]",
            "Probe:Probe 10000000 [-4.0, 5.0, 6.0] [0.0, 0.0, 0.0]",
            "Bone:Bone 20000000 a position that is not finite",
            "Probe:Probe 20000000 [-4.5, 5.0, 6.0] [0.0, 0.0, 0.0]",
        ];
        assert_eq!(words(&read(VICON, None).unwrap()), expected);
        assert_eq!(words(&read(VICON, Some(1.0)).unwrap()), expected);
        let metres = VICON.replace("mm", "m");
        assert!(words(&read(&metres, None).unwrap())[0].contains("[10000.0, 20000.0, 30000.0]"));
    }

    #[test]
    fn what_a_table_does_not_say_is_refused_with_its_line() {
        for (text, unit_mm, expected) in [
            (MOTIVE.replace("Quaternion", "XYZ"), None, "the rotations are XYZ; export them as Quaternion"),
            (MOTIVE.replace("Meters", "Furlongs"), None, "the unit of length (Length Units) is Furlongs"),
            (MOTIVE.replace("Rigid Body", "Marker"), None, "it has no rigid body with rotations"),
            (MOTIVE.into(), Some(1.0), "it states a unit of 1000 mm, and unit_mm is 1"),
            (MOTIVE.replace("1,0.008333", "1,later"), None, "line 9"),
            (MOTIVE.replace("\"Stylus 2\"", "Bone"), None, "two bodies are called Bone; rename one"),
            (VICON.replace("Probe:Probe", "Bone:Bone"), None, "two bodies are called Bone:Bone; rename one"),
            (VICON.replace(",RW", ",RV"), None, "line 4: the rotations of Bone:Bone are angles"),
            (VICON.replace(",mm", ",px"), None, "line 4: the unit of TX is \"px\""),
            (VICON.replace("100\n", "fast\n"), None, "line 4: the second line is not the rate"),
        ] {
            let said = read(&text, unit_mm).unwrap_err();
            assert!(said.contains(expected), "{said}\n{expected}");
        }
    }
}
