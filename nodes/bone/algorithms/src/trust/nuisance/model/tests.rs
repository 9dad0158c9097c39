use super::*;
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// A family of one parameter, and one of two places of three.
fn families() -> Vec<Family> {
    let cause = |name: &str| CAUSES.iter().find(|cause| cause.name == name).unwrap();
    vec![
        Family { cause: cause("offset"), modes: 0..1, together: 1, prior: 0.2, fault: 0.5 },
        Family { cause: cause("step"), modes: 1..7, together: 3, prior: 0.02, fault: 1.5 },
    ]
}

/// What 60 residuals of unit variance say of the unknowns, with all of them off by what `of` draws.
fn information(of: impl Fn(usize) -> f64) -> Information {
    let n = N_BEFORE + 7;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let rows = DMatrix::from_fn(60, n, |_, _| rng.random::<f64>() - 0.5) * 8.0;
    let noise = DVector::from_fn(60, |_, _| rng.random::<f64>() - 0.5);
    let left = &rows * DVector::from_fn(n, |k, _| of(k)) + noise;
    let (matrix, vector) = (rows.transpose() * &rows, rows.transpose() * left);
    Information { matrix, vector, left_out: 0.0, response: DMatrix::zeros(6, 7) }
}

#[test]
fn each_hypothesis_is_that_of_its_own_precisions() {
    let (families, odds) = (families(), 0.01_f64);
    let information = information(|k| if k >= N_BEFORE + 4 { 2.0 } else { 0.05 });
    let field: Vec<f64> = (0..N_BEFORE - 6).map(|k| 0.1 / (k + 1) as f64).collect();
    let found = hypotheses(&information, &field, &families, odds).unwrap();
    // By inversion, one at a time: mean, covariance and logarithm of the evidence.
    let direct = |fault: &Option<(usize, Range<usize>)>| {
        let prior = |k: usize| families.iter().find(|family| family.modes.contains(&k)).unwrap();
        let at_fault = |k: usize| fault.as_ref().is_some_and(|(_, modes)| modes.contains(&k));
        let sd = |k: usize| if at_fault(k) { prior(k).fault } else { prior(k).prior };
        let sds: Vec<f64> = field.iter().copied().chain((0..7).map(sd)).collect();
        let precisions =
            DVector::from_iterator(sds.len() + 6, [0.0; 6].into_iter().chain(sds.iter().map(|sd| sd.powi(-2))));
        let inverse = (&information.matrix + DMatrix::from_diagonal(&precisions)).try_inverse().unwrap();
        let mean = &inverse * &information.vector;
        let evidence = 0.5 * mean.dot(&information.vector) + 0.5 * inverse.determinant().ln()
            - sds.iter().map(|sd| sd.ln()).sum::<f64>();
        let n_places = fault.as_ref().map_or(1, |(f, _)| families[*f].modes.len() / families[*f].together);
        let log_odds = if fault.is_some() { (odds / n_places as f64).ln() } else { 0.0 };
        (mean, inverse, evidence + log_odds)
    };
    let faults: Vec<_> = found.iter().map(|h| h.fault.clone()).collect();
    assert_eq!(faults, [None, Some((0, 0..1)), Some((1, 1..4)), Some((1, 4..7))]);
    let direct: Vec<_> = faults.iter().map(direct).collect();
    let largest = direct.iter().map(|(.., log)| *log).fold(f64::MIN, f64::max);
    let sum: f64 = direct.iter().map(|(.., log)| (log - largest).exp()).sum();
    for (h, (mean, covariance, log)) in found.iter().zip(direct) {
        assert!((&h.whole - &mean).amax() < 1e-9, "{:?}", h.fault);
        assert!((&h.mean - mean.rows(N_BEFORE, 7)).amax() < 1e-9, "{:?}", h.fault);
        assert!((&h.covariance - covariance.view((N_BEFORE, N_BEFORE), (7, 7))).amax() < 1e-9, "{:?}", h.fault);
        let weight = (log - largest).exp() / sum;
        assert!((h.weight - weight).abs() < 1e-9, "{:?}: {} instead of {weight}", h.fault, h.weight);
    }
    // The step that is there is the likeliest.
    assert!(found[..3].iter().all(|h| h.weight < found[3].weight));
}

#[test]
fn without_odds_all_is_sound_and_sound_data_leave_the_odds() {
    let weights = |odds: f64| -> Vec<f64> {
        let found = hypotheses(&information(|_| 0.0), &[0.1; N_BEFORE - 6], &families(), odds).unwrap();
        found.into_iter().map(|h| h.weight).collect()
    };
    assert_eq!(weights(0.0), [1.0, 0.0, 0.0, 0.0]);
    let faults = weights(0.01);
    assert!(faults[0] > 0.99 && faults[1..].iter().all(|weight| *weight < 0.01), "{faults:?}");
}
