use crate::{
    Body, CachePolicy, Context, DeclaredPort, Emission, InputPort, Item, Joined, NodeError, OutputPorts, ParamError,
    Payload, Slot, Value,
};
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use std::{path::PathBuf, time::Duration};

/// A node with inputs: fires when its ports join, and gives a value or an empty on every output.
pub trait Node: Describe + Send + Sized + 'static {
    /// `stage.variant`, as graph files name it.
    const KIND: &'static str;
    /// Whether answers are cached across runs.
    const CACHE: CachePolicy = CachePolicy::Never;
    /// Whether answers may differ though inputs, parameters and seed are the same, as those of a method that races its threads.
    const UNSTEADY: bool = false;
    /// The parameters; their docs state defaults, ranges and reasons.
    type Params: Parameters;
    /// The input ports.
    type Inputs: Inputs;
    /// The output ports.
    type Outputs: Outputs;

    /// Builds the node; opens nothing yet, as `check` builds it too.
    ///
    /// # Errors
    /// [`ParamError`] for combinations of values that no single range excludes.
    fn new(params: Self::Params) -> Result<Self, ParamError>;

    /// One firing.
    ///
    /// # Errors
    /// [`NodeError`] if there is no result; the outputs then get an empty that says why.
    fn process(&mut self, inputs: Self::Inputs, ctx: &mut Context) -> Result<Self::Outputs, NodeError>;
}

/// A node without memory: each firing depends on its parameters and inputs alone. [`crate::Registry::function`] makes a [`Node`] of it.
pub trait Function: Describe + 'static {
    /// `stage.variant`, as graph files name it.
    const KIND: &'static str;
    /// Whether answers are cached across runs.
    const CACHE: CachePolicy = CachePolicy::Never;
    /// The parameters; their docs state defaults, ranges and reasons.
    type Params: Parameters + Send;
    /// The input ports.
    type Inputs: Inputs;
    /// The output ports.
    type Outputs: Outputs;

    /// One firing.
    ///
    /// # Errors
    /// As [`Node::process`].
    fn process(params: &Self::Params, inputs: Self::Inputs, ctx: &mut Context) -> Result<Self::Outputs, NodeError>;
}

/// The node of a function: its parameters.
pub(crate) struct FunctionNode<F: Function>(F::Params);

impl<F: Function> Describe for FunctionNode<F> {
    const DOC: &'static str = F::DOC;
    const EXAMPLE: &'static str = F::EXAMPLE;
    const LITERATURE: &'static [&'static str] = F::LITERATURE;
}

impl<F: Function> Node for FunctionNode<F> {
    const KIND: &'static str = F::KIND;
    const CACHE: CachePolicy = F::CACHE;
    type Params = F::Params;
    type Inputs = F::Inputs;
    type Outputs = F::Outputs;

    fn new(params: F::Params) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, inputs: F::Inputs, ctx: &mut Context) -> Result<F::Outputs, NodeError> {
        F::process(&self.0, inputs, ctx)
    }
}

/// Default of [`Source::silent_after`], 5 s: longer than any camera takes between two clouds, and short enough for an
/// operator to wait.
pub const SILENT_AFTER: Duration = Duration::from_secs(5);

/// A node without inputs.
pub trait Source: Describe + Send + Sized + 'static {
    /// `stage.variant`, as graph files name it.
    const KIND: &'static str;
    /// Whether the source follows the wall clock, so that its wires may be lossy.
    const LIVE: bool = false;
    /// Whether the source gives constants: one item on each output, at stamp 0, and then ends.
    const CONSTANT: bool = false;
    /// Whether its answers may differ from one run to the next, as those of a device.
    const UNSTEADY: bool = false;
    /// The parameters; their docs state defaults, ranges and reasons.
    type Params: Parameters;
    /// The output ports; [`crate::Declared`] where the graph declares them.
    type Outputs: Outputs;

    /// Builds the source; reads nothing yet, as `check` builds it too.
    ///
    /// # Errors
    /// [`ParamError`] for combinations of values that no single range excludes.
    fn new(params: Self::Params) -> Result<Self, ParamError>;

    /// Refuses ports that the graph declares and the source cannot fill, whatever it reads; called before [`Source::new`].
    ///
    /// # Errors
    /// [`DeclaredPort::refused`] of the first such port.
    fn check_ports(_ports: &[DeclaredPort]) -> Result<(), ParamError> {
        Ok(())
    }

    /// Whether every item of a declared port has a time of its own; false if some may be constants, whose stamp is 0.
    fn is_timed(&self, _port: &DeclaredPort) -> bool {
        false
    }

    /// For a live source: maximum delay of an item behind the newest stamp on any other port, ns. A silent port is not
    /// waited for beyond that; a later item is late and replaced by an empty. 0: all ports come in the order of their
    /// stamps.
    fn max_delay_ns(&self) -> crate::StampNs {
        0
    }

    /// For a live source: time without an answer after which the run reports it as silent.
    fn silent_after(&self) -> Duration {
        SILENT_AFTER
    }

    /// Files that the source will read beside those that its parameters name, such as those that a list names; none if the
    /// list cannot be read. The manifest of a run holds their hashes, and a replay by hash refuses changed ones.
    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    /// The next answer, at the stamp given to [`Context::set_stamp_ns`]; `None` at the end. Ports may stay silent.
    ///
    /// A live source may wait for its device here, on its own thread. It must notice cancellation
    /// ([`Context::cancelled`], [`Context::wait_until`]) within half a second; otherwise the run ends without it.
    ///
    /// # Errors
    /// [`NodeError`] if nothing more can be read.
    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError>;
}

/// Parameters: deserialized by serde, described by schemars.
pub trait Parameters: DeserializeOwned + JsonSchema {}

impl<P: DeserializeOwned + JsonSchema> Parameters for P {}

/// Documentation of a kind; derived from the doc comment and `#[describe(example = "...", literature = ["..."])]`.
pub trait Describe {
    /// The doc comment; the first paragraph is the summary.
    const DOC: &'static str;
    /// The table of the node in a graph file, with the important parameters; checked by a test.
    const EXAMPLE: &'static str;
    /// Paper, section, equation.
    const LITERATURE: &'static [&'static str];
}

/// The input ports of a node; derived.
pub trait Inputs: Sized {
    /// The ports in order.
    fn ports() -> Vec<InputPort>;

    /// Takes the values of one firing: moved out of `joined` where it is spent, otherwise cloned handles.
    ///
    /// # Errors
    /// [`NodeError`] if `joined` does not match the declared ports.
    fn take(joined: &mut Joined) -> Result<Self, NodeError>;
}

/// The output ports of a node; derived.
pub trait Outputs: Sized {
    /// The ports in order.
    fn ports() -> OutputPorts;

    /// Writes the emission of each port to `out`, which holds one silent emission per port, in order.
    fn put(self, out: &mut [Emission]);
}

/// The type of an output field that does not always have a value.
#[derive(Debug, Clone, PartialEq)]
pub enum Emit<T> {
    /// A value.
    Value(T),
    /// No result, for this reason.
    Empty(String),
    /// No item at this stamp; for sources only.
    Silent,
}

impl<T> From<T> for Emit<T> {
    fn from(value: T) -> Self {
        Self::Value(value)
    }
}

/// A silent port.
impl<T> Default for Emit<T> {
    fn default() -> Self {
        Self::Silent
    }
}

/// Writes the value of a `T` field to a place that is silent.
#[inline]
pub fn put_value(place: &mut Emission, value: Value) {
    // Once known to be silent, the place is written directly: a move through the stack costs as much as a channel.
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
    NodeError::new(format!("input \"{port}\" was given a {}, which it does not accept", value.ty().name))
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
        Slot::Items(_) => Err(NodeError::new(format!("input \"{port}\" takes one item, but several were joined"))),
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

/// The value of an `Option<Value>` field, which takes any payload and may be absent.
pub fn take_optional_any(joined: &mut Joined, index: usize, port: &str) -> Result<Option<Value>, NodeError> {
    if let Some(value) = joined.take_out(index) {
        return Ok(Some(value));
    }
    match joined.slot(index)? {
        Slot::Item(Item { body: Body::Value(value), .. }) => Ok(Some(value.clone())),
        Slot::Item(Item { body: Body::Empty(_), .. }) | Slot::Absent(_) => Ok(None),
        Slot::Items(_) => Err(NodeError::new(format!("input \"{port}\" takes one item, but several were joined"))),
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
