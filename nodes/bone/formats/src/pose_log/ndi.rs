//! Tables of NDI's programs, known by their headings.
//!
//! | Program | Heading |
//! |---|---|
//! | Track, of ToolBox | `Tools`, and for each port `Port 1: NAME,Frame,Time [sec],Face,State,Q0,..,Error,Markers,State,Tx,Ty,Tz,..`; a line with the date may be before it; older ones have no times |
//! | the sample program of the Combined API | `#Tools`, and for each tool `ToolInfo,Frame#,PortHandle,Face#,timespec_s,timespec_ns,TransformStatus,Q0,..,Error,#Markers,Marker0.Status,Tx,Ty,Tz,..`; older ones have no times |
//!
//! # Source
//! Exports and their readers as others published them: a table of a Polaris Vega in the tests of a reader of three trackers of a knee, the
//! reader of a Polaris Vicra's of the HRRT user's software (`vicra_plot`), and the sample program `sample.cpp` of NDI's Combined API.

use super::columns::{Columns, QuaternionColumns, SEPARATORS, TimeUnit, Tool, named};
use crate::{columns::quoted_cells, cursor::Cursor};

/// The heading is among so many lines.
pub(super) const N_HEAD_LINES: usize = 2;

/// A table of NDI, by its heading.
pub(super) struct Ndi {
    pub(super) columns: Columns,
    /// The place of the number of tools in a line.
    count: Option<usize>,
    /// The heading's number of columns.
    n_columns: usize,
}

/// The cells of a heading, by the separator that gives most.
fn heading(line: &str) -> Vec<String> {
    let line = line.trim_start_matches('\u{feff}');
    let cut = SEPARATORS.map(|separator| quoted_cells(line, separator));
    let cells = cut.into_iter().max_by_key(Vec::len).unwrap_or_default();
    named(&cells)
}

/// Whether a cell names a port.
pub(super) fn is_port(cell: &str) -> bool {
    cell.starts_with("Port ")
}

/// Whether two cells name one port, `Port 10: NAME`, of which one may be without the tool's name.
pub(super) fn is_same_port(a: &str, b: &str) -> bool {
    let parts = |cell: &str| {
        let (port, tool) = cell.split_once(':').unwrap_or((cell, ""));
        [port, tool].map(|part| part.split_whitespace().collect::<Vec<_>>().join(" ").to_lowercase())
    };
    let ([port_a, tool_a], [port_b, tool_b]) = (parts(a), parts(b));
    port_a == port_b && (tool_a == tool_b || tool_a.is_empty() || tool_b.is_empty())
}

/// Whether a line is the heading of a table of NDI.
pub(super) fn is_heading(line: &str) -> bool {
    let cells = heading(line);
    let has = |name: &str| cells.iter().any(|cell| cell == name);
    let is_of_track = cells.first().is_some_and(|cell| cell == "Tools") && cells.iter().any(|cell| is_port(cell));
    let is_of_sample = has("ToolInfo") && has("TransformStatus");
    ["Tx", "Ty", "Tz"].iter().all(|name| has(name)) && (is_of_track || is_of_sample)
}

impl Ndi {
    /// The table that begins with a heading of NDI.
    pub(super) fn find(mut cursor: Cursor<'_>) -> Option<Self> {
        (0..N_HEAD_LINES)
            .map_while(|_| cursor.filled_line().map(|line| line.to_string()))
            .find(|line| is_heading(line))
            .map(|line| Self::of(&line))
    }

    fn of(line: &str) -> Self {
        let cells = heading(line);
        let has = |name: &str| cells.iter().any(|cell| cell == name);
        let is_of_sample = has("ToolInfo");
        let (time, time_unit) =
            [("Time [sec]", TimeUnit::S), ("timespec_s", TimeUnit::S), ("Frame#", TimeUnit::Frames)]
                .into_iter()
                .find(|(name, _)| has(name))
                .unwrap_or(("Frame", TimeUnit::Frames));
        let names = |names: [&str; 3]| names.map(String::from);
        let tool = |after: String, name: Option<String>| Tool {
            child_column: name.is_none().then(|| "ToolInfo".into()),
            child: name,
            after: Some(after),
            translation: names(["Tx", "Ty", "Tz"]),
            quaternion: has("Q0").then(|| {
                let [w, x, y, z] = ["Q0", "Qx", "Qy", "Qz"].map(String::from);
                QuaternionColumns { w, x, y, z }
            }),
            euler_zyx_deg: (!has("Q0")).then(|| names(["Rz", "Ry", "Rx"])),
            status: Some(if is_of_sample { "TransformStatus" } else { "State" }.into()),
            seen: Some(vec!["OK".into(), "Enabled".into()]),
            ..Tool::default()
        };
        let tools: Vec<Tool> = if is_of_sample {
            let n = cells.iter().filter(|cell| *cell == "ToolInfo").count();
            (1..=n).map(|k| tool(format!("ToolInfo#{k}"), None)).collect()
        } else {
            let named = |port: &String| port.split_once(':').map_or(port.as_str(), |(_, name)| name).trim().to_owned();
            cells.iter().filter(|cell| is_port(cell)).map(|port| tool(port.clone(), Some(named(port)))).collect()
        };
        let first = cells.iter().position(|cell| is_port(cell) || cell == "ToolInfo");
        let columns = Columns {
            time: time.into(),
            time_unit,
            time_ns: has("timespec_ns").then(|| "timespec_ns".into()),
            parent: "tracker".into(),
            tools,
        };
        Self { columns, count: first.and_then(|k| k.checked_sub(1)), n_columns: cells.len() }
    }

    /// Whether the columns of a line are those of the heading: a line of other tools or markers has its poses elsewhere.
    pub(super) fn check(&self, cells: &[String]) -> Result<(), String> {
        let n_tools = self.columns.tools.len();
        let stated = self.count.and_then(|place| cells.get(place)?.parse::<usize>().ok());
        if let Some(stated) = stated.filter(|stated| *stated != n_tools) {
            return Err(format!(
                "the line has {stated} tools, and the heading has columns of {n_tools}; repeat them in the heading for each tool, or keep one tool"
            ));
        }
        let (n, is_last_empty) = (cells.len(), cells.last().is_some_and(String::is_empty));
        let is_whole = n == self.n_columns || (is_last_empty && n == self.n_columns + 1);
        if n_tools > 1 && !is_whole {
            return Err(format!(
                "the line has {n} cells, and the heading {}, so that the second tool is not where the heading says; was the file cut \
                 short, or does the line have other markers?",
                self.n_columns
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        pose_log::{LogFormat, LogOptions, PoseLog, read_log},
        probe::{Kind, probe},
    };
    use nalgebra::Vector3;
    use osteoflow_geometry::StampNs;

    fn read(text: &str, rate_hz: Option<f64>) -> Result<PoseLog, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        assert_eq!(probe(file.path()).unwrap().kind, Kind::Poses(LogFormat::Ndi), "{text}");
        read_log(file.path(), &LogOptions { rate_hz, ..LogOptions::default() }).map_err(|error| error.to_string())
    }

    /// Name, stamp and x of each pose, or why it is lost.
    fn found(log: &PoseLog) -> Vec<(String, StampNs, Result<f64, String>)> {
        let words = |pose: &Result<osteoflow_geometry::Nearest<osteoflow_geometry::Pose>, crate::LostPose>| match pose {
            Ok(pose) => (pose.value.from.to_string(), pose.value.stamp_ns, Ok(pose.value.isometry.translation.x)),
            Err(lost) => (lost.from.to_string(), lost.stamp_ns, Err(lost.reason.clone())),
        };
        log.poses.iter().map(words).collect()
    }

    const TOOL: &str = "ToolInfo,Frame#,PortHandle,Face#,timespec_s,timespec_ns,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers,\
                        Marker0.Status,Tx,Ty,Tz";

    #[test]
    fn a_table_of_the_sample_program_has_its_tools_by_their_serial_numbers_and_stamps_of_two_columns() {
        let text = format!(
            "#Tools,{TOOL},{TOOL}\n\
             2,8700340 s/n:3A,7,Port:10,0,1700000000,123456789,Enabled,0.5,0.5,0.5,0.5,1.5,2,3,0.1,1,OK,90,91,92,\
             8700449 s/n:3B,9,Port:11,0,1700000000,173456789,Missing,,,,,,,,,1,Missing,,,\n\
             2,8700340 s/n:3A,8,Port:10,0,1700000000,223456789,PartiallyOutOfVolume,0.5,0.5,0.5,0.5,1.5,2,3,0.1,1,OK,90,91,92,\
             8700449 s/n:3B,9,Port:11,0,1700000000,273456789,OK,1,0,0,0,-4.5,2,3,0.1,1,OK,90,91,92\n"
        );
        let log = read(&text, None).unwrap();
        let ns = 1_700_000_000_000_000_000;
        let lost = |status: &str| Err(format!("the status {status}"));
        let (a, b) = ("8700340 s/n:3A".to_owned(), "8700449 s/n:3B".to_owned());
        assert_eq!(
            found(&log),
            [
                (a.clone(), ns + 123_456_789, Ok(1.5)),
                (b.clone(), ns + 173_456_789, lost("Missing")),
                (a, ns + 223_456_789, lost("PartiallyOutOfVolume")),
                (b, ns + 273_456_789, Ok(-4.5)),
            ]
        );
        // w first: x to y, y to z.
        let turn = log.poses[0].as_ref().unwrap().value.isometry.rotation;
        assert!((turn * Vector3::x() - Vector3::y()).norm() < 1e-12);
    }

    #[test]
    fn tables_without_times_count_frames_and_a_line_with_the_date_may_be_before_the_heading() {
        let track = "Date:=12:02:2010,10:11:12.5\nTools,Port 10,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,\
                     Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error\n\
                     2,Port 10,120,1,OK,1,0,0,0,1,2,3,0.1,Port 1,120,1,OK,1,0,0,0,4,5,6,0.1\n";
        let sample = "#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz\n\
                      1,A s/n:1,120,Port:1,0,Enabled,1,0,0,0,1,2,3,0.1,2,OK,7,8,9,OK,7,8,9\n";
        for (text, tools) in [(track, &[("Port 10", 1.0), ("Port 1", 4.0)][..]), (sample, &[("A s/n:1", 1.0)])] {
            assert!(read(text, None).unwrap_err().contains("give the rate of the tracker in Hz (rate_hz, --rate)"));
            let log = read(text, Some(60.0)).unwrap();
            let found = found(&log);
            let expected: Vec<_> = tools.iter().map(|(name, x)| ((*name).to_owned(), 2_000_000_000, Ok(*x))).collect();
            assert_eq!(found, expected);
        }
    }

    /// A table of Track with two ports, and lines of the names that they have there.
    fn track(rows: &[[&str; 2]]) -> String {
        let columns = "Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz";
        let mut text = format!("Tools,Port 10: Bone s/n:1,{columns},Port 11: Stylus s/n:2,{columns}\n");
        for (k, ports) in rows.iter().enumerate() {
            let tool = |port: &str, x: usize| format!("{port},{k},12.{k},0,OK,1,0,0,0,{x}.5,50,-900,0.1,1,OK,1,2,3");
            text += &format!("2,{},{}\n", tool(ports[0], 100 + k), tool(ports[1], 200 + k));
        }
        text
    }

    const BONE: &str = "Port 10: Bone s/n:1";
    const STYLUS: &str = "Port 11: Stylus s/n:2";

    #[test]
    fn a_line_that_names_another_port_than_the_heading_is_refused_and_given_to_no_tool() {
        let sound = read(&track(&[[BONE, STYLUS], ["Port 10", "port 11:  Stylus s/n:2 "]]), None).unwrap();
        assert_eq!(sound.poses.len(), 4, "the name of the tool may be left out");
        let as_heading = "where the heading has \"Port 10: Bone s/n:1\", so that its poses are not of that tool";
        for (ports, found) in [
            // Another port, the ports in another order, another tool on that port, one whose number begins alike, and none.
            (["Port 12: Camera s/n:3", STYLUS], "the line has \"Port 12: Camera s/n:3\""),
            ([STYLUS, BONE], "the line has \"Port 11: Stylus s/n:2\""),
            (["Port 10: Bone s/n:9", STYLUS], "the line has \"Port 10: Bone s/n:9\""),
            (["Port 1: Bone s/n:1", STYLUS], "the line has \"Port 1: Bone s/n:1\""),
            (["", STYLUS], "the line names no port"),
        ] {
            let error = read(&track(&[[BONE, STYLUS], ports, [BONE, STYLUS]]), None).unwrap_err();
            assert!(error.contains(&format!("line 3: {found} {as_heading}")), "{error}\n{found}");
        }
        // By columns that a user describes, too.
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), track(&[[BONE, STYLUS], [BONE, "Port 13: Stylus s/n:2"]])).unwrap();
        let columns = "time = \"Time [sec]\"\ntime_unit = \"s\"\nparent = \"tracker\"\n[[tools]]\nchild = \"stylus\"\nafter = \"Port 11\"\n\
                       translation = [\"Tx\", \"Ty\", \"Tz\"]\nquaternion = { w = \"Q0\", x = \"Qx\", y = \"Qy\", z = \"Qz\" }\n";
        let options = LogOptions { columns: Some(toml::from_str(columns).unwrap()), ..LogOptions::default() };
        let error = read_log(file.path(), &options).unwrap_err().to_string();
        assert!(error.contains("line 3: the line has \"Port 13: Stylus s/n:2\" where the heading has"), "{error}");
    }

    #[test]
    fn a_port_that_is_missing_or_appears_later_a_second_heading_and_a_cut_end_are_refused() {
        let sound = track(&[[BONE, STYLUS], [BONE, STYLUS]]);
        let first = sound.lines().nth(1).unwrap();
        let one = format!("1{}\n", &first[1..first.find(",Port 11").unwrap()]);
        let more = format!("3{},Port 12: Camera s/n:3,1,12.1,0,OK,1,0,0,0,1,2,3,0.1,1,OK,1,2,3\n", &first[1..]);
        let heading = sound.lines().next().unwrap().replace("Bone", "Saw");
        for (more, expected) in [
            (one.as_str(), "line 4: the line has 1 tools, and the heading has columns of 2"),
            (&more, "line 4: the line has 3 tools, and the heading has columns of 2"),
            (&heading, "line 4: the line has \"Port 10: Saw s/n:1\" where the heading has \"Port 10: Bone s/n:1\""),
        ] {
            let error = read(&format!("{sound}{more}"), None).unwrap_err();
            assert!(error.contains(expected), "{error}\n{expected}");
        }
        // A single tool, whose lines may have other markers: wherever it is cut, no number is taken for a shorter one.
        let single = "Tools,Port 10: Bone s/n:1,Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz\n\
                      1,Port 10: Bone s/n:1,1,12.5,0,OK,1,0,0,0,100,50,-1655.25,0.1,1,OK,1,2,3\n";
        let start = single.find("\n1,").unwrap() + 3;
        for end in start..single.find(",2,3\n").unwrap() {
            assert!(read(&single[..end], None).is_err(), "{}", &single[start..end]);
        }
        assert_eq!(
            found(&read(single.trim_end(), None).unwrap())[0].2,
            Ok(100.0),
            "only the end of the line is missing"
        );
    }

    #[test]
    fn a_line_whose_columns_are_not_those_of_the_heading_is_refused() {
        let two = format!("#Tools,{TOOL},{TOOL}\n");
        let tool = |name: &str| format!("{name},7,Port:10,0,1700000000,5,Enabled,1,0,0,0,1,2,3,0.1,1,OK,90,91,92");
        let more = tool("A").replace("1,OK,90,91,92", "2,OK,90,91,92,OK,90,91,92");
        for (text, expected) in [
            (
                format!("#Tools,{TOOL}\n2,{},{}\n", tool("A"), tool("B")),
                "line 2: the line has 2 tools, and the heading has columns of 1",
            ),
            (format!("{two}2,{more},{}\n", tool("B")), "line 2: the line has 45 cells, and the heading 41"),
            (format!("{two}2,{},B,7,Port:10\n", tool("A")), "line 2: the line has 24 cells, and the heading 41"),
        ] {
            let error = read(&text, None).unwrap_err();
            assert!(error.contains(expected), "{error}\n{expected}");
        }
    }
}
