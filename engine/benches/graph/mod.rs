//! Kinds that do next to nothing, and plans made of them: for the benches, and for the test that counts allocations.

use osteoflow_engine::plan::{
    Link, Location, OnError, OutputId, Plan, PlanInput, PlanNode, PlanOutput, Policy, PortFrames, RecordSettings,
};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, OutputPorts, Outputs, ParamError, Part, Payload, Registry, Source,
    Value, View, ViewError, schemars, serde, serde_json,
};
use std::sync::Arc;

/// How many items wait on a wire, as where a graph says nothing.
pub(crate) const CAPACITY: usize = 4;

/// A number.
#[derive(Clone)]
pub(crate) struct Number(pub(crate) f64);

impl Payload<Number> for Number {
    const NAME: &'static str = "bench/Number";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [Part] = &[Part::float("value")];

    fn to_view(&self) -> View {
        View::new().with("value", self.0)
    }

    fn from_view(view: &View) -> Result<Self, ViewError> {
        Ok(Self(view.float("value")?))
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.into()
    }
}

/// A megabyte behind a handle.
#[derive(Clone)]
pub(crate) struct Megabyte(pub(crate) Arc<Vec<u8>>);

impl Megabyte {
    /// One with something in it.
    pub(crate) fn new() -> Self {
        Self(Arc::new((0..1 << 20).map(|i: u32| i as u8).collect()))
    }
}

impl Payload<Megabyte> for Megabyte {
    const NAME: &'static str = "bench/Megabyte";
    const VERSION: u32 = 1;
    const SCHEMA: &'static [Part] = &[Part::float("bytes")];

    fn to_view(&self) -> View {
        View::new().with("bytes", self.0.len() as f64)
    }

    fn from_view(_: &View) -> Result<Self, ViewError> {
        Ok(Self::new())
    }

    fn to_result(&self) -> serde_json::Value {
        self.0.len().into()
    }

    fn n_bytes(&self) -> usize {
        self.0.len()
    }
}

/// How many items a source gives.
#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct Items {
    items: u64,
}

/// How long a firing computes.
#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
pub(crate) struct Spin {
    spin_us: u64,
}

/// Counts up.
#[derive(Describe)]
pub(crate) struct Count(u64, u64);

/// A number.
#[derive(Outputs)]
pub(crate) struct NumberOut {
    /// The number.
    out: Number,
}

impl Source for Count {
    const KIND: &'static str = "bench.count";
    type Params = Items;
    type Outputs = NumberOut;

    fn new(params: Items) -> Result<Self, ParamError> {
        Ok(Self(0, params.items))
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<NumberOut>, NodeError> {
        self.0 += 1;
        ctx.set_stamp_ns(self.0 as i64);
        Ok((self.0 <= self.1).then_some(NumberOut { out: Number(self.0 as f64) }))
    }
}

/// Gives the same megabyte again and again: a handle on it, made once.
#[derive(Describe)]
pub(crate) struct Frames(u64, u64, Value);

/// Whatever it is.
#[derive(Outputs)]
pub(crate) struct AnyOut {
    /// A value.
    out: Value,
}

impl Source for Frames {
    const KIND: &'static str = "bench.frames";
    type Params = Items;
    type Outputs = AnyOut;

    fn new(params: Items) -> Result<Self, ParamError> {
        Ok(Self(0, params.items, Value::new(Megabyte::new())))
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<AnyOut>, NodeError> {
        self.0 += 1;
        ctx.set_stamp_ns(self.0 as i64);
        Ok((self.0 <= self.1).then(|| AnyOut { out: self.2.clone() }))
    }
}

/// Computes for so long.
pub(crate) fn spin(us: u64) {
    if us > 0 {
        let began = std::time::Instant::now();
        while began.elapsed().as_micros() < us.into() {
            std::hint::spin_loop();
        }
    }
}

/// Hands on the value it gets.
#[derive(Describe)]
pub(crate) struct Relay(Spin);

/// Whatever it is.
#[derive(Inputs)]
pub(crate) struct AnyIn {
    /// A value.
    value: Value,
}

impl Node for Relay {
    const KIND: &'static str = "bench.relay";
    type Params = Spin;
    type Inputs = AnyIn;
    type Outputs = AnyOut;

    fn new(params: Spin) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, i: AnyIn, _: &mut Context) -> Result<AnyOut, NodeError> {
        spin(self.0.spin_us);
        Ok(AnyOut { out: i.value })
    }
}

/// Takes a megabyte and hands on the very same.
#[derive(Describe)]
pub(crate) struct Look;

/// A megabyte.
#[derive(Inputs)]
pub(crate) struct MegabyteIn {
    /// The megabyte.
    megabyte: Megabyte,
}

/// The megabyte.
#[derive(Outputs)]
pub(crate) struct MegabyteOut {
    /// The megabyte.
    out: Megabyte,
}

impl Node for Look {
    const KIND: &'static str = "bench.look";
    type Params = Spin;
    type Inputs = MegabyteIn;
    type Outputs = MegabyteOut;

    fn new(_: Spin) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: MegabyteIn, _: &mut Context) -> Result<MegabyteOut, NodeError> {
        Ok(MegabyteOut { out: i.megabyte })
    }
}

/// Makes a new number of the one it gets.
#[derive(Describe)]
pub(crate) struct Next;

/// A number.
#[derive(Inputs)]
pub(crate) struct NumberIn {
    /// A number.
    number: Number,
}

impl Node for Next {
    const KIND: &'static str = "bench.next";
    type Params = Spin;
    type Inputs = NumberIn;
    type Outputs = NumberOut;

    fn new(_: Spin) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: NumberIn, _: &mut Context) -> Result<NumberOut, NodeError> {
        Ok(NumberOut { out: Number(i.number.0 + 1.0) })
    }
}

/// All of the kinds.
pub(crate) fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Number, _>().payload::<Megabyte, _>();
    registry.source::<Count>().source::<Frames>().node::<Relay>().node::<Next>().node::<Look>();
    registry
}

/// A plan of nodes, each with its kind, its parameters and the node that feeds it.
pub(crate) fn plan(registry: &Registry, nodes: &[(&str, serde_json::Value, Option<usize>)]) -> Plan {
    let location = Location { file: "bench.toml".into(), line: 1, column: 1 };
    let mut links: Vec<Link> = Vec::new();
    let mut planned: Vec<PlanNode> = Vec::new();
    for (index, (kind, params, from)) in nodes.iter().enumerate() {
        let description = &registry.kind(kind).expect("the kind is registered").description;
        let OutputPorts::Fixed(outputs) = &description.outputs else { unreachable!("the ports are fixed") };
        let link = from.map(|from| {
            let link = links.len();
            planned[from].outputs[0].links.push(link);
            links.push(Link {
                from: OutputId { node: from, port: 0 },
                to_node: index,
                to_port: 0,
                capacity: CAPACITY,
                max_bytes: 1 << 30,
                policy: Policy::Block,
            });
            link
        });
        let inputs = description.inputs.iter().map(|port| PlanInput { port: port.clone(), link });
        let outputs = outputs.iter().map(|port| PlanOutput {
            name: port.name.into(),
            payload: port.payload,
            frames: PortFrames::default(),
            links: Vec::new(),
        });
        planned.push(PlanNode {
            name: Arc::from(format!("n{index}")),
            kind: (*kind).into(),
            role: description.role,
            location: location.clone(),
            plugin: None,
            params: params.clone(),
            files: Vec::new(),
            declared: Arc::from([]),
            inputs: inputs.collect(),
            outputs: outputs.collect(),
            on_error: OnError::Stop,
        });
    }
    Plan {
        name: "bench".into(),
        seed: 1,
        path: "bench.toml".into(),
        nodes: planned,
        links,
        record: Vec::new(),
        results: Vec::new(),
        input_files: Vec::new(),
        plugins: Vec::new(),
        resolved: String::new(),
        recording: RecordSettings::default(),
    }
}

/// A source of so many items and so many nodes in a row.
pub(crate) fn chain(registry: &Registry, source: &str, n_items: u64, node: &str, n_nodes: usize, spin_us: u64) -> Plan {
    let mut nodes = vec![(source, serde_json::json!({ "items": n_items }), None)];
    nodes.extend((0..n_nodes).map(|index| (node, serde_json::json!({ "spin_us": spin_us }), Some(index))));
    plan(registry, &nodes)
}
