//! Properties for any table: independence of the order of rows, effects of clustering, and coverage of intervals.

use std::time::Instant;

use osteoflow_statistics::*;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use rand_distr::{Beta, Distribution, StandardNormal};

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// `n_rows` rows for each of `n_bones`.
fn bones(n_bones: usize, n_rows: usize) -> Units {
    let paths: Vec<_> = (0..n_bones * n_rows).map(|row| [format!("{:04}", row / n_rows)]).collect();
    Units::new(&["bone"], &paths).unwrap()
}

/// Errors of rows with a common part for each bone.
fn errors(rng: &mut ChaCha8Rng, n_bones: usize, n_rows: usize, sd_between: f64, sd_within: f64) -> Vec<f64> {
    let of_bone = |rng: &mut ChaCha8Rng| {
        let shift = sd_between * normal(rng);
        (0..n_rows).map(|_| shift + sd_within * normal(rng)).collect::<Vec<_>>()
    };
    (0..n_bones).flat_map(|_| of_bone(rng)).collect()
}

fn width(interval: &Result<Interval, NoInterval>) -> f64 {
    let interval = interval.clone().unwrap();
    interval.high - interval.low
}

#[test]
fn the_order_of_the_rows_changes_no_bit() {
    let mut rng = rng(1);
    let (n_bones, n_rows) = (6, 7);
    let values = errors(&mut rng, n_bones, n_rows, 1.0, 0.5);
    let mut rows: Vec<(String, f64)> =
        values.iter().enumerate().map(|(row, value)| (format!("bone {}", row / n_rows), *value)).collect();
    let answers = |rows: &[(String, f64)]| {
        let paths: Vec<_> = rows.iter().map(|(bone, _)| [bone.as_str()]).collect();
        let units = Units::new(&["bone"], &paths).unwrap();
        let values: Vec<f64> = rows.iter().map(|(_, value)| *value).collect();
        let squares: Vec<f64> = values.iter().map(|v| v * v).collect();
        let groups: Vec<&str> = rows.iter().map(|(bone, _)| bone.as_str()).collect();
        let hits: Vec<bool> = values.iter().map(|v| v.abs() < 1.0).collect();
        let bca = BootstrapParams { kind: BootstrapKind::BiasCorrected, n_resamples: 500, ..Default::default() };
        format!(
            "{:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?}",
            Summary::of(&values),
            unit_means(&units, &values),
            bootstrap_mean(&units, &values, &BootstrapParams::default()),
            bootstrap(&units, &values, median, &bca),
            wilson_clustered(&units, &hits, 0.95),
            wilcoxon(&values),
            tost(&values, 0.3, 0.05),
            bland_altman(&values, 0.95),
            repeatability(&groups, &values),
            pearson(&values, &squares, 0.95),
            spearman(&values, &squares, 0.95),
        )
    };
    let expected = answers(&rows);
    for _ in 0..20 {
        for last in (1..rows.len()).rev() {
            rows.swap(last, rng.next_u32() as usize % (last + 1));
        }
        assert_eq!(answers(&rows), expected);
    }
}

#[test]
fn the_same_seed_draws_the_same_and_another_nearly_the_same() {
    let values: Vec<f64> = (0..60).map(|row| f64::from((row / 5 * 37) % 29) + f64::from(row % 5) / 7.0).collect();
    let interval = |seed| {
        let params = BootstrapParams { seed, ..Default::default() };
        bootstrap_mean(&bones(12, 5), &values, &params).unwrap().interval.unwrap()
    };
    // Only sums and quotients: the same bits on every machine.
    assert_eq!((interval(0).low, interval(0).high), (7.16533033121076, 18.619047619047617));
    assert_ne!(interval(0), interval(1));
    assert!((interval(0).low - interval(1).low).abs() < 0.2);
}

#[test]
fn all_three_forms_of_the_bootstrap_draw_the_same_units() {
    let values = errors(&mut rng(3), 8, 4, 1.0, 1.0);
    let (units, params) = (bones(8, 4), BootstrapParams { n_resamples: 1000, ..Default::default() });
    let by_sums = bootstrap_mean(&units, &values, &params).unwrap().interval.unwrap();
    let mean = |values: &mut [f64]| values.iter().sum::<f64>() / values.len() as f64;
    let by_values = bootstrap(&units, &values, mean, &params).unwrap().interval.unwrap();
    let of_rows = |rows: &[usize]| rows.iter().map(|row| values[*row]).sum::<f64>() / rows.len() as f64;
    let by_rows = bootstrap_rows(&units, of_rows, &params).unwrap().interval.unwrap();
    for other in [by_values, by_rows] {
        assert!((by_sums.low - other.low).abs() < 1e-12 && (by_sums.high - other.high).abs() < 1e-12);
    }
}

#[test]
fn rows_of_one_bone_are_not_taken_as_independent() {
    let values = errors(&mut rng(4), 10, 20, 1.0, 0.2);
    let params = BootstrapParams::default();
    let clustered = width(&bootstrap_mean(&bones(10, 20), &values, &params).unwrap().interval);
    let naive = width(&bootstrap_mean(&Units::each_row("row", 200), &values, &params).unwrap().interval);
    // Rows of a bone are nearly equal, so 200 rows know as much as ten: √20 = 4.5 times the width.
    assert!(clustered > 3.5 * naive, "{clustered} against {naive} mm");
    let hits: Vec<bool> = values.iter().map(|v| *v < 0.3).collect();
    let clustered = width(&wilson_clustered(&bones(10, 20), &hits, 0.95).unwrap().interval);
    let naive = width(&wilson_clustered(&Units::each_row("row", 200), &hits, 0.95).unwrap().interval);
    assert!(clustered > 2.0 * naive, "{clustered} against {naive}");
}

#[test]
fn one_bone_gives_an_estimate_and_never_an_interval() {
    let values = errors(&mut rng(5), 1, 200, 1.0, 0.2);
    let result = bootstrap_mean(&bones(1, 200), &values, &BootstrapParams::default()).unwrap();
    assert_eq!((result.n_units, result.n_rows, result.few_units), (1, 200, true));
    let reason = result.interval.clone().unwrap_err();
    assert_eq!(reason.to_string(), "n = 1 bone: one bone does not show how others differ; measure a second one");
    let json = serde_json::to_value(&result).unwrap();
    assert_eq!(json["interval"]["no_interval"], reason.to_string());
    assert_eq!(json["estimate"], result.estimate);
}

#[test]
fn a_statistic_that_fails_in_a_resample_has_no_interval_and_one_that_fails_on_all_rows_is_an_error() {
    let (units, values) = (Units::each_row("bone", 3), [1.0, 2.0, 4.0]);
    let params = BootstrapParams::default();
    // The correlation of one unit drawn three times is undefined.
    let spread_of_none = |v: &mut [f64]| if v.iter().all(|x| *x == v[0]) { f64::NAN } else { 1.0 };
    let result = bootstrap(&units, &values, spread_of_none, &params).unwrap();
    assert!(matches!(result.interval, Err(NoInterval::NotFinite { n_failed: 1.., n_resamples: 10_000 })));
    let refused = bootstrap(&units, &values, |_| f64::NAN, &params);
    assert!(refused.unwrap_err().to_string().contains("the statistic of all 3 rows is"));
    assert!(
        bootstrap_mean(&units, &[1.0, f64::NAN, 2.0], &params)
            .unwrap_err()
            .to_string()
            .contains("leave rows without a number out")
    );
    let none = bootstrap_mean(&Units::each_row("bone", 0), &[], &params);
    assert!(none.unwrap_err().to_string().starts_with("0 rows, at least 1 needed"));
}

#[test]
fn a_column_of_equal_values_has_an_interval_without_width() {
    for kind in [BootstrapKind::Percentile, BootstrapKind::BiasCorrected] {
        let params = BootstrapParams { kind, ..Default::default() };
        let result = bootstrap_mean(&bones(5, 2), &[0.5; 10], &params).unwrap().interval.unwrap();
        assert_eq!((result.low, result.high), (0.5, 0.5));
    }
}

/// Share of `n` simulations whose interval contains `truth`.
fn coverage(n: u64, truth: f64, interval: impl Fn(&mut ChaCha8Rng) -> Interval) -> f64 {
    let held = (0..n).filter(|seed| {
        let result = interval(&mut rng(1000 + seed));
        result.low <= truth && truth <= result.high
    });
    held.count() as f64 / n as f64
}

#[test]
fn the_wilson_interval_has_about_its_nominal_coverage() {
    for (n, share) in [(10, 0.5), (10, 0.9), (30, 0.95), (200, 0.98)] {
        let result = coverage(4000, share, |rng| {
            let n_hits = (0..n).filter(|_| f64::from(rng.next_u32()) < share * 4_294_967_296.0).count();
            wilson(n_hits, n, 0.95).unwrap().interval.unwrap()
        });
        assert!((0.90..0.995).contains(&result), "{n} rows, share {share}: held in {result}");
    }
}

#[test]
fn the_clustered_wilson_interval_holds_where_the_naive_one_fails() {
    let (n_rows, share) = (20, 0.8);
    for n_bones in [5, 8, 15, 30] {
        let spread = Beta::new(4.0 * share, 4.0 * (1.0 - share)).unwrap(); // correlation 0.2 within a bone
        let hits = |rng: &mut ChaCha8Rng| -> Vec<bool> {
            let of_bone = |rng: &mut ChaCha8Rng| {
                let share = spread.sample(rng);
                (0..n_rows).map(|_| f64::from(rng.next_u32()) < share * 4_294_967_296.0).collect::<Vec<_>>()
            };
            (0..n_bones).flat_map(|_| of_bone(rng)).collect()
        };
        let (units, rows) = (bones(n_bones, n_rows), Units::each_row("row", n_bones * n_rows));
        let with = |units: &Units| {
            coverage(2000, share, |rng| wilson_clustered(units, &hits(rng), 0.95).unwrap().interval.unwrap())
        };
        let (clustered, naive) = (with(&units), with(&rows));
        assert!((0.925..0.975).contains(&clustered), "{n_bones} bones: held in {clustered}");
        assert!(naive < 0.7, "{n_bones} bones, rows as independent: held in {naive}");
    }
}

#[test]
fn the_cluster_bootstrap_holds_where_the_naive_one_fails() {
    let n_rows = 5;
    for (n_bones, at_least) in [(5, 0.87), (10, 0.91), (30, 0.93)] {
        let (units, rows) = (bones(n_bones, n_rows), Units::each_row("row", n_bones * n_rows));
        let with = |units: &Units, kind| {
            let params = BootstrapParams { n_resamples: 2000, kind, ..Default::default() };
            coverage(1000, 0.0, |rng| {
                let values = errors(rng, n_bones, n_rows, 1.0, 0.5);
                bootstrap_mean(units, &values, &params).unwrap().interval.unwrap()
            })
        };
        let [expanded, percentile, bias_corrected] =
            [BootstrapKind::Expanded, BootstrapKind::Percentile, BootstrapKind::BiasCorrected]
                .map(|kind| with(&units, kind));
        let naive = with(&rows, BootstrapKind::Expanded);
        println!("| {n_bones} | {expanded} | {percentile} | {bias_corrected} | {naive} |");
        assert!((at_least..0.97).contains(&expanded), "{n_bones} bones: held in {expanded}");
        assert!(percentile < expanded && bias_corrected < expanded, "{n_bones} bones: {percentile} {bias_corrected}");
        assert!(naive < 0.7, "{n_bones} bones, rows as independent: held in {naive}");
    }
}

#[test]
fn intervals_of_the_limits_of_agreement_have_about_their_nominal_coverage() {
    for n_bones in [5, 10, 30] {
        let held =
            coverage(1000, 1.96, |rng| bland_altman(&errors(rng, n_bones, 1, 1.0, 0.0), 0.95).unwrap().upper_interval);
        assert!((0.91..0.985).contains(&held), "{n_bones} bones: held in {held}");
    }
}

#[test]
fn ten_thousand_resamples_of_two_hundred_units_take_well_under_a_tenth_of_a_second() {
    let values = errors(&mut rng(6), 200, 5, 1.0, 0.5);
    let units = bones(200, 5);
    let seconds = (0..5).map(|_| {
        let start = Instant::now();
        bootstrap_mean(&units, &values, &BootstrapParams::default()).unwrap();
        start.elapsed().as_secs_f64()
    });
    let least = seconds.fold(f64::INFINITY, f64::min);
    println!("{:.1} ms", 1e3 * least);
    assert!(cfg!(debug_assertions) || least < 0.1, "{least} s");
}
