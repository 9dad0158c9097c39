//! Damaged recordings give an error with the place of the damage, or the intact part on request. They never cause a
//! panic or an absurd allocation.
// The counting allocator needs unsafe code.
#![allow(clippy::unwrap_used, unsafe_code)]

mod layouts;

use layouts::{Compression, Encoding, Layout, recording_bytes};
use nalgebra::Point3;
use osteoflow_container::Cause;
use osteoflow_formats::{
    mcap_read::{McapError, Recording},
    message_read::{procedure_region, read_cloud, read_cloud_head, read_pose_in_frame, read_transforms},
    recording_write::Stream,
};
use osteoflow_formats::{mesh_or_cloud, plan_file, poses_csv};
use osteoflow_geometry::Cloud;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::{
    alloc::{GlobalAlloc, Layout as Memory, System},
    collections::BTreeMap,
    sync::atomic::{AtomicUsize, Ordering},
};

/// Allocator that records the size of the largest allocation.
struct Watched;

static LARGEST: AtomicUsize = AtomicUsize::new(0);

unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, memory: Memory) -> *mut u8 {
        LARGEST.fetch_max(memory.size(), Ordering::Relaxed);
        unsafe { System.alloc(memory) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, memory: Memory) {
        unsafe { System.dealloc(pointer, memory) }
    }

    unsafe fn alloc_zeroed(&self, memory: Memory) -> *mut u8 {
        LARGEST.fetch_max(memory.size(), Ordering::Relaxed);
        unsafe { System.alloc_zeroed(memory) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, memory: Memory, size: usize) -> *mut u8 {
        LARGEST.fetch_max(size, Ordering::Relaxed);
        unsafe { System.realloc(pointer, memory, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

fn recording(layout: &Layout) -> Vec<u8> {
    let cloud = |k: i64| {
        let points: Vec<_> = (0..20).map(|i| Point3::new(f64::from(i), k as f64, 200.0)).collect();
        Cloud::new("camera", points).unwrap().at(1_750_000_000_000_000_000 + k)
    };
    let tips =
        (0..6).map(|k| ("world".into(), 1_750_000_001_000_000_000 + k, Point3::new(k as f64, 0.0, 0.0))).collect();
    let streams = [("/scan", Stream::Clouds((0..6).map(cloud).collect())), ("/stylus", Stream::Tips(tips))];
    let roi = [("roi_camera_min_m", "0 0 0"), ("roi_camera_max_m", "1 1 1")];
    let metadata = [("procedure".into(), roi.map(|(k, v)| (k.to_owned(), v.to_owned())).into())].into();
    recording_bytes(&streams, &metadata, &[], layout)
}

fn small_chunks(compression: Compression) -> Layout {
    Layout { compression, chunk_bytes: Some(400), ..Layout::default() }
}

/// Opcode, start and end of each record of the file.
fn records(bytes: &[u8]) -> Vec<(u8, usize, usize)> {
    let mut at = 8;
    let mut findings = Vec::new();
    while at + 9 <= bytes.len() - 8 {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        findings.push((bytes[at], at, at + 9 + length));
        at += 9 + length;
    }
    findings
}

fn chunks(bytes: &[u8]) -> Vec<(usize, usize)> {
    records(bytes).into_iter().filter(|r| r.0 == 6).map(|r| (r.1, r.2)).collect()
}

fn cause(error: &McapError) -> Option<&Cause> {
    match error {
        McapError::Damaged { damage, .. } => Some(&damage.cause),
        _ => None,
    }
}

fn n_messages(recording: &Recording) -> usize {
    recording.topics().iter().map(|t| t.n_messages).sum()
}

#[test]
fn an_empty_file_is_named_as_such() {
    let error = Recording::from_bytes("a.mcap", &[], true).unwrap_err();
    assert!(error.to_string().starts_with("a.mcap: the file is empty"), "{error}");
}

#[test]
fn another_kind_of_file_is_named_as_such() {
    let error = Recording::from_bytes("a.mcap", b"#ROSBAG V2.0\n", true).unwrap_err();
    let begins = "a.mcap: byte 0: a ROS 1 bag is not read; convert it with `rosbags-convert --src a.mcap";
    assert!(error.to_string().starts_with(begins), "{error}");
    let error = Recording::from_bytes("a.mcap", b"\x89MCA", false).unwrap_err();
    assert!(error.to_string().contains("cut short in its first bytes"), "{error}");
}

#[test]
fn a_cut_at_any_byte_is_an_error_with_its_place_and_gives_the_whole_chunks_before_it_on_request() {
    let bytes = recording(&small_chunks(Compression::Zstd));
    let whole = chunks(&bytes);
    let last_chunk = whole.last().unwrap().1;
    let all = n_messages(&Recording::from_bytes("whole", &bytes, false).unwrap());
    let mut n_before = 0;
    for cut in 8..bytes.len() {
        let error = Recording::from_bytes("cut", &bytes[..cut], false).unwrap_err();
        assert!(matches!(error, McapError::Truncated { .. }), "cut at {cut}: {error}");
        let part = Recording::from_bytes("cut", &bytes[..cut], true).unwrap();
        assert_eq!(part.notes.len(), 1, "cut at {cut}: {:?}", part.notes);
        let n = n_messages(&part);
        assert!(n >= n_before, "cut at {cut}: fewer messages than before");
        assert!(cut < last_chunk || n == all, "cut at {cut}: {n} of {all} messages, although all chunks are whole");
        n_before = n;
    }
    let refusal = Recording::from_bytes("cut", &bytes[..whole[1].0 + 20], false).unwrap_err().to_string();
    let place = format!("cut: byte {}: the file ends inside chunk", whole[1].0);
    assert!(refusal.starts_with(&place) && refusal.contains("allow_truncated = true"), "{refusal}");
}

#[test]
fn a_changed_byte_in_a_chunk_is_found_and_that_chunk_alone_left_out_on_request() {
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let mut bytes = recording(&small_chunks(compression));
        let all = n_messages(&Recording::from_bytes("whole", &bytes, false).unwrap());
        let (start, end) = chunks(&bytes)[1];
        // A byte in the middle of the compressed records.
        bytes[(start + end) / 2 + 20] ^= 0x10;
        let error = Recording::from_bytes("flipped", &bytes, false).unwrap_err();
        let named = matches!(cause(&error), Some(Cause::Crc { .. } | Cause::Compression { .. }));
        assert!(named, "{compression:?}: {error}");
        assert!(error.to_string().starts_with(&format!("flipped: byte {start}: ")), "{error}");
        let part = Recording::from_bytes("flipped", &bytes, true).unwrap();
        let n = n_messages(&part);
        assert!(0 < n && n < all, "{compression:?}: {n} of {all}");
        assert!(part.notes.iter().any(|note| note.contains(&format!("byte {start}"))), "{:?}", part.notes);
    }
}

#[test]
fn a_changed_byte_outside_chunks_is_found_by_the_crc_of_its_section() {
    let layout = Layout { chunk_bytes: None, compression: Compression::None, ..Layout::default() };
    let bytes = recording(&layout);
    let message = records(&bytes).into_iter().find(|r| r.0 == 5).unwrap();
    let mut changed = bytes.clone();
    changed[message.2 - 3] ^= 1;
    let error = Recording::from_bytes("data", &changed, false).unwrap_err();
    assert!(matches!(cause(&error), Some(Cause::Crc { what: "the data section", .. })), "{error}");
    let statistics = records(&bytes).into_iter().find(|r| r.0 == 11).unwrap();
    let mut changed = bytes.clone();
    changed[statistics.2 - 1] ^= 1;
    let error = Recording::from_bytes("summary", &changed, false).unwrap_err();
    assert!(matches!(cause(&error), Some(Cause::Crc { what: "the summary", .. })), "{error}");
    assert_eq!(n_messages(&Recording::from_bytes("summary", &changed, true).unwrap()), 12);
}

#[test]
fn a_length_that_cannot_be_true_is_named_and_costs_no_memory() {
    let bytes = recording(&small_chunks(Compression::Zstd));
    let (start, _) = chunks(&bytes)[0];
    let mut record = bytes.clone();
    record[start + 1..start + 9].copy_from_slice(&(1_u64 << 60).to_le_bytes());
    let error = Recording::from_bytes("record", &record, false).unwrap_err();
    assert!(matches!(cause(&error), Some(Cause::Length { what: "chunk", .. })), "{error}");
    let mut unpacked = bytes.clone();
    unpacked[start + 25..start + 33].copy_from_slice(&(1_u64 << 50).to_le_bytes());
    let error = Recording::from_bytes("unpacked", &unpacked, false).unwrap_err();
    assert!(matches!(cause(&error), Some(Cause::Length { what: "the unpacked chunk", .. })), "{error}");
    let mut larger = bytes;
    larger[start + 25..start + 33].copy_from_slice(&(1_u64 << 29).to_le_bytes());
    let error = Recording::from_bytes("larger", &larger, false).unwrap_err();
    assert!(error.to_string().contains("fewer than the 536870912 bytes it claims"), "{error}");
}

/// A recording written by the `mcap` crate, as other programs do: twelve messages on two topics, and an attachment.
fn foreign(compression: Option<mcap::Compression>, chunks: bool, summary: bool) -> Vec<u8> {
    let options = mcap::WriteOptions::new()
        .compression(compression)
        .compression_threads(0)
        .use_chunks(chunks)
        .chunk_size(chunks.then_some(400))
        .emit_message_indexes(summary)
        .emit_summary_records(summary)
        .emit_summary_offsets(summary);
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema("their/Type", "ros2msg", b"uint8[] data").unwrap();
    let channels = ["/a", "/b"].map(|topic| writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap());
    for i in 0..N_FOREIGN {
        let time = u64::from(i) + 1;
        let header = mcap::records::MessageHeader {
            channel_id: channels[i as usize % 2],
            sequence: i,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, &foreign_data(i)).unwrap();
    }
    let attachment = mcap::Attachment {
        log_time: 1,
        create_time: 1,
        name: "notes.txt".into(),
        media_type: "text/plain".into(),
        data: b"as they were".into(),
    };
    writer.attach(&attachment).unwrap();
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

const N_FOREIGN: u32 = 12;

fn foreign_data(i: u32) -> Vec<u8> {
    (0..150 + i).map(|k| (k.wrapping_mul(k + i) >> 3) as u8).collect()
}

/// Sorted numbers of the messages of both topics; asserts that each has its data.
fn foreign_numbers(recording: &Recording) -> Vec<u32> {
    let mut numbers = Vec::new();
    for (topic, k) in [("/a", 0), ("/b", 1)] {
        for message in recording.messages(topic) {
            assert_eq!((message.sequence % 2, &*message.data), (k, &*foreign_data(message.sequence)), "{topic}");
            assert_eq!((&*message.schema_name, &*message.message_encoding), ("their/Type", "cdr"));
            numbers.push(message.sequence);
        }
    }
    numbers.sort_unstable();
    numbers
}

const COMPRESSIONS: [Option<mcap::Compression>; 3] =
    [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)];

#[test]
fn recordings_of_other_programs_are_read_in_every_layout() {
    for compression in COMPRESSIONS {
        for (chunks, summary) in [(true, true), (true, false), (false, true), (false, false)] {
            let what = format!("{compression:?}, chunks {chunks}, summary {summary}");
            let recording = Recording::from_bytes("foreign", &foreign(compression, chunks, summary), false).unwrap();
            assert_eq!(recording.notes, [""; 0], "{what}");
            assert_eq!(foreign_numbers(&recording), Vec::from_iter(0..N_FOREIGN), "{what}");
            assert_eq!(recording.attachment("notes.txt").unwrap().data, b"as they were".as_slice(), "{what}");
        }
    }
}

#[test]
fn messages_behind_a_damaged_record_length_are_read_and_the_damage_is_noted_with_its_place() {
    for compression in COMPRESSIONS {
        for chunks in [true, false] {
            let bytes = foreign(compression, chunks, true);
            let opcode = if chunks { 6 } else { 5 };
            let of_kind: Vec<_> = records(&bytes).into_iter().filter(|r| r.0 == opcode).collect();
            let (_, start, _) = of_kind[of_kind.len() / 2];
            let what = format!("{compression:?}, chunks {chunks}");
            let mut damaged = bytes.clone();
            // The length becomes about a terabyte.
            damaged[start + 6] = 1;
            let error = Recording::from_bytes("damaged", &damaged, false).unwrap_err();
            assert!(matches!(cause(&error), Some(Cause::Length { .. } | Cause::Malformed { .. })), "{what}: {error}");
            let part = Recording::from_bytes("damaged", &damaged, true).unwrap();
            let numbers = foreign_numbers(&part);
            assert!((8..N_FOREIGN as usize).contains(&numbers.len()), "{what}: {numbers:?}");
            assert!(numbers.contains(&0) && numbers.contains(&(N_FOREIGN - 1)), "{what}: {numbers:?}");
            assert!(part.attachment("notes.txt").is_some(), "{what}");
            let places = part.notes.iter().filter_map(|note| note.strip_prefix("damaged: byte ")?.split(':').next());
            let mut places = places.map(|place| place.parse::<usize>().unwrap());
            assert!(places.any(|place| place.abs_diff(start) <= 200), "{what}: {start}: {:?}", part.notes);
        }
    }
}

#[test]
fn a_summary_that_counts_otherwise_is_noted() {
    let mut bytes = foreign(None, true, true);
    let statistics = records(&bytes).into_iter().find(|r| r.0 == 11).unwrap();
    // Changes the counts of both channels but not their sum, and removes the CRC of the summary.
    let counts = statistics.2 - 20;
    for (at, n) in [(counts + 2, 5_u64), (counts + 12, 7)] {
        bytes[at..at + 8].copy_from_slice(&n.to_le_bytes());
    }
    let footer = records(&bytes).into_iter().find(|r| r.0 == 2).unwrap();
    bytes[footer.2 - 4..footer.2].fill(0);
    let recording = Recording::from_bytes("counts", &bytes, false).unwrap();
    assert_eq!(foreign_numbers(&recording).len(), N_FOREIGN as usize);
    let expected = "the summary counts 5 messages of \"/a\", but 6 could be read";
    assert!(recording.notes.iter().any(|note| note == expected), "{:?}", recording.notes);
}

#[test]
fn an_unknown_compression_is_named() {
    let mut bytes = recording(&small_chunks(Compression::Zstd));
    let (start, _) = chunks(&bytes)[0];
    let name = bytes[start..].windows(4).position(|w| w == b"zstd").unwrap() + start;
    bytes[name..name + 4].copy_from_slice(b"bzip");
    let error = Recording::from_bytes("a", &bytes, false).unwrap_err();
    assert!(error.to_string().contains("\"bzip\" data cannot be unpacked"), "{error}");
}

#[test]
fn a_message_without_its_channel_is_named() {
    let layout = Layout { chunk_bytes: None, index: false, ..Layout::default() };
    let bytes = recording(&layout);
    let channel = records(&bytes).into_iter().find(|r| r.0 == 4).unwrap();
    let mut without = bytes[..channel.1].to_vec();
    without.extend(&bytes[channel.2..]);
    // The CRC of the data section no longer matches, so it is set to zero, which means none.
    let end = records(&without).into_iter().find(|r| r.0 == 15).unwrap();
    without[end.2 - 4..end.2].fill(0);
    let error = Recording::from_bytes("a", &without, false).unwrap_err();
    assert!(error.to_string().contains("which the file does not describe"), "{error}");
    let part = Recording::from_bytes("a", &without, true).unwrap();
    assert!(part.notes.iter().any(|note| note.starts_with("6 messages were left out")), "{:?}", part.notes);
    assert_eq!(part.messages("/stylus").len(), 6);
}

/// Reads everything that can be read, and ignores the results.
fn read_all(bytes: &[u8]) {
    for allow_truncated in [false, true] {
        let Ok(recording) = Recording::from_bytes("fuzzed", bytes, allow_truncated) else { continue };
        let _ = procedure_region(&recording);
        for topic in recording.topics() {
            for message in recording.messages(&topic.name) {
                let _ = (read_cloud_head(message), read_cloud(message));
                let _ = (read_transforms(message), read_pose_in_frame(message));
            }
        }
    }
}

#[test]
fn no_damage_makes_the_reader_panic_or_ask_for_absurd_memory() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    LARGEST.store(0, Ordering::Relaxed);
    for encoding in [Encoding::Protobuf, Encoding::Json] {
        for (compression, chunk_bytes) in [
            (Compression::None, Some(400)),
            (Compression::None, None),
            (Compression::Lz4, Some(400)),
            (Compression::Zstd, Some(400)),
        ] {
            let layout = Layout { encoding, compression, chunk_bytes, ..Layout::default() };
            let mut bytes = recording(&layout);
            // Without stored CRCs, damage is detected later.
            if rng.random_range(0..2) == 0 {
                for (start, _) in chunks(&bytes) {
                    bytes[start + 33..start + 37].fill(0);
                }
            }
            for _ in 0..400 {
                let mut damaged = bytes.clone();
                for _ in 0..rng.random_range(1..4) {
                    let at = rng.random_range(0..damaged.len());
                    match rng.random_range(0..4) {
                        0 => damaged[at] ^= 1 << rng.random_range(0..8),
                        1 => damaged[at] = rng.random_range(0..=255),
                        2 => {
                            let end = (at + rng.random_range(1..9)).min(damaged.len());
                            damaged[at..end].fill(0xFF);
                        }
                        _ => damaged.truncate(at.max(1)),
                    }
                }
                read_all(&damaged);
            }
        }
    }
    let largest = LARGEST.load(Ordering::Relaxed);
    // The files have 5 kB, and decompression begins with a buffer of at most 4 MB.
    assert!(largest <= 16 << 20, "{largest} bytes were asked for in one piece");
}

#[test]
fn messages_survive_any_bytes() {
    use osteoflow_formats::message_read::{Encoded, FRAME_TRANSFORM, FRAME_TRANSFORMS, POINT_CLOUD, POSE_IN_FRAME};
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let encodings = [
        ("protobuf", Encoding::Protobuf),
        ("json", Encoding::Json),
        ("cdr", Encoding::Cdr { big_endian: false }),
        ("cdr", Encoding::Cdr { big_endian: true }),
    ];
    let samples = encodings.map(|(_, encoding)| {
        let bytes = recording(&Layout { encoding, ..Layout::default() });
        let recording = Recording::from_bytes("samples", &bytes, false).unwrap();
        ["/scan", "/stylus"].map(|topic| recording.messages(topic)[0].data.to_vec())
    });
    for _ in 0..6000 {
        let k = rng.random_range(0..encodings.len());
        let encoding = encodings[k].0;
        let mut data = samples[k][rng.random_range(0..2)].clone();
        for _ in 0..rng.random_range(0..4) {
            let at = rng.random_range(0..data.len());
            data[at] = rng.random_range(0..=255);
        }
        let schemas = match encoding {
            "cdr" => [
                "sensor_msgs/msg/PointCloud2",
                "geometry_msgs/msg/TransformStamped",
                "tf2_msgs/msg/TFMessage",
                "geometry_msgs/msg/PoseStamped",
            ],
            _ => [POINT_CLOUD, FRAME_TRANSFORM, FRAME_TRANSFORMS, POSE_IN_FRAME],
        };
        for schema_name in schemas {
            let data = data.clone().into();
            let message = Encoded { schema_name, message_encoding: encoding, publish_time_ns: 1, data };
            let _ = (read_cloud_head(message.clone()), read_cloud(message.clone()));
            let _ = (read_transforms(message.clone()), read_pose_in_frame(message));
        }
    }
}

#[test]
fn no_damage_to_a_file_makes_its_reader_panic_or_ask_for_absurd_memory() {
    use osteoflow_geometry::SurfaceOrigin;
    let header = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
                  property list uchar int vertex_indices\nend_header\n";
    let ascii_ply =
        format!("ply\nformat ascii 1.0\n{header}0 0 0\n9 0 0\n9 9 0\n0 9 0\n3 0 1 2\n3 0 2 3\n").into_bytes();
    let mut binary_ply = format!("ply\nformat binary_little_endian 1.0\n{header}").into_bytes();
    binary_ply
        .extend([0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 9.0, 9.0, 0.0, 0.0, 9.0, 0.0_f32].iter().flat_map(|c| c.to_le_bytes()));
    for face in [[0, 1, 2], [0, 2, 3_i32]] {
        binary_ply.push(3);
        binary_ply.extend(face.iter().flat_map(|i| i.to_le_bytes()));
    }
    let facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 9 0 0\nvertex 9 9 1e0\nendloop\nendfacet\n";
    let ascii_stl = format!("solid a\n{facet}{facet}endsolid a\n").into_bytes();
    let mut binary_stl = vec![0; 80];
    binary_stl.extend(2_u32.to_le_bytes());
    binary_stl.extend((0..100_u8).map(|k| k.wrapping_mul(7)));
    let poses = b"t_ns,parent,child,x,y,z,qx,qy,qz,qw\n1,world,m,0,0,0,0,0,0,1\n2,world,m,0,0,0,0,0,0,1\n".to_vec();
    let plan =
        br#"{"units":"mm","landmarks":{"P1":[1,2,3]},"planes":[[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]]}"#.to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let file = tempfile::NamedTempFile::new().unwrap();
    let path = file.path();
    let mut n_read = 0;
    for whole in [ascii_ply, binary_ply, ascii_stl, binary_stl, poses, plan] {
        for _ in 0..120 {
            let mut damaged = whole.clone();
            for _ in 0..rng.random_range(0..3) {
                let at = rng.random_range(0..damaged.len());
                match rng.random_range(0..4) {
                    0 => damaged[at] ^= 1 << rng.random_range(0..8),
                    1 => damaged[at] = rng.random_range(b'0'..=b'9'),
                    2 => damaged.insert(at, rng.random_range(b' '..=b'~')),
                    _ => damaged.truncate(at.max(1)),
                }
            }
            std::fs::write(path, &damaged).unwrap();
            n_read += usize::from(mesh_or_cloud::read_mesh(path, 1.0, "ct", SurfaceOrigin::User).is_ok());
            n_read += usize::from(mesh_or_cloud::read_cloud(path, 1.0, "camera").is_ok());
            n_read += usize::from(poses_csv::read_poses(path, 1.0).is_ok());
            n_read += usize::from(plan_file::read_plan(path).is_ok());
        }
    }
    assert!(
        (120..960).contains(&n_read),
        "{n_read} of 2880 attempts were readable: the damage is too mild or too strong"
    );
    assert!(
        LARGEST.load(Ordering::Relaxed) <= 16 << 20,
        "{} bytes were asked for in one piece",
        LARGEST.load(Ordering::Relaxed)
    );
}

/// A valid file of each format of surfaces and clouds, in each of its encodings.
fn shapes() -> Vec<(&'static str, Vec<u8>)> {
    use osteoflow_formats::{
        Space,
        write::{Precision, write_cloud, write_mesh},
    };
    use osteoflow_geometry::{Mesh, SurfaceOrigin};
    let dir = tempfile::tempdir().unwrap();
    let corners = [[0.0, 0.0, 0.0], [9.5, 0.0, 0.0], [9.0, 9.25, 0.0], [0.0, 9.0, 1.0]].map(Point3::from).to_vec();
    let mesh = Mesh::new("ct", SurfaceOrigin::User, corners.clone(), vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let cloud = Cloud::new("ct", corners).unwrap();
    let cloud = cloud.with_normals(vec![nalgebra::Vector3::z(); 4]).unwrap();
    let mut files = Vec::new();
    for ending in ["ply", "stl", "obj"] {
        let path = dir.path().join(format!("mesh.{ending}"));
        write_mesh(&path, &mesh, Space::Ras, Precision::Single).unwrap();
        files.push((ending, std::fs::read(path).unwrap()));
    }
    for ending in ["ply", "pcd", "csv"] {
        let path = dir.path().join(format!("cloud.{ending}"));
        write_cloud(
            &path,
            &cloud.clone().with_extra("heat", vec![1.0, 2.0, 3.0, 4.0]).unwrap(),
            Space::Lps,
            Precision::Single,
        )
        .unwrap();
        files.push((ending, std::fs::read(path).unwrap()));
    }
    let pcd = "# .PCD v0.7\nFIELDS x y z _ id\nSIZE 4 4 4 1 2\nTYPE F F F U I\nCOUNT 1 1 1 2 1\nWIDTH 2\nHEIGHT 2\n\
               VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA ";
    files.push((
        "ascii pcd",
        format!("{pcd}ascii\n1 2 3 0 0 5\n4 5 nan 0 0 5\n7 8 9 0 0 6\n1 5 9 0 0 7\n").into_bytes(),
    ));
    let mut packed = format!("{pcd}binary_compressed\n").into_bytes();
    // 64 bytes: 2 literals, a copy of 9 + 53 from 2 back.
    packed.extend(6_u32.to_le_bytes());
    packed.extend(64_u32.to_le_bytes());
    packed.extend([1, 0, 64, 7 << 5, 53, 1]);
    files.push(("packed pcd", packed));
    files.push(("off", b"CNOFF # SPACE=RAS\n4 2 0\n0 0 0 0 0 1 9 9 9\n9 0 0 0 0 1 9 9 9\n9 9 0 0 0 1 9 9 9\n0 9 0 0 0 1 9 9 9\n3 0 1 2\n3 0 2 3\n".to_vec()));
    files.push((
        "obj",
        b"o a\nv 0 0 0\nv 9 0 0\nvn 0 0 1\nv 9 9 0\nv 0 9 0\nf 1//1 2//1 3//1 4//1\nf -4/1 -2/1 -1/1\n".to_vec(),
    ));
    let vtk = "# vtk DataFile Version 5.1\nbone SPACE=RAS\n";
    files.push(("vtk", format!("{vtk}ASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 9 0 0\n9 9 0 0 9 0\nPOLYGONS 1 5\n4 0 1 2 3\nPOINT_DATA 4\nSCALARS a int 1\nLOOKUP_TABLE default\n1 2 3 4\nNORMALS n float\n0 0 1 0 0 1 0 0 1 0 0 1\n").into_bytes()));
    let mut binary = format!("{vtk}BINARY\nDATASET POLYDATA\nPOINTS 4 float\n").into_bytes();
    binary
        .extend([0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 9.0, 9.0, 0.0, 0.0, 9.0, 0.0_f32].iter().flat_map(|c| c.to_be_bytes()));
    binary.extend(b"\nPOLYGONS 3 6\nOFFSETS vtktypeint64\n");
    binary.extend([0, 3, 6_i64].iter().flat_map(|c| c.to_be_bytes()));
    binary.extend(b"\nCONNECTIVITY vtktypeint64\n");
    binary.extend([0, 1, 2, 0, 2, 3_i64].iter().flat_map(|c| c.to_be_bytes()));
    binary.extend(b"\nMETADATA\nINFORMATION 0\n\nTRIANGLE_STRIPS 1 5\n");
    binary.extend([4, 0, 1, 3, 2_i32].iter().flat_map(|c| c.to_be_bytes()));
    files.push(("binary vtk", binary));
    files.push(("text", b"4\n//X;Y;Z;Label\n1,5;2,5;3,5;a\n1,5;2,0;nan;b\n4;5;6;c\n7;8;9;d\n".to_vec()));
    files.push(("xyz", b"1.5 2.5 3.5 0 0 1\n1.5 2.0 4 0 0 1\n4 5 6 0 1 0\n".to_vec()));
    files
}

/// Changes a few bytes: flips, replaces, inserts, removes, doubles, cuts.
fn damaged(whole: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for _ in 0..rng.random_range(1..4) {
        let at = rng.random_range(0..bytes.len());
        let end = (at + rng.random_range(1..12)).min(bytes.len());
        match rng.random_range(0..8) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes[at] = rng.random_range(b'0'..=b'9'),
            2 => bytes[at] = rng.random_range(0..=255),
            3 => bytes.insert(at, rng.random_range(b' '..=b'~')),
            4 => bytes.insert(at, b"90-\n,;. "[rng.random_range(0..8)]),
            5 => drop(bytes.drain(at..end)),
            6 => {
                let doubled = bytes[at..end].to_vec();
                bytes.splice(at..at, doubled);
            }
            _ => bytes.truncate(at.max(1)),
        }
        if bytes.is_empty() {
            bytes.push(b' ');
        }
    }
    bytes
}

#[test]
fn no_damage_to_a_surface_or_cloud_makes_its_reader_panic_or_ask_for_absurd_memory() {
    use osteoflow_formats::mesh_or_cloud::read_mesh_or_cloud;
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    for (name, whole) in shapes() {
        let path = name.as_ref();
        let read = read_mesh_or_cloud(path, &whole, 1.0, "ct");
        assert!(read.is_ok(), "{name}: {}", read.unwrap_err());
        let mut n_read = 0;
        for _ in 0..600 {
            n_read += usize::from(read_mesh_or_cloud(path, &damaged(&whole, &mut rng), 1000.0, "ct").is_ok());
        }
        assert!((1..600).contains(&n_read), "{name}: {n_read} of 600 mutants were readable");
    }
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest <= 16 << 20, "{largest} bytes were asked for in one piece");
}

#[test]
fn no_damage_to_picked_points_makes_their_reader_panic_or_ask_for_absurd_memory() {
    use osteoflow_formats::{
        Space,
        picked_points::{parse_picked_points, write_fcsv, write_mrk_json, write_points_csv},
    };
    use osteoflow_geometry::NamedPoint;
    let dir = tempfile::tempdir().unwrap();
    let points = [("P1", [1.0, 2.5, 3.0]), ("P 2", [4.0, -5.0, 6.0])].map(|(name, p)| NamedPoint::new(name, p.into()));
    let path = dir.path().join("points");
    let mut files = Vec::new();
    write_mrk_json(&path, &points, Space::Ras).unwrap();
    files.push(std::fs::read(&path).unwrap());
    write_fcsv(&path, &points, Space::Lps).unwrap();
    files.push(std::fs::read(&path).unwrap());
    write_points_csv(&path, &points, Space::Ras).unwrap();
    files.push(std::fs::read(&path).unwrap());
    for text in [
        r#"{"markups":[{"type":"Plane","coordinateSystem":"RAS","center":[1,2,3],"normal":[0,0,1]},
            {"type":"ROI","coordinateSystem":"RAS","center":[1,2,3],"size":[1,2,3],"orientation":[-1,0,0,0,-1,0,0,0,1]}]}"#,
        "<!DOCTYPE PickedPoints>\n<PickedPoints>\n<point x=\"1\" y=\"2\" z=\"3\" active=\"1\" name=\"P1\"/></PickedPoints>",
        "P1,1,2,3\nP2,4,5,6\n",
        "#0 1 2 3\nP2 4 5 6\nP 3 4 5 6\n",
        "0;1,5;2,5;3,5\n1;4;5;6\n",
        "1 2 3\n4 5 6\n",
    ] {
        files.push(text.into());
    }
    let scene = "<MRML><MarkupsFiducial id=\"a\" name=\"a\" references=\"storage:b;transform:t;\"/><MarkupsJsonStorage id=\"b\" fileName=\"a\"/>\
                 <LinearTransform id=\"t\" matrixTransformToParent=\"1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1\"/></MRML>";
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, bytes) in [("s/s.mrml", scene.as_bytes()), ("s/a", &files[0])] {
        let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        zip.start_file(name, stored).unwrap();
        std::io::Write::write_all(&mut zip, bytes).unwrap();
    }
    files.push(zip.finish().unwrap().into_inner());
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for whole in files {
        let name = String::from_utf8_lossy(&whole).into_owned();
        parse_picked_points("whole".as_ref(), &whole).unwrap_or_else(|error| panic!("{error}\n{name}"));
        let mut n_read = 0;
        for _ in 0..600 {
            n_read += usize::from(parse_picked_points("damaged".as_ref(), &damaged(&whole, &mut rng)).is_ok());
        }
        assert!((1..600).contains(&n_read), "{n_read} of 600 mutants were readable\n{name}");
    }
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest <= 16 << 20, "{largest} bytes were asked for in one piece");
}

#[cfg(unix)]
#[test]
fn every_reader_refuses_devices_pipes_sockets_and_folders_by_name() {
    use osteoflow_formats::{folder, mcap_read, picked_points, pose_file, region_file, volume};
    use osteoflow_geometry::SurfaceOrigin;
    use std::{
        fs,
        os::unix::net::UnixListener,
        path::{Path, PathBuf},
        process::Command,
    };
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (pipe, socket, folder) = (at("pipe"), at("socket"), at("folder"));
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let _listener = UnixListener::bind(&socket).unwrap();
    fs::create_dir(&folder).unwrap();
    type Reader = (&'static str, fn(&Path) -> Result<(), String>);
    let readers: [Reader; 9] = [
        ("cloud", |p| mesh_or_cloud::read_cloud(p, 1.0, "camera").map(drop).map_err(|e| e.to_string())),
        ("mesh", |p| mesh_or_cloud::read_mesh(p, 1.0, "ct", SurfaceOrigin::User).map(drop).map_err(|e| e.to_string())),
        ("points", |p| picked_points::read_picked_points(p).map(drop).map_err(|e| e.to_string())),
        ("plan", |p| plan_file::read_plan(p).map(drop).map_err(|e| e.to_string())),
        ("pose", |p| pose_file::read_pose(p, 1.0).map(drop).map_err(|e| e.to_string())),
        ("poses", |p| poses_csv::read_poses(p, 1.0).map(drop).map_err(|e| e.to_string())),
        ("region", |p| region_file::read_region(p).map(drop).map_err(|e| e.to_string())),
        ("tips", |p| folder::read_tips(p, 1.0).map(drop).map_err(|e| e.to_string())),
        ("plan of a bone", |p| plan_file::read_plan_of(p, "a").map(drop).map_err(|e| e.to_string())),
    ];
    let zero = PathBuf::from("/dev/zero");
    let kinds = [(&zero, "a device"), (&pipe, "a pipe"), (&socket, "a socket"), (&folder, "a folder")];
    for (name, reader) in readers {
        for (path, kind) in kinds {
            let refusal = reader(path).unwrap_err();
            let expected = format!("{}: it is {kind}, but a regular file is needed", path.display());
            assert!(refusal.starts_with(&expected), "{name}: {refusal}");
        }
    }
    // These take a folder, too.
    for (path, kind) in &kinds[..3] {
        for refusal in [
            volume::read_volume(path, None).unwrap_err().to_string(),
            mcap_read::Recording::open(path, false).unwrap_err().to_string(),
            folder::ProcedureFolder::open(path).unwrap_err().to_string(),
        ] {
            assert!(refusal.contains(&format!("it is {kind}, but a regular file is needed")), "{refusal}");
        }
    }
}

#[test]
fn a_number_cut_at_the_end_of_a_text_is_not_read_as_another_number() {
    let folder = tempfile::tempdir().unwrap();
    let row = |k: usize, separator: &str| format!("{k}.2500{separator}-1.5000{separator}41.3000");
    let rows = |separator: &str| (0..8).map(|k| row(k, separator) + "\n").collect::<String>();
    let labelled = |k: usize| format!("P{k},{}\n", row(k, ","));
    let pose = |k: usize| format!("{k}.0500 {} 0.0000 0.0000 0.0000 1.0000\n", row(k, " "));
    let named = |k: usize| format!("{k}0000000,world,bone,{},0.0000,0.0000,0.0000,1.0000\n", row(k, ","));
    let header =
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let pcd =
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 8\nHEIGHT 1\nPOINTS 8\nDATA ascii\n";
    type Read = fn(&std::path::Path) -> Result<Vec<String>, osteoflow_formats::FileError>;
    let cloud: Read = |path| Ok(mesh_or_cloud::read_cloud(path, 1.0, "scan")?.notes);
    let picked: Read = |path| Ok(osteoflow_formats::picked_points::read_picked_points(path)?.notes);
    let poses: Read = |path| {
        use osteoflow_formats::pose_log::{LogOptions, read_log};
        let names = LogOptions { parent: Some("world".into()), child: Some("bone".into()), ..LogOptions::default() };
        Ok(read_log(path, &names)?.notes)
    };
    for (name, text, read) in [
        ("a.xyz", rows(" "), cloud),
        ("a.csv", format!("x,y,z\n{}", rows(",")), cloud),
        ("a.asc", format!("//X;Y;Z\n{}", rows(";")), cloud),
        ("a.pts", format!("8\n{}", rows(" ")), cloud),
        ("a.ply", format!("{header}{}", rows(" ")), cloud),
        ("a.pcd", format!("{pcd}{}", rows(" ")), cloud),
        ("picked.csv", format!("name,x,y,z\n{}", (0..3).map(labelled).collect::<String>()), picked),
        ("a.tum", (0..8).map(pose).collect(), poses),
        ("poses.csv", format!("t_ns,parent,child,x,y,z,qx,qy,qz,qw\n{}", (0..8).map(named).collect::<String>()), poses),
    ] {
        let file = folder.path().join(name);
        let of = |text: &str| {
            std::fs::write(&file, text).unwrap();
            read(&file)
        };
        let open = "the last line has no end; was the file cut short?";
        assert!(!of(&text).unwrap().contains(&open.into()), "{name}");
        let ended = text.trim_end();
        assert!(of(ended).unwrap().contains(&open.into()), "{name}: {:?}", of(ended));
        for n_less in 1..=4 {
            let said = of(&ended[..ended.len() - n_less]).map_err(|error| error.to_string());
            let said = said.expect_err(name);
            assert!(said.contains("the last line has no end, and its last number, "), "{name}: {said}");
        }
    }
}
