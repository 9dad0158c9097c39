//! What a hop costs: an item from one node to the next on one worker and on two, beside the bare channel.

use crossbeam_channel::bounded;
use divan::{Bencher, counter::ItemsCount};
use osteoflow_engine::{
    plan::{
        Link, Location, OnError, OutputId, Plan, PlanInput, PlanNode, PlanOutput, Policy, PortFrames, RecordSettings,
    },
    run::{RunOptions, run},
};
use osteoflow_node::{
    Body, Context, Describe, Inputs, Item, Node, NodeError, OutputPorts, Outputs, ParamError, Payload, Registry,
    Source, Value, View, ViewError, schemars, serde, serde_json,
};
use std::sync::Arc;

const ITEMS: u64 = 20_000;
const HOPS: usize = 8;

fn main() {
    divan::main();
}

/// A number.
#[derive(Clone)]
struct Number(f64);

impl Payload<Number> for Number {
    const NAME: &'static str = "bench/Number";
    const VERSION: u32 = 1;

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

#[derive(Default, serde::Deserialize, schemars::JsonSchema)]
#[serde(default, crate = "serde")]
#[schemars(crate = "schemars")]
struct NoParams {}

/// Counts up.
#[derive(Describe)]
struct Count(u64);

#[derive(Inputs)]
struct In {
    /// A number.
    number: Number,
}

#[derive(Outputs)]
struct Out {
    /// The same number.
    number: Number,
}

impl Source for Count {
    const KIND: &'static str = "bench.count";
    type Params = NoParams;
    type Outputs = Out;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self(0))
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        self.0 += 1;
        ctx.set_stamp_ns(self.0 as i64);
        Ok((self.0 <= ITEMS).then_some(Out { number: Number(self.0 as f64) }))
    }
}

/// Hands on what it gets.
#[derive(Describe)]
struct Relay;

impl Node for Relay {
    const KIND: &'static str = "bench.relay";
    type Params = NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: In, _: &mut Context) -> Result<Out, NodeError> {
        Ok(Out { number: i.number })
    }
}

fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.payload::<Number, _>().source::<Count>().node::<Relay>();
    registry
}

/// A source and so many relays in a row.
fn chain(registry: &Registry, n_relays: usize) -> Plan {
    let location = Location { file: "bench.toml".into(), line: 1, column: 1 };
    let node = |index: usize| {
        let kind = if index == 0 { Count::KIND } else { Relay::KIND };
        let description = &registry.kind(kind).expect("the kind is registered").description;
        let OutputPorts::Fixed(outputs) = &description.outputs else { unreachable!("the ports are fixed") };
        let inputs = description.inputs.iter().map(|port| PlanInput { port: port.clone(), link: Some(index - 1) });
        let outputs = outputs.iter().map(|port| PlanOutput {
            name: port.name.into(),
            payload: port.payload,
            frames: PortFrames::default(),
            links: (index < n_relays).then_some(index).into_iter().collect(),
        });
        PlanNode {
            name: Arc::from(format!("n{index}")),
            kind: kind.into(),
            role: description.role,
            location: location.clone(),
            params: serde_json::json!({}),
            declared: Arc::from([]),
            inputs: inputs.collect(),
            outputs: outputs.collect(),
            on_error: OnError::Stop,
        }
    };
    let link = |index: usize| Link {
        from: OutputId { node: index, port: 0 },
        to_node: index + 1,
        to_port: 0,
        capacity: 4,
        max_bytes: 1 << 20,
        policy: Policy::Block,
    };
    Plan {
        name: "bench".into(),
        seed: 1,
        path: "bench.toml".into(),
        nodes: (0..=n_relays).map(node).collect(),
        links: (0..n_relays).map(link).collect(),
        record: Vec::new(),
        recording: RecordSettings::default(),
        results: Vec::new(),
        input_files: Vec::new(),
        resolved: String::new(),
    }
}

/// Items through nodes; counted per hop.
#[divan::bench(args = [1, 2])]
fn through_nodes(bencher: Bencher<'_, '_>, workers: usize) {
    let registry = registry();
    let plan = chain(&registry, HOPS);
    let options = RunOptions { workers, ..RunOptions::default() };
    bencher
        .counter(ItemsCount::new(ITEMS * HOPS as u64))
        .bench_local(|| run(&plan, &registry, &options, &()).expect("the chain runs"));
}

/// The source alone: what its calls and the run itself cost, to be taken off.
#[divan::bench]
fn no_hop(bencher: Bencher<'_, '_>) {
    let registry = registry();
    let plan = chain(&registry, 0);
    bencher
        .counter(ItemsCount::new(ITEMS))
        .bench_local(|| run(&plan, &registry, &RunOptions::default(), &()).expect("the source runs"));
}

/// The same items through bare channels on one thread.
#[divan::bench]
fn through_channels(bencher: Bencher<'_, '_>) {
    bencher.counter(ItemsCount::new(ITEMS * HOPS as u64)).bench_local(|| {
        let channels: Vec<_> = (0..HOPS).map(|_| bounded::<Item>(4)).collect();
        for number in 0..ITEMS {
            let body = Body::Value(Value::new(Number(number as f64)));
            let mut item = Item { number, stamp_ns: number as i64, body };
            for (tx, rx) in &channels {
                tx.try_send(item).expect("there is room");
                item = rx.try_recv().expect("an item waits");
            }
            divan::black_box(item);
        }
    });
}
