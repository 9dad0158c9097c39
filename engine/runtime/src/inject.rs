//! Injected failures, for testing how a graph fails.

use crate::{names::nearest, plan::Plan};
use osteoflow_node::{AnyNode, AnySource, Built, Context, Emission, Joined, NodeError};
use serde::{Deserialize, Serialize};
use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

/// A firing that fails instead of running the node's own code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Injection {
    /// The node's full name.
    pub node: String,
    /// The number of the firing, from 0.
    pub item: u64,
    /// How it fails.
    pub how: Injected,
}

/// The kind of an injected failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Injected {
    /// The node panics.
    Panic,
    /// The node returns an error.
    Error,
}

impl Injected {
    /// `panic` or `error`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Panic => "panic",
            Self::Error => "error",
        }
    }

    /// The variant with that name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Panic, Self::Error].into_iter().find(|how| how.name() == name)
    }

    /// Panics or returns the error.
    ///
    /// # Errors
    /// Always, unless it panics.
    pub fn fail(self, node: &str, item: u64) -> NodeError {
        match self {
            Self::Panic => panic!("a panic was injected into {node} at item {item}"),
            Self::Error => NodeError::new(format!("an error was injected into {node} at item {item}")),
        }
    }
}

impl fmt::Display for Injection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}={}", self.node, self.item, self.how.name())
    }
}

impl Injection {
    /// Parses `NODE[@ITEM][=panic|error]`; the defaults are item 0 and a panic.
    ///
    /// # Errors
    /// What is wrong with the text, and the most similar name where the plan has no such node.
    pub fn parse(text: &str, plan: &Plan) -> Result<Self, String> {
        let (rest, how) = match text.split_once('=') {
            None => (text, Injected::Panic),
            Some((rest, how)) => match Injected::from_name(how) {
                Some(known) => (rest, known),
                None => return Err(format!("\"{how}\" cannot be injected; panic and error can, as in icp@2=error")),
            },
        };
        let (node, item) = match rest.split_once('@') {
            None => (rest, 0),
            Some((node, item)) => match item.parse() {
                Ok(item) => (node, item),
                Err(_) => return Err(format!("\"{item}\" is no item number; write a count from 0, as in icp@2")),
            },
        };
        let injection = Self { node: node.into(), item, how };
        injection.check(plan)?;
        Ok(injection)
    }

    /// Checks that the plan has the node.
    ///
    /// # Errors
    /// The plan has no such node; the message names the most similar one.
    pub fn check(&self, plan: &Plan) -> Result<(), String> {
        let names = || plan.nodes.iter().map(|node| &*node.name);
        if names().any(|name| name == self.node) {
            return Ok(());
        }
        let help = nearest::help(&self.node, names()).or_else(|| nearest::list("nodes here", names()));
        let help = help.map(|help| format!("; {help}")).unwrap_or_default();
        Err(format!("nothing can be injected into \"{}\": the graph has no such node{help}", self.node))
    }
}

/// The injections into one node, and whether each has happened.
#[derive(Debug, Default)]
pub(crate) struct Planned(Vec<(Injection, AtomicBool)>);

impl Planned {
    /// Those of `all` for this node.
    pub(crate) fn of(node: &str, all: &[Injection]) -> Arc<Self> {
        let own = all.iter().filter(|injection| injection.node == node);
        Arc::new(Self(own.map(|injection| (injection.clone(), AtomicBool::new(false))).collect()))
    }

    /// The failure to inject into the firing, if any.
    pub(crate) fn at(&self, item: u64) -> Option<Injected> {
        let (injection, happened) = self.0.iter().find(|(injection, _)| injection.item == item)?;
        happened.store(true, Ordering::Relaxed);
        Some(injection.how)
    }

    /// Injections whose firing never happened.
    pub(crate) fn missed(&self) -> impl Iterator<Item = &Injection> {
        self.0.iter().filter(|(_, happened)| !happened.load(Ordering::Relaxed)).map(|(injection, _)| injection)
    }

    /// Wraps the node so that it fails where planned. A node without injections is returned as it is.
    pub(crate) fn into_node(self: &Arc<Self>, built: Built) -> Built {
        if self.0.is_empty() {
            return built;
        }
        let planned = self.clone();
        match built {
            Built::Node(inner) => Built::Node(Box::new(Failing { inner, planned })),
            Built::Source(inner) => Built::Source(Box::new(Failing { inner, planned })),
        }
    }
}

/// A single node that fails at `item`, if `how` is given.
pub fn planned_failure(built: Built, node: &str, item: u64, how: Option<Injected>) -> Built {
    let all: Vec<_> = how.into_iter().map(|how| Injection { node: node.into(), item, how }).collect();
    Planned::of(node, &all).into_node(built)
}

struct Failing<T> {
    inner: T,
    planned: Arc<Planned>,
}

impl<T> Failing<T> {
    fn fail(&self, ctx: &Context) -> Result<(), NodeError> {
        self.planned.at(ctx.item()).map_or(Ok(()), |how| Err(how.fail(ctx.node(), ctx.item())))
    }
}

impl AnyNode for Failing<Box<dyn AnyNode>> {
    fn fire(&mut self, joined: &mut Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError> {
        self.fail(ctx)?;
        self.inner.fire(joined, out, ctx)
    }
}

impl AnySource for Failing<Box<dyn AnySource>> {
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError> {
        self.fail(ctx)?;
        self.inner.next(out, ctx)
    }
}
