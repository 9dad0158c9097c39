//! Known answers of scipy, statsmodels and numpy for the same data, printed by `golden.py`.

use osteoflow_statistics::*;
use serde_json::Value;

fn cases(name: &str) -> Vec<Value> {
    let golden: Value = serde_json::from_str(include_str!("golden.json")).unwrap();
    let cases = golden[name].as_array().unwrap().clone();
    assert!(!cases.is_empty());
    cases
}

fn numbers(case: &Value, key: &str) -> Vec<f64> {
    case[key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn texts(case: &Value, key: &str) -> Vec<String> {
    case[key].as_array().unwrap().iter().map(|v| v.as_str().unwrap().to_string()).collect()
}

fn units(case: &Value) -> Units {
    let paths: Vec<[String; 1]> = texts(case, "group").into_iter().map(|group| [group]).collect();
    Units::new(&["bone"], &paths).unwrap()
}

#[track_caller]
fn check(result: f64, expected: &Value, what: &str) {
    let expected = expected.as_f64().unwrap();
    // Libraries sum in different orders, and a p-value loses digits in its quantile.
    let tolerance = 1e-14 + 1e-10 * expected.abs();
    assert!((result - expected).abs() <= tolerance, "{what}: {result:e}, scipy says {expected:e}");
}

#[track_caller]
fn check_interval(result: Interval, expected: &Value, what: &str) {
    check(result.low, &expected[0], what);
    check(result.high, &expected[1], what);
}

#[test]
fn summaries_are_those_of_numpy() {
    for case in cases("summary") {
        let result = Summary::of(&numbers(&case, "values")).unwrap();
        let result = serde_json::to_value(result).unwrap();
        assert_eq!(result["sd"].is_null(), case["sd"].is_null());
        for (key, value) in result.as_object().unwrap().iter().filter(|(_, value)| !value.is_null()) {
            check(value.as_f64().unwrap(), &case[key], key);
        }
    }
}

#[test]
fn wilsons_interval_is_that_of_statsmodels() {
    for case in cases("wilson") {
        let count = |key: &str| case[key].as_u64().unwrap() as usize;
        let result = wilson(count("n_hits"), count("n"), case["level"].as_f64().unwrap()).unwrap().interval.unwrap();
        check(result.low, &case["low"], "low");
        check(result.high, &case["high"], "high");
    }
}

#[test]
fn the_effective_sample_size_is_that_of_cluster_robust_least_squares() {
    for case in cases("wilson_clustered") {
        let hits: Vec<bool> = case["hits"].as_array().unwrap().iter().map(|v| v.as_bool().unwrap()).collect();
        let result = wilson_clustered(&units(&case), &hits, case["level"].as_f64().unwrap()).unwrap();
        check(result.n_effective, &case["n_effective"], "n_effective");
        let interval = result.interval.unwrap();
        check(interval.low, &case["low"], "low");
        check(interval.high, &case["high"], "high");
    }
}

#[test]
fn the_signed_rank_test_is_that_of_scipy_with_ties_and_zeros_and_without() {
    for case in cases("wilcoxon") {
        let differences = numbers(&case, "differences");
        let (result, what) = (wilcoxon(&differences).unwrap(), format!("{differences:?}"));
        check(result.p, &case["p"], &what);
        check(result.w_plus, &case["w_plus"], &what);
        check(result.w_minus, &case["w_minus"], &what);
        check(result.rank_biserial, &case["rank_biserial"], &what);
        check(result.hodges_lehmann, &case["hodges_lehmann"], &what);
        assert_eq!(result.n_zeros as u64, case["n_zeros"].as_u64().unwrap());
    }
}

#[test]
fn holms_correction_is_that_of_statsmodels() {
    for case in cases("holm") {
        let result = holm(&numbers(&case, "p")).unwrap();
        for (result, expected) in result.iter().zip(case["corrected"].as_array().unwrap()) {
            check(*result, expected, "corrected p");
        }
    }
}

#[test]
fn equivalence_is_that_of_statsmodels() {
    for case in cases("tost") {
        let (margin, alpha) = (case["margin"].as_f64().unwrap(), case["alpha"].as_f64().unwrap());
        let result = tost(&numbers(&case, "differences"), margin, alpha).unwrap();
        check(result.p, &case["p"], "p");
        check(result.p_lower, &case["p_lower"], "p_lower");
        check(result.p_upper, &case["p_upper"], "p_upper");
        check(result.interval.low, &case["low"], "low");
        check(result.interval.high, &case["high"], "high");
    }
}

#[test]
fn limits_of_agreement_follow_their_formulas_with_scipys_quantiles() {
    for case in cases("bland_altman") {
        let (differences, level) = (numbers(&case, "differences"), case["level"].as_f64().unwrap());
        let result = bland_altman(&differences, level).unwrap();
        check(result.bias, &case["bias"], "bias");
        check(result.sd, &case["sd"], "sd");
        check(result.lower_limit, &case["lower"], "lower limit");
        check(result.upper_limit, &case["upper"], "upper limit");
        check_interval(result.bias_interval, &case["bias_interval"], "bias");
        check_interval(result.lower_interval, &case["lower_interval"], "lower limit");
        check_interval(result.upper_interval, &case["upper_interval"], "upper limit");
    }
}

#[test]
fn repeatability_is_that_of_statsmodels_analysis_of_variance() {
    for case in cases("repeatability") {
        let result = repeatability(&texts(&case, "group"), &numbers(&case, "values")).unwrap();
        check(result.n0, &case["n0"], "n0");
        check(result.sd_within, &case["sd_within"], "sd within");
        check(result.sd_between, &case["sd_between"], "sd between");
        check(result.coefficient, &case["coefficient"], "coefficient");
        check(result.icc, &case["icc"], "icc");
    }
}

#[test]
fn correlations_are_those_of_scipy() {
    for (name, correlate) in [("pearson", pearson as fn(&[f64], &[f64], f64) -> _), ("spearman", spearman)] {
        for case in cases(name) {
            let level = case["level"].as_f64().unwrap();
            let result: Correlation = correlate(&numbers(&case, "x"), &numbers(&case, "y"), level).unwrap();
            check(result.r, &case["r"], name);
            check(result.p, &case["p"], name);
            let interval = result.interval.unwrap();
            check(interval.low, &case["low"], name);
            check(interval.high, &case["high"], name);
        }
    }
}

#[test]
fn bootstrap_intervals_lie_where_scipys_do() {
    for case in cases("bootstrap") {
        let values = numbers(&case, "values");
        let kind = if case["kind"] == "BCa" { BootstrapKind::BiasCorrected } else { BootstrapKind::Percentile };
        let params = BootstrapParams { kind, n_resamples: 100_000, ..Default::default() };
        let units = Units::each_row("bone", values.len());
        let result = if case["statistic"] == "mean" {
            bootstrap_mean(&units, &values, &params).unwrap()
        } else {
            bootstrap(&units, &values, median, &params).unwrap()
        };
        let (low, high) = (case["low"].as_f64().unwrap(), case["high"].as_f64().unwrap());
        let result = result.interval.unwrap();
        let off = (result.low - low).abs().max((result.high - high).abs()) / (high - low);
        // Other random draws: an end of 100,000 resamples is known to about 1 % of the width.
        assert!(off < 0.02, "{} {}: {result:?}, scipy says {low} to {high}", case["statistic"], case["kind"]);
    }
}
