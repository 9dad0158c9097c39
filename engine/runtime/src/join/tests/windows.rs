//! Windows of `collect`, and several wires to one port.

use super::*;

fn every(n: u32, step: u32) -> Join {
    Join::CollectEvery { n, step }
}

fn span(span_ns: i64, step_ns: i64) -> Join {
    Join::CollectSpan { span_ns, step_ns }
}

fn further(join: Join) -> PortSpec {
    PortSpec { continues: true, wire: Some("other.wire".into()), ..plain(join) }
}

fn numbers(n: i64) -> Vec<Offer> {
    (1..=n).map(|i| V(i, i as f64)).collect()
}

#[test]
fn windows_of_items_overlap_or_leave_items_out() {
    check(&[plain(every(3, 1))], &[numbers(5)], &["3: [1 2 3]", "4: [2 3 4]", "5: [3 4 5]"]);
    let rest = "6: skipped by node: input \"port\": 2 of 3 items came before the end";
    check(&[plain(every(3, 2))], &[numbers(7)], &["3: [1 2 3]", "5: [3 4 5]", "7: [5 6 7]"]);
    check(&[plain(every(3, 2))], &[numbers(6)], &["3: [1 2 3]", "5: [3 4 5]", rest]);
    check(&[plain(every(2, 3))], &[numbers(6)], &["2: [1 2]", "5: [4 5]"]);
    let rest = "7: skipped by node: input \"port\": 1 of 2 items came before the end";
    check(&[plain(every(2, 3))], &[numbers(7)], &["2: [1 2]", "5: [4 5]", rest]);
    let few = "2: skipped by node: input \"port\": 2 of 3 items came before the end";
    check(&[plain(every(3, 1))], &[numbers(2)], &[few]);
}

#[test]
fn an_empty_skips_every_window_that_holds_it() {
    let offers = [vec![V(1, 1.0), Lost(2), V(3, 3.0), V(4, 4.0)]];
    let lost = |stamp: i64| format!("{stamp}: skipped by marker: lost");
    check(&[plain(every(2, 1))], &offers, &[&lost(2), &lost(3), "4: [3 4]"]);
    check(&[optional(every(2, 1))], &offers, &["2: [1 (lost)]", "3: [(lost) 3]", "4: [3 4]"]);
}

#[test]
fn windows_in_time_begin_with_the_first_item_and_fire_where_they_hold_a_new_one() {
    let offers = [vec![V(10, 1.0), V(14, 2.0), V(20, 3.0), V(29, 4.0), V(47, 5.0)]];
    // [10, 20), [20, 30), [30, 40) is empty, [40, 50).
    check(&[plain(span(10, 10))], &offers, &["14: [1 2]", "29: [3 4]", "47: [5]"]);
    // [10, 20), [15, 25), [20, 30), [25, 35) and [30, 40) hold nothing new, [35, 45) nothing, [40, 50).
    check(&[plain(span(10, 5))], &offers, &["14: [1 2]", "20: [3]", "29: [3 4]", "47: [5]"]);
    // [10, 15), [30, 35), [50, 55): what lies between is left out.
    check(&[plain(span(5, 20))], &offers, &["14: [1 2]"]);
    check(&[plain(span(5, 20))], &[vec![V(10, 1.0), V(29, 2.0), V(30, 3.0)]], &["10: [1]", "30: [3]"]);
}

#[test]
fn a_window_in_time_fires_as_soon_as_nothing_more_can_lie_in_it() {
    let mut joiner = Joiner::new("node".into(), vec![plain(span(10, 10))]);
    joiner.offer(0, items(&[V(5, 1.0)]).remove(0)).unwrap();
    joiner.progress(0, 14);
    assert!(matches!(joiner.step(), Step::Wait), "an item at 14 may come");
    assert_eq!(joiner.progress_out(), 5, "the window may end with the item it has");
    joiner.progress(0, 15);
    assert!(matches!(joiner.step(), Step::Activate(Activation { stamp_ns: 5, skip: None })));
    assert_eq!(joiner.progress_out(), 15, "the next has an item to come");
}

#[test]
fn several_wires_are_collected_in_step_and_in_their_order() {
    let offers = [numbers(3), vec![V(1, 10.0), V(5, 20.0), V(6, 30.0), V(7, 40.0)]];
    check(&[plain(collect(1)), further(collect(1))], &offers, &["1: [1 10]", "5: [2 20]", "6: [3 30]"]);
    let missing = "7: skipped by node: input \"port\": 1 of 2 items of from.wire came before the end";
    check(&[plain(collect(2)), further(collect(2))], &offers, &["5: [1 2 10 20]", missing]);
    check(&[plain(ALL), further(ALL)], &offers, &["7: [1 2 3 10 20 30 40]"]);
    let ports = [plain(EACH), plain(collect(1)), further(collect(1)), plain(Join::Once)];
    let offers = [numbers(2), numbers(2), vec![V(1, 10.0), Lost(2)], vec![V(0, 7.0)]];
    check(&ports, &offers, &["1: 1 [1 10] 7", "2: skipped by marker: lost"]);
    assert_eq!(run(&[plain(collect(1)), further(collect(1))], &[numbers(3), numbers(1)], 0..).1, [2, 0]);
}

#[test]
fn an_optional_port_of_several_wires_is_absent_where_one_has_nothing() {
    let ports = [plain(EACH), optional(collect(1)), PortSpec { optional: true, ..further(collect(1)) }];
    let offers = [numbers(2), numbers(2), vec![Lost(1)]];
    let ended = "2: 2 <other.wire ended after 1 item>";
    check(&ports, &offers, &["1: 1 [1 (lost)]", ended]);
}

/// The windows by their definition.
fn windows(items: &[(i64, f64)], join: Join) -> Vec<Vec<f64>> {
    let mut out: Vec<Vec<f64>> = Vec::new();
    let values = |items: &[(i64, f64)]| items.iter().map(|(_, x)| *x).collect::<Vec<_>>();
    match join {
        Join::CollectEvery { n, step } => {
            let begins = (0..items.len()).step_by(step as usize);
            let whole = begins.filter_map(|begin| items.get(begin..begin + n as usize));
            out.extend(whole.map(values));
        }
        Join::CollectSpan { span_ns, step_ns } => {
            let (Some(first), Some(last)) = (items.first(), items.last()) else { return out };
            let mut newest = None;
            for begin in (first.0..=last.0).step_by(step_ns as usize) {
                let within: Vec<usize> =
                    (0..items.len()).filter(|i| (begin..begin + span_ns).contains(&items[*i].0)).collect();
                if within.last().copied() > newest {
                    newest = within.last().copied();
                    out.push(within.iter().map(|i| items[*i].1).collect());
                }
            }
        }
        _ => unreachable!("no windows"),
    }
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn windows_are_those_of_their_definition(
        steps in proptest::collection::vec(0i64..7, 0..30),
        (n, step, in_time) in (1u32..6, 1u32..8, any::<bool>()),
    ) {
        let mut now = 100;
        let stamps = steps.iter().map(|step| { now += step; now });
        let items: Vec<(i64, f64)> = stamps.zip(0..).map(|(at, i)| (at, f64::from(i))).collect();
        let join = if in_time { span(i64::from(n) * 3, i64::from(step) * 2) } else { every(n, step) };
        let offers = [items.iter().map(|(at, x)| V(*at, *x)).collect()];
        let fired: Vec<_> = run(&[plain(join)], &offers, 0..).0;
        let fired = fired.iter().filter(|fired| !fired.contains("skipped"));
        let found: Vec<String> = fired.map(|fired| fired.split_once(": ").unwrap().1.to_owned()).collect();
        let text = |window: &Vec<f64>| format!("[{}]", window.iter().map(f64::to_string).collect::<Vec<_>>().join(" "));
        prop_assert_eq!(found, windows(&items, join).iter().map(text).collect::<Vec<_>>());
    }

    #[test]
    fn several_wires_fire_alike_whatever_the_order_of_offers(
        wires in proptest::collection::vec(wire(), 2..4),
        n in 1u32..3,
        seed in any::<usize>(),
    ) {
        let join = if n == 2 { ALL } else { collect(n) };
        let ports: Vec<_> = (0..wires.len()).map(|i| if i == 0 { plain(join) } else { further(join) }).collect();
        let expected = run(&ports, &wires, 0..);
        let random = (0usize..).map(|i| (i.wrapping_mul(seed | 1) ^ (seed >> 7)).rotate_left(17) >> 3);
        prop_assert_eq!(run(&ports, &wires, random.chain(0..)), expected);
    }
}
