//! The process in which a node fires: builds it, and fires it when asked.

use super::{
    Library, PluginDescription,
    load::{self, loads_since},
    provide,
};
use crate::{
    cpu_time,
    hash::mapped::mapped,
    panics,
    plan::Loads,
    process::{
        segment::{Pool, StopPage, Views},
        socket::{Received, Socket},
        wire::{self, Emitted, Fire, FiringOutcome, FromWorker, Place, Reply, ToWorker},
    },
};
use osteoflow_node::{
    Body, BuildContext, Built, Context, DeclaredPort, Emission, Item, Joined, Kind, LogForward, PayloadType, Registry,
    Slot,
};
use std::{
    collections::BTreeMap,
    io,
    os::unix::net::UnixStream,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

/// How often the process looks whether it shall stop, and whether its program is still there.
const LOOK_INTERVAL: Duration = Duration::from_millis(50);

/// Serves a node at a time until the connection on standard input is closed: each message that builds one ends the one before.
///
/// # Errors
/// [`io::Error`] if standard input is no such connection.
pub fn serve(mut registry: Registry) -> io::Result<()> {
    let mut socket = connection()?;
    let Received::Message(ToWorker::Build(build)) = socket.receive()? else {
        return Err(io::Error::other("the first message must be that of the node; this command is run by others"));
    };
    let fds = socket.take_fds(1)?;
    let cancelled = Arc::new(AtomicBool::new(false));
    watch(StopPage::of(&fds[0])?, cancelled.clone())?;
    let socket = Arc::new(Mutex::new(socket));
    if build.log_level > 0 {
        let socket = socket.clone();
        let forward = LogForward::new(build.log_level, move |level, target: &str, message: &str| {
            let line = FromWorker::Log { level, target: target.into(), message: message.into() };
            let _ = send(&socket, &line, &[]);
        });
        let _ = tracing::subscriber::set_global_default(forward);
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(build.n_threads);
    pool.start_handler(|_| panics::mark_helper_thread()).build_global().map_err(io::Error::other)?;
    let before = mapped();
    let (mut node, mut memory) = (None, Memory::default());
    let mut next = Received::Message(ToWorker::Build(build));
    loop {
        match next {
            Received::Message(ToWorker::Build(build)) => {
                // The node before is destroyed first.
                drop(node.take());
                let path = build.plugin.as_ref().map(|plugin| plugin.path.clone());
                match Node::build(&mut registry, *build, cancelled.clone()) {
                    Ok(built) => {
                        let loads = path.map(|path| loads_since(&before, &path));
                        send(&socket, &built.message(loads), &[])?;
                        node = Some(built);
                    }
                    Err((parameter, message)) => {
                        return send(&socket, &FromWorker::Refused { parameter, message }, &[]);
                    }
                }
            }
            Received::Message(ToWorker::Fire(fire)) => {
                let fds = lock(&socket).take_fds(fire.new.len())?;
                memory.views.add(&fire.new, fds)?;
                memory.pool.answered(&fire.held);
                fire.released.iter().for_each(|segment| drop(memory.constants.remove(segment)));
                let Some(node) = &mut node else { return Err(io::Error::other("no node is built")) };
                let began = cpu_time::of_process();
                let answer = node.fire(*fire, &mut memory, &registry);
                let cpu_ns = cpu_time::of_process().saturating_sub(began).as_nanos() as u64;
                let (new, fds) = memory.pool.news();
                send(&socket, &FromWorker::Answer(Box::new(Reply { new, cpu_ns, ..answer })), &fds)?;
            }
            Received::Closed => return Ok(()),
            Received::Nothing => {}
        }
        next = lock(&socket).receive()?;
    }
}

/// The connection on standard input, which becomes empty: a node that reads it must not take messages away.
fn connection() -> io::Result<Socket> {
    let connection = rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdin(), 3)?;
    let stream = UnixStream::from(connection);
    stream.local_addr()?;
    let nothing = std::fs::File::open("/dev/null")?;
    rustix::stdio::dup2_stdin(nothing)?;
    Ok(Socket::new(stream))
}

/// Sets `cancelled` once the page says so, and ends the process when the program is gone while a node still computes.
fn watch(page: StopPage, cancelled: Arc<AtomicBool>) -> io::Result<()> {
    let parent = rustix::process::getppid();
    let look = move || {
        loop {
            thread::sleep(LOOK_INTERVAL);
            if page.is_stopped() {
                cancelled.store(true, Ordering::Relaxed);
            }
            if rustix::process::getppid() != parent {
                #[expect(
                    clippy::disallowed_methods,
                    reason = "the program is gone, and this process has no other purpose"
                )]
                std::process::abort();
            }
        }
    };
    thread::Builder::new().name("stop".into()).spawn(look).map(|_| ())
}

fn lock(socket: &Mutex<Socket>) -> std::sync::MutexGuard<'_, Socket> {
    socket.lock().unwrap_or_else(PoisonError::into_inner)
}

fn send(socket: &Mutex<Socket>, message: &FromWorker, fds: &[rustix::fd::BorrowedFd<'_>]) -> io::Result<()> {
    lock(socket).send(message, fds)
}

/// What is shared with the program, for as long as the process lives.
#[derive(Default)]
struct Memory {
    views: Views,
    pool: Pool,
    /// The constants, by their segment.
    constants: BTreeMap<u32, Item>,
}

/// The node that fires.
struct Node {
    built: Built,
    context: Context,
    inputs: Vec<&'static str>,
    out: Vec<Emission>,
}

impl Node {
    /// Builds the node; the error has the parameter at fault, and a message.
    fn build(
        registry: &mut Registry,
        build: wire::Build,
        cancelled: Arc<AtomicBool>,
    ) -> Result<Self, (String, String)> {
        let whole = |message: String| (String::new(), message);
        if build.version != wire::VERSION {
            let message =
                format!("the process speaks version {} of the protocol, the program {}", wire::VERSION, build.version);
            return Err(whole(message));
        }
        if let Some(library) = build.plugin.filter(|_| registry.kind(&build.kind).is_none()) {
            let description: PluginDescription =
                serde_json::from_value(library.description).map_err(|error| whole(error.to_string()))?;
            let sha256: Arc<str> = library.sha256.as_str().into();
            let plugin = super::Plugin {
                path: library.path,
                sha256: sha256.clone(),
                identity: sha256.clone(),
                copy: library.copy,
                description,
                named: true,
                script: None,
                names_interpreter: false,
            };
            let description = plugin.description.clone();
            let load = move || -> Result<&'static Library, String> { load::load(&plugin) };
            provide(registry, &description, &sha256, load).map_err(|error| whole(error.to_string()))?;
        }
        for payload in &build.payloads {
            if registry.payload_type(&payload.name).is_some() {
                continue;
            }
            let ty = PayloadType::dynamic(&payload.name, payload.version, payload.schema.clone());
            let ty = ty.map_err(|error| whole(error.to_string()))?;
            registry.add_payload_type(ty).map_err(|error| whole(error.to_string()))?;
        }
        let declare = |port: wire::Declared| -> Result<DeclaredPort, (String, String)> {
            let payload = registry.payload_type(&port.payload);
            let payload = payload.ok_or_else(|| whole(format!("payload {} is not known here", port.payload)))?;
            Ok(DeclaredPort { name: port.name, payload, params: port.params })
        };
        let declared: Arc<[DeclaredPort]> =
            build.declared.into_iter().map(declare).collect::<Result<Vec<_>, _>>()?.into();
        let kind: &Kind =
            registry.kind(&build.kind).ok_or_else(|| whole(format!("there is no kind \"{}\" here", build.kind)))?;
        let context = BuildContext {
            node: build.node.as_str().into(),
            seed: build.seed,
            declared: declared.clone(),
            joins: build.joins,
            place: Default::default(),
        };
        let built = match panics::catch(|| kind.build(&build.params, &context)) {
            Ok(built) => built.map_err(|error| (error.parameter, error.message))?,
            Err(panic) => return Err(whole(panic)),
        };
        let n_outputs = kind.description.outputs.payloads(&declared).count();
        let inputs = kind.description.inputs.iter().map(|port| port.name).collect();
        let context = Context::new(build.node, build.seed, cancelled, declared);
        Ok(Self { built, context, inputs, out: vec![Emission::Silent; n_outputs] })
    }

    /// Says that the node is built.
    fn message(&self, loads: Option<Loads>) -> FromWorker {
        let (max_delay_ns, silent_after_ns) = match &self.built {
            Built::Node(_) => (0, None),
            Built::Source(source) => (source.max_delay_ns(), u64::try_from(source.silent_after().as_nanos()).ok()),
        };
        FromWorker::Built { max_delay_ns, silent_after_ns, again: true, loads }
    }

    fn fire(&mut self, fire: Fire, memory: &mut Memory, registry: &Registry) -> Reply {
        let item = fire.context.item;
        let slots = fire.slots.into_iter().map(|slot| memory.slot(slot, registry)).collect();
        self.context.receive(fire.context, &self.inputs);
        self.out.fill(Emission::Silent);
        let ended = match slots {
            Err(message) => FiringOutcome::Failed(message),
            Ok(slots) => {
                let mut joined = Joined { slots, is_spent: true };
                let (built, out, context) = (&mut self.built, &mut self.out, &mut self.context);
                let fired = panics::catch(|| match built {
                    Built::Node(node) => node.fire(&mut joined, out, context).map(|()| true),
                    Built::Source(source) => source.next(out, context),
                });
                match fired {
                    Ok(Ok(true)) => FiringOutcome::Well,
                    Ok(Ok(false)) => FiringOutcome::End,
                    Ok(Err(error)) => FiringOutcome::Failed(error.message),
                    Err(panic) => FiringOutcome::Panicked(panic),
                }
            }
        };
        let emissions: Vec<Emission> = self.out.iter_mut().map(|e| std::mem::replace(e, Emission::Silent)).collect();
        let outputs = match ended {
            FiringOutcome::Well => emissions.into_iter().map(|emission| memory.emitted(emission)).collect(),
            _ => Ok(Vec::new()),
        };
        let (ended, outputs) = match outputs {
            Ok(outputs) => (ended, outputs),
            Err(error) => (FiringOutcome::Failed(format!("no memory to share: {error}")), Vec::new()),
        };
        let (context, held) = (self.context.done(), memory.views.held());
        Reply { item, ended, outputs, context, new: Vec::new(), held, cpu_ns: 0, loads: None }
    }
}

impl Memory {
    fn slot(&mut self, slot: wire::Slot, registry: &Registry) -> Result<Slot, String> {
        Ok(match slot {
            wire::Slot::Absent(empty) => Slot::Absent(Arc::new(empty)),
            wire::Slot::Item(place) => Slot::Item(self.item(place, registry)?),
            wire::Slot::Items(places) => {
                Slot::Items(places.into_iter().map(|place| self.item(place, registry)).collect::<Result<_, _>>()?)
            }
            wire::Slot::Constant(place) => {
                if let Some(item) = self.constants.get(&place.segment) {
                    return Ok(Slot::Item(item.clone()));
                }
                let item = self.item(place, registry)?;
                self.constants.insert(place.segment, item.clone());
                Slot::Item(item)
            }
        })
    }

    fn item(&self, place: Place, registry: &Registry) -> Result<Item, String> {
        let recorded = self.views.item(place)?;
        let body = match (recorded.body, recorded.payload) {
            (Err(empty), _) => Body::Empty(Arc::new(empty)),
            (Ok(view), Some((name, _))) => {
                let ty = registry.payload_type(&name).ok_or_else(|| format!("payload {name} is not known here"))?;
                Body::Value(ty.from_view(&view).map_err(|error| format!("{name}: {error}"))?)
            }
            (Ok(_), None) => return Err("a value without its payload".into()),
        };
        Ok(Item { number: recorded.number, stamp_ns: recorded.stamp_ns, body })
    }

    fn emitted(&mut self, emission: Emission) -> io::Result<Emitted> {
        Ok(match emission {
            Emission::Silent => Emitted::Silent,
            Emission::Empty(reason) => Emitted::Empty(reason),
            Emission::PassedOn(empty) => Emitted::PassedOn((*empty).clone()),
            Emission::Value(value) => {
                let item = Item { number: 0, stamp_ns: 0, body: Body::Value(value) };
                Emitted::Value(self.pool.put(&item, false)?)
            }
        })
    }
}
