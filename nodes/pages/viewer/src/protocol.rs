//! Messages of the Foxglove WebSocket protocol, subprotocols `foxglove.sdk.v1` and `foxglove.websocket.v1`.
//!
//! Only what this server needs: channels, subscriptions, parameters, services, status and playback control. JSON messages
//! have an `op`; binary ones begin with their opcode, numbers are little-endian.

use crate::door::{Door, Role};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use osteoflow_engine::run::ListenedChannel;
use serde_json::{Value, json};

/// The subprotocols that are spoken, the preferred one first.
pub(crate) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Opcodes of the server's binary messages.
const MESSAGE: u8 = 1;
const SERVICE_RESPONSE: u8 = 3;
pub(crate) const PLAYBACK_STATE: u8 = 5;
/// The schema of any object; viewers ask for its properties.
pub(crate) const ANY_OBJECT: &str = r#"{"type":"object","properties":{}}"#;

/// Opcodes of the client's binary messages.
const SERVICE_REQUEST: u8 = 2;
const PLAYBACK_CONTROL: u8 = 3;

/// A message of a client.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum FromClient {
    /// Subscription and channel.
    Subscribe(Vec<(u32, u32)>),
    Unsubscribe(Vec<u32>),
    GetParameters {
        names: Vec<String>,
        id: Option<String>,
    },
    SetParameters {
        values: Vec<(String, Value)>,
        id: Option<String>,
    },
    Service(ServiceCall),
    Playback(PlaybackRequest),
    /// Valid, but not for this server.
    Other,
}

impl FromClient {
    /// The door that it is for; `services` are those of the server.
    pub(crate) fn door(&self, services: &[Door]) -> Result<Door, String> {
        Ok(match self {
            Self::Subscribe(_) | Self::Unsubscribe(_) => Door::Subscribe,
            Self::GetParameters { .. } => Door::GetParameters,
            Self::SetParameters { .. } => Door::SetParameters,
            Self::Service(call) => {
                let door = (call.service as usize).checked_sub(1).and_then(|index| services.get(index));
                *door.ok_or_else(|| "there is no such service".to_owned())?
            }
            Self::Playback(_) => Door::Playback,
            Self::Other => Door::Stream,
        })
    }
}

/// A call of a service.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ServiceCall {
    pub(crate) service: u32,
    pub(crate) call: u32,
    /// JSON.
    pub(crate) request: Value,
}

/// What a client wants of the playback.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PlaybackRequest {
    pub(crate) plays: bool,
    pub(crate) speed: f32,
    pub(crate) seek_ns: Option<u64>,
    pub(crate) id: String,
}

/// How the playback goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlaybackState {
    /// Whether time advances.
    pub(crate) plays: bool,
    /// Whether the end was reached.
    pub(crate) ended: bool,
    /// Time of the recording, ns.
    pub(crate) at_ns: u64,
    /// Seconds of the recording in a second.
    pub(crate) speed: f32,
}

/// Severity of a status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Level {
    Warning = 1,
    Error = 2,
}

pub(crate) fn server_info(
    name: &str,
    session: &str,
    role: Role,
    services: bool,
    range_ns: Option<(u64, u64)>,
) -> String {
    let mut capabilities = vec!["parameters", "parametersSubscribe"];
    if services {
        capabilities.push("services");
    }
    let mut info = json!({
        "op": "serverInfo", "name": name, "sessionId": session, "supportedEncodings": ["json"],
        "metadata": { "role": role.word() },
    });
    if let Some((start, end)) = range_ns {
        if Door::Playback.needs() <= role {
            capabilities.push("playbackControl");
        }
        let time = |ns: u64| json!({ "sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000 });
        info["dataStartTime"] = time(start);
        info["dataEndTime"] = time(end);
    }
    info["capabilities"] = json!(capabilities);
    info.to_string()
}

/// Schemas in text are sent as they are, binary ones in base 64.
pub(crate) fn advertise<'a>(channels: impl IntoIterator<Item = (&'a u32, &'a ListenedChannel)>) -> String {
    let row = |(id, channel): (&u32, &ListenedChannel)| {
        let schema = match channel.schema_encoding.as_str() {
            "protobuf" | "flatbuffer" => STANDARD.encode(&channel.schema),
            _ => String::from_utf8_lossy(&channel.schema).into_owned(),
        };
        let mut row = json!({
            "id": id, "topic": channel.topic, "encoding": channel.encoding, "schemaName": channel.schema_name,
            "schemaEncoding": channel.schema_encoding, "schema": schema,
        });
        // For our own page: the frame in which it shows the others.
        if let Some(origin) = channel.metadata.get("origin") {
            row["origin"] = json!(origin);
        }
        row
    };
    json!({ "op": "advertise", "channels": channels.into_iter().map(row).collect::<Vec<_>>() }).to_string()
}

pub(crate) fn unadvertise(channels: &[u32]) -> String {
    json!({ "op": "unadvertise", "channelIds": channels }).to_string()
}

/// The services of a role. They are numbered from 1, those of all roles alike.
pub(crate) fn advertise_services(services: &[Door], role: Role) -> String {
    let row = |(id, door): (u32, &Door)| {
        let name = door.service().filter(|_| door.needs() <= role)?;
        let schema =
            json!({ "encoding": "json", "schemaName": name, "schemaEncoding": "jsonschema", "schema": ANY_OBJECT });
        Some(json!({ "id": id, "name": name, "type": name, "request": schema, "response": schema }))
    };
    json!({ "op": "advertiseServices", "services": (1..).zip(services).filter_map(row).collect::<Vec<_>>() })
        .to_string()
}

pub(crate) fn parameter_values(values: &[(String, Value)], id: Option<&str>) -> String {
    let rows: Vec<_> = values.iter().map(|(name, value)| json!({ "name": name, "value": value })).collect();
    let mut message = json!({ "op": "parameterValues", "parameters": rows });
    if let Some(id) = id {
        message["id"] = id.into();
    }
    message.to_string()
}

/// A status with an `id` replaces the one of that id.
pub(crate) fn status(level: Level, message: &str, id: &str) -> String {
    json!({ "op": "status", "level": level as u8, "message": message, "id": id }).to_string()
}

pub(crate) fn service_failure(call: &ServiceCall, message: &str) -> String {
    json!({ "op": "serviceCallFailure", "serviceId": call.service, "callId": call.call, "message": message })
        .to_string()
}

pub(crate) fn service_response(call: &ServiceCall, reply: &Value) -> Vec<u8> {
    const ENCODING: &[u8] = b"json";
    let reply = reply.to_string();
    let mut out = vec![SERVICE_RESPONSE];
    out.extend(call.service.to_le_bytes());
    out.extend(call.call.to_le_bytes());
    out.extend((ENCODING.len() as u32).to_le_bytes());
    out.extend(ENCODING);
    out.extend(reply.as_bytes());
    out
}

pub(crate) fn message(subscription: u32, log_time_ns: u64, data: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(13 + data.len());
    out.push(MESSAGE);
    out.extend(subscription.to_le_bytes());
    out.extend(log_time_ns.to_le_bytes());
    out.extend(data);
    out
}

pub(crate) fn playback_state(state: &PlaybackState, did_seek: bool, request: &str) -> Vec<u8> {
    let status = if state.ended { 3 } else { u8::from(!state.plays) };
    let mut out = vec![PLAYBACK_STATE, status];
    out.extend(state.at_ns.to_le_bytes());
    out.extend(state.speed.to_le_bytes());
    out.push(did_seek.into());
    out.extend((request.len() as u32).to_le_bytes());
    out.extend(request.as_bytes());
    out
}

/// Reads a text message.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn read_text(text: &str) -> Result<FromClient, String> {
    let message: Value = serde_json::from_str(text).map_err(|error| format!("a message is no JSON: {error}"))?;
    let op = message["op"].as_str().ok_or("a message has no op")?;
    let number = |value: &Value| value.as_u64().and_then(|n| u32::try_from(n).ok());
    let rows = |key: &str| message[key].as_array().ok_or(format!("{op} has no {key}"));
    let id = || message["id"].as_str().map(str::to_owned);
    Ok(match op {
        "subscribe" => {
            let pair = |row: &Value| Some((number(&row["id"])?, number(&row["channelId"])?));
            let pairs: Option<_> = rows("subscriptions")?.iter().map(pair).collect();
            FromClient::Subscribe(pairs.ok_or("subscribe has a subscription without id or channelId")?)
        }
        "unsubscribe" => {
            let ids: Option<_> = rows("subscriptionIds")?.iter().map(number).collect();
            FromClient::Unsubscribe(ids.ok_or("unsubscribe has an id that is no number")?)
        }
        "getParameters" => {
            let names = rows("parameterNames")?.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect();
            FromClient::GetParameters { names, id: id() }
        }
        "setParameters" => {
            let pair = |row: &Value| Some((row["name"].as_str()?.to_owned(), row["value"].clone()));
            let values: Option<_> = rows("parameters")?.iter().map(pair).collect();
            FromClient::SetParameters {
                values: values.ok_or("setParameters has a parameter without a name")?,
                id: id(),
            }
        }
        _ => FromClient::Other,
    })
}

/// Reads a binary message.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn read_binary(bytes: &[u8]) -> Result<FromClient, String> {
    let short = || "a binary message is too short".to_owned();
    let (&opcode, mut rest) = bytes.split_first().ok_or_else(short)?;
    let mut take = |n: usize| -> Result<&[u8], String> {
        let (head, tail) = rest.split_at_checked(n).ok_or_else(short)?;
        rest = tail;
        Ok(head)
    };
    let array = |bytes: &[u8]| -> [u8; 4] { std::array::from_fn(|k| bytes[k]) };
    match opcode {
        SERVICE_REQUEST => {
            let (service, call) = (u32::from_le_bytes(array(take(4)?)), u32::from_le_bytes(array(take(4)?)));
            let n = u32::from_le_bytes(array(take(4)?)) as usize;
            let encoding = take(n)?;
            if encoding != b"json" {
                return Err(format!("services take json, not {}", String::from_utf8_lossy(encoding)));
            }
            let request =
                if rest.is_empty() { Value::Null } else { serde_json::from_slice(rest).map_err(|e| e.to_string())? };
            Ok(FromClient::Service(ServiceCall { service, call, request }))
        }
        PLAYBACK_CONTROL => {
            let plays = match take(1)? {
                [0] => true,
                [1] => false,
                other => return Err(format!("playback command {other:?} is neither play nor pause")),
            };
            let speed = f32::from_le_bytes(array(take(4)?));
            let seeks = take(1)? != [0];
            let at: [u8; 8] = take(8)?.try_into().map_err(|_| short())?;
            let n = u32::from_le_bytes(array(take(4)?)) as usize;
            let id = std::str::from_utf8(take(n)?).map_err(|_| "a request id is no UTF-8")?.to_owned();
            let seek_ns = seeks.then(|| u64::from_le_bytes(at));
            Ok(FromClient::Playback(PlaybackRequest { plays, speed, seek_ns, id }))
        }
        _ => Ok(FromClient::Other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_of_clients_are_read_and_damaged_ones_are_errors() {
        let text = r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":10},{"id":2,"channelId":20}]}"#;
        assert_eq!(read_text(text), Ok(FromClient::Subscribe(vec![(1, 10), (2, 20)])));
        assert_eq!(read_text(r#"{"op":"unsubscribe","subscriptionIds":[3]}"#), Ok(FromClient::Unsubscribe(vec![3])));
        assert_eq!(read_text(r#"{"op":"subscribeConnectionGraph"}"#), Ok(FromClient::Other));
        for bad in [
            "",
            "{",
            "[]",
            r#"{"op":1}"#,
            r#"{"op":"subscribe"}"#,
            r#"{"op":"subscribe","subscriptions":[{"id":-1}]}"#,
            r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":4294967296}]}"#,
            r#"{"op":"setParameters","parameters":[{}]}"#,
        ] {
            assert!(read_text(bad).is_err(), "{bad}");
        }
    }

    /// The bytes of the protocol's own test of a request: play at speed 1, seek to 100.5 s, "some-id".
    #[test]
    fn playback_requests_are_read_byte_by_byte_and_no_prefix_is_taken_for_a_whole_one() {
        let mut bytes = vec![3, 0];
        bytes.extend(1.0_f32.to_le_bytes());
        bytes.push(1);
        bytes.extend(100_500_000_000_u64.to_le_bytes());
        bytes.extend(7_u32.to_le_bytes());
        bytes.extend(b"some-id");
        let expected =
            PlaybackRequest { plays: true, speed: 1.0, seek_ns: Some(100_500_000_000), id: "some-id".into() };
        assert_eq!(read_binary(&bytes), Ok(FromClient::Playback(expected)));
        for n in 0..bytes.len() {
            assert!(read_binary(&bytes[..n]).is_err(), "{n} bytes");
        }
        bytes[1] = 2;
        assert!(read_binary(&bytes).is_err());
    }

    #[test]
    fn a_service_call_is_answered_with_its_own_numbers() {
        let mut bytes = vec![2, 7, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0];
        bytes.extend(b"json{\"a\":1}");
        let Ok(FromClient::Service(call)) = read_binary(&bytes) else { panic!("a call") };
        assert_eq!((call.service, call.call, &call.request["a"]), (7, 9, &json!(1)));
        let reply = service_response(&call, &json!({ "b": 2 }));
        assert_eq!(reply, [&[3, 7, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0], &b"json{\"b\":2}"[..]].concat());
    }

    #[test]
    fn a_message_has_subscription_time_and_data() {
        assert_eq!(message(30, 1234, b"x"), [1, 30, 0, 0, 0, 210, 4, 0, 0, 0, 0, 0, 0, b'x']);
    }

    #[test]
    fn schemas_of_protobuf_are_in_base_64_and_text_is_text() {
        let channel = |encoding: &str, schema: &[u8]| ListenedChannel {
            id: 1,
            topic: "/t".into(),
            encoding: "e".into(),
            schema_name: "s".into(),
            schema_encoding: encoding.into(),
            schema: schema.into(),
            metadata: Default::default(),
        };
        let channels = [channel("protobuf", &[0, 255]), channel("jsonschema", b"{}")];
        let text = advertise([1, 2].iter().zip(&channels));
        let message: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(
            (&message["channels"][0]["schema"], &message["channels"][1]["schema"]),
            (&json!("AP8="), &json!("{}"))
        );
    }
}
