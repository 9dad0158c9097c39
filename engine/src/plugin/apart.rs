//! Nodes that fire in a process of their own.

use super::{Finder, Plugin, late, log_lines};
use crate::{
    cpu_time, panics,
    plan::Loads,
    process::{
        Launcher,
        child::Child,
        segment::{Pool, StopPage, Views},
        socket::Received,
        wire::{self, Emitted, Fire, FiringOutcome, FromWorker, Place, Reply, ToWorker},
    },
};
use osteoflow_node::{
    AnyNode, AnySource, Body, BuildContext, Built, Context, Emission, Item, Join, Joined, Kind, Launch, NodeError,
    ParamError, PayloadType, PortPayload, Role, SILENT_AFTER, Slot, StampNs, Value, abi::schema::PayloadDescription,
};
use std::{
    collections::BTreeMap,
    io,
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

/// How often a waiting node looks whether the user asked to stop or its time is over.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);
/// How long a process may take to build its node: loading a library takes milliseconds, an interpreter's imports seconds.
const BUILD_WITHIN: Duration = Duration::from_secs(60);

/// Starts processes for nodes.
pub(super) struct Processes {
    pub(super) finder: Arc<Finder>,
    pub(super) plugins: Vec<Arc<Plugin>>,
    /// The payload types that the program does not have by itself.
    pub(super) payloads: Vec<&'static PayloadType>,
    /// All payload types.
    pub(super) types: Arc<[&'static PayloadType]>,
    /// Processes without a node, by plugin and kind.
    pub(super) idle: Arc<Idle>,
}

/// Processes whose node is no longer needed, by plugin and kind.
pub(super) type Idle = Mutex<BTreeMap<String, Vec<Worker>>>;

impl Launch for Processes {
    fn is_wanted(&self, kind: &Kind) -> bool {
        let is_script = || self.of_kind(kind).is_some_and(|plugin| plugin.script.is_some());
        kind.plugin.is_some() && (is_script() || self.finder.plugins_apart && self.finder.launcher.is_some())
    }

    fn launch(&self, kind: &Kind, params: &serde_json::Value, context: &BuildContext) -> Result<Built, ParamError> {
        let plugin = self.of_kind(kind);
        let script = plugin.and_then(|plugin| plugin.script.as_ref());
        let Some(launcher) = script.or(self.finder.launcher.as_ref()) else {
            return Err(ParamError::new("process", "this program runs no nodes in processes of their own"));
        };
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
        let build = ToWorker::Build(Box::new(wire::Build {
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
        }));
        let outputs = kind.description.outputs.payloads(&context.declared);
        let outputs = outputs.map(|(name, payload)| (name.into(), payload)).collect();
        let is_pooled = self.finder.held.is_some() && context.place.pool != Some(false);
        let key = format!("{} {}", kind.plugin.as_deref().unwrap_or_default(), kind.description.kind);
        let worker = is_pooled.then(|| lock(&self.idle).get_mut(&key)?.pop()).flatten();
        let worker = worker.map_or_else(|| Worker::start(launcher, plugin), Ok);
        let worker =
            worker.map_err(|error| ParamError::new("process", format!("its process cannot be started: {error}")))?;
        let mut node = OutOfProcess {
            worker: Some(worker),
            is_constant: context.joins.iter().map(|join| matches!(join, Join::Once)).collect(),
            stop_after: context.place.stop_after,
            outputs,
            types: self.types.clone(),
            max_delay_ns: 0,
            silent_after: SILENT_AFTER,
            idle: None,
        };
        let Some(worker) = &mut node.worker else { return Err(ParamError::new("", "its process has ended")) };
        let (max_delay_ns, silent_after_ns, again) =
            worker.build(&build).map_err(|(parameter, message)| ParamError::new(parameter, message))?;
        if worker.loads_something_else.is_some()
            && let Some(plugin) = plugin
        {
            // It is looked at again next time, whatever the stamps of the files say.
            self.finder.forget(plugin);
        }
        node.idle = (is_pooled && again).then(|| (self.idle.clone(), key));
        node.max_delay_ns = max_delay_ns;
        node.silent_after = silent_after_ns.map_or(SILENT_AFTER, Duration::from_nanos);
        Ok(match kind.description.role {
            Role::Node => Built::Node(Box::new(node)),
            Role::Source | Role::LiveSource => Built::Source(Box::new(node)),
        })
    }
}

impl Processes {
    fn of_kind(&self, kind: &Kind) -> Option<&Plugin> {
        let identity = kind.plugin.as_ref()?;
        self.plugins.iter().find(|plugin| plugin.identity == *identity).map(|plugin| &**plugin)
    }
}

/// The payload types of a node's ports.
fn of_ports(kind: &Kind, context: &BuildContext) -> Vec<&'static PayloadType> {
    let inputs = kind.description.inputs.iter().map(|port| port.payload);
    let outputs = kind.description.outputs.payloads(&context.declared).map(|(_, payload)| payload);
    inputs.chain(outputs).filter_map(|payload| payload.ty()).collect()
}

fn library(plugin: &Plugin) -> wire::Library {
    let description = serde_json::to_value(&plugin.description).unwrap_or_default();
    let (path, copy) = (plugin.path.clone(), plugin.copy.clone());
    wire::Library { path, sha256: plugin.sha256.to_string(), copy, description }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A process that builds nodes and fires them, one after the other.
pub(super) struct Worker {
    child: Child,
    stop_page: StopPage,
    /// Whether it has built a node before.
    is_used: bool,
    /// The plugin's file, and what was loaded when it was looked at.
    plugin: Option<(PathBuf, Loads)>,
    /// In which way its process has loaded something else.
    loads_something_else: Option<String>,
    pool: Pool,
    views: Views,
    /// The constants that it has, with their places, the least recently used first.
    constants: Vec<(Value, Place)>,
    is_gone: bool,
    n_processors: u32,
}

/// Constants that a process keeps beside those of its node: a sweep goes from bone to bone and back.
const MORE_CONSTANTS: usize = 4;

/// A node in a process of its own.
struct OutOfProcess {
    /// Taken when the node is dropped.
    worker: Option<Worker>,
    stop_after: Option<Duration>,
    /// For each input: whether it is joined by `once`.
    is_constant: Vec<bool>,
    /// Names and payloads.
    outputs: Vec<(String, PortPayload)>,
    types: Arc<[&'static PayloadType]>,
    max_delay_ns: StampNs,
    silent_after: Duration,
    /// Where the process waits for another node, and its key there.
    idle: Option<(Arc<Idle>, String)>,
}

impl Drop for OutOfProcess {
    fn drop(&mut self) {
        if let (Some(worker), Some((idle, key))) = (self.worker.take(), self.idle.take())
            && !worker.is_gone
            && !worker.stop_page.is_stopped()
        {
            lock(&idle).entry(key).or_default().push(worker);
        }
    }
}

/// The process is gone or does not keep to the protocol: why.
struct Disconnected(String);

impl Worker {
    fn start(launcher: &Launcher, plugin: Option<&Plugin>) -> io::Result<Self> {
        Ok(Self {
            child: Child::start(launcher)?,
            stop_page: StopPage::new()?,
            is_used: false,
            plugin: plugin.map(|plugin| (plugin.path.clone(), plugin.description.loads.clone())),
            loads_something_else: None,
            pool: Pool::default(),
            views: Views::default(),
            constants: Vec::new(),
            is_gone: false,
            n_processors: std::thread::available_parallelism().map_or(1, |n| n.get() as u32),
        })
    }

    /// Builds a node; gives the delay and the silence of a source, and whether another may be built after it. The error has the
    /// parameter at fault, and a message.
    fn build(&mut self, build: &ToWorker) -> Result<(StampNs, Option<u64>, bool), (String, String)> {
        let whole = |message: String| (String::new(), message);
        let fds: Vec<_> = self.stop_page.fd().into_iter().filter(|_| !self.is_used).collect();
        if let Err(error) = self.child.socket.send(build, &fds) {
            return Err(("process".into(), format!("its process cannot be started: {error}")));
        }
        self.is_used = true;
        if let ToWorker::Build(build) = build {
            self.child.node.clone_from(&build.node);
        }
        match self.reply(Some(BUILD_WITHIN), &mut || false) {
            Ok(FromWorker::Built { max_delay_ns, silent_after_ns, again, loads }) => {
                self.take_loads(loads);
                match &self.loads_something_else {
                    Some(message) => Err(whole(message.clone())),
                    None => Ok((max_delay_ns, silent_after_ns, again)),
                }
            }
            Ok(FromWorker::Refused { parameter, message }) => Err((parameter, message)),
            Ok(_) => Err(whole("its process answers something else than that the node is built".into())),
            Err(Disconnected(message)) => Err(whole(message)),
        }
    }

    /// Compares what the process has loaded with what was loaded when the plugin was looked at, and by other processes since.
    fn take_loads(&mut self, loads: Option<Loads>) {
        let (Some(loads), Some((path, known))) = (loads, &mut self.plugin) else { return };
        let mut differences = known.changed(&loads);
        if known.add(&loads) {
            differences.extend(late::add(path, &loads));
        }
        if !differences.is_empty() {
            let differences = differences.join(", ");
            let path = path.display();
            let message =
                format!("plugin {path} loads something else than when it was looked at: {differences}; run again");
            self.loads_something_else = Some(message);
        }
    }

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
                    log_lines::log(level, &format!("node \"{}\": {target}", self.child.node), &message)
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
        let of = self.plugin.as_ref().map(|(file, _)| format!(", plugin {}", file.display())).unwrap_or_default();
        Disconnected(format!("{how}{of}"))
    }

    /// Sends a firing, and waits for its answer. The error says why there is none.
    fn fire(
        &mut self,
        joined: &Joined,
        is_constant: &[bool],
        stop_after: Option<Duration>,
        context: &mut Context,
    ) -> Result<Reply, String> {
        if self.is_gone {
            return Err("its process has ended".into());
        }
        let n_constants = is_constant.iter().filter(|is_constant| **is_constant).count();
        let n_dropped = self.constants.len().saturating_sub(MORE_CONSTANTS + n_constants);
        let dropped: Vec<Place> = self.constants.drain(..n_dropped).map(|(_, place)| place).collect();
        dropped.iter().for_each(|place| self.pool.release(*place));
        let slots = joined
            .slots
            .iter()
            .enumerate()
            .map(|(port, slot)| self.slot(slot, is_constant.get(port).copied().unwrap_or_default()));
        let slots = slots.collect::<io::Result<_>>();
        let slots = slots.map_err(|error| format!("no memory to share with its process: {error}"))?;
        let held = self.views.held();
        let (new, fds) = self.pool.news();
        let sent_context = context.sent();
        let number = sent_context.item;
        let released = dropped.iter().map(|place| place.segment).collect();
        let fire = ToWorker::Fire(Box::new(Fire { context: sent_context, slots, new, held, released }));
        if self.child.socket.send(&fire, &fds).is_err() {
            let how = self.child.ending();
            return Err(self.gone(how).0);
        }
        let sent_at = Instant::now();
        match self.reply(stop_after, &mut || context.cancelled()) {
            Ok(FromWorker::Answer(answer)) if answer.item == number => {
                // No process can spend more, whatever it says.
                let most = sent_at.elapsed().saturating_mul(self.n_processors);
                cpu_time::add_apart(Duration::from_nanos(answer.cpu_ns).min(most));
                Ok(*answer)
            }
            Ok(FromWorker::Answer(answer)) => {
                self.child.kill();
                Err(self.gone(format!("its process answers for item {}, and was stopped", answer.item)).0)
            }
            Ok(_) => Err("its process answers something else than a firing".into()),
            Err(Disconnected(message)) => Err(message),
        }
    }

    fn slot(&mut self, slot: &Slot, is_constant: bool) -> io::Result<wire::Slot> {
        Ok(match slot {
            Slot::Absent(empty) => wire::Slot::Absent((**empty).clone()),
            Slot::Items(items) => {
                let places = items.iter().map(|item| self.pool.put(item, false));
                wire::Slot::Items(places.collect::<Result<_, _>>()?)
            }
            Slot::Item(item) => match &item.body {
                Body::Value(value) if is_constant => wire::Slot::Constant(self.constant(value, item)?),
                _ => wire::Slot::Item(self.pool.put(item, false)?),
            },
        })
    }

    /// Where the process has the constant; sent if it has it not.
    fn constant(&mut self, value: &Value, item: &Item) -> io::Result<Place> {
        let known = self.constants.iter().position(|(known, _)| known.is_same(value));
        // Another run may have read or computed the same again.
        let known = known.or_else(|| self.constants.iter().position(|(_, place)| self.pool.holds(*place, item)));
        let place = match known {
            Some(at) => self.constants.remove(at).1,
            None => self.pool.put(item, true)?,
        };
        self.constants.push((value.clone(), place));
        Ok(place)
    }
}

impl OutOfProcess {
    /// Sends a firing, and takes its answer.
    fn call(&mut self, joined: &Joined, out: &mut [Emission], context: &mut Context) -> Result<bool, NodeError> {
        let Some(worker) = &mut self.worker else { return Err(NodeError::new("its process has ended")) };
        let answer = worker.fire(joined, &self.is_constant, self.stop_after, context);
        let taken = answer.map(|answer| self.take(answer, out, context));
        // A process that does not keep to the protocol builds no other node: what it answers next may be to this firing.
        if !matches!(taken, Ok(Ok(_))) {
            self.idle = None;
        }
        taken.map_err(NodeError::new)?.map_err(|message| NodeError::new(format!("its process {message}")))?
    }

    /// Takes the answer over; the error says what is wrong with it.
    fn take(
        &mut self,
        mut answer: Reply,
        out: &mut [Emission],
        context: &mut Context,
    ) -> Result<Result<bool, NodeError>, String> {
        let Some(worker) = &mut self.worker else { return Err("has ended".into()) };
        let fds =
            worker.child.socket.take_fds(answer.new.len()).map_err(|error| format!("breaks the protocol: {error}"))?;
        worker.views.add(&answer.new, fds).map_err(|error| format!("shares memory that cannot be read: {error}"))?;
        worker.pool.answered(&answer.held);
        context.take_over(answer.context);
        worker.take_loads(answer.loads.take());
        match answer.ended {
            FiringOutcome::Well => {}
            FiringOutcome::End => return Ok(Ok(false)),
            FiringOutcome::Failed(message) => return Ok(Err(NodeError::new(message))),
            FiringOutcome::Panicked(message) => panics::resume_described(message),
        }
        if let Some(message) = &worker.loads_something_else {
            return Ok(Err(NodeError::new(message.clone())));
        }
        if answer.outputs.len() != out.len() {
            return Err(format!("answers on {} outputs of {}", answer.outputs.len(), out.len()));
        }
        let value = |port: usize, place: Place| {
            let (output, payload): &(String, PortPayload) = &self.outputs[port];
            worker.views.value(place, *payload, &self.types).map_err(|error| format!("output \"{output}\": {error}"))
        };
        for (port, (emitted, emission)) in answer.outputs.into_iter().zip(out).enumerate() {
            *emission = match emitted {
                Emitted::Silent => Emission::Silent,
                Emitted::Empty(reason) => Emission::Empty(reason),
                Emitted::PassedOn(empty) => Emission::PassedOn(Arc::new(empty)),
                Emitted::Value(place) => match value(port, place) {
                    Ok(value) => Emission::Value(value),
                    Err(message) => return Ok(Err(NodeError::new(message))),
                },
            };
        }
        Ok(Ok(true))
    }
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
