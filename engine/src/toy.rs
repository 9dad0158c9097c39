//! Payloads, nodes and plans of a few lines, for the tests of the running half.
#![allow(clippy::unwrap_used)]

use crate::plan::{Link, Location, OnError, OutputId, Plan, PlanInput, PlanNode, PlanOutput, Policy, ResultEntry};
use osteoflow_node::{
    Column, ColumnType, Context, Declared, Describe, Emission, Emit, Inputs, Join, Node, NodeError, OutputPorts,
    Outputs, ParamError, Payload, PortPayload, Registry, SchemaEntry, Source, View, ViewError, schemars, serde,
    serde_json::{self, Value as Json},
};
use std::{
    collections::BTreeMap,
    sync::{Arc, Condvar, Mutex},
    time::{Duration, Instant},
};

/// A number.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Number(pub(crate) f64);

impl Payload<Number> for Number {
    const NAME: &'static str = "toy/Number";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [SchemaEntry] = &[SchemaEntry::float("value")];
    const INTERPOLATES: bool = true;

    fn to_view(&self) -> View {
        View::new().with("value", self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.float("value")?))
    }

    fn to_result(&self) -> Json {
        self.0.into()
    }

    fn interpolate(a: &Self, b: &Self, s: f64) -> Option<Self> {
        Some(Self(a.0 + s * (b.0 - a.0)))
    }

    fn display() -> Option<osteoflow_node::Display> {
        Some(osteoflow_node::Display {
            schema_name: "toy.Number".into(),
            schema_encoding: "jsonschema".into(),
            schema_data: b"{}".to_vec(),
            message_encoding: "json".into(),
        })
    }

    fn to_display(&self, stamp_ns: i64) -> Option<Vec<u8>> {
        Some(format!("{{\"value\": {}, \"stamp_ns\": {stamp_ns}}}", self.0).into_bytes())
    }
}

/// Samples with a label.
#[derive(Debug, Clone)]
pub(crate) struct Wave {
    pub(crate) label: String,
    pub(crate) samples: Vec<f64>,
}

impl Payload<Wave> for Wave {
    const NAME: &'static str = "toy/Wave";
    const VERSION: u32 = 2;
    const SCHEMA: &'static [SchemaEntry] =
        &[SchemaEntry::text("label"), SchemaEntry::column("samples", ColumnType::F64, 1)];

    fn to_view(&self) -> View {
        let bytes: Vec<u8> = self.samples.iter().flat_map(|s| s.to_ne_bytes()).collect();
        View::new().with("label", self.label.as_str()).with_column(Column::new(
            "samples",
            ColumnType::F64,
            1,
            Arc::new(bytes),
        ))
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self { label: view.text("label")?.into(), samples: view.column("samples")?.rows_of::<f64>()?.into_owned() })
    }

    fn to_result(&self) -> Json {
        self.samples.len().into()
    }
}

/// Answers what its script says, one entry for each call: ports that are not named stay silent.
#[derive(Describe)]
pub(crate) struct Script {
    calls: std::vec::IntoIter<Call>,
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct ScriptParams {
    calls: Vec<Call>,
}

/// The same, live: with a delay that it promises between its ports, and what a device does beside answering.
#[derive(Describe)]
pub(crate) struct LiveScript {
    script: Script,
    max_delay_ns: i64,
    silent_after_ms: u64,
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct LiveParams {
    calls: Vec<Call>,
    #[serde(default)]
    max_delay_ns: i64,
    #[serde(default = "hour")]
    silent_after_ms: u64,
}

fn hour() -> u64 {
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

const HOUR: Duration = Duration::from_secs(3600);

/// Holds a node until a test opens it.
#[derive(Clone, Default)]
pub(crate) struct Gate(Arc<(Mutex<bool>, Condvar)>);

impl Gate {
    /// The gate of that name; tests run side by side, so that each takes names of its own.
    pub(crate) fn of(name: &str) -> Self {
        static GATES: Mutex<BTreeMap<String, Gate>> = Mutex::new(BTreeMap::new());
        GATES.lock().unwrap().entry(name.into()).or_default().clone()
    }

    pub(crate) fn open(&self) {
        *self.0.0.lock().unwrap() = true;
        self.0.1.notify_all();
    }

    fn pass(&self, ctx: &Context) {
        let mut open = self.0.0.lock().unwrap();
        while !*open && !ctx.cancelled() {
            open = self.0.1.wait_timeout(open, Duration::from_millis(10)).unwrap().0;
        }
    }
}

/// A call's stamp and what it gives on ports: a number, or null for an empty.
#[derive(Clone, serde::Deserialize, schemars::JsonSchema)]
#[serde(crate = "serde")]
#[schemars(crate = "schemars")]
struct Call {
    stamp_ns: i64,
    give: Vec<(usize, Option<f64>)>,
    #[serde(default)]
    fail: Option<String>,
    /// `waits ..` or `deaf ..` to the wish to stop, either opens the gate `in ..`; `panics`; or the name of a gate to pass.
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
        if let Some(message) = call.fail {
            return Err(NodeError::new(message));
        }
        let emission = |give: Option<f64>| give.map_or(Emission::Empty("lost".into()), |x| Emission::value(Number(x)));
        let mut give = call.give.into_iter();
        let Some((port, first)) = give.next() else { return Err(NodeError::new("the script gives nothing")) };
        Ok(Some(give.fold(Declared::one(port, emission(first)), |out, (port, next)| out.and(port, emission(next)))))
    }
}

/// Adds two numbers; refuses 13, panics at 666.
#[derive(Describe)]
pub(crate) struct Add;

#[derive(Inputs)]
pub(crate) struct AddIn {
    /// The first.
    a: Number,
    /// The second.
    b: Option<Number>,
}

#[derive(Outputs)]
pub(crate) struct NumberOut {
    /// The answer.
    out: Number,
}

#[derive(serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct AddParams {
    /// Answers with noise from the context's generator added.
    noise: bool,
    /// Refused at build.
    bad: bool,
    /// How long a firing takes.
    sleep_us: u64,
    /// The gate that each firing passes.
    gate: Option<String>,
    /// Adds the time of day, and 1024 times how often it found time left in a budget of so many microseconds.
    budget_us: Option<u64>,
    /// After so many looks it does without.
    most_looks: u64,
}

#[allow(clippy::derivable_impls)]
impl Default for AddParams {
    fn default() -> Self {
        Self { noise: false, bad: false, sleep_us: 0, gate: None, budget_us: None, most_looks: u64::MAX }
    }
}

pub(crate) struct Adder(AddParams);

impl Describe for Adder {
    const DOC: &'static str = Add::DOC;
    const EXAMPLE: &'static str = "";
    const LITERATURE: &'static [&'static str] = &[];
}

impl Node for Adder {
    const KIND: &'static str = "toy.add";
    type Params = AddParams;
    type Inputs = AddIn;
    type Outputs = NumberOut;

    fn new(params: AddParams) -> Result<Self, ParamError> {
        match params.bad {
            true => Err(ParamError::new("bad", "expected false, found true")),
            false => Ok(Self(params)),
        }
    }

    fn process(&mut self, i: AddIn, ctx: &mut Context) -> Result<NumberOut, NodeError> {
        use osteoflow_node::rand::RngExt;
        if self.0.sleep_us > 0 {
            std::thread::sleep(std::time::Duration::from_micros(self.0.sleep_us));
        }
        if let Some(gate) = &self.0.gate {
            Gate::of(gate).pass(ctx);
        }
        if i.a.0 == 13.0 {
            return Err(NodeError::new("13 is not a number to add to"));
        }
        assert!(i.a.0 != 666.0, "the beast of item {}", ctx.item());
        if i.b.is_none() && ctx.absent_reason("b").is_none() {
            return Err(NodeError::new("input b is absent without a reason"));
        }
        if i.a.0 == 99.0 {
            ctx.warn("99 is nearly 100");
        }
        let mut from_clock = 0.0;
        if let Some(us) = self.0.budget_us {
            let mut budget = ctx.budget(Duration::from_micros(us));
            let n_looks = (0..self.0.most_looks).take_while(|_| !budget.is_over()).count();
            from_clock = ctx.clock_ns() as f64 + n_looks as f64 * 1024.0;
        }
        let noise: f64 = if self.0.noise { ctx.rng().random() } else { 0.0 };
        Ok(NumberOut { out: Number(i.a.0 + i.b.map_or(0.0, |b| b.0) + noise + from_clock) })
    }
}

/// Sums what it collects.
#[derive(Describe)]
pub(crate) struct Sum;

#[derive(Inputs)]
pub(crate) struct SumIn {
    /// What to sum.
    all: Vec<Number>,
}

#[derive(Outputs)]
pub(crate) struct SumOut {
    /// The sum, if it is positive.
    out: Emit<Number>,
}

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct NoParams {}

impl Node for Sum {
    const KIND: &'static str = "toy.sum";
    type Params = NoParams;
    type Inputs = SumIn;
    type Outputs = SumOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: SumIn, _: &mut Context) -> Result<SumOut, NodeError> {
        let sum: f64 = i.all.iter().map(|n| n.0).sum();
        Ok(SumOut { out: if sum > 0.0 { Number(sum).into() } else { Emit::Empty("the sum is not positive".into()) } })
    }
}

/// Sums what there is of what it collects.
#[derive(Describe)]
pub(crate) struct SumOfSome;

#[derive(Inputs)]
pub(crate) struct SomeIn {
    /// What to sum.
    all: Vec<Option<Number>>,
}

impl Node for SumOfSome {
    const KIND: &'static str = "toy.some";
    type Params = NoParams;
    type Inputs = SomeIn;
    type Outputs = NumberOut;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: SomeIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.all.iter().flatten().map(|n| n.0).sum()) })
    }
}

/// Doubles; its answers are decided by its inputs, so it says. Refuses 13, panics at 666.
#[derive(Describe)]
pub(crate) struct Kept(KeptParams);

/// The same, with its seed.
#[derive(Describe)]
pub(crate) struct KeptWithSeed(KeptParams);

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct KeptParams {
    /// What counts its firings.
    counter: String,
    /// What it takes from its context: `draws`, `stamp`, `clock`.
    takes: Option<String>,
}

#[derive(Outputs)]
pub(crate) struct KeptOut {
    /// The double.
    out: Number,
    /// The same, if it is positive.
    positive: Emit<Number>,
}

impl KeptParams {
    fn answer(&self, i: &AddIn, ctx: &mut Context) -> Result<KeptOut, NodeError> {
        use osteoflow_node::rand::RngExt;
        *locked_counts().entry(self.counter.clone()).or_default() += 1;
        if i.a.0 == 13.0 {
            return Err(NodeError::new("13 is not a number to double"));
        }
        assert!(i.a.0 != 666.0, "the beast");
        if i.a.0 == 99.0 {
            ctx.warn("99 is nearly 100");
        }
        let taken = match self.takes.as_deref() {
            Some("draws") => ctx.rng().random(),
            Some("stamp") => ctx.stamp_ns() as f64,
            Some("clock") => ctx.clock_ns() as f64,
            _ => 0.0,
        };
        let out = Number(2.0 * i.a.0 + i.b.as_ref().map_or(0.0, |b| b.0) + taken);
        let positive = if out.0 > 0.0 { out.clone().into() } else { Emit::Empty("it is not positive".into()) };
        Ok(KeptOut { out, positive })
    }
}

fn locked_counts() -> std::sync::MutexGuard<'static, BTreeMap<String, u64>> {
    static COUNTS: Mutex<BTreeMap<String, u64>> = Mutex::new(BTreeMap::new());
    COUNTS.lock().unwrap()
}

/// How often nodes with this counter have fired; tests run side by side, so that each takes names of its own.
pub(crate) fn n_fired(counter: &str) -> u64 {
    locked_counts().get(counter).copied().unwrap_or(0)
}

impl Node for Kept {
    const KIND: &'static str = "toy.kept";
    const CACHE: osteoflow_node::CachePolicy = osteoflow_node::CachePolicy::ByInputs;
    type Params = KeptParams;
    type Inputs = AddIn;
    type Outputs = KeptOut;

    fn new(params: KeptParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, i: AddIn, ctx: &mut Context) -> Result<KeptOut, NodeError> {
        self.0.answer(&i, ctx)
    }
}

impl Node for KeptWithSeed {
    const KIND: &'static str = "toy.kept_with_seed";
    const CACHE: osteoflow_node::CachePolicy = osteoflow_node::CachePolicy::ByInputsAndSeed;
    type Params = KeptParams;
    type Inputs = AddIn;
    type Outputs = KeptOut;

    fn new(params: KeptParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, i: AddIn, ctx: &mut Context) -> Result<KeptOut, NodeError> {
        self.0.answer(&i, ctx)
    }
}

pub(crate) fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Number, _>().payload::<Wave, _>().node::<Kept>().node::<KeptWithSeed>();
    registry.source::<Script>().source::<LiveScript>().node::<Adder>().node::<Sum>().node::<SumOfSome>();
    registry
}

/// A plan in the making.
pub(crate) struct Toy {
    plan: Plan,
}

impl Toy {
    pub(crate) fn new() -> Self {
        Self {
            plan: Plan {
                name: "toy".into(),
                seed: 7,
                path: "toy.toml".into(),
                nodes: Vec::new(),
                links: Vec::new(),
                record: Vec::new(),
                recording: Default::default(),
                results: Vec::new(),
                input_files: Vec::new(),
                plugins: Vec::new(),
                resolved: "[graph]\nname = \"toy\"\n".into(),
            },
        }
    }

    /// A script with ports `p0`, `p1` ...
    pub(crate) fn script(self, name: &str, n_ports: usize, calls: Json) -> Self {
        self.source(name, Script::KIND, n_ports, serde_json::json!({ "calls": calls }))
    }

    /// A source whose ports `p0`, `p1` ... the graph declares.
    pub(crate) fn source(mut self, name: &str, kind: &str, n_ports: usize, params: Json) -> Self {
        let ty = registry().payload_type(Number::NAME).unwrap();
        let ports = (0..n_ports).map(|i| format!("p{i}"));
        let declared =
            ports.clone().map(|name| osteoflow_node::DeclaredPort { name, payload: ty, params: serde_json::json!({}) });
        let outputs = ports.map(|name| PlanOutput {
            name,
            payload: PortPayload::Type(ty),
            frames: Default::default(),
            links: Vec::new(),
        });
        let (declared, outputs) = (declared.collect(), outputs.collect());
        self.push(name, kind, params, declared, outputs, Vec::new());
        self
    }

    /// A node; inputs are `port = "from.port"`, with a join of its own or the kind's.
    pub(crate) fn node(mut self, name: &str, kind: &str, params: Json, inputs: &[(&str, &str, Option<Join>)]) -> Self {
        let registry = registry();
        let description = &registry.kind(kind).unwrap().description;
        let OutputPorts::Fixed(ports) = &description.outputs else { panic!("{kind} declares its ports") };
        let outputs = ports.iter().map(|p| PlanOutput {
            name: p.name.into(),
            payload: p.payload,
            frames: Default::default(),
            links: Vec::new(),
        });
        let (outputs, to_node) = (outputs.collect(), self.plan.nodes.len());
        let mut plan_inputs = Vec::new();
        for (to_port, port) in description.inputs.iter().enumerate() {
            let mut port = port.clone();
            let wired = inputs.iter().find(|(name, ..)| *name == port.name);
            let link = wired.map(|(_, from, join)| {
                port.join = join.unwrap_or(port.join);
                let from = self.wire(from);
                let link = self.plan.links.len();
                self.plan.nodes[from.node].outputs[from.port].links.push(link);
                let policy = Policy::Block;
                self.plan.links.push(Link { from, to_node, to_port, capacity: 4, max_bytes: 1 << 20, policy });
                link
            });
            plan_inputs.push(PlanInput { port, link });
        }
        self.push(name, kind, params, Arc::from([]), outputs, plan_inputs);
        self
    }

    fn push(
        &mut self,
        name: &str,
        kind: &str,
        params: Json,
        declared: Arc<[osteoflow_node::DeclaredPort]>,
        outputs: Vec<PlanOutput>,
        inputs: Vec<PlanInput>,
    ) {
        let role = registry().kind(kind).unwrap().description.role;
        let location = Location { file: "toy.toml".into(), line: 10 + self.plan.nodes.len(), column: 1 };
        let (name, kind) = (Arc::from(name), kind.to_owned());
        self.plan.nodes.push(PlanNode {
            name,
            kind,
            role,
            location,
            plugin: None,
            params,
            files: Vec::new(),
            declared,
            inputs,
            outputs,
            on_error: OnError::Stop,
        });
    }

    pub(crate) fn wire(&self, name: &str) -> OutputId {
        let (node, port) = name.split_once('.').unwrap();
        let node = self.plan.nodes.iter().position(|n| &*n.name == node).unwrap();
        let port = self.plan.nodes[node].outputs.iter().position(|o| o.name == port).unwrap();
        OutputId { node, port }
    }

    /// Changes the link into the node's port.
    pub(crate) fn link(mut self, to: &str, change: impl Fn(&mut Link)) -> Self {
        let (node, port) = to.split_once('.').unwrap();
        let node = self.plan.nodes.iter().position(|n| &*n.name == node).unwrap();
        let input = self.plan.nodes[node].inputs.iter().find(|i| i.port.name == port).unwrap();
        change(&mut self.plan.links[input.link.unwrap()]);
        self
    }

    pub(crate) fn skip_errors(mut self, node: &str) -> Self {
        self.plan.nodes.iter_mut().filter(|n| &*n.name == node).for_each(|n| n.on_error = OnError::Skip);
        self
    }

    pub(crate) fn record(mut self, wires: &[&str]) -> Self {
        self.plan.record = wires.iter().map(|w| self.wire(w)).collect();
        self
    }

    pub(crate) fn result(mut self, key: &str, wire: &str, all: bool, optional: bool) -> Self {
        let location = Location { file: "toy.toml".into(), line: 90, column: 1 };
        let from = self.wire(wire);
        self.plan.results.push(ResultEntry { key: key.into(), from, all, optional, location });
        self
    }

    pub(crate) fn plan(self) -> Plan {
        self.plan
    }
}
