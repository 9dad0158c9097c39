use super::*;
use nalgebra::{Isometry3, Matrix4, Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const STAMP: StampNs = 1_750_000_011_123_456_789;

/// Messages of the reference library, by name.
fn vector(name: &str) -> Vec<u8> {
    let lines = include_str!("vectors.txt").lines().filter(|line| !line.starts_with('#'));
    let (_, hex) = lines.filter_map(|line| line.split_once(' ')).find(|(key, _)| *key == name).unwrap();
    (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap()).collect()
}

fn decode_all(bytes: &[u8]) -> Vec<Result<Message, Damage>> {
    let mut decoder = Decoder::default();
    decoder.push(bytes);
    decoder.collect()
}

fn decode(bytes: &[u8]) -> Message {
    let mut all = decode_all(bytes);
    assert_eq!(all.len(), 1, "{all:?}");
    all.remove(0).unwrap()
}

/// The metadata of the reference library's messages of header version 2.
fn reference_metadata() -> Vec<Metadata> {
    vec![Metadata::new("First patient age", "22"), Metadata::new("Second patient age", "25")]
}

/// One message of each kind.
fn every_kind() -> Vec<Message> {
    let pose = Isometry3::new(Vector3::new(10.0, 20.0, -30.5), Vector3::new(0.3, -0.2, 0.9));
    let q = pose.rotation.coords.map(|c| c as f32);
    let position = Position { name: String::new(), position: [1.0, -2.0, 3.5], quaternion: Some(q.into()) };
    let tool = |name: &str| TrackedTool { name: name.into(), kind: 2, matrix: Affine::of(&pose) };
    let mesh = PolyData {
        points: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]],
        polygons: Cells::new([[0, 1, 2]]),
        vertices: Cells::new([[2]]),
        lines: Cells::new([[0, 1], [1, 2]]),
        strips: Cells::default(),
        attributes: vec![Attribute { kind: 2, n_components: 3, name: "n".into(), values: vec![0.5; 9] }],
    };
    let bodies = [
        Body::Transform(Affine::of(&pose)),
        Body::Tracking(vec![tool("StylusToTracker"), tool("ProbeToTracker")]),
        Body::Positions(vec![position]),
        Body::Points(vec![Fiducial::new("P1", [1.0, 2.0, 3.0]), Fiducial::new("P2", [4.0, 5.0, 6.0])]),
        Body::PolyData(mesh),
        Body::Image(PixelImage::new([2, 3], 1, Scalar::U16, (0..12).collect())),
        Body::Status(Status::new(Status::OK, "OK", "all is well")),
        Body::Text("Grüße".into()),
        Body::StartTracking { interval_ms: 50, coordinates: "Reference".into() },
    ];
    let messages = bodies.into_iter().map(|body| Message::new("Device", STAMP, body));
    let extended = |message: Message| message.extended(7, vec![Metadata::new("TransformStatus", "OK")]);
    messages.flat_map(|message| [message.clone(), extended(message)]).collect()
}

#[test]
fn messages_of_the_reference_library_are_read_and_written_byte_for_byte() {
    for name in ["transform", "position", "tdata", "point", "polydata", "status", "string", "image_float", "image_part"]
    {
        let bytes = vector(name);
        let message = decode(&bytes);
        assert_eq!((message.device.as_str(), message.stamp_ns), ("DeviceName", 287_445_237), "{name}");
        assert_eq!(message.to_bytes().unwrap(), bytes, "{name}");
    }
    for name in ["transform_2", "position_2", "tdata_2"] {
        let bytes = vector(name);
        let message = decode(&bytes);
        let extended = message.extended.as_ref().unwrap();
        assert_eq!((extended.message_id, &extended.metadata), (1, &reference_metadata()), "{name}");
        assert_eq!(message.to_bytes().unwrap(), bytes, "{name}");
    }
}

#[test]
fn header_version_2_puts_the_reference_content_between_extended_header_and_metadata() {
    // The library has no bytes of these in header version 2; its tests compare their content with that of version 1.
    let around = vector("transform_2");
    let (head, tail) = (&around[58..70], &around[118..]);
    for name in ["transform", "position", "tdata", "point", "polydata", "status", "string"] {
        let bytes = vector(name);
        let written = decode(&bytes).extended(1, reference_metadata()).to_bytes().unwrap();
        assert_eq!(written[..2], [0, 2], "{name}");
        assert_eq!(written[58..], [head, &bytes[58..], tail].concat(), "{name}");
    }
}

#[test]
fn the_numbers_of_the_reference_messages_are_those_that_its_tests_set() {
    let Body::Transform(affine) = decode(&vector("transform")).body else { panic!("no transform") };
    let expected = Matrix4::new(
        -0.954_892, -0.196_632, 0.222_525, 46.0531, 0.196_632, 0.142_857, 0.970_014, 19.4709, -0.222_525, 0.970_014,
        -0.097_749, 46.0531, 0.0, 0.0, 0.0, 1.0,
    );
    // The columns are sent one after the other; row by row, the first rows would differ by 0.39.
    assert!((affine.matrix() - expected).amax() < 1e-4, "{}", affine.matrix());
    let Body::Status(status) = decode(&vector("status")).body else { panic!("no status") };
    let sent = Status { sub_code: 10, ..Status::new(15, "ACTUATOR_DISABLED", "Actuator A is disabled.") };
    assert_eq!(status, sent);
    let Body::Text(text) = decode(&vector("string")).body else { panic!("no string") };
    assert_eq!(text, "Welcome to OpenIGTLink");
    let Body::Points(points) = decode(&vector("point")).body else { panic!("no points") };
    let first = &points[0];
    assert_eq!((points.len(), first.name.as_str(), first.position), (3, "POINT_DESCRIPTION_0", [10.0, 15.0, 20.0]));
    assert_eq!((first.diameter, first.owner.as_str(), first.rgba), (5.0, "IMAGE_0", [255, 0, 0, 255]));
    let Body::PolyData(cube) = decode(&vector("polydata")).body else { panic!("no poly data") };
    assert_eq!((cube.points.len(), cube.polygons.iter().count(), cube.points[6]), (8, 6, [1.0; 3]));
    assert_eq!(cube.polygons.iter().last().unwrap(), [3, 0, 4, 7]);
    assert_eq!((cube.attributes[0].name.as_str(), cube.attributes[0].values[7]), ("attr", 7.0));
    let Body::Image(scan) = decode(&vector("image_float")).body else { panic!("no image") };
    assert_eq!((scan.form().as_str(), scan.is_whole()), ("4 x 3 pixels of 3 float32", true));
    assert_eq!(scan.values(), (0..36).map(|i| 0.25 * f64::from(i) - 3.0).collect::<Vec<_>>());
    // A quarter turn about z, 0.5 mm by 2 mm; the middle of the image is at (10, 20, 30).
    let middle = scan.t_space_index() * nalgebra::Vector4::new(1.5, 1.0, 0.0, 1.0);
    assert!((middle.xyz() - Vector3::new(10.0, 20.0, 30.0)).norm() < 1e-5, "{middle}");
    let step = scan.t_space_index() * nalgebra::Vector4::new(1.0, 0.0, 0.0, 0.0);
    assert!((step.xyz() - Vector3::new(0.0, 0.5, 0.0)).norm() < 1e-5, "{step}");
    let Body::Image(part) = decode(&vector("image_part")).body else { panic!("no image") };
    assert_eq!((part.size, part.part_offset, part.part_size), ([4, 3, 1], [1, 1, 0], [2, 2, 1]));
    assert_eq!(part.values(), [7.0, 1007.0, 2007.0, 3007.0]);
}

#[test]
fn numbers_of_an_image_are_those_of_its_type_in_both_byte_orders() {
    let one = |scalar: Scalar, is_little_endian: bool, bytes: &[u8]| {
        let image = PixelImage { is_little_endian, ..PixelImage::new([1, 1], 1, scalar, bytes.to_vec()) };
        let Body::Image(read) = decode(&Message::new("I", 0, Body::Image(image)).to_bytes().unwrap()).body else {
            panic!("no image")
        };
        read.values()
    };
    for (scalar, number, bytes) in [
        (Scalar::I8, -2.0, (-2i8).to_le_bytes().to_vec()),
        (Scalar::U8, 254.0, vec![254]),
        (Scalar::I16, -300.0, (-300i16).to_le_bytes().to_vec()),
        (Scalar::U16, 65_000.0, 65_000u16.to_le_bytes().to_vec()),
        (Scalar::I32, -70_000.0, (-70_000i32).to_le_bytes().to_vec()),
        (Scalar::U32, 4e9, 4_000_000_000u32.to_le_bytes().to_vec()),
        (Scalar::F32, -0.75, (-0.75f32).to_le_bytes().to_vec()),
        (Scalar::F64, 0.1, 0.1f64.to_le_bytes().to_vec()),
    ] {
        assert_eq!(one(scalar, true, &bytes), [number], "{}", scalar.name());
        let reversed: Vec<u8> = bytes.into_iter().rev().collect();
        assert_eq!(one(scalar, false, &reversed), [number], "{}, highest byte first", scalar.name());
    }
}

#[test]
fn every_kind_comes_back_as_it_was_sent_in_both_header_versions() {
    let sent = every_kind();
    let bytes: Vec<u8> = sent.iter().flat_map(|message| message.to_bytes().unwrap()).collect();
    let expected: Vec<_> = sent.into_iter().map(Ok).collect();
    assert_eq!(decode_all(&bytes), expected);
    // In pieces of any size.
    for n in [1, 7, 58, 59, 1000] {
        let mut decoder = Decoder::default();
        let mut items = Vec::new();
        for piece in bytes.chunks(n) {
            decoder.push(piece);
            items.extend(&mut decoder);
        }
        assert_eq!(items, expected, "in pieces of {n} bytes");
    }
}

#[test]
fn stamps_keep_their_nanoseconds() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..10_000 {
        let ns = rng.random_range(0..4_294_967_295_000_000_000i64);
        let message = Message::new("D", ns, Body::Text(String::new()));
        assert_eq!(decode(&message.to_bytes().unwrap()).stamp_ns, ns);
    }
    for ns in [-1, 4_294_967_296_000_000_000] {
        let message = Message::new("D", ns, Body::Text(String::new()));
        assert_eq!(
            message.to_bytes(),
            Err(EncodeError(format!(
                "the stamp {ns} ns does not fit a timestamp, which begins in 1970 and ends in 2106"
            )))
        );
    }
}

#[test]
fn a_pose_in_single_precision_is_within_a_ten_thousandth_of_a_millimetre_at_a_metre() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut worst = 0.0_f64;
    for _ in 0..1000 {
        let mut vector = |scale: f64| Vector3::from_fn(|_, _| rng.random_range(-scale..scale));
        let sent = Isometry3::from_parts(vector(577.0).into(), UnitQuaternion::new(vector(1.8)));
        let read = Affine::of(&sent).rigid().unwrap();
        let origin = (read.value * Point3::origin() - sent * Point3::origin()).norm();
        worst = worst.max(origin);
        // A marker is within 100 mm of its origin.
        let away = Point3::new(100.0, 0.0, 0.0);
        assert!((read.value * away - sent * away).norm() < 1e-4);
    }
    assert!(worst < 6e-5, "{worst} mm");
}

#[test]
fn every_truncation_of_a_message_gives_no_message() {
    for message in every_kind() {
        let bytes = message.to_bytes().unwrap();
        for n in 0..bytes.len() {
            assert_eq!(decode_all(&bytes[..n]), [], "{} of {} bytes", n, bytes.len());
        }
    }
}

#[test]
fn a_body_cut_short_with_a_right_length_and_crc_is_malformed() {
    for message in every_kind() {
        let bytes = message.to_bytes().unwrap();
        for n in HEADER_BYTES..bytes.len() {
            let mut cut = bytes[..n].to_vec();
            let crc = crc64(&cut[HEADER_BYTES..]);
            cut[42..50].copy_from_slice(&((n - HEADER_BYTES) as u64).to_be_bytes());
            cut[50..58].copy_from_slice(&crc.to_be_bytes());
            // The last number of a quaternion follows from the others, and the zero after a status may be missing.
            let n_cut = bytes.len() - n;
            let is_whole = matches!((&message.body, n_cut), (Body::Positions(_), 4) | (Body::Status(_), 1));
            for item in decode_all(&cut).into_iter().filter(|_| !is_whole) {
                assert_ne!(item.as_ref(), Ok(&message), "{n} of {} bytes", bytes.len());
            }
        }
    }
}

#[test]
fn every_flipped_bit_of_a_body_is_found_and_the_next_message_is_read() {
    let next = Message::new("Next", STAMP, Body::Text("here".into()));
    for message in every_kind() {
        let bytes = message.to_bytes().unwrap();
        for bit in 8 * HEADER_BYTES..8 * bytes.len() {
            let mut stream = bytes.clone();
            stream[bit / 8] ^= 1 << (bit % 8);
            stream.extend(next.to_bytes().unwrap());
            let items = decode_all(&stream);
            assert!(
                items[0].as_ref().is_err_and(|damage| damage.to_string().contains("the CRC of its body is wrong")),
                "bit {bit}: {items:?}"
            );
            assert_eq!(items.last(), Some(&Ok(next.clone())), "bit {bit}");
            assert!(items.iter().flatten().count() == 1, "bit {bit}: {items:?}");
        }
    }
}

#[test]
fn a_sender_that_writes_no_crc_is_named_and_read_on_request() {
    let message = Message::new("Device", STAMP, Body::Transform(Affine([1.0; 12])));
    let mut bytes = message.to_bytes().unwrap();
    bytes[50..58].fill(0);
    let error = decode_all(&bytes)[0].clone().unwrap_err().to_string();
    assert!(
        error.ends_with("the CRC of its body is wrong (0; of a sender that writes none, set crc = false)"),
        "{error}"
    );
    let mut decoder = Decoder::without_crc();
    decoder.push(&bytes);
    assert_eq!(decoder.next(), Some(Ok(message.clone())));
    // A CRC that is there is checked all the same.
    let mut damaged = message.to_bytes().unwrap();
    damaged[HEADER_BYTES] ^= 1;
    decoder.push(&damaged);
    assert!(decoder.next().unwrap().is_err());
}

#[test]
fn a_flipped_bit_of_a_header_loses_at_most_that_message() {
    let next = Message::new("Next", STAMP, Body::Text("here".into()));
    let bytes = Message::new("Device", STAMP, Body::Transform(Affine([1.0; 12]))).to_bytes().unwrap();
    for bit in 0..8 * HEADER_BYTES {
        let mut stream = bytes.clone();
        stream[bit / 8] ^= 1 << (bit % 8);
        stream.extend(next.to_bytes().unwrap());
        let mut decoder = Decoder::default();
        decoder.push(&stream);
        let mut items: Vec<_> = decoder.by_ref().collect();
        // A wrong length or type of a type without a known size can wait for bytes that do not come.
        decoder.give_up();
        items.extend(decoder);
        assert_eq!(items.last(), Some(&Ok(next.clone())), "bit {bit}: {items:?}");
    }
}

#[test]
fn a_message_that_stops_half_way_does_not_swallow_the_next() {
    let bytes = every_kind().iter().map(|m| m.to_bytes().unwrap()).collect::<Vec<_>>();
    let next = Message::new("Next", STAMP, Body::Transform(Affine([0.5; 12])));
    for half in &bytes {
        let mut decoder = Decoder::default();
        decoder.push(&half[..half.len() / 2]);
        (0..20).for_each(|_| decoder.push(&next.to_bytes().unwrap()));
        let mut items: Vec<_> = decoder.by_ref().collect();
        decoder.give_up();
        items.extend(decoder);
        let n = items.iter().filter(|item| **item == Ok(next.clone())).count();
        assert!(n >= 20, "{n} of 20 messages after half a message: {items:?}");
    }
}

#[test]
fn ten_thousand_transforms_between_a_thousand_random_pieces_arrive_in_order() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut decoder = Decoder::default();
    let (mut items, mut n_damages) = (Vec::new(), 0);
    for i in 0..10_000 {
        let message = Message::new("ProbeToTracker", STAMP + i, Body::Transform(Affine([i as f32; 12])));
        decoder.push(&message.to_bytes().unwrap());
        if i % 10 == 0 {
            let n = rng.random_range(1..2000);
            let mut noise: Vec<u8> = (0..n).map(|_| rng.random()).collect();
            // Half of them begin like a message.
            if i % 20 == 0 && n > 14 {
                noise[..12].copy_from_slice(&message.to_bytes().unwrap()[..12]);
            }
            decoder.push(&noise);
        }
        for read in &mut decoder {
            match read {
                Ok(message) => items.push(message.stamp_ns - STAMP),
                Err(_) => n_damages += 1,
            }
        }
    }
    assert_eq!(items, (0..10_000).collect::<Vec<_>>());
    assert_eq!(n_damages, 1000, "one report for each random piece");
}

#[test]
fn bodies_of_random_bytes_with_a_right_crc_are_refused_without_a_panic() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let types = ["TRANSFORM", "TDATA", "POSITION", "POINT", "POLYDATA", "STATUS", "STRING", "IMAGE"];
    for i in 0..10_000 {
        let body: Vec<u8> = (0..rng.random_range(0..400)).map(|_| rng.random::<u8>() & rng.random::<u8>()).collect();
        let mut bytes = vec![0, 1 + (i % 3) as u8];
        put_name(&mut bytes, "", types[i % types.len()], 12).unwrap();
        put_name(&mut bytes, "", "Device", 20).unwrap();
        bytes.extend([0; 8]);
        bytes.extend((body.len() as u64).to_be_bytes());
        bytes.extend(crc64(&body).to_be_bytes());
        bytes.extend(&body);
        let next = Message::new("Next", STAMP, Body::Text("here".into()));
        bytes.extend(next.to_bytes().unwrap());
        let mut decoder = Decoder::default();
        decoder.push(&bytes);
        let mut items: Vec<_> = decoder.by_ref().collect();
        decoder.give_up();
        items.extend(decoder);
        assert_eq!(items.last(), Some(&Ok(next)), "message {i}");
    }
}

#[test]
fn announced_numbers_allocate_nothing_that_did_not_come() {
    // Four billion points, attributes and cells in a body of forty bytes.
    for at in [0, 4, 8, 36] {
        let mut body = [0; 40];
        body[at..at + 4].fill(0xff);
        let error = PolyData::parse(&mut Reader::new(&body)).unwrap_err();
        assert!(error.contains("bytes are expected") || error.contains("announced"), "{error}");
    }
}

#[test]
fn cells_in_the_wrong_byte_order_are_refused() {
    let mut bytes = Message::new(
        "Mesh",
        0,
        Body::PolyData(PolyData {
            points: vec![[0.0; 3]; 3],
            vertices: Cells::new([[0], [1], [2]]),
            ..PolyData::default()
        }),
    )
    .to_bytes()
    .unwrap();
    let cells = HEADER_BYTES + 40 + 36;
    bytes[cells..].chunks_mut(4).for_each(<[u8]>::reverse);
    let crc = crc64(&bytes[HEADER_BYTES..]);
    bytes[50..58].copy_from_slice(&crc.to_be_bytes());
    let items = decode_all(&bytes);
    assert!(matches!(&items[..], [Err(damage)] if damage.to_string().contains("byte order")), "{items:?}");
}

#[test]
fn a_matrix_sent_row_by_row_or_mirrored_is_no_rigid_motion_or_another() {
    let pose = Isometry3::new(Vector3::new(100.0, 200.0, 300.0), Vector3::new(0.3, -0.2, 0.9));
    let rows: Affine = {
        let matrix = pose.to_homogeneous();
        Affine(std::array::from_fn(|k| matrix[(k / 4, k % 4)] as f32))
    };
    assert!(rows.rigid().is_err(), "row by row, a translation is in the rotation");
    let mut mirrored = Affine::of(&pose);
    (0..4).for_each(|column| mirrored.0[3 * column] *= -1.0);
    assert!(matches!(mirrored.rigid(), Err(osteoflow_geometry::RigidError::Mirror { .. })));
    let mut scaled = Affine::of(&pose);
    scaled.0[..9].iter_mut().for_each(|c| *c *= 1000.0);
    assert!(scaled.rigid().is_err(), "a matrix with the scale of metres");
}

#[test]
fn names_that_do_not_fit_are_refused_instead_of_cut() {
    let text = || Body::Text("x".into());
    let error = Message::new("PhantomMarkerToTracker", 0, text()).to_bytes().unwrap_err().to_string();
    assert_eq!(error, "the device \"PhantomMarkerToTracker\" has 22 bytes, and 20 fit");
    assert!(Message::new("a\0b", 0, text()).to_bytes().is_err());
    assert!(Message::new("D", 0, Body::Text("x".repeat(70_000))).to_bytes().is_err());
    assert!(Message::new("D", 0, Body::Other { type_name: "SENSOR".into(), n_bytes: 0 }).to_bytes().is_err());
}
