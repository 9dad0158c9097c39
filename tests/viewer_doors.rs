//! Everything that the page's server answers or takes, tried by each role, from each origin; and what a stranger sends there.

use crate::common::{browser::Browser, osteoflow, served::Served};
use crate::privacy::layer;
use crate::viewer_steering::Bench;
use osteoflow_container::{MessageHeader, WriteOptions, Writer};
use osteoflow_viewer::{Door, Role};
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    fs,
    io::{Read, Write},
    net::TcpStream,
    time::{Duration, Instant},
};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

const LIMIT: Duration = Duration::from_secs(60);
/// An origin whose pages may see, and one whose pages may steer.
const SEES: &str = "https://sees.example";
const STEERS: &str = "https://steers.example";
/// What a request of the protocol begins with.
const UPGRADE: &str = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
    Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n";

/// A way to knock at a door.
enum Way {
    /// Method, path, headers, body, and the statuses of those who are admitted.
    Http(&'static str, &'static str, &'static str, Value, &'static [u16]),
    /// A message of the stream.
    Text(Value),
    Binary(Vec<u8>),
}

/// A call of the n-th service of `view GRAPH`.
fn service(n: u32, request: &Value) -> Way {
    let mut call = vec![2];
    [n, 9, 4].into_iter().for_each(|number| call.extend(number.to_le_bytes()));
    call.extend(b"json");
    call.extend(request.to_string().into_bytes());
    Way::Binary(call)
}

fn post(path: &'static str, body: Value, admitted: &'static [u16]) -> Way {
    Way::Http("POST", path, "", body, admitted)
}

/// The role that a door needs, and the ways to it. A new door does not compile without its row.
fn row(door: Door) -> (Role, Vec<Way>) {
    let steps = json!({ "values": { "icp.max_iterations": 50 } });
    let get = |path| Way::Http("GET", path, "", Value::Null, &[200]);
    match door {
        Door::Page => (Role::See, vec![get(""), get("main.js")]),
        Door::Picks => (Role::See, vec![get("picks")]),
        Door::Stream => (
            Role::See,
            vec![
                Way::Http("GET", "", UPGRADE, Value::Null, &[101]),
                Way::Text(json!({ "op": "subscribeConnectionGraph" })),
            ],
        ),
        Door::Subscribe => {
            let subscribe = json!({ "op": "subscribe", "subscriptions": [] });
            (Role::See, vec![Way::Text(subscribe), Way::Text(json!({ "op": "unsubscribe", "subscriptionIds": [1] }))])
        }
        Door::GetParameters => (Role::See, vec![Way::Text(json!({ "op": "getParameters", "parameterNames": [] }))]),
        Door::SetParameters => {
            let parameters = json!([{ "name": "icp.max_iterations", "value": 50 }]);
            (Role::Steer, vec![Way::Text(json!({ "op": "setParameters", "parameters": parameters }))])
        }
        Door::Playback => {
            let mut play = vec![3, 0];
            play.extend(1.0_f32.to_le_bytes());
            play.extend([0; 13]);
            (Role::Steer, vec![Way::Binary(play)])
        }
        Door::Set => (Role::Steer, vec![post("set", steps.clone(), &[200]), service(1, &steps)]),
        Door::Revert => (Role::Steer, vec![post("revert", json!({}), &[200]), service(2, &json!({}))]),
        // Written if there is a change, else refused as nothing to write.
        Door::Write => (Role::Write, vec![post("write", json!({}), &[200, 422]), service(3, &json!({}))]),
        Door::Region => (Role::Write, vec![post("region", json!({}), &[422]), service(4, &json!({}))]),
        Door::SavePlan => (Role::Write, vec![post("save/plan", json!({}), &[422])]),
        Door::SavePairs => (Role::Write, vec![post("save/pairs", json!({}), &[422])]),
    }
}

/// Who knocks: the address up to the token, with what they say of themselves, and the role that they have by it.
struct Sender {
    token: String,
    host: String,
    origin: Option<String>,
    role: Option<Role>,
}

fn senders(served: &Served) -> Vec<Sender> {
    let (own, _) = served.parts();
    let tokens: Vec<&str> =
        served.pages.iter().map(|page| page.trim_end_matches('/').rsplit('/').next().unwrap()).collect();
    let [see, steer, write] = tokens[..] else { panic!("three addresses: {tokens:?}") };
    let own_page = format!("http://{own}");
    let rows = [
        ("", own, None, None),
        ("0123456789abcdef0123456789abcdef/", own, None, None),
        (&write[..31], own, None, None),
        (write, "evil.example", None, None),
        (write, "evil.example:80", None, None),
        (write, own, Some("http://evil.example"), None),
        (write, own, Some("null"), None),
        (see, own, None, Some(Role::See)),
        (see, own, Some(STEERS), Some(Role::See)),
        (see, own, Some(own_page.as_str()), Some(Role::See)),
        (write, own, Some(SEES), Some(Role::See)),
        (steer, own, None, Some(Role::Steer)),
        (write, own, Some(STEERS), Some(Role::Steer)),
        (write, own, None, Some(Role::Write)),
        (write, own, Some(own_page.as_str()), Some(Role::Write)),
    ];
    let sender = |(token, host, origin, role): (&str, &str, Option<&str>, _)| Sender {
        token: token.trim_end_matches('/').into(),
        host: host.into(),
        origin: origin.map(Into::into),
        role,
    };
    rows.map(sender).into()
}

impl Sender {
    /// Status and body of the answer to a request.
    fn ask(&self, served: &Served, method: &str, path: &str, headers: &str, body: &str) -> (u16, String) {
        let Self { token, host, origin, .. } = self;
        let slash = if token.is_empty() { "" } else { "/" };
        let origin = origin.as_ref().map_or_else(String::new, |origin| format!("Origin: {origin}\r\n"));
        let head = format!("{method} /{token}{slash}{path} HTTP/1.1\r\nHost: {host}\r\n{origin}{headers}");
        let answer = served.raw(format!("{head}Content-Length: {}\r\n\r\n{body}", body.len()).as_bytes());
        let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok());
        (status.unwrap_or_else(|| panic!("{head}: {answer}")), answer)
    }

    /// The stream, if it is let in.
    fn connect(&self, served: &Served) -> Option<WebSocket<TcpStream>> {
        let own = served.parts().0;
        if self.host != own {
            return None;
        }
        let connection = TcpStream::connect(own).unwrap();
        connection.set_read_timeout(Some(LIMIT)).unwrap();
        let address = format!("ws://{own}/{}", self.token);
        let mut request = ClientRequestBuilder::new(address.parse().unwrap()).with_sub_protocol("foxglove.sdk.v1");
        if let Some(origin) = &self.origin {
            request = request.with_header("Origin", origin.clone());
        }
        tungstenite::client(request, connection).ok().map(|(socket, _)| socket)
    }
}

/// Replies to a message of the stream, until a later one is answered.
fn reply_to(socket: &mut WebSocket<TcpStream>, message: Message) -> String {
    socket.send(message).unwrap();
    socket.send(Message::text(r#"{"op":"getParameters","parameterNames":["none.none"],"id":"after"}"#)).unwrap();
    let mut reply = String::new();
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            if text.contains(r#""id":"after""#) {
                return reply;
            }
            reply += &text;
        }
    }
}

const ROLES: [&str; 6] =
    ["--role=see,steer,write", "--allow-origin", SEES, "--allow-origin", "https://steers.example=steer", "--no-cache"];

#[test]
fn each_door_opens_to_its_role_and_to_nobody_else_from_wherever_they_come() {
    let bench = Bench::new();
    let before = bench.text("fibula.toml");
    let served = bench.view("fibula.toml", &ROLES);
    let senders = senders(&served);
    for sender in &senders {
        let who = format!("/{} of {} from {:?}", sender.token, sender.host, sender.origin);
        let mut socket = sender.connect(&served);
        assert_eq!(socket.is_some(), sender.role.is_some(), "{who}");
        for door in Door::ALL.iter().copied() {
            let (needs, ways) = row(door);
            let is_admitted = sender.role.is_some_and(|role| role >= needs);
            for way in ways {
                let reply = match (way, &mut socket) {
                    (Way::Http(method, path, headers, body, admitted), _) => {
                        let body = if body.is_null() { String::new() } else { body.to_string() };
                        let (status, reply) = sender.ask(&served, method, path, headers, &body);
                        let expected = if is_admitted { admitted } else { &[403] };
                        assert!(expected.contains(&status), "{door:?} by {who}: {status}, not {expected:?}");
                        reply
                    }
                    (Way::Text(message), Some(socket)) => reply_to(socket, Message::text(message.to_string())),
                    (Way::Binary(message), Some(socket)) => reply_to(socket, Message::binary(message)),
                    (_, None) => continue,
                };
                let says_so = reply.contains(&format!("this needs the role {needs}"));
                assert_eq!(says_so, sender.role.is_some() && !is_admitted, "{door:?} by {who}: {reply}");
                if says_so {
                    let origin = sender.origin.as_deref().filter(|origin| [SEES, STEERS].contains(origin));
                    let remedy = origin.filter(|_| sender.token.len() == 32 && sender.token == senders[13].token);
                    let remedy = remedy.map_or(format!("--role {needs}"), |o| format!("--allow-origin {o}={needs}"));
                    assert!(reply.contains(&remedy), "{door:?} by {who}: {reply} lacks {remedy}");
                }
            }
        }
        if sender.role.is_none_or(|role| role == Role::See) {
            assert_eq!(bench.text("fibula.toml"), before, "{who}");
            assert!(!bench.run(2).exists() && !bench.path("picks").exists(), "{who}");
        }
    }
    let write = &senders[13];
    assert_eq!(sender_set(write, &served, &json!({ "icp.max_iterations": 50 })).0, 200);
    assert_eq!(write.ask(&served, "POST", "write", "", "{}").0, 200);
    assert_ne!(bench.text("fibula.toml"), before, "who writes has written");
}

#[test]
fn who_steers_sets_numbers_and_words_of_the_graphs_nodes_and_nothing_that_may_be_a_path() {
    let bench = Bench::new();
    fs::write(bench.path("mod.toml"), "[module]\n").unwrap();
    let served = bench.view("fibula.toml", &ROLES);
    let steers = &senders(&served)[11];
    let set = |values: &Value| sender_set(steers, &served, values);
    for values in [
        json!({ "bone.kind": "surface.file", "bone.path": "bone.stl" }),
        json!({ "plan.kind": "plan.file", "plan.path": "plan.json" }),
        json!({ "bone.kind": "surface.file", "bone.path": bench.path("fibula.toml") }),
        json!({ "extra.kind": "module", "extra.file": "mod.toml" }),
        json!({ "more.kind": "surface.simulated" }),
        json!({ "icp.in": { "source": "recording.scan" } }),
        json!({ "graph.name": "another" }),
        json!({ "record.wires": ["*"] }),
        json!({ "recording.kind": "acquire.openigtlink", "recording.address": "192.0.2.1:18944" }),
    ] {
        let (status, reply) = set(&values);
        assert_eq!(status, 422, "{values}: {reply}");
    }
    let (_, reply) = set(&json!({ "graph.name": "another" }));
    assert!(reply.contains("graph.name") && reply.contains("--role write"), "{reply}");
    assert!(!bench.run(2).exists());
    let (status, reply) = set(&json!({ "icp.kind": "icp.point_to_point", "icp.trim_fraction": 0.1, "graph.seed": 7 }));
    assert_eq!(status, 200, "{reply}");
    bench.results(2);
    let (status, reply) = set(&json!({ "icp.kind": null }));
    assert_eq!(status, 200, "{reply}");
    // Who may write sets a text, too.
    let (status, reply) = sender_set(&senders(&served)[13], &served, &json!({ "graph.name": "another" }));
    assert_eq!(status, 200, "{reply}");
}

fn sender_set(sender: &Sender, served: &Served, values: &Value) -> (u16, String) {
    sender.ask(served, "POST", "set", "", &json!({ "values": values }).to_string())
}

#[test]
fn no_path_leads_out_of_the_page_and_what_is_too_long_or_too_much_is_refused_to_each_role() {
    let bench = Bench::new();
    let served = bench.view("fibula.toml", &ROLES);
    let all = senders(&served);
    for sender in all.iter().filter(|sender| sender.role.is_some()) {
        for path in [
            "../Cargo.toml",
            "..%2f..%2fetc%2fpasswd",
            "%2e%2e/%2e%2e/etc/passwd",
            "/etc/passwd",
            "//etc/passwd",
            "..\\..\\etc\\passwd",
            "C:\\boot.ini",
            "main.js/../../x",
            "main.js%00.html",
            "file:///etc/passwd",
            "three/",
            "save/plan",
        ] {
            let (status, reply) = sender.ask(&served, "GET", path, "", "");
            assert!([400, 404].contains(&status) && !reply.contains("root:"), "{path}: {reply}");
        }
        assert_eq!(sender.ask(&served, "PUT", "set", "", "{}").0, 405);
        assert_eq!(sender.ask(&served, "POST", "save/../../x", "", "{}").0, 404);
        // A body that never comes: who may not send it is refused before it is read, and so is one that is too long.
        for (n, may, may_not) in [(17 << 20, 413, 403), (1_u64 << 40, 413, 403)] {
            let mut connection = TcpStream::connect(served.parts().0).unwrap();
            connection.set_read_timeout(Some(LIMIT)).unwrap();
            let origin = sender.origin.as_ref().map_or_else(String::new, |origin| format!("Origin: {origin}\r\n"));
            let head = format!("POST /{}/save/plan HTTP/1.1\r\nHost: {}\r\n{origin}", sender.token, sender.host);
            write!(connection, "{head}Content-Length: {n}\r\n\r\n").unwrap();
            let (began, mut answer) = (Instant::now(), String::new());
            connection.read_to_string(&mut answer).unwrap();
            let expected = if sender.role == Some(Role::Write) { may } else { may_not };
            assert!(answer.starts_with(&format!("HTTP/1.1 {expected}")), "{head}: {answer}");
            assert!(began.elapsed() < Duration::from_secs(5), "it waited for the body");
        }
        // A frame that is too long ends the connection, not the server.
        let mut socket = sender.connect(&served).unwrap();
        let _ = socket.send(Message::text("x".repeat(2 << 20)));
        while socket.read().is_ok() {}
    }
    // Who asks without end and reads nothing is left, and costs no memory. Twice the same channel is refused.
    let before = served.resident_bytes();
    let mut socket = all[7].connect(&served).unwrap();
    let id = json!("x".repeat(100_000));
    let ask = json!({ "op": "getParameters", "parameterNames": ["none.none"], "id": id }).to_string();
    let until = Instant::now() + LIMIT;
    socket.get_ref().set_write_timeout(Some(Duration::from_secs(5))).unwrap();
    while Instant::now() < until && socket.send(Message::text(ask.clone())).is_ok() {}
    assert!(Instant::now() < until, "it is never left");
    let more = served.resident_bytes() - before;
    assert!(more < 200e6, "{more} bytes more");
    let mut socket = all[7].connect(&served).unwrap();
    let twice = json!([{ "id": 1, "channelId": 1 }, { "id": 2, "channelId": 1 }]);
    let twice = json!({ "op": "subscribe", "subscriptions": twice }).to_string();
    let reply = reply_to(&mut socket, Message::text(twice));
    assert!(reply.contains("subscribed already"), "{reply}");
    assert_eq!(all[7].ask(&served, "GET", "", "", "").0, 200);
}

#[test]
fn a_public_address_and_other_origins_see_only_unless_the_command_line_says_more() {
    let bench = Bench::new();
    for (arguments, role) in [
        (&["--serve-public", "--address=0.0.0.0:0"][..], "see"),
        (&["--serve-public", "--role=steer"], "steer"),
        (&["--role=see"], "see"),
        (&[], "write"),
    ] {
        let served = bench.view("fibula.toml", &[arguments].concat());
        let (host, token) = served.parts();
        let sender = Sender { token: token.into(), host: host.into(), origin: None, role: None };
        let mut socket = sender.connect(&served).unwrap();
        let info: Value = serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap();
        assert_eq!(info["metadata"]["role"], role, "{arguments:?}");
        let steered = sender_set(&sender, &served, &json!({ "icp.max_iterations": 50 })).0;
        assert_eq!(steered, if role == "see" { 403 } else { 200 }, "{arguments:?}");
        drop(served);
        for n in 1..4 {
            let _ = fs::remove_dir_all(bench.run(n));
        }
    }
}

/// What would strike if it were taken for HTML.
const SCRIPT: &str = "<img src=x onerror=window.struck=1>";

/// A DICOM file whose modality is this text.
fn dicom(modality: &str) -> Vec<u8> {
    let mut file = [&[0; 128][..], b"DICM"].concat();
    let syntax = "1.2.840.10008.1.2.1\0";
    let image = [0x0028_0010, 0x0028_0011].map(|tag| (tag, "US", b"\x02\0".to_vec()));
    let texts = [(0x0002_0010, "UI", syntax), (0x0008_0060, "CS", modality), (0x0020_000e, "UI", "1.2.3\0")];
    let texts = texts.map(|(tag, kind, text)| (tag, kind, text.as_bytes().to_vec()));
    for (tag, kind, mut value) in texts.into_iter().chain(image) {
        value.resize(value.len().next_multiple_of(2), b' ');
        let tag: u32 = tag;
        [tag >> 16, tag & 0xffff].into_iter().for_each(|part| file.extend((part as u16).to_le_bytes()));
        file.extend(kind.as_bytes());
        file.extend((value.len() as u16).to_le_bytes());
        file.extend(value);
    }
    file.extend(b"\xe0\x7f\x10\0OW\0\0\x08\0\0\0");
    file.extend([0; 8]);
    file
}

#[test]
fn names_from_files_are_text_on_the_page_and_a_page_that_may_less_says_so() {
    let Some(mut browser) = Browser::start("names_from_files_are_text_on_the_page") else { return };
    let bench = Bench::new();
    let graph = format!("{SCRIPT}.toml");
    let text = bench.text("fibula.toml");
    let name = text.lines().find(|line| line.starts_with("name ")).unwrap();
    fs::write(bench.path(&graph), text.replace(name, &format!("name = {SCRIPT:?}"))).unwrap();
    fs::write(bench.path(&format!("{SCRIPT}.dcm")), dicom(SCRIPT)).unwrap();
    let served = bench.view(&graph, &ROLES);
    let open = |browser: &mut Browser, page: &str| {
        browser.events.clear();
        browser.call("Page.navigate", json!({ "url": page }));
        browser.wait_until("document.readyState === 'complete' && typeof osteoflow === 'object'");
        browser
            .wait_until("osteoflow.state.state === 'complete' && document.getElementById('graph').children.length > 0");
    };
    let is_text = |browser: &mut Browser, what: &str| {
        let shown = browser.evaluate(what);
        assert!(shown.as_str().is_some_and(|shown| shown.contains(SCRIPT)), "{what}: {shown}");
        let harm = "[window.struck === undefined, document.querySelectorAll('img, iframe, body script').length]";
        assert_eq!(browser.evaluate(harm), json!([true, 0]), "{what}");
    };
    open(&mut browser, &served.pages[2]);
    is_text(&mut browser, "document.title");
    let write = &senders(&served)[13];
    let (status, reply) = sender_set(write, &served, &json!({ "icp.max_iterations": 50, "graph.name": SCRIPT }));
    assert_eq!(status, 200, "{reply}");
    browser.wait_until("osteoflow.state.run === 'run-2' && osteoflow.state.state === 'complete'");
    is_text(&mut browser, "document.getElementById('changes').textContent");
    is_text(&mut browser, "document.getElementById('write').textContent");
    // A file's name and the text in it, in the reason why the graph cannot run.
    let file = bench.path(&format!("{SCRIPT}.dcm")).display().to_string();
    let (status, reply) = sender_set(write, &served, &json!({ "bone.kind": "surface.ct", "bone.path": file }));
    assert_eq!(status, 200, "{reply}");
    browser.wait_until("document.getElementById('verdict').textContent.includes('data set')");
    is_text(&mut browser, "document.getElementById('verdict').textContent");
    assert_eq!(sender_set(write, &served, &json!({ "bone.kind": null, "bone.path": null })).0, 200);
    let complain = |browser: &Browser| browser.events.iter().any(|event| event["method"] == "Runtime.exceptionThrown");
    assert!(!complain(&browser), "{:?}", browser.events);

    // The fields, buttons and the one sentence, by role.
    for (page, fields, write, sentence) in [
        (0, false, false, "may see, not change, play or save"),
        (1, true, false, "may see and steer"),
        (2, true, true, ""),
    ] {
        open(&mut browser, &served.pages[page]);
        browser.wait_until("osteoflow.state.changes?.values.length > 0");
        let enabled = |browser: &mut Browser, field: &str| {
            browser.evaluate(&format!("document.getElementById({field:?})?.disabled === false")).as_bool().unwrap()
        };
        assert_eq!(enabled(&mut browser, "field-icp.max_iterations"), fields);
        assert_eq!(enabled(&mut browser, "write"), write);
        // A free text may be a path.
        let states = "[...document.querySelectorAll('[id^=\"field-\"]')].map((f) => [f.id, f.type, f.disabled])";
        let states = browser.evaluate(states);
        let (mut n_texts, mut n_others) = (0, 0);
        for state in states.as_array().unwrap() {
            let is_text = state[1] == "text";
            let may_change = write || fields && !is_text;
            assert_eq!(state[2], json!(!may_change), "{page}: {state}");
            *if is_text { &mut n_texts } else { &mut n_others } += 1;
        }
        // Who may see only has no fields.
        assert_eq!((n_texts > 0, n_others > 10), (fields, fields), "{page}: {states}");
        assert_eq!(browser.evaluate("!document.getElementById('draw').hidden"), json!(write));
        let reply = browser.evaluate("document.getElementById('role').textContent");
        let reply = reply.as_str().unwrap();
        assert!(reply.contains(sentence) && reply.is_empty() == sentence.is_empty(), "{reply}");
        assert_eq!(browser.evaluate("document.getElementById('role').hidden"), json!(sentence.is_empty()));
    }
}

/// Another one, which would end an attribute or a script.
const CLOSES: &str = "\"></script><script>window.struck=1</script>";

/// Writes a recording of transforms whose topics, schemas and frames are scripts.
fn bag(path: &std::path::Path) {
    let mut writer = Writer::new(fs::File::create(path).unwrap(), WriteOptions::default()).unwrap();
    let transform = |parent: &str, child: &str| {
        json!({
            "timestamp": { "sec": 1_767_225_600, "nsec": 0 }, "parent_frame_id": parent, "child_frame_id": child,
            "translation": { "x": 0.1, "y": 0.0, "z": 0.0 }, "rotation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
        })
    };
    for (topic, schema, encoding, data) in [
        (SCRIPT, "foxglove.FrameTransform", "json", transform("world", SCRIPT)),
        ("/closes", "foxglove.FrameTransform", "json", transform("world", CLOSES)),
        (CLOSES, CLOSES, "json", json!({})),
        (&format!("/exact/{SCRIPT}"), SCRIPT, "osteoflow", json!({})),
        (&format!("/view/{SCRIPT}"), "foxglove.FrameTransform", "json", transform(SCRIPT, CLOSES)),
    ] {
        let schema = writer.add_schema(schema, "jsonschema", b"{}").unwrap();
        let channel = writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap();
        let (log_time, publish_time) = (1_767_225_600_000_000_000, 1_767_225_600_000_000_000);
        let header = MessageHeader { channel_id: channel, sequence: 0, log_time, publish_time };
        writer.write_message(header, data.to_string().into_bytes().into()).unwrap();
    }
    writer.finish().unwrap();
}

/// Nothing ran, nothing became an element, and the page has complained of nothing.
fn is_harmless(browser: &mut Browser, what: &str) {
    let harm = "[window.struck === undefined, document.querySelectorAll('img[onerror], [src=x], iframe').length, \
                [...document.scripts].filter((s) => s.textContent === 'window.struck=1').length]";
    assert_eq!(browser.evaluate(harm), json!([true, 0, 0]), "{what}");
    let thrown = browser.events.iter().find(|event| event["method"] == "Runtime.exceptionThrown");
    assert!(thrown.is_none(), "{what}: {thrown:?}");
}

#[test]
fn names_in_recordings_and_texts_in_dicom_are_text_for_view_report_and_info() {
    let Some(mut browser) = Browser::start("names_in_recordings_and_texts_in_dicom_are_text") else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let says = |arguments: &[&str]| {
        let output = osteoflow().current_dir(dir.path()).args(arguments).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.success(), String::from_utf8(text).unwrap())
    };
    bag(&path("bag.mcap"));
    // The channels of a recording, on the page of view.
    let served = Served::start(&["view", path("bag.mcap").to_str().unwrap()]);
    browser.events.clear();
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until(&format!("typeof osteoflow === 'object' && document.body.textContent.includes({SCRIPT:?})"));
    is_harmless(&mut browser, "view of a recording");
    drop(served);
    // Topics and frames of the graph that reads it, in the report of its run.
    let graph = format!(
        "[graph]\nformat = 1\nname = {SCRIPT:?}\n[node.bag]\nkind = \"acquire.mcap\"\npath = \"bag.mcap\"\n\
         out.a = {{ type = \"geometry/Pose\", topic = {SCRIPT:?}, to = \"world\", from = {SCRIPT:?} }}\n\
         out.b = {{ type = \"geometry/Pose\", topic = \"/closes\", to = \"world\", from = {CLOSES:?} }}\n\
         [results]\na = \"bag.a\"\nb = \"bag.b\"\n"
    );
    fs::write(path("g.toml"), graph).unwrap();
    let (is_done, said) = says(&["run", "g.toml", "--out", "r"]);
    assert!(is_done, "{said}");
    let (is_done, said) = says(&["report", "r"]);
    assert!(is_done, "{said}");
    browser.open(&path("r/report.html"));
    let shown = browser.evaluate("document.body.textContent");
    let shown = shown.as_str().unwrap();
    assert!(shown.contains(SCRIPT) && shown.contains(CLOSES), "the report shows the names");
    is_harmless(&mut browser, "report of a run on a recording");
    // A series whose texts are scripts.
    let texts = [0x0008_0080, 0x0008_1030, 0x0008_103e, 0x0010_0020, 0x0018_1030].map(|tag| (tag, "LO", SCRIPT));
    let texts = [&texts[..], &[(0x0010_0010, "PN", CLOSES), (0x0008_1010, "SH", CLOSES)]].concat();
    fs::create_dir(path("ct")).unwrap();
    (0..30).for_each(|k| fs::write(path("ct").join(format!("{k}.dcm")), layer(k, &texts)).unwrap());
    let (is_done, said) = says(&["info", "ct"]);
    assert!(is_done && !said.contains(CLOSES), "a patient's name is nobody's: {said}");
    let graph = "[graph]\nformat = 1\n[node.bone]\nkind = \"surface.ct\"\npath = \"ct\"\nthreshold_hu = 600\n\
                 [record]\nwires = [\"bone.*\"]\n[results]\nct = \"bone.report\"\n";
    fs::write(path("ct.toml"), graph).unwrap();
    let served = Served::start(&["view", path("ct.toml").to_str().unwrap(), "--out", path("c").to_str().unwrap()]);
    browser.events.clear();
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("typeof osteoflow === 'object' && osteoflow.state.state === 'complete'");
    is_harmless(&mut browser, "view of a series");
    drop(served);
    let (is_done, said) = says(&["report", "c"]);
    assert!(is_done, "{said}");
    browser.open(&path("c/report.html"));
    is_harmless(&mut browser, "report of a series");
}
