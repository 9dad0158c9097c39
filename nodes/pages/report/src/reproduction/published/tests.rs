use super::{super::EXPERIMENTS, *};

/// The paper's numbers, typed a second time: id, section, words of the definition, numbers as shown.
const FACTS: [(&str, &str, &str, &[&str]); 23] = [
    ("calibration", "3.1", "hole of a printed check piece", &["0.3 ± 0.2 (0.1 to 0.8)"]),
    (
        "tre_camera",
        "3.2.1",
        "five holes touched by a stylus, registered by camera",
        &["0.5 ± 0.1", "0.4 ± 0.04", "0.9 ± 0.1"],
    ),
    ("within_points", "3.2.1", "SD of the distance within the points", &["0.2 ± 0.1"]),
    ("within_procedures", "3.2.1", "SD of the distance within the procedures", &["0.2"]),
    ("tre_stylus", "3.2.1", "palpation with a tracked stylus", &["0.5 ± 0.1", "0.5 ± 0.2", "1.3 ± 0.03"]),
    ("tre_camera_norm", "4", "camera as one number", &["0.9 ± 0.2"]),
    ("tre_stylus_norm", "4", "stylus as one number", &["1.26 ± 0.4 (0.6 to 1.8)"]),
    ("time_camera", "3.2.1", "laser and camera", &["2.5 ± 0.4"]),
    ("time_stylus", "3.2.1", "stylus", &["2.8 ± 0.4"]),
    ("time_calibration", "2", "calibration", &["40"]),
    ("time_scan", "2", "20,000 points", &["50"]),
    ("cut_camera", "3.2.2", "greatest cloud-to-cloud distance", &["0.1 ± 0.02"]),
    ("cut_stylus", "3.2.2", "greatest cloud-to-cloud distance", &["0.2 ± 0.06"]),
    ("placements", "3.2.3", "200 simulated placements", &["2 ± 0.1", "1 ± 0.1", "4.6 ± 0.03"]),
    ("correlation", "3.2.3", "distance of the first point from the malleolus", &["0.98"]),
    ("fragments", "3.2.3, Fig. 7", "greatest cloud-to-cloud distance", &["0.8 ± 0.5"]),
    ("fragments_max", "3.2.3, Fig. 7", "the greatest of all placements", &["1.9"]),
    ("table_1", "4, Table 1", "for the same initialisation", &["5.5", "3.1", "2.5", "2.3", "2.2", "1"]),
    ("laser", "4", "located 50 times", &["0.8"]),
    ("laser_sd", "4", "SD along an axis", &["0.6", "0.7", "0.1"]),
    ("in_vivo", "3.3", "ruled and located by the laser", &["1.9, 1.7, 3.6"]),
    ("in_vivo_mean", "3.3", "average", &["2.3"]),
    ("precision", "4", "wanted by the field", &["at most 2"]),
];

#[test]
fn the_papers_numbers_and_definitions_are_those_of_a_second_table_and_each_has_a_row() {
    let (published, file) = (Published::new(), toml::from_str::<File>(include_str!("../published.toml")).unwrap());
    let known: Vec<_> = published.fact.iter().map(|fact| fact.id.as_str()).collect();
    assert_eq!(known, FACTS.map(|(id, ..)| id));
    for (fact, (id, section, words, numbers)) in published.fact.iter().zip(FACTS) {
        assert_eq!(fact.section, section, "{id}");
        assert!(fact.what.contains(words), "{id}: {}", fact.what);
        let shown: Vec<_> = (0..fact.n()).map(|k| fact.text(k)).collect();
        assert_eq!(shown, numbers, "{id}");
        assert!([&fact.mean, &fact.sd].iter().all(|list| list.is_empty() || list.len() == fact.n()), "{id}");
        let is_compared = file.row.iter().any(|row| row.fact.as_deref() == Some(id));
        assert!(is_compared || published.time.iter().any(|time| time.fact == id), "{id} has no row");
    }
    for row in &file.row {
        assert!(row.fact.as_deref().is_none_or(|id| published.fact(id).is_some()), "{:?} is no fact", row.fact);
    }
}

#[test]
fn every_row_names_an_experiment_and_has_a_sound_spread() {
    let published = Published::new();
    let shown = published.reading.iter().flat_map(|reading| &reading.shows).map(|shown| &shown.experiment);
    let paired = published.pair.iter().flat_map(|pair| [&pair.first, &pair.second]);
    let tables = published.table.iter().map(|table| &table.experiment);
    let rows = || published.row.iter().chain(&published.independent);
    for name in rows().map(|row| &row.experiment).chain(shown).chain(paired).chain(tables) {
        assert!(EXPERIMENTS.contains(&name.as_str()), "{name}");
    }
    for row in rows() {
        assert!(row.spread.is_none_or(|[low, high]| low < high), "{}: {:?}", row.what, row.spread);
        assert!(!row.what.is_empty() && !row.theirs.is_empty() && !row.section.contains('*'), "{row:?}");
    }
    // Six counts, by three readings of the stop rule and by ours, carried back and in place.
    assert_eq!(rows().filter(|row| row.section == "4, Table 1").count(), 48);
    let first = rows().find(|row| row.section == "4, Table 1").unwrap();
    assert_eq!((&first.setting["n_points"], &first.setting["registration"]), (&100.into(), &"mean below 1e-5".into()));
}

#[test]
fn a_number_outside_the_spread_is_shown_with_its_side() {
    let judged = |row: &PublishedNumber, ours| match row.judged(ours) {
        Some(Judged::Within(text) | Judged::Outside(text)) => text,
        None => "not judged".into(),
    };
    let fact =
        |text: &str| -> Fact { toml::from_str(&format!("id = 'a'\nsection = '1'\nwhat = 'b'\n{text}")).unwrap() };
    let of = |fact: &Fact| PublishedNumber { spread: fact.spread(0), ..PublishedNumber::default() };
    let with_sd = of(&fact("mean = [0.3]\nsd = [0.2]"));
    let texts = [0.3, 0.6, 0.05].map(|ours| judged(&with_sd, ours));
    assert_eq!(texts, ["yes (0.1 to 0.5)", "**above** 0.1 to 0.5", "**below** 0.1 to 0.5"]);
    let without = of(&fact("mean = [0.9]"));
    assert_eq!([0.2, 0.5].map(|ours| judged(&without, ours)), ["**below** 0.45 to 1.35", "yes (0.45 to 1.35)"]);
    assert_eq!(judged(&of(&fact("max = 2.0")), 2.5), "**above** 0 to 2");
    assert_eq!(judged(&of(&fact("values = [1.9, 1.7, 3.6]")), 2.0), "yes (1.7 to 3.6)");
    let size = PublishedNumber { magnitude: true, ..of(&fact("mean = [0.98]\nwithin = [0.9, 1.0]")) };
    assert_eq!(judged(&size, -0.95), "yes (0.9 to 1)");
    assert_eq!(judged(&PublishedNumber::default(), 1.0), "not judged");
}
