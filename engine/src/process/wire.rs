//! The messages between the program and the process of a node. docs/extend/processes.md describes them.

use crate::plan::Loads;
use osteoflow_node::{Empty, FiringDone, FiringSent, Join, StampNs, abi::schema::PayloadDescription};
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;
use std::path::PathBuf;

/// The version of the protocol; the process refuses another.
pub(crate) const VERSION: u32 = 1;

/// Shared memory that is new.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct NewSegment {
    pub(crate) id: u32,
    pub(crate) n_bytes: u64,
}

/// An item in shared memory, from the start of its segment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Place {
    pub(crate) segment: u32,
    pub(crate) n_bytes: u64,
}

/// What the program says.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ToWorker {
    Build(Box<Build>),
    Fire(Box<Fire>),
}

/// Builds a node, and ends the one before. With the first comes the descriptor of a page of memory, whose first byte becomes 1
/// when the user asks to stop.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Build {
    /// [`VERSION`].
    pub(crate) version: u32,
    pub(crate) node: String,
    pub(crate) kind: String,
    pub(crate) seed: u64,
    pub(crate) params: Json,
    pub(crate) joins: Vec<Join>,
    pub(crate) declared: Vec<Declared>,
    /// The plugin of the kind.
    pub(crate) plugin: Option<Library>,
    /// Payloads that plugins describe.
    pub(crate) payloads: Vec<PayloadDescription>,
    /// Threads for parallel algorithms.
    pub(crate) n_threads: usize,
    /// 0 (nothing) to 5 (trace).
    pub(crate) log_level: u32,
}

/// A plugin's library.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Library {
    pub(crate) path: PathBuf,
    pub(crate) sha256: String,
    /// The file to load in its stead, of the same content.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) copy: Option<PathBuf>,
    /// Its description, as the program has read it.
    pub(crate) description: Json,
}

/// An output that the graph declares.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Declared {
    pub(crate) name: String,
    pub(crate) payload: String,
    pub(crate) params: Json,
}

/// Asks for a firing.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Fire {
    pub(crate) context: FiringSent,
    pub(crate) slots: Vec<Slot>,
    /// Segments that are new, in the order of the descriptors that come with the message.
    pub(crate) new: Vec<NewSegment>,
    /// The segments of the process that the program still uses.
    pub(crate) held: Vec<u32>,
    /// The segments with constants that do not come again.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) released: Vec<u32>,
}

/// What a port brings.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Slot {
    Item(Place),
    /// The same item as whenever the place comes, until its segment is released.
    Constant(Place),
    Items(Vec<Place>),
    Absent(Empty),
}

/// What the process says.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FromWorker {
    /// The node is built.
    Built {
        #[serde(default)]
        max_delay_ns: StampNs,
        #[serde(default)]
        silent_after_ns: Option<u64>,
        /// Whether the process builds another node when this one is not needed any more.
        #[serde(default)]
        again: bool,
        /// What the plugin has loaded; `None` if it is nothing else than when it was last said.
        #[serde(default)]
        loads: Option<Loads>,
    },
    /// The node cannot be built.
    Refused {
        #[serde(default)]
        parameter: String,
        message: String,
    },
    /// A line for the log, at any time.
    Log { level: u32, target: String, message: String },
    /// The answer to a firing.
    Answer(Box<Reply>),
}

/// The answer to a firing.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Reply {
    /// The number of the firing: an answer to another one is refused.
    pub(crate) item: u64,
    pub(crate) ended: FiringOutcome,
    /// One for each output; none unless it ended well.
    #[serde(default)]
    pub(crate) outputs: Vec<Emitted>,
    #[serde(default)]
    pub(crate) context: FiringDone,
    #[serde(default)]
    pub(crate) new: Vec<NewSegment>,
    #[serde(default)]
    pub(crate) held: Vec<u32>,
    /// Processor time of the firing, on all threads of the process.
    #[serde(default)]
    pub(crate) cpu_ns: u64,
    /// As in `Built`.
    #[serde(default)]
    pub(crate) loads: Option<Loads>,
}

/// How a firing ended.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FiringOutcome {
    Well,
    /// A source has no more items.
    End,
    Failed(String),
    Panicked(String),
}

/// What an output gives.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Emitted {
    Value(Place),
    Empty(String),
    PassedOn(Empty),
    Silent,
}
