mod as_recorded;

use super::*;
use crate::acquire::network::{
    NetworkSource,
    tests::{self, MS, Outcome, PortSpec, STAMP, context, take_until},
};
use osteoflow_geometry::{Cloud, Points};
use osteoflow_node::{Emission, Source};
use serde_json::{Value, json};
use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    thread,
};
use tungstenite::{
    Message, WebSocket,
    handshake::server::{Request, Response},
};

fn marker() -> (&'static str, &'static str, Value) {
    ("marker", "geometry/Pose", json!({ "topic": "/tf", "parent": "world", "child": "bone_marker" }))
}

/// Runs a source to its end.
fn take_all(address: &str, ports: &[PortSpec], change: impl FnOnce(&mut Params)) -> Outcome {
    let network = NetworkParams { reconnect: false, timeout_s: 5.0, ..NetworkParams::default() };
    let mut params = Params { address: address.into(), network, ..Params::default() };
    change(&mut params);
    tests::take_all::<FoxgloveWs>(params, ports)
}

/// What a server does with a client.
type Treat = Box<dyn FnOnce(&mut Client) + Send>;

/// A server that treats each of its clients in turn; its address.
fn server(clients: Vec<Treat>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        for treat in clients {
            let (stream, _) = listener.accept().unwrap();
            #[allow(clippy::result_large_err, reason = "the type is tungstenite's")]
            let protocol = |request: &Request, mut response: Response| {
                assert_eq!(request.headers()["sec-websocket-protocol"], "foxglove.sdk.v1, foxglove.websocket.v1");
                response.headers_mut().insert("sec-websocket-protocol", "foxglove.websocket.v1".parse().unwrap());
                Ok(response)
            };
            let mut client = Client(tungstenite::accept_hdr(stream, protocol).unwrap());
            treat(&mut client);
            let _ = client.0.close(None);
            while client.0.read().is_ok() {}
        }
    });
    address
}

struct Client(WebSocket<TcpStream>);

impl Client {
    fn text(&mut self, message: &Value) {
        self.0.send(Message::text(message.to_string())).unwrap();
    }

    fn advertise(&mut self, channels: &[(u64, &str, &str, &str)]) {
        let row = |(id, topic, encoding, schema): &(u64, &str, &str, &str)| json!({ "id": id, "topic": topic, "encoding": encoding, "schemaName": schema, "schema": "" });
        self.text(&json!({ "op": "advertise", "channels": channels.iter().map(row).collect::<Vec<_>>() }));
    }

    /// The next subscriptions, pairs of subscription and channel.
    fn subscribed(&mut self) -> Vec<(u64, u64)> {
        let Message::Text(text) = self.0.read().unwrap() else { panic!("no text") };
        let message: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(message["op"], "subscribe");
        let rows = message["subscriptions"].as_array().unwrap().iter();
        rows.map(|row| (row["id"].as_u64().unwrap(), row["channelId"].as_u64().unwrap())).collect()
    }

    /// The next subscription; none of a client that has left.
    fn subscription(&mut self) -> Option<u64> {
        let Ok(Message::Text(text)) = self.0.read() else { return None };
        let message: Value = serde_json::from_str(&text).unwrap();
        message["subscriptions"][0]["id"].as_u64()
    }

    fn data(&mut self, subscription: u64, data: &[u8]) {
        let bytes = [&[1][..], &(subscription as u32).to_le_bytes(), &(STAMP as u64).to_le_bytes(), data].concat();
        self.0.send(Message::binary(bytes)).unwrap();
    }

    /// Advertises `/tf` and gives its subscription.
    fn tf(&mut self) -> u64 {
        self.advertise(&[(4, "/other", "json", "foxglove.Log"), (7, "/tf", "json", "foxglove.FrameTransform")]);
        let subscribed = self.subscribed();
        assert_eq!(subscribed.len(), 1, "nothing else is subscribed to");
        assert_eq!(subscribed[0].1, 7);
        subscribed[0].0
    }
}

fn transform(stamp_ns: StampNs, x_m: f64) -> Vec<u8> {
    let stamp = json!({ "sec": stamp_ns / 1_000_000_000, "nsec": stamp_ns % 1_000_000_000 });
    json!({
        "timestamp": stamp, "parent_frame_id": "world", "child_frame_id": "bone_marker",
        "translation": { "x": x_m, "y": 0.02, "z": -0.03 }, "rotation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
    })
    .to_string()
    .into_bytes()
}

fn one(treat: impl FnOnce(&mut Client) + Send + 'static) -> String {
    format!("ws://{}", server(vec![Box::new(treat)]))
}

#[test]
fn poses_points_and_clouds_arrive_in_millimetres_from_the_topics_of_ports_alone() {
    let address = one(|client| {
        client.text(&json!({ "op": "serverInfo", "name": "test", "capabilities": [] }));
        client.advertise(&[
            (1, "/tf", "json", "foxglove.FrameTransform"),
            (2, "/log", "json", "foxglove.Log"),
            (3, "/scan", "json", "foxglove.PointCloud"),
            (4, "/tip", "json", "foxglove.PoseInFrame"),
        ]);
        let of: BTreeMap<u64, u64> = client.subscribed().into_iter().map(|(id, channel)| (channel, id)).collect();
        assert_eq!(of.keys().copied().collect::<Vec<_>>(), [1, 3, 4]);
        client.data(of[&1], &transform(STAMP, 0.5));
        let stamp = json!({ "sec": 1_750_000_012, "nsec": 0 });
        let here = json!({ "x": 0.001, "y": 0.0, "z": 0.0 });
        let points: Vec<u8> = [0.1_f32, 0.2, 0.3].iter().flat_map(|c| c.to_le_bytes()).collect();
        assert_eq!(points, [205, 204, 204, 61, 205, 204, 76, 62, 154, 153, 153, 62]);
        let cloud = json!({
            "timestamp": stamp, "frame_id": "depth", "point_stride": 12, "data": "zczMPc3MTD6amZk+",
            "fields": [{ "name": "x", "offset": 0, "type": 7 }, { "name": "y", "offset": 4, "type": 7 }, { "name": "z", "offset": 8, "type": 7 }],
        });
        client.data(of[&3], cloud.to_string().as_bytes());
        let tip = json!({ "timestamp": stamp, "frame_id": "world", "pose": { "position": here } });
        client.data(of[&4], tip.to_string().as_bytes());
    });
    let ports = [
        marker(),
        ("scan", "geometry/Cloud", json!({ "topic": "/scan" })),
        ("tip", "geometry/Points", json!({ "topic": "/tip", "labels": ["M1"] })),
        ("tracked", "report/Flag", json!({ "default": true })),
    ];
    let ran = take_all(&address, &ports, |p| p.frames = BTreeMap::from([("depth".into(), "camera".into())]));
    assert_eq!(ran.error, None);
    assert_eq!(ran.poses(0), [(STAMP, Ok(500.0))]);
    let value = |port: usize| ran.items.iter().find(|item| item.1 == port).map(|item| &item.2);
    let Some(Emission::Value(cloud)) = value(1) else { panic!("no cloud in {:?}", ran.warnings) };
    let cloud = cloud.get::<Cloud>().unwrap();
    assert_eq!((cloud.frame.as_str(), cloud.len(), cloud.label.as_deref()), ("camera", 1, Some("scan")));
    assert!((cloud.points()[0].x - 100.0).abs() < 1e-4, "{}", cloud.points()[0]);
    let Some(Emission::Value(tip)) = value(2) else { panic!("no point in {:?}", ran.warnings) };
    let tip = &tip.get::<Points>().unwrap().points[0];
    assert_eq!((tip.name.as_ref(), tip.position.x), ("M1", 1.0));
    assert!(matches!(value(3), Some(Emission::Value(_))), "the flag comes with the first item");
}

#[test]
fn whatever_is_wrong_with_messages_is_said_and_the_rest_arrives() {
    let address = one(|client| {
        client.0.send(Message::text("no JSON")).unwrap();
        client.text(&json!({ "op": "status", "level": 2, "message": "the disk is full" }));
        client.text(&json!({ "op": "somethingNew" }));
        client.text(&json!({ "op": "advertise" }));
        client.text(&json!({ "op": "advertise", "channels": [{ "id": 1 }] }));
        let id = client.tf();
        client.0.send(Message::binary(vec![1, 2])).unwrap();
        client.0.send(Message::binary(vec![77, 2])).unwrap();
        client.0.send(Message::binary(Vec::new())).unwrap();
        client.data(id + 5, &transform(STAMP, 0.1));
        client.data(id, b"{ half");
        let lost = String::from_utf8(transform(STAMP + MS, 0.0)).unwrap().replace("\"w\":1.0", "\"w\":0.0");
        client.data(id, lost.as_bytes());
        let crooked = String::from_utf8(transform(STAMP + MS, 0.0)).unwrap().replace("\"w\":1.0", "\"w\":0.7");
        client.data(id, crooked.as_bytes());
        client.data(id, &transform(STAMP + 2 * MS, 0.2));
    });
    let ran = take_all(&address, &[marker()], |_| {});
    for of in [
        "is no JSON",
        "reports an error: the disk is full",
        "lacks its channels",
        "lack id, topic",
        "has 2 bytes, 13",
        "opcode 77",
        "a binary message is empty",
        "which was not asked for",
        "/tf: ",
        "closed the connection",
    ] {
        ran.warned(of);
    }
    let poses = ran.poses(0);
    assert_eq!(poses.len(), 4, "{poses:?}");
    assert!(poses[..3].iter().all(|(_, pose)| pose.is_err()), "{poses:?}");
    assert_eq!(poses[3], (STAMP + 2 * MS, Ok(200.0)));
}

#[test]
fn random_messages_neither_crash_nor_stop_the_stream() {
    let address = one(|client| {
        let id = client.tf();
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        };
        for i in 0..1000 {
            let bytes: Vec<u8> = (0..random()).map(|_| random()).collect();
            match i % 3 {
                0 => client.0.send(Message::binary(bytes)).unwrap(),
                1 => client.0.send(Message::text(String::from_utf8_lossy(&bytes).into_owned())).unwrap(),
                _ => client.data(id, &bytes),
            }
            client.data(id, &transform(STAMP + i * MS, i as f64 * 1e-3));
        }
    });
    let ran = take_all(&address, &[marker()], |_| {});
    let good: Vec<_> = ran.poses(0).into_iter().filter_map(|(stamp, pose)| Some((stamp, pose.ok()?))).collect();
    assert_eq!(good.len(), 1000);
    assert!(
        good.iter().enumerate().all(|(i, (stamp, x))| *stamp == STAMP + i as i64 * MS && (x - i as f64).abs() < 1e-6)
    );
    assert!(ran.warnings.len() < 50, "{} warnings", ran.warnings.len());
}

#[test]
fn a_topic_of_another_schema_or_encoding_is_an_error_that_names_what_is_there() {
    for (encoding, schema, expected) in [
        ("json", "foxglove.PointCloud", "/tf has foxglove.PointCloud, but geometry/Pose is read from"),
        ("ros1", "foxglove.FrameTransform", "encoded as \"ros1\"; protobuf, json, cdr are read"),
    ] {
        let address = one(move |client| client.advertise(&[(1, "/tf", encoding, schema), (2, "/rosout", "cdr", "x")]));
        let error = take_all(&address, &[marker()], |_| {}).error.unwrap();
        assert!(error.contains(expected) && error.contains("port \"marker\""), "{error}");
        assert!(encoding == "ros1" || error.contains("the server has"), "{error}");
    }
}

#[test]
fn topics_that_are_never_advertised_are_named_with_those_that_are() {
    let wait = |client: &mut Client| while client.0.read().is_ok() {};
    let address = one(move |client| {
        client.advertise(&[(1, "/rosout", "cdr", "rcl_interfaces/msg/Log")]);
        wait(client);
    });
    let error = take_all(&address, &[marker()], |p| p.network.timeout_s = 0.5).error.unwrap();
    assert!(error.contains("none of /tf was advertised within 0.5 s; the server has /rosout"), "{error}");
    let silent = one(wait);
    let error = take_all(&silent, &[marker()], |p| p.network.timeout_s = 0.5).error.unwrap();
    assert!(error.contains("advertises no topic"), "{error}");
    // One of two: the run goes on.
    let address = one(|client| {
        let id = client.tf();
        client.data(id, &transform(STAMP, 0.5));
    });
    let ports = [marker(), ("scan", "geometry/Cloud", json!({ "topic": "/scan" }))];
    let ran = take_all(&address, &ports, |_| {});
    ran.warned("port \"scan\": /scan was not advertised");
    assert_eq!(ran.poses(0), [(STAMP, Ok(500.0))]);
}

#[test]
fn a_server_that_does_not_answer_refuses_or_speaks_another_protocol_is_an_error() {
    // Bytes that a server answers to any request.
    let raw = |answer: &'static [u8]| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("ws://{}/secret", listener.local_addr().unwrap());
        thread::spawn(move || {
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                let _ = stream.read(&mut [0; 2000]);
                if stream.write_all(answer).is_ok() && answer.is_empty() {
                    thread::sleep(Duration::from_secs(8));
                }
            }
        });
        address
    };
    for (answer, expected) in [
        (&b""[..], "did not answer the request for a WebSocket within 3s"),
        (b"HTTP/1.1 403 Forbidden\r\nContent-Length: 8\r\n\r\nno token", "refuses the connection: 403 Forbidden"),
        (b"SSH-2.0-OpenSSH_9.6\r\n\r\n", "does not speak the protocol"),
    ] {
        let began = Instant::now();
        let error = take_all(&raw(answer), &[marker()], |p| p.network.timeout_s = 1.0).error.unwrap();
        assert!(error.contains(expected), "{error}");
        assert!(!error.contains("secret"), "the path may be a token: {error}");
        assert!(began.elapsed() < Duration::from_secs(6), "{:?}", began.elapsed());
    }
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let error = take_all(&format!("ws://{nobody}"), &[marker()], |p| p.network.timeout_s = 0.5).error.unwrap();
    assert!(error.contains("no connection to") && error.contains("refused"), "{error}");
}

#[test]
fn a_message_that_is_announced_as_huge_ends_the_connection_and_many_channels_do_not() {
    let address = one(|client| {
        let many: Vec<String> = (0..10_100).map(|i| format!("/topic_{i}")).collect();
        let rows: Vec<_> = (0..).zip(&many).map(|(id, topic)| (id + 100, topic.as_str(), "cdr", "x")).collect();
        client.advertise(&rows[..5000]);
        let id = client.tf();
        client.advertise(&rows[5000..]);
        client.data(id, &transform(STAMP, 0.5));
        // The header of a binary frame of 1 TiB.
        let header = [&[0x82, 127][..], &(1_u64 << 40).to_be_bytes(), &[1; 100]].concat();
        client.0.get_mut().write_all(&header).unwrap();
    });
    let ran = take_all(&address, &[marker()], |_| {});
    ran.warned("more than 10000 channels");
    ran.warned("a message above 64 MiB");
    assert_eq!(ran.poses(0), [(STAMP, Ok(500.0))]);
}

#[test]
fn a_lost_tool_a_topic_that_ends_and_a_server_that_comes_back_are_said() {
    let first = |client: &mut Client| {
        client.advertise(&[
            (1, "/tf", "json", "foxglove.FrameTransform"),
            (2, "/other", "json", "foxglove.FrameTransform"),
        ]);
        let of: BTreeMap<u64, u64> = client.subscribed().into_iter().map(|(id, channel)| (channel, id)).collect();
        client.data(of[&1], &transform(STAMP, 0.1));
        client.data(of[&2], &transform(STAMP + 900 * MS, 0.7));
        client.data(of[&1], &transform(STAMP + 1000 * MS, 0.2));
        client.text(&json!({ "op": "unadvertise", "channelIds": [1, 99] }));
    };
    let second = |client: &mut Client| {
        let id = client.tf();
        client.data(id, &transform(STAMP + 2000 * MS, 0.3));
        client.data(id, b"");
        // Then nobody listens any more.
    };
    let address = server(vec![Box::new(first), Box::new(second)]);
    let mut lost = marker();
    lost.2["lost_after_ms"] = json!(500.0);
    let ports = [lost, ("other", "geometry/Pose", json!({ "topic": "/other" }))];
    let params = Params { address: format!("ws://{address}"), ..Params::default() };
    let (mut source, mut ctx) = (NetworkSource::<FoxgloveWs>::new(params).unwrap(), context(&ports));
    let is_last = |item: &(StampNs, usize, Emission)| item.0 == STAMP + 2000 * MS;
    let ran = take_until(&mut source, &mut ctx, |ran| ran.items.iter().any(is_last));
    for of in ["/tf is no longer advertised", "waiting for the server again", "connected again"] {
        ran.warned(of);
    }
    let poses = ran.poses(0);
    assert_eq!(poses[0], (STAMP, Ok(100.0)));
    assert_eq!(poses[1], (STAMP + 500 * MS, Err("/tf was not sent for 0.50 s")));
    assert_eq!(poses[2], (STAMP + 1000 * MS, Ok(200.0)));
    assert_eq!(poses[3], (STAMP + 1000 * MS, Err("/tf: /tf is no longer advertised")));
    assert_eq!(poses.last().unwrap(), &(STAMP + 2000 * MS, Ok(300.0)));
}

#[test]
fn addresses_and_ports_that_cannot_be_read_are_refused() {
    for (address, expected) in [
        ("wss://127.0.0.1:8765", "TLS (wss) is not supported"),
        ("127.0.0.1:8765", "is not ws://HOST:PORT"),
        ("http://127.0.0.1:8765", "is not ws://HOST:PORT"),
        ("ws://", "is no address"),
    ] {
        let error = FoxgloveWs::peer(&Params { address: address.into(), ..Params::default() }).err().unwrap();
        assert!(error.to_string().contains(expected), "{error}");
    }
    for (port, expected) in [
        (("a", "geometry/Pose", json!({})), "neither topic nor topics"),
        (("a", "report/Flag", json!({})), "default is not given"),
        (("a", "geometry/Region", json!({ "topic": "/r" })), "no topic states a region or a flag; remove it"),
        (("a", "geometry/Planes", json!({ "topic": "/r" })), "but not geometry/Planes"),
    ] {
        let error = take_all("ws://127.0.0.1:1", &[port], |_| {}).error.unwrap();
        assert!(error.contains(expected), "{error}");
    }
}
