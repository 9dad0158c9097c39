//! Time of a firing in a process of its own, beside the same node in this one: the median of 1,000 firings.
//!
//! `cargo bench -p osteoflow --bench apart`. docs/performance.md has the figures.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed bench, with its line")]

#[allow(dead_code, reason = "tests use the rest")]
#[path = "../../engine/tests/plugins/build.rs"]
mod build;

use osteoflow_algorithms::sample;
use osteoflow_engine::plugin::{Finder, Kinds, Launcher, Prober};
use osteoflow_geometry::{Cloud, NamedPoint, Points, nalgebra::Point3};
use osteoflow_node::{Body, BuildContext, Built, Context, Emission, Item, Join, Joined, Place, Registry, Slot, Value};
use osteoflow_simulation::bone::{BoneParams, fibula};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::json;
use std::{
    path::Path,
    time::{Duration, Instant},
};

const N_FIRINGS: usize = 1_000;

fn main() {
    let dir = tempfile::tempdir().unwrap();
    let libraries: Vec<_> = ["centre", "dies"].map(|name| (name, dir.path().join(format!("lib{name}.so")))).into();
    for (name, library) in &libraries {
        if !build::compile(Path::new(&format!("tests/plugins/{name}.cpp")), library, &[]) {
            return;
        }
    }
    let program = env!("CARGO_BIN_EXE_osteoflow");
    let finder = Finder {
        prober: Prober { program: program.into(), arguments: vec!["plugin-probe".into()], timeout: Prober::TIMEOUT },
        store: None,
        asked: libraries.into_iter().map(|(_, library)| library).collect(),
        folders: Vec::new(),
        launcher: Some(Launcher { program: program.into(), arguments: vec!["worker".into()] }),
        scripts: None,
        plugins_apart: false,
    };
    let registry = Kinds::new(osteoflow_standard::registry(), finder).known().registry;

    let samples = sample::surface(&fibula(&BoneParams::default()), 20_000, &mut ChaCha8Rng::seed_from_u64(1));
    let cloud = Cloud::new("camera", samples.points).unwrap().with_normals(samples.normals).unwrap();
    compare(&registry, "20,000 points with normals in, a pose out", "centre.mean", Value::new(cloud));

    let points = (0..20).map(|k| NamedPoint::new(format!("P{k:02}"), Point3::new(f64::from(k), 0.0, 0.0)));
    let points = Value::new(Points::new("ct", points.collect::<Vec<_>>()));
    println!("{} bytes:", points.n_bytes());
    compare(&registry, "1 kB in and out", "dies.relay", points);
}

fn compare(registry: &Registry, what: &str, kind: &str, value: Value) {
    let here = median(registry, kind, &value, false);
    let apart = median(registry, kind, &value, true);
    let us = |time: Duration| time.as_secs_f64() * 1e6;
    println!("{what}: {:.1} us here, {:.1} us apart, {:.1} us more", us(here), us(apart), us(apart) - us(here));
}

fn median(registry: &Registry, kind: &str, value: &Value, process: bool) -> Duration {
    let place = Place { process: Some(process), stop_after: None };
    let context = BuildContext { joins: vec![Join::Each], place, ..BuildContext::detached("bench") };
    let kind = registry.kind(kind).unwrap();
    let Ok(Built::Node(mut node)) = registry.build(kind, &json!({}), &context) else { panic!("it is a node") };
    let mut context = Context::for_test("bench");
    let mut times: Vec<Duration> = (0..N_FIRINGS as u64)
        .map(|number| {
            let item = Item { number: number + 2, stamp_ns: 0, body: Body::Value(value.clone()) };
            let mut joined = Joined { slots: vec![Slot::Item(item)], is_spent: false };
            let mut out = [Emission::Silent];
            context.begin(number, 0);
            let began = Instant::now();
            node.fire(&mut joined, &mut out, &mut context).unwrap();
            let took = began.elapsed();
            assert!(matches!(out[0], Emission::Value(_)));
            took
        })
        .collect();
    times.sort();
    times[times.len() / 2]
}
