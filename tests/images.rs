//! Colour images in recordings: the same landmarks as from the simulated camera, and images that do not fit are refused by name.

use crate::common::{Ran, is_slow_run, python::python_with, root, run, run_whole};
use foxglove::{
    Encode,
    messages::{CameraCalibration, RawImage, Timestamp},
};
use osteoflow_geometry::Image;
use osteoflow_simulation::{Procedure, ProcedureParams};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Points of the scan: fewer take less time.
const N_POINTS: usize = 8000;

/// Settings of a run.
fn settings() -> Vec<String> {
    ["--set", "bone.exact=true", "--set"]
        .map(String::from)
        .into_iter()
        .chain([format!("recording.camera.n_points={N_POINTS}")])
        .collect()
}

/// The images of graphs/variants/fibula_rgb_spot.toml.
fn images() -> Vec<Image> {
    let mut params = ProcedureParams::default();
    params.image.taken = true;
    params.camera.n_points = N_POINTS;
    Procedure::simulate(&params, 42).unwrap().images
}

fn bytes<M: Encode>(message: &M) -> Vec<u8> {
    let mut bytes = Vec::new();
    message.encode(&mut bytes).unwrap();
    bytes
}

/// A recording of the images, red and blue in the order of `encoding`, and of the calibration of their camera, `scale` times too
/// large.
fn record(path: &Path, images: &[Image], encoding: &str, scale: u32) {
    let mut writer = mcap::Writer::new(std::io::BufWriter::new(std::fs::File::create(path).unwrap())).unwrap();
    let mut channel = |topic: &str, schema: &str| {
        let schema = writer.add_schema(schema, "protobuf", &[]).unwrap();
        writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).unwrap()
    };
    let (raw, calibrated) =
        (channel("/camera/color", "foxglove.RawImage"), channel("/camera/info", "foxglove.CameraCalibration"));
    for image in images {
        let (seconds, rest) = (image.stamp_ns / 1_000_000_000, image.stamp_ns % 1_000_000_000);
        let timestamp = Some(Timestamp::new(seconds as u32, rest as u32));
        let mut data = image.pixels().to_vec();
        if encoding == "bgr8" {
            data.chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2));
        }
        let message = RawImage {
            timestamp,
            frame_id: "colour_optical_frame".into(),
            width: image.width(),
            height: image.height(),
            encoding: encoding.into(),
            step: image.width() * 3,
            data: data.into(),
        };
        let i = image.intrinsics();
        let times = f64::from(scale);
        let calibration = CameraCalibration {
            timestamp,
            frame_id: "colour_optical_frame".into(),
            width: image.width() * scale,
            height: image.height() * scale,
            distortion_model: String::new(),
            d: Vec::new(),
            k: vec![times * i.fx, 0.0, times * i.cx, 0.0, times * i.fy, times * i.cy, 0.0, 0.0, 1.0],
            r: Vec::new(),
            p: Vec::new(),
        };
        for (channel_id, data) in [(calibrated, bytes(&calibration)), (raw, bytes(&message))] {
            let time = image.stamp_ns as u64;
            let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
            writer.write_to_known_channel(&header, &data).unwrap();
        }
    }
    writer.finish().unwrap();
}

/// The procedure of the graph with the images of a recording.
fn run_recorded(dir: &Path, kind: &str) -> Ran {
    let graph = format!(
        r#"
extends = "{}"

[node.images]
kind = "{kind}"
path = "images.mcap"
frames = {{ colour_optical_frame = "camera" }}
out.image = {{ type = "geometry/Image", topic = "/camera/color", calibration = "/camera/info", labels = ["P1", "P2", "P3"], frame = "camera" }}

[node.hole]
in = {{ reference = "to_bone.cloud", cloud = "to_bone_laser.cloud", image = "images.image" }}
"#,
        root().join("graphs/variants/fibula_rgb_spot.toml").display()
    );
    let path = dir.join("graph.toml");
    std::fs::write(&path, graph).unwrap();
    run(path.to_str().unwrap(), &settings().iter().map(String::as_str).collect::<Vec<_>>())
}

#[test]
fn recorded_images_give_the_landmarks_of_the_simulated_ones_bit_for_bit() {
    let settings = settings();
    let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
    let simulated = run_whole("graphs/variants/fibula_rgb_spot.toml", &settings);
    let holes = &simulated.results["holes"];
    assert_eq!(holes.as_array().unwrap().len(), 3, "{holes}");
    let images = images();
    for encoding in ["rgb8", "bgr8"] {
        let dir = tempfile::tempdir().unwrap();
        record(&dir.path().join("images.mcap"), &images, encoding, 1);
        let recorded = run_recorded(dir.path(), "acquire.mcap");
        assert_eq!(&recorded.results["holes"], holes, "{encoding}: {}", recorded.stderr);
        assert_eq!(recorded.results["laser_points"], simulated.results["laser_points"], "{encoding}");
    }
}

/// The pictures as files whose names are their stamps.
fn write_ppm(dir: &Path, images: &[Image]) -> Vec<PathBuf> {
    let write = |image: &Image| {
        let path = dir.join(format!("{}.ppm", image.stamp_ns));
        let head = format!("P6 {} {} 255\n", image.width(), image.height());
        std::fs::write(&path, [head.as_bytes(), image.pixels()].concat()).unwrap();
        path
    };
    images.iter().map(write).collect()
}

#[test]
fn pictures_that_opencv_bends_give_the_landmarks_of_straight_ones() {
    let Some(python) = python_with("bent pictures", &["rosbags", "opencv-python-headless"], "rosbags, cv2") else {
        return;
    };
    let images = images();
    let i = *images[0].intrinsics();
    let settings = settings();
    let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
    let straight = run_whole("graphs/variants/fibula_rgb_spot.toml", &settings);
    let places = |ran: &Ran| -> Vec<[f64; 3]> {
        let points = ran.results["laser_points"].as_array().unwrap();
        let first = |p: &serde_json::Value| p.as_array().map_or_else(|| p.clone(), |list| list[0].clone());
        let at = |p: &serde_json::Value| [0, 1, 2].map(|c| first(p)["position_mm"][c].as_f64().unwrap());
        points.iter().map(at).collect()
    };
    let models = [
        ("rational_polynomial", &[0.52, -0.26, 0.0006, -0.0002, 0.015, 0.39, -0.024, 0.0144][..]),
        ("plumb_bob", &[-0.28, 0.09, 0.0011, -0.0007, -0.012]),
        ("equidistant", &[-0.0125, 0.0034, -0.0011, 0.0002]),
    ];
    // Each model's formula has known answers of its own (nodes/bone/geometry).
    for (model, d) in models.into_iter().take(if is_slow_run() { 3 } else { 1 }) {
        let dir = tempfile::tempdir().unwrap();
        let mut bend = std::process::Command::new(&python);
        bend.arg(root().join("tests/python/bend_images.py")).arg(dir.path().join("bag"));
        bend.args(write_ppm(dir.path(), &images)).arg("--k").args([i.fx, i.fy, i.cx, i.cy].map(|c| c.to_string()));
        bend.args(["--model", model, "--d"]).args(d.iter().map(|c| format!("{c}")));
        let output = bend.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        std::fs::rename(dir.path().join("bag/bag.mcap"), dir.path().join("images.mcap")).unwrap();
        let bent = run_recorded(dir.path(), "acquire.mcap");
        let (found, expected) = (places(&bent), places(&straight));
        assert_eq!((found.len(), expected.len()), (3, 3), "{model}: {}", bent.stderr);
        for (found, expected) in found.iter().zip(&expected) {
            let apart = (0..3).map(|c| (found[c] - expected[c]).powi(2)).sum::<f64>().sqrt();
            // A pixel is 0.23 mm; the picture was resampled and compressed.
            assert!(apart < 0.1, "{model}: {apart} mm");
        }
    }
}

#[test]
fn images_of_another_order_time_resolution_or_encoding_are_refused_with_the_reason() {
    let refused = |what: &str, images: &[Image], encoding: &str, scale: u32, expected: &str| {
        let dir = tempfile::tempdir().unwrap();
        record(&dir.path().join("images.mcap"), images, encoding, scale);
        let ran = run_recorded(dir.path(), "acquire.mcap");
        assert!(ran.code != 0 && ran.stderr.contains(expected), "{what}: {}\n{}", ran.code, ran.stderr);
        assert!(ran.results["laser_points"].as_array().is_none_or(|points| points.len() < 3), "{what}");
    };
    let all = images();
    refused(
        "twice the resolution",
        &all,
        "rgb8",
        2,
        "640 x 480 pixels, but its camera's calibration is for 1280 x 960",
    );
    refused("unknown encoding", &all, "yuv422", 1, "encoding \"yuv422\" is not read");
    // Red and blue exchanged by a writer that says nothing of it.
    let blue: Vec<Image> = all.iter().map(|image| repainted(image, |rgb| [rgb[2], rgb[1], rgb[0]])).collect();
    refused("BGR as RGB", &blue, "rgb8", 1, "is the image BGR?");
    let late: Vec<Image> = all.iter().map(|image| image.clone().at(image.stamp_ns + 4_000_000_000)).collect();
    refused("4 s late", &late, "rgb8", 1, "the image was taken 4.0 s before or after the scan");
    // The second image with the stamp of the first, and so on.
    let swapped: Vec<Image> = (0..3).map(|k| all[(k + 1) % 3].clone().at(all[k].stamp_ns)).collect();
    refused("exchanged", &swapped, "rgb8", 1, "is the image mirrored, of another scan or camera");
}

fn repainted(image: &Image, colour: impl Fn([u8; 3]) -> [u8; 3]) -> Image {
    let pixels: Vec<u8> = image.pixels().chunks_exact(3).flat_map(|p| colour([p[0], p[1], p[2]])).collect();
    let size = [image.width(), image.height()];
    Image::new(image.frame.clone(), size, 3, *image.intrinsics(), pixels).unwrap().at(image.stamp_ns)
}
