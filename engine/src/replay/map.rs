//! Which recorded wire plays which wire of the graph.

use super::ReplayError;
use crate::{
    plan::{FrameDifference, OutputId, Plan, PlanOutput, PortFrames},
    recording::{RecordedWire, Recording, codec},
};
use osteoflow_node::Role;
use std::{collections::BTreeMap, fmt, str::FromStr};

/// Plays a recorded wire, or a topic of another program's recording, as a wire of the graph: `NODE.PORT=TOPIC`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mapping {
    /// The wire of the graph, `node.port`.
    pub port: String,
    /// The recorded wire, or the topic.
    pub topic: String,
}

impl FromStr for Mapping {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').map(|(port, topic)| (port.trim(), topic.trim()));
        match parts.filter(|(port, topic)| port.contains('.') && !topic.is_empty()) {
            Some((port, topic)) => Ok(Self { port: port.into(), topic: topic.into() }),
            None => {
                Err("write NODE.PORT=TOPIC, such as scanner.cloud=recording.scan or scanner.cloud=/camera/scan".into())
            }
        }
    }
}

impl fmt::Display for Mapping {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "--map {}={}", self.port, self.topic)
    }
}

impl Mapping {
    /// The output of the plan that it names.
    ///
    /// # Errors
    /// [`ReplayError::Unfit`] with the ports that the graph's sources have.
    pub(super) fn output(&self, plan: &Plan) -> Result<OutputId, ReplayError> {
        plan.all_outputs().find(|id| plan.wire_name(*id) == self.port).ok_or_else(|| {
            let sources = plan.all_outputs().filter(|id| plan.nodes[id.node].role != Role::Node);
            let ports = listed(sources.map(|id| plan.wire_name(id)));
            ReplayError::Unfit(format!("{self}: the graph has no output \"{}\"; its sources have {ports}", self.port))
        })
    }
}

/// Names in a row; `none` for an empty list.
pub(super) fn listed(names: impl IntoIterator<Item = impl Into<String>>) -> String {
    let names: Vec<String> = names.into_iter().map(Into::into).collect();
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// The recorded wires that can be played as this output, for a message.
pub(super) fn fitting(recording: &Recording, output: &PlanOutput) -> String {
    let fits = recording.wires.iter().filter(|(_, wire)| wire.is_of(output.payload));
    listed(fits.map(|(name, _)| name.as_str()))
}

/// Gives the recorded wires the names of the outputs that they are played as.
///
/// # Errors
/// [`ReplayError::Unfit`] if an output or a wire does not exist, or they differ in payload or frames.
pub(super) fn apply(recording: &mut Recording, plan: &Plan, maps: &[Mapping]) -> Result<(), ReplayError> {
    let mut played: BTreeMap<String, RecordedWire> = BTreeMap::new();
    for map in maps {
        let id = map.output(plan)?;
        let output = &plan.nodes[id.node].outputs[id.port];
        let payload = output.payload.name();
        let unfit = |what: String| {
            let fit = fitting(recording, output);
            ReplayError::Unfit(format!("{map}: {what}; of {payload}, which {} gives, it has {fit}", map.port))
        };
        let name = map.topic.strip_prefix("/exact/").unwrap_or(&map.topic);
        let Some(wire) = recording.wires.get(name) else {
            return Err(unfit(format!("the recording has no wire \"{name}\"")));
        };
        if !wire.is_of(output.payload) {
            return Err(unfit(format!("{name} was recorded with {}", wire.payload)));
        }
        if let Some(FrameDifference { key, found, expected }) = difference(wire, &output.frames) {
            let (port, file) = (&map.port, recording.path.display());
            return Err(ReplayError::Unfit(format!(
                "{map}: {key} is \"{found}\" in {file}, but \"{expected}\" on {port} of the graph; change it in the graph, or \
                 map another wire"
            )));
        }
        if played.insert(map.port.clone(), wire.clone()).is_some() {
            return Err(ReplayError::Unfit(format!("{map}: {} is mapped twice", map.port)));
        }
    }
    recording.wires.extend(played);
    Ok(())
}

/// The first frame of a wire's first value that the graph expects otherwise.
fn difference(wire: &RecordedWire, expected: &PortFrames) -> Option<FrameDifference> {
    let items = wire.messages.iter().filter_map(|bytes| codec::decode(bytes).ok());
    expected.difference(&items.filter_map(|item| item.body.ok()).next()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapping_is_a_port_and_a_topic() {
        let map: Mapping = "scanner.cloud = /camera/scan".parse().unwrap();
        assert_eq!((map.port.as_str(), map.topic.as_str()), ("scanner.cloud", "/camera/scan"));
        assert_eq!(map.to_string(), "--map scanner.cloud=/camera/scan");
        assert!(["", "scan", "scan=/a", "a.b=", "=x"].iter().all(|text| text.parse::<Mapping>().is_err()));
    }
}
