//! What the engine costs beside what it is made of: items through nodes, and the same items through bare channels of the
//! same capacity, in one run. What each figure means stands in `docs/performance.md`.

#[allow(dead_code, reason = "the test that counts allocations uses the rest")]
mod graph;

use crossbeam_channel::{Receiver, Sender, bounded};
use divan::{Bencher, counter::ItemsCount};
use graph::{CAPACITY, Megabyte, Number, chain, plan, registry};
use osteoflow_engine::{
    plan::Plan,
    run::{RunOptions, run},
};
use osteoflow_node::{Body, Item, Registry, Value};
use serde_json::json;

const ITEMS: u64 = 20_000;
const HOPS: usize = 8;

fn main() {
    divan::main();
}

/// Runs the plan again and again; `n_hops` are counted for each item.
fn bench(bencher: Bencher<'_, '_>, registry: &Registry, plan: &Plan, workers: usize, n_items: u64, n_hops: usize) {
    let options = RunOptions { workers, ..RunOptions::default() };
    bencher
        .counter(ItemsCount::new(n_items * n_hops.max(1) as u64))
        .bench_local(|| run(plan, registry, &options, &()).expect("the graph runs"));
}

fn item(number: u64, value: &Value) -> Item {
    Item { number, stamp_ns: number as i64, body: Body::Value(value.clone()) }
}

/// So many threads in a row after the calling one, which sends; the last one only takes.
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
                        Some(tx) => tx.send(item).expect("the next thread takes it"),
                        None => drop(divan::black_box(item)),
                    }
                }
            });
        }
        (0..n_items).for_each(|number| first.send(item(number, value)).expect("the first thread takes it"));
        drop(first);
    });
}

/// The same items through bare channels on one thread.
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

/// One hop, eight times: items are counted per hop.
mod hop {
    use super::*;

    /// The source alone: what its calls and the run itself cost, to be taken off.
    #[divan::bench]
    fn source_alone(bencher: Bencher<'_, '_>) {
        let registry = registry();
        bench(bencher, &registry, &chain(&registry, "bench.count", ITEMS, "bench.relay", 0, 0), 1, ITEMS, 0);
    }

    /// Nodes that hand on what they get.
    #[divan::bench(args = [1, 2])]
    fn hand_on(bencher: Bencher<'_, '_>, workers: usize) {
        let registry = registry();
        let plan = chain(&registry, "bench.count", ITEMS, "bench.relay", HOPS, 0);
        bench(bencher, &registry, &plan, workers, ITEMS, HOPS);
    }

    /// Nodes that make a new payload, which is an allocation.
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

/// Two nodes, one channel: what a second thread brings and costs where there is nothing to compute.
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

/// Ten nodes that compute for 20 µs each: items are counted per node, so that two cores give twice as many at best.
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

    /// A thread for each node.
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
                            graph::spin(SPIN_US);
                            tx.iter().for_each(|tx| tx.send(item.clone()).expect("the next thread takes it"));
                        }
                    });
                }
                (0..FEW).for_each(|number| first.send(item(number, &value)).expect("the first thread takes it"));
                drop(first);
            });
        });
    }
}

/// One source, eight consumers: items are counted per consumer.
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
                    senders.iter().for_each(|tx| tx.send(item(number, &value)).expect("a thread takes it"));
                }
                drop(senders);
            });
        });
    }
}

/// A megabyte through ten nodes: items are counted per hop. Nothing of it is copied.
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
        let value = Value::new(Megabyte::new());
        bencher.counter(ItemsCount::new(ITEMS * 10)).bench_local(|| through_channels(10, ITEMS, &value));
    }
}
