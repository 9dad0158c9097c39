use super::*;
use osteoflow_formats::openigtlink::Decoder;
use osteoflow_geometry::{NamedPoint, Plane, nalgebra::Vector3};
use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    path::Path,
    sync::Arc,
    thread,
    time::Instant,
};

const STAMP: StampNs = 1_750_000_011_000_000_000;
const MS: StampNs = 1_000_000;

fn verdict(answer: Answer) -> Verdict {
    let mut verdict = Verdict::new(Vec::new(), Vec::new(), None, None, Vec::new());
    (verdict.answer, verdict.sentence) = (answer, "the scan slides".into());
    verdict
}

fn plane() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(10.0, 20.0, 30.0), Vector3::new(0.0, 0.4, 0.0))
}

fn planes(frame: &str) -> Planes {
    Planes::new(frame, vec![Plane::new("plane_top", plane())])
}

fn input(frame: &str, answer: Option<Answer>) -> In {
    let tip = Points::new("world", vec![NamedPoint::new("tip", Point3::new(1.0, 2.0, 3.0))]);
    In {
        planes: Some(planes(frame)),
        registration: Some(Pose::new("ct", "world", plane())),
        points: Some(Points::new("world", vec![NamedPoint::new("P1", Point3::new(4.0, 5.0, 6.0))])),
        tip: Some(tip),
        verdict: answer.map(verdict),
    }
}

fn node(change: impl FnOnce(&mut Params)) -> OpenIgtLink {
    let mut params = Params { address: "127.0.0.1:0".into(), ..Params::default() };
    change(&mut params);
    OpenIgtLink::new(params).unwrap()
}

/// The messages of a firing.
fn fired(node: &mut OpenIgtLink, input: In, stamp_ns: StampNs) -> Vec<Message> {
    let tasks = node.tasks(input, stamp_ns, None).unwrap();
    tasks
        .into_iter()
        .filter_map(|task| if let Task::Send { message, .. } = task { Some(message) } else { None })
        .collect()
}

fn devices(messages: &[Message]) -> Vec<String> {
    messages.iter().map(|message| format!("{} {}", message.body.type_name(), message.device)).collect()
}

fn status_of(messages: &[Message]) -> (u16, String) {
    let status = messages.iter().find_map(|m| if let Body::Status(s) = &m.body { Some(s) } else { None }).unwrap();
    (status.code, format!("{}: {}", status.name, status.message))
}

const ALL: [&str; 6] = [
    "POINT Points",
    "POINT StylusTip",
    "TRANSFORM WorldToRas",
    "TRANSFORM PlaneTopToWorld",
    "POLYDATA PlaneTop",
    "STATUS Osteoflow",
];
const MEASURED: [&str; 3] = ["POINT Points", "POINT StylusTip", "STATUS Osteoflow"];

#[test]
fn planes_and_registration_are_sent_only_while_the_verdict_is_trusted() {
    for (answer, send_doubtful, expected, said) in [
        (Some(Answer::Trusted), false, &ALL[..], (1, "planes sent: trusted: the scan slides")),
        (Some(Answer::Doubtful), false, &MEASURED, (15, "doubtful: the registration is doubtful: the scan slides")),
        (Some(Answer::Doubtful), true, &ALL, (1, "planes sent: doubtful: the scan slides")),
        (Some(Answer::Refused), false, &MEASURED, (15, "refused: the registration is refused: the scan slides")),
        (Some(Answer::Refused), true, &MEASURED, (15, "refused: the registration is refused: the scan slides")),
        (None, false, &MEASURED, (13, "no verdict: there is no verdict on the registration")),
        (None, true, &MEASURED, (13, "no verdict: there is no verdict on the registration")),
    ] {
        let mut node = node(|params| params.send_doubtful = send_doubtful);
        let sent = fired(&mut node, input("world", answer), STAMP);
        assert_eq!(devices(&sent), expected, "{answer:?}, send_doubtful {send_doubtful}");
        assert_eq!(status_of(&sent), (said.0, said.1.to_owned()));
    }
}

#[test]
fn a_verdict_that_changes_stops_the_planes_and_says_so_once() {
    let mut node = node(|_| {});
    fired(&mut node, input("world", Some(Answer::Trusted)), STAMP);
    let doubtful = fired(&mut node, input("world", Some(Answer::Doubtful)), STAMP + 50 * MS);
    assert_eq!(devices(&doubtful), ["POINT StylusTip", "STATUS Osteoflow"]);
    let again = fired(&mut node, input("world", Some(Answer::Doubtful)), STAMP + 100 * MS);
    assert_eq!(devices(&again), ["POINT StylusTip"]);
    let trusted = fired(&mut node, input("world", Some(Answer::Trusted)), STAMP + 150 * MS);
    let expected = ["POINT StylusTip", "TRANSFORM PlaneTopToWorld", "POLYDATA PlaneTop", "STATUS Osteoflow"];
    assert_eq!(devices(&trusted), expected);
}

#[test]
fn a_lost_marker_stops_the_planes_with_its_reason() {
    let mut node = node(|_| {});
    let mut lost = input("world", Some(Answer::Trusted));
    lost.planes = lost.planes.map(|planes| planes.unknown("world", STAMP, "the bone marker was not seen"));
    let sent = fired(&mut node, lost, STAMP);
    assert_eq!(devices(&sent), ["POINT Points", "POINT StylusTip", "TRANSFORM WorldToRas", "STATUS Osteoflow"]);
    assert_eq!(status_of(&sent), (13, "planes unknown: plane_top: the bone marker was not seen".into()));
    let none = In { planes: None, ..input("world", Some(Answer::Trusted)) };
    let tasks = node.tasks(none, STAMP + 50 * MS, Some("marker lost")).unwrap();
    assert!(tasks.iter().any(|task| matches!(task, Task::Withheld)));
}

#[test]
fn planes_in_ct_are_turned_to_ras_and_those_in_world_are_not() {
    let of = |frame: &str| {
        let sent = fired(&mut node(|_| {}), input(frame, Some(Answer::Trusted)), STAMP);
        let to = if frame == "ct" { "PlaneTopToRas" } else { "PlaneTopToWorld" };
        let affine = sent.iter().find_map(|m| match &m.body {
            Body::Transform(affine) if m.device == to => Some(*affine),
            _ => None,
        });
        let corners = sent.iter().find_map(|m| match &m.body {
            Body::PolyData(data) => Some(data.points.clone()),
            _ => None,
        });
        (affine.unwrap().rigid().unwrap().value, corners.unwrap())
    };
    let (world, _) = of("world");
    assert!((world.to_homogeneous() - plane().to_homogeneous()).amax() < 1e-5);
    let (ras, corners) = of("ct");
    // x and y change sign, of the origin and of the normal; z stays. Left as LPS, the plane would be 45 mm away.
    assert!((ras.translation.vector - Vector3::new(-10.0, -20.0, 30.0)).norm() < 1e-5);
    let (sent, planned) = (ras * Vector3::z(), plane() * Vector3::z());
    assert!((sent - Vector3::new(-planned.x, -planned.y, planned.z)).norm() < 1e-6, "{sent}");
    let middle = corners.iter().fold(Vector3::zeros(), |sum, c| sum + Vector3::from(c.map(f64::from))) / 4.0;
    assert!((middle - ras.translation.vector).norm() < 1e-4);
    for corner in corners {
        let corner = Vector3::from(corner.map(f64::from)) - middle;
        assert!(corner.dot(&sent).abs() < 1e-4, "the square lies in its plane");
        assert!((corner.norm() - 60.0 / 2.0_f64.sqrt()).abs() < 1e-3);
    }
}

#[test]
fn the_registration_takes_the_trackers_points_to_ras() {
    let sent = fired(&mut node(|_| {}), input("world", Some(Answer::Trusted)), STAMP);
    let Some(Body::Transform(affine)) = sent.iter().find(|m| m.device == "WorldToRas").map(|m| m.body.clone()) else {
        panic!("no registration: {sent:?}")
    };
    let point_world = Point3::new(100.0, -50.0, 7.0);
    let (found, lps) = (affine.rigid().unwrap().value * point_world, plane() * point_world);
    assert!((found - Point3::new(-lps.x, -lps.y, lps.z)).norm() < 1e-4, "{found} for LPS {lps}");
}

#[test]
fn planes_are_sent_at_most_at_the_stated_rate() {
    let mut node = node(|params| params.rate_hz = 20.0);
    let n = (0..1000)
        .filter(|i| {
            let sent = fired(&mut node, input("world", Some(Answer::Trusted)), STAMP + i * MS);
            devices(&sent).contains(&"TRANSFORM PlaneTopToWorld".to_owned())
        })
        .count();
    assert!((20..=22).contains(&n), "{n} in a second at 20 Hz");
}

/// Reads from a receiver until it has a message that is looked for; `None` at the end of the stream.
fn read_until(stream: &mut TcpStream, decoder: &mut Decoder, is_it: impl Fn(&Message) -> bool) -> Option<Message> {
    let mut buffer = [0; 4096];
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    loop {
        for read in decoder.by_ref() {
            let message = read.unwrap();
            if is_it(&message) {
                return Some(message);
            }
        }
        match stream.read(&mut buffer).unwrap() {
            0 => return None,
            n => decoder.push(&buffer[..n]),
        }
    }
}

fn is_status(message: &Message, name: &str) -> bool {
    matches!(&message.body, Body::Status(status) if status.name == name)
}

#[test]
fn a_receiver_that_comes_late_gets_what_lasts_and_hears_when_planes_are_old_and_when_the_run_ends() {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut node = node(|params| (params.address, params.stale_after_s) = (address.to_string(), 0.3));
    let mut ctx = Context::for_test("navigation").with_out_dir(Some(Arc::from(Path::new("."))));
    let mut fire = |node: &mut OpenIgtLink, stamp_ns| {
        ctx.begin(0, stamp_ns);
        node.process(input("world", Some(Answer::Trusted)), &mut ctx).unwrap();
    };
    fire(&mut node, STAMP);
    thread::sleep(Duration::from_millis(100));
    let mut stream = TcpStream::connect(address).unwrap();
    let mut decoder = Decoder::default();
    let registration = read_until(&mut stream, &mut decoder, |m| m.device == "WorldToRas").unwrap();
    assert_eq!(registration.extended, None, "header version 1 until the receiver has said what it reads");
    let speak = |stream: &mut TcpStream, message: &Message| stream.write_all(&message.to_bytes().unwrap()).unwrap();
    speak(&mut stream, &outlet::status(Status::OK, "ready", "a receiver of header version 2"));
    let registration = read_until(&mut stream, &mut decoder, |m| m.device == "WorldToRas").unwrap();
    assert_eq!(registration.metadata("Verdict"), Some("trusted"));
    let mut old = TcpStream::connect(address).unwrap();
    speak(&mut old, &Message { extended: None, ..outlet::status(Status::OK, "ready", "") });
    let began = Instant::now();
    let is_stale = |m: &Message| is_status(m, "stale");
    let is_plane = |m: &Message| m.device == "PlaneTopToWorld";
    let first = read_until(&mut stream, &mut decoder, |m| is_stale(m) || is_plane(m)).unwrap();
    assert!(is_stale(&first), "old planes are not sent to a late receiver");
    assert!(began.elapsed() < Duration::from_secs(5));
    fire(&mut node, STAMP + 1000 * MS);
    read_until(&mut stream, &mut decoder, is_plane).unwrap();
    read_until(&mut stream, &mut decoder, |m| is_status(m, "planes sent")).unwrap();
    drop(node);
    let last = read_until(&mut stream, &mut decoder, |m| is_status(m, "exiting")).unwrap();
    assert!(matches!(last.body, Body::Status(Status { code: 19, .. })));
    assert_eq!(read_until(&mut stream, &mut decoder, |_| true), None, "the connection is closed");
    let mut decoder = Decoder::default();
    let extended = read_until(&mut old, &mut decoder, |message| message.extended.is_some());
    assert_eq!(extended, None, "one that says version 1 gets no other");
}

#[test]
fn a_client_connects_to_its_receiver_when_that_comes_and_again_when_it_left() {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut node = node(|params| (params.address, params.role) = (address.to_string(), Role::Client));
    let mut ctx = Context::for_test("navigation").with_out_dir(Some(Arc::from(Path::new("."))));
    ctx.begin(0, STAMP);
    node.process(input("world", Some(Answer::Trusted)), &mut ctx).map(drop).unwrap();
    let listener = TcpListener::bind(address).unwrap();
    for _ in 0..2 {
        let (mut stream, _) = listener.accept().unwrap();
        assert!(read_until(&mut stream, &mut Decoder::default(), |m| m.device == "WorldToRas").is_some());
    }
}

#[test]
fn a_receiver_that_reads_nothing_stops_neither_the_node_nor_the_others() {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut node = node(|params| (params.address, params.plane_size_mm) = (address.to_string(), 0.0));
    let mut ctx = Context::for_test("navigation").with_out_dir(Some(Arc::from(Path::new("."))));
    let many: Vec<_> = (0..2000).map(|k| NamedPoint::new(format!("{k}"), Point3::origin())).collect();
    let mut fire = |node: &mut OpenIgtLink, i: i64| {
        ctx.begin(0, STAMP + i * 50 * MS);
        let tip = Some(Points::new("world", many.clone()));
        node.process(In { tip, ..input("world", Some(Answer::Trusted)) }, &mut ctx).unwrap();
    };
    fire(&mut node, 0);
    let _stuck = TcpStream::connect(address).unwrap();
    let mut reader = TcpStream::connect(address).unwrap();
    thread::sleep(Duration::from_millis(200));
    let taken = thread::spawn(move || {
        let mut decoder = Decoder::default();
        read_until(&mut reader, &mut decoder, |m| m.stamp_ns == STAMP - 1 || is_status(m, "exiting")).is_some()
    });
    // 27 MB, more than the buffers of a connection hold.
    let longest = (1..100).map(|i| {
        let began = Instant::now();
        fire(&mut node, i);
        let took = began.elapsed();
        thread::sleep(Duration::from_millis(2));
        took
    });
    let longest = longest.max().unwrap();
    assert!(longest < Duration::from_secs(2), "a firing took {longest:?}");
    drop(node);
    assert!(taken.join().unwrap(), "the other receiver heard the end");
}

#[test]
fn a_replay_sends_nothing_and_an_address_in_use_is_an_error() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut node = node(|params| params.address = taken.local_addr().unwrap().to_string());
    let mut ctx = Context::for_test("navigation");
    node.process(input("world", Some(Answer::Trusted)), &mut ctx).map(drop).unwrap();
    let mut ctx = Context::for_test("navigation").with_out_dir(Some(Arc::from(Path::new("."))));
    let error = node.process(input("world", Some(Answer::Trusted)), &mut ctx).map(drop).unwrap_err().to_string();
    assert!(error.starts_with("cannot listen at 127.0.0.1:"), "{error}");
}
