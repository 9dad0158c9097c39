use crate::{ParamError, Payload, PayloadType};
use serde::{Deserialize, Serialize, Serializer, de::DeserializeOwned};
use std::marker::PhantomData;

/// An input port of a kind.
#[derive(Debug, Clone, Serialize)]
pub struct InputPort {
    /// Its name.
    pub name: &'static str,
    /// The doc comment of the field.
    pub doc: &'static str,
    /// The payload that it takes.
    pub payload: PortPayload,
    /// The default join; a graph may override it.
    pub join: Join,
    /// Whether the port may stay unwired and receives empties instead of skipping the firing (`Option<T>`).
    pub optional: bool,
    /// Whether the kind ignores the port: declared so that all kinds of a stage have the same ports, and drained.
    pub unused: bool,
    /// The expected frames.
    pub frames: FrameExpr,
}

/// An output port of a kind.
#[derive(Debug, Clone, Serialize)]
pub struct OutputPort {
    /// Its name.
    pub name: &'static str,
    /// The doc comment of the field.
    pub doc: &'static str,
    /// The payload that it gives.
    pub payload: PortPayload,
    /// The frames of the payload.
    pub frames: FrameExpr,
}

/// The outputs of a kind: fixed by the kind, or declared in the graph by `out`.
#[derive(Debug, Clone, Serialize)]
pub enum OutputPorts {
    /// The ports of the kind.
    Fixed(Vec<OutputPort>),
    /// Each entry of `out` is a port: a table with `type`, optional `frame`, `to` and `from`, and parameters.
    Declared {
        /// JSON Schema of the parameters of a port.
        schema: serde_json::Value,
    },
}

impl OutputPorts {
    /// The ports of the kind: none if a graph declares them.
    pub fn fixed(&self) -> &[OutputPort] {
        match self {
            Self::Fixed(ports) => ports,
            Self::Declared { .. } => &[],
        }
    }

    /// The ports of a node with their payloads: those of the kind, or the declared ones.
    pub fn payloads<'a>(
        &'a self,
        declared: &'a [DeclaredPort],
    ) -> impl Iterator<Item = (&'a str, PortPayload)> + use<'a> {
        let declared = declared.iter().map(|port| (port.name.as_str(), PortPayload::Type(port.payload)));
        self.fixed().iter().map(|port| (port.name, port.payload)).chain(declared)
    }
}

/// The payload of a port.
#[derive(Clone, Copy, PartialEq)]
pub enum PortPayload {
    /// One payload type.
    Type(&'static PayloadType),
    /// Any payload.
    Any,
}

impl PortPayload {
    /// The type, if the port has one.
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

/// How the items of a port are chosen for a firing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "rule", rename_all = "snake_case")]
pub enum Join {
    /// The next item: all `each` ports advance in step. Triggers.
    Each,
    /// The item with the stamp of the trigger, within the tolerance. Triggers.
    Stamp {
        /// Maximum difference of stamps.
        tolerance_ns: i64,
    },
    /// `n` items at a time, or all until the end. Triggers.
    Collect {
        /// Number of items; all if `None`.
        n: Option<u32>,
    },
    /// Windows of `n` items, of which each begins `step` items after the one before. Triggers.
    CollectEvery {
        /// Number of items.
        n: u32,
        /// Number of items from one window to the next.
        step: u32,
    },
    /// Windows in time from the stamp of the first item on, each `step_ns` after the one before. Triggers.
    CollectSpan {
        /// Length of a window.
        span_ns: i64,
        /// Time from one window to the next.
        step_ns: i64,
    },
    /// The newest item at or before the firing stamp.
    Latest,
    /// The newest item up to this long after the firing stamp, for which the node waits in the time of the stamps.
    LatestAfter {
        /// The time after the firing stamp.
        after_ns: i64,
    },
    /// Interpolated between the neighbours of the firing stamp, never across an empty or a longer gap.
    Interpolate {
        /// Maximum gap between the neighbours; unlimited if `None`.
        max_gap_ns: Option<i64>,
    },
    /// A constant: one item for the whole run.
    Once,
    /// What the wire carried for the firing before: item number k - 1 at firing k, and nothing at the first. The one join
    /// over which wires may go in a cycle.
    Previous,
}

impl Join {
    /// The name in a graph file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Each => "each",
            Self::Stamp { .. } => "stamp",
            Self::Collect { .. } | Self::CollectEvery { .. } | Self::CollectSpan { .. } => "collect",
            Self::Latest | Self::LatestAfter { .. } => "latest",
            Self::Interpolate { .. } => "interpolate",
            Self::Once => "once",
            Self::Previous => "previous",
        }
    }

    /// Whether a firing takes several items.
    pub fn collects(&self) -> bool {
        matches!(self, Self::Collect { .. } | Self::CollectEvery { .. } | Self::CollectSpan { .. })
    }

    /// Whether items make the node fire.
    pub fn triggers(&self) -> bool {
        matches!(self, Self::Each | Self::Stamp { .. }) || self.collects()
    }
}

/// The frames of a port as expressions that `check` resolves along the wires.
///
/// `source`: the frame of the port `source`; `init.to`, `init.from`: a frame of the pose there; `@ct`: the frame `ct`;
/// `$frame`: the value of the parameter `frame`. A pose has `to` and `from`, everything else `frame`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct FrameExpr {
    /// The frame of anything but a pose.
    pub frame: Option<&'static str>,
    /// The target frame of a pose.
    pub to: Option<&'static str>,
    /// The source frame of a pose.
    pub from: Option<&'static str>,
}

/// The port payload of `T`; called by the derives.
pub fn payload_of<T: Payload<By>, By: 'static>() -> PortPayload {
    PortPayload::Type(PayloadType::of::<T, By>())
}

/// The port payload of a [`crate::Value`]; called by the derives.
pub fn any_payload() -> PortPayload {
    PortPayload::Any
}

/// The field of an input port that this kind ignores but other kinds of its stage need.
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
    /// The rest of the table: the parameters.
    pub params: serde_json::Value,
}

impl DeclaredPort {
    /// The port's parameters.
    ///
    /// # Errors
    /// [`ParamError`] if they do not match `P`; `check` refuses such graphs earlier.
    pub fn params<P: DeserializeOwned>(&self) -> Result<P, ParamError> {
        P::deserialize(&self.params).map_err(|error| ParamError::new(format!("out.{}", self.name), error.to_string()))
    }

    /// The error of a value of the port: `key` is `type`, a frame or one of its parameters.
    pub fn refused(&self, key: &str, message: impl Into<String>) -> ParamError {
        ParamError::new(format!("out.{}.{key}", self.name), message)
    }
}
