//! Messages about the run itself, in JSON, one topic each.

use super::Topic;
use osteoflow_node::ClockReading;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::{Value as Json, json};

/// A message about the run.
pub(crate) trait RunMessage: Serialize + Sized {
    /// Its topic.
    const TOPIC: Topic<'static>;
    /// The name of its schema, and the JSON Schema.
    const SCHEMA: (&'static str, fn() -> Json);

    /// Reads one.
    ///
    /// # Errors
    /// What is wrong with it, and its topic.
    fn read(data: &[u8]) -> Result<Self, String>
    where
        Self: DeserializeOwned,
    {
        serde_json::from_slice(data)
            .map_err(|error| format!("a message of {} cannot be read: {error}", Self::TOPIC.name()))
    }
}

/// Wall-clock times of firings: node, item, start in nanoseconds since the start of the run, duration in nanoseconds.
#[derive(Serialize)]
pub(crate) struct Timing<'a> {
    pub(crate) firings: Vec<(&'a str, u64, u64, u64)>,
}

/// Items that policies dropped: wire, input, number.
#[derive(Serialize, Deserialize)]
pub(crate) struct Drops {
    pub(crate) drops: Vec<(String, String, u64)>,
}

/// Clock readings of a firing, in order; a replay returns the same.
#[derive(Serialize, Deserialize)]
pub(crate) struct Live {
    pub(crate) node: String,
    pub(crate) item: u64,
    pub(crate) readings: Vec<ClockReading>,
}

/// A message of a node, as `foxglove.Log`, which viewers list.
#[derive(Serialize)]
pub(crate) struct Log<'a> {
    timestamp: Time,
    level: u8,
    message: &'a str,
    name: &'a str,
    file: &'static str,
    line: u32,
}

/// The levels of `foxglove.Log` that are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum LogLevel {
    Info = 2,
    Warning = 3,
    Error = 4,
}

#[derive(Serialize)]
struct Time {
    sec: u64,
    nsec: u64,
}

impl<'a> Log<'a> {
    /// A message of the node `name`.
    pub(crate) fn new(time_ns: u64, level: LogLevel, name: &'a str, message: &'a str) -> Self {
        let timestamp = Time { sec: time_ns / 1_000_000_000, nsec: time_ns % 1_000_000_000 };
        Self { timestamp, level: level as u8, message, name, file: "", line: 0 }
    }
}

impl RunMessage for Log<'_> {
    const TOPIC: Topic<'static> = Topic::Log;
    const SCHEMA: (&'static str, fn() -> Json) = ("foxglove.Log", || {
        let time = json!({ "sec": { "type": "integer" }, "nsec": { "type": "integer" } });
        let properties = json!({
            "timestamp": { "type": "object", "title": "time", "properties": time },
            "level": { "type": "integer", "description": "2 info, 3 warning, 4 error" },
            "message": { "type": "string" },
            "name": { "type": "string", "description": "the node" },
            "file": { "type": "string" },
            "line": { "type": "integer" },
        });
        json!({ "title": "foxglove.Log", "type": "object", "properties": properties })
    });
}

/// A list of rows. Viewers refuse a channel whose schema has lists of lists, so it is described in words alone.
fn rows(name: &str, doc: &str) -> Json {
    json!({ "type": "object", "description": format!("{name}: a list of rows of {doc}"), "properties": {} })
}

impl RunMessage for Timing<'_> {
    const TOPIC: Topic<'static> = Topic::Timing;
    const SCHEMA: (&'static str, fn() -> Json) = ("osteoflow.Timing", || {
        rows(
            "firings",
            "node, item, when it began in ns since the run began, how long it took in ns; by the wall clock",
        )
    });
}

impl RunMessage for Drops {
    const TOPIC: Topic<'static> = Topic::Drops;
    const SCHEMA: (&'static str, fn() -> Json) =
        ("osteoflow.Drops", || rows("drops", "wire, input, number of the item that the input's policy dropped"));
}

impl RunMessage for Live {
    const TOPIC: Topic<'static> = Topic::Live;
    const SCHEMA: (&'static str, fn() -> Json) = ("osteoflow.Live", || {
        let properties = json!({
            "node": { "type": "string" },
            "item": { "type": "integer", "description": "number of the firing" },
        });
        let doc = "readings: of the clock in this firing, in order; a replay answers with them";
        json!({ "type": "object", "description": doc, "properties": properties })
    });
}
