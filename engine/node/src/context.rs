use crate::{
    Budget, DeclaredPort, Empty, Kept, Reading, StampNs,
    plugin::Host,
    reading::{NotRecorded, Readings},
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// What a node may know of the run beside its inputs: its stamp, its item number, a seeded generator, and whether to stop.
///
/// Everything random or timed enters through here, so that a run is a function of graph, inputs and seed.
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
    asked: Asked,
    /// In a plugin, during a firing: the program, which answers in the place of what stands here.
    host: Option<Host>,
}

/// What a firing took from its context, apart from readings of the clock. Set through a shared context, also by threads
/// of the node.
#[derive(Default)]
struct Asked {
    /// The generator, or what it is seeded by.
    generator: AtomicBool,
    /// Stamp or folder.
    rest: AtomicBool,
}

impl Context {
    /// A context of the node with this full name, for the engine and for tests.
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
            asked: Asked::default(),
            host: None,
        }
    }

    /// A context outside any run: seed 0, item 0, stamp 0.
    pub fn for_test(node: &str) -> Self {
        Self::new(node, 0, Arc::default(), Arc::from([]))
    }

    /// The plugin's: the program answers from here on.
    pub(crate) fn enter(&mut self, host: Host) {
        self.host = Some(host);
    }

    /// The plugin's: the firing is over.
    pub(crate) fn leave(&mut self) {
        self.host = None;
    }

    /// The engine's: nodes that write files write them into this folder.
    pub fn with_out_dir(mut self, out_dir: Option<Arc<std::path::Path>>) -> Self {
        self.out_dir = out_dir;
        self
    }

    /// The engine's: the next firing begins.
    #[inline]
    pub fn begin(&mut self, item: u64, stamp_ns: StampNs) {
        (self.item, self.stamp_ns) = (item, stamp_ns);
        self.absent.clear();
        self.readings.begin();
    }

    /// The engine's: in a replay, what the record holds of this firing's readings of the clock; after [`Context::begin`].
    pub fn give_readings(&mut self, recorded: &[Reading]) {
        self.readings.give(recorded);
    }

    /// The engine's: whether this firing took anything from the clock.
    #[inline]
    pub fn has_readings(&self) -> bool {
        self.readings.has_any()
    }

    /// The engine's: what this firing took from the clock.
    pub fn take_readings(&mut self) -> Vec<Reading> {
        self.readings.take()
    }

    /// The engine's: what the firing takes from here on counts for [`Context::is_within`].
    pub fn watch(&mut self) {
        self.asked = Asked::default();
    }

    /// The engine's: whether what this firing took decides nothing that `kept` leaves out.
    pub fn is_within(&self, kept: Kept) -> bool {
        let Asked { generator, rest } = &self.asked;
        let drew = generator.load(Ordering::Relaxed);
        let took_more = rest.load(Ordering::Relaxed) || self.readings.has_any();
        match kept {
            Kept::No => false,
            Kept::ByInputs => !drew && !took_more,
            Kept::ByInputsAndSeed => !took_more,
        }
    }

    /// The engine's: an optional port got nothing, for this reason.
    pub fn note_absent(&mut self, port: &'static str, empty: Arc<Empty>) {
        self.absent.push((port, empty));
    }

    /// The engine's: whether [`Context::take_warnings`] has any.
    #[inline]
    pub fn has_warnings(&self) -> bool {
        !self.warnings.is_empty()
    }

    /// The engine's: the warnings that [`Context::take_warnings`] would give.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The engine's: the warnings since the last call.
    pub fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// The node's full name in the graph.
    #[inline]
    pub fn node(&self) -> &str {
        if let Some(host) = &self.host {
            return host.node();
        }
        self.asked.generator.store(true, Ordering::Relaxed);
        &self.node
    }

    /// The firing stamp: the largest among the triggering items'. A source sets its own.
    #[inline]
    pub fn stamp_ns(&self) -> StampNs {
        if let Some(host) = &self.host {
            return host.stamp_ns();
        }
        self.asked.rest.store(true, Ordering::Relaxed);
        self.stamp_ns
    }

    /// For a source: the stamp of what this call of `next` answers; must not decrease.
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
        self.asked.generator.store(true, Ordering::Relaxed);
        self.item
    }

    /// A generator of its own for this run's seed, this node and this item: the same draws whatever ran before.
    pub fn rng(&self) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed());
        rng.set_stream(fnv1a(self.node().as_bytes()));
        // Items lie 2^32 words apart, so that no draw of one is a draw of the next.
        rng.set_word_pos(u128::from(self.item()) << 32);
        rng
    }

    /// The `index`-th 64 bits that [`Context::rng`] would draw.
    pub fn random(&self, index: u64) -> u64 {
        use rand_chacha::rand_core::Rng as _;
        let mut rng = self.rng();
        // Words are of 32 bits.
        rng.set_word_pos(rng.get_word_pos() + 2 * u128::from(index));
        rng.next_u64()
    }

    /// The run's seed.
    pub fn seed(&self) -> u64 {
        if let Some(host) = &self.host {
            return host.seed();
        }
        self.asked.generator.store(true, Ordering::Relaxed);
        self.seed
    }

    /// The time of day, ns since the Unix epoch: recorded with this firing, and answered from the record in a replay.
    ///
    /// When something was measured is the item's stamp; this is for what a node itself does at a time.
    pub fn clock_ns(&mut self) -> StampNs {
        if let Some(host) = &mut self.host {
            return host.clock_ns();
        }
        let (ns, missing) = self.readings.clock();
        self.warn_of(missing);
        ns
    }

    /// A budget of time for this firing: recorded as the number of looks that found time left, and in a replay over at the
    /// same look.
    pub fn budget(&mut self, limit: Duration) -> Budget {
        if let Some(host) = &mut self.host {
            return Budget::of_host(host.budget(limit.as_nanos().try_into().unwrap_or(u64::MAX)));
        }
        let (budget, missing) = self.readings.budget(limit);
        self.warn_of(missing);
        budget
    }

    fn warn_of(&mut self, missing: Option<NotRecorded>) {
        if missing.is_some() {
            self.warn(
                "this firing asks the clock otherwise than the recorded one did, so that it is answered by the clock",
            );
        }
    }

    /// Whether the user asked to stop; a long computation looks now and then and returns an error.
    pub fn cancelled(&self) -> bool {
        if let Some(host) = &self.host {
            return host.cancelled();
        }
        self.cancelled.load(Ordering::Relaxed)
    }

    /// For a live source: waits until then; `false` if the user asked to stop meanwhile.
    pub fn wait_until(&self, then: Instant) -> bool {
        /// Short enough for someone who waits for the run to stop.
        const LOOK: Duration = Duration::from_millis(50);
        while !self.cancelled() {
            match then.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
                Some(left) => std::thread::sleep(left.min(LOOK)),
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

    /// Says something the user should know about this item; shown, counted, and kept in the manifest.
    pub fn warn(&mut self, message: impl Into<String>) {
        match &mut self.host {
            Some(host) => host.warn(&message.into()),
            None => self.warnings.push(message.into()),
        }
    }

    /// The folder of this run, where a node that writes files puts them; `None` where the run leaves nothing.
    pub fn out_dir(&self) -> Option<&std::path::Path> {
        if let Some(host) = &self.host {
            return host.out_dir();
        }
        self.asked.rest.store(true, Ordering::Relaxed);
        self.out_dir.as_deref()
    }

    /// The output ports that the graph declared for this source by `out`, in the graph's order.
    pub fn declared(&self) -> Arc<[DeclaredPort]> {
        self.declared.clone()
    }
}

/// Fowler, Noll and Vo's hash: the same on every machine and in every version, unlike the standard library's.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3))
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
