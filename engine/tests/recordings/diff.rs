use super::{
    rewrite::{Layout, copy, rewrite},
    toy::record,
};
use osteoflow_engine::diff::{DiffOptions, DiffReport, diff};
use std::{
    fs,
    path::{Path, PathBuf},
};

const SMALL: Layout = Layout { chunk_bytes: Some(4096), compression: None, shuffle: Some(4), crc: true };

fn of(a: &Path, b: &Path) -> DiffReport {
    diff(a, b, &DiffOptions::default(), &mut |_, _| {}).unwrap()
}

fn recorded(dir: &Path, name: &str, sets: &[&str]) -> PathBuf {
    record(&dir.join(name), sets, 2)
}

#[test]
fn a_changed_parameter_diverges_first_at_the_output_of_its_node_and_nowhere_upstream() {
    let dir = tempfile::tempdir().unwrap();
    let [a, b] = [("a", "1.0"), ("b", "1.0000000000000002")]
        .map(|(name, gain)| recorded(dir.path(), name, &[&format!("cut.gain={gain}")]));
    let report = of(&a, &b);
    let first = report.first.clone().unwrap();
    assert_eq!(
        (first.wire.as_str(), first.item, first.what.field.as_str()),
        ("cut.short", 0, "column samples_mm, row 0, component 1")
    );
    assert_eq!((first.what.ulp, first.what.unit.as_deref()), (Some(1), Some("mm")));
    let names: Vec<_> = report.wires.iter().map(|wire| (wire.wire.as_str(), wire.is_equal())).collect();
    assert_eq!(names, [("beat.wave", true), ("constant.wave", true), ("cut.short", false), ("pass.out", false)]);
    let cut = &report.wires[2];
    // The gain differs by one ulp, so a rounded product differs by at most two.
    assert!(cut.n_differ > 25 && cut.n_differ <= 32 && cut.largest.ulp <= 2, "{cut:#?}");
    assert!(cut.largest.by_unit["mm"] > 0.0 && cut.largest.by_unit["mm"] < 3e-14, "{cut:#?}");
    assert_eq!((report.same_graph, report.sides[0].seed), (Some(false), Some(5)));

    // Within a tolerance they are equal, and the report counts the items that differ.
    let options = DiffOptions { wires: Vec::new(), tolerance: 1e-12 };
    let report = diff(&a, &b, &options, &mut |_, _| {}).unwrap();
    assert!(report.is_equal() && report.wires[2].n_within == cut.n_differ, "{:#?}", report.wires[2]);
    let options = DiffOptions { wires: vec!["beat.*".into()], tolerance: 0.0 };
    assert!(diff(&a, &b, &options, &mut |_, _| {}).unwrap().is_equal());
}

#[test]
fn the_same_items_in_another_file_are_equal() {
    let dir = tempfile::tempdir().unwrap();
    let a = recorded(dir.path(), "a", &[]);
    let b = dir.path().join("b.mcap");
    copy(&a, &b, &SMALL);
    let report = of(&a, &b);
    assert!(report.is_equal() && report.first.is_none(), "{report:#?}");
    assert_eq!(report.same_results, Some(true));
}

#[test]
fn the_first_of_many_differences_is_that_of_the_lowest_item_wherever_it_stands_in_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let a = recorded(dir.path(), "a", &[]);
    let b = dir.path().join("b.mcap");
    rewrite(&a, &b, &SMALL, |topic, header, data| {
        if topic == "/exact/beat.wave" && [7, 9, 30].contains(&header.sequence) {
            let last = data.len() - 1;
            data[last] ^= 0x80;
        }
        true
    });
    let first = of(&a, &b).first.unwrap();
    assert_eq!(
        (first.wire.as_str(), first.item, first.what.field.as_str()),
        ("beat.wave", 7, "column samples_mm, row 49, component 1")
    );
}

#[test]
fn stamps_empties_missing_items_signs_of_zero_and_nan_are_told_apart() {
    let dir = tempfile::tempdir().unwrap();
    let a = recorded(dir.path(), "a", &[]);
    let changed = |name: &str, topic: &'static str, change: &dyn Fn(&mut Vec<u8>) -> bool| {
        let b = dir.path().join(format!("{name}.mcap"));
        rewrite(&a, &b, &SMALL, |found, header, data| found != topic || header.sequence != 3 || change(data));
        of(&a, &b)
    };
    let report = changed("stamp", "/exact/cut.short", &|data| {
        data[8] ^= 1;
        true
    });
    let what = report.first.unwrap().what;
    assert_eq!((what.field.as_str(), what.distance, what.unit.as_deref()), ("stamp", Some(1.0), Some("ns")));
    let report = changed("missing", "/exact/cut.short", &|_| false);
    let first = report.first.unwrap();
    assert_eq!((first.item, first.what.a.as_str(), first.what.b.as_str()), (3, "an item", "none"));
    assert_eq!(report.wires[2].n_only, [1, 0]);
    let put = |bits: u64| {
        move |data: &mut Vec<u8>| {
            let at = data.len() - 8;
            data[at..].copy_from_slice(&bits.to_le_bytes());
            true
        }
    };
    let ends_with = |name: &str, bits: u64| {
        let b = dir.path().join(format!("{name}.mcap"));
        rewrite(&a, &b, &SMALL, |found, header, data| {
            found != "/exact/beat.wave" || header.sequence != 3 || put(bits)(data)
        });
        b
    };
    let [nan, other_nan, zero, minus_zero] =
        [("nan", f64::NAN), ("minus_nan", -f64::NAN), ("zero", 0.0), ("minus_zero", -0.0)]
            .map(|(name, x)| ends_with(name, x.to_bits()));
    assert!(of(&nan, &nan).is_equal());
    let note = |a: &Path, b: &Path| of(a, b).first.unwrap().what.note.unwrap();
    assert!(note(&nan, &other_nan).contains("different bits"));
    assert!(note(&nan, &zero).contains("one is NaN"));
    assert!(note(&zero, &minus_zero).contains("sign of a zero"));
    let options = DiffOptions { wires: Vec::new(), tolerance: 1.0 };
    let report = diff(&nan, &zero, &options, &mut |_, _| {}).unwrap();
    assert!(!report.is_equal(), "no tolerance covers a NaN");

    // A value in one recording, an empty item in the other.
    let report = changed("empty", "/exact/cut.short", &|data| {
        data.truncate(40);
        data[24] = 1;
        data[28..36].fill(0);
        for text in ["cut", "it was refused"] {
            data.extend_from_slice(&(text.len() as u32).to_le_bytes());
            data.extend_from_slice(text.as_bytes());
        }
        true
    });
    let what = report.first.unwrap().what;
    assert_eq!(
        (what.field.as_str(), what.a.as_str(), what.b.as_str()),
        ("presence", "a value", "empty: cut: it was refused")
    );
    assert_eq!(report.wires[2].n_empties, 1);
}

#[test]
fn numbers_in_a_report_are_compared_as_numbers() {
    let dir = tempfile::tempdir().unwrap();
    let [a, b] = [("a", ""), ("b", "beat.odd=0")].map(|(name, set)| {
        let sets: Vec<_> = Some(set).into_iter().filter(|set| !set.is_empty()).collect();
        recorded(dir.path(), name, &sets)
    });
    let report = of(&a, &b);
    let beat = &report.wires[0];
    assert_eq!((beat.wire.as_str(), beat.n_differ), ("beat.wave", 1));
    let what = &beat.first.as_ref().unwrap().1;
    assert_eq!((what.field.as_str(), what.unit.as_deref()), ("gain_mm", Some("mm")));
    // The gain, the number in the report and every sample have this unit.
    assert!((beat.largest.by_unit["mm"] - 1e-9).abs() < 1e-13, "{:?}", beat.largest);
    assert_eq!(beat.largest.by_unit.len(), 1);
}

#[test]
fn of_recordings_that_lack_items_it_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let a = recorded(dir.path(), "a", &[]);
    let whole = dir.path().join("whole.mcap");
    copy(&a, &whole, &Layout { shuffle: None, ..SMALL });
    let bytes = fs::read(&whole).unwrap();
    let cut = dir.path().join("cut.mcap");
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let report = of(&whole, &cut);
    assert!(report.sides[1].incomplete.as_ref().unwrap().contains("cut short"));
    assert!(!report.is_equal() && report.wires.iter().all(|wire| wire.n_differ == 0), "{report:#?}");
    let only = recorded(dir.path(), "only", &["record.wires=[\"cut.*\"]"]);
    let report = of(&a, &only);
    let pass = report.wires.iter().find(|wire| wire.wire == "pass.out").unwrap();
    assert_eq!((pass.present, pass.n_only), ([true, false], [40, 0]));
}
