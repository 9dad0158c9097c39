//! What a source over a network must not get wrong, for each protocol through one helper.

use super::*;
use crate::acquire::{foxglove_ws::FoxgloveWs, openigtlink::OpenIgtLink};
use osteoflow_formats::openigtlink::{self as igtl, Affine, Body, Fiducial};
use osteoflow_geometry::{Points, Pose, nalgebra::Isometry3};
use osteoflow_node::{Outputs, Registry};
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    io::Write,
    net::{SocketAddr, TcpListener},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle},
};
use tungstenite::{
    WebSocket,
    handshake::server::{Request, Response},
};

/// A declared port: name, type and parameters.
pub(crate) type PortSpec = (&'static str, &'static str, Value);

pub(crate) const STAMP: StampNs = 1_750_000_011_000_000_000;
pub(crate) const MS: StampNs = 1_000_000;

/// Longest time for which a test waits.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) fn context(ports: &[PortSpec]) -> Context {
    stoppable(ports, Arc::default())
}

fn stoppable(ports: &[PortSpec], stop: Arc<AtomicBool>) -> Context {
    let mut registry = Registry::default();
    osteoflow_payloads::register(&mut registry);
    let declared = ports.iter().map(|(name, ty, params)| DeclaredPort {
        name: (*name).into(),
        payload: registry.payload_type(ty).unwrap(),
        params: params.clone(),
    });
    Context::new("network", 0, stop, declared.collect::<Vec<_>>().into())
}

/// What a source gave.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    pub(crate) items: Vec<(StampNs, usize, Emission)>,
    pub(crate) warnings: Vec<String>,
    pub(crate) error: Option<String>,
}

impl Outcome {
    /// The items of a port.
    pub(crate) fn of_port(&self, port: usize) -> Vec<(StampNs, &Emission)> {
        self.items.iter().filter(|item| item.1 == port).map(|(stamp, _, emission)| (*stamp, emission)).collect()
    }

    /// The x of the poses of a port, to 1e-9 mm, or why they are unknown.
    pub(crate) fn poses(&self, port: usize) -> Vec<(StampNs, Result<f64, &str>)> {
        fn x(emission: &Emission) -> Result<f64, &str> {
            match emission {
                Emission::Value(value) => Ok((value.get::<Pose>().unwrap().isometry.translation.x * 1e9).round() / 1e9),
                Emission::Empty(reason) => Err(reason),
                other => panic!("{other:?}"),
            }
        }
        self.of_port(port).into_iter().map(|(stamp, emission)| (stamp, x(emission))).collect()
    }

    #[track_caller]
    pub(crate) fn warned(&self, of: &str) {
        assert!(self.n_warned(of) > 0, "no \"{of}\" in {:#?}", self.warnings);
    }

    fn n_warned(&self, of: &str) -> usize {
        self.warnings.iter().filter(|warning| warning.contains(of)).count()
    }
}

/// The items of a source until its end, or until `is_enough`.
pub(crate) fn take_until<P: Protocol>(
    source: &mut NetworkSource<P>,
    ctx: &mut Context,
    is_enough: impl Fn(&Outcome) -> bool,
) -> Outcome {
    let (mut outcome, began) = (Outcome::default(), Instant::now());
    while !is_enough(&outcome) {
        assert!(began.elapsed() < PATIENCE, "the source does not end: {outcome:#?}");
        ctx.begin(0, 0);
        let answer = source.next(ctx);
        outcome.warnings.extend(ctx.take_warnings());
        match answer {
            Err(error) => outcome.error = Some(error.to_string()),
            Ok(Some(out)) => {
                let mut emissions: Vec<Emission> = ctx.declared().iter().map(|_| Emission::Silent).collect();
                out.put(&mut emissions);
                let items = emissions.into_iter().enumerate().filter(|(_, e)| !matches!(e, Emission::Silent));
                outcome.items.extend(items.map(|(port, emission)| (ctx.stamp_ns(), port, emission)));
                continue;
            }
            Ok(None) => {}
        }
        break;
    }
    outcome
}

pub(crate) fn take_all<P: Protocol>(params: P::Params, ports: &[PortSpec]) -> Outcome {
    take_until(&mut NetworkSource::<P>::new(params).unwrap(), &mut context(ports), |_| false)
}

/// A protocol and the other side of it, as far as these tests need it.
trait Rig: Protocol {
    /// A peer with a client.
    type Talk: 'static;

    fn params(address: SocketAddr, network: NetworkParams) -> Self::Params;

    /// The name under which a stream is sent.
    fn name(stream: &str) -> String;

    /// The parameters of a port that reads this device or topic.
    fn port(stream: &str) -> Value;

    /// Welcomes a client and announces streams: poses or points.
    fn welcome(stream: TcpStream, streams: &[&str]) -> Self::Talk;

    /// The pose at (x, 20, -30) mm.
    fn pose(talk: &mut Self::Talk, stream: &str, stamp_ns: StampNs, x: f64);

    /// A point without a name.
    fn point(talk: &mut Self::Talk, stream: &str, stamp_ns: StampNs);

    /// The first half of a message, and no more.
    fn half(talk: &mut Self::Talk);

    fn close(talk: Self::Talk);
}

/// What a peer does with a client.
type Part<P> = Box<dyn FnOnce(&mut <P as Rig>::Talk) + Send>;

fn part<P: Rig>(part: impl FnOnce(&mut P::Talk) + Send + 'static) -> Part<P> {
    Box::new(part)
}

/// A peer that announces these streams to each of its clients, plays a part for each in turn, and is gone then.
fn peer<P: Rig>(streams: &'static [&'static str], parts: Vec<Part<P>>) -> (SocketAddr, JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let thread = thread::spawn(move || {
        for part in parts {
            let mut talk = P::welcome(listener.accept().unwrap().0, streams);
            part(&mut talk);
            P::close(talk);
        }
    });
    (address, thread)
}

fn network(reconnect: bool) -> NetworkParams {
    NetworkParams { reconnect, ..NetworkParams::default() }
}

/// A port of poses of a stream, with further parameters.
fn pose_port<P: Rig>(name: &'static str, stream: &str, more: Value) -> PortSpec {
    let mut params = P::port(stream);
    params.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    (name, "geometry/Pose", params)
}

/// Runs a source against a peer that plays one part, to the end.
fn run<P: Rig>(streams: &'static [&'static str], ports: &[PortSpec], play: Part<P>) -> Outcome {
    let (address, thread) = peer::<P>(streams, vec![play]);
    let outcome = take_all::<P>(P::params(address, network(false)), ports);
    thread.join().unwrap();
    outcome
}

/// Runs a source against a peer that plays several parts, one after another, until `is_enough`.
fn rerun<P: Rig>(
    streams: &'static [&'static str],
    ports: &[PortSpec],
    parts: Vec<Part<P>>,
    is_enough: impl Fn(&Outcome) -> bool,
) -> Outcome {
    let (address, thread) = peer::<P>(streams, parts);
    let mut source = NetworkSource::<P>::new(P::params(address, network(true))).unwrap();
    let outcome = take_until(&mut source, &mut context(ports), is_enough);
    drop(source);
    thread.join().unwrap();
    outcome
}

/// A test for each protocol.
macro_rules! for_each_protocol {
    ($($(#[$attribute:meta])* $name:ident => $check:ident;)*) => {
        $(
            $(#[$attribute])*
            #[test]
            fn $name() {
                $check::<OpenIgtLink>();
                $check::<FoxgloveWs>();
            }
        )*
    };
}

for_each_protocol! {
    each_port_gets_its_own_device_and_all_that_was_sent_before_the_close => own_device;
    a_reconnect_goes_by_names_and_continues_the_count_of_each_port => reconnect;
    a_device_that_does_not_come_back_stays_unknown => stale_device;
    a_silent_device_is_lost_at_the_limit_once_and_found_again => silent_device;
    a_clock_that_is_wrong_or_jumps_is_reported_and_stamps_stay_the_senders => wrong_clock;
    a_device_of_another_type_gives_nothing_and_is_named => other_type;
    a_device_that_is_not_there_is_named_once_for_its_port => missing_device;
    a_flag_comes_once_before_the_first_item => flags;
    a_stop_ends_the_source_within_half_a_second => stop;
    nobody_there_is_an_error_within_the_timeout => nobody;
    delay_and_silence_are_those_of_the_parameters => delays;
}

fn own_device<P: Rig>() {
    let ports = [pose_port::<P>("b", "B", json!({})), pose_port::<P>("a", "A", json!({}))];
    let outcome = run::<P>(
        &["A", "B"],
        &ports,
        part::<P>(|talk| {
            for i in 0..500 {
                P::pose(talk, "A", STAMP + 2 * i * MS, i as f64);
                P::pose(talk, "B", STAMP + (2 * i + 1) * MS, 1000.0 + i as f64);
            }
        }),
    );
    let expected = |from: f64, after: StampNs| -> Vec<(StampNs, Result<f64, &str>)> {
        (0..500).map(|i| (STAMP + (2 * i + after) * MS, Ok(from + i as f64))).collect()
    };
    assert_eq!(outcome.poses(0), expected(1000.0, 1), "{}", P::KIND);
    assert_eq!(outcome.poses(1), expected(0.0, 0), "{}", P::KIND);
    assert!(outcome.items.is_sorted_by_key(|item| item.0), "{}", P::KIND);
}

fn reconnect<P: Rig>() {
    let points = |name, stream| {
        let mut params = P::port(stream);
        params["labels"] = json!(["M1", "M2", "M3"]);
        (name, "geometry/Points", params)
    };
    let ports = [points("touched", "T"), pose_port::<P>("a", "A", json!({})), pose_port::<P>("b", "B", json!({}))];
    let parts = vec![
        part::<P>(|talk| {
            P::point(talk, "T", STAMP);
            P::pose(talk, "A", STAMP + MS, 1.0);
            P::pose(talk, "B", STAMP + 2 * MS, 2.0);
        }),
        part::<P>(|talk| {
            P::pose(talk, "B", STAMP + 3 * MS, 4.0);
            P::pose(talk, "A", STAMP + 4 * MS, 3.0);
            P::point(talk, "T", STAMP + 5 * MS);
        }),
    ];
    let outcome = rerun::<P>(&["A", "B", "T"], &ports, parts, |outcome| {
        outcome.items.last().is_some_and(|item| item.0 == STAMP + 5 * MS)
    });
    let names: Vec<String> = outcome
        .of_port(0)
        .into_iter()
        .map(|(_, emission)| match emission {
            Emission::Value(value) => value.get::<Points>().unwrap().points[0].name.to_string(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(names, ["M1", "M2"], "{}", P::KIND);
    for (port, before, after, at) in [(1, 1.0, 3.0, [1, 4]), (2, 2.0, 4.0, [2, 3])] {
        let poses = outcome.poses(port);
        assert_eq!(poses.len(), 3, "{}: {poses:?}", P::KIND);
        assert_eq!([&poses[0], &poses[2]], [&(STAMP + at[0] * MS, Ok(before)), &(STAMP + at[1] * MS, Ok(after))]);
        let (lost_ns, reason) = (poses[1].0, poses[1].1.unwrap_err());
        assert!(lost_ns == STAMP + 2 * MS && reason.contains("closed the connection"), "{}: {poses:?}", P::KIND);
    }
    let again = format!("waiting for the {} again", P::PEER);
    assert_eq!((outcome.n_warned(&again), outcome.n_warned("connected again, with 127.0.0.1")), (1, 1), "{}", P::KIND);
}

fn stale_device<P: Rig>() {
    let lost = json!({ "lost_after_ms": 50.0 });
    let ports = [pose_port::<P>("a", "A", lost), pose_port::<P>("b", "B", json!({}))];
    let parts = vec![
        part::<P>(|talk| {
            P::pose(talk, "A", STAMP, 1.0);
            P::pose(talk, "B", STAMP + MS, 2.0);
        }),
        part::<P>(|talk| (1..100).for_each(|i| P::pose(talk, "B", STAMP + i * 10 * MS, i as f64))),
    ];
    let outcome = rerun::<P>(&["A", "B"], &ports, parts, |outcome| {
        outcome.items.last().is_some_and(|item| item.0 == STAMP + 990 * MS)
    });
    let poses = outcome.poses(0);
    assert_eq!(poses[0], (STAMP, Ok(1.0)), "{}", P::KIND);
    assert!(poses.len() > 1 && poses[1..].iter().all(|(_, pose)| pose.is_err()), "{}: {poses:?}", P::KIND);
    let reason = poses.last().unwrap().1.unwrap_err();
    assert_eq!(reason, format!("{} was not sent for 0.05 s", P::name("A")));
}

fn silent_device<P: Rig>() {
    let lost = json!({ "lost_after_ms": 200.0 });
    let ports = [pose_port::<P>("a", "A", lost), pose_port::<P>("b", "B", json!({}))];
    let outcome = run::<P>(
        &["A", "B"],
        &ports,
        part::<P>(|talk| {
            for begin in [0, 1000] {
                P::pose(talk, "A", STAMP + begin * MS, begin as f64);
                (1..20).for_each(|i| P::pose(talk, "B", STAMP + (begin + i * 50) * MS, (begin / 50 + i) as f64));
            }
        }),
    );
    let reason = format!("{} was not sent for 0.20 s", P::name("A"));
    let expected = [(0, Ok(0.0)), (200, Err(reason.as_str())), (1000, Ok(1000.0)), (1200, Err(reason.as_str()))];
    assert_eq!(outcome.poses(0), expected.map(|(ms, pose)| (STAMP + ms * MS, pose)), "{}", P::KIND);
    assert_eq!(outcome.poses(1).len(), 38, "{}", P::KIND);
    assert!(outcome.items.is_sorted_by_key(|item| item.0), "{}: stamps never decrease", P::KIND);
}

fn wrong_clock<P: Rig>() {
    let ports = [pose_port::<P>("a", "A", json!({}))];
    let hour = 3600 * 1000 * MS;
    let parts = vec![
        part::<P>(|talk| (0..30).for_each(|i| P::pose(talk, "A", STAMP + i * MS, 1.0 + i as f64))),
        part::<P>(move |talk| (30..60).for_each(|i| P::pose(talk, "A", STAMP + i * MS + hour, 1.0 + i as f64))),
    ];
    let last_ns = STAMP + 59 * MS + hour;
    let outcome = rerun::<P>(&["A"], &ports, parts, |outcome| outcome.items.last().is_some_and(|i| i.0 == last_ns));
    let stamps: Vec<_> = outcome.poses(0).into_iter().filter(|(_, pose)| pose.is_ok()).map(|(ns, _)| ns).collect();
    let expected: Vec<_> = (0..60).map(|i| STAMP + i * MS + if i < 30 { 0 } else { hour }).collect();
    assert_eq!(stamps, expected, "{}: stamps are the sender's", P::KIND);
    let offset = outcome.n_warned("of the sender: its clock is");
    assert_eq!((offset, outcome.n_warned("its clock jumped by 3")), (1, 1), "{}: {:?}", P::KIND, outcome.warnings);
}

fn other_type<P: Rig>() {
    // A port of clouds and a device of poses.
    let cloud = ("cloud", "geometry/Cloud", P::port("A"));
    let outcome = run::<P>(&["A"], &[cloud], part::<P>(|talk| P::pose(talk, "A", STAMP, 1.0)));
    assert_eq!(outcome.items.len(), 0, "{}", P::KIND);
    let told = outcome.error.iter().chain(&outcome.warnings).find(|message| message.contains("port \"cloud\""));
    let told = told.unwrap_or_else(|| panic!("{}: {outcome:?}", P::KIND));
    assert!(told.contains(&P::name("A")) && (told.contains("TRANSFORM") || told.contains("FrameTransform")), "{told}");
}

fn missing_device<P: Rig>() {
    let ports = [pose_port::<P>("a", "A", json!({})), pose_port::<P>("gone", "C", json!({}))];
    let (address, thread) = peer::<P>(
        &["A", "B"],
        vec![part::<P>(|talk| {
            P::pose(talk, "A", STAMP, 1.0);
            thread::sleep(Duration::from_millis(300));
            P::pose(talk, "A", STAMP + MS, 2.0);
            P::pose(talk, "B", STAMP + 2 * MS, 2.0);
        })],
    );
    let params = NetworkParams { silent_after_s: 0.1, ..network(false) };
    let outcome = take_all::<P>(P::params(address, params), &ports);
    thread.join().unwrap();
    let message = format!("port \"gone\": {} {}; ", P::name("C"), P::MISSING);
    assert_eq!(outcome.n_warned(&message), 1, "{}: {:?}", P::KIND, outcome.warnings);
    assert_eq!(outcome.n_warned("port \"a\""), 0, "{}: {:?}", P::KIND, outcome.warnings);
    assert_eq!(outcome.poses(0).len(), 2, "{}", P::KIND);
}

fn flags<P: Rig>() {
    let ports = [("simulated", "report/Flag", json!({ "default": false })), pose_port::<P>("a", "A", json!({}))];
    let parts = vec![
        part::<P>(|talk| (0..3).for_each(|i| P::pose(talk, "A", STAMP + i * MS, 1.0))),
        part::<P>(|talk| P::pose(talk, "A", STAMP + 3 * MS, 2.0)),
    ];
    let outcome =
        rerun::<P>(&["A"], &ports, parts, |outcome| outcome.items.last().is_some_and(|item| item.0 == STAMP + 3 * MS));
    let flags = outcome.of_port(0);
    assert_eq!((flags.len(), flags[0].0, outcome.items[0].1), (1, STAMP, 0), "{}: {:?}", P::KIND, outcome.items);
}

/// Runs a source until it waits, stops it, and tells how long it takes to end.
fn time_to_stop<P: Rig>(params: P::Params) -> Duration {
    let stop = Arc::new(AtomicBool::new(false));
    let mut ctx = stoppable(&[pose_port::<P>("a", "A", json!({}))], stop.clone());
    let mut source = NetworkSource::<P>::new(params).unwrap();
    let stopper = thread::spawn(move || {
        thread::sleep(Duration::from_millis(400));
        stop.store(true, Ordering::Relaxed);
        Instant::now()
    });
    let outcome = take_until(&mut source, &mut ctx, |_| false);
    let ended = Instant::now();
    assert_eq!((outcome.error, outcome.items.len()), (None, 0), "{}", P::KIND);
    ended - stopper.join().unwrap()
}

fn stop<P: Rig>() {
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mute = TcpListener::bind("127.0.0.1:0").unwrap();
    let silent = |play: fn(&mut P::Talk)| {
        let (address, _) = peer::<P>(
            &["A", "B"],
            vec![part::<P>(move |talk| {
                play(talk);
                thread::sleep(Duration::from_secs(2));
            })],
        );
        address
    };
    let unread = |talk: &mut P::Talk| (0..100).for_each(|i| P::pose(talk, "B", STAMP + i * MS, 1.0));
    for (state, address) in [
        ("nobody listens", nobody),
        ("a peer accepts and says nothing", mute.local_addr().unwrap()),
        ("a peer is silent", silent(|_| {})),
        ("half of a message came", silent(P::half)),
        ("what comes is read by no port", silent(unread)),
    ] {
        let time = time_to_stop::<P>(P::params(address, network(true)));
        // Half a second, and a busy machine.
        assert!(time < Duration::from_millis(500), "{}, {state}: {time:?}", P::KIND);
    }
}

fn nobody<P: Rig>() {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let params = NetworkParams { timeout_s: 0.4, ..network(true) };
    let error =
        take_all::<P>(P::params(address, params.clone()), &[pose_port::<P>("a", "A", json!({}))]).error.unwrap();
    let expected = format!("{address} within 0.4 s: ");
    assert!(error.starts_with("no connection to ") && error.contains(&expected), "{}: {error}", P::KIND);
    // A peer that was there and said nothing is waited for as long again.
    let (address, _) = peer::<P>(&[], vec![part::<P>(|_| ())]);
    let outcome = take_all::<P>(P::params(address, params), &[pose_port::<P>("a", "A", json!({}))]);
    assert!(outcome.error.unwrap().contains("within 0.4 s"), "{}", P::KIND);
}

fn delays<P: Rig>() {
    let address = "127.0.0.1:1".parse().unwrap();
    let params = NetworkParams { silent_after_s: 1.5, max_delay_ms: 20.25, ..network(true) };
    let source = NetworkSource::<P>::new(P::params(address, params)).unwrap();
    assert_eq!(
        (source.silent_after(), source.max_delay_ns()),
        (Duration::from_millis(1500), 20_250_000),
        "{}",
        P::KIND
    );
}

#[test]
fn a_server_takes_one_sender_at_a_time_and_waits_for_the_next() {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let senders = thread::spawn(move || {
        for i in 0..2 {
            let until = Instant::now() + PATIENCE;
            let stream = loop {
                match TcpStream::connect(address) {
                    Ok(stream) => break stream,
                    Err(error) => assert!(Instant::now() < until, "{error}"),
                }
                thread::sleep(Duration::from_millis(10));
            };
            let mut talk = OpenIgtLink::welcome(stream, &[]);
            OpenIgtLink::pose(&mut talk, "A", STAMP + i * MS, i as f64);
            OpenIgtLink::close(talk);
        }
    });
    let mut params = OpenIgtLink::params(address, network(true));
    params.role = Role::Server;
    let mut source = NetworkSource::<OpenIgtLink>::new(params).unwrap();
    let ports = [pose_port::<OpenIgtLink>("a", "A", json!({}))];
    let outcome = take_until(&mut source, &mut context(&ports), |outcome| outcome.items.len() == 3);
    // The last sender waits for it.
    drop(source);
    senders.join().unwrap();
    let poses = outcome.poses(0);
    assert_eq!([poses[0].1, poses[2].1], [Ok(0.0), Ok(1.0)]);
    assert!(poses[1].1.is_err() && outcome.n_warned("connected again") == 1, "{outcome:?}");
}

impl Rig for OpenIgtLink {
    type Talk = TcpStream;

    fn params(address: SocketAddr, network: NetworkParams) -> Self::Params {
        Self::Params { address: address.to_string(), network, ..Self::Params::default() }
    }

    fn name(stream: &str) -> String {
        stream.into()
    }

    fn port(stream: &str) -> Value {
        json!({ "device": stream, "frame": "camera", "to": "world", "from": "marker" })
    }

    fn welcome(stream: TcpStream, _streams: &[&str]) -> TcpStream {
        stream
    }

    fn pose(talk: &mut TcpStream, stream: &str, stamp_ns: StampNs, x: f64) {
        let body = Body::Transform(Affine::of(&Isometry3::translation(x, 20.0, -30.0)));
        let _ = talk.write_all(&igtl::Message::new(stream, stamp_ns, body).to_bytes().unwrap());
    }

    fn point(talk: &mut TcpStream, stream: &str, stamp_ns: StampNs) {
        let body = Body::Points(vec![Fiducial::new("", [1.0, 2.0, 3.0])]);
        talk.write_all(&igtl::Message::new(stream, stamp_ns, body).to_bytes().unwrap()).unwrap();
    }

    fn half(talk: &mut TcpStream) {
        let body = Body::Transform(Affine::of(&Isometry3::translation(1.0, 2.0, 3.0)));
        talk.write_all(&igtl::Message::new("A", STAMP, body).to_bytes().unwrap()[..80]).unwrap();
    }

    fn close(mut talk: TcpStream) {
        talk.shutdown(std::net::Shutdown::Write).unwrap();
        // The source reads to the end before this side closes.
        let _ = std::io::copy(&mut talk, &mut std::io::sink());
    }
}

/// A client of a bridge, and the subscription of each topic.
struct Bridge {
    socket: WebSocket<TcpStream>,
    subscriptions: BTreeMap<String, u32>,
}

impl Bridge {
    fn send(&mut self, stream: &str, stamp_ns: StampNs, message: &Value) {
        // A topic that nobody subscribed to is not sent.
        let Some(subscription) = self.subscriptions.get(stream) else { return };
        let (id, time) = (subscription.to_le_bytes(), (stamp_ns as u64).to_le_bytes());
        let bytes = [&[1][..], &id, &time, message.to_string().as_bytes()].concat();
        let _ = self.socket.send(tungstenite::Message::binary(bytes));
    }
}

fn stamp(stamp_ns: StampNs) -> Value {
    json!({ "sec": stamp_ns / 1_000_000_000, "nsec": stamp_ns % 1_000_000_000 })
}

impl Rig for FoxgloveWs {
    type Talk = Bridge;

    fn params(address: SocketAddr, network: NetworkParams) -> Self::Params {
        Self::Params { address: format!("ws://{address}"), network, ..Self::Params::default() }
    }

    fn name(stream: &str) -> String {
        format!("/{stream}")
    }

    fn port(stream: &str) -> Value {
        json!({ "topic": Self::name(stream) })
    }

    fn welcome(stream: TcpStream, streams: &[&str]) -> Bridge {
        #[allow(clippy::result_large_err, reason = "the type is tungstenite's")]
        let protocol = |_: &Request, mut response: Response| {
            response.headers_mut().insert("sec-websocket-protocol", "foxglove.websocket.v1".parse().unwrap());
            Ok(response)
        };
        let mut socket = tungstenite::accept_hdr(stream, protocol).unwrap();
        // Each client finds other channels: what counts are the topics.
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        let shift = NEXT.fetch_add(1, Ordering::Relaxed);
        let id = |index: usize| (index + shift) % streams.len().max(1);
        let schema = |stream: &str| if stream == "T" { "foxglove.PoseInFrame" } else { "foxglove.FrameTransform" };
        let channel = |(index, stream): (usize, &&str)| {
            let (topic, schema) = (Self::name(stream), schema(stream));
            json!({ "id": id(index), "topic": topic, "encoding": "json", "schemaName": schema, "schema": "" })
        };
        let channels: Vec<Value> = streams.iter().enumerate().map(channel).collect();
        if !channels.is_empty() {
            let advertise = json!({ "op": "advertise", "channels": channels });
            socket.send(tungstenite::Message::text(advertise.to_string())).unwrap();
        }
        let mut subscriptions = BTreeMap::new();
        if !channels.is_empty()
            && let Ok(tungstenite::Message::Text(text)) = socket.read()
        {
            let request: Value = serde_json::from_str(&text).unwrap();
            for row in request["subscriptions"].as_array().unwrap() {
                let channel = channels.iter().find(|channel| channel["id"] == row["channelId"]).unwrap();
                let topic = channel["topic"].as_str().unwrap().trim_start_matches('/');
                subscriptions.insert(topic.to_owned(), row["id"].as_u64().unwrap() as u32);
            }
        }
        Bridge { socket, subscriptions }
    }

    fn pose(talk: &mut Bridge, stream: &str, stamp_ns: StampNs, x: f64) {
        let message = json!({
            "timestamp": stamp(stamp_ns), "parent_frame_id": "world", "child_frame_id": "marker",
            "translation": { "x": x * 1e-3, "y": 0.02, "z": -0.03 }, "rotation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
        });
        talk.send(stream, stamp_ns, &message);
    }

    fn point(talk: &mut Bridge, stream: &str, stamp_ns: StampNs) {
        let position = json!({ "x": 0.001, "y": 0.002, "z": 0.003 });
        let pose = json!({ "timestamp": stamp(stamp_ns), "frame_id": "camera", "pose": { "position": position } });
        talk.send(stream, stamp_ns, &pose);
    }

    fn half(talk: &mut Bridge) {
        // A frame of 100 bytes, of which ten come.
        talk.socket.get_mut().write_all(&[&[0x82, 100][..], &[1; 10]].concat()).unwrap();
    }

    fn close(mut talk: Bridge) {
        let _ = talk.socket.close(None);
        while talk.socket.read().is_ok() {}
    }
}
