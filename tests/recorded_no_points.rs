//! Recorded procedures registered by the shape of the bone alone, beside those with three points.

use crate::common::{Ran, case::Case, is_slow_run, isometry};
use osteoflow_formats::mcap_read::{Message, Recording, Topic};
use osteoflow_formats::message_read::{read_cloud, read_transforms};
use osteoflow_formats::recording_write::{Stream, recording_bytes};
use osteoflow_geometry::{
    Cloud,
    nalgebra::{Point3, Vector3},
};
use serde_json::Value;
use std::path::Path;

const GRAPH: &str = "graphs/fibula_no_points.toml";

/// Distances of the origins of the planes of two results, mm.
fn planes_apart_mm(a: &Ran, b: &Ran) -> Vec<f64> {
    let origins = |ran: &Ran| -> Vec<Vector3<f64>> {
        let planes = ran.results["planes_at_scan"].as_array().unwrap();
        planes.iter().map(|plane| isometry(&plane["matrix"]).translation.vector).collect()
    };
    let (a, b) = (origins(a), origins(b));
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).map(|(a, b)| (a - b).norm()).collect()
}

#[test]
fn without_landmarks_the_planes_are_where_three_points_put_them() {
    for case in Case::all("without_landmarks_the_planes_are_where_three_points_put_them") {
        let with_points = case.run(&["--no-record"]);
        let ran = case.with_graph(GRAPH, &case.plan, &["--no-record"]);
        let recording = case.recording.display();
        assert_eq!(ran.code, 0, "{recording}: {}", ran.stderr);
        let verdict = &ran.results["verdict"];
        let apart_mm = planes_apart_mm(with_points, &ran);
        println!("{recording}: {}, planes {apart_mm:.4?} mm apart", verdict["answer"]);
        assert_ne!(verdict["answer"], "refused", "{recording}: {verdict}");
        assert_eq!(apart_mm.len(), 2, "two cuts are planned");
        assert!(apart_mm.iter().all(|mm| *mm < 0.3), "{recording}: {apart_mm:?} mm apart at the cuts");
    }
}

/// A recording with these points (camera) in place of the scan.
fn with_scan(recording: &Path, scan: &[Point3<f64>], into: &Path) {
    let read = Recording::open(recording, false).unwrap();
    let stream = |topic: &Topic| {
        let messages = read.messages(&topic.name);
        let cloud = |message: &Message| {
            let read = read_cloud(message).unwrap().cloud;
            let is_scan = topic.name == "/camera/scan";
            if is_scan { Cloud::new(read.frame, scan.to_vec()).unwrap().at(read.stamp_ns) } else { read }
        };
        let poses = |message: &Message| read_transforms(message).unwrap().into_iter().map(|pose| pose.unwrap().value);
        match topic.schema_name.as_str() {
            "foxglove.PointCloud" => Some(Stream::Clouds(messages.iter().map(cloud).collect())),
            "foxglove.FrameTransform" => Some(Stream::Transforms(messages.iter().flat_map(poses).collect())),
            _ => None,
        }
    };
    let streams: Vec<_> =
        read.topics().iter().filter_map(|topic| Some((topic.name.as_str(), stream(topic)?))).collect();
    std::fs::write(into, recording_bytes(&streams, &read.metadata, &[]).unwrap()).unwrap();
}

/// The points of the only cloud of a topic.
fn cloud_of(recording: &Path, topic: &str) -> Vec<Point3<f64>> {
    let read = Recording::open(recording, false).unwrap();
    read_cloud(&read.messages(topic)[0]).unwrap().cloud.points().to_vec()
}

/// What the camera may see instead of a bone, about the middle of the scan: the phantom, and of 100 mm along x a fold of a drape
/// and a tube as thick as a fibula.
fn other_scans(recording: &Path) -> [Vec<Point3<f64>>; 3] {
    let middle = |points: &[Point3<f64>]| points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let at = middle(&cloud_of(recording, "/camera/scan"));
    let phantom = cloud_of(recording, "/camera/calibration");
    let moved = at - middle(&phantom);
    let surface = |depth: &dyn Fn(f64, f64) -> f64| -> Vec<Point3<f64>> {
        let grid = (0..250).flat_map(|i| (0..40).map(move |j| (f64::from(i) * 0.4 - 50.0, f64::from(j) * 0.4 - 8.0)));
        grid.map(|(x, y)| Point3::from(at + Vector3::new(x, y, depth(x, y)))).collect()
    };
    [
        phantom.iter().map(|p| p + moved).collect(),
        surface(&|x, y| 3.0 * (x / 14.0).sin() + 0.1 * y * y),
        surface(&|_, y| 9.0 - (81.0 - y * y).sqrt()),
    ]
}

#[test]
fn without_landmarks_a_scan_without_the_bone_is_refused() {
    let n = if is_slow_run() { usize::MAX } else { 1 };
    for case in Case::all("without_landmarks_a_scan_without_the_bone_is_refused").into_iter().take(n) {
        let dir = tempfile::tempdir().unwrap();
        let recording = dir.path().join("no_bone.mcap");
        let answer = |scan: &[Point3<f64>]| {
            with_scan(&case.recording, scan, &recording);
            let case = Case { recording: recording.clone(), truth: Value::Null, ..case.clone() };
            let ran = case.with_graph(GRAPH, &case.plan, &["--no-record"]);
            let answer = ran.results["verdict"]["answer"].as_str().unwrap().to_owned();
            let withholds = ran.results.get("planes").is_none() && ran.results.get("poses").is_none();
            assert_eq!((ran.code == 3, withholds), (answer == "refused", answer == "refused"), "{}", ran.stderr);
            println!("{}: {answer}: {}", case.recording.display(), ran.results["verdict"]["sentence"]);
            answer
        };
        let name = case.recording.display();
        assert_eq!(answer(&cloud_of(&case.recording, "/camera/scan")), "trusted", "{name} written anew");
        let [phantom, drape, tube] = other_scans(&case.recording);
        assert_eq!(answer(&phantom), "refused", "{name}");
        // A tube differs from the shaft of a fibula by less than tissue may.
        assert_ne!(answer(&tube), "trusted", "{name}");
        if is_slow_run() {
            assert_eq!(answer(&drape), "refused", "{name}");
        }
    }
}
