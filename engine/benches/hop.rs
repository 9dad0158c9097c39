//! Cost of the engine compared with bare channels of the same capacity. `docs/project/performance.md` explains the figures.

#[allow(dead_code, reason = "the test that counts allocations uses the rest")]
mod graph;

use crossbeam_channel::{Receiver, Sender, bounded};
use divan::{Bencher, counter::ItemsCount};
use graph::{CAPACITY, chain, plan};
use osteoflow_engine::{
    plan::Plan,
    run::{RunOptions, run},
};
use osteoflow_node::{Body, Item, Registry, Value};
use osteoflow_toy::{
    Number,
    stream::{Megabyte, registry, spin},
};
use serde_json::json;

const ITEMS: u64 = 20_000;
const HOPS: usize = 8;

fn main() {
    divan::main();
}

/// Runs the plan repeatedly, counting `n_hops` per item.
fn bench(bencher: Bencher<'_, '_>, registry: &Registry, plan: &Plan, workers: usize, n_items: u64, n_hops: usize) {
    let options = RunOptions { workers, ..RunOptions::default() };
    bencher
        .counter(ItemsCount::new(n_items * n_hops.max(1) as u64))
        .bench_local(|| run(plan, registry, &options, &()).expect("the graph runs"));
}

fn item(number: u64, value: &Value) -> Item {
    Item { number, stamp_ns: number as i64, body: Body::Value(value.clone()) }
}

/// Sends items from the calling thread through `n_hops` threads in a row.
fn through_threads(n_hops: usize, n_items: u64, value: &Value) {
    let (ends, mut rest): (Vec<Sender<Item>>, Vec<Receiver<Item>>) = (0..n_hops).map(|_| bounded(CAPACITY)).unzip();
    let mut senders = ends.into_iter();
    let first = senders.next().expect("there is a hop");
    std::thread::scope(|scope| {
        for rx in rest.drain(..) {
            let tx = senders.next();
            scope.spawn(move || {
                for item in rx {
                    match &tx {
                        Some(tx) => tx.send(item).expect("the next thread receives it"),
                        None => drop(divan::black_box(item)),
                    }
                }
            });
        }
        (0..n_items).for_each(|number| first.send(item(number, value)).expect("the first thread receives it"));
        drop(first);
    });
}

/// Sends items through `n_hops` bare channels on one thread.
fn through_channels(n_hops: usize, n_items: u64, value: &Value) {
    let channels: Vec<_> = (0..n_hops).map(|_| bounded::<Item>(CAPACITY)).collect();
    for number in 0..n_items {
        let mut item = item(number, value);
        for (tx, rx) in &channels {
            tx.try_send(item).expect("there is room");
            item = rx.try_recv().expect("an item waits");
        }
        divan::black_box(item);
    }
}

/// Eight hops, counted separately.
mod hop {
    use super::*;

    /// The source alone, to be subtracted.
    #[divan::bench]
    fn source_alone(bencher: Bencher<'_, '_>) {
        let registry = registry();
        bench(bencher, &registry, &chain(&registry, "bench.count", ITEMS, "bench.relay", 0, 0), 1, ITEMS, 0);
    }

    /// Nodes that pass on their value.
    #[divan::bench(args = [1, 2])]
    fn hand_on(bencher: Bencher<'_, '_>, workers: usize) {
        let registry = registry();
        let plan = chain(&registry, "bench.count", ITEMS, "bench.relay", HOPS, 0);
        bench(bencher, &registry, &plan, workers, ITEMS, HOPS);
    }

    /// Nodes that make a new payload, with one allocation.
    #[divan::bench(args = [1, 2])]
    fn make_anew(bencher: Bencher<'_, '_>, workers: usize) {
        let registry = registry();
        let plan = chain(&registry, "bench.count", ITEMS, "bench.next", HOPS, 0);
        bench(bencher, &registry, &plan, workers, ITEMS, HOPS);
    }

    #[divan::bench]
    fn bare_channels_on_one_thread(bencher: Bencher<'_, '_>) {
        let value = Value::new(Number(1.0));
        bencher.counter(ItemsCount::new(ITEMS * HOPS as u64)).bench_local(|| through_channels(HOPS, ITEMS, &value));
    }

    #[divan::bench]
    fn bare_channels_between_threads(bencher: Bencher<'_, '_>) {
        let value = Value::new(Number(1.0));
        bencher.counter(ItemsCount::new(ITEMS * HOPS as u64)).bench_local(|| through_threads(HOPS, ITEMS, &value));
    }
}

/// Two nodes, one channel: effect of a second thread where there is nothing to compute.
mod pair {
    use super::*;

    #[divan::bench(args = [1, 2])]
    fn engine(bencher: Bencher<'_, '_>, workers: usize) {
        let registry = registry();
        let plan = chain(&registry, "bench.count", ITEMS, "bench.relay", 1, 0);
        bench(bencher, &registry, &plan, workers, ITEMS, 1);
    }

    #[divan::bench]
    fn bare_channel_between_threads(bencher: Bencher<'_, '_>) {
        let value = Value::new(Number(1.0));
        bencher.counter(ItemsCount::new(ITEMS)).bench_local(|| through_threads(1, ITEMS, &value));
    }
}

/// Ten nodes that compute for 20 µs each, counted per node: two cores give at most twice the throughput.
mod chain_of_10 {
    use super::*;

    const FEW: u64 = 200;
    const SPIN_US: u64 = 20;

    #[divan::bench(args = [1, 2], sample_count = 10)]
    fn engine(bencher: Bencher<'_, '_>, workers: usize) {
        let registry = registry();
        let plan = chain(&registry, "bench.count", FEW, "bench.relay", 10, SPIN_US);
        bench(bencher, &registry, &plan, workers, FEW, 10);
    }

    /// One thread per node.
    #[divan::bench(sample_count = 10)]
    fn bare_channels_between_threads(bencher: Bencher<'_, '_>) {
        let value = Value::new(Number(1.0));
        bencher.counter(ItemsCount::new(FEW * 10)).bench_local(|| {
            let (senders, receivers): (Vec<_>, Vec<_>) = (0..10).map(|_| bounded::<Item>(CAPACITY)).unzip();
            let mut senders = senders.into_iter();
            let first = senders.next().expect("there is a hop");
            std::thread::scope(|scope| {
                for rx in receivers {
                    let tx = senders.next();
                    scope.spawn(move || {
                        for item in rx {
                            spin(SPIN_US);
                            tx.iter().for_each(|tx| tx.send(item.clone()).expect("the next thread receives it"));
                        }
                    });
                }
                (0..FEW).for_each(|number| first.send(item(number, &value)).expect("the first thread receives it"));
                drop(first);
            });
        });
    }
}

/// One source and eight consumers, counted per consumer.
mod fan_out_to_8 {
    use super::*;

    #[divan::bench(args = [1, 2])]
    fn engine(bencher: Bencher<'_, '_>, workers: usize) {
        let registry = registry();
        let mut nodes = vec![("bench.count", json!({ "items": ITEMS }), None)];
        nodes.extend((0..8).map(|_| ("bench.relay", json!({}), Some(0))));
        bench(bencher, &registry, &plan(&registry, &nodes), workers, ITEMS, 8);
    }

    #[divan::bench]
    fn bare_channels_between_threads(bencher: Bencher<'_, '_>) {
        let value = Value::new(Number(1.0));
        bencher.counter(ItemsCount::new(ITEMS * 8)).bench_local(|| {
            let (senders, receivers): (Vec<_>, Vec<_>) = (0..8).map(|_| bounded::<Item>(CAPACITY)).unzip();
            std::thread::scope(|scope| {
                for rx in receivers {
                    scope.spawn(move || rx.iter().for_each(|item| drop(divan::black_box(item))));
                }
                for number in 0..ITEMS {
                    senders.iter().for_each(|tx| tx.send(item(number, &value)).expect("a thread receives it"));
                }
                drop(senders);
            });
        });
    }
}

/// A megabyte through ten nodes without a copy, counted per hop.
mod megabyte_through_10 {
    use super::*;

    #[divan::bench(args = [1, 2])]
    fn engine(bencher: Bencher<'_, '_>, workers: usize) {
        let registry = registry();
        let plan = chain(&registry, "bench.frames", ITEMS, "bench.relay", 10, 0);
        bench(bencher, &registry, &plan, workers, ITEMS, 10);
    }

    #[divan::bench]
    fn bare_channels_on_one_thread(bencher: Bencher<'_, '_>) {
        let value = Value::new(Megabyte::scan(0));
        bencher.counter(ItemsCount::new(ITEMS * 10)).bench_local(|| through_channels(10, ITEMS, &value));
    }
}
