//! Sources that answer what their parameters say.

use crate::Number;
use osteoflow_node::{Context, Declared, Describe, Emission, NodeError, ParamError, Source, schemars, serde};
use std::{
    collections::BTreeMap,
    sync::{Arc, Condvar, Mutex},
    time::{Duration, Instant},
};

/// Answers what its script says, one entry per call. Ports that are not named stay silent.
#[derive(Describe)]
pub struct Script {
    calls: std::vec::IntoIter<Call>,
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub struct ScriptParams {
    calls: Vec<Call>,
}

/// The stamp of a call and its emissions by port: a number, or null for an empty.
#[derive(Clone, serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
struct Call {
    stamp_ns: i64,
    give: Vec<(usize, Option<f64>)>,
    #[serde(default)]
    sign: Option<String>,
    #[serde(default)]
    fail: Option<String>,
    /// `waits ..` until cancelled, `deaf ..` to cancellation (both open the gate `in ..`), `panics`, or the name of a gate
    /// to pass.
    #[serde(default)]
    device: Option<String>,
}

impl Source for Script {
    const KIND: &'static str = "toy.script";
    type Params = ScriptParams;
    type Outputs = Declared<ScriptParams>;

    fn new(params: ScriptParams) -> Result<Self, ParamError> {
        Ok(Self { calls: params.calls.into_iter() })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Declared<ScriptParams>>, NodeError> {
        let Some(call) = self.calls.next() else { return Ok(None) };
        ctx.set_stamp_ns(call.stamp_ns);
        if let Some(message) = call.sign {
            ctx.sign("script_wrong", message);
        }
        if let Some(message) = call.fail {
            return Err(NodeError::new(message));
        }
        let emission = |give: Option<f64>| give.map_or(Emission::Empty("lost".into()), |x| Emission::value(Number(x)));
        let mut give = call.give.into_iter();
        let Some((port, first)) = give.next() else { return Err(NodeError::new("the script gives nothing")) };
        Ok(Some(give.fold(Declared::one(port, emission(first)), |out, (port, next)| out.and(port, emission(next)))))
    }
}

/// A live [`Script`], with a maximum delay between its ports and a scripted device.
#[derive(Describe)]
pub struct LiveScript {
    script: Script,
    max_delay_ns: i64,
    silent_after_ms: u64,
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub struct LiveParams {
    calls: Vec<Call>,
    #[serde(default)]
    max_delay_ns: i64,
    #[serde(default = "hour_ms")]
    silent_after_ms: u64,
}

const HOUR: Duration = Duration::from_secs(3600);

fn hour_ms() -> u64 {
    3_600_000
}

impl Source for LiveScript {
    const KIND: &'static str = "toy.live";
    const LIVE: bool = true;
    type Params = LiveParams;
    type Outputs = Declared<ScriptParams>;

    fn new(params: LiveParams) -> Result<Self, ParamError> {
        let script = Script { calls: params.calls.into_iter() };
        Ok(Self { script, max_delay_ns: params.max_delay_ns, silent_after_ms: params.silent_after_ms })
    }

    fn max_delay_ns(&self) -> i64 {
        self.max_delay_ns
    }

    fn silent_after(&self) -> Duration {
        Duration::from_millis(self.silent_after_ms)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Declared<ScriptParams>>, NodeError> {
        match self.script.calls.as_slice().first().and_then(|call| call.device.as_deref()) {
            Some(name) if name.starts_with("waits") => {
                Gate::of(&format!("in {name}")).open();
                assert!(!ctx.wait_until(Instant::now() + HOUR), "an hour has passed");
                return Ok(None);
            }
            Some(name) if name.starts_with("deaf") => loop {
                Gate::of(&format!("in {name}")).open();
                std::thread::park();
            },
            Some("panics") => panic!("the device is on fire"),
            Some(gate) => Gate::of(gate).pass(ctx),
            None => {}
        }
        self.script.next(ctx)
    }
}

/// Blocks a node until a test opens it.
#[derive(Clone, Default)]
pub struct Gate(Arc<(Mutex<bool>, Condvar)>);

impl Gate {
    /// The gate of that name. Tests run in parallel, so each uses its own names.
    pub fn of(name: &str) -> Self {
        static GATES: Mutex<BTreeMap<String, Gate>> = Mutex::new(BTreeMap::new());
        GATES.lock().unwrap().entry(name.into()).or_default().clone()
    }

    pub fn open(&self) {
        *self.0.0.lock().unwrap() = true;
        self.0.1.notify_all();
    }

    pub(crate) fn pass(&self, ctx: &Context) {
        let mut open = self.0.0.lock().unwrap();
        while !*open && !ctx.cancelled() {
            open = self.0.1.wait_timeout(open, Duration::from_millis(10)).unwrap().0;
        }
    }
}
