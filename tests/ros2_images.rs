//! Images and depth of ROS 2, written by rosbags and OpenCV: tests/python/ros2_images.py.

use crate::common::{python::python_with, root, run};
use osteoflow_formats::{
    mcap_read::{Message, Recording},
    message_read::{Calibration, read_calibration, read_cloud, read_depth, read_image},
};
use osteoflow_geometry::{Image, StampNs};
use std::{fs, path::Path};

const START_NS: StampNs = 1_750_000_000_000_000_000;
const WIDTH: usize = 16;
const HEIGHT: usize = 12;
/// Levels by which decoders of JPEG differ: they round the transform and blend halved colours in their own ways.
const JPEG_LEVELS: u8 = 4;

fn first<'a>(bag: &'a Recording, topic: &str) -> &'a Message {
    &bag.messages(topic)[0]
}

fn camera(bag: &Recording, topic: &str) -> Calibration {
    read_calibration(first(bag, topic), false).unwrap()
}

/// What `picture` of the script says.
fn expected(x: usize, y: usize) -> [u8; 3] {
    match (x, y) {
        (1..=4, 2..=4) => [230, 30, 20],
        (6..=9, 8..=10) => [20, 30, 230],
        _ => [40 + 10 * x as u8, 200 - 12 * y as u8, 60],
    }
}

fn off(image: &Image, colour: impl Fn([u8; 3]) -> [u8; 3]) -> u8 {
    assert_eq!((image.width() as usize, image.height() as usize, image.stamp_ns), (WIDTH, HEIGHT, START_NS));
    let pixels = (0..WIDTH * HEIGHT).map(|i| (i % WIDTH, i / WIDTH));
    let levels = pixels.flat_map(|(x, y)| {
        let (found, expected) = (image.rgb(x, y), colour(expected(x, y)));
        [0, 1, 2].map(|c| found[c].abs_diff(expected[c]))
    });
    levels.max().unwrap()
}

fn check(path: &Path) {
    let bag = Recording::open(path, false).unwrap();
    let pinhole = camera(&bag, "/pinhole/info");
    let read = |topic: &str| read_image(first(&bag, topic), &pinhole).unwrap();
    for topic in ["/rgb8", "/bgr8", "/rgba8", "/bgra8", "/png", "/png_of_rgb"] {
        assert_eq!(off(&read(topic), |rgb| rgb), 0, "{topic}");
    }
    for topic in ["/mono8", "/mono16"] {
        assert_eq!(off(&read(topic), |rgb| [rgb[1]; 3]), 0, "{topic}");
    }
    let (here, there) = (read("/jpeg"), read("/jpeg_by_opencv"));
    let apart = here.pixels().iter().zip(there.pixels()).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(apart <= JPEG_LEVELS, "{apart} levels from what OpenCV decodes");
    let middle_of_red = read("/jpeg").rgb(2, 3);
    assert!(middle_of_red[0] > 150 && middle_of_red[2] < 80, "{middle_of_red:?}");
    // At quality 95, across the borders of two patches.
    assert!(off(&read("/jpeg_of_grey"), |rgb| [rgb[1]; 3]) <= 12);

    // The points of OpenCV for the same depths, in double precision.
    for lens in ["pinhole", "brown", "rational", "fisheye"] {
        let camera = camera(&bag, &format!("/{lens}/info"));
        assert_eq!(camera.intrinsics.distortion.name().is_none(), lens == "pinhole");
        let of_opencv = read_cloud(first(&bag, &format!("/{lens}/points"))).unwrap().cloud;
        for (topic, tolerance_mm) in
            [("/depth16", 1e-6), ("/depth16_big", 1e-6), ("/depth32", 1e-3), ("/depth32_big", 1e-3)]
        {
            let cloud = read_depth(first(&bag, topic), &camera, None).unwrap().cloud;
            assert_eq!((cloud.len(), of_opencv.len()), (WIDTH * HEIGHT - 3, WIDTH * HEIGHT - 3), "{lens} {topic}");
            let apart = cloud.points().iter().zip(of_opencv.points()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            // Floats of metres are exact to 2e-5 mm; the rest is OpenCV's own iteration.
            assert!(apart < tolerance_mm, "{lens} {topic}: {apart} mm");
        }
    }
    let refused = |topic: &str| read_image(first(&bag, topic), &pinhole).unwrap_err().to_string();
    assert!(refused("/bayer").contains("encoding \"bayer_rggb8\" is not read"), "{}", refused("/bayer"));
    assert!(refused("/depth16").contains("a port of type = \"geometry/Cloud\""));
    let half = Calibration { size: [8, 6], ..pinhole.clone() };
    let error = read_image(first(&bag, "/rgb8"), &half).unwrap_err().to_string();
    assert!(error.contains("16 x 12 pixels, but its camera's calibration is for 8 x 6"), "{error}");
    let error = read_depth(first(&bag, "/depth16"), &half, None).unwrap_err().to_string();
    assert!(error.contains("16 x 12 pixels, but its camera's calibration is for 8 x 6"), "{error}");
    // K of the whole images, with half of their size.
    for (topic, part) in [
        ("/binned/info", "(binning 2 x 2)"),
        ("/part/info", "(roi 8 x 12 at 4, 0)"),
        ("/half/info", "its images have 8 x 6 pixels: its numbers are of images about 1.90 times as large"),
    ] {
        let error = read_calibration(first(&bag, topic), false).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    // Cut anywhere, a message is no image.
    for topic in ["/rgb8", "/jpeg", "/png", "/depth32"] {
        let whole = first(&bag, topic);
        for n in 0..whole.data.len() {
            let cut = Message { data: whole.data.slice(..n), ..whole.clone() };
            let is_read = read_image(&cut, &pinhole).is_ok() || read_depth(&cut, &pinhole, None).is_ok();
            assert!(!is_read, "{topic}: {n} of {} bytes", whole.data.len());
        }
    }
}

#[test]
fn images_and_depth_of_a_public_writer_are_read_as_opencv_sees_them() {
    check(&root().join("tests/data/ros2_images.mcap"));
    let Some(python) = python_with("fresh images of ROS 2", &["rosbags", "opencv-python-headless"], "rosbags, cv2")
    else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let script = root().join("tests/python/ros2_images.py");
    let output = std::process::Command::new(python).arg(script).arg(&bag).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    check(&bag);
}

#[test]
fn a_graph_takes_clouds_from_a_depth_image_and_says_what_a_calibration_lacks() {
    let dir = tempfile::tempdir().unwrap();
    let ran = |port: &str| {
        let graph = format!(
            "[graph]\nformat = 1\nname = \"depth\"\nframes = [\"camera\"]\n\n[node.recording]\nkind = \"acquire.mcap\"\npath = \"{}\"\n\
             out.scan = {{ {port} }}\n\n[node.keep]\nkind = \"output.ply\"\nin = {{ cloud = \"recording.scan\" }}\n",
            root().join("tests/data/ros2_images.mcap").display()
        );
        let path = dir.path().join("graph.toml");
        fs::write(&path, graph).unwrap();
        run(path.to_str().unwrap(), &[])
    };
    let cloud = |rest: &str| ran(&format!("type = \"geometry/Cloud\", topic = \"/depth16\", frame = \"camera\"{rest}"));
    let read = cloud(", calibration = \"/fisheye/info\"");
    assert_eq!(read.code, 0, "{}", read.stderr);
    for (rest, expected) in [
        (
            "",
            "images need calibration, the topic of their camera's foxglove.CameraCalibration or sensor_msgs/CameraInfo",
        ),
        (", calibration = \"/half/info\"", "its principal point is at 7.3, 5.9, but its images have 8 x 6 pixels"),
        (", calibration = \"/nothing\"", "the recording ros2_images.mcap has no messages on /nothing"),
        (
            ", calibration = \"/rgb8\"",
            "a camera's calibration is needed here, but the topic carries sensor_msgs/msg/Image",
        ),
    ] {
        let refused = cloud(rest);
        assert!(refused.code != 0 && refused.stderr.contains(expected), "{rest}: {}", refused.stderr);
    }
}
