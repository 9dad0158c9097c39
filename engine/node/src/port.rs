use crate::{Emission, Emit, Outputs, Payload, PayloadType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize, Serializer, de::DeserializeOwned};
use std::marker::PhantomData;

/// An input port as declared by a node.
#[derive(Debug, Clone, Serialize)]
pub struct InputPort {
    /// Its name.
    pub name: &'static str,
    /// What it takes, in the words of the node's author.
    pub doc: &'static str,
    /// What may be wired to it.
    pub payload: PortPayload,
    /// How its items are chosen for a firing; a graph may say otherwise.
    pub join: Join,
    /// Whether it may stay unwired, and receives empties instead of being skipped (`Option<T>`).
    pub optional: bool,
    /// Whether the kind does not need it: declared so that the kinds of a stage swap by one word, and drained.
    pub unused: bool,
    /// The frames it should have.
    pub frames: FrameExpr,
}

/// An output port.
#[derive(Debug, Clone, Serialize)]
pub struct OutputPort {
    /// Its name.
    pub name: &'static str,
    /// What it gives, in the words of the node's author.
    pub doc: &'static str,
    /// The type of what it gives.
    pub payload: PortPayload,
    /// The frames of what it gives.
    pub frames: FrameExpr,
}

/// The outputs of a kind: fixed by the kind, or declared in the graph by `out`.
#[derive(Debug, Clone, Serialize)]
pub enum OutputPorts {
    /// The kind's own ports.
    Fixed(Vec<OutputPort>),
    /// Each entry of `out` is a port: a table with `type`, optionally `frame`, `to` and `from`, and these parameters.
    Declared {
        /// JSON Schema of a port's parameters.
        schema: serde_json::Value,
    },
}

/// What a port takes or gives.
#[derive(Clone, Copy, PartialEq)]
pub enum PortPayload {
    /// One payload type.
    Type(&'static PayloadType),
    /// Any payload.
    Any,
}

impl PortPayload {
    /// The type, if it is one.
    pub fn ty(&self) -> Option<&'static PayloadType> {
        match self {
            Self::Type(ty) => Some(ty),
            Self::Any => None,
        }
    }

    /// The type's name, or `any`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Type(ty) => ty.name,
            Self::Any => "any",
        }
    }
}

impl std::fmt::Debug for PortPayload {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for PortPayload {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// How a port's items are chosen for a firing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "rule", rename_all = "snake_case")]
pub enum Join {
    /// The next item: ports joined so go in step. Triggers.
    Each,
    /// The item with the trigger's stamp, or within the tolerance. Triggers.
    Stamp {
        /// Largest difference of stamps.
        tolerance_ns: i64,
    },
    /// So many items at a time, or all until the end. Triggers.
    Collect {
        /// How many; all if not given.
        n: Option<u32>,
    },
    /// The newest item at or before the firing stamp.
    Latest,
    /// Between the neighbours of the firing stamp, never across an empty or a longer gap.
    Interpolate {
        /// Longest gap between the neighbours; any if not given.
        max_gap_ns: Option<i64>,
    },
    /// A constant: one item for the whole run.
    Once,
}

impl Join {
    /// The rule's name in a graph file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Each => "each",
            Self::Stamp { .. } => "stamp",
            Self::Collect { .. } => "collect",
            Self::Latest => "latest",
            Self::Interpolate { .. } => "interpolate",
            Self::Once => "once",
        }
    }

    /// Whether its items make the node fire.
    pub fn triggers(&self) -> bool {
        matches!(self, Self::Each | Self::Stamp { .. } | Self::Collect { .. })
    }
}

/// The frames of a port, as far as its author could say: texts that `check` resolves along the wires.
///
/// `source`: the frame of the port `source`; `init.to`, `init.from`: of a pose there; `@ct`: the frame of that name;
/// `$frame`: the value of the parameter `frame`. A pose has `to` and `from`, everything else `frame`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct FrameExpr {
    /// Of anything but a pose.
    pub frame: Option<&'static str>,
    /// Of a pose.
    pub to: Option<&'static str>,
    /// Of a pose.
    pub from: Option<&'static str>,
}

/// The port payload of `T`, as the derives name it.
pub fn payload_of<T: Payload<By>, By: 'static>() -> PortPayload {
    PortPayload::Type(PayloadType::of::<T, By>())
}

/// The port payload of a [`crate::Value`], as the derives name it.
pub fn any_payload() -> PortPayload {
    PortPayload::Any
}

/// The field of an input port that this kind does not need, though its stage has it.
pub struct Unused<T>(PhantomData<T>);

impl<T> Default for Unused<T> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

/// A port declared in the graph by `out`.
#[derive(Debug, Clone)]
pub struct DeclaredPort {
    /// Its name.
    pub name: String,
    /// Its type.
    pub payload: &'static PayloadType,
    /// The rest of its table: the parameters of the kind's port schema.
    pub params: serde_json::Value,
}

impl DeclaredPort {
    /// The port's parameters.
    ///
    /// # Errors
    /// [`serde_json::Error`] if they do not fit; `check` has refused such before.
    pub fn params<P: DeserializeOwned>(&self) -> Result<P, serde_json::Error> {
        P::deserialize(&self.params)
    }
}

/// The `Outputs` of a source whose ports the graph declares; `P` are the parameters of a port.
///
/// Ports are numbered as in [`crate::Context::declared`]; those without an answer stay silent.
pub struct Declared<P> {
    answers: Vec<(usize, Emission)>,
    params: PhantomData<P>,
}

impl<P> Declared<P> {
    /// An answer on one port.
    pub fn one(port: usize, emission: Emission) -> Self {
        Self { answers: vec![(port, emission)], params: PhantomData }
    }

    /// The same, and an answer on a further port.
    pub fn and(mut self, port: usize, emission: Emission) -> Self {
        self.answers.push((port, emission));
        self
    }
}

impl<P: JsonSchema + Send> Outputs for Declared<P> {
    fn ports() -> OutputPorts {
        OutputPorts::Declared { schema: schemars::schema_for!(P).to_value() }
    }

    fn put(self, out: &mut [Emission]) {
        for (port, emission) in self.answers {
            out[port] = emission;
        }
    }
}

/// A port that answers nothing.
impl<T> Default for Emit<T> {
    fn default() -> Self {
        Self::Silent
    }
}
