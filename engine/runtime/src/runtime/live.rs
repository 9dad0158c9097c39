//! Live sources: each runs on a thread of its own and may wait for its device. One further thread puts their answers on
//! the wires, so that no worker waits for a device and no device for a worker.
//!
//! A source is *pending* while it is asked for its next answer. It is not pending while its outputs lack room, nor once
//! it has ended: a graph whose workers all wait while no source is pending is stuck, and this is detected exactly and
//! at once. The step in which a worker reports room also counts the source as pending again.

use super::{
    Runtime,
    cell::{NextRequest, Reply},
};
use crate::{
    activity::{Doing, Name},
    outcome::discard,
    panics,
    report::{Event, Warning},
    scheduler::Scheduler,
};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use osteoflow_node::{AnySource, Context, StampNs};
use std::{
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
    sync::{Mutex, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// Interval at which stop requests and silent sources are checked.
const TICK: Duration = Duration::from_millis(20);
/// Time that a source has to react to a stop request; then the run ends without it.
const GRACE: Duration = Duration::from_millis(500);

/// A live source before it starts.
pub(crate) struct Live {
    /// The node.
    pub(crate) node: usize,
    /// The node's source.
    pub(crate) source: Box<dyn AnySource>,
    /// The source's own context; the cell has another.
    pub(crate) context: Context,
    /// Number of outputs.
    pub(crate) n_ports: usize,
}

/// Messages to the thread that serves live sources.
pub(crate) enum LiveMessage {
    /// A source has answered.
    Answered(usize, Reply),
    /// An output may have room for the source's next answer; the source counts as pending since before this was sent.
    Room(usize),
    /// A source has been dropped on its thread.
    Gone,
    /// All workers have ended.
    Over,
}

/// Channel to the thread that serves live sources.
pub(crate) struct Mailbox {
    pub(crate) tx: Sender<LiveMessage>,
    rx: Receiver<LiveMessage>,
}

impl Mailbox {
    /// Capacity for `n_sources`: each has at most one answer, one notice of room and one notice of its end in flight.
    pub(crate) fn new(n_sources: usize) -> Self {
        let (tx, rx) = bounded(3 * n_sources + 1);
        Self { tx, rx }
    }
}

/// Request for a source's next answer.
struct Ask {
    item: u64,
    stamp_ns: StampNs,
}

/// A running source.
struct Device {
    node: usize,
    asks: Option<Sender<Ask>>,
    thread: JoinHandle<()>,
    silent_after: Duration,
    /// Interval at which it is looked whether its wires are silent, if a contract limits that.
    look_every: Option<Duration>,
    /// When it was asked; `None` while it is not pending.
    asked: Option<Instant>,
    reported_silent: bool,
    /// It did not react to the stop request in time.
    left_behind: bool,
}

/// Runs a graph with live sources.
pub(crate) fn run(run: &Runtime<'_>, scheduler: &Scheduler, sources: Vec<Live>) {
    let panicked = Mutex::new(None);
    std::thread::scope(|scope| {
        let serve = std::thread::Builder::new().name("live".into());
        let served = serve.spawn_scoped(scope, || {
            let served = catch_unwind(AssertUnwindSafe(|| {
                // If this thread panics, the workers must not wait for it.
                let _guard = scheduler.guard();
                Server { run, scheduler, devices: Vec::new(), stopped: None, looked: Duration::ZERO }.serve(sources);
            }));
            *panicked.lock().unwrap_or_else(PoisonError::into_inner) = served.err();
        });
        if let Err(error) = served {
            run.fail_live(&format!("the thread for live sources cannot be started: {error}"), scheduler);
        }
        // Also when the workers unwind.
        let _over = Over(&run.mailbox);
        scheduler.run(run);
    });
    if let Some(payload) = panicked.into_inner().unwrap_or_else(PoisonError::into_inner) {
        resume_unwind(payload);
    }
}

struct Over<'a>(&'a Mailbox);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        // Without a receiver no notice is needed.
        let _ = self.0.tx.try_send(LiveMessage::Over);
    }
}

struct Server<'a, 'r> {
    run: &'a Runtime<'r>,
    scheduler: &'a Scheduler,
    devices: Vec<Device>,
    /// When the stop request was seen.
    stopped: Option<Instant>,
    /// When it last looked for wires that are silent.
    looked: Duration,
}

impl Server<'_, '_> {
    fn serve(mut self, sources: Vec<Live>) {
        for source in sources {
            self.start(source);
        }
        loop {
            match self.run.mailbox.rx.recv_timeout(self.look_every().unwrap_or(TICK)) {
                Ok(LiveMessage::Answered(node, answer)) => self.answered(node, answer),
                Ok(LiveMessage::Room(node)) => self.ask(node),
                Ok(LiveMessage::Over) | Err(RecvTimeoutError::Disconnected) => break,
                Ok(LiveMessage::Gone) | Err(RecvTimeoutError::Timeout) => {}
            }
            self.check_clock();
        }
        self.leave();
    }

    fn start(&mut self, source: Live) {
        let (node, silent_after) = (source.node, source.source.silent_after());
        let (asks, asked) = bounded(1);
        let answers = self.run.mailbox.tx.clone();
        let thread = std::thread::Builder::new().name(format!("source-{node}")).stack_size(8 << 20);
        match thread.spawn(move || run_source(source, &asked, &answers)) {
            Ok(thread) => {
                let asks = Some(asks);
                let look_every = self.run.cell(node).look_every();
                let (asked, reported_silent, left_behind) = (None, false, false);
                self.devices.push(Device {
                    node,
                    asks,
                    thread,
                    silent_after,
                    look_every,
                    asked,
                    reported_silent,
                    left_behind,
                });
                self.ask(node);
            }
            Err(error) => {
                let reason = format!("its thread cannot be started: {error}");
                self.run.cell(node).fail_live(reason, self.run);
                self.ask(node);
            }
        }
    }

    fn look_every(&self) -> Option<Duration> {
        self.devices.iter().filter_map(|device| device.look_every).min().map(|every| every.min(TICK))
    }

    /// Looks for wires that are silent for longer than a contract allows.
    fn note_silence(&mut self) {
        let now = self.run.now();
        if self.look_every().is_none_or(|every| now < self.looked + every) {
            return;
        }
        self.looked = now;
        for device in self.devices.iter().filter(|device| device.look_every.is_some() && device.asks.is_some()) {
            self.scheduler.outside(|turn| self.run.cell(device.node).note_silence(self.run, turn));
        }
    }

    fn device(&mut self, node: usize) -> Option<&mut Device> {
        self.devices.iter_mut().find(|device| device.node == node)
    }

    fn answered(&mut self, node: usize, answer: Reply) {
        let _stepping = self.run.stepping(node);
        let Some(device) = self.device(node).filter(|device| device.asks.is_some()) else { return };
        let (asked, was_silent) = (device.asked.take(), std::mem::take(&mut device.reported_silent));
        // The end of a source is no sign of life.
        if let (Some(asked), true, false) = (asked, was_silent, answer.is_end()) {
            let message = format!("it gave something again after {}", seconds(asked.elapsed()));
            self.run.warn(node, answer.item(), vec![message]);
        }
        self.run.cell(node).answered(answer, self.run);
        self.ask(node);
    }

    /// Asks a pending source for its next answer; if that fails, it is no longer pending.
    fn ask(&mut self, node: usize) {
        let request = self.scheduler.outside(|turn| self.run.cell(node).ask(self.run, turn));
        if let NextRequest::Next { item, stamp_ns } = request {
            if let Some(device) = self.device(node) {
                device.asked = Some(Instant::now());
                // A source whose thread has ended has sent its last answer before.
                let _ = device.asks.as_ref().map(|asks| asks.try_send(Ask { item, stamp_ns }));
            }
            return;
        }
        if let (NextRequest::Never, Some(device)) = (request, self.device(node)) {
            device.asks = None;
        }
        self.not_pending();
    }

    fn not_pending(&self) {
        if self.run.no_longer_pending() {
            self.scheduler.recheck();
        }
    }

    fn check_clock(&mut self) {
        self.note_silence();
        if self.run.cancelled() {
            let since = *self.stopped.get_or_insert_with(Instant::now);
            self.stop(since.elapsed() > GRACE);
        }
        for device in &mut self.devices {
            let Some(silent) = device.asked.map(|asked| asked.elapsed()) else { continue };
            if silent >= device.silent_after && !device.reported_silent {
                device.reported_silent = true;
                let message = format!("it has given nothing for {}; is the device connected and on?", seconds(silent));
                let item = self.run.cell(device.node).n_items();
                self.run.warn(device.node, item, vec![message.clone()]);
                let node = self.run.plan.nodes[device.node].name.to_string();
                self.run.event(&Event::Urgent(&Warning { node, item, message }));
            }
        }
    }

    /// Ends the sources that wait for room; with `all`, also those that have not reacted to the stop request.
    fn stop(&mut self, all: bool) {
        for device in &mut self.devices {
            let ends = device.asks.is_some() && (device.asked.is_none() || all);
            if !ends {
                continue;
            }
            let was_pending = device.asked.take().is_some();
            let ended = self.scheduler.outside(|turn| self.run.cell(device.node).interrupt(self.run, turn));
            if !ended {
                // It has failed, and its outputs wait for room to report that.
                continue;
            }
            device.asks = None;
            if was_pending {
                device.left_behind = true;
                let message =
                    format!("it did not notice the wish to stop within {}; the run ends without it", seconds(GRACE));
                self.run.warn(device.node, self.run.cell(device.node).n_items(), vec![message]);
                if self.run.no_longer_pending() {
                    self.scheduler.recheck();
                }
            }
        }
    }

    /// Waits briefly for the sources to be dropped, so that devices are closed in order.
    fn leave(mut self) {
        self.devices.iter_mut().for_each(|device| device.asks = None);
        let until = Instant::now() + GRACE;
        let open = |device: &&Device| !device.left_behind && !device.thread.is_finished();
        while self.devices.iter().any(|device| open(&device)) && Instant::now() < until {
            // Anything else that arrives now is too late.
            let _ = self.run.mailbox.rx.recv_timeout(TICK);
        }
        for device in self.devices.iter().filter(open) {
            let node = &self.run.plan.nodes[device.node].name;
            tracing::warn!("node \"{node}\" does not leave its device; its thread is left behind");
        }
    }
}

/// Thread function of a source.
fn run_source(live: Live, asks: &Receiver<Ask>, answers: &Sender<LiveMessage>) {
    let Live { node, mut source, mut context, n_ports } = live;
    let name = Name::of(context.node());
    for Ask { item, stamp_ns } in asks {
        // The run waits for an answer to each request, so a panic outside of the source's own call is one, too.
        let answer = panics::catch(|| Reply::of(name, &mut *source, &mut context, n_ports, item, stamp_ns))
            .unwrap_or_else(|panic| Reply::of_panic(item, stamp_ns, n_ports, panic));
        if answers.try_send(LiveMessage::Answered(node, answer)).is_err() {
            break;
        }
    }
    discard(name, Doing::Destroying, source);
    let _ = answers.try_send(LiveMessage::Gone);
}

fn seconds(time: Duration) -> String {
    format!("{:.1} s", time.as_secs_f64())
}
