//! What the joins answer to single offers.

use super::*;

fn joiner(ports: &[PortSpec], offers: &[Vec<Offer>]) -> Joiner {
    let mut joiner = Joiner::new("node".into(), ports.to_vec());
    joiner.disable_lock_step();
    for (port, offers) in offers.iter().enumerate() {
        for item in items(offers) {
            joiner.offer(port, item).unwrap();
        }
    }
    joiner
}

/// The next activation; none if the joins wait.
fn next(joiner: &mut Joiner) -> Option<String> {
    match joiner.step() {
        Step::Activate(activation) => Some(describe(joiner.joined(), &activation)),
        Step::Wait => None,
        Step::Ended => panic!("it has ended"),
    }
}

#[test]
fn the_promised_progress_is_that_of_the_triggers_that_decide() {
    let of = |ports: &[PortSpec], offers: &[Vec<Offer>], progress: &[StampNs]| {
        let mut joiner = joiner(ports, offers);
        for (port, stamp_ns) in progress.iter().enumerate() {
            joiner.progress(port, *stamp_ns);
        }
        joiner.progress_out()
    };
    let none = Vec::new;
    // A waiting item decides, or else the progress: all plain ports must have theirs.
    assert_eq!(of(&[plain(EACH), plain(EACH)], &[vec![V(5, 1.0)], none()], &[7, 9]), 9);
    assert_eq!(of(&[plain(EACH), plain(EACH)], &[vec![V(5, 1.0)], none()], &[7, 3]), 5);
    // An optional port may end without another item.
    assert_eq!(of(&[plain(EACH), optional(EACH)], &[vec![V(5, 1.0)], none()], &[5, 9]), 5);
    assert_eq!(of(&[plain(EACH), optional(EACH)], &[none(), vec![V(7, 1.0)]], &[3, 7]), 7);
    assert_eq!(of(&[optional(EACH), optional(EACH)], &[none(), none()], &[8, 3]), 3);
    assert_eq!(of(&[plain(EACH), plain(Join::Latest), plain(stamp(0))], &[none(), none(), none()], &[4, 9, 8]), 4);
    assert_eq!(of(&[plain(stamp(0)), plain(stamp(0)), optional(stamp(0))], &[none(), none(), none()], &[4, 9, 20]), 9);
    assert_eq!(
        of(&[optional(stamp(0)), optional(stamp(0)), plain(Join::Latest)], &[none(), none(), none()], &[9, 4, 2]),
        4
    );
    assert_eq!(of(&[plain(Join::Once)], &[none()], &[9]), StampNs::MIN);
    // A port that has ended decides no longer, and nothing precedes the last activation.
    let mut joiner = joiner(&[plain(EACH), optional(EACH)], &[vec![V(5, 1.0)], vec![V(9, 2.0)]]);
    assert_eq!(next(&mut joiner).unwrap(), "9: 1 2");
    assert_eq!(joiner.progress_out(), 9);
    joiner.end(0);
    assert!(joiner.progress(0, 30) && joiner.progress(1, 20));
    assert_eq!(joiner.progress_out(), 20);
}

#[test]
fn progress_is_news_once() {
    let mut joiner = Joiner::new("node".into(), vec![plain(EACH)]);
    assert!(joiner.progress(0, 5) && !joiner.progress(0, 5) && !joiner.progress(0, 4) && joiner.progress(0, 6));
    assert_eq!(joiner.progress_out(), 6);
}

#[test]
fn a_port_asks_for_no_more_items_than_decide_the_next_activation() {
    for (join, n) in [(EACH, 1), (Join::Latest, 1), (interpolate(9), 1), (stamp(3), 2), (collect(3), 3)] {
        let mut joiner = Joiner::new("node".into(), vec![optional(join)]);
        for item in items(&vec![V(1, 1.0); n]) {
            assert!(joiner.wants(0), "{join:?} before item {}", item.number);
            joiner.offer(0, item).unwrap();
        }
        assert!(!joiner.wants(0), "{join:?}");
    }
    for spec in [plain(ALL), plain(Join::Once), PortSpec { unused: true, ..optional(EACH) }] {
        let mut joiner = Joiner::new("node".into(), vec![spec]);
        joiner.offer(0, items(&[V(1, 1.0)]).remove(0)).unwrap();
        assert!(joiner.wants(0), "without limit");
    }
}

#[test]
fn items_after_the_end_of_a_node_are_unmatched_and_after_a_stop_they_are_not() {
    let ports = [plain(EACH), plain(EACH), plain(Join::Latest)];
    let late = || items(&[V(3, 1.0), V(4, 2.0)]);
    let mut ended = joiner(&ports, &[vec![V(1, 1.0)], vec![], vec![V(1, 9.0), V(9, 9.0)]]);
    ended.end(1);
    assert!(matches!(ended.step(), Step::Ended));
    let mut stopped = joiner(&ports, &[vec![V(1, 1.0)], vec![], vec![]]);
    stopped.stop();
    assert!(matches!(stopped.step(), Step::Ended));
    for (joiner, expected) in [(&mut ended, [3, 0, 0]), (&mut stopped, [0, 0, 0])] {
        for port in [0, 2] {
            for item in late() {
                assert!(joiner.wants(port), "an ended node drains its ports");
                joiner.offer(port, item).unwrap();
            }
        }
        assert_eq!([0, 1, 2].map(|port| joiner.unmatched(port)), expected);
    }
}

#[test]
fn a_sample_is_decided_as_soon_as_nothing_can_change_it() {
    let trigger = || vec![V(10, 1.0)];
    let mut exact = joiner(&[plain(EACH), plain(interpolate(9))], &[trigger(), vec![V(10, 100.0)]]);
    assert_eq!(next(&mut exact), None, "another sample at 10 may come");
    exact.progress(1, 11);
    assert_eq!(next(&mut exact).unwrap(), "10: 1 100");
    let mut lost = joiner(&[plain(EACH), plain(interpolate(9))], &[trigger(), vec![Lost(5)]]);
    lost.progress(1, 11);
    assert_eq!(next(&mut lost).unwrap(), "10: skipped by marker: lost");
    let mut between = joiner(&[plain(EACH), plain(interpolate(9))], &[trigger(), vec![V(5, 50.0)]]);
    between.progress(1, 11);
    assert_eq!(next(&mut between), None, "the next sample is needed");
    let mut latest = joiner(&[plain(EACH), plain(Join::Latest)], &[trigger(), vec![V(5, 50.0)]]);
    latest.progress(1, 10);
    assert_eq!(next(&mut latest), None, "another sample at 10 may come");
    latest.progress(1, 11);
    assert_eq!(next(&mut latest).unwrap(), "10: 1 50");
    let mut first = joiner(&[plain(EACH), plain(Join::Latest)], &[trigger(), vec![]]);
    first.progress(1, 11);
    assert_eq!(next(&mut first), None, "the reason names the distance of the first sample");
}

#[test]
fn a_stamp_port_takes_what_is_exactly_at_its_tolerance() {
    check(&[plain(stamp(2)), plain(stamp(2))], &[vec![V(10, 1.0)], vec![V(8, 2.0)]], &["10: 1 2"]);
    check(&[plain(EACH), plain(stamp(2))], &[vec![V(10, 1.0)], vec![V(8, 2.0)]], &["10: 1 2"]);
    check(&[plain(EACH), plain(stamp(2))], &[vec![V(10, 1.0)], vec![V(12, 2.0)]], &["12: 1 2"]);
    let mut joiner = joiner(&[plain(EACH), plain(stamp(9))], &[vec![V(10, 1.0)], vec![V(8, 2.0)]]);
    joiner.progress(1, 11);
    assert_eq!(next(&mut joiner), None, "an item at 11 would be nearer");
    joiner.progress(1, 12);
    assert_eq!(next(&mut joiner).unwrap(), "10: 1 2", "the earlier of two as near");
}

#[test]
fn what_is_absent_is_told_for_each_port() {
    let mut joiner = joiner(
        &[plain(EACH), optional(Join::Latest), optional(collect(2))],
        &[vec![V(5, 1.0)], vec![], vec![V(1, 1.0), Lost(2)]],
    );
    joiner.end(1);
    assert_eq!(next(&mut joiner).unwrap(), "5: 1 <no item ever came on from.wire> [1 (lost)]");
    let absent: Vec<_> = joiner.take_absent().map(|(port, empty)| (port, empty.reason.clone())).collect();
    let expected = ["no item ever came on from.wire", "lost"].map(|reason| ("port", reason.to_owned()));
    assert_eq!(absent, expected);
    assert_eq!(joiner.take_absent().count(), 0);
}

#[test]
fn the_buffer_of_a_collection_is_kept_for_the_next() {
    let mut joiner = joiner(&[plain(collect(2))], &[vec![V(1, 1.0), V(2, 2.0)]]);
    assert_eq!(next(&mut joiner).unwrap(), "2: [1 2]");
    assert_eq!(joiner.ports[0].spare_capacity(), 0, "in use");
    joiner.release();
    assert!(joiner.ports[0].spare_capacity() >= 2);
}
