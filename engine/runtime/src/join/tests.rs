mod previous;
mod steps;
mod windows;

use super::*;
use osteoflow_node::Value;
use osteoflow_toy::Number;
use proptest::prelude::*;

/// An offer to a port: an item with a stamp and a number, or an empty.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Offer {
    Value(StampNs, f64),
    Empty(StampNs),
}

use Offer::{Empty as Lost, Value as V};

fn plain(join: Join) -> PortSpec {
    PortSpec { name: "port", join, optional: false, unused: false, wire: Some("from.wire".into()), continues: false }
}

fn optional(join: Join) -> PortSpec {
    PortSpec { optional: true, ..plain(join) }
}

fn items(offers: &[Offer]) -> Vec<Item> {
    let items = offers.iter().zip(0..).map(|(offer, number)| match *offer {
        V(stamp_ns, x) => Item { number, stamp_ns, body: Body::Value(Value::new(Number(x))) },
        Lost(stamp_ns) => {
            let empty = Empty { node: "marker".into(), reason: "lost".into() };
            Item { number, stamp_ns, body: Body::Empty(Arc::new(empty)) }
        }
    });
    items.collect()
}

/// Formats an activation: its stamp, and the slots or the reason.
fn describe(joined: &Joined, activation: &Activation) -> String {
    let number = |item: &Item| match &item.body {
        Body::Value(value) => format!("{}", value.get::<Number>().unwrap().0),
        Body::Empty(empty) => format!("({})", empty.reason),
    };
    let slot = |slot: &Slot| match slot {
        Slot::Item(item) => number(item),
        Slot::Items(items) => format!("[{}]", items.iter().map(number).collect::<Vec<_>>().join(" ")),
        Slot::Absent(empty) => format!("<{}>", empty.reason),
    };
    let text = match &activation.skip {
        None => joined.slots.iter().map(slot).collect::<Vec<_>>().join(" "),
        Some(empty) => format!("skipped by {}: {}", empty.node, empty.reason),
    };
    format!("{}: {text}", activation.stamp_ns)
}

/// Offers everything in the order given by `turns` and returns what fires. Progress may be offered between items.
fn run(ports: &[PortSpec], offers: &[Vec<Offer>], turns: impl Iterator<Item = usize>) -> (Vec<String>, Vec<u64>) {
    let mut joiner = Joiner::new("node".into(), ports.to_vec());
    let mut waiting: Vec<_> = offers.iter().map(|o| items(o).into_iter().peekable()).collect();
    let mut ended = vec![false; ports.len()];
    let (mut out, mut turns) = (Vec::new(), turns);
    let (mut done, mut promised) = (false, StampNs::MIN);
    while !(done && ended.iter().all(|e| *e)) {
        let turn = turns.next().unwrap();
        let port = turn % ports.len();
        if joiner.wants(port) && !ended[port] {
            match waiting[port].peek().map(|item| item.stamp_ns) {
                Some(stamp_ns) if (turn / ports.len()).is_multiple_of(3) => drop(joiner.progress(port, stamp_ns)),
                Some(_) => joiner.offer(port, waiting[port].next().unwrap()).unwrap(),
                None => {
                    joiner.end(port);
                    ended[port] = true;
                }
            }
        }
        loop {
            promised = promised.max(joiner.progress_out());
            match joiner.step() {
                Step::Wait => break,
                Step::Ended => {
                    done = true;
                    break;
                }
                Step::Activate(activation) => {
                    assert!(activation.stamp_ns >= promised, "{} after progress {promised}", activation.stamp_ns);
                    out.push(describe(joiner.joined(), &activation));
                }
            }
        }
    }
    (out, (0..ports.len()).map(|port| joiner.unmatched(port)).collect())
}

/// Runs as a node does: each port is filled before every step, and each activation is released.
fn run_like_a_node(ports: &[PortSpec], offers: &[Vec<Offer>], in_lock_step: bool) -> Vec<String> {
    let mut joiner = Joiner::new("node".into(), ports.to_vec());
    if !in_lock_step {
        joiner.disable_lock_step();
    }
    let mut waiting: Vec<_> = offers.iter().map(|o| items(o).into_iter()).collect();
    let mut out = Vec::new();
    loop {
        for (port, items) in waiting.iter_mut().enumerate() {
            while joiner.wants(port) && !joiner.ports[port].ended {
                match items.next() {
                    Some(item) => joiner.offer(port, item).unwrap(),
                    None => joiner.end(port),
                }
            }
        }
        match joiner.step() {
            Step::Wait => {}
            Step::Ended => return out,
            Step::Activate(activation) => {
                out.push(describe(joiner.joined(), &activation));
                if activation.skip.is_none() {
                    joiner.release();
                }
            }
        }
    }
}

fn check(ports: &[PortSpec], offers: &[Vec<Offer>], expected: &[&str]) {
    // Port by port in turn, the same from the last port, and one port after the other as far as the joins allow.
    let n = ports.len();
    assert_eq!(run(ports, offers, 0..).0, expected, "in turns");
    assert_eq!(run(ports, offers, (0usize..).map(|i| n * 1000 - 1 - i % (n * 3))).0, expected, "from behind");
    assert_eq!(run(ports, offers, (0usize..).map(|i| (i / 64) % n + (i % 3) * n)).0, expected, "port by port");
}

const EACH: Join = Join::Each;
const ALL: Join = Join::Collect { n: None };
const fn collect(n: u32) -> Join {
    Join::Collect { n: Some(n) }
}
const fn stamp(tolerance_ns: i64) -> Join {
    Join::Stamp { tolerance_ns }
}
const fn interpolate(max_gap_ns: i64) -> Join {
    Join::Interpolate { max_gap_ns: Some(max_gap_ns) }
}

#[test]
fn each_pairs_items_by_number_and_fires_at_the_later_stamp() {
    let offers = [vec![V(1, 1.0), V(5, 2.0), V(6, 3.0)], vec![V(3, 10.0), V(4, 20.0)]];
    check(&[plain(EACH), plain(EACH)], &offers, &["3: 1 10", "5: 2 20"]);
    assert_eq!(run(&[plain(EACH), plain(EACH)], &offers, 0..).1, [1, 0], "one item had no partner");
}

#[test]
fn an_empty_skips_a_plain_port_with_its_reason_and_reaches_an_optional_one() {
    let offers = [vec![V(1, 1.0), Lost(2), V(3, 3.0)], vec![V(1, 1.0), V(2, 2.0), Lost(3)]];
    let plain_plain = ["1: 1 1", "2: skipped by marker: lost", "3: skipped by marker: lost"];
    check(&[plain(EACH), plain(EACH)], &offers, &plain_plain);
    let optional_optional = ["1: 1 1", "2: <lost> 2", "3: 3 <lost>"];
    check(&[optional(EACH), optional(EACH)], &offers, &optional_optional);
}

#[test]
fn an_optional_port_that_has_ended_no_longer_blocks_the_others() {
    let offers = [vec![V(1, 1.0), V(2, 2.0)], vec![V(1, 7.0)]];
    let ended = "2: 2 <from.wire ended after 1 item>";
    check(&[plain(EACH), optional(EACH)], &offers, &["1: 1 7", ended]);
    let offers = [vec![V(1, 1.0)], vec![]];
    check(&[plain(EACH), optional(EACH)], &offers, &["1: 1 <no item ever came on from.wire>"]);
}

#[test]
fn collect_takes_n_at_a_time_and_says_what_is_missing_at_the_end() {
    let offers = [vec![V(1, 1.0), V(2, 2.0), V(3, 3.0), V(4, 4.0), V(5, 5.0)]];
    let missing = "5: skipped by node: input \"port\": 2 of 3 items came before the end";
    check(&[plain(collect(3))], &offers, &["3: [1 2 3]", missing]);
    check(&[plain(ALL)], &offers, &["5: [1 2 3 4 5]"]);
    check(&[plain(ALL)], &[vec![]], &[]);
}

#[test]
fn an_empty_among_the_collected_skips_a_plain_vec() {
    let offers = [vec![V(1, 1.0), Lost(2)]];
    check(&[plain(collect(2))], &offers, &["2: skipped by marker: lost"]);
    check(&[optional(collect(2))], &offers, &["2: [1 (lost)]"]);
    check(&[plain(collect(3))], &offers, &["2: skipped by marker: lost"]);
}

#[test]
fn collect_promises_no_progress_that_its_end_would_break() {
    // Progress runs ahead of the last item, at whose stamp the collection fires when the port ends.
    let mut joiner = Joiner::new("node".into(), vec![plain(ALL)]);
    joiner.offer(0, items(&[V(5, 1.0)]).remove(0)).unwrap();
    joiner.progress(0, 100);
    assert!(matches!(joiner.step(), Step::Wait));
    assert_eq!(joiner.progress_out(), 5);
}

#[test]
fn stamp_pairs_equal_times_and_counts_what_has_no_partner() {
    let offers = [vec![V(1, 1.0), V(2, 2.0), V(4, 4.0)], vec![V(2, 20.0), V(3, 30.0), V(4, 40.0), V(5, 50.0)]];
    check(&[plain(stamp(0)), plain(stamp(0))], &offers, &["2: 2 20", "4: 4 40"]);
    assert_eq!(run(&[plain(stamp(0)), plain(stamp(0))], &offers, 0..).1, [1, 2]);
}

#[test]
fn stamp_within_a_tolerance_takes_the_newest_up_to_the_latest_head() {
    let offers = [vec![V(10, 1.0), V(20, 2.0)], vec![V(8, 80.0), V(9, 90.0), V(19, 190.0)]];
    check(&[plain(stamp(2)), plain(stamp(2))], &offers, &["10: 1 90", "20: 2 190"]);
}

#[test]
fn stamp_pairs_items_of_equal_stamps_in_their_order() {
    let offers = [vec![V(2, 1.0), V(2, 2.0), V(2, 3.0), V(4, 4.0)], vec![V(2, 20.0), V(2, 21.0), V(4, 40.0)]];
    check(&[plain(stamp(0)), plain(stamp(0))], &offers, &["2: 1 20", "2: 2 21", "4: 4 40"]);
    assert_eq!(run(&[plain(stamp(0)), plain(stamp(0))], &offers, 0..).1, [1, 0], "the third has no partner");
}

#[test]
fn stamp_matches_an_empty_as_it_matches_a_value() {
    let offers = [vec![V(1, 1.0), Lost(2), V(3, 3.0)], vec![V(1, 10.0), V(2, 20.0), V(3, 30.0)]];
    let expected = ["1: 1 10", "2: skipped by marker: lost", "3: 3 30"];
    check(&[plain(stamp(0)), plain(stamp(0))], &offers, &expected);
}

#[test]
fn stamp_takes_the_earlier_of_two_equally_near_items() {
    let offers = [vec![V(10, 1.0)], vec![V(9, 90.0), V(11, 110.0)]];
    check(&[plain(EACH), plain(stamp(2))], &offers, &["10: 1 90"]);
    let offers = [vec![V(10, 1.0)], vec![V(8, 80.0), V(11, 110.0)]];
    check(&[plain(EACH), plain(stamp(2))], &offers, &["11: 1 110"]);
}

#[test]
fn the_last_of_several_samples_at_one_stamp_is_used() {
    let offers = [vec![V(10, 1.0), V(15, 2.0)], vec![V(10, 100.0), V(10, 200.0), V(20, 300.0)]];
    check(&[plain(EACH), plain(interpolate(10))], &offers, &["10: 1 200", "15: 2 250"]);
    check(&[plain(EACH), plain(Join::Latest)], &offers, &["10: 1 200", "15: 2 200"]);
}

#[test]
fn a_sampler_that_has_ended_is_read_to_its_last_item() {
    let offers = [vec![V(1, 1.0), V(9, 9.0)], vec![V(1, 10.0)]];
    check(&[plain(EACH), plain(Join::Latest)], &offers, &["1: 1 10", "9: 9 10"]);
    let last = "9: skipped by node: input \"port\": the last sample of from.wire is 8 ns before the stamp";
    check(&[plain(EACH), plain(interpolate(100))], &offers, &["1: 1 10", last]);
}

#[test]
fn collect_with_each_takes_one_collection_per_item() {
    let offers = [vec![V(1, 1.0), V(2, 2.0), V(3, 3.0), V(4, 4.0)], vec![V(5, 50.0), V(6, 60.0), V(7, 70.0)]];
    check(&[plain(collect(2)), plain(EACH)], &offers, &["5: [1 2] 50", "6: [3 4] 60"]);
}

#[test]
fn stamp_with_each_takes_the_nearest_and_skips_where_none_is_near() {
    let offers = [vec![V(10, 1.0), V(20, 2.0), V(30, 3.0)], vec![V(9, 9.0), V(10, 10.0), V(25, 25.0), V(31, 31.0)]];
    let none = "20: skipped by node: input \"port\": no item of from.wire within 2 ns of the stamp";
    check(&[plain(EACH), plain(stamp(2))], &offers, &["10: 1 10", none, "31: 3 31"]);
    let none = "20: 2 <no item of from.wire within 2 ns of the stamp>";
    check(&[plain(EACH), optional(stamp(2))], &offers, &["10: 1 10", none, "31: 3 31"]);
}

#[test]
fn optional_stamps_alone_fire_with_the_items_available() {
    let offers = [vec![V(1, 1.0), V(3, 3.0)], vec![V(1, 10.0), V(2, 20.0)]];
    let none = "<no item of from.wire within 0 ns of the stamp>";
    let expected = ["1: 1 10", &format!("2: {none} 20"), &format!("3: 3 {none}")];
    check(&[optional(stamp(0)), optional(stamp(0))], &offers, &expected);
}

#[test]
fn latest_is_the_newest_at_or_before_and_an_empty_replaces_it() {
    let offers = [vec![V(1, 1.0), V(5, 5.0), V(7, 7.0)], vec![V(2, 20.0), V(5, 50.0), V(5, 51.0), Lost(6)]];
    let first = "1: skipped by node: input \"port\": the first sample of from.wire is 1 ns after the stamp";
    check(&[plain(EACH), plain(Join::Latest)], &offers, &[first, "5: 5 51", "7: skipped by marker: lost"]);
    let first = "1: 1 <the first sample of from.wire is 1 ns after the stamp>";
    check(&[plain(EACH), optional(Join::Latest)], &offers, &[first, "5: 5 51", "7: 7 <lost>"]);
    check(
        &[plain(EACH), optional(Join::Latest)],
        &[vec![V(3, 3.0)], vec![]],
        &["3: 3 <no item ever came on from.wire>"],
    );
}

#[test]
fn interpolate_uses_neighbours_and_returns_an_exact_match_unchanged() {
    let offers = [vec![V(15, 1.0), V(20, 2.0), V(22, 3.0)], vec![V(10, 100.0), V(20, 200.0), V(24, 240.0)]];
    check(&[plain(EACH), plain(interpolate(10))], &offers, &["15: 1 150", "20: 2 200", "22: 3 220"]);
}

#[test]
fn interpolate_does_not_bridge_a_gap_an_empty_or_an_end() {
    let s = 1_000_000_000;
    let port = interpolate(200_000_000);
    let gap = "the nearest samples are 2.05 s apart around the stamp, 0.2 s allowed";
    let offers = [vec![V(s, 1.0)], vec![V(s / 2, 0.0), V(s / 2 + 2_050_000_000, 1.0)]];
    check(&[plain(EACH), plain(port)], &offers, &[&format!("{s}: skipped by node: input \"port\": {gap}")]);
    check(&[plain(EACH), optional(port)], &offers, &[&format!("{s}: 1 <{gap}>")]);

    let offers = [vec![V(5, 1.0), V(15, 2.0), V(25, 3.0)], vec![V(0, 0.0), Lost(10), V(20, 20.0)]];
    let last = "25: 3 <the last sample of from.wire is 5 ns before the stamp>";
    check(&[plain(EACH), optional(port)], &offers, &["5: 1 <lost>", "15: 2 <lost>", last]);
    let before = "5: 1 <the first sample of from.wire is 15 ns after the stamp>";
    check(&[plain(EACH), optional(port)], &[vec![V(5, 1.0)], vec![V(20, 20.0)]], &[before]);
}

#[test]
fn once_is_available_at_every_firing_and_a_second_value_is_an_error() {
    let offers = [vec![V(1, 1.0), V(2, 2.0)], vec![V(9, 90.0)]];
    check(&[plain(EACH), plain(Join::Once)], &offers, &["1: 1 90", "2: 2 90"]);
    let none = |stamp: i64| format!("{stamp}: skipped by node: input \"port\": no item ever came on from.wire");
    check(&[plain(EACH), plain(Join::Once)], &[vec![V(1, 1.0), V(2, 2.0)], vec![]], &[&none(1), &none(2)]);

    let mut joiner = Joiner::new("node".into(), vec![plain(EACH), plain(Join::Once)]);
    let two = items(&[V(1, 1.0), V(2, 2.0), Lost(3)]);
    assert_eq!(joiner.offer(1, two[0].clone()), Ok(()));
    assert_eq!(joiner.offer(1, two[1].clone()), Err(SecondItem { port: "port", number: 1 }));
    assert_eq!(joiner.offer(1, two[2].clone()), Ok(()), "the empty of a producer that failed later");
}

#[test]
fn a_node_with_constants_only_fires_once() {
    let offers = [vec![V(3, 1.0)], vec![V(8, 2.0)]];
    check(&[plain(Join::Once), plain(Join::Once)], &offers, &["8: 1 2"]);
    let none = "3: skipped by node: input \"port\": no item ever came on from.wire";
    check(&[plain(Join::Once), plain(Join::Once)], &[vec![V(3, 1.0)], vec![]], &[none]);
}

#[test]
fn ports_that_are_not_wired_are_absent_and_unused_ones_are_drained() {
    let unwired = PortSpec { wire: None, ..optional(EACH) };
    let unused = PortSpec { unused: true, ..optional(EACH) };
    let ports = [plain(EACH), unwired, unused];
    let offers = [vec![V(1, 1.0)], vec![], vec![V(1, 1.0), V(2, 2.0)]];
    check(&ports, &offers, &["1: 1 <nothing is wired to it> <the node does not use it>"]);
}

#[test]
fn samplers_release_samples_that_the_triggers_have_passed() {
    // Hundreds of samples before the first trigger: progress of the trigger's wire releases them.
    let mut joiner = Joiner::new("node".into(), vec![plain(EACH), plain(interpolate(10))]);
    for item in items(&(0..500).map(|i| V(i, i as f64)).collect::<Vec<_>>()) {
        assert!(joiner.wants(1), "stuck before sample {}", item.number);
        let stamp_ns = item.stamp_ns;
        joiner.offer(1, item).unwrap();
        joiner.progress(0, stamp_ns);
        assert!(matches!(joiner.step(), Step::Wait));
    }
}

fn wire() -> impl Strategy<Value = Vec<Offer>> {
    let offer = (0i64..6, -9i32..9, 0u8..6);
    proptest::collection::vec(offer, 0..12).prop_map(|steps| {
        let mut now = 0;
        let offer = |(step, x, kind): (i64, i32, u8)| {
            now += step;
            if kind == 0 { Lost(now) } else { V(now, x.into()) }
        };
        steps.into_iter().map(offer).collect()
    })
}

#[test]
fn latest_may_look_a_stated_time_ahead_and_takes_what_is_there_at_the_end() {
    let ahead = Join::LatestAfter { after_ns: 5 };
    let offers = [vec![V(1, 1.0), V(5, 5.0), V(7, 7.0)], vec![V(2, 20.0), V(5, 50.0), V(6, 60.0), V(11, 110.0)]];
    check(&[plain(EACH), plain(ahead)], &offers, &["1: 1 60", "5: 5 60", "7: 7 110"]);
    let first = "1: 1 <the first sample of from.wire is 6 ns after the stamp>";
    let offers = [vec![V(1, 1.0), V(3, 3.0)], vec![V(7, 70.0), Lost(8)]];
    check(&[plain(EACH), optional(ahead)], &offers, &[first, "3: 3 <lost>"]);
    check(&[plain(EACH), optional(ahead)], &[vec![V(3, 3.0)], vec![V(4, 40.0)]], &["3: 3 40"]);
}

fn join() -> impl Strategy<Value = Join> {
    prop_oneof![
        3 => Just(EACH),
        1 => Just(collect(2)),
        1 => Just(ALL),
        2 => (0i64..4).prop_map(stamp),
        2 => Just(Join::Latest),
        1 => (1i64..9).prop_map(|after_ns| Join::LatestAfter { after_ns }),
        2 => (1i64..9).prop_map(interpolate),
        1 => Just(Join::Previous),
        1 => (1u32..4, 1u32..5).prop_map(|(n, step)| Join::CollectEvery { n, step }),
        1 => (1i64..9, 1i64..9).prop_map(|(span_ns, step_ns)| Join::CollectSpan { span_ns, step_ns }),
    ]
}

#[test]
fn a_stamp_port_takes_the_newest_up_to_the_stamp_and_not_a_later_one_that_is_nearer() {
    let offers = [vec![V(30, 1.0), V(38, 2.0), V(41, 3.0)], vec![V(40, 10.0)]];
    check(&[plain(stamp(15)), plain(stamp(15))], &offers, &["40: 2 10"]);
    assert_eq!(
        run(&[plain(stamp(15)), plain(stamp(15))], &offers, 0..).1,
        [2, 0],
        "the first and the last had no partner"
    );
}

#[test]
fn constants_do_not_wait_for_the_end_of_what_is_sampled() {
    let mut joiner = Joiner::new("node".into(), vec![plain(Join::Once), plain(Join::Latest)]);
    joiner.offer(0, items(&[V(3, 1.0)]).remove(0)).unwrap();
    for item in items(&[V(2, 20.0), V(7, 70.0)]) {
        joiner.offer(1, item).unwrap();
    }
    let Step::Activate(activation) = joiner.step() else { panic!("it waits") };
    assert_eq!(describe(joiner.joined(), &activation), "3: 1 20");
}

#[test]
fn only_a_node_in_lock_step_knows_which_item_it_lacks() {
    let mut joiner = Joiner::new("node".into(), vec![plain(EACH), plain(EACH)]);
    assert!(joiner.lacks_item());
    joiner.offer(0, items(&[V(1, 1.0)]).remove(0)).unwrap();
    assert!(joiner.lacks_item());
    joiner.offer(1, items(&[V(1, 2.0)]).remove(0)).unwrap();
    assert!(!joiner.lacks_item());
    assert!(!Joiner::new("node".into(), vec![plain(EACH), plain(Join::Latest)]).lacks_item());
    // An item that has moved to its port, as not all were there, is not lacking.
    let mut joiner = Joiner::new("node".into(), vec![plain(EACH), plain(EACH)]);
    joiner.offer(0, items(&[V(1, 1.0)]).remove(0)).unwrap();
    assert!(matches!(joiner.step(), Step::Wait) && joiner.lacks_item());
    joiner.offer(1, items(&[V(1, 2.0)]).remove(0)).unwrap();
    assert!(!joiner.lacks_item());
}

#[test]
fn durations_are_written_in_the_unit_that_suits_them() {
    for (ns, said) in [
        (-5, "-5 ns"),
        (999, "999 ns"),
        (1_000, "0.001 ms"),
        (12_500_000, "12.5 ms"),
        (99_999_999, "100 ms"),
        (100_000_000, "0.1 s"),
        (2_050_000_000, "2.05 s"),
    ] {
        assert_eq!(span(ns), said);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    /// Determinism of a Kahn network: what fires depends on what arrives, not on when. `run` checks that no activation
    /// precedes the promised progress.
    #[test]
    fn activations_do_not_depend_on_the_order_of_offers(
        ports in proptest::collection::vec((join(), any::<bool>(), wire()), 1..4),
        seed in any::<u64>(),
    ) {
        let mut specs: Vec<_> = ports.iter().map(|(j, o, _)| if *o { optional(*j) } else { plain(*j) }).collect();
        if !specs.iter().any(|s| s.join.triggers()) {
            specs[0].join = EACH;
        }
        let offers: Vec<_> = ports.into_iter().map(|(.., wire)| wire).collect();
        let mut state = seed | 1;
        let random = std::iter::repeat_with(move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 33) as usize
        });
        let expected = run(&specs, &offers, 0..);
        prop_assert_eq!(run(&specs, &offers, random), expected);
    }

    /// The fast path of nodes in lock step agrees with the general rules.
    #[test]
    fn lock_step_agrees_with_the_general_rules(wires in proptest::collection::vec(wire(), 1..4)) {
        let ports = vec![plain(EACH); wires.len()];
        let by_rules = run_like_a_node(&ports, &wires, false);
        prop_assert_eq!(run_like_a_node(&ports, &wires, true), by_rules.clone());
        prop_assert_eq!(run(&ports, &wires, 0..).0, by_rules);
    }

    /// Every item of a stepping port is part of exactly one activation, or counted as unmatched.
    #[test]
    fn each_loses_nothing(a in wire(), b in wire()) {
        let (fired, unmatched) = run(&[plain(EACH), plain(EACH)], &[a.clone(), b.clone()], 0..);
        prop_assert_eq!(fired.len(), a.len().min(b.len()));
        prop_assert_eq!(unmatched, [(a.len() - fired.len()) as u64, (b.len() - fired.len()) as u64]);
    }
}
