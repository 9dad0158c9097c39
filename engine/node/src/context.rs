use crate::{Budget, CachePolicy, ClockReading, DeclaredPort, Empty, StampNs, clock::Readings, host::Host};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde::{Deserialize, Serialize};
use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// What a node may know of the run beside its inputs: stamp, item number, a seeded generator, and whether to stop.
///
/// All random numbers and times come from here, so that a run is a function of graph, inputs and seed.
pub struct Context {
    node: Arc<str>,
    seed: u64,
    cancelled: Arc<AtomicBool>,
    declared: Arc<[DeclaredPort]>,
    out_dir: Option<Arc<std::path::Path>>,
    stamp_ns: StampNs,
    item: u64,
    absent: Vec<(&'static str, Arc<Empty>)>,
    warnings: Vec<String>,
    readings: Readings,
    used: Used,
    /// Whether this firing was answered that the user asked to stop: what it gives depends on when that was.
    saw_stop: AtomicBool,
    /// In a plugin, during a firing: the program, which answers instead of the fields above.
    host: Option<Host>,
}

/// What a firing used of its context, apart from clock readings. Atomic, because threads of the node share the context.
#[derive(Default)]
struct Used {
    /// The generator, or a value that seeds it.
    generator: AtomicBool,
    /// Stamp or output folder.
    other: AtomicBool,
}

/// What a firing in another process needs of its context.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct FiringSent {
    /// The number of the firing.
    pub item: u64,
    /// Its stamp.
    pub stamp_ns: StampNs,
    /// In a replay: the recorded clock readings.
    pub recorded: Option<Vec<ClockReading>>,
    /// The folder for files that nodes write.
    pub out_dir: Option<PathBuf>,
    /// The optional ports that got nothing, and why.
    pub absent: Vec<(String, Empty)>,
}

/// What a firing in another process did with its context.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct FiringDone {
    /// The stamp that a source set.
    pub stamp_ns: StampNs,
    /// Its clock readings.
    pub readings: Vec<ClockReading>,
    /// Its warnings.
    pub warnings: Vec<String>,
    /// Whether it used the generator, or a value that seeds it.
    pub used_generator: bool,
    /// Whether it used the stamp or the folder.
    pub used_other: bool,
}

impl Context {
    /// For the engine: what a firing in another process needs.
    pub fn sent(&self) -> FiringSent {
        FiringSent {
            item: self.item,
            stamp_ns: self.stamp_ns,
            recorded: self.readings.recorded(),
            out_dir: self.out_dir.as_deref().map(Into::into),
            absent: self.absent.iter().map(|(port, empty)| ((*port).into(), (**empty).clone())).collect(),
        }
    }

    /// For the engine, in the other process: begins the firing. `inputs` are the names of the ports.
    pub fn receive(&mut self, sent: FiringSent, inputs: &[&'static str]) {
        self.begin(sent.item, sent.stamp_ns);
        self.track_use();
        self.out_dir = sent.out_dir.map(Into::into);
        if let Some(recorded) = &sent.recorded {
            self.replay_readings(recorded);
        }
        for (port, empty) in sent.absent {
            if let Some(port) = inputs.iter().find(|name| **name == port) {
                self.note_absent(port, Arc::new(empty));
            }
        }
    }

    /// For the engine, in the other process: what the firing did.
    pub fn done(&mut self) -> FiringDone {
        FiringDone {
            stamp_ns: self.stamp_ns,
            readings: self.take_readings(),
            warnings: self.take_warnings(),
            used_generator: self.used.generator.load(Ordering::Relaxed),
            used_other: self.used.other.load(Ordering::Relaxed),
        }
    }

    /// For the engine: takes over what the firing did in another process.
    pub fn take_over(&mut self, done: FiringDone) {
        self.stamp_ns = done.stamp_ns;
        self.readings.add(done.readings);
        self.warnings.extend(done.warnings);
        self.used.generator.fetch_or(done.used_generator, Ordering::Relaxed);
        self.used.other.fetch_or(done.used_other, Ordering::Relaxed);
    }

    /// A context for the node with this full name; for the engine and for tests.
    pub fn new(
        node: impl Into<Arc<str>>,
        seed: u64,
        cancelled: Arc<AtomicBool>,
        declared: Arc<[DeclaredPort]>,
    ) -> Self {
        Self {
            node: node.into(),
            seed,
            cancelled,
            declared,
            out_dir: None,
            stamp_ns: 0,
            item: 0,
            absent: Vec::new(),
            warnings: Vec::new(),
            readings: Readings::default(),
            used: Used::default(),
            saw_stop: AtomicBool::new(false),
            host: None,
        }
    }

    /// A context outside any run: seed 0, item 0, stamp 0.
    pub fn for_test(node: &str) -> Self {
        Self::new(node, 0, Arc::default(), Arc::from([]))
    }

    /// In a plugin: the program answers from now on.
    pub(crate) fn enter(&mut self, host: Host) {
        self.host = Some(host);
    }

    /// In a plugin: the firing has ended.
    pub(crate) fn leave(&mut self) {
        self.host = None;
    }

    /// For the engine: the folder for files that nodes write.
    pub fn with_out_dir(mut self, out_dir: Option<Arc<std::path::Path>>) -> Self {
        self.out_dir = out_dir;
        self
    }

    /// For the engine: begins the next firing.
    #[inline]
    pub fn begin(&mut self, item: u64, stamp_ns: StampNs) {
        (self.item, self.stamp_ns) = (item, stamp_ns);
        self.absent.clear();
        self.readings.begin();
        *self.saw_stop.get_mut() = false;
    }

    /// For the engine: whether this firing was answered that the user asked to stop.
    pub fn saw_stop(&self) -> bool {
        self.saw_stop.load(Ordering::Relaxed)
    }

    /// For the engine: in a replay, the recorded clock readings of this firing. Call after [`Context::begin`].
    pub fn replay_readings(&mut self, recorded: &[ClockReading]) {
        self.readings.replay(recorded);
    }

    /// For the engine: whether this firing has read the clock.
    #[inline]
    pub fn has_readings(&self) -> bool {
        self.readings.has_any()
    }

    /// For the engine: the clock readings of this firing.
    pub fn take_readings(&mut self) -> Vec<ClockReading> {
        self.readings.take()
    }

    /// For the engine: begins tracking what the firing uses, for [`Context::is_cacheable`].
    pub fn track_use(&mut self) {
        self.used = Used::default();
    }

    /// For the engine: whether the firing used nothing that is not part of the cache key of `policy`.
    pub fn is_cacheable(&self, policy: CachePolicy) -> bool {
        let Used { generator, other } = &self.used;
        let used_generator = generator.load(Ordering::Relaxed);
        let used_other = other.load(Ordering::Relaxed) || self.readings.has_any();
        match policy {
            CachePolicy::Never => false,
            CachePolicy::ByInputs => !used_generator && !used_other,
            CachePolicy::ByInputsAndSeed => !used_other,
        }
    }

    /// For the engine: an optional port got nothing, for this reason.
    pub fn note_absent(&mut self, port: &'static str, empty: Arc<Empty>) {
        self.absent.push((port, empty));
    }

    /// For the engine: whether there are warnings.
    #[inline]
    pub fn has_warnings(&self) -> bool {
        !self.warnings.is_empty()
    }

    /// For the engine: the warnings so far.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// For the engine: the warnings since the last call.
    pub fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// The node's full name in the graph.
    #[inline]
    pub fn node(&self) -> &str {
        if let Some(host) = &self.host {
            return host.node();
        }
        self.used.generator.store(true, Ordering::Relaxed);
        &self.node
    }

    /// The firing stamp: the largest of the triggering items. A source sets its own.
    #[inline]
    pub fn stamp_ns(&self) -> StampNs {
        if let Some(host) = &self.host {
            return host.stamp_ns();
        }
        self.used.other.store(true, Ordering::Relaxed);
        self.stamp_ns
    }

    /// For a source: sets the stamp of the answer of this `next`; must not decrease.
    #[inline]
    pub fn set_stamp_ns(&mut self, stamp_ns: StampNs) {
        if let Some(host) = &mut self.host {
            return host.set_stamp_ns(stamp_ns);
        }
        self.stamp_ns = stamp_ns;
    }

    /// The number of this firing, from 0.
    #[inline]
    pub fn item(&self) -> u64 {
        if let Some(host) = &self.host {
            return host.item();
        }
        self.used.generator.store(true, Ordering::Relaxed);
        self.item
    }

    /// A random generator seeded by run seed, node name and item number, independent of what ran before.
    pub fn rng(&self) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed());
        rng.set_stream(fnv1a(self.node().as_bytes()));
        // Items are 2^32 words apart, so that their draws do not overlap.
        rng.set_word_pos(u128::from(self.item()) << 32);
        rng
    }

    /// The `index`-th 64-bit draw of [`Context::rng`].
    pub fn random(&self, index: u64) -> u64 {
        use rand_chacha::rand_core::Rng as _;
        let mut rng = self.rng();
        // A word has 32 bits.
        rng.set_word_pos(rng.get_word_pos() + 2 * u128::from(index));
        rng.next_u64()
    }

    /// The run's seed.
    pub fn seed(&self) -> u64 {
        if let Some(host) = &self.host {
            return host.seed();
        }
        self.used.generator.store(true, Ordering::Relaxed);
        self.seed
    }

    /// The time of day, ns since the Unix epoch: recorded with this firing, and answered from the recording in a replay.
    ///
    /// The time of a measurement is the item's stamp; this is for what the node itself does.
    pub fn clock_ns(&mut self) -> StampNs {
        if let Some(host) = &mut self.host {
            return host.clock_ns();
        }
        let (ns, is_missing) = self.readings.clock();
        self.warn_of_clock(is_missing);
        ns
    }

    /// A time budget for this firing: recorded as the number of checks that found time left, and over at the same check in
    /// a replay.
    pub fn budget(&mut self, limit: Duration) -> Budget {
        if let Some(host) = &mut self.host {
            return Budget::of_host(host.budget(limit.as_nanos().try_into().unwrap_or(u64::MAX)));
        }
        let (budget, is_missing) = self.readings.budget(limit);
        self.warn_of_clock(is_missing);
        budget
    }

    fn warn_of_clock(&mut self, is_missing: bool) {
        if is_missing {
            self.warn("this firing reads the clock differently from the recorded one, so it is answered by the clock");
        }
    }

    /// Whether the user asked to stop. A long computation checks this from time to time and returns; what it returns after
    /// the answer `true` is discarded, since it depends on the moment.
    pub fn cancelled(&self) -> bool {
        if let Some(host) = &self.host {
            return host.cancelled();
        }
        let cancelled = self.cancelled.load(Ordering::Relaxed);
        if cancelled {
            self.saw_stop.store(true, Ordering::Relaxed);
        }
        cancelled
    }

    /// For a live source: waits until `then`; `false` if the user asked to stop meanwhile.
    pub fn wait_until(&self, then: Instant) -> bool {
        /// Upper bound on the delay of a stop.
        const POLL: Duration = Duration::from_millis(50);
        while !self.cancelled() {
            match then.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
                Some(left) => std::thread::sleep(left.min(POLL)),
                None => return true,
            }
        }
        false
    }

    /// Why an optional port got nothing at this firing.
    pub fn absent_reason(&self, port: &str) -> Option<&str> {
        if let Some(host) = &self.host {
            return host.absent_reason(port);
        }
        self.absent.iter().find(|(name, _)| *name == port).map(|(_, empty)| empty.reason.as_str())
    }

    /// Warns the user about this item; shown, counted, and written to the manifest.
    pub fn warn(&mut self, message: impl Into<String>) {
        match &mut self.host {
            Some(host) => host.warn(&message.into()),
            None => self.warnings.push(message.into()),
        }
    }

    /// Warns of a sign that an input is wrong, found by the rule of this name, such as `marker_jump`: a warning that ends with the rule in
    /// brackets, which `results.json` lists under `reasons`.
    ///
    /// # Panics
    /// If the rule is not of two or more words of small letters, joined by `_`: it would be taken for a part of the message.
    pub fn sign(&mut self, rule: &'static str, message: impl std::fmt::Display) {
        assert!(is_rule(rule), "the rule \"{rule}\" of a sign is not of two or more words, such as marker_jump");
        self.warn(format!("{message} [{rule}]"));
    }

    /// The folder for files that the node writes; `None` if the run has no folder.
    pub fn out_dir(&self) -> Option<&std::path::Path> {
        if let Some(host) = &self.host {
            return host.out_dir();
        }
        self.used.other.store(true, Ordering::Relaxed);
        self.out_dir.as_deref()
    }

    /// The output ports that the graph declares by `out`, in the order of the graph.
    pub fn declared(&self) -> Arc<[DeclaredPort]> {
        self.declared.clone()
    }
}

/// FNV-1a: stable across machines and versions, unlike the hash of the standard library.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3))
}

/// A warning that is a sign, as [`Context::sign`] writes it: its message and its rule.
pub fn sign(warning: &str) -> Option<(&str, &str)> {
    let (message, rule) = warning.strip_suffix(']')?.rsplit_once(" [")?;
    is_rule(rule).then_some((message, rule))
}

/// Whether it is two or more words, which no unit and no name of a table in brackets is.
fn is_rule(rule: &str) -> bool {
    let is_word = |word: &str| !word.is_empty() && word.bytes().all(|c| c.is_ascii_lowercase());
    rule.contains('_') && rule.split('_').all(is_word)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    fn draws(seed: u64, node: &str, item: u64) -> Vec<u64> {
        let mut ctx = Context::new(node, seed, Arc::default(), Arc::from([]));
        ctx.begin(item, 0);
        let mut rng = ctx.rng();
        (0..4).map(|_| rng.random()).collect()
    }

    #[test]
    fn draws_depend_on_seed_node_and_item_and_on_nothing_else() {
        assert_eq!(draws(7, "scan", 3), draws(7, "scan", 3));
        let others = [draws(8, "scan", 3), draws(7, "hole", 3), draws(7, "scan", 4)];
        assert!(others.iter().all(|other| *other != draws(7, "scan", 3)));
    }
}
