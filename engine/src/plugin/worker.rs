//! The process in which a node fires: builds it, and fires it when asked.

use super::{Library, PluginDescription, load, provide};
use crate::{
    panics,
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

/// Serves one node until the connection on standard input is closed.
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
    let (node, seed) = (build.node.clone(), build.seed);
    let (built, declared, inputs, n_outputs) = match built(&mut registry, *build) {
        Ok(built) => built,
        Err((parameter, message)) => return send(&socket, &FromWorker::Refused { parameter, message }, &[]),
    };
    let (max_delay_ns, silent_after_ns) = match &built {
        Built::Node(_) => (0, None),
        Built::Source(source) => (source.max_delay_ns(), u64::try_from(source.silent_after().as_nanos()).ok()),
    };
    send(&socket, &FromWorker::Built { max_delay_ns, silent_after_ns }, &[])?;
    let mut server = Server {
        built,
        context: Context::new(node, seed, cancelled, declared),
        inputs,
        out: vec![Emission::Silent; n_outputs],
        registry,
        views: Views::default(),
        pool: Pool::default(),
        constants: BTreeMap::new(),
    };
    loop {
        let message = lock(&socket).receive()?;
        match message {
            Received::Message(ToWorker::Fire(fire)) => {
                let fds = lock(&socket).take_fds(fire.new.len())?;
                server.views.add(&fire.new, fds)?;
                server.pool.answered(&fire.held);
                let answer = server.fire(*fire);
                let (new, fds) = server.pool.news();
                send(&socket, &FromWorker::Answer(Box::new(Reply { new, ..answer })), &fds)?;
            }
            Received::Closed => return Ok(()),
            Received::Nothing | Received::Message(ToWorker::Build(_)) => {}
        }
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

type Ready = (Built, Arc<[DeclaredPort]>, Vec<&'static str>, usize);

/// Builds the node; the error has the parameter at fault, and a message.
fn built(registry: &mut Registry, build: wire::Build) -> Result<Ready, (String, String)> {
    let whole = |message: String| (String::new(), message);
    if build.version != wire::VERSION {
        let message =
            format!("the process speaks version {} of the protocol, the program {}", wire::VERSION, build.version);
        return Err(whole(message));
    }
    if let Some(library) = build.plugin {
        let description: PluginDescription =
            serde_json::from_value(library.description).map_err(|error| whole(error.to_string()))?;
        let sha256: Arc<str> = library.sha256.as_str().into();
        let plugin = super::Plugin {
            path: library.path,
            sha256: sha256.clone(),
            description,
            named: true,
            script: None,
            names_interpreter: false,
        };
        let description = plugin.description.clone();
        provide(registry, &description, &sha256, move || -> Result<&'static Library, String> { load::load(&plugin) })
            .map_err(|error| whole(error.to_string()))?;
    }
    for payload in build.payloads {
        let ty = PayloadType::dynamic(&payload.name, payload.version, payload.schema);
        let ty = ty.map_err(|error| whole(error.to_string()))?;
        registry.add_payload_type(ty).map_err(|error| whole(error.to_string()))?;
    }
    let declare = |port: wire::Declared| -> Result<DeclaredPort, (String, String)> {
        let payload = registry.payload_type(&port.payload);
        let payload = payload.ok_or_else(|| whole(format!("payload {} is not known here", port.payload)))?;
        Ok(DeclaredPort { name: port.name, payload, params: port.params })
    };
    let declared: Arc<[DeclaredPort]> = build.declared.into_iter().map(declare).collect::<Result<Vec<_>, _>>()?.into();
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
    let n_outputs = match &kind.description.outputs {
        osteoflow_node::OutputPorts::Fixed(ports) => ports.len(),
        osteoflow_node::OutputPorts::Declared { .. } => declared.len(),
    };
    let inputs = kind.description.inputs.iter().map(|port| port.name).collect();
    Ok((built, declared, inputs, n_outputs))
}

struct Server {
    built: Built,
    context: Context,
    inputs: Vec<&'static str>,
    out: Vec<Emission>,
    registry: Registry,
    views: Views,
    pool: Pool,
    /// The constants of ports, with their places.
    constants: BTreeMap<usize, (Place, Item)>,
}

impl Server {
    fn fire(&mut self, fire: Fire) -> Reply {
        let item = fire.context.item;
        let slots = fire.slots.into_iter().enumerate().map(|(port, slot)| self.slot(port, slot)).collect();
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
            FiringOutcome::Well => emissions.into_iter().map(|emission| self.emitted(emission)).collect(),
            _ => Ok(Vec::new()),
        };
        let (ended, outputs) = match outputs {
            Ok(outputs) => (ended, outputs),
            Err(error) => (FiringOutcome::Failed(format!("no memory to share: {error}")), Vec::new()),
        };
        Reply { item, ended, outputs, context: self.context.done(), new: Vec::new(), held: self.views.held() }
    }

    fn slot(&mut self, port: usize, slot: wire::Slot) -> Result<Slot, String> {
        Ok(match slot {
            wire::Slot::Absent(empty) => Slot::Absent(Arc::new(empty)),
            wire::Slot::Item(place) => Slot::Item(self.item(place)?),
            wire::Slot::Items(places) => {
                Slot::Items(places.into_iter().map(|p| self.item(p)).collect::<Result<_, _>>()?)
            }
            wire::Slot::Constant(place) => match self.constants.get(&port) {
                Some((known, item)) if *known == place => Slot::Item(item.clone()),
                _ => {
                    self.constants.remove(&port);
                    let item = self.item(place)?;
                    self.constants.insert(port, (place, item.clone()));
                    Slot::Item(item)
                }
            },
        })
    }

    fn item(&self, place: Place) -> Result<Item, String> {
        let recorded = self.views.item(place)?;
        let body = match (recorded.body, recorded.payload) {
            (Err(empty), _) => Body::Empty(Arc::new(empty)),
            (Ok(view), Some((name, _))) => {
                let ty =
                    self.registry.payload_type(&name).ok_or_else(|| format!("payload {name} is not known here"))?;
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
