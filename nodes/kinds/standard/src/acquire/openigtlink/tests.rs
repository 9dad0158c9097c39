use super::*;
use crate::acquire::network::{
    NetworkSource,
    tests::{MS, Outcome, PortSpec, STAMP, context, take_until},
};
use osteoflow_formats::openigtlink::{
    Affine, Body, Cells, Fiducial, Message, Metadata, PixelImage, PolyData, Position, Scalar, Status, TrackedTool,
};
use osteoflow_geometry::{
    Cloud, Image, Mesh, Points, Pose, Region, StampNs,
    nalgebra::{Isometry3, Point3, Vector3},
};
use osteoflow_node::{Emission, Source};
use osteoflow_payloads::{Flag, Text as TextPayload};
use serde_json::json;
use std::{
    io::Write,
    net::{SocketAddr, TcpListener, TcpStream},
    thread,
};

fn source(address: SocketAddr, change: impl FnOnce(&mut Params)) -> NetworkSource<OpenIgtLink> {
    let network = NetworkParams { reconnect: false, ..NetworkParams::default() };
    let mut params = Params { address: address.to_string(), network, ..Params::default() };
    change(&mut params);
    NetworkSource::new(params).unwrap()
}

/// The items of a source to its end.
fn take_all(source: &mut NetworkSource<OpenIgtLink>, ctx: &mut Context) -> Result<Outcome, String> {
    let outcome = take_until(source, ctx, |_| false);
    outcome.error.clone().map_or(Ok(outcome), Err)
}

/// What a source gives of bytes that one sender sends, before it closes.
fn sent(bytes: Vec<u8>, ports: &[PortSpec]) -> Outcome {
    ended(bytes, ports).unwrap()
}

/// How a source ends, after bytes that one sender sends before it closes.
fn ended(bytes: Vec<u8>, ports: &[PortSpec]) -> Result<Outcome, String> {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let sender = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(&bytes).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        // The source reads to the end before this side closes, or leaves before.
        let _ = std::io::copy(&mut stream, &mut std::io::sink());
    });
    let ran = take_all(&mut source(address, |_| {}), &mut context(ports));
    sender.join().unwrap();
    ran
}

fn messages(messages: &[Message]) -> Vec<u8> {
    messages.iter().flat_map(|message| message.to_bytes().unwrap()).collect()
}

fn pose(x: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(x, 20.0, -30.0), Vector3::new(0.3, -0.2, 0.9))
}

fn transform(device: &str, stamp_ns: StampNs, x: f64) -> Message {
    Message::new(device, stamp_ns, Body::Transform(Affine::of(&pose(x))))
}

fn value<T: Clone + 'static>(emission: &Emission) -> T {
    match emission {
        Emission::Value(value) => value.get::<T>().unwrap().clone(),
        other => panic!("no value: {other:?}"),
    }
}

fn reason(emission: &Emission) -> &str {
    match emission {
        Emission::Empty(reason) => reason,
        other => panic!("no empty: {other:?}"),
    }
}

fn stylus() -> PortSpec {
    ("stylus", "geometry/Pose", json!({ "device": "StylusToReference", "to": "world", "from": "stylus_marker" }))
}

/// The error of ports that cannot be read.
fn fault(ports: &[PortSpec]) -> String {
    OpenIgtLink::ports(&context(ports).declared()).map(drop).unwrap_err().to_string()
}

#[test]
fn ten_thousand_transforms_arrive_in_order_between_a_thousand_random_messages() {
    let mut bytes = Vec::new();
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    for i in 0..10_000 {
        bytes.extend(transform("StylusToReference", STAMP + i * MS, i as f64 * 0.01).to_bytes().unwrap());
        match i % 10 {
            // Random bytes.
            0 => bytes.extend((0..200).map(|_| random())),
            // Half a message.
            5 => bytes.extend(&transform("StylusToReference", STAMP, 0.0).to_bytes().unwrap()[..80]),
            // A message whose body was changed.
            7 => {
                let mut changed = transform("StylusToReference", STAMP, 0.0).to_bytes().unwrap();
                changed[70] ^= 0x40;
                bytes.extend(changed);
            }
            _ => {}
        }
    }
    let ran = sent(bytes, &[stylus()]);
    assert_eq!(ran.items.len(), 10_000);
    for (i, (stamp_ns, emission)) in ran.of_port(0).into_iter().enumerate() {
        let found: Pose = value(emission);
        assert_eq!((stamp_ns, found.stamp_ns), (STAMP + i as i64 * MS, stamp_ns));
        assert!((found.isometry.translation.x - i as f64 * 0.01).abs() < 1e-5, "message {i}");
        assert_eq!((found.to.as_str(), found.from.as_str()), ("world", "stylus_marker"));
    }
    let n_damages = ran.warnings.iter().filter(|w| w.contains("out of step") || w.contains("CRC")).count();
    assert!((2..=20).contains(&n_damages), "reported, but not without end: {:#?}", ran.warnings);
}

#[test]
fn every_type_reaches_a_port_of_its_payload() {
    let quaternion = Some(pose(1.0).rotation.coords.map(|c| c as f32).into());
    let position = Position { name: String::new(), position: [1.0, 20.0, -30.0], quaternion };
    let tool = TrackedTool { name: "ProbeToWorld".into(), kind: 2, matrix: Affine::of(&pose(2.0)) };
    let triangle = PolyData {
        points: vec![[0.0; 3], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [10.0, 10.0, f32::NAN]],
        polygons: Cells::new([[0, 1, 2]]),
        ..PolyData::default()
    };
    let mesh = PolyData { points: triangle.points[..3].to_vec(), ..triangle.clone() };
    let points = vec![Fiducial::new("M1", [5.0, 6.0, 7.0]), Fiducial::new("M2", [1.0, 2.0, 30.0])];
    let all = [
        Message::new("Simulated", STAMP, Body::Text("true".into())),
        transform("StylusToReference", STAMP, 0.0),
        Message::new("PointerToWorld", STAMP, Body::Positions(vec![position])),
        Message::new("Tracker", STAMP, Body::Tracking(vec![tool])),
        Message::new("Scan", STAMP, Body::PolyData(triangle)),
        Message::new("Touched", STAMP, Body::Points(points.clone())),
        Message::new("Bone", STAMP, Body::PolyData(mesh)),
        Message::new("Roi", STAMP, Body::Points(points)),
        Message::new("Note", STAMP, Body::Text("here".into())),
        Message::new("Camera", STAMP, Body::Status(Status::new(13, "warm", "warming up"))),
    ];
    let ports = [
        stylus(),
        ("pointer", "geometry/Pose", json!({ "to": "world", "from": "pointer" })),
        ("probe", "geometry/Pose", json!({ "to": "world", "from": "probe" })),
        ("scan", "geometry/Cloud", json!({ "device": "Scan", "frame": "camera" })),
        ("cloud", "geometry/Cloud", json!({ "device": "Touched", "frame": "world" })),
        ("touched", "geometry/Points", json!({ "device": "Touched", "frame": "world" })),
        ("bone", "geometry/Mesh", json!({ "device": "Bone", "frame": "phantom" })),
        ("roi", "geometry/Region", json!({ "device": "Roi", "frame": "camera" })),
        ("note", "report/Text", json!({ "devices": ["Note", "Camera"] })),
        ("simulated", "report/Flag", json!({ "device": "Simulated", "default": false })),
        ("tracked", "report/Flag", json!({ "default": true })),
    ];
    let ran = sent(messages(&all), &ports);
    let one = |port: usize| ran.of_port(port)[0].1;
    for (port, x) in [(0, 0.0), (1, 1.0), (2, 2.0)] {
        let found: Pose = value(one(port));
        assert!((found.isometry.to_homogeneous() - pose(x).to_homogeneous()).amax() < 1e-5, "port {port}");
    }
    let scan: Cloud = value(one(3));
    assert_eq!((scan.len(), scan.frame.as_str(), scan.viewpoint), (3, "camera", Some(Isometry3::identity())));
    assert!(ran.warnings.iter().any(|w| w == "Scan: 1 of 4 points are NaN or infinite and were left out"));
    let cloud: Cloud = value(one(4));
    assert_eq!((cloud.points()[0], cloud.viewpoint), (Point3::new(5.0, 6.0, 7.0), None));
    let touched: Points = value(one(5));
    assert_eq!((&*touched.points[1].name, touched.points[1].stamp_ns), ("M2", STAMP));
    assert_eq!(value::<Mesh>(one(6)).faces().len(), 1);
    let roi: Region = value(one(7));
    assert_eq!((roi.min, roi.max), (Point3::new(1.0, 2.0, 7.0), Point3::new(5.0, 6.0, 30.0)));
    let notes: Vec<TextPayload> = ran.of_port(8).iter().map(|(_, emission)| value(emission)).collect();
    assert_eq!(notes, [TextPayload("here".into()), TextPayload("13 warm: warming up".into())]);
    assert_eq!((value::<Flag>(one(9)), value::<Flag>(one(10))), (Flag(true), Flag(true)));
}

#[test]
fn a_tool_that_plus_calls_lost_is_unknown_in_each_way_of_saying_it() {
    let said = |key: &str, text: &str| vec![Metadata::new(key, text)];
    let tools = |name: &str, x| TrackedTool { name: name.into(), kind: 2, matrix: Affine::of(&pose(x)) };
    let tracked = Body::Tracking(vec![tools("StylusToReference", 5.0), tools("ProbeToReference", 6.0)]);
    let all = [
        transform("StylusToReference", STAMP, 0.0).extended(0, said("TransformStatus", "OUT_OF_VIEW")),
        transform("StylusToReference", STAMP + MS, 1.0).extended(0, said("TransformValid", "False")),
        transform("StylusToReference", STAMP + 2 * MS, 2.0).extended(0, said("Status", "INVALID")),
        Message::new("T", STAMP + 3 * MS, tracked).extended(0, said("StylusToReferenceStatus", "MISSING")),
        transform("StylusToReference", STAMP + 4 * MS, 4.0).extended(0, said("TransformStatus", "OK")),
    ];
    let probe = ("probe", "geometry/Pose", json!({ "device": "ProbeToReference", "to": "world", "from": "probe" }));
    let ran = sent(messages(&all), &[stylus(), probe]);
    let stylus = ran.of_port(0);
    let reasons: Vec<_> = stylus[..4].iter().map(|(_, emission)| reason(emission)).collect();
    assert_eq!(
        reasons,
        [
            "StylusToReference is lost: TransformStatus is OUT_OF_VIEW",
            "StylusToReference is lost: TransformValid is False",
            "StylusToReference is lost: Status is INVALID",
            "StylusToReference is lost: StylusToReferenceStatus is MISSING",
        ]
    );
    assert!((value::<Pose>(stylus[4].1).isometry.translation.x - 4.0).abs() < 1e-5);
    assert!((value::<Pose>(ran.of_port(1)[0].1).isometry.translation.x - 6.0).abs() < 1e-5, "the other tool is seen");
}

#[test]
fn an_exact_identity_is_a_lost_tool_unless_the_port_says_otherwise() {
    let identity = Body::Transform(Affine::of(&Isometry3::identity()));
    let message = messages(&[Message::new("StylusToReference", STAMP, identity)]);
    let ran = sent(message.clone(), &[stylus()]);
    assert!(reason(ran.of_port(0)[0].1).starts_with("StylusToReference is lost: it is the identity"));
    let mut stylus = stylus();
    stylus.2["identity_is_lost"] = json!(false);
    let ran = sent(message, &[stylus]);
    assert_eq!(value::<Pose>(ran.of_port(0)[0].1).isometry, Isometry3::identity());
}

#[test]
fn a_pose_that_is_repeated_to_the_last_bit_is_lost_and_reported_once() {
    let frozen: Vec<_> = (0..100).map(|i| transform("StylusToReference", STAMP + i * 50 * MS, 1.0)).collect();
    let ran = sent(messages(&frozen), &[stylus()]);
    assert_eq!(ran.items.len(), 100);
    let frozen = "StylusToReference is frozen: its pose has been the same to the last bit";
    let reports = ran.warnings.iter().filter(|w| w.contains(frozen)).count();
    assert_eq!(reports, 1, "{:?}", ran.warnings);
    let poses = ran.of_port(0);
    assert!((value::<Pose>(poses[39].1).isometry.translation.x - 1.0).abs() < 1e-5, "up to 2 s");
    assert!(poses[40..].iter().all(|(_, emission)| reason(emission).starts_with(frozen)), "as for a lost marker");
}

#[test]
fn a_tool_that_is_no_longer_sent_is_lost_at_the_limit_and_found_again() {
    let mut all = vec![transform("StylusToReference", STAMP, 0.0)];
    all.extend((1..20).map(|i| transform("CameraMarkerToWorld", STAMP + i * 50 * MS, 0.0)));
    all.push(transform("StylusToReference", STAMP + 1000 * MS, 7.0));
    let mut stylus = stylus();
    stylus.2["lost_after_ms"] = json!(200.0);
    let camera = ("camera", "geometry/Pose", json!({ "to": "world", "from": "camera_marker" }));
    let ran = sent(messages(&all), &[stylus, camera]);
    let stylus = ran.of_port(0);
    assert_eq!(stylus.iter().map(|(stamp_ns, _)| stamp_ns - STAMP).collect::<Vec<_>>(), [0, 200 * MS, 1000 * MS]);
    assert_eq!(reason(stylus[1].1), "StylusToReference was not sent for 0.20 s");
    assert!(ran.items.is_sorted_by_key(|item| item.0), "stamps never decrease");
}

#[test]
fn matrices_that_are_no_rigid_motion_are_refused_by_device_and_number_and_the_next_is_used() {
    let mut mirrored = Affine::of(&pose(0.0));
    (0..4).for_each(|column| mirrored.0[3 * column] *= -1.0);
    let mut scaled = Affine::of(&pose(0.0));
    scaled.0[..9].iter_mut().for_each(|c| *c *= 1.01);
    let bad = |affine: Affine| Message::new("StylusToReference", STAMP, Body::Transform(affine));
    let all = [
        transform("StylusToReference", STAMP, 0.0),
        bad(mirrored),
        bad(scaled),
        bad(Affine([f32::NAN; 12])),
        bad(Affine([0.0; 12])),
        transform("StylusToReference", STAMP, 5.0),
    ];
    let ran = sent(messages(&all), &[stylus()]);
    let found = ran.of_port(0);
    for (k, part) in [(1, "mirror image"), (2, "not a rotation"), (3, "not finite"), (4, "zero")] {
        let reason = reason(found[k].1);
        assert!(reason.starts_with(&format!("StylusToReference, message {}: ", k + 1)), "{reason}");
        assert!(reason.contains(part), "{reason}");
        assert!(ran.warnings.iter().any(|warning| warning == reason), "{reason} is no warning");
    }
    assert!((value::<Pose>(found[5].1).isometry.translation.x - 5.0).abs() < 1e-5);
}

#[test]
fn single_precision_is_not_reported_and_a_rounded_rotation_is() {
    let mut rounded = Affine::of(&pose(0.0));
    rounded.0[..9].iter_mut().for_each(|c| *c = (*c * 1000.0).round() / 1000.0);
    let ran = sent(messages(&[transform("StylusToReference", STAMP, 0.0)]), &[stylus()]);
    assert_eq!(ran.warnings, Vec::<String>::new());
    let ran = sent(messages(&[Message::new("StylusToReference", STAMP, Body::Transform(rounded))]), &[stylus()]);
    assert!(ran.warnings[0].starts_with("StylusToReference: a rotation is rounded"), "{:?}", ran.warnings);
}

#[test]
fn coordinates_of_a_patient_are_turned_from_ras_and_never_mirrored() {
    let cloud = PolyData::of_points(vec![[1.0, 2.0, 3.0], [-40.0, 5.0, 6.0], [7.0, -80.0, 9.0]]);
    let message = [
        Message::new("Scan", STAMP, Body::PolyData(cloud)),
        Message::new("ReferenceToRas", STAMP, Body::Transform(Affine::of(&pose(10.0)))),
    ];
    let found = |space: &str| {
        let cloud = ("scan", "geometry/Cloud", json!({ "device": "Scan", "frame": "ct", "space": space }));
        let params = json!({ "device": "ReferenceToRas", "to": "ct", "from": "world", "space": space });
        let ran = sent(messages(&message), &[cloud, ("pose", "geometry/Pose", params)]);
        (value::<Cloud>(ran.of_port(0)[0].1), value::<Pose>(ran.of_port(1)[0].1))
    };
    let (lps, t_lps) = found("lps");
    let (ras, t_ras) = found("ras");
    assert_eq!(lps.points()[0], Point3::new(1.0, 2.0, 3.0));
    assert_eq!(ras.points()[0], Point3::new(-1.0, -2.0, 3.0));
    assert!((t_lps.isometry.translation.vector - Vector3::new(10.0, 20.0, -30.0)).norm() < 1e-5);
    assert!((t_ras.isometry.translation.vector - Vector3::new(-10.0, -20.0, -30.0)).norm() < 1e-5);
    // A mirror image would have the opposite volume.
    let volume = |c: &Cloud| {
        let [a, b, c] = [0, 1, 2].map(|k| c.points()[k].coords);
        a.dot(&b.cross(&c))
    };
    assert!((volume(&lps) - volume(&ras)).abs() < 1e-9 && volume(&lps).abs() > 100.0);
}

#[test]
fn ports_that_would_be_wrong_in_silence_are_refused() {
    let cloud = |params| ("scan", "geometry/Cloud", params);
    let of_pose = |params| ("p", "geometry/Pose", params);
    let ct = fault(&[cloud(json!({ "device": "Scan", "frame": "ct" }))]);
    assert!(ct.contains("set space = \"ras\""), "{ct}");
    let world = fault(&[cloud(json!({ "device": "Scan", "frame": "world", "space": "ras" }))]);
    assert!(world.contains("space is for coordinates in ct alone"), "{world}");
    assert!(fault(&[cloud(json!({ "device": "Scan" }))]).contains("frame is not given"));
    assert!(fault(&[cloud(json!({ "frame": "camera" }))]).contains("neither device nor devices"));
    let swapped = fault(&[of_pose(json!({ "device": "WorldToStylus", "to": "world", "from": "stylus" }))]);
    assert!(swapped.contains("swap to and from"), "{swapped}");
    let long = fault(&[of_pose(json!({ "to": "tracker", "from": "phantom_marker" }))]);
    assert!(long.contains("PhantomMarkerToTracker") && long.contains("20 at most"), "{long}");
    let same = json!({ "device": "StylusToReference", "to": "world", "from": "stylus" });
    let twice = fault(&[of_pose(same.clone()), ("q", "geometry/Pose", same)]);
    assert!(twice.contains("ports \"p\" and \"q\" both read geometry/Pose of StylusToReference"), "{twice}");
    assert!(fault(&[("t", "geometry/Axes", json!({}))]).contains("but not geometry/Axes"));
}

#[test]
fn a_device_that_does_not_come_is_reported_with_those_that_do() {
    let ran = sent(messages(&[transform("ProbeToReference", STAMP, 0.0)]), &[stylus()]);
    assert_eq!(ran.items.len(), 0, "another tool's pose is not the stylus'");
    assert_eq!(ran.warnings, ["port \"stylus\": StylusToReference has not come; unread are ProbeToReference"]);
}

#[test]
fn a_cloud_in_metres_is_suspected() {
    let metres = PolyData::of_points((0..100).map(|k| [0.001 * k as f32, 0.2, 0.3]).collect());
    let port = ("scan", "geometry/Cloud", json!({ "device": "Scan", "frame": "camera" }));
    let ran = sent(messages(&[Message::new("Scan", STAMP, Body::PolyData(metres))]), &[port]);
    assert_eq!(ran.warnings, ["Scan: 100 points within 2 mm; is the cloud in metres?"]);
}

#[test]
fn a_jump_of_the_senders_clock_is_reported_and_its_stamps_stay() {
    let jump = 3600 * 1000 * MS;
    let all: Vec<_> =
        (0..60).map(|i| transform("StylusToReference", STAMP + i * MS + if i < 30 { 0 } else { jump }, 0.0)).collect();
    let ran = sent(messages(&all), &[stylus()]);
    assert_eq!(ran.items.last().unwrap().0, STAMP + 59 * MS + jump);
    let jumps: Vec<_> = ran.warnings.iter().filter(|w| w.contains("its clock jumped by 3600.")).collect();
    assert_eq!(jumps.len(), 1, "{:?}", ran.warnings);
}

#[test]
fn a_message_without_a_stamp_gets_the_time_of_its_arrival() {
    let ran = sent(messages(&[transform("StylusToReference", 0, 0.0)]), &[stylus()]);
    assert!(ran.items[0].0 > STAMP, "{}", ran.items[0].0);
    assert!(ran.warnings[0].contains("StylusToReference has no stamp"), "{:?}", ran.warnings);
}

#[test]
fn equal_transforms_of_one_stamp_are_one_and_those_that_contradict_are_told_once() {
    let all = [(0, 1.0), (0, 1.0), (1, 1.0), (1, 4.0), (2, 1.0), (2, 9.0)];
    let all = all.map(|(k, x)| transform("StylusToReference", STAMP + k * MS, x));
    let ran = sent(messages(&all), &[stylus()]);
    assert_eq!(ran.items.len(), 5, "the second is the first once more");
    let told: Vec<_> = ran.warnings.iter().filter(|warning| warning.contains("contradict")).collect();
    assert_eq!(told.len(), 1, "{:?}", ran.warnings);
    let words = format!(
        "StylusToReference: 1 stamp has poses that contradict each other, first at {} ns, up to 3.00 mm",
        STAMP + MS
    );
    assert!(told[0].contains(&words), "{}", told[0]);
    // Without stamps of the sender's they share a time of arrival by chance.
    let all = [1.0, 4.0].map(|x| transform("StylusToReference", 0, x));
    let ran = sent(messages(&all), &[stylus()]);
    assert!(
        ran.items.len() == 2 && !ran.warnings.iter().any(|warning| warning.contains("contradict")),
        "{:?}",
        ran.warnings
    );
}

#[test]
fn a_server_takes_one_sender_at_a_time_and_reports_the_second() {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let connect = move || {
        let until = Instant::now() + Duration::from_secs(10);
        loop {
            match TcpStream::connect(address) {
                Ok(stream) => break stream,
                Err(error) => assert!(Instant::now() < until, "{error}"),
            }
            thread::sleep(Duration::from_millis(10));
        }
    };
    let senders = thread::spawn(move || {
        let mut first = connect();
        first.write_all(&transform("StylusToReference", STAMP, 1.0).to_bytes().unwrap()).unwrap();
        thread::sleep(Duration::from_millis(300));
        let mut second = connect();
        // The second may be closed before it has written.
        let _ = second.write_all(&transform("StylusToReference", STAMP + MS, 99.0).to_bytes().unwrap());
        thread::sleep(Duration::from_millis(300));
        first.write_all(&transform("StylusToReference", STAMP + 2 * MS, 2.0).to_bytes().unwrap()).unwrap();
    });
    let mut source = source(address, |params| params.role = Role::Server);
    let ran = take_all(&mut source, &mut context(&[stylus()])).unwrap();
    senders.join().unwrap();
    let found: Vec<f64> = ran.items.iter().map(|(_, _, e)| value::<Pose>(e).isometry.translation.x.round()).collect();
    assert_eq!(found, [1.0, 2.0]);
    assert!(ran.warnings.iter().any(|w| w.contains("was turned away")), "{:?}", ran.warnings);
}

#[test]
fn a_lost_connection_makes_poses_unknown_and_is_waited_for() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let sender = thread::spawn(move || {
        for i in 0..2 {
            let (mut stream, _) = listener.accept().unwrap();
            stream.write_all(&transform("StylusToReference", STAMP + i * MS, i as f64).to_bytes().unwrap()).unwrap();
        }
    });
    let mut source = source(address, |params| params.network.reconnect = true);
    let ran = take_until(&mut source, &mut context(&[stylus()]), |ran| ran.items.len() == 3);
    let (found, warnings): (Vec<_>, _) = (ran.items.into_iter().map(|(_, _, item)| item).collect(), ran.warnings);
    sender.join().unwrap();
    assert!(matches!(found[0], Emission::Value(_)) && matches!(found[2], Emission::Value(_)));
    let lost = reason(&found[1]);
    assert!(lost.starts_with("StylusToReference: ") && lost.contains("connection"), "{lost}");
    assert!(warnings.iter().any(|w| w.contains("waiting for the sender again")), "{warnings:?}");
    assert!(warnings.iter().any(|w| w.starts_with("connected again, with 127.0.0.1")), "{warnings:?}");
}

#[test]
fn a_source_says_that_it_reads_header_version_2_and_asks_for_tracking_data() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let sender = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let (mut decoder, mut found, mut buffer) = (Decoder::default(), Vec::new(), [0; 1024]);
        while found.len() < 2 {
            let n = std::io::Read::read(&mut stream, &mut buffer).unwrap();
            assert!(n > 0, "closed after {found:?}");
            decoder.push(&buffer[..n]);
            found.extend(decoder.by_ref().map(Result::unwrap));
        }
        found
    });
    take_all(&mut source(address, |params| params.tdata_ms = Some(50)), &mut context(&[stylus()])).unwrap();
    let found = sender.join().unwrap();
    assert!(found.iter().all(|message| message.extended.is_some()), "{found:?}");
    assert!(matches!(&found[0].body, Body::Status(status) if status.code == Status::OK), "{found:?}");
    assert_eq!(found[1].body, Body::StartTracking { interval_ms: 50, coordinates: String::new() });
}

#[test]
fn no_sender_within_the_timeout_is_an_error_that_names_the_address() {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    for (role, part) in [(Role::Client, "is the server running there?"), (Role::Server, "no sender connected to")] {
        let mut source = source(address, |params| (params.network.timeout_s, params.role) = (0.3, role));
        let error = take_all(&mut source, &mut context(&[stylus()])).unwrap_err();
        assert!(error.contains(part) && error.contains(&address.to_string()), "{error}");
    }
    assert!(OpenIgtLink::peer(&Params { address: "tracker".into(), ..Params::default() }).is_err());
}

fn scan_port() -> PortSpec {
    ("scan", "geometry/Cloud", json!({ "device": "Scan", "frame": "camera" }))
}

fn intrinsics() -> serde_json::Value {
    json!([500.0, 400.0, 1.0, 0.5])
}

fn image(body: PixelImage) -> Vec<u8> {
    messages(&[Message::new("Scan", STAMP, Body::Image(body))])
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The error with which a source ends, after these bytes and an end in order.
fn failed(bytes: Vec<u8>, ports: &[PortSpec]) -> String {
    ended(bytes, ports).unwrap_err()
}

#[test]
fn a_point_image_is_a_cloud_of_the_pixels_that_have_a_point() {
    let values = [1.0, 2.0, 300.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 1.0, -4.0, 5.0, 310.0];
    let body = PixelImage::new([2, 2], 3, Scalar::F32, floats(&values));
    let ran = sent(image(body.clone()), &[scan_port()]);
    let cloud: Cloud = value(ran.of_port(0)[0].1);
    assert_eq!(cloud.points(), [Point3::new(1.0, 2.0, 300.0), Point3::new(-4.0, 5.0, 310.0)]);
    assert_eq!((cloud.frame.as_str(), cloud.stamp_ns), ("camera", STAMP));
    assert_eq!(cloud.viewpoint, Some(Isometry3::identity()));
    assert_eq!(ran.warnings, Vec::<String>::new(), "pixels without a point are not worth a word");
    let wrong = PixelImage {
        is_little_endian: false,
        pixels: floats(&[1.0, 2.0, 300.0]),
        ..PixelImage::new([1, 1], 3, Scalar::F32, vec![])
    };
    let ran = sent(image(wrong), &[scan_port()]);
    let said = reason(ran.of_port(0)[0].1);
    assert!(
        said.contains("mm with the highest byte first, as it states, and 300.0 mm with the lowest first"),
        "{said}"
    );
    let body = PixelImage { pixels: floats(&[0.0; 12]), ..body };
    let ran = sent(image(body), &[scan_port()]);
    assert_eq!(reason(ran.of_port(0)[0].1), "Scan, message 1: none of its 4 pixels has a point");
}

#[test]
fn the_matrix_of_a_point_image_moves_its_points_only_if_asked() {
    // A quarter turn about z; the centre of one pixel is the pixel.
    let matrix = Affine([0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 10.0, 20.0, 30.0]);
    let body = PixelImage { matrix, ..PixelImage::new([1, 1], 3, Scalar::F32, floats(&[1.0, 2.0, 3.0])) };
    let ran = sent(image(body.clone()), &[scan_port()]);
    assert_eq!(value::<Cloud>(ran.of_port(0)[0].1).points(), [Point3::new(1.0, 2.0, 3.0)]);
    assert!(ran.warnings[0].contains("set use_matrix = true if it takes them to camera"), "{:?}", ran.warnings);
    let mut port = scan_port();
    port.2["use_matrix"] = json!(true);
    let ran = sent(image(body.clone()), &[port.clone()]);
    let moved = value::<Cloud>(ran.of_port(0)[0].1).points()[0];
    assert!((moved - Point3::new(8.0, 21.0, 33.0)).norm() < 1e-6, "{moved}");
    let scaled = PixelImage { matrix: Affine(matrix.0.map(|c| 0.2 * c)), ..body };
    let ran = sent(image(scaled), &[port]);
    assert!(reason(ran.of_port(0)[0].1).contains("its matrix is no rigid motion"), "{:?}", ran.items);
}

#[test]
fn a_depth_image_is_placed_by_the_intrinsics_of_the_port() {
    let depths: Vec<u8> = [3000u16, 0, 3100, 3200, 3300, 0].iter().flat_map(|depth| depth.to_le_bytes()).collect();
    let body = PixelImage::new([3, 2], 1, Scalar::U16, depths);
    let mut port = scan_port();
    port.2["intrinsics"] = intrinsics();
    port.2["depth_unit_mm"] = json!(0.1);
    let ran = sent(image(body.clone()), &[port.clone()]);
    let cloud: Cloud = value(ran.of_port(0)[0].1);
    let expected = [(0.0, 0.0, 300.0), (2.0, 0.0, 310.0), (0.0, 1.0, 320.0), (1.0, 1.0, 330.0)]
        .map(|(u, v, z)| Point3::new((u - 1.0) / 500.0 * z, (v - 0.5) / 400.0 * z, z));
    assert_eq!(cloud.len(), 4);
    for (found, expected) in cloud.points().iter().zip(expected) {
        assert!((found - expected).norm() < 1e-9, "{found} is not {expected}");
    }
    // A part of a larger image keeps its place in it.
    let part = PixelImage { size: [13, 12, 1], part_offset: [10, 10, 0], ..body.clone() };
    let moved: Cloud = value(sent(image(part), &[port]).of_port(0)[0].1);
    assert!((moved.points()[0] - Point3::new(9.0 / 500.0 * 300.0, 9.5 / 400.0 * 300.0, 300.0)).norm() < 1e-9);
    let error = failed(image(body), &[scan_port()]);
    assert_eq!(
        error,
        "port \"scan\": Scan sends an IMAGE of 3 x 2 pixels of 1 uint16: depth, for which the port needs intrinsics = [fx, fy, cx, cy] and depth_unit_mm, the depth of one step (0.1 for Revopoint, 1 for Kinect and RealSense)"
    );
}

#[test]
fn the_distortion_of_a_port_is_undone_along_the_ray() {
    // What OpenCV 5.0.0 (cv2.projectPoints) sees of x / z = 0.3, y / z = -0.2.
    let (distortion, [x, y]) = ([-0.28, 0.09, 0.0011, -0.0007, -0.012], [0.289_179_390_8, -0.192_703_927_2]);
    let depths: Vec<u8> = [0u16, 3000, 0, 0, 0, 0].iter().flat_map(|depth| depth.to_le_bytes()).collect();
    let body = PixelImage::new([3, 2], 1, Scalar::U16, depths);
    let mut port = scan_port();
    port.2["intrinsics"] = json!([500.0, 400.0, 1.0 - 500.0 * x, -400.0 * y]);
    port.2["depth_unit_mm"] = json!(0.1);
    port.2["distortion"] = json!(distortion);
    let cloud: Cloud = value(sent(image(body), &[port.clone()]).of_port(0)[0].1);
    assert!((cloud.points()[0] - Point3::new(90.0, -60.0, 300.0)).norm() < 1e-6, "{}", cloud.points()[0]);
    let refused = |key: &str, value: serde_json::Value| {
        let mut port = port.clone();
        port.2[key] = value;
        fault(&[port])
    };
    assert!(refused("distortion", json!([0.1, 0.2])).contains("has 2 coefficients, 4, 5 or 8 are expected"));
    assert!(refused("distortion_model", json!("fisheye62")).contains("\"fisheye62\" is not read"));
    assert!(refused("intrinsics", json!([])).contains("whose intrinsics are not given"));
}

#[test]
fn pictures_are_grey_or_colour_and_no_cloud() {
    let port = ("image", "geometry/Image", json!({ "device": "Scan", "frame": "camera", "intrinsics": intrinsics() }));
    for (n_components, channels, expected) in [
        (1, 1, vec![0, 1, 2, 3, 4, 5]),
        (3, 3, (0..18).collect()),
        (4, 3, vec![0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 18, 20, 21, 22]),
    ] {
        let bytes = (0..6 * n_components).collect();
        let body = PixelImage::new([3, 2], n_components, Scalar::U8, bytes);
        let ran = sent(image(body.clone()), std::slice::from_ref(&port));
        let found: Image = value(ran.of_port(0)[0].1);
        assert_eq!((found.width(), found.height(), found.channels()), (3, 2, channels));
        assert_eq!((found.pixels(), found.stamp_ns, found.intrinsics().fx), (&expected[..], STAMP, 500.0));
        let error = failed(image(body), &[scan_port()]);
        assert!(error.contains("a picture is of type = \"geometry/Image\""), "{error}");
    }
    let depth = PixelImage::new([3, 2], 1, Scalar::U16, vec![0; 12]);
    let error = failed(image(depth), &[port]);
    assert!(error.contains("3 x 2 pixels of 1 uint16, and geometry/Image is of 1, 3 or 4 uint8"), "{error}");
    let error = fault(&[("image", "geometry/Image", json!({ "device": "Scan", "frame": "camera" }))]);
    assert!(error.contains("intrinsics are not given, and no IMAGE has them"), "{error}");
    let mut pose = stylus();
    pose.2["depth_unit_mm"] = json!(0.1);
    assert!(fault(&[pose]).contains("are for images, and the port is of geometry/Pose"));
}

#[test]
fn a_device_that_sends_another_type_than_its_port_reads_is_a_fault_by_name() {
    let scan =
        || Message::new("StylusToReference", STAMP, Body::Image(PixelImage::new([1, 1], 3, Scalar::F32, vec![0; 12])));
    let error = failed(messages(&[scan()]), &[stylus()]);
    assert_eq!(
        error,
        "port \"stylus\": StylusToReference sends IMAGE, which gives no geometry/Pose; a port of geometry/Cloud or geometry/Image reads it"
    );
    let error = failed(messages(&[transform("Scan", STAMP, 0.0)]), &[scan_port()]);
    assert!(
        error.contains("Scan sends TRANSFORM, which gives no geometry/Cloud; a port of geometry/Pose reads it"),
        "{error}"
    );
    // A device may send two types, of which the port reads one.
    let ran = sent(messages(&[scan(), transform("StylusToReference", STAMP, 0.0)]), &[stylus()]);
    assert_eq!(ran.items.len(), 1);
}

#[test]
fn devices_that_no_port_reads_are_listed_with_their_types() {
    let body = Body::Image(PixelImage::new([1, 1], 1, Scalar::U8, vec![0]));
    let all = [
        transform("StylusToReference", STAMP, 0.0),
        transform("ProbeToReference", STAMP, 0.0),
        Message::new("Video", STAMP, body),
    ];
    let ran = sent(messages(&all), &[stylus()]);
    assert_eq!(ran.warnings, ["no port reads ProbeToReference (TRANSFORM), Video (IMAGE)"]);
}

#[test]
fn stamps_are_corrected_by_the_offset_of_the_senders_clock_and_by_that_after_a_jump() {
    // A sender an hour behind that sends at the times of its stamps, and then at once an hour and a half behind.
    let (slow, jump) = (3600 * 1000 * MS, 1800 * 1000 * MS);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let now_ns = || std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as StampNs;
    let sender = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut sent_at = Vec::new();
        for k in 0..60 {
            let now = now_ns();
            let behind = if k < 30 { slow } else { slow - jump };
            stream
                .write_all(
                    &transform("StylusToReference", now - behind, 300.0 + 0.01 * f64::from(k)).to_bytes().unwrap(),
                )
                .unwrap();
            sent_at.push(now);
            thread::sleep(Duration::from_millis(10));
        }
        sent_at
    });
    let ran =
        take_all(&mut source(address, |params| params.clock = Clock::Receiver), &mut context(&[stylus()])).unwrap();
    let sent_at = sender.join().unwrap();
    assert_eq!(ran.items.len(), 60, "{:?}", ran.warnings);
    for ((stamp_ns, _, _), sent_ns) in ran.items.iter().zip(sent_at) {
        // The shortest delay of a message on one machine.
        assert!((stamp_ns - sent_ns).abs() < 200 * MS, "{} ms off", (stamp_ns - sent_ns) / MS);
    }
    let told = ran.warnings.iter().filter(|w| w.starts_with("stamps are corrected by 3600.")).count();
    assert_eq!(told, 1, "{:?}", ran.warnings);
    let jumped =
        ran.warnings.iter().any(|w| w.contains("jumped") && w.ends_with("; stamps are corrected by the new offset"));
    assert!(jumped, "{:?}", ran.warnings);
}

#[test]
fn few_messages_wait_a_second_for_the_offset_and_keep_their_order() {
    let all: Vec<_> = (0..3).map(|k| transform("StylusToReference", STAMP + k * MS, k as f64)).collect();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let sender = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(&messages(&all)).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let _ = std::io::copy(&mut stream, &mut std::io::sink());
    });
    let ran =
        take_all(&mut source(address, |params| params.clock = Clock::Receiver), &mut context(&[stylus()])).unwrap();
    sender.join().unwrap();
    let stamps: Vec<_> = ran.items.iter().map(|item| item.0 - ran.items[0].0).collect();
    assert_eq!(stamps, [0, MS, 2 * MS], "{:?}", ran.warnings);
    assert!(
        ran.items[0].0 > STAMP + 3600 * 1000 * MS,
        "the time of this machine, not of the stamps: {}",
        ran.items[0].0
    );
}
