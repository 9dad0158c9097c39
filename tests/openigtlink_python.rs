//! Messages exchanged with pyigtl, in both directions and both header versions.

use crate::common::python::python_with;
use osteoflow_formats::openigtlink::{
    Affine, Body, Cells, Decoder, Fiducial, Message, Metadata, PixelImage, PolyData, Position, Scalar, Status,
    TrackedTool,
};
use osteoflow_geometry::nalgebra::{Isometry3, Matrix4, Vector3};
use serde_json::{Value, json};
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    path::PathBuf,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

const STAMP: i64 = 1_750_000_011_250_000_000;

/// An interpreter with pyigtl; a note and `None` where it cannot be had.
fn pyigtl(test: &str) -> Option<PathBuf> {
    python_with(test, &["pyigtl"], "pyigtl")
}

/// A Python program, ended when dropped.
struct Program(Child);

impl Program {
    fn start(interpreter: &PathBuf, source: &str, port: u16) -> Self {
        let mut command = Command::new(interpreter);
        command.args(["-c", source, &port.to_string()]).stdin(Stdio::piped()).stdout(Stdio::piped());
        Self(command.spawn().unwrap())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

const SENDER: &str = r#"
import os, sys, time
import numpy as np
import pyigtl
from pyigtl.messages import PolyDataMessage, PositionMessage

server = pyigtl.OpenIGTLinkServer(port=int(sys.argv[1]))
while not server.is_connected():
    time.sleep(0.01)
matrix = np.array([[0, -1, 0, 10.5], [1, 0, 0, -20.25], [0, 0, 1, 1000.125], [0, 0, 0, 1]])
stamp = 1750000011.25
for version in (1, 2):
    for message in (
        pyigtl.TransformMessage(matrix, timestamp=stamp, device_name="StylusToReference"),
        pyigtl.StringMessage("hello", timestamp=stamp, device_name="Note"),
        pyigtl.PointMessage([[1, 2, 3], [4, 5, 6.5]], names=["P1", "P2"], timestamp=stamp, device_name="Points"),
        PositionMessage([7, 8, 9], [0.0, 0.0, 1.0, 0.0], names=["Q"], timestamp=stamp, device_name="Position"),
        PolyDataMessage(points=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]), polygons=np.array([3, 0, 1, 2]),
                        timestamp=stamp, device_name="Mesh"),
        pyigtl.ImageMessage(0.5 * np.arange(36, dtype=np.float32).reshape(1, 3, 4, 3), timestamp=stamp, device_name="Image"),
    ):
        message.header_version = version
        if version == 2:
            message.metadata = {"TransformStatus": "OK", "key": "value"}
        server.send_message(message, wait=True)
sys.stdin.read()
os._exit(0)
"#;

#[test]
fn messages_of_pyigtl_are_read_in_both_header_versions() {
    let Some(interpreter) = pyigtl("messages_of_pyigtl_are_read") else { return };
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let _sender = Program::start(&interpreter, SENDER, port);
    let until = Instant::now() + Duration::from_secs(60);
    let mut stream = loop {
        match TcpStream::connect(("127.0.0.1", port)) {
            Ok(stream) => break stream,
            Err(error) => assert!(Instant::now() < until, "{error}"),
        }
        thread::sleep(Duration::from_millis(20));
    };
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let (mut decoder, mut found, mut buffer) = (Decoder::default(), Vec::new(), [0; 4096]);
    while found.len() < 12 {
        let n = stream.read(&mut buffer).unwrap();
        assert!(n > 0, "it closed after {found:?}");
        decoder.push(&buffer[..n]);
        found.extend(decoder.by_ref().map(Result::unwrap));
    }
    let matrix = Matrix4::new(0.0, -1.0, 0.0, 10.5, 1.0, 0.0, 0.0, -20.25, 0.0, 0.0, 1.0, 1000.125, 0.0, 0.0, 0.0, 1.0);
    let points = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]];
    for (version, found) in [(1, &found[..6]), (2, &found[6..])] {
        let devices: Vec<_> = found.iter().map(|message| message.device.as_str()).collect();
        assert_eq!(devices, ["StylusToReference", "Note", "Points", "Position", "Mesh", "Image"]);
        for message in found {
            assert_eq!(message.stamp_ns, STAMP, "{message:?}");
            let expected = if version == 2 { Some("OK") } else { None };
            assert_eq!(message.metadata("TransformStatus"), expected, "header version {version}");
        }
        let Body::Transform(affine) = &found[0].body else { panic!("{:?}", found[0]) };
        assert_eq!(affine.matrix(), matrix, "columns, not rows");
        assert_eq!(found[1].body, Body::Text("hello".into()));
        let Body::Points(fiducials) = &found[2].body else { panic!("{:?}", found[2]) };
        let named: Vec<_> = fiducials.iter().map(|point| (point.name.as_str(), point.position)).collect();
        assert_eq!(named, [("P1", [1.0, 2.0, 3.0]), ("P2", [4.0, 5.0, 6.5])]);
        let quaternion = Some([0.0, 0.0, 1.0, 0.0]);
        let position = Position { name: "Q".into(), position: [7.0, 8.0, 9.0], quaternion };
        assert_eq!(found[3].body, Body::Positions(vec![position]), "a list, which only pyigtl sends");
        let mesh = PolyData { points: points.clone(), polygons: Cells::new([[0, 1, 2]]), ..PolyData::default() };
        assert_eq!(found[4].body, Body::PolyData(mesh));
        let Body::Image(image) = &found[5].body else { panic!("{:?}", found[5]) };
        assert_eq!((image.form().as_str(), image.is_whole()), ("4 x 3 pixels of 3 float32", true));
        assert_eq!(image.values(), (0..36).map(|k| 0.5 * f64::from(k)).collect::<Vec<_>>());
        // Its matrix is the identity at the first pixel; the protocol sends the centre.
        assert_eq!(image.t_space_index(), Matrix4::identity());
    }
}

const RECEIVER: &str = r#"
import json, os, sys, time
import pyigtl

client = pyigtl.OpenIGTLinkClient(port=int(sys.argv[1]))
for version in (1, 2):
    for device in ("StylusToReference", "Note", "Points", "Position", "Scan", "Last"):
        m = client.wait_for_message(device + str(version), timeout=20)
        out = {"device": m.device_name, "version": m.header_version, "stamp": m.timestamp, "type": m.message_type,
               "metadata": m.metadata}
        if m.message_type == "TRANSFORM":
            out["value"] = m.matrix.tolist()
        elif m.message_type == "STRING":
            out["value"] = m.string
        elif m.message_type == "POINT":
            out["value"] = [[n, list(p)] for n, p in zip(m.names, m.positions)]
        elif m.message_type == "POSITION":
            out["value"] = m.positions
        elif m.message_type == "IMAGE":
            out["value"] = [str(m.image.dtype), list(m.image.shape), m.image.ravel().tolist(), m.ijk_to_world_matrix.tolist()]
        print(json.dumps(out), flush=True)
os._exit(0)
"#;

#[test]
fn pyigtl_reads_what_is_written_in_both_header_versions() {
    let Some(interpreter) = pyigtl("pyigtl_reads_what_is_written") else { return };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut receiver = Program::start(&interpreter, RECEIVER, listener.local_addr().unwrap().port());
    let (mut stream, _) = listener.accept().unwrap();
    let pose = Isometry3::new(Vector3::new(10.5, -20.25, 1000.125), Vector3::new(0.3, -0.2, 0.9));
    let position = Position { name: String::new(), position: [1.0, 2.0, 3.0], quaternion: Some([0.0, 0.0, 0.0, 1.0]) };
    let tool = TrackedTool { name: "Probe".into(), kind: 2, matrix: Affine::of(&pose) };
    let bodies = [
        ("StylusToReference", Body::Transform(Affine::of(&pose))),
        // Types that pyigtl skips must not put it out of step.
        ("Status", Body::Status(Status::new(Status::OK, "OK", "fine"))),
        ("Tools", Body::Tracking(vec![tool])),
        ("Mesh", Body::PolyData(PolyData::of_points(vec![[1.0, 2.0, 3.0]]))),
        ("Note", Body::Text("hello".into())),
        ("Points", Body::Points(vec![Fiducial::new("P1", [1.0, 2.0, 3.5])])),
        ("Position", Body::Positions(vec![position])),
        ("Scan", Body::Image(PixelImage::new([3, 2], 1, Scalar::U16, (0..12).collect()))),
        ("Last", Body::Text("end".into())),
    ];
    for version in [1, 2] {
        for (device, body) in &bodies {
            let mut message = Message::new(format!("{device}{version}"), STAMP, body.clone());
            if version == 2 {
                message = message.extended(7, vec![Metadata::new("TransformStatus", "OK")]);
            }
            stream.write_all(&message.to_bytes().unwrap()).unwrap();
        }
    }
    let stdout = BufReader::new(receiver.0.stdout.take().unwrap());
    let read: Vec<Value> = stdout.lines().map(|line| serde_json::from_str(&line.unwrap()).unwrap()).collect();
    assert_eq!(read.len(), 12, "{read:#?}");
    for (version, read) in [(1, &read[..6]), (2, &read[6..])] {
        for message in read {
            assert_eq!((&message["version"], &message["stamp"]), (&json!(version), &json!(1_750_000_011.25)));
            let metadata = if version == 2 { json!({ "TransformStatus": "OK" }) } else { json!({}) };
            assert_eq!(message["metadata"], metadata);
        }
        let matrix = pose.to_homogeneous();
        for (row, column) in (0..4).flat_map(|row| (0..4).map(move |column| (row, column))) {
            let found = read[0]["value"][row][column].as_f64().unwrap();
            assert!((found - matrix[(row, column)]).abs() < 1e-4, "{row}, {column}: {found}");
        }
        assert_eq!(read[1]["value"], "hello");
        assert_eq!(read[2]["value"], json!([["P1", [1.0, 2.0, 3.5]]]));
        // pyigtl expects lists of 152 bytes each, so it finds none in the 28 bytes of the specification.
        assert_eq!(read[3]["value"], json!([]));
        let depths: Vec<u16> = (0..6).map(|k| u16::from_le_bytes([2 * k, 2 * k + 1])).collect();
        let matrix: Vec<Vec<f64>> = (0..4).map(|row| (0..4).map(|k| f64::from(u8::from(row == k))).collect()).collect();
        assert_eq!(read[4]["value"], json!(["uint16", [1, 2, 3], depths, matrix]));
        assert_eq!(read[5]["value"], "end");
    }
}
