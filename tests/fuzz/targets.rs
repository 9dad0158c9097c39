//! What is given hostile bytes: each target reads them as a file of a stranger, and may refuse them, but not panic.

#[cfg(unix)]
use super::border;
use osteoflow_engine::{Recording, check_text, recording::digest::digest, recover::recover, validate::validate};
use osteoflow_formats::{
    folder::ProcedureFolder,
    mcap_read,
    mesh_or_cloud::read_mesh_or_cloud,
    message_read::{self, CAMERA_CALIBRATION, COMPRESSED_IMAGE, Calibration, MessageKind, RAW_IMAGE},
    openigtlink, picked_points, plan_file, pose_file, pose_log, poses_csv, probe, region_file, volume,
};
use osteoflow_geometry::{Distortion, Intrinsics};
use osteoflow_node::Registry;
use std::{fs, path::Path, sync::LazyLock};

/// Made once: it takes longer than most readers.
pub(crate) static REGISTRY: LazyLock<Registry> = LazyLock::new(osteoflow_standard::registry);

/// A target: its name, the endings of the files that it reads, and the reader, which is given a file of that name.
pub(crate) struct Target {
    pub(crate) name: &'static str,
    /// Endings without the dot.
    pub(crate) endings: &'static [&'static str],
    /// Whether the file is taken.
    pub(crate) read: fn(&Path, &[u8]) -> bool,
}

pub(crate) const TARGETS: &[Target] = &[
    Target {
        name: "surface_or_cloud",
        endings: &["ply", "stl", "obj", "off", "vtk", "vtp", "pcd", "csv", "xyz"],
        read: surface_or_cloud,
    },
    Target {
        name: "picked_points",
        endings: &["json", "csv", "pp", "txt"],
        read: |path, bytes| picked_points::parse_picked_points(path, bytes).is_ok(),
    },
    Target { name: "plan", endings: &["json"], read: |path, _| plan_file::read_plan(path).is_ok() },
    Target { name: "pose", endings: &["txt", "json", "tfm"], read: |path, _| pose_file::read_pose(path, 1.0).is_ok() },
    Target { name: "poses", endings: &["csv"], read: |path, _| poses_csv::read_poses(path, 1.0).is_ok() },
    Target {
        name: "log",
        endings: &["tum", "csv", "txt", "mha", "nrrd"],
        read: |path, _| pose_log::read_log(path, &options_of_log()).is_ok(),
    },
    Target {
        name: "probe",
        endings: &["csv", "txt", "json", "ply", "vtk", "vtp", "dcm", "nii", "nrrd", "mha", "zip", "mcap", "toml"],
        read: |path, _| probe::probe(path).is_ok(),
    },
    Target { name: "archive", endings: &["zip"], read: |path, _| osteoflow::app::same(path, path).is_ok() },
    Target { name: "region", endings: &["json"], read: |path, _| region_file::read_region(path).is_ok() },
    Target {
        name: "volume",
        endings: &["nii", "nrrd", "dcm", "mha"],
        read: |path, _| volume::read_volume(path, None).is_ok(),
    },
    Target { name: "procedure", endings: &["toml"], read: |path, _| ProcedureFolder::open(path).is_ok() },
    Target { name: "openigtlink", endings: &["bin"], read: messages_of_openigtlink },
    Target { name: "recording", endings: &["mcap"], read: recording },
    Target { name: "message", endings: &["message"], read: |_, bytes| message(bytes).is_some() },
    Target { name: "graph", endings: &["toml"], read: graph },
    #[cfg(unix)]
    Target { name: "payload", endings: &["view"], read: border::payload },
    #[cfg(unix)]
    Target { name: "plugin_description", endings: &["description"], read: border::plugin_description },
    #[cfg(unix)]
    Target { name: "process", endings: &["sent"], read: border::process },
];

/// What logs without frames and stamps are read with.
fn options_of_log() -> pose_log::LogOptions {
    let (parent, child) = (Some("world".into()), Some("marker".into()));
    pose_log::LogOptions { parent, child, rate_hz: Some(100.0), ..pose_log::LogOptions::default() }
}

fn surface_or_cloud(path: &Path, bytes: &[u8]) -> bool {
    read_mesh_or_cloud(path, bytes, 1.0, "ct").is_ok()
}

/// The bytes as they are, and as one message whose size and CRC are right: otherwise no changed content would be read.
fn messages_of_openigtlink(_: &Path, bytes: &[u8]) -> bool {
    let mut repaired = bytes.to_vec();
    if let Some((header, body)) = repaired.split_at_mut_checked(openigtlink::HEADER_BYTES) {
        header[42..50].copy_from_slice(&(body.len() as u64).to_be_bytes());
        header[50..].copy_from_slice(&openigtlink::crc64(body).to_be_bytes());
    }
    [bytes, &repaired].map(|bytes| {
        let mut decoder = openigtlink::Decoder::default();
        bytes.chunks(1000).fold(false, |is_read, piece| {
            decoder.push(piece);
            decoder.by_ref().fold(is_read, |is_read, message| is_read | message.is_ok())
        })
    }) == [true, true]
}

/// The schemas of messages of other programs, with their encodings.
pub(crate) const MESSAGES: [(&str, &str); 18] = [
    ("foxglove.PointCloud", "protobuf"),
    ("foxglove.PointCloud", "json"),
    ("sensor_msgs/msg/PointCloud2", "cdr"),
    ("foxglove.FrameTransform", "protobuf"),
    ("foxglove.FrameTransform", "json"),
    ("geometry_msgs/msg/TransformStamped", "cdr"),
    ("foxglove.FrameTransforms", "protobuf"),
    ("foxglove.FrameTransforms", "json"),
    ("tf2_msgs/msg/TFMessage", "cdr"),
    ("foxglove.PoseInFrame", "protobuf"),
    ("foxglove.PoseInFrame", "json"),
    ("geometry_msgs/msg/PoseStamped", "cdr"),
    (RAW_IMAGE, "protobuf"),
    (COMPRESSED_IMAGE, "protobuf"),
    (CAMERA_CALIBRATION, "protobuf"),
    ("sensor_msgs/msg/Image", "cdr"),
    ("sensor_msgs/msg/CompressedImage", "cdr"),
    (CAMERA_INFO, "cdr"),
];

/// The schema of a camera's calibration of ROS 2.
const CAMERA_INFO: &str = "sensor_msgs/msg/CameraInfo";

/// The camera of the images among the seeds.
pub(crate) const IMAGE_SIZE: [u32; 2] = [16, 12];

/// A message within a recording of another program, without the file, whose CRCs keep changed content from its readers. The first
/// byte chooses schema and encoding.
fn message(bytes: &[u8]) -> Option<()> {
    let (first, data) = bytes.split_first()?;
    let (schema_name, message_encoding) = MESSAGES[usize::from(*first) % MESSAGES.len()];
    let message =
        || message_read::Encoded { schema_name, message_encoding, publish_time_ns: 1, data: data.to_vec().into() };
    let Some(kind) = MessageKind::of(schema_name) else {
        if [CAMERA_CALIBRATION, CAMERA_INFO].contains(&schema_name) {
            return message_read::read_calibration(message(), false).ok().map(drop);
        }
        let distortion = Distortion::named("plumb_bob", &[-0.2, 0.03, 0.001, 0.001]).unwrap();
        let intrinsics = Intrinsics { distortion, ..Intrinsics::pinhole(14.0, 14.0, 7.0, 5.0) };
        let camera = Calibration { frame: "camera".into(), size: IMAGE_SIZE, intrinsics };
        let _ = message_read::read_image_head(message());
        let _ = message_read::read_depth(message(), &camera, None);
        return message_read::read_image(message(), &camera).ok().map(drop);
    };
    match kind {
        MessageKind::Cloud => {
            let _ = message_read::read_cloud_head(message());
            message_read::read_cloud(message()).ok().map(drop)
        }
        MessageKind::Transform | MessageKind::Transforms => message_read::read_transforms(message()).ok().map(drop),
        MessageKind::Pose => message_read::read_pose_in_frame(message()).ok().map(drop),
    }
}

/// A recording as this program reads its own, and as it reads those of others.
fn recording(path: &Path, _: &[u8]) -> bool {
    let quiet = &mut |_, _| {};
    let _ = digest(path, quiet);
    let _ = validate(path, &*REGISTRY, quiet);
    let saved = path.with_extension("saved");
    let _ = fs::remove_file(&saved);
    let _ = recover(path, &saved, quiet);
    let mut is_read = false;
    if let Ok(recording) = Recording::open(path) {
        for wire in recording.wires.keys() {
            is_read |= recording.items(wire, &recording.registry(&REGISTRY)).is_ok();
        }
    }
    for allow_truncated in [false, true] {
        let Ok(recording) = mcap_read::Recording::open(path, allow_truncated) else { continue };
        for topic in recording.topics() {
            for message in recording.messages(&topic.name) {
                is_read |= message_read::read_cloud(message).is_ok();
                is_read |= message_read::read_transforms(message).is_ok();
                is_read |= message_read::read_pose_in_frame(message).is_ok();
            }
        }
    }
    is_read
}

fn graph(path: &Path, bytes: &[u8]) -> bool {
    check_text(&String::from_utf8_lossy(bytes), path, &[], &*REGISTRY).is_ok()
}

/// Reads the bytes as a file of the target with this ending, in this folder.
pub(crate) fn read_as(target: &Target, ending: &str, bytes: &[u8], folder: &Path) -> bool {
    let path = folder.join(format!("{}.{ending}", target.name));
    fs::write(&path, bytes).expect("the folder can be written");
    (target.read)(&path, bytes)
}
