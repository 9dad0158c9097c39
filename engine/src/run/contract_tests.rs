//! Contracts of time: kept or named, live and in a replay.

use super::{
    tests::{calls, check, options, refusal_of},
    *,
};
use crate::{
    plan::{Contract, Deadline, Otherwise, OutputId, Policy},
    recording::Recording,
    replay::{ReplayOptions, replay_plan},
    runtime::ContractKind,
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::{Body, Item, Join};
use osteoflow_toy::{
    Number,
    devices::{Followed, Given, World},
    registry,
};
use serde_json::{Value as Json, json};
use std::{collections::BTreeMap, sync::Mutex};

const MS: i64 = 1_000_000;

fn max_age(ns: i64, otherwise: Otherwise) -> Contract {
    Contract { max_age_ns: Some(ns), period_ns: None, otherwise }
}

/// Scans every 10 ns, and poses of which the newest are 0, 10, 20, 30 .. old.
fn aging(otherwise: Otherwise, joined_by: Join) -> Plan {
    let scans: Vec<_> = (1..7).map(|k| (10 * k, 0, k as f64)).collect();
    PlanBuilder::new()
        .script("scan", 1, calls(&scans))
        .script("pose", 1, calls(&[(10, 0, 100.0), (60, 0, 200.0)]))
        .node("place", "toy.add", json!({}), &[("a", "scan.p0", None), ("b", "pose.p0", Some(joined_by))])
        .contract("place.b", max_age(20, otherwise))
        .record(&["scan.p0", "pose.p0", "place.out"])
        .result("all", "place.out", true, true)
        .plan()
}

fn reasons(report: &RunReport) -> Vec<(String, String)> {
    let text = |sign: &Json, key: &str| sign[key].as_str().unwrap().to_owned();
    let signs = report.results["reasons"].as_array().into_iter().flatten();
    signs.map(|sign| (text(sign, "rule"), text(sign, "reason"))).collect()
}

#[test]
fn a_value_that_is_too_old_by_its_stamp_is_unknown_left_out_or_refuses_the_run() {
    let report = check(&aging(Otherwise::Unknown, Join::Latest));
    assert_eq!(
        report.results["all"],
        json!([101.0, 102.0, 103.0, 4.0, 5.0, 206.0]),
        "without it the node adds nothing"
    );
    let told = ("max_age".to_owned(), "place.b: 2 of 6 values were older than 20 ns, the first at item 3".to_owned());
    assert_eq!(reasons(&report), std::slice::from_ref(&told));
    let kept = &report.contracts[0];
    assert_eq!(
        (&*kept.on, kept.kind, kept.n, kept.n_broken, kept.first),
        ("place.b", ContractKind::MaxAge, 6, 2, Some(3))
    );
    assert_eq!(kept.spread.max.as_nanos(), 40);

    let report = check(&aging(Otherwise::Drop, Join::Latest));
    let left_out = |ns| json!({ "unknown": format!("input \"b\": its value is {ns} ns older than the firing, 20 ns allowed"), "node": "place" });
    assert_eq!(report.results["all"], json!([101.0, 102.0, 103.0, left_out(30), left_out(40), 206.0]));
    assert_eq!(report.nodes[2].skipped, 2);

    let report = check(&aging(Otherwise::Refuse, Join::Latest));
    let refusal = refusal_of(&report);
    assert_eq!((&*refusal.node, refusal.item), ("place", Some(3)));
    assert!(refusal.reason.ends_with("20 ns allowed, and otherwise = \"refuse\""), "{}", refusal.reason);
    assert_eq!((report.nodes[2].items, reasons(&report)), (6, vec![told]), "the run itself goes on");
}

#[test]
fn between_two_poses_nothing_is_old_and_a_required_input_skips_the_node() {
    let report = check(&aging(Otherwise::Unknown, Join::Interpolate { max_gap_ns: None }));
    assert_eq!((report.contracts[0].n_broken, report.contracts[0].spread.max.as_nanos()), (0, 0));
    let plan = PlanBuilder::new()
        .script("pose", 1, calls(&[(10, 0, 100.0)]))
        .script("scan", 1, calls(&[(10, 0, 1.0), (50, 0, 2.0)]))
        .node(
            "place",
            "toy.add",
            json!({}),
            &[("a", "pose.p0", Some(Join::Latest)), ("b", "scan.p0", Some(Join::Each))],
        )
        .contract("place.a", max_age(30, Otherwise::Unknown))
        .record(&["scan.p0", "place.out"])
        .result("all", "place.out", true, true)
        .plan();
    let unknown = "input \"a\": its value is 40 ns older than the firing, 30 ns allowed";
    assert_eq!(check(&plan).results["all"], json!([101.0, { "unknown": unknown, "node": "place" }]));
}

#[test]
fn feedback_is_broken_off_by_an_age_and_begins_anew() {
    let script = calls(&[(10, 0, 1.0), (20, 0, 1.0), (30, 0, 1.0), (90, 0, 1.0), (100, 0, 1.0)]);
    let plan = PlanBuilder::new()
        .script("scan", 1, script)
        .node("start", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .previous("start.b", "start.out")
        .contract("start.b", max_age(25, Otherwise::Unknown))
        .record(&["scan.p0", "start.out"])
        .result("all", "start.out", true, false)
        .plan();
    assert_eq!(check(&plan).results["all"], json!([1.0, 2.0, 3.0, 1.0, 2.0]));
}

#[test]
fn of_several_values_the_oldest_counts_and_a_constant_does_not_grow_old() {
    let numbers: Vec<_> = (1..7).map(|k| (if k < 5 { 10 * k } else { 100 * k }, 0, k as f64)).collect();
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&numbers))
        .node("sum", "toy.sum", json!({}), &[("all", "scan.p0", Some(Join::Collect { n: Some(2) }))])
        .script("plan", 1, calls(&[(0, 0, 1000.0)]))
        .node("add", "toy.add", json!({}), &[("a", "sum.out", None), ("b", "plan.p0", Some(Join::Latest))])
        .contract("sum.all", max_age(10, Otherwise::Unknown))
        .contract("add.b", max_age(10, Otherwise::Unknown))
        .record(&["scan.p0", "sum.out", "add.out"])
        .result("all", "add.out", true, true)
        .plan();
    let unknown = "input \"all\": its value is 100 ns older than the firing, 10 ns allowed";
    assert_eq!(check(&plan).results["all"], json!([1003.0, 1007.0, { "unknown": unknown, "node": "sum" }]));
}

#[test]
fn a_wire_of_a_file_is_told_where_it_is_silent_and_is_not_changed() {
    let given: Vec<_> = [10, 20, 30, 90, 100].iter().map(|ns| (*ns, 0, 1.0)).collect();
    let plan = |otherwise| {
        let contract = Contract { max_age_ns: None, period_ns: Some(10), otherwise };
        let plan = PlanBuilder::new().script("scan", 1, calls(&given));
        let plan = plan.node("add", "toy.add", json!({}), &[("a", "scan.p0", None)]).contract("add.a", contract);
        plan.record(&["scan.p0", "add.out"]).result("all", "add.out", true, false).plan()
    };
    let report = check(&plan(Otherwise::Unknown));
    let told = "scan.p0: nothing came for 20 ns or longer, 1 times, the first at item 3".to_owned();
    assert_eq!((&report.results["all"], reasons(&report)), (&json!(vec![1.0; 5]), vec![("silent_wire".into(), told)]));
    let refused = check(&plan(Otherwise::Refuse));
    assert_eq!(refusal_of(&refused).reason, "nothing came for 60 ns, and otherwise = \"refuse\"");
}

#[test]
fn a_wire_of_two_consumers_breaks_the_rate_of_one_by_its_own_limit_and_not_by_the_age_of_the_other() {
    let plan = |gap: i64| {
        let given: Vec<_> = [10, 20, 20 + gap].iter().map(|ns| (*ns, 0, 1.0)).collect();
        let rate = Contract { max_age_ns: None, period_ns: Some(50), otherwise: Otherwise::Refuse };
        PlanBuilder::new()
            .script("scan", 1, calls(&given))
            .node("young", "toy.add", json!({}), &[("a", "scan.p0", None)])
            .node("often", "toy.add", json!({}), &[("a", "scan.p0", None)])
            .contract("young.a", max_age(20, Otherwise::Unknown))
            .contract("often.a", rate)
            .record(&["scan.p0", "young.out", "often.out"])
            .result("all", "often.out", true, true)
            .plan()
    };
    let report = check(&plan(60));
    assert_eq!((&report.outcome, reasons(&report)), (&Outcome::Complete, vec![]));
    let report = check(&plan(100));
    assert_eq!(refusal_of(&report).reason, "nothing came for 100 ns, and otherwise = \"refuse\"");
    let told = "scan.p0: nothing came for 100 ns or longer, 1 times, the first at item 2".to_owned();
    assert_eq!(reasons(&report), [("silent_wire".to_owned(), told)]);
}

/// What came on each wire, with the time.
struct Wires<'w>(&'w World, Mutex<BTreeMap<OutputId, Vec<(u64, Item)>>>);

impl Tap for Wires<'_> {
    fn listens(&self, _: OutputId) -> bool {
        true
    }

    fn item(&self, wire: OutputId, item: &Item) {
        self.1.lock().unwrap().entry(wire).or_default().push((self.0.now(), item.clone()));
    }
}

/// Numbers from a seed: SplitMix64.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }
}

const TRACKER: usize = 0;
const CAMERA: usize = 1;

/// 10 000 items a second of a tracker and a camera for 40 ms, with jitter, stalls that end in a burst, clocks that are set, lost
/// samples and devices that die.
fn devices(draws: &mut Draws) -> Vec<Given> {
    let mut all = Vec::new();
    for (device, period_ns) in [(TRACKER, 125_000), (CAMERA, 500_000)] {
        let (mut stalled_until, mut step_ns) = (0, 0);
        let dies_at = if draws.one_in(3) { 5_000_000 + draws.below(30_000_000) } else { u64::MAX };
        for k in 1..40_000_000 / period_ns {
            let measured_ns = k * period_ns + draws.below(period_ns / 4);
            if measured_ns > dies_at {
                break;
            }
            if draws.one_in(60) {
                stalled_until = measured_ns + draws.below(12_000_000);
            }
            if draws.one_in(150) {
                step_ns += draws.below(4_000_000) as i64 - 2_000_000;
            }
            let at_ns = measured_ns.max(stalled_until);
            // Not 0, which is a constant.
            let stamp_ns = (measured_ns as i64 + step_ns).max(1);
            all.push(Given { device, at_ns, stamp_ns, is_lost: draws.one_in(40) });
        }
    }
    all.sort_by_key(|given| given.at_ns);
    all
}

/// The contracts of a schedule.
#[derive(Clone, Copy)]
struct Limits {
    a: Contract,
    b: Contract,
    deadline_ns: i64,
}

fn scheduled(name: &str, limits: Limits) -> Plan {
    let wide = |link: &mut crate::plan::Link| {
        (link.capacity, link.max_bytes, link.policy) = (100_000, 1 << 30, Policy::Block);
    };
    let device = |device: usize| json!({ "world": name, "device": device });
    PlanBuilder::new()
        .source("tracker", "toy.device", 1, device(TRACKER))
        .source("camera", "toy.device", 1, device(CAMERA))
        .node(
            "follow",
            "toy.follow",
            json!({ "world": name }),
            &[("a", "tracker.p0", Some(Join::Each)), ("b", "camera.p0", Some(Join::Latest))],
        )
        .node("after", "toy.add", json!({}), &[("a", "follow.out", None)])
        .contract("follow.a", limits.a)
        .contract("follow.b", limits.b)
        .deadline("follow", Deadline { ns: limits.deadline_ns, otherwise: Otherwise::Unknown })
        .link("follow.a", wide)
        .link("follow.b", wide)
        .record(&["tracker.p0", "camera.p0", "follow.out", "after.out"])
        .result("all", "after.out", true, true)
        .plan()
}

/// How often contracts were broken, by kind.
#[derive(Default, Debug)]
struct Broken {
    by_stamp: u64,
    by_arrival: u64,
    deadline: u64,
    silent: u64,
    kept: u64,
}

/// Checks one value of a firing: brought if it is young enough, named if it is too old. What the clock says is known between
/// the times that were seen before and after.
fn judge(
    port: &str,
    got: &Result<usize, String>,
    offered: Option<&(u64, Item)>,
    at: (&Followed, u64),
    max_ns: i64,
    world: &World,
    n: &mut Broken,
) {
    let (followed, decided_after) = at;
    let Some((sent_ns, item)) = offered else {
        assert!(got.is_err(), "{port}: {got:?} where nothing came");
        return;
    };
    let Some(value) = item.body.value().map(|value| value.get::<Number>().unwrap().0 as usize) else {
        assert!(got.as_ref().is_err_and(|why| !why.contains("allowed")), "{port}: {got:?} where an empty came");
        n.silent += u64::from(got.as_ref().is_err_and(|why| why.starts_with("nothing came for")));
        return;
    };
    let by_stamp = followed.stamp_ns - item.stamp_ns;
    let least = decided_after.saturating_sub(*sent_ns) as i64;
    let most = (followed.began_ns - world.times.lock().unwrap()[value]) as i64;
    match got {
        Ok(place) => {
            assert_eq!(*place, value, "{port}: another value");
            assert!(by_stamp <= max_ns && least <= max_ns, "{port}: {by_stamp} or {least} ns old, and not named");
            n.kept += 1;
        }
        Err(why) if why.contains("older than the firing") => {
            assert!(by_stamp > max_ns, "{port}: {by_stamp} ns by its stamp, and named: {why}");
            n.by_stamp += 1;
        }
        Err(why) => {
            assert!(why.contains("its value came") && most > max_ns, "{port}: at most {most} ns old, and named: {why}");
            n.by_arrival += 1;
        }
    }
}

/// Runs one schedule, checks every firing against what was seen from outside, and replays it.
fn schedule(seed: u64) -> Broken {
    let mut draws = Draws(seed);
    let name = format!("schedule {seed}");
    let given = devices(&mut draws);
    let a = max_age((4 + draws.below(6)) as i64 * MS, Otherwise::Unknown);
    let period_ns = draws.one_in(2).then(|| (1 + draws.below(2)) as i64 * MS);
    let b = Contract { period_ns, ..max_age((4 + draws.below(6)) as i64 * MS, Otherwise::Unknown) };
    let limits = Limits { a, b, deadline_ns: 300_000 };
    let spent_ns =
        (0..37).map(|_| if draws.one_in(12) { draws.below(2_000_000) } else { draws.below(60_000) }).collect();
    let world = World { given, spent_ns, ..World::default() }.begin(&name);
    let plan = scheduled(&name, limits);
    let dir = tempfile::tempdir().unwrap();
    let run_options = RunOptions {
        clock: Some(world.clock.clone()),
        out_dir: Some(dir.path().into()),
        record: true,
        shuffle: draws.one_in(2).then_some(seed),
        ..options([1, 2, 8][draws.below(3) as usize])
    };
    let wires = Wires(&world, Mutex::default());
    let report = run_with(&plan, &registry(), &run_options, &(), Replayed::default(), Some(&wires)).unwrap();
    let wires = wires.1.into_inner().unwrap();
    let on = |name: &str, port: usize| {
        wires.get(&OutputId { node: plan.node(name).unwrap(), port }).cloned().unwrap_or_default()
    };
    let (tracker, camera, out) = (on("tracker", 0), on("camera", 0), on("follow", 0));
    let followed = std::mem::take(&mut *world.followed.lock().unwrap());
    assert_eq!((followed.len(), out.len()), (tracker.len(), tracker.len()), "seed {seed}: a firing for each");
    let mut n = Broken::default();
    for (firing, (ended_ns, answer)) in followed.iter().zip(&out) {
        let trigger = &tracker[firing.item as usize];
        judge("a", &firing.a, Some(trigger), (firing, trigger.0), limits.a.max_age_ns.unwrap(), &world, &mut n);
        let newest = camera.iter().rev().find(|(_, item)| item.stamp_ns <= firing.stamp_ns);
        judge("b", &firing.b, newest, (firing, trigger.0), limits.b.max_age_ns.unwrap(), &world, &mut n);
        let is_late = answer.body.value().is_none();
        let (least, most) = (firing.ended_ns - firing.began_ns, ended_ns - trigger.0);
        assert!(is_late || least <= limits.deadline_ns as u64, "seed {seed}: it took {least} ns, and is not named");
        assert!(!is_late || most > limits.deadline_ns as u64, "seed {seed}: it took at most {most} ns, and is named");
        n.deadline += u64::from(is_late);
    }
    // Every breach is counted, and a wire whose device died says so while the other goes on.
    let counted = |kind, on: &str| {
        report.contracts.iter().find(|c| c.kind == kind && c.on == on).map_or(0, |contract| contract.n_broken)
    };
    let ages = counted(ContractKind::MaxAge, "follow.a") + counted(ContractKind::MaxAge, "follow.b");
    assert_eq!(
        (ages, counted(ContractKind::Deadline, "follow")),
        (n.by_stamp + n.by_arrival, n.deadline),
        "seed {seed}"
    );
    for (items, contract) in [(&tracker, limits.a), (&camera, limits.b)] {
        let (Some((last_ns, last)), Some(max_ns)) = (items.last(), contract.silence_ns()) else { continue };
        let says_so = |(_, item): &(u64, Item)| matches!(&item.body, Body::Empty(empty) if empty.reason.starts_with("nothing came for"));
        let silent_ns = world.given.last().unwrap().at_ns.saturating_sub(*last_ns) as i64;
        let is_told = last.body.value().is_none() || silent_ns < 2 * max_ns || items.iter().any(says_so);
        assert!(is_told, "seed {seed}: silent for {silent_ns} ns, and not told");
    }
    let gaps = camera.windows(2).filter(|pair| pair[1].1.stamp_ns - pair[0].1.stamp_ns >= b.silence_ns().unwrap());
    let (gaps, silences) = (gaps.count() as u64, counted(ContractKind::Silence, "camera.p0"));
    // An empty that tells a silence, and the item that ends it long after, are one silence.
    assert!(
        silences <= gaps && (silences > 0) == (gaps > 0 && period_ns.is_some()),
        "seed {seed}: {silences} of {gaps}"
    );
    let recording = Recording::open(&dir.path().join("run.mcap")).unwrap();
    for workers in [1, 2] {
        let replayed =
            replay_plan(&plan, &recording, &ReplayOptions::default(), &registry(), &options(workers), &()).unwrap();
        assert!(replayed.is_equal() && replayed.results_equal == Some(true), "seed {seed}: {:#?}", replayed.wires);
        let broken = |report: &RunReport| -> Vec<_> {
            report.contracts.iter().map(|c| (c.on.clone(), c.n, c.n_broken, c.first)).collect()
        };
        assert_eq!(broken(&replayed.run), broken(&report), "seed {seed}: a replay counts the same");
    }
    n
}

/// 1,000 with `SLOW_TESTS`, 25 without.
#[test]
fn each_contract_is_kept_or_named_in_random_schedules_and_every_replay_decides_the_same() {
    let n_schedules = if std::env::var_os("SLOW_TESTS").is_some() { 1000 } else { 25 };
    let mut all = Broken::default();
    for seed in 0..n_schedules {
        let n = schedule(seed);
        all.by_stamp += n.by_stamp;
        all.by_arrival += n.by_arrival;
        all.deadline += n.deadline;
        all.silent += n.silent;
        all.kept += n.kept;
    }
    println!("{n_schedules} schedules: {all:?}");
    let Broken { by_stamp, by_arrival, deadline, silent, kept } = all;
    assert!([by_stamp, by_arrival, deadline, silent, kept].iter().all(|n| *n > 0), "each happens: {all:?}");
}

#[test]
fn a_device_that_dies_is_unknown_within_the_time_allowed_and_one_that_comes_back_is_known_again() {
    let given =
        |device, at_ms: u64| Given { device, at_ns: at_ms * 1_000_000, stamp_ns: at_ms as i64 * MS, is_lost: false };
    let tracker = (1..200).map(|ms| given(TRACKER, ms));
    let camera = (1..200).filter(|ms| !(40..90).contains(ms) && *ms < 150).map(|ms| given(CAMERA, ms));
    let mut all: Vec<_> = tracker.chain(camera).collect();
    all.sort_by_key(|given| (given.at_ns, given.device));
    let world = World { given: all, ahead: Some(16), ..World::default() }.begin("dies");
    let b = Contract { period_ns: Some(5 * MS), ..max_age(30 * MS, Otherwise::Unknown) };
    let limits = Limits { a: Contract::default(), b, deadline_ns: i64::MAX };
    let run_options = RunOptions { clock: Some(world.clock.clone()), ..options(2) };
    let report =
        run_with(&scheduled("dies", limits), &registry(), &run_options, &(), Replayed::default(), None).unwrap();
    let followed = world.followed.lock().unwrap();
    let known: Vec<_> = followed.iter().filter(|f| f.b.is_ok()).map(|f| f.stamp_ns / MS).collect();
    let expected: Vec<_> = (1..49).chain(90..159).collect();
    assert_eq!(known, expected, "what the empty at 49 ms ends, the item of 90 ms begins anew");
    let silent = |f: &&Followed| f.b.as_ref().is_err_and(|why| why == "nothing came for 10 ms");
    let silent: Vec<_> = followed.iter().filter(silent).map(|f| f.stamp_ns / MS).collect();
    assert_eq!(silent, (49..90).chain(159..200).collect::<Vec<_>>(), "from the empty to the next item");
    let silence = report.contracts.iter().find(|c| c.kind == ContractKind::Silence).unwrap();
    assert_eq!((&*silence.on, silence.n_broken, silence.spread.max.as_millis()), ("camera.p0", 2, 51));
}
