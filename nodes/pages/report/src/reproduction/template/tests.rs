use super::{
    super::{EXPERIMENTS, TIMED},
    *,
};

/// The paper's numbers, typed a second time: section, words of the definition, numbers as shown.
const FACTS: [(&str, &str, &[&str]); 23] = [
    ("3.1", "hole of a printed check piece", &["0.3 ± 0.2 (0.1 to 0.8)"]),
    ("3.2.1", "five holes touched by a stylus, registered by camera", &["0.5 ± 0.1", "0.4 ± 0.04", "0.9 ± 0.1"]),
    ("3.2.1", "SD of the distance within the points", &["0.2 ± 0.1"]),
    ("3.2.1", "SD of the distance within the procedures", &["0.2"]),
    ("3.2.1", "palpation with a tracked stylus", &["0.5 ± 0.1", "0.5 ± 0.2", "1.3 ± 0.03"]),
    ("4", "camera as one number", &["0.9 ± 0.2"]),
    ("4", "stylus as one number", &["1.26 ± 0.4 (0.6 to 1.8)"]),
    ("3.2.1", "a procedure with laser and camera", &["2.5 ± 0.4 min"]),
    ("3.2.1", "a procedure with the stylus", &["2.8 ± 0.4 min"]),
    ("2", "calibration", &["40 s"]),
    ("2", "20,000 points", &["50 ms"]),
    (
        "3.2.2",
        "greatest cloud-to-cloud distance of a fragment cut by slots that the measured assessment points moved, mean; camera",
        &["0.1 ± 0.02"],
    ),
    (
        "3.2.2",
        "greatest cloud-to-cloud distance of a fragment cut by slots that the measured assessment points moved, mean; stylus",
        &["0.2 ± 0.06"],
    ),
    ("3.2.3", "200 simulated placements", &["2 ± 0.1", "1 ± 0.1", "4.6 ± 0.03"]),
    ("3.2.3", "distance of the first point from the malleolus", &["0.98"]),
    ("3.2.3, Fig. 7", "greatest cloud-to-cloud distance of a fragment after such a placement, mean", &["0.8 ± 0.5"]),
    ("3.2.3, Fig. 7", "the greatest of all placements", &["1.9"]),
    ("4, Table 1", "for the same initialisation", &["5.5", "3.1", "2.5", "2.3", "2.2", "1"]),
    ("4", "located 50 times", &["0.8"]),
    ("4", "SD along an axis", &["0.6", "0.7", "0.1"]),
    ("3.3", "ruled and located by the laser", &["1.9, 1.7, 3.6"]),
    ("3.3", "average", &["2.3"]),
    ("4", "wanted by the field", &["at most 2"]),
];

#[test]
fn the_papers_numbers_and_definitions_are_those_of_a_second_table_and_each_has_a_row() {
    let lines: Vec<_> = sections().flatten().filter(|line| line.request.is_some()).collect();
    let mut n = 0;
    for (section, words, numbers) in FACTS {
        let of_fact = |line: &&Line| {
            let cells: Vec<_> = line.before.split(" | ").collect();
            cells[0] == format!("| {section}") && cells[1].contains(words)
        };
        let theirs: Vec<_> = lines.iter().filter(of_fact).map(Line::theirs).collect();
        assert!(!theirs.is_empty(), "{words} has no row");
        assert!(
            theirs.chunks(numbers.len()).all(|shown| shown == numbers),
            "{words}: {theirs:?} instead of {numbers:?}"
        );
        n += theirs.len();
    }
    let is_papers = |line: &&Line| line.before.split(" | ").count() == 4 && line.theirs() != "not given";
    assert_eq!(n, lines.iter().filter(is_papers).count(), "a number of the paper is not in the second table");
}

#[test]
fn every_request_names_an_experiment_and_every_row_has_a_sound_spread() {
    for request in sections().flatten().filter_map(|line| line.request) {
        assert!(request.experiments().iter().all(|name| EXPERIMENTS.contains(name)), "{request:?}");
        assert!(!matches!(&request, Request::Time(time) if !TIMED.contains(&&*time.of)), "{request:?} is not timed");
    }
    for row in rows() {
        let spread = row.number.within.or_else(|| spread(row.theirs));
        assert!(spread.map_or(row.theirs == "not given", |[low, high]| low < high), "{}: {spread:?}", row.what);
        assert!(!row.what.is_empty() && !row.number.path.contains('*'), "{}", row.what);
    }
    // Six counts, by three readings of the stop rule and by ours, carried back and in place.
    let table_1: Vec<_> = rows().filter(|row| row.section == Some("4, Table 1")).collect();
    assert_eq!(table_1.len(), 48);
    let setting = &table_1[0].number.setting;
    assert_eq!((&setting["n_points"], &setting["registration"]), (&100.into(), &"mean below 1e-5".into()));
}

#[test]
fn a_number_outside_the_spread_is_shown_with_its_side() {
    let judged = |number: &Number, theirs: &str, ours: f64| {
        number.judgement(theirs, ours).map_or_else(|| "not judged".into(), |judgement| judgement.text)
    };
    let plain = Number::default();
    let texts = [0.3, 0.6, 0.05].map(|ours| judged(&plain, "0.3 ± 0.2 (0.1 to 0.8)", ours));
    assert_eq!(texts, ["yes (0.1 to 0.5)", "**above** 0.1 to 0.5", "**below** 0.1 to 0.5"]);
    let texts = [0.2, 0.5].map(|ours| judged(&plain, "0.9", ours));
    assert_eq!(texts, ["**below** 0.45 to 1.35", "yes (0.45 to 1.35)"]);
    assert_eq!(judged(&plain, "at most 2", 2.5), "**above** 0 to 2");
    assert_eq!(judged(&plain, "1.9, 1.7, 3.6", 2.0), "yes (1.7 to 3.6)");
    let size = Number { magnitude: true, within: Some([0.9, 1.0]), ..Number::default() };
    assert_eq!(judged(&size, "0.98", -0.95), "yes (0.9 to 1)");
    assert_eq!(judged(&plain, "not given", 1.0), "not judged");
}
