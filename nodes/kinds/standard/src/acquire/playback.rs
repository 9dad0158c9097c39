use osteoflow_geometry::StampNs;
use osteoflow_node::Emission;

/// An answer on one port at one stamp. `T` may be a description from which the answer is made later.
pub(crate) struct Event<T> {
    pub(crate) stamp_ns: StampNs,
    pub(crate) port: usize,
    pub(crate) body: T,
}

/// Events in the order in which they are played.
pub(crate) type Playback<T> = std::vec::IntoIter<Event<T>>;

/// Orders events by stamp, then by port, then as they were added.
pub(crate) fn in_order<T>(mut events: Vec<Event<T>>) -> Playback<T> {
    events.sort_by_key(|event| (event.stamp_ns, event.port));
    events.into_iter()
}

/// An empty that says why for each gap in a stream longer than `lost_after_ns`, at the stamp at which the limit passes.
///
/// `end_ns` is the end of the recording, so a stream that stops early has a gap too.
pub(crate) fn silences(
    stamps: &[StampNs],
    lost_after_ns: StampNs,
    end_ns: StampNs,
    what: &str,
) -> Vec<(StampNs, Emission)> {
    let mut sorted = stamps.to_vec();
    sorted.sort_unstable();
    let next = sorted.iter().skip(1).map(|&s| (s, "was seen again")).chain([(end_ns, "the recording ended")]);
    let mut out = Vec::new();
    for (&last, (next, then)) in sorted.iter().zip(next) {
        if next - last > lost_after_ns {
            let seconds = (next - last) as f64 * 1e-9;
            let reason = format!("{what} was not seen for {seconds:.2} s, until it {then}").replace("it the", "the");
            out.push((last + lost_after_ns, Emission::Empty(reason)));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_that_pauses_or_stops_early_is_lost_from_the_limit_on() {
        let lost = silences(&[0, 50, 100, 700, 750], 200, 1000, "the marker");
        let stamps: Vec<_> = lost.iter().map(|(stamp, _)| *stamp).collect();
        assert_eq!(stamps, [300, 950]);
        assert!(silences(&[0, 50], 200, 60, "the marker").is_empty());
    }

    #[test]
    fn events_come_by_stamp_then_by_port() {
        let event = |stamp_ns, port| Event { stamp_ns, port, body: () };
        let order: Vec<_> =
            in_order(vec![event(2, 0), event(1, 1), event(1, 0)]).map(|e| (e.stamp_ns, e.port)).collect();
        assert_eq!(order, [(1, 0), (1, 1), (2, 0)]);
    }
}
