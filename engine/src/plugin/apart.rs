//! Nodes that fire in a process of their own.

use super::{Plugin, log_lines};
use crate::{
    panics,
    process::{
        Launcher,
        child::Child,
        segment::{Pool, StopPage, Views},
        socket::Received,
        wire::{self, Emitted, Fire, FiringOutcome, FromWorker, Place, Reply, ToWorker},
    },
};
use osteoflow_node::{
    AnyNode, AnySource, BuildContext, Built, Context, Emission, Item, Join, Joined, Kind, Launch, NodeError,
    OutputPorts, ParamError, PayloadType, PortPayload, Role, SILENT_AFTER, Slot, StampNs, Value,
    abi::schema::PayloadDescription,
};
use std::{
    io,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

/// How often a waiting node looks whether the user asked to stop or its time is over.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);
/// How long a process may take to build its node: loading a library takes milliseconds, an interpreter's imports seconds.
const BUILD_WITHIN: Duration = Duration::from_secs(60);

/// Starts processes of this program for nodes.
pub(super) struct Processes {
    pub(super) launcher: Option<Launcher>,
    /// Whether the kinds of plugins fire there where the graph does not say.
    pub(super) of_plugins: bool,
    pub(super) plugins: Vec<Arc<Plugin>>,
    /// The payload types that the program does not have by itself.
    pub(super) payloads: Vec<&'static PayloadType>,
    /// All payload types.
    pub(super) types: Arc<[&'static PayloadType]>,
}

impl Launch for Processes {
    fn is_wanted(&self, kind: &Kind) -> bool {
        let is_script = || self.of_kind(kind).is_some_and(|plugin| plugin.script.is_some());
        kind.plugin.is_some() && (is_script() || self.of_plugins && self.launcher.is_some())
    }

    fn launch(&self, kind: &Kind, params: &serde_json::Value, context: &BuildContext) -> Result<Built, ParamError> {
        let plugin = self.of_kind(kind);
        let script = plugin.and_then(|plugin| plugin.script.as_ref());
        let Some(launcher) = script.or(self.launcher.as_ref()) else {
            return Err(ParamError::new("process", "this program runs no nodes in processes of their own"));
        };
        let fault = |error: io::Error| ParamError::new("process", format!("its process cannot be started: {error}"));
        let mut child = Child::start(launcher).map_err(fault)?;
        let stop_page = StopPage::new().map_err(|error| fault(error.into()))?;
        let declared = context.declared.iter().map(|port| wire::Declared {
            name: port.name.clone(),
            payload: port.payload.name.into(),
            params: port.params.clone(),
        });
        // A script knows no payload but those of its ports.
        let of_ports = script.map(|_| of_ports(kind, context)).unwrap_or_default();
        let payloads = self.payloads.iter().chain(&of_ports).map(|ty| PayloadDescription {
            name: ty.name.into(),
            version: ty.version,
            schema: ty.schema.to_vec(),
        });
        let build = wire::Build {
            version: wire::VERSION,
            node: context.node.to_string(),
            kind: kind.description.kind.into(),
            seed: context.seed,
            params: params.clone(),
            joins: context.joins.clone(),
            declared: declared.collect(),
            plugin: plugin.map(library),
            payloads: payloads.collect(),
            n_threads: rayon::current_num_threads(),
            log_level: log_lines::level(),
        };
        let fds: Vec<_> = stop_page.fd().into_iter().collect();
        child.socket.send(&ToWorker::Build(Box::new(build)), &fds).map_err(fault)?;
        let outputs = match &kind.description.outputs {
            OutputPorts::Fixed(ports) => ports.iter().map(|port| (port.name.into(), port.payload)).collect(),
            OutputPorts::Declared { .. } => {
                context.declared.iter().map(|port| (port.name.clone(), PortPayload::Type(port.payload))).collect()
            }
        };
        let mut node = OutOfProcess {
            child,
            stop_page,
            file: plugin.map(|plugin| plugin.path.clone()),
            stop_after: context.place.stop_after,
            pool: Pool::default(),
            views: Views::default(),
            constants: context.joins.iter().map(|join| matches!(join, Join::Once).then_some(None)).collect(),
            outputs,
            types: self.types.clone(),
            max_delay_ns: 0,
            silent_after: SILENT_AFTER,
            is_gone: false,
        };
        match node.reply(Some(BUILD_WITHIN), &mut || false) {
            Ok(FromWorker::Built { max_delay_ns, silent_after_ns }) => {
                node.max_delay_ns = max_delay_ns;
                node.silent_after = silent_after_ns.map_or(SILENT_AFTER, Duration::from_nanos);
            }
            Ok(FromWorker::Refused { parameter, message }) => return Err(ParamError::new(parameter, message)),
            Ok(_) => return Err(ParamError::new("", "its process answers something else than that the node is built")),
            Err(Disconnected(message)) => return Err(ParamError::new("", message)),
        }
        Ok(match kind.description.role {
            Role::Node => Built::Node(Box::new(node)),
            Role::Source | Role::LiveSource => Built::Source(Box::new(node)),
        })
    }
}

impl Processes {
    fn of_kind(&self, kind: &Kind) -> Option<&Plugin> {
        let sha256 = kind.plugin.as_ref()?;
        self.plugins.iter().find(|plugin| plugin.sha256 == *sha256).map(|plugin| &**plugin)
    }
}

/// The payload types of a node's ports.
fn of_ports(kind: &Kind, context: &BuildContext) -> Vec<&'static PayloadType> {
    let inputs = kind.description.inputs.iter().map(|port| port.payload);
    let outputs = match &kind.description.outputs {
        OutputPorts::Fixed(ports) => ports.iter().map(|port| port.payload).collect(),
        OutputPorts::Declared { .. } => Vec::new(),
    };
    let types = inputs.chain(outputs).filter_map(|payload| match payload {
        PortPayload::Type(ty) => Some(ty),
        PortPayload::Any => None,
    });
    types.chain(context.declared.iter().map(|port| port.payload)).collect()
}

fn library(plugin: &Plugin) -> wire::Library {
    let description = serde_json::to_value(&plugin.description).unwrap_or_default();
    wire::Library { path: plugin.path.clone(), sha256: plugin.sha256.to_string(), description }
}

/// A constant that the process has: the value, and where it lies.
type Sent = Option<(Value, Place)>;

/// A node in a process of its own.
struct OutOfProcess {
    child: Child,
    stop_page: StopPage,
    /// The library or program of its kind.
    file: Option<PathBuf>,
    stop_after: Option<Duration>,
    pool: Pool,
    views: Views,
    /// For each input joined by `once`: what the process has.
    constants: Vec<Option<Sent>>,
    /// Names and payloads.
    outputs: Vec<(String, PortPayload)>,
    types: Arc<[&'static PayloadType]>,
    max_delay_ns: StampNs,
    silent_after: Duration,
    is_gone: bool,
}

/// The process is gone or does not keep to the protocol: why.
struct Disconnected(String);

impl OutOfProcess {
    /// The next message of the process but log lines.
    fn reply(
        &mut self,
        limit: Option<Duration>,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<FromWorker, Disconnected> {
        let began = Instant::now();
        let _ = self.child.socket.wait_at_most(Some(LOOK_INTERVAL));
        loop {
            // Looked at after log lines, too: a process that logs without end is stopped like a silent one.
            if cancelled() {
                self.stop_page.stop();
            }
            if let Some(limit) = limit.filter(|limit| began.elapsed() > *limit) {
                self.child.kill();
                let within = limit.as_secs_f64();
                return Err(self.gone(format!("it did not answer within {within} s, and its process was stopped")));
            }
            match self.child.socket.receive::<FromWorker>() {
                Ok(Received::Message(FromWorker::Log { level, target, message })) => {
                    log_lines::log(level, &target, &message)
                }
                Ok(Received::Message(message)) => return Ok(message),
                Ok(Received::Nothing) => {}
                Ok(Received::Closed) => {
                    let how = self.child.ending();
                    return Err(self.gone(how));
                }
                Err(error) => {
                    self.child.kill();
                    return Err(self.gone(format!("its process sends what cannot be read: {error}")));
                }
            }
        }
    }

    fn gone(&mut self, how: String) -> Disconnected {
        self.is_gone = true;
        let of = self.file.as_ref().map(|file| format!(", plugin {}", file.display())).unwrap_or_default();
        Disconnected(format!("{how}{of}"))
    }

    /// Sends a firing, and takes its answer.
    fn call(&mut self, joined: &Joined, out: &mut [Emission], context: &mut Context) -> Result<bool, NodeError> {
        if self.is_gone {
            return Err(NodeError::new("its process has ended"));
        }
        let slots =
            joined.slots.iter().enumerate().map(|(port, slot)| self.slot(port, slot)).collect::<io::Result<_>>();
        let slots = slots.map_err(|error| NodeError::new(format!("no memory to share with its process: {error}")))?;
        let held = self.views.held();
        let (new, fds) = self.pool.news();
        let sent_context = context.sent();
        let number = sent_context.item;
        let fire = ToWorker::Fire(Box::new(Fire { context: sent_context, slots, new, held }));
        let sent = self.child.socket.send(&fire, &fds);
        if sent.is_err() {
            let how = self.child.ending();
            return Err(NodeError::new(self.gone(how).0));
        }
        let answer = match self.reply(self.stop_after, &mut || context.cancelled()) {
            Ok(FromWorker::Answer(answer)) if answer.item == number => *answer,
            Ok(FromWorker::Answer(answer)) => {
                self.child.kill();
                let message = format!("its process answers for item {}, and was stopped", answer.item);
                return Err(NodeError::new(self.gone(message).0));
            }
            Ok(_) => return Err(NodeError::new("its process answers something else than a firing")),
            Err(Disconnected(message)) => return Err(NodeError::new(message)),
        };
        self.take(answer, out, context).map_err(|message| NodeError::new(format!("its process {message}")))?
    }

    fn slot(&mut self, port: usize, slot: &Slot) -> io::Result<wire::Slot> {
        Ok(match slot {
            Slot::Absent(empty) => wire::Slot::Absent((**empty).clone()),
            Slot::Items(items) => {
                let places = items.iter().map(|item| self.pool.put(item, false));
                wire::Slot::Items(places.collect::<Result<_, _>>()?)
            }
            Slot::Item(item) => match self.constants.get_mut(port) {
                Some(Some(sent)) => wire::Slot::Constant(constant(&mut self.pool, sent, item)?),
                _ => wire::Slot::Item(self.pool.put(item, false)?),
            },
        })
    }

    /// Takes the answer over; the error says what is wrong with it.
    fn take(
        &mut self,
        answer: Reply,
        out: &mut [Emission],
        context: &mut Context,
    ) -> Result<Result<bool, NodeError>, String> {
        let fds =
            self.child.socket.take_fds(answer.new.len()).map_err(|error| format!("breaks the protocol: {error}"))?;
        self.views.add(&answer.new, fds).map_err(|error| format!("shares memory that cannot be read: {error}"))?;
        self.pool.answered(&answer.held);
        context.take_over(answer.context);
        match answer.ended {
            FiringOutcome::Well => {}
            FiringOutcome::End => return Ok(Ok(false)),
            FiringOutcome::Failed(message) => return Ok(Err(NodeError::new(message))),
            FiringOutcome::Panicked(message) => panics::resume_described(message),
        }
        if answer.outputs.len() != out.len() {
            return Err(format!("answers on {} outputs of {}", answer.outputs.len(), out.len()));
        }
        for (port, (emitted, emission)) in answer.outputs.into_iter().zip(out).enumerate() {
            *emission = match emitted {
                Emitted::Silent => Emission::Silent,
                Emitted::Empty(reason) => Emission::Empty(reason),
                Emitted::PassedOn(empty) => Emission::PassedOn(Arc::new(empty)),
                Emitted::Value(place) => match self.value(port, place) {
                    Ok(value) => Emission::Value(value),
                    Err(message) => return Ok(Err(NodeError::new(message))),
                },
            };
        }
        Ok(Ok(true))
    }

    fn value(&self, port: usize, place: Place) -> Result<Value, String> {
        let (output, payload) = &self.outputs[port];
        self.views.value(place, *payload, &self.types).map_err(|error| format!("output \"{output}\": {error}"))
    }
}

/// Where the process has the constant; sent anew if it is another.
fn constant(pool: &mut Pool, sent: &mut Sent, item: &Item) -> io::Result<Place> {
    if let osteoflow_node::Body::Value(value) = &item.body {
        if let Some((_, place)) = sent.as_ref().filter(|(known, _)| known.is_same(value)) {
            return Ok(*place);
        }
        let place = pool.put(item, true)?;
        if let Some((_, old)) = sent.replace((value.clone(), place)) {
            pool.release(old);
        }
        return Ok(place);
    }
    Ok(pool.put(item, false)?)
}

impl AnyNode for OutOfProcess {
    fn fire(&mut self, joined: &mut Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError> {
        self.call(joined, out, ctx).map(|_| ())
    }
}

impl AnySource for OutOfProcess {
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError> {
        self.call(&Joined::default(), out, ctx)
    }

    fn max_delay_ns(&self) -> StampNs {
        self.max_delay_ns
    }

    fn silent_after(&self) -> Duration {
        self.silent_after
    }
}
