//! The keys of a graph file, table by table, shared by the reader and the JSON Schema.

/// The top level.
pub(crate) const TOP: [&str; 9] =
    ["graph", "node", "record", "results", "extends", "remove", "module", "plugins", "sweep"];
/// A plugin, in `plugins`.
pub(crate) const PLUGIN: [&str; 2] = ["file", "interpreter"];
/// `[graph]`.
pub(crate) const GRAPH: [&str; 5] = ["format", "name", "seed", "frames", "lossy"];
/// The keys of a node's table that are no parameters.
pub(crate) const NODE: [&str; 6] = ["kind", "in", "out", "on_error", "process", "stop_after_s"];
/// A node that is a module.
pub(crate) const MODULE_NODE: [&str; 3] = ["kind", "file", "in"];
/// The table of an input.
pub(crate) const INPUT: [&str; 9] =
    ["from", "capacity", "max_bytes", "policy", "every", "join", "tolerance_ms", "max_gap_ms", "n"];
/// `[record]`.
pub(crate) const RECORD: [&str; 4] = ["wires", "sources", "compression", "views"];
/// The entry of `[results]` that is the verdict on the results.
pub(crate) const VERDICT: &str = "verdict";
/// The key of `[results]` that is no wire: the answer that the verdict must give at least.
pub(crate) const REQUIRE: &str = "require";
/// The answers that `require` takes.
pub(crate) const REQUIRED: [&str; 2] = ["doubtful", "trusted"];
/// An entry of `[results]`.
pub(crate) const RESULT: [&str; 3] = ["from", "all", "optional"];
/// `[module]`.
pub(crate) const MODULE: [&str; 4] = ["doc", "inputs", "outputs", "params"];
/// An input of a module.
pub(crate) const MODULE_INPUT: [&str; 3] = ["to", "doc", "optional"];
/// An output of a module.
pub(crate) const MODULE_OUTPUT: [&str; 2] = ["from", "doc"];
/// A parameter of a module.
pub(crate) const MODULE_PARAM: [&str; 4] = ["to", "doc", "default", "required"];
/// `[sweep]`.
pub(crate) const SWEEP: [&str; 10] =
    ["repeat", "same_seed", "units", "pair", "factor", "draw", "columns", "points", "limit", "compare"];
/// `[sweep.factor]`: a factor.
pub(crate) const FACTOR: [&str; 8] = ["key", "keys", "values", "labels", "from", "to", "n", "log"];
/// The distributions of a draw.
pub(crate) const DISTRIBUTIONS: [&str; 5] = ["uniform", "normal", "log_uniform", "integers", "choice"];
/// `[sweep.draw]`: a draw.
pub(crate) const DRAW: [&str; 7] = ["key", "keys", "uniform", "normal", "log_uniform", "integers", "choice"];
/// `[sweep.points]`: a list of points.
pub(crate) const POINTS: [&str; 3] = ["from", "name", "axes"];
/// `[sweep.compare]`.
pub(crate) const COMPARE: [&str; 3] = ["factor", "to", "margin"];
/// The joins that a graph may choose.
pub(crate) const JOINS: [&str; 6] = ["each", "stamp", "collect", "latest", "interpolate", "once"];
/// The policies of a link.
pub(crate) const POLICIES: [&str; 5] = ["block", "drop_old", "drop_new", "sample", "fail"];
