use crate::{
    Body, Context, Emission, InputPort, Item, Joined, Kept, NodeError, OutputPorts, ParamError, Payload, Slot, Value,
};
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use std::time::Duration;

/// A stage of a graph: fires when its ports join, and answers a value or an empty on every output.
pub trait Node: Describe + Send + Sized + 'static {
    /// `stage.variant`, as graph files name it.
    const KIND: &'static str;
    /// Whether its answers are kept from one run to the next.
    const KEPT: Kept = Kept::No;
    /// The parameters, with defaults, ranges and reasons in their docs.
    type Params: Parameters;
    /// The input ports.
    type Inputs: Inputs;
    /// The output ports.
    type Outputs: Outputs;

    /// Builds the node; only after the whole graph has been checked.
    ///
    /// # Errors
    /// [`ParamError`] for values that no single range can refuse.
    fn new(params: Self::Params) -> Result<Self, ParamError>;

    /// One firing.
    ///
    /// # Errors
    /// [`NodeError`] if there is no result; the outputs then get an empty with the reason.
    fn process(&mut self, inputs: Self::Inputs, ctx: &mut Context) -> Result<Self::Outputs, NodeError>;
}

/// After how long without an answer a live source counts as silent where it does not say so itself: 5 s, longer than any
/// camera takes between two clouds, and short enough for someone who stands beside it.
pub const SILENT_AFTER: Duration = Duration::from_secs(5);

/// A node without inputs.
pub trait Source: Describe + Send + Sized + 'static {
    /// `stage.variant`, as graph files name it.
    const KIND: &'static str;
    /// Whether it follows the world's clock, so that lossy wires may hang on it.
    const LIVE: bool = false;
    /// Whether it gives constants: one item on each output, without a time (stamp 0), and then ends.
    const CONSTANT: bool = false;
    /// The parameters, with defaults, ranges and reasons in their docs.
    type Params: Parameters;
    /// The output ports; [`crate::Declared`] where the graph declares them.
    type Outputs: Outputs;

    /// Builds the source; reads nothing yet.
    ///
    /// # Errors
    /// [`ParamError`] for values that no single range can refuse.
    fn new(params: Self::Params) -> Result<Self, ParamError>;

    /// For a live source: how far the stamp of an item on one port may lie behind the newest on any other, ns. Where its
    /// other ports have come so far, nothing more is waited for on a port that stays silent; what comes later than that
    /// is late, and an empty stands in its place. 0: all ports come in the order of their stamps.
    fn max_delay_ns(&self) -> crate::StampNs {
        0
    }

    /// For a live source: after how long without an answer the run says that it is silent.
    fn silent_after(&self) -> Duration {
        SILENT_AFTER
    }

    /// The next answer, at the stamp given to [`Context::set_stamp_ns`]; `None` at the end. Ports may stay silent.
    ///
    /// A live source may wait for its device here, on a thread of its own. It notices the wish to stop
    /// ([`Context::cancelled`], [`Context::wait_until`]) within half a second; else the run ends without it.
    ///
    /// # Errors
    /// [`NodeError`] if nothing more can be read.
    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError>;
}

/// Parameters: read by serde, described by schemars where they live.
pub trait Parameters: DeserializeOwned + JsonSchema {}

impl<P: DeserializeOwned + JsonSchema> Parameters for P {}

/// What a kind says of itself; derived from the doc comment and `#[describe(example = "...", literature = ["..."])]`.
pub trait Describe {
    /// The doc comment: its first paragraph is the summary.
    const DOC: &'static str;
    /// The node's table as a graph file would hold it, parameters that matter included; checked in a test.
    const EXAMPLE: &'static str;
    /// Paper, section, equation.
    const LITERATURE: &'static [&'static str];
}

/// The input ports of a node; derived.
pub trait Inputs: Sized {
    /// The ports in order.
    fn ports() -> Vec<InputPort>;

    /// The values of one firing: handles on what `joined` keeps, or the very values where it is spent.
    ///
    /// # Errors
    /// [`NodeError`] if the engine joined something else than declared.
    fn take(joined: &mut Joined) -> Result<Self, NodeError>;
}

/// The output ports of a node; derived.
pub trait Outputs: Sized {
    /// The ports in order.
    fn ports() -> OutputPorts;

    /// Puts an emission for each port into `out`, in order; `out` holds one for each, all silent.
    fn put(self, out: &mut [Emission]);
}

/// The field of an output port that does not always have a value.
#[derive(Debug, Clone, PartialEq)]
pub enum Emit<T> {
    /// A value.
    Value(T),
    /// No result, for this reason.
    Empty(String),
    /// Nothing at this stamp; only a source may say so.
    Silent,
}

impl<T> From<T> for Emit<T> {
    fn from(value: T) -> Self {
        Self::Value(value)
    }
}

/// Puts the value of a `T` field into a place that is silent.
#[inline]
pub fn put_value(place: &mut Emission, value: Value) {
    // Known to be silent from here on, the place is written at once: a move through the stack costs as much as a channel.
    if !matches!(place, Emission::Silent) {
        *place = Emission::Silent;
    }
    *place = Emission::Value(value);
}

/// The emission of an `Emit<T>` field.
pub fn into_emission<T: Payload<By>, By: 'static>(emit: Emit<T>) -> Emission {
    match emit {
        Emit::Value(value) => Emission::value(value),
        Emit::Empty(reason) => Emission::Empty(reason),
        Emit::Silent => Emission::Silent,
    }
}

fn value_of<T: Clone + 'static>(item: &Item, port: &str) -> Result<Option<T>, NodeError> {
    match &item.body {
        Body::Empty(_) => Ok(None),
        Body::Value(value) => match value.get::<T>() {
            Some(payload) => Ok(Some(payload.clone())),
            None => Err(wrong_type(port, value)),
        },
    }
}

fn wrong_type(port: &str, value: &Value) -> NodeError {
    NodeError::new(format!("input \"{port}\" was given a {}, which it does not take", value.ty().name))
}

fn no_value(port: &str) -> NodeError {
    NodeError::new(format!("input \"{port}\" has no value"))
}

/// The value of a `T` field.
pub fn take_one<T: Clone + Send + Sync + 'static>(
    joined: &mut Joined,
    index: usize,
    port: &str,
) -> Result<T, NodeError> {
    take_optional(joined, index, port)?.ok_or_else(|| no_value(port))
}

/// The value of an `Option<T>` field.
pub fn take_optional<T: Clone + Send + Sync + 'static>(
    joined: &mut Joined,
    index: usize,
    port: &str,
) -> Result<Option<T>, NodeError> {
    if let Some(value) = joined.take_out(index) {
        return value.into_payload().map(Some).map_err(|value| wrong_type(port, &value));
    }
    match joined.slot(index)? {
        Slot::Item(item) => value_of(item, port),
        Slot::Absent(_) => Ok(None),
        Slot::Items(_) => Err(NodeError::new(format!("input \"{port}\" takes one item, several were joined"))),
    }
}

/// The values of a `Vec<T>` field.
pub fn take_many<T: Clone + 'static>(joined: &mut Joined, index: usize, port: &str) -> Result<Vec<T>, NodeError> {
    take_many_optional(joined, index, port)?.into_iter().map(|v| v.ok_or_else(|| no_value(port))).collect()
}

/// The values of a `Vec<Option<T>>` field.
pub fn take_many_optional<T: Clone + 'static>(
    joined: &mut Joined,
    index: usize,
    port: &str,
) -> Result<Vec<Option<T>>, NodeError> {
    match joined.slot(index)? {
        Slot::Items(items) => items.iter().map(|item| value_of(item, port)).collect(),
        Slot::Item(item) => Ok(vec![value_of(item, port)?]),
        Slot::Absent(_) => Ok(Vec::new()),
    }
}

/// The value of a [`Value`] field, which takes any payload.
#[inline]
pub fn take_any(joined: &mut Joined, index: usize, port: &str) -> Result<Value, NodeError> {
    if let Some(value) = joined.take_out(index) {
        return Ok(value);
    }
    match joined.slot(index)? {
        Slot::Item(Item { body: Body::Value(value), .. }) => Ok(value.clone()),
        _ => Err(no_value(port)),
    }
}
