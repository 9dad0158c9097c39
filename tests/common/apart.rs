//! Time of a firing in a process of its own, beside the same node in this one.

use super::build;
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

/// Median times of a firing.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) here: Duration,
    pub(crate) apart: Duration,
}

impl Case {
    /// What the process costs.
    pub(crate) fn more(&self) -> Duration {
        self.apart.saturating_sub(self.here)
    }
}

/// A cloud of 20,000 points in and a pose out; 1 kB in and out. `None` where there is no C++ compiler.
pub(crate) fn measure(n_firings: u64) -> Option<[Case; 2]> {
    let dir = tempfile::tempdir().unwrap();
    let libraries: Vec<_> = ["centre", "dies"].map(|name| (name, dir.path().join(format!("lib{name}.so")))).into();
    for (name, library) in &libraries {
        build::compile(Path::new(&format!("tests/plugins/{name}.cpp")), library, &[]).then_some(())?;
    }
    let own = |subcommand: &str| Launcher::new(env!("CARGO_BIN_EXE_osteoflow").into(), vec![subcommand.into()]);
    let finder = Finder {
        prober: Prober { launcher: own("plugin-probe"), timeout: Prober::TIMEOUT },
        store: None,
        asked: libraries.into_iter().map(|(_, library)| library).collect(),
        folders: Vec::new(),
        launcher: Some(own("worker")),
        scripts: None,
        only: None,
        recorded: Vec::new(),
        carried: Default::default(),
        plugins_apart: false,
        held: None,
    };
    let registry = Kinds::new(osteoflow_standard::registry(), finder).known().registry;

    let samples = sample::surface(&fibula(&BoneParams::default()), 20_000, &mut ChaCha8Rng::seed_from_u64(1));
    let cloud = Value::new(Cloud::new("camera", samples.points).unwrap().with_normals(samples.normals).unwrap());
    let points = (0..20).map(|k| NamedPoint::new(format!("P{k:02}"), Point3::new(f64::from(k), 0.0, 0.0)));
    let points = Value::new(Points::new("ct", points.collect::<Vec<_>>()));
    let cases = [
        ("20,000 points with normals in, a pose out", "centre.mean", cloud),
        ("1.3 kB in and out", "dies.relay", points),
    ];
    Some(cases.map(|(name, kind, value)| {
        let median = |process| median(&registry, kind, &value, process, n_firings);
        Case { name, here: median(false), apart: median(true) }
    }))
}

fn median(registry: &Registry, kind: &str, value: &Value, process: bool, n_firings: u64) -> Duration {
    let place = Place { process: Some(process), ..Place::default() };
    let context = BuildContext { joins: vec![Join::Each], place, ..BuildContext::detached("bench") };
    let kind = registry.kind(kind).unwrap();
    let Ok(Built::Node(mut node)) = registry.build(kind, &json!({}), &context) else { panic!("it is a node") };
    let mut context = Context::for_test("bench");
    let mut times: Vec<Duration> = (0..n_firings)
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
