//! The join `previous`: what the wire carried for the firing before.

use super::*;

const NONE: &str = "<from.wire carries nothing before the first firing>";

#[test]
fn previous_brings_the_item_of_the_firing_before_and_nothing_to_the_first() {
    let offers = [vec![V(1, 1.0), V(2, 2.0), V(4, 3.0)], vec![V(1, 10.0), V(2, 20.0), V(4, 30.0)]];
    let expected = [&format!("1: 1 {NONE}"), "2: 2 10", "4: 3 20"];
    check(&[plain(EACH), optional(Join::Previous)], &offers, &expected);
}

#[test]
fn an_empty_is_absent_with_its_reason_and_a_wire_that_ended_says_so() {
    let offers = [vec![V(1, 1.0), V(2, 2.0), V(3, 3.0)], vec![Lost(1)]];
    let expected = [&format!("1: 1 {NONE}"), "2: 2 <lost>", "3: 3 <from.wire ended after 1 item>"];
    check(&[plain(EACH), optional(Join::Previous)], &offers, &expected);
    let never = [vec![V(1, 1.0), V(2, 2.0)], vec![]];
    let expected = [&format!("1: 1 {NONE}"), "2: 2 <no item ever came on from.wire>"];
    check(&[plain(EACH), optional(Join::Previous)], &never, &expected);
}

#[test]
fn a_skipped_firing_takes_its_item_too_so_the_numbers_stay() {
    let offers = [vec![Lost(1), Lost(2), V(3, 3.0), V(4, 4.0)], vec![V(1, 10.0), V(2, 20.0), V(3, 30.0)]];
    let expected = ["1: skipped by marker: lost", "2: skipped by marker: lost", "3: 3 20", "4: 4 30"];
    check(&[plain(EACH), optional(Join::Previous)], &offers, &expected);
}

#[test]
fn a_firing_waits_for_the_item_of_the_one_before_and_for_no_later_one() {
    let mut joiner = Joiner::new("node".into(), vec![plain(EACH), optional(Join::Previous)]);
    assert!(joiner.takes_previous && !joiner.in_lock_step);
    let offer = |joiner: &mut Joiner, port, number: usize| {
        let all = items(&[V(1, 1.0), V(2, 2.0), V(3, 3.0)]);
        joiner.offer(port, all[number].clone()).unwrap();
    };
    offer(&mut joiner, 0, 0);
    assert!(matches!(joiner.step(), Step::Activate(_)), "the first waits for nothing");
    offer(&mut joiner, 0, 1);
    assert!(matches!(joiner.step(), Step::Wait), "item 0 has not come");
    assert!(joiner.wants(1));
    offer(&mut joiner, 1, 0);
    assert!(!joiner.wants(1), "one item is enough");
    assert!(matches!(joiner.step(), Step::Activate(Activation { stamp_ns: 2, skip: None })));
}

#[test]
fn previous_triggers_nothing_and_promises_nothing() {
    let mut joiner = Joiner::new("node".into(), vec![plain(EACH), optional(Join::Previous)]);
    joiner.progress(1, 50);
    joiner.progress(0, 7);
    assert_eq!(joiner.progress_out(), 7);
    joiner.end(1);
    assert!(matches!(joiner.step(), Step::Wait), "the end of the wire ends nothing");
    joiner.end(0);
    assert!(matches!(joiner.step(), Step::Ended));
}
