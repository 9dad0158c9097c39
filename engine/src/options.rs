//! Options of a run.

use crate::{runtime::Injection, store::Store};
use std::{
    collections::BTreeMap,
    fmt,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64},
    },
};

/// Key of [`RunOptions::command`]: the names of nodes that are functions of the program that runs the graph.
pub const GIVEN_NODES: &str = "given_nodes";

/// How to run a graph and which files to write.
#[osteoflow_node::params]
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Number of threads that run nodes; with 1 all nodes run on the calling thread.
    #[param(1)]
    pub workers: usize,
    /// For testing: seed for random delays, spurious wake-ups and another order of nodes; the results do not depend on
    /// it.
    pub shuffle: Option<u64>,
    /// For testing: the time since the run began, ns, by which contracts of time are judged; `None` is this machine's.
    pub clock: Option<Arc<AtomicU64>>,
    /// Where `run.mcap`, `results.json` and `manifest.json` are written; created if missing. `None` writes no files.
    pub out_dir: Option<PathBuf>,
    /// Whether the plan's recorded wires are written to `run.mcap`.
    pub record: bool,
    /// Whether the latency from each source to each sink is measured; every firing is then timed on its own.
    pub latency: bool,
    /// Whether the processor time of each node's firings is measured.
    pub cpu_time: bool,
    /// Constants put at the start of `results.json`, by dotted key.
    pub fixed_results: Vec<(String, serde_json::Value)>,
    /// Stop request, set from outside: the sources stop and the items in flight are processed.
    pub cancelled: Arc<AtomicBool>,
    /// Description of the command and the machine, for the manifest.
    pub command: serde_json::Value,
    /// Injected failures, for testing how a graph fails.
    pub inject: Vec<Injection>,
    /// Store of cached answers, looked up before a node whose kind is cached fires. The results and recorded wires are
    /// the same with and without; `None` computes everything.
    pub store: Option<Arc<Store>>,
    /// Receives what is recorded while it is recorded; nothing if `record` is not set.
    pub listener: Option<Arc<dyn Listener>>,
}

/// Receives the channels and messages of a recording in the order of its file, such as a server of viewers.
///
/// It is called on the recorder's thread, which the graph may have to wait for: it must not wait itself.
pub trait Listener: fmt::Debug + Send + Sync {
    /// A channel, before its first message.
    fn channel(&self, channel: ListenedChannel);

    /// A message of a channel.
    fn message(&self, channel: u16, log_time_ns: u64, data: Vec<u8>);
}

/// A channel of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ListenedChannel {
    /// Its number in the recording.
    pub id: u16,
    /// Its topic, such as `/exact/icp.t_target_source`.
    pub topic: String,
    /// The encoding of its messages.
    pub encoding: String,
    /// The name of their schema.
    pub schema_name: String,
    /// The encoding of the schema.
    pub schema_encoding: String,
    /// The schema.
    pub schema: Arc<[u8]>,
    /// Its metadata: node, port, kind, units.
    pub metadata: BTreeMap<String, String>,
}
