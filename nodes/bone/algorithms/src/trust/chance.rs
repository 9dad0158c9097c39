//! The chance that an answer is wrong.

use super::evidence::{Evidence, SEARCH_MM};
use super::rules::RuleParams;
use crate::sensor::{Sensor, SensorKind};
use osteoflow_verdict::{Answer, Reason};
use std::collections::BTreeMap;

/// Error between a bone and its CT's surface, mm: less of a sensor shows nothing.
const SURFACE_MM: f64 = 0.2;

/// More reasons than these say no more.
const MAX_REASONS: usize = 3;

/// The log odds of an answer without any sign, and what each sign adds to them, as `graphs/real/chance.py fit` prints them.
const WITHOUT: f64 = -5.02;
const WEIGHTS: [(&str, f64); 6] = [
    ("another_place", 2.31),
    ("beyond_limits", 1.14),
    ("far", 1.95),
    ("off_surface", 0.51),
    ("reasons", 0.52),
    ("unclear", 0.73),
];

/// What speaks against an answer, by name, each 0 where nothing does.
pub(super) fn signs(
    evidence: Option<&Evidence>,
    beyond_limits: Option<f64>,
    reasons: &[Reason],
    rules: &RuleParams,
) -> BTreeMap<String, f64> {
    let n_reasons = reasons.iter().filter(|reason| reason.answer > Answer::Trusted).count().min(MAX_REASONS);
    let mut signs = vec![("reasons", n_reasons as f64)];
    if let Some(evidence) = evidence {
        let Sensor { noise_mm, patch_mm, .. } =
            evidence.sensor.clone().unwrap_or_else(|| SensorKind::StructuredLight.sensor());
        let far_mm = evidence.p90_mm.unwrap_or(SEARCH_MM);
        let limit_mm = rules.limits.max_tre_mm.max(f64::MIN_POSITIVE);
        signs.extend([
            ("beyond_limits", beyond_limits.unwrap_or(1.0)),
            ("far", (far_mm / (patch_mm.max(SURFACE_MM) + 2.0 * noise_mm)).ln_1p()),
            ("off_surface", 1.0 - evidence.on_surface),
        ]);
        if let Some(shape) = &evidence.shape {
            signs.extend([
                ("another_place", shape.apart_mm / (shape.apart_mm + limit_mm)),
                ("unclear", 1.0 - shape.clearness),
            ]);
        }
    }
    signs.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// The share of answers with such signs that are wrong, where half of all answers are: a logistic regression on simulated registrations
/// whose weights cannot be negative. What was not examined says nothing.
pub(super) fn chance_of_being_wrong(signs: &BTreeMap<String, f64>) -> f64 {
    let without = if signs.contains_key("far") { WITHOUT } else { 0.0 };
    let log_odds: f64 = WEIGHTS.iter().map(|(name, weight)| weight * signs.get(*name).unwrap_or(&0.0)).sum();
    1.0 / (1.0 + (-without - log_odds).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chance(signs: &[(&str, f64)]) -> f64 {
        chance_of_being_wrong(&signs.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect())
    }

    #[test]
    fn no_sign_lowers_the_chance_and_what_was_not_examined_leaves_it_at_a_half() {
        assert_eq!(chance(&[]), 0.5);
        assert!(chance(&[("reasons", 1.0)]) > 0.5);
        let none = chance(&[("far", 0.0)]);
        assert!(none < 0.05, "{none}");
        for (name, _) in WEIGHTS {
            assert!(chance(&[("far", 0.5), (name, 1.0)]) >= chance(&[("far", 0.5)]), "{name}");
        }
        let all: Vec<_> = WEIGHTS.iter().map(|(name, _)| (*name, if *name == "reasons" { 3.0 } else { 1.0 })).collect();
        assert!(chance(&all) > 0.95, "{}", chance(&all));
    }
}
