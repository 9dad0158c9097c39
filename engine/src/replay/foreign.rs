//! Plays the topics of another program's recording into a graph: the sources that they stand for become readers of the file.

use super::{
    Mapping, ReplayError, ReplayOptions, ReplayReport, TopicReader, WireComparison, WirePart, map::listed, select,
};
use crate::{
    check::{Checked, check_recorded, check_text},
    graph::grammar,
    options::RunOptions,
    panics,
    plan::{FrameDifference, OutputId, Plan, PlanNode, PlanOutput},
    plugin::Kinds,
    recording::{
        format::{RunRecord, Topic},
        scan::{Carried, Gather, PassState, scan},
    },
    run,
    runtime::Observer,
};
use osteoflow_container::Record;
use osteoflow_node::{BuildContext, Built, Context, DeclaredPort, Emission, OutputPorts, Registry, Role};
use serde_json::Value as Json;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
    path::Path,
    sync::Arc,
};
use toml::{Table, Value};

/// Parameters of a port of which one says what it reads of a recording.
const WHAT_IS_READ: [&str; 4] = ["topic", "topics", "metadata", "present"];

/// The topics of a recording of another program, with their schemas and numbers of messages.
#[derive(Default)]
pub(super) struct Topics {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, String>,
    topics: BTreeMap<String, (String, u64)>,
}

impl Gather for Topics {
    fn record(&mut self, record: &Record<'_>) -> ControlFlow<()> {
        match record {
            Record::Schema { id, name, .. } => {
                self.schemas.insert(*id, (*name).to_owned());
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                self.channels.insert(channel.id, channel.topic.clone());
                self.topics.entry(channel.topic.clone()).or_insert((schema, 0));
            }
            Record::Message(message) => {
                let topic = self.channels.get(&message.channel_id).and_then(|topic| self.topics.get_mut(topic));
                topic.into_iter().for_each(|(_, n)| *n += 1);
            }
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn message(&mut self, _: Carried<'_>, _: &mut PassState) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

impl Topics {
    /// The topics of a file of another program; `None` if it is a recording of a run or the rest of one, or has no topics.
    pub(super) fn of(path: &Path) -> Option<Self> {
        let mut topics = Self::default();
        let scanned = scan(path, &mut topics, &mut |_, _| {}).ok()?;
        let is_ours =
            scanned.metadata.has::<RunRecord>() || topics.topics.keys().any(|topic| Topic::parse(topic).is_some());
        (!is_ours && !topics.topics.is_empty()).then_some(topics)
    }

    /// All topics with their schemas, for a message.
    pub(super) fn all(&self) -> String {
        listed(self.topics.iter().map(|(topic, (schema, _))| format!("{topic} ({schema})")))
    }

    /// The topics that a port with this payload can read, for a message.
    fn fitting(&self, reader: &TopicReader, payload: &str) -> String {
        let fits = self.topics.iter().filter(|(_, (schema, _))| (reader.reads)(payload, schema));
        listed(fits.map(|(topic, (schema, _))| format!("{topic} ({schema})")))
    }
}

/// Runs the graph on the topics of the file.
///
/// # Errors
/// [`ReplayError`] if a port or a topic does not exist or they do not fit, or the graph has faults.
pub(super) fn replay(
    path: &Path,
    topics: &Topics,
    changes: &ReplayOptions,
    kinds: &Kinds,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<ReplayReport, ReplayError> {
    let unfit =
        |what: String| ReplayError::Unfit(format!("{} is a recording of another program: {what}", path.display()));
    let (Some(graph), Some(reader)) = (&changes.graph, &changes.reader) else {
        let hint = "--graph names the graph that they play into, and --map NODE.PORT=TOPIC the port of one";
        return Err(unfit(format!("its topics are {}; {hint}", topics.all())));
    };
    for (is_given, option) in [
        (changes.from.is_some(), "--from"),
        (changes.start.is_some(), "--start"),
        (changes.end.is_some(), "--end"),
        (changes.rate.is_some(), "--rate"),
    ] {
        if is_given {
            return Err(unfit(format!("{option} needs the wires of a run; leave it out")));
        }
    }
    let text = crate::regular(graph)
        .and_then(std::fs::read_to_string)
        .map_err(|error| ReplayError::Unfit(format!("cannot read {}: {error}", graph.display())))?;
    let of_graph = |faults| ReplayError::Graph { faults, recorded: false };
    let first = check_recorded(&text, graph, &changes.sets, kinds).map_err(of_graph)?;
    let Some(kind) = first.registry.kind(&reader.kind) else {
        return Err(unfit(format!("this program has no kind {}, which reads it", reader.kind)));
    };
    let OutputPorts::Declared { schema } = &kind.description.outputs else {
        return Err(unfit(format!("{} declares no outputs", reader.kind)));
    };
    let file = File { path, topics, reader, params: &kind.description.params, port_params: schema };
    let (text, played) = file.with_readers(&changes.maps, &first.plan).map_err(|error| match error {
        ReplayError::Unfit(what) if !what.starts_with("--map") => unfit(what),
        other => other,
    })?;
    let Checked { plan, registry, .. } = check_text(&text, graph, &[], kinds).map_err(of_graph)?;
    let played_nodes = plan.nodes.iter().enumerate().filter(|(_, node)| node.kind == reader.kind);
    for (index, _) in played_nodes {
        if let Some((wire, FrameDifference { key, found, expected })) = other_frame(&plan, index, &registry) {
            return Err(unfit(format!(
                "{key} is \"{found}\" in it, but \"{expected}\" on {wire} of the graph; change it in the graph, or rename it \
                 where the source reads topics: --set '{}.frames={{ {found:?} = {expected:?} }}'",
                plan.nodes[index].name
            )));
        }
    }
    let report = run::run(&plan, &registry, options, observer)?;
    let wires = played.into_iter().map(|(wire, topics_of)| {
        let n_recorded = topics_of.iter().filter_map(|topic| topics.topics.get(topic)).map(|(_, n)| n).sum();
        let n_replayed = plan.all_outputs().find(|id| plan.wire_name(*id) == wire).and_then(|id| {
            let links = plan.links.iter().zip(&report.links).filter(|(link, _)| link.from == id);
            links.map(|(_, stats)| stats.sent).max()
        });
        WireComparison {
            wire,
            part: WirePart::Played,
            n_recorded,
            n_replayed: n_replayed.unwrap_or(0),
            n_compared: 0,
            first_difference: None,
            not_comparable: None,
        }
    });
    Ok(ReplayReport {
        wires: wires.collect(),
        results_equal: None,
        not_compared: Some(format!(
            "{} is a recording of another program, with no wires to compare with",
            path.display()
        )),
        truncated: None,
        unsound: None,
        computed_too: Vec::new(),
        own_sources: own_sources(&plan, &reader.kind),
        differences: Vec::new(),
        late_differences: Vec::new(),
        warnings: first.warnings,
        run: report,
    })
}

/// The first wire of a source whose first value has another frame than the graph expects. What the source refuses is said when it
/// runs.
fn other_frame(plan: &Plan, node: usize, registry: &Registry) -> Option<(String, FrameDifference)> {
    let of = &plan.nodes[node];
    let (name, declared) = (of.name.clone(), of.declared.clone());
    let place = Default::default();
    let context =
        BuildContext { node: name.clone(), seed: plan.seed, declared: declared.clone(), joins: Vec::new(), place };
    let built = panics::catch(|| registry.build(registry.kind(&of.kind)?, &of.params, &context).ok());
    let Ok(Some(Built::Source(mut source))) = built else { return None };
    let mut context = Context::new(name.to_string(), plan.seed, Arc::default(), declared);
    let mut waiting: BTreeSet<usize> = (0..of.outputs.len()).collect();
    let mut number = 0;
    while !waiting.is_empty() {
        context.begin(number, 0);
        number += 1;
        let mut out = vec![Emission::Silent; of.outputs.len()];
        if !matches!(panics::catch(|| source.next(&mut out, &mut context)), Ok(Ok(true))) {
            return None;
        }
        for (port, emission) in out.iter().enumerate() {
            let Emission::Value(value) = emission else { continue };
            if let Some(difference) =
                waiting.remove(&port).then(|| of.outputs[port].frames.difference(&value.to_view()))
                && let Some(difference) = difference
            {
                return Some((plan.wire_name(OutputId { node, port }), difference));
            }
        }
    }
    None
}

/// Sources that are run as the graph has them.
fn own_sources(plan: &Plan, reader: &str) -> Vec<String> {
    let own = plan.nodes.iter().filter(|node| node.role != Role::Node && node.kind != reader);
    own.map(|node| node.name.to_string()).collect()
}

/// Wires that are played, each with its topics.
type Played = Vec<(String, Vec<String>)>;

/// The file, and what reads it.
struct File<'a> {
    path: &'a Path,
    topics: &'a Topics,
    reader: &'a TopicReader,
    /// The schemas of the reader's parameters and of those of its outputs.
    params: &'a Json,
    port_params: &'a Json,
}

impl File<'_> {
    /// The resolved graph in which the sources of topics read the file, and the wires that they play.
    fn with_readers(&self, maps: &[Mapping], plan: &Plan) -> Result<(String, Played), ReplayError> {
        let mut graph: Table = plan.resolved.parse().map_err(|error| ReplayError::Unfit(format!("{error}")))?;
        let mut mapped: BTreeMap<usize, BTreeMap<&str, &str>> = BTreeMap::new();
        for map in maps {
            let id = map.output(plan)?;
            let node = &plan.nodes[id.node];
            if node.role == Role::Node {
                let what = format!("{map}: \"{}\" is no source, and a topic plays a source only", node.name);
                return Err(ReplayError::Unfit(what));
            }
            self.fits(map, &node.outputs[id.port])?;
            mapped.entry(id.node).or_default().insert(&node.outputs[id.port].name, &map.topic);
        }
        let (mut played, mut dropped) = (Played::new(), BTreeSet::new());
        for (index, node) in plan.nodes.iter().enumerate().filter(|(_, node)| node.role != Role::Node) {
            let of_node = mapped.remove(&index).unwrap_or_default();
            if of_node.is_empty() && !node.declared.iter().any(|port| !topics_of(&port.params).is_empty()) {
                if node.role == Role::LiveSource {
                    return Err(self.unmapped(plan.outputs(index).map(|id| (plan.wire_name(id), output(plan, id)))));
                }
                continue;
            }
            let table = graph.get_mut("node").and_then(|nodes| nodes.get_mut(&*node.name));
            let Some(table) = table.and_then(Value::as_table_mut) else { continue };
            let renamed = table.get("frames").and_then(Value::as_table).cloned().unwrap_or_default();
            let mut out = Table::new();
            for id in plan.outputs(index) {
                let (name, output) = (plan.wire_name(id), output(plan, id));
                let declared = node.declared.iter().find(|port| port.name == output.name);
                let reads = |declared: &&DeclaredPort| WHAT_IS_READ.iter().any(|key| is_given(&declared.params[*key]));
                let written = table.get("out").and_then(|out| out.get(&output.name)).and_then(Value::as_table);
                if let Some(topic) = of_node.get(&*output.name) {
                    out.insert(output.name.clone(), port(output, topic, &renamed).into());
                    played.push((name, vec![(*topic).to_owned()]));
                } else if let Some((declared, written)) = declared.filter(reads).zip(written) {
                    let mut written = written.clone();
                    written.retain(|key, _| grammar::has(&grammar::OUTPUT, key) || has(self.port_params, key));
                    out.insert(output.name.clone(), written.into());
                    played.push((name, topics_of(&declared.params)));
                } else if select::is_used(plan, id) {
                    return Err(self.unmapped([(name, output)]));
                } else {
                    dropped.insert(name);
                }
            }
            table.retain(|key, _| key == "on_error" || has(self.params, key));
            let path = std::path::absolute(self.path).unwrap_or_else(|_| self.path.into()).display().to_string();
            table.insert("kind".into(), self.reader.kind.clone().into());
            table.insert("path".into(), path.into());
            table.insert("out".into(), out.into());
        }
        if played.is_empty() {
            let all = self.topics.all();
            let what = format!("no source of the graph reads topics, and none is mapped; its topics are {all}");
            return Err(ReplayError::Unfit(format!("{what}; {}", example(plan))));
        }
        let wires = graph.get_mut("record").and_then(|record| record.get_mut("wires")).and_then(Value::as_array_mut);
        let is_there = |wire: &Value| wire.as_str().is_none_or(|wire| !dropped.contains(wire));
        wires.into_iter().for_each(|wires| wires.retain(is_there));
        Ok((graph.to_string(), played))
    }

    /// Checks that the topic is there, and that a port with this payload can read it.
    fn fits(&self, map: &Mapping, output: &PlanOutput) -> Result<(), ReplayError> {
        let payload = output.payload.name();
        let what = match self.topics.topics.get(&map.topic) {
            Some((schema, _)) if (self.reader.reads)(payload, schema) => return Ok(()),
            Some((schema, _)) => format!("{} carries {schema}", map.topic),
            None => format!("the recording has no topic {}", map.topic),
        };
        let fit = self.topics.fitting(self.reader, payload);
        Err(ReplayError::Unfit(format!("{map}: {what}; of {payload}, which {} gives, it has {fit}", map.port)))
    }

    /// The error for ports that nothing plays, with the topics that fit each.
    fn unmapped<'a>(&self, ports: impl IntoIterator<Item = (String, &'a PlanOutput)>) -> ReplayError {
        let ports = ports.into_iter().map(|(name, output)| {
            let payload = output.payload.name();
            format!("--map {name}=TOPIC, of {payload}: {}", self.topics.fitting(self.reader, payload))
        });
        let ports = ports.collect::<Vec<_>>().join("; ");
        ReplayError::Unfit(format!("no topic is played as a source of the graph; name them: {ports}"))
    }
}

fn output(plan: &Plan, id: OutputId) -> &PlanOutput {
    &plan.nodes[id.node].outputs[id.port]
}

/// Whether a schema has the property.
fn has(schema: &Json, key: &str) -> bool {
    schema["properties"].get(key).is_some()
}

/// Whether a parameter names something.
fn is_given(value: &Json) -> bool {
    value.is_string() || value.as_array().is_some_and(|list| !list.is_empty())
}

/// How a source of this graph is mapped.
fn example(plan: &Plan) -> String {
    let source = |node: &&PlanNode| node.role != Role::Node && !node.outputs.is_empty();
    let source = plan.nodes.iter().find(source).map(|node| format!("{}.{}", node.name, node.outputs[0].name));
    format!("--map {}=TOPIC names one", source.unwrap_or_else(|| "NODE.PORT".into()))
}

/// The topics that the parameters of a declared port name.
fn topics_of(params: &Json) -> Vec<String> {
    let one = params["topic"].as_str().into_iter();
    one.chain(params["topics"].as_array().into_iter().flatten().filter_map(|topic| topic.as_str()))
        .map(str::to_owned)
        .collect()
}

/// The declaration of a port that reads one topic, with the frames that the graph expects; `renamed` has those of the file that have
/// other names in the graph.
fn port(output: &PlanOutput, topic: &str, renamed: &Table) -> Table {
    let in_file = |frame: &Option<String>| {
        let frame = frame.as_deref()?;
        Some(
            renamed
                .iter()
                .find(|(_, name)| name.as_str() == Some(frame))
                .map_or(frame, |(of_file, _)| of_file)
                .to_owned(),
        )
    };
    let frames = &output.frames;
    let entries = [
        ("type", Some(output.payload.name().to_owned())),
        ("topic", Some(topic.to_owned())),
        ("frame", frames.frame.clone()),
        ("to", frames.to.clone()),
        ("from", frames.from.clone()),
        ("parent", in_file(&frames.to)),
        ("child", in_file(&frames.from)),
    ];
    entries.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?.into()))).collect()
}
