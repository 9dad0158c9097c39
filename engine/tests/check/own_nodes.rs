//! Kinds whose ports join in every way and whose frames refer to each other in every way; checked, never run.
#![allow(dead_code, reason = "the nodes are never run")]

use osteoflow_node::{
    Context, Declared, DeclaredPort, Describe, FilePath, Inputs, Node, NodeError, Outputs, ParamError, Registry,
    Source, Unused, schemars, serde,
};
use osteoflow_toy::{
    NoParams,
    stages::{Cloud, Pose, Report},
};
use std::path::{Path, PathBuf};

macro_rules! node {
    ($name:ident, $kind:literal, $params:ty, $inputs:ty, $outputs:ty) => {
        #[derive(Describe)]
        /// A node.
        pub(crate) struct $name;

        impl Node for $name {
            const KIND: &'static str = $kind;
            type Params = $params;
            type Inputs = $inputs;
            type Outputs = $outputs;

            fn new(_: $params) -> Result<Self, ParamError> {
                Ok(Self)
            }

            fn process(&mut self, _: $inputs, _: &mut Context) -> Result<$outputs, NodeError> {
                Err(NodeError::new("only to be checked"))
            }
        }
    };
}

macro_rules! source {
    ($name:ident, $kind:literal, $live:literal, $constant:literal, $params:ty, $outputs:ty) => {
        #[derive(Describe)]
        /// A source.
        pub(crate) struct $name;

        impl Source for $name {
            const KIND: &'static str = $kind;
            const LIVE: bool = $live;
            const CONSTANT: bool = $constant;
            type Params = $params;
            type Outputs = $outputs;

            fn new(_: $params) -> Result<Self, ParamError> {
                Ok(Self)
            }

            fn next(&mut self, _: &mut Context) -> Result<Option<$outputs>, NodeError> {
                Ok(None)
            }
        }
    };
}

#[derive(Outputs)]
pub(crate) struct One {
    out: Pose,
}

#[derive(Outputs)]
pub(crate) struct Two {
    out: Pose,
    other: Pose,
}

source!(Live, "from.live", true, false, NoParams, One);
source!(LiveTwo, "from.live_two", true, false, NoParams, Two);
source!(Constant, "from.constant", false, true, NoParams, One);
source!(File, "from.file", false, false, NoParams, One);

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct ListedParams {
    list: Option<FilePath>,
}

/// A source of files that a list names.
#[derive(Describe)]
pub(crate) struct Listed(ListedParams);

impl Source for Listed {
    const KIND: &'static str = "from.listed";
    type Params = ListedParams;
    type Outputs = One;

    fn new(params: ListedParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn files(&self) -> Vec<PathBuf> {
        let list = self.0.list.as_ref().map_or(Path::new("list.txt"), |list| list.as_ref());
        vec![list.with_file_name("x/../of_the_list.txt"), list.to_owned()]
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<One>, NodeError> {
        Ok(None)
    }
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct TimedPort {
    device: Option<String>,
    has_constants: bool,
}

/// A source of declared poses, which refuses those of a device `none`.
#[derive(Describe)]
pub(crate) struct Timed;

impl Timed {
    fn port(port: &DeclaredPort) -> Result<TimedPort, ParamError> {
        let params: TimedPort = port.params()?;
        match params.device.as_deref() {
            None => Err(port.refused("device", "no device is given")),
            Some("none") => Err(port.refused("device", "there is no device \"none\"")),
            Some(_) => Ok(params),
        }
    }
}

impl Source for Timed {
    const KIND: &'static str = "from.timed";
    type Params = NoParams;
    type Outputs = Declared<TimedPort>;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn check_ports(ports: &[DeclaredPort]) -> Result<(), ParamError> {
        ports.iter().try_for_each(|port| Self::port(port).map(drop))
    }

    fn is_timed(&self, port: &DeclaredPort) -> bool {
        Self::port(port).is_ok_and(|params| !params.has_constants)
    }

    fn next(&mut self, _: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        Ok(None)
    }
}

#[derive(Inputs)]
pub(crate) struct PairIn {
    a: Pose,
    b: Pose,
}

#[derive(Inputs)]
pub(crate) struct MaybeIn {
    a: Pose,
    b: Option<Pose>,
}

#[derive(Inputs)]
pub(crate) struct ListIn {
    list: Vec<Pose>,
}

#[derive(Inputs)]
pub(crate) struct ListAndIn {
    list: Vec<Pose>,
    b: Pose,
}

#[derive(Inputs)]
pub(crate) struct SpareIn {
    a: Pose,
    spare: Unused<Pose>,
}

node!(Pair, "to.pair", NoParams, PairIn, One);
node!(Maybe, "to.maybe", NoParams, MaybeIn, One);
node!(List, "to.list", NoParams, ListIn, One);
node!(ListAnd, "to.list_and", NoParams, ListAndIn, One);
node!(Spare, "to.spare", NoParams, SpareIn, One);

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct FrameParams {
    frame: String,
    to: String,
    from: String,
}

#[derive(Outputs)]
pub(crate) struct FramedOut {
    #[port(frame = "$frame")]
    cloud: Cloud,
    #[port(to = "$to", from = "$from")]
    pose: Pose,
    unknown: Cloud,
}

source!(Framed, "frames.source", false, false, FrameParams, FramedOut);

#[derive(Inputs)]
pub(crate) struct MoveIn {
    #[port(frame = "pose.from")]
    cloud: Cloud,
    #[port(from = "cloud.frame")]
    pose: Pose,
}

#[derive(Outputs)]
pub(crate) struct MoveOut {
    #[port(frame = "pose.to")]
    cloud: Cloud,
    #[port(to = "pose.from", from = "pose.to")]
    back: Pose,
}

node!(Move, "frames.move", NoParams, MoveIn, MoveOut);

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct WantParams {
    frame: String,
}

impl Default for WantParams {
    fn default() -> Self {
        Self { frame: "ct".into() }
    }
}

#[derive(Inputs)]
pub(crate) struct WantIn {
    #[port(frame = "$frame")]
    cloud: Cloud,
    #[port(to = "$frame", from = "@tool")]
    pose: Option<Pose>,
}

#[derive(Outputs)]
pub(crate) struct WantOut {
    #[port(frame = "cloud")]
    cloud: Cloud,
    #[port(to = "pose.to", from = "pose.from")]
    pose: Pose,
}

node!(Want, "frames.want", WantParams, WantIn, WantOut);

#[derive(Inputs)]
pub(crate) struct OptionalIn {
    b: Option<Pose>,
}

node!(Optional, "to.optional", NoParams, OptionalIn, One);

#[derive(Inputs)]
pub(crate) struct ReportIn {
    report: Report,
}

node!(WantReport, "to.report", NoParams, ReportIn, One);

#[derive(Inputs)]
pub(crate) struct RankedIn {
    /// Where it starts.
    ///
    /// And no more of it.
    #[port(to = "@ct", from = "@tool")]
    start: Pose,
}

#[derive(Outputs)]
pub(crate) struct RankedOut {
    other: Pose,
    #[port(to = "@ct", from = "@tool")]
    end: Pose,
    start: Pose,
}

node!(Ranked, "frames.ranked", NoParams, RankedIn, RankedOut);

pub(crate) fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Cloud, _>().payload::<Pose, _>().payload::<Report, _>();
    registry.source::<Live>().source::<LiveTwo>().source::<Constant>().source::<File>().source::<Framed>();
    registry.source::<Listed>().source::<Timed>();
    registry.node::<Pair>().node::<Maybe>().node::<List>().node::<ListAnd>().node::<Spare>();
    registry.node::<Move>().node::<Want>().node::<Optional>().node::<WantReport>().node::<Ranked>();
    registry
}
