//! What a scan says of every cause: a posterior with each cause as large as in a sound procedure, and one for each that may be at fault.

use super::axes::Axes;
use super::cause::{CAUSES, Cause, Mode};
use super::effect::{Effect, Levers};
use super::fit::{Fit, GATES_MM, Information, N_BEFORE, Problem};
use super::params::NuisanceParams;
use super::report::{Nuisance, NuisanceState};
use super::words::{self, Unseen};
use crate::product::product;
use crate::trust::predict::{Component, Deformation, Predicted, Where};
use crate::trust::{Limits, RuleParams};
use nalgebra::{DMatrix, DVector, Point3, Vector3};
use osteoflow_verdict::Reason;
use statrs::distribution::{Continuous, ContinuousCDF, Normal};
use std::ops::Range;

/// A fault is looked at from its own fit where it explains this share of the scan, which the sound fit leaves out.
const EXPLAINED: f64 = 0.03;

/// And this share of all that lies near the surface and is left out: a surface that is distorted into tissue and the wound's edges takes some of
/// them with it.
const MOST: f64 = 0.5;

/// Another cause explains the same numbers if it has this share of the best one's chance.
const AS_WELL: f64 = 0.2;

/// Standard deviations from which a deformation is told, however harmless it is.
const NOTED: f64 = 10.0;

/// Chance from which a fault is there.
const THERE: f64 = 0.5;

/// The modes of a cause among all.
pub(super) struct Family {
    cause: &'static Cause,
    modes: Range<usize>,
    /// Those that are at fault together: a step is in one place.
    together: usize,
    /// Prior standard deviation of each parameter.
    prior: f64,
    /// The same where it is a fault.
    fault: f64,
}

/// What the causes may be if some of them are at fault.
struct Hypothesis {
    /// The family at fault, and its modes that are.
    fault: Option<(usize, Range<usize>)>,
    weight: f64,
    /// Mean of all unknowns.
    whole: DVector<f64>,
    /// Mean and covariance of the causes' parameters.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// The same of the pose's shift and turn, and the causes' parameters after them.
    joint_mean: DVector<f64>,
    joint_covariance: DMatrix<f64>,
}

/// The causes of one registration.
pub(in crate::trust) struct Nuisances {
    axes: Axes,
    families: Vec<Family>,
    /// The first has no fault.
    hypotheses: Vec<Hypothesis>,
    levers: Levers,
    /// For each family, the effect of a parameter of 1 in its worst direction.
    worst: Vec<Effect>,
}

/// What is known of the causes, with the chance that each puts the answer beyond the limits.
pub(in crate::trust) struct Known {
    /// Each cause.
    pub(in crate::trust) list: Vec<Nuisance>,
    /// The sign against the registration that a cause was measured.
    pub(in crate::trust) reason: Option<Reason>,
    /// What is taken for granted, the most dangerous first; each with whether it is of camera or markers.
    pub(in crate::trust) assumptions: Vec<(bool, String)>,
}

impl Family {
    /// The families that apply, and the modes of all; markers only where they carry the answer.
    pub(super) fn all(axes: &Axes, has_markers: bool, params: &NuisanceParams) -> (Vec<Self>, Vec<Mode>) {
        let mut all = Vec::new();
        let family = |cause: &'static Cause| {
            let first = all.len();
            all.extend((cause.modes)(axes));
            let (modes, (_, by)) = (first..all.len(), cause.unit.of());
            let together = if cause.name == "step" { 3 } else { modes.len() };
            let n_places = modes.len().div_ceil(together.max(1)).max(1) as f64;
            Self {
                cause,
                modes,
                together,
                prior: (cause.prior)(params) / by / n_places.sqrt(),
                fault: cause.fault / by,
            }
        };
        let causes = CAUSES.iter().filter(|cause| has_markers || cause.name != "marker");
        let families = causes.map(family).filter(|family| !family.modes.is_empty()).collect();
        (families, all)
    }
}

impl Nuisances {
    /// `None` where the scan leaves a motion undetermined.
    pub(super) fn new(
        problem: &Problem<'_>,
        families: Vec<Family>,
        place: &Where<'_>,
        limits: &Limits,
        params: &NuisanceParams,
    ) -> Option<Self> {
        let sds = |of: fn(&Family) -> f64| -> Vec<f64> {
            families.iter().flat_map(|family| vec![of(family); family.modes.len()]).collect()
        };
        let mut fit = problem.fit(&sds(|family| family.fault), &GATES_MM)?;
        let all =
            |information: &Information| hypotheses(information, &problem.field.sds_mm, &families, params.fault_odds);
        let faults = all(&problem.look(&mut fit, None)?)?.into_iter().skip(1);
        let fault = faults.max_by(|a, b| a.weight.total_cmp(&b.weight))?;
        let sound = problem.fit(&sds(|family| family.prior), &[])?.at;
        // To first order about a sound procedure, or about the likeliest fault where that explains a part of the scan that the other leaves out.
        let about = |first: DVector<f64>, fault: Option<(usize, Range<usize>)>, fit: &mut Fit| {
            let information = problem.look(fit, Some(first))?;
            let again = all(&information)?.into_iter().find(|h| h.fault == fault)?;
            problem.look(fit, Some(again.whole))
        };
        let (of_sound, of_fault) = (about(sound, None, &mut fit)?, about(fault.whole, fault.fault, &mut fit));
        let information = match of_fault {
            Some(of_fault) if of_sound.left_out - of_fault.left_out > EXPLAINED.max(MOST * of_sound.left_out) => {
                of_fault
            }
            _ => of_sound,
        };
        let hypotheses = all(&information)?;
        let axes = problem.axes.clone();
        let levers = Levers::new(axes.clone(), problem.modes.to_vec(), information.response);
        let worst = |family: &Family| {
            let (first, k) = (family.modes.start, family.modes.len());
            let at = |direction: DVector<f64>| {
                // A size that may be: a tilt is no multiple of an angle that is not small.
                levers.effect(place, limits, &(direction * family.prior)).scaled(1.0 / family.prior)
            };
            let worst = levers.worst(place, first, k).into_iter().map(at);
            worst.max_by(|a, b| a.times.total_cmp(&b.times)).unwrap_or_default()
        };
        let worst = families.iter().map(worst).collect();
        Some(Self { axes, families, hypotheses, levers, worst })
    }

    /// What the causes may do to the answer, for the predicted error.
    pub(in crate::trust) fn deformation(&self) -> Deformation<'_> {
        fn component(h: &Hypothesis) -> Component<'_> {
            Component { weight: h.weight, mean: &h.joint_mean, covariance: &h.joint_covariance }
        }
        let components = self.hypotheses.iter().map(component).collect();
        Deformation { components, at: Box::new(|p| self.levers.with_pose(p)) }
    }

    /// What is known of the causes, with the predicted error.
    pub(in crate::trust) fn known(&self, predicted: &Predicted, at: &Where<'_>, rules: &RuleParams) -> Known {
        let measured = self.measured(predicted, at, rules);
        let (mut list, mut unseen, mut notes) = (Vec::new(), Vec::new(), Vec::new());
        for (f, (family, worst)) in self.families.iter().zip(&self.worst).enumerate() {
            let of_fault = self.of_fault(f);
            let is_measured = measured.iter().any(|h| h.fault.as_ref().is_some_and(|(of, _)| *of == f));
            let critical = 1.0 / worst.times.max(1e-12);
            let (size, sd, modes) = self.size(f, if is_measured { of_fault } else { None });
            let danger = self.danger(f, critical);
            let (chance, _) = danger;
            let within = of_fault.map_or(1.0, |h| self.beyond(h, f, critical).0);
            let state = match (is_measured, within < 0.1) {
                (true, _) => NuisanceState::Measured,
                (false, true) => NuisanceState::Bounded,
                (false, false) => NuisanceState::Unseen,
            };
            let effect = match state {
                NuisanceState::Measured => {
                    let mean = of_fault.map(|h| self.only(f, &h.mean)).unwrap_or_default();
                    self.levers.effect(at, &rules.limits, &mean)
                }
                _ => worst.scaled(size.abs() + 1.645 * sd),
            };
            let (unit, by) = family.cause.unit.of();
            if state != NuisanceState::Measured {
                let is_there = family.cause.name != "plan" || !(at.points.is_empty() && at.cuts.is_empty());
                if state == NuisanceState::Unseen && is_there {
                    unseen.push(Unseen { cause: family.cause, danger: danger.1, critical, worst: *worst });
                }
                let found = of_fault.map(|h| (h.weight > THERE, self.size(f, Some(h))));
                let found = found.filter(|(is_there, (size, sd, _))| *is_there || size.abs() > NOTED * sd);
                notes.extend(found.map(|(_, (size, sd, _))| (false, words::note(family.cause, size, sd))));
            }
            list.push(Nuisance {
                name: family.cause.name.to_owned(),
                state,
                estimate: by * size,
                sd: by * sd,
                prior: by * family.prior,
                unit: unit.to_owned(),
                axis: axis(&modes, &self.axes, family).map(Into::into),
                at: of_fault.and_then(|h| self.place(h)).map(Into::into),
                effect_mm: effect.mm,
                effect_deg: effect.deg,
                critical: by * critical,
                chance,
            });
        }
        let assumptions = words::assumptions(unseen, &rules.limits, &self.axes, at).into_iter().chain(notes).collect();
        Known { list, reason: self.reason(&measured, at, rules), assumptions }
    }

    /// The faults that make the answer likely wrong: the likeliest, and those that explain about as much. Else one that is there and would
    /// make an answer wrong that knows nothing of it: which part of a bone a plan belongs to, no scan shows.
    fn measured(&self, predicted: &Predicted, at: &Where<'_>, rules: &RuleParams) -> Vec<&Hypothesis> {
        let of: Vec<(f64, &Hypothesis)> = predicted.beyond_by.iter().copied().zip(&self.hypotheses).collect();
        let mut faults: Vec<(f64, &Hypothesis)> = of.into_iter().filter(|(_, h)| h.fault.is_some()).collect();
        faults.sort_by(|a, b| b.0.total_cmp(&a.0));
        let sound = predicted.beyond_by.first().copied().unwrap_or(0.0);
        let is_harmful = |h: &&Hypothesis| {
            let of = h.fault.as_ref().map(|(f, _)| self.levers.effect(at, &rules.limits, &self.only(*f, &h.mean)));
            h.weight > THERE && of.is_some_and(|effect| effect.times > 1.0)
        };
        let likely =
            faults.first().filter(|(best, _)| *best > sound && predicted.beyond_limits > rules.max_beyond_limits);
        let Some((best, _)) = likely else { return self.hypotheses.iter().filter(is_harmful).collect() };
        let mut named: Vec<&str> = Vec::new();
        let least = AS_WELL * best;
        let mut is_new = |h: &Hypothesis| {
            let name = h.fault.as_ref().map_or("", |(f, _)| self.families[*f].cause.name);
            !named.contains(&name) && {
                named.push(name);
                true
            }
        };
        faults.into_iter().filter(|(chance, h)| *chance >= least && is_new(h)).map(|(_, h)| h).collect()
    }

    fn reason(&self, measured: &[&Hypothesis], at: &Where<'_>, rules: &RuleParams) -> Option<Reason> {
        let (first, others) = measured.split_first()?;
        let of = |h: &Hypothesis| h.fault.as_ref().map(|(f, _)| (*f, self.size(*f, Some(h))));
        let (f, (size, sd, _)) = of(first)?;
        let effect = self.levers.effect(at, &rules.limits, &self.only(f, &first.mean));
        let others: Vec<(&Cause, f64)> =
            others.iter().filter_map(|h| of(h)).map(|(f, (size, ..))| (self.families[f].cause, size)).collect();
        Some(words::measured(self.families[f].cause, size, sd, effect, &others))
    }

    /// The likeliest hypothesis in which a family is at fault.
    fn of_fault(&self, f: usize) -> Option<&Hypothesis> {
        let own = self.hypotheses.iter().filter(|h| h.fault.as_ref().is_some_and(|(of, _)| *of == f));
        own.max_by(|a, b| a.weight.total_cmp(&b.weight))
    }

    /// Size, standard deviation and parameters of a family: where one is at fault, of what is; else in the sound posterior. One parameter has a
    /// sign.
    fn size(&self, f: usize, fault: Option<&Hypothesis>) -> (f64, f64, Vec<f64>) {
        let h = fault.unwrap_or(&self.hypotheses[0]);
        let own = h.fault.as_ref().filter(|(of, _)| *of == f).map(|(_, modes)| modes.clone());
        let modes = own.unwrap_or_else(|| self.families[f].modes.clone());
        let values: Vec<f64> = modes.clone().map(|k| h.mean[k]).collect();
        let size = if values.len() == 1 { values[0] } else { DVector::from_column_slice(&values).norm() };
        let variance = modes.clone().map(|k| h.covariance[(k, k)]).sum::<f64>() / modes.len() as f64;
        (size, variance.max(0.0).sqrt(), values)
    }

    /// Where a fault acts, if it is a step.
    fn place(&self, h: &Hypothesis) -> Option<Point3<f64>> {
        let (f, modes) = h.fault.as_ref()?;
        let family = self.families.get(*f).filter(|family| family.cause.name == "step")?;
        let at_mm = self.axes.steps().get((modes.start - family.modes.start) / family.together)?.to_owned();
        Some(self.axes.centre + self.axes.along * at_mm)
    }

    /// The parameters of a family alone.
    fn only(&self, f: usize, values: &DVector<f64>) -> DVector<f64> {
        DVector::from_fn(values.len(), |k, _| if self.families[f].modes.contains(&k) { values[k] } else { 0.0 })
    }

    /// Under a hypothesis the chance that a family is beyond its critical size, and the mean of its size over that where it is.
    fn beyond(&self, h: &Hypothesis, f: usize, critical: f64) -> (f64, f64) {
        let (size, sd, _) = self.size(f, Some(h));
        let (size, sd) = (size.abs() / critical, (sd / critical).max(1e-9));
        let Ok(normal) = Normal::new(0.0, 1.0) else { return (0.0, 0.0) };
        let tail = |mean: f64| {
            let z = (1.0 - mean) / sd;
            (normal.sf(z), mean * normal.sf(z) + sd * normal.pdf(z))
        };
        let (above, below) = (tail(size), tail(-size));
        (above.0 + below.0, above.1 + below.1)
    }

    /// The chance that a family puts the answer beyond the limits, and that times how far.
    fn danger(&self, f: usize, critical: f64) -> (f64, f64) {
        let concerns = |h: &&Hypothesis| h.fault.as_ref().is_none_or(|(of, _)| *of == f);
        let of = self.hypotheses.iter().filter(concerns).map(|h| (h.weight, self.beyond(h, f, critical)));
        of.fold((0.0, 0.0), |sum, (weight, (chance, times))| (sum.0 + weight * chance, sum.1 + weight * times))
    }
}

/// The direction in which a family acts, where it has one.
fn axis(values: &[f64], axes: &Axes, family: &Family) -> Option<Vector3<f64>> {
    match (family.cause.name, values) {
        ("stretch_along" | "film_along" | "twist", _) => Some(axes.along),
        ("bend", [a, b]) | ("step", [a, b, _]) => (axes.towards * *a + axes.sideways * *b).try_normalize(1e-12),
        ("shear", _) => Some(Vector3::y()),
        ("film_around", _) => Some(axes.sideways),
        ("film", _) => Some(axes.towards),
        _ => None,
    }
}

/// The posteriors: of a sound procedure, and of each fault, with their weights.
///
/// A fault changes the priors of a few parameters, so that each posterior follows from that of a sound procedure.
fn hypotheses(
    information: &Information,
    field_sds_mm: &[f64],
    families: &[Family],
    fault_odds: f64,
) -> Option<Vec<Hypothesis>> {
    let of_field = field_sds_mm.iter().map(|sd_mm| sd_mm.powi(-2));
    let of_causes = families.iter().flat_map(|family| vec![family.prior.powi(-2); family.modes.len()]);
    let precisions: Vec<f64> = [0.0; 6].into_iter().chain(of_field).chain(of_causes).collect();
    let precisions = DVector::from_vec(precisions);
    let mut matrix = information.matrix.clone();
    (0..precisions.len()).for_each(|k| matrix[(k, k)] += precisions[k]);
    let cholesky = matrix.cholesky()?;
    let whole = cholesky.solve(&information.vector);
    let n = whole.len() - N_BEFORE;
    let all_covariance = cholesky.inverse();
    let mean = whole.rows(N_BEFORE, n).into_owned();
    let covariance = all_covariance.view((N_BEFORE, N_BEFORE), (n, n)).into_owned();
    // Without the waves of the camera's depth.
    let kept: Vec<usize> = (0..6).chain(N_BEFORE..whole.len()).collect();
    let joint = |mean: &DVector<f64>, covariance: &DMatrix<f64>| {
        (mean.select_rows(&kept), covariance.select_rows(&kept).select_columns(&kept))
    };
    let (joint_mean, joint_covariance) = joint(&whole, &all_covariance);
    let sound = Hypothesis {
        fault: None,
        weight: 0.0,
        mean: mean.clone(),
        covariance: covariance.clone(),
        whole: whole.clone(),
        joint_mean,
        joint_covariance,
    };
    let mut all = vec![(0.0, sound)];
    for (f, family) in families.iter().enumerate() {
        let (k, n_places) = (family.together, (family.modes.len() / family.together) as f64);
        // The change of the precision.
        let change = family.fault.powi(-2) - family.prior.powi(-2);
        for first in family.modes.clone().step_by(k) {
            let own = covariance.view((first, first), (k, k)).into_owned();
            let own_mean = mean.rows(first, k).into_owned();
            let ratio = (DMatrix::identity(k, k) + own * change).lu();
            let determinant = ratio.determinant();
            let Some(gain) = ratio.try_inverse().filter(|_| determinant > 0.0).map(|inverse| inverse * change) else {
                continue;
            };
            let moved = &gain * &own_mean;
            // What a wider prior costs, and how much of it the data leave.
            let space =
                -0.5 * determinant.ln() + k as f64 * (family.prior / family.fault).ln() + (fault_odds / n_places).ln();
            let log = -0.5 * own_mean.dot(&moved) + space;
            let columns = all_covariance.columns(N_BEFORE + first, k).into_owned();
            let whole = &whole - &columns * moved;
            let (joint_mean, joint_covariance) =
                joint(&whole, &(&all_covariance - product(&product(&columns, &gain), &columns.transpose())));
            let columns = columns.rows(N_BEFORE, n).into_owned();
            let covariance = &covariance - product(&product(&columns, &gain), &columns.transpose());
            let mean = whole.rows(N_BEFORE, n).into_owned();
            let fault = Some((f, first..first + k));
            all.push((log, Hypothesis { fault, weight: 0.0, whole, mean, covariance, joint_mean, joint_covariance }));
        }
    }
    let largest = all.iter().map(|(log, _)| *log).fold(0.0, f64::max);
    let sum: f64 = all.iter().map(|(log, _)| (log - largest).exp()).sum();
    let weighted =
        |(log, hypothesis): (f64, Hypothesis)| Hypothesis { weight: (log - largest).exp() / sum, ..hypothesis };
    Some(all.into_iter().map(weighted).collect())
}

#[cfg(test)]
mod tests;
