//! The table of formats in docs/use/formats.md, each line of which is run: a file of the format is read, and written where it is.
//!
//! `UPDATE=1` rewrites the table.

mod one_answer;
mod volumes;

use crate::common::{osteoflow, root};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Before and behind the table.
const MARKS: [&str; 2] = ["<!-- formats -->\n", "<!-- end of formats -->\n"];

/// A line of the table.
struct Line {
    format: &'static str,
    /// Files of the format, and what `info` says that they are, or the words with which it refuses them.
    files: Vec<(PathBuf, Result<&'static str, &'static str>)>,
    /// The ending with which `convert` writes it, and what is converted.
    written: Option<(&'static str, PathBuf)>,
    /// Those whose files were read here, or who read those written here, as docs/clients.md names them.
    confirmed: &'static [&'static str],
}

/// Files of all formats.
struct Files {
    dir: tempfile::TempDir,
}

impl Files {
    /// A file of these bytes.
    fn of(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    /// A file made by `convert`.
    fn converted(&self, from: &Path, name: &str, more: &[&str]) -> PathBuf {
        let path = self.dir.path().join(name);
        if !path.exists() {
            let output = osteoflow().arg("convert").arg(from).arg(&path).args(more).output().unwrap();
            assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
        }
        path
    }

    fn points_and_surfaces(&self) -> Vec<Line> {
        let data = root().join("tests/data/folder");
        let (bone, scan) = (data.join("bone.stl"), data.join("scan.ply"));
        let (mesh, cloud) = (Ok("mesh"), Ok("cloud"));
        let ascii = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 40 0 0\nvertex 0 40 0\nendloop\nendfacet\nendsolid a\n";
        let off = "OFF\n3 1 0\n0 0 0\n40 0 0\n0 40 0\n3 0 1 2\n";
        let vtp = "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\">\
                   <Points><DataArray type=\"Float32\" format=\"ascii\">0 0 0 40 0 0 0 40 0</DataArray></Points>\
                   <Polys><DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">0 1 2</DataArray>\
                   <DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">3</DataArray></Polys></Piece></PolyData></VTKFile>";
        let read = |name: &str| self.converted(&bone, name, &[]);
        let surfaces = [
            Line {
                format: "PLY",
                files: vec![(scan.clone(), cloud), (read("bone.ply"), mesh)],
                written: Some((".ply", scan.clone())),
                confirmed: &[
                    "PCL",
                    "Open3D",
                    "CloudCompare",
                    "MeshLab (pymeshlab)",
                    "VTK",
                    "PyVista",
                    "trimesh",
                    "meshio",
                ],
            },
            Line {
                format: "STL",
                files: vec![
                    (bone.clone(), mesh),
                    (self.of("ascii.stl", ascii), mesh),
                    (self.of("bom.stl", format!("\u{feff}{ascii}")), mesh),
                ],
                written: Some((".stl", bone.clone())),
                confirmed: &["Open3D", "CloudCompare", "MeshLab (pymeshlab)", "VTK", "PyVista", "trimesh", "meshio"],
            },
            Line {
                format: "OBJ",
                files: vec![(read("bone.obj"), mesh)],
                written: Some((".obj", bone.clone())),
                confirmed: &["Open3D", "CloudCompare", "MeshLab (pymeshlab)", "VTK", "trimesh", "meshio"],
            },
            Line {
                format: "OFF",
                files: vec![(self.of("a.off", off), mesh)],
                written: None,
                confirmed: &["trimesh", "meshio"],
            },
            Line {
                format: "VTK legacy",
                files: vec![(self.converted(&scan, "scan.vtk", &[]), cloud)],
                written: Some((".vtk", scan.clone())),
                confirmed: &["VTK", "PyVista", "ParaView"],
            },
            Line {
                format: "VTK XML `.vtp`",
                files: vec![(self.of("a.vtp", vtp), mesh)],
                written: None,
                confirmed: &["VTK"],
            },
            Line {
                format: "PCD",
                files: vec![(self.converted(&scan, "scan.pcd", &[]), cloud)],
                written: Some((".pcd", scan.clone())),
                confirmed: &["PCL", "Open3D"],
            },
        ];
        let mut comma = String::new();
        let mut index = String::new();
        for k in 0..40 {
            comma += &format!("12,5{k};-7,25;103,1\n");
            index += &format!("{} 12.5{k} -7.25 103.1\n", k + 1);
        }
        let texts = [
            ("plain.xyz", "1.5 2 3\n4 5 6\n7 8 9\n".to_owned()),
            ("heading.csv", "x_mm,y_mm,z_mm\n1,2,3\n4,5,6\n".into()),
            ("comma.csv", comma),
            ("index.xyz", index),
            ("ras.txt", "# SPACE = RAS\n1 2 3\n4 5 6\n".into()),
        ];
        let texts = texts.map(|(name, text)| (self.of(name, text), cloud));
        let text = Line {
            format: "text (XYZ, ASC, PTS, CSV, TXT)",
            files: texts.into(),
            written: Some((".csv", scan)),
            confirmed: &["CloudCompare"],
        };
        surfaces.into_iter().chain([text]).collect()
    }

    fn picked_points(&self) -> Vec<Line> {
        let points = Ok("points");
        let csv = self.of("picked.csv", "# SPACE=LPS\nlabel,x,y,z\nP1,1,2,3\nP2,4,5,6\nP3,7,8,10\n");
        let pp = "<!DOCTYPE PickedPoints>\n<PickedPoints><point x=\"1\" y=\"2\" z=\"3\" active=\"1\" name=\"P1\"/></PickedPoints>\n";
        self.converted(&csv, "in_scene.mrk.json", &[]);
        let scene = "<MRML><MarkupsFiducial id=\"a\" name=\"F\" references=\"storage:b;\"/>\
                     <MarkupsJsonStorage id=\"b\" fileName=\"in_scene.mrk.json\"/></MRML>";
        let own = "name,frame,x_mm,y_mm,z_mm,stamp_ns\nP1,ct,10.5,-20.25,300.125,0\nP2,ct,-4.5,30.75,280.5,0\n";
        vec![
            Line {
                format: "3D Slicer markups `.mrk.json`",
                files: vec![(self.converted(&csv, "read.mrk.json", &[]), points)],
                written: Some((".mrk.json", csv.clone())),
                confirmed: &[],
            },
            Line {
                format: "3D Slicer scene `.mrb`, `.mrml`",
                files: vec![(self.of("scene.mrml", scene), points)],
                written: None,
                confirmed: &[],
            },
            Line {
                format: "3D Slicer fiducials `.fcsv`",
                files: vec![(self.converted(&csv, "read.fcsv", &[]), points)],
                written: Some((".fcsv", csv.clone())),
                confirmed: &[],
            },
            Line { format: "MeshLab `.pp`", files: vec![(self.of("a.pp", pp), points)], written: None, confirmed: &[] },
            Line {
                format: "CloudCompare's picking list",
                files: vec![(self.of("list.txt", "0,1,2,3\n1,4,5,6\n2,7,8,10\n"), points)],
                written: None,
                confirmed: &[],
            },
            Line {
                format: "CSV `label,x,y,z`",
                files: vec![(csv.clone(), points), (self.of("output.csv", own), points)],
                written: Some((".csv", csv)),
                confirmed: &[],
            },
        ]
    }

    fn poses(&self) -> Vec<Line> {
        let tfm = |body: &str| format!("#Insight Transform File V1.0\n#Transform 0\n{body}");
        let shift = "Transform: TranslationTransform_double_3_3\nParameters: 5 6 7\nFixedParameters: \n";
        let files = [
            (
                "composite.tfm",
                tfm(&format!("Transform: CompositeTransform_double_3_3\n#Transform 1\n{shift}#Transform 2\n{shift}")),
            ),
            ("identity.tfm", tfm("Transform: IdentityTransform_double_3_3\nParameters: \nFixedParameters: \n")),
        ];
        let files = files.map(|(name, text)| (self.of(name, text), Ok("pose"))).into();
        let matrix = [
            ("matrix.txt", "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n"),
            ("matrix.json", "{\"T\": [1,0,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,1]}"),
        ];
        vec![
            Line { format: "ITK transform `.tfm`", files, written: None, confirmed: &["SimpleITK"] },
            Line {
                format: "4 x 4 matrix, text or JSON",
                files: matrix.map(|(name, text)| (self.of(name, text), Ok("pose"))).into(),
                written: None,
                confirmed: &[],
            },
        ]
    }

    fn logs(&self) -> Vec<Line> {
        let poses = |file: PathBuf| vec![(file, Ok("poses"))];
        let frame = |k: usize| {
            let name = format!("Seq_Frame{k:04}_StylusToTrackerTransform");
            format!(
                "{name} = 1 0 0 {k} 0 1 0 0 0 0 1 0 0 0 0 1\n{name}Status = OK\nSeq_Frame{k:04}_Timestamp = {k}.5\n"
            )
        };
        let frames: String = (0..3).map(frame).collect();
        let sequence = format!("ObjectType = Image\nNDims = 3\nDimSize = 0 0 3\n{frames}ElementDataFile = LOCAL\n");
        let in_nrrd = format!("NRRD0004\nsizes: 0 0 3\n{}\n", frames.replace(" = ", ":="));
        let [sequence, in_nrrd] = [self.of("log.igs.mha", sequence), self.of("log.igs.nrrd", in_nrrd)];
        let tum: String = (0..5).map(|k| format!("{k}.5 0.1 0.2 0.3 0 0 0.6 0.8\n")).collect();
        let euroc = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n\
                     1403636579763555584,1,2,3,0.8,0,0,0.6\n";
        let kitti = "1 0 0 0.1 0 1 0 0.2 0 0 1 0.3\n1 0 0 0.1 0 1 0 0.2 0 0 1 0.4\n";
        let ndi = "Tools,Port 1: Probe,Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error\n1,Port 1,7,1.5,1,OK,1,0,0,0,1,2,3,0.1\n";
        let tool = "ToolInfo,Frame#,PortHandle,Face#,timespec_s,timespec_ns,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers";
        let sample = format!("#Tools,{tool}\n1,A s/n:1,7,Port:10,0,1700000000,5,Enabled,1,0,0,0,1,2,3,0.1,0\n");
        let motive = "Format Version,1.23,Rotation Type,Quaternion,Length Units,Meters\n,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n\
                      ,Name,A,A,A,A,A,A,A\n,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z\n0,0.5,0,0,0,1,1,2,3\n";
        let vicon =
            "Objects\n100\n,,A:A,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n1,0,0,0,0,1,1,2,3\n";
        let csv = "t_ns,parent,child,x,y,z,qx,qy,qz,qw\n10,world,marker,1,2,3,0,0,0,1\n20,world,marker,,,,,,,\n";
        vec![
            Line {
                format: "tracked sequence `.igs.mha`, `.igs.nrrd` of PLUS",
                files: vec![(sequence.clone(), Ok("poses")), (in_nrrd, Ok("poses"))],
                written: None,
                confirmed: &["SimpleITK"],
            },
            Line {
                format: "TUM trajectory",
                files: poses(self.of("a.tum", tum)),
                written: Some((".tum", sequence.clone())),
                confirmed: &["evo"],
            },
            Line {
                format: "EuRoC trajectory, CSV",
                files: poses(self.of("euroc.csv", euroc)),
                written: None,
                confirmed: &["evo"],
            },
            Line {
                format: "KITTI trajectory",
                files: poses(self.of("kitti.txt", kitti)),
                written: None,
                confirmed: &["evo"],
            },
            Line { format: "NDI Track, CSV", files: poses(self.of("ndi.csv", ndi)), written: None, confirmed: &[] },
            Line {
                format: "NDI, sample program of the Combined API, CSV",
                files: poses(self.of("sample.csv", sample)),
                written: None,
                confirmed: &[],
            },
            Line {
                format: "OptiTrack Motive, Vicon Tracker, CSV",
                files: vec![(self.of("motive.csv", motive), Ok("poses")), (self.of("vicon.csv", vicon), Ok("poses"))],
                written: None,
                confirmed: &[],
            },
            Line {
                format: "CSV `t_ns,parent,child,x,..`",
                files: poses(self.of("poses.csv", csv)),
                written: Some((".csv", sequence)),
                confirmed: &[],
            },
        ]
    }

    fn recordings(&self) -> Vec<Line> {
        let data = root().join("tests/data");
        let sqlite = self.of("bag.db3", b"SQLite format 3\0and more of it");
        let log = self.of("one.csv", "t_ns,parent,child,x,y,z,qx,qy,qz,qw\n10,world,marker,1,2,3,0,0,0,1\n");
        vec![
            Line {
                format: "MCAP of Foxglove's messages",
                files: vec![(data.join("procedure/procedure.mcap"), Ok("recording"))],
                written: Some((".mcap", log)),
                confirmed: &["mcap (Python)", "Rerun"],
            },
            Line {
                format: "ROS 2 bag in MCAP",
                files: vec![(data.join("ros2_bag"), Ok("recording"))],
                written: None,
                confirmed: &["rosbags", "evo"],
            },
            Line {
                format: "ROS 2 bag in SQLite `.db3`",
                files: vec![(sqlite, Err("rosbags-convert --src "))],
                written: None,
                confirmed: &["rosbags"],
            },
            Line {
                format: "ROS 1 `.bag`",
                files: vec![(
                    self.of("ros1.bag", b"#ROSBAG V2.0\nE\0\0\0\x10\0\0\0chunk_count="),
                    Err("rosbags-convert --src "),
                )],
                written: None,
                confirmed: &["rosbags"],
            },
        ]
    }

    fn lines(&self) -> Vec<Line> {
        [
            self.points_and_surfaces(),
            volumes::lines(),
            self.picked_points(),
            self.poses(),
            self.logs(),
            self.recordings(),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

/// What `info` says that a file is, or its refusal.
fn kind(file: &Path) -> Result<String, String> {
    let output = osteoflow().arg("info").arg(file).args(["--format", "json"]).output().unwrap();
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    Ok(found["kind"].as_str().unwrap().to_owned())
}

impl Line {
    /// Runs the line; its cells.
    fn run(&self, files: &Files) -> String {
        let mut kinds = Vec::new();
        for (file, expected) in &self.files {
            match (kind(file), expected) {
                (Ok(found), Ok(expected)) => assert_eq!(found, *expected, "{}", file.display()),
                (Err(refusal), Err(words)) => {
                    assert!(refusal.contains(words) && refusal.contains(&file.display().to_string()), "{refusal}")
                }
                (found, expected) => panic!("{}: {found:?} instead of {expected:?}", file.display()),
            }
            kinds.push(expected.unwrap_or("refused, with the command that converts it"));
        }
        kinds.sort_unstable();
        kinds.dedup();
        let written = self.written.as_ref().map(|(ending, from)| {
            let name: String = self.format.chars().filter(char::is_ascii_alphanumeric).collect();
            let made = files.converted(from, &format!("written-{name}{ending}"), &[]);
            let found = kind(&made).unwrap();
            assert!(kinds.contains(&found.as_str()), "{}: {found}", made.display());
            format!("`{ending}`")
        });
        let confirmed = if self.confirmed.is_empty() { "nobody yet".to_owned() } else { self.confirmed.join(", ") };
        format!("| {} | {} | {} | {confirmed} |\n", self.format, kinds.join(", "), written.unwrap_or_default())
    }
}

#[test]
fn each_line_of_the_table_of_formats_is_what_the_program_does() {
    let files = Files { dir: tempfile::tempdir().unwrap() };
    let lines = files.lines();
    let rows: String = lines.iter().map(|line| line.run(&files)).collect();
    let table = format!("| Format | Read as | Written | Confirmed by |\n|---|---|---|---|\n{rows}");
    let path = root().join("docs/use/formats.md");
    let page = fs::read_to_string(&path).unwrap();
    let (head, rest) = page.split_once(MARKS[0]).unwrap();
    let (kept, tail) = rest.split_once(MARKS[1]).unwrap();
    if std::env::var_os("UPDATE").is_some() {
        return fs::write(&path, [head, MARKS[0], "\n", &table, "\n", MARKS[1], tail].concat()).unwrap();
    }
    assert_eq!(kept.trim(), table.trim(), "docs/use/formats.md is stale: UPDATE=1 rewrites it");
    let clients = fs::read_to_string(root().join("docs/clients.md")).unwrap();
    for name in lines.iter().flat_map(|line| line.confirmed) {
        assert!(clients.contains(&format!("| {name} |")), "{name} has no row in docs/clients.md");
    }
}
