//! Messages of a server of the Foxglove WebSocket protocol, as far as a client that only reads needs them.

use bytes::Bytes;
use serde_json::{Value, json};
use std::{collections::BTreeMap, sync::Arc};

/// The subprotocols, the preferred one first.
pub(super) const SUBPROTOCOLS: &str = "foxglove.sdk.v1, foxglove.websocket.v1";

/// Opcodes of binary messages that are not skipped.
const MESSAGE_DATA: u8 = 1;
/// Largest opcode of the protocol: time, service response, asset and playback state.
const LAST_OPCODE: u8 = 5;
/// Opcode, subscription and time.
const HEAD_BYTES: usize = 13;
/// Characters of a foreign text that are repeated.
const N_CHARS: usize = 300;

/// A channel that a server advertises.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Channel {
    pub(super) id: u64,
    pub(super) topic: String,
    pub(super) encoding: Arc<str>,
    pub(super) schema_name: Arc<str>,
}

/// A message of the server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum FromServer {
    /// Its name, and what it states of what it plays.
    Info(String, BTreeMap<String, String>),
    /// Channels, and the number of those that could not be read.
    Advertise(Vec<Channel>, usize),
    Unadvertise(Vec<u64>),
    /// A level from 0, information, to 2, error.
    Status(u64, String),
    Data {
        subscription: u32,
        log_time_ns: u64,
        data: Bytes,
    },
    /// Valid, but not for this client.
    Other,
}

impl FromServer {
    /// # Errors
    /// What is wrong with the message.
    pub(super) fn of_text(text: &str) -> Result<Self, String> {
        let message: Value = serde_json::from_str(text)
            .map_err(|error| format!("a text message is no JSON ({error}): \"{}\"", shortened(text)))?;
        let words = |of: &Value, key: &str| of[key].as_str().map(str::to_owned);
        let ids = |key: &str| message[key].as_array().map(|all| all.iter().filter_map(Value::as_u64).collect());
        let lacks = |what: &str| format!("a message lacks {what}: \"{}\"", shortened(text));
        Ok(match message["op"].as_str().ok_or_else(|| lacks("its op"))? {
            "serverInfo" => {
                let metadata = message["metadata"].as_object().into_iter().flatten();
                let metadata = metadata.filter_map(|(key, value)| Some((key.clone(), value.as_str()?.to_owned())));
                Self::Info(shortened(&words(&message, "name").unwrap_or_default()), metadata.collect())
            }
            "advertise" => {
                let all = message["channels"].as_array().ok_or_else(|| lacks("its channels"))?;
                let channel = |of: &Value| {
                    let (topic, [encoding, schema_name]) =
                        (words(of, "topic")?, ["encoding", "schemaName"].map(|key| words(of, key)));
                    let (encoding, schema_name) = (encoding?.into(), schema_name?.into());
                    Some(Channel { id: of["id"].as_u64()?, topic, encoding, schema_name })
                };
                let channels: Vec<Channel> = all.iter().filter_map(channel).collect();
                let n_unread = all.len() - channels.len();
                Self::Advertise(channels, n_unread)
            }
            "unadvertise" => Self::Unadvertise(ids("channelIds").ok_or_else(|| lacks("its channelIds"))?),
            "status" => Self::Status(
                message["level"].as_u64().ok_or_else(|| lacks("its level"))?,
                shortened(&words(&message, "message").unwrap_or_default()),
            ),
            _ => Self::Other,
        })
    }

    /// # Errors
    /// What is wrong with the message.
    pub(super) fn of_binary(bytes: &Bytes) -> Result<Self, String> {
        match bytes.first() {
            None => Err("a binary message is empty".into()),
            Some(&MESSAGE_DATA) => {
                let (Some(subscription), Some(time)) = (bytes.get(1..5), bytes.get(5..HEAD_BYTES)) else {
                    return Err(format!(
                        "a message has {} bytes, {HEAD_BYTES} before its data are needed",
                        bytes.len()
                    ));
                };
                Ok(Self::Data {
                    subscription: u32::from_le_bytes(subscription.try_into().unwrap_or_default()),
                    log_time_ns: u64::from_le_bytes(time.try_into().unwrap_or_default()),
                    data: bytes.slice(HEAD_BYTES..),
                })
            }
            Some(2..=LAST_OPCODE) => Ok(Self::Other),
            Some(opcode) => Err(format!("a binary message has opcode {opcode}, which the protocol does not know")),
        }
    }
}

/// The request for channels, pairs of subscription and channel.
pub(super) fn subscribe(pairs: &[(u32, u64)]) -> String {
    let rows: Vec<Value> = pairs.iter().map(|(id, channel)| json!({ "id": id, "channelId": channel })).collect();
    json!({ "op": "subscribe", "subscriptions": rows }).to_string()
}

/// The beginning of a text of the other side, without control characters.
pub(super) fn shortened(text: &str) -> String {
    let all: String = text.chars().take(N_CHARS).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if all.len() < text.len() { format!("{all}...") } else { all }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_of_a_server_are_read() {
        let channel = json!({ "id": 7, "topic": "/scan", "encoding": "cdr", "schemaName": "sensor_msgs/msg/PointCloud2", "schema": "" });
        let read = |value: Value| FromServer::of_text(&value.to_string());
        let expected = Channel {
            id: 7,
            topic: "/scan".into(),
            encoding: "cdr".into(),
            schema_name: "sensor_msgs/msg/PointCloud2".into(),
        };
        let with_broken = json!({ "op": "advertise", "channels": [channel, { "id": "x" }, 3] });
        assert_eq!(read(with_broken), Ok(FromServer::Advertise(vec![expected], 2)));
        assert_eq!(read(json!({ "op": "unadvertise", "channelIds": [7] })), Ok(FromServer::Unadvertise(vec![7])));
        let status = json!({ "op": "status", "level": 2, "message": "too slow" });
        assert_eq!(read(status), Ok(FromServer::Status(2, "too slow".into())));
        assert_eq!(read(json!({ "op": "connectionGraphUpdate" })), Ok(FromServer::Other));
        let bytes = [&[1][..], &7_u32.to_le_bytes(), &9_u64.to_le_bytes(), b"data"].concat();
        let data = FromServer::Data { subscription: 7, log_time_ns: 9, data: Bytes::from_static(b"data") };
        assert_eq!(FromServer::of_binary(&bytes.into()), Ok(data));
        assert_eq!(FromServer::of_binary(&Bytes::from_static(&[2, 0, 0])), Ok(FromServer::Other));
    }

    #[test]
    fn what_is_no_message_is_described() {
        for (text, expected) in [
            ("hello", "a text message is no JSON"),
            ("{\"op\": \"advertise\"}", "lacks its channels"),
            ("[1]", "lacks its op"),
            ("{\"op\": \"status\"}", "lacks its level"),
        ] {
            let error = FromServer::of_text(text).unwrap_err();
            assert!(error.contains(expected) && error.contains(text), "{error}");
        }
        assert!(FromServer::of_text(&"x".repeat(100_000)).unwrap_err().len() < 500);
        for (bytes, expected) in
            [(&[][..], "is empty"), (&[1, 0, 0], "has 3 bytes, 13"), (&[9, 0], "opcode 9"), (&[0], "opcode 0")]
        {
            let error = FromServer::of_binary(&Bytes::from_static(bytes)).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
