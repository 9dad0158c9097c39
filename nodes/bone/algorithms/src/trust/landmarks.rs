//! Landmarks against the surface, and each against the others.

use super::Spread;
use crate::kabsch::kabsch;
use crate::product::product;
use nalgebra::{DMatrix, DVector, Matrix3x6, Point3, Vector3};
use osteoflow_geometry::NamedPoint;
use osteoflow_node_macros::params;
use osteoflow_verdict::{Answer, Reason};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Chance that landmarks with their stated errors contradict a sound registration, by all together or by the worst alone.
const LEVEL: f64 = 0.002;

/// Number of landmarks from which one can be told from the others without a surface.
const N_ALONE: usize = 4;

/// Stated errors of located landmarks.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LandmarkErrors {
    /// Standard deviation, per axis, of a landmark on the surface, planned and located. 1.5: aimed with a laser or picked by
    /// hand to 1 to 2 mm along the surface.
    #[param(1.5, 0.01..=100.0)]
    pub landmark_mm: f64,
    /// Standard deviation, per axis, of a fiducial off the surface. 0.5: with a tracked stylus fiducials were located to 0.3 to
    /// 0.4 per axis (FRE of 0.4 to 0.6), to which the stylus' tip, 0.2, and the CT's voxel, 0.2, add.
    #[param(0.5, 0.01..=100.0)]
    pub fiducial_mm: f64,
}

/// Located landmarks beside the planned ones.
pub(super) struct Compared<'a> {
    /// The planned landmarks.
    pub(super) planned: &'a [NamedPoint],
    /// The located ones, as the registration carries them.
    pub(super) carried: &'a [NamedPoint],
    /// "landmark" or "fiducial".
    pub(super) word: &'a str,
    /// Stated error of one of them, SD per axis, mm.
    pub(super) sd_mm: f64,
    /// The scan, as the registration carries it.
    pub(super) scan: &'a [Point3<f64>],
}

/// A planned landmark and the place to which the registration carries the located one.
struct Pair<'a> {
    name: &'a str,
    planned: Point3<f64>,
    carried: Point3<f64>,
}

impl Pair<'_> {
    fn off(&self) -> Vector3<f64> {
        self.carried - self.planned
    }
}

/// How far landmarks are off, as a share of what their errors allow.
struct Misfit {
    rms_mm: f64,
    /// Above 1, they contradict.
    share: f64,
    explained_mm: f64,
}

/// The sign that landmarks lie farther from where the registration of the surface puts them than their errors and its spread allow;
/// without a spread, that they do not fit each other.
pub(super) fn landmarks_contradict(compared: &Compared<'_>, spread: Option<&Spread>) -> Option<Reason> {
    let Compared { planned, carried, word, sd_mm, scan } = *compared;
    let pair = |p: &'_ NamedPoint| carried.iter().find(|c| c.name == p.name).map(|c| c.position);
    let pairs: Vec<Pair<'_>> =
        planned.iter().filter_map(|p| Some(Pair { name: &p.name, planned: p.position, carried: pair(p)? })).collect();
    let all: Vec<&Pair<'_>> = pairs.iter().collect();
    let found = misfit(&all, spread, sd_mm)?;
    if found.share <= 1.0 {
        return None;
    }
    let (reference, puts) = match spread {
        Some(_) => ("the registration of the surface", "puts"),
        None => ("the others", "put"),
    };
    let n_rest = pairs.len() - 1;
    let without = |k: usize| {
        let rest: Vec<&Pair<'_>> = pairs.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, pair)| pair).collect();
        let rest_misfit = misfit(&rest, spread, sd_mm)?;
        let off_mm = if spread.is_some() { pairs[k].off().norm() } else { off_the_others(&pairs[k], &rest)? };
        Some((k, off_mm, rest_misfit))
    };
    let best = (0..pairs.len()).filter_map(without).min_by(|a, b| a.2.share.total_cmp(&b.2.share));
    let explained_mm = found.explained_mm;
    let text = match best.filter(|(_, _, rest)| rest.share <= 1.0) {
        Some((k, off_mm, rest)) => format!(
            "the {word} {} lies {off_mm:.1} mm from where {reference} {puts} it, and the other {n_rest} fit to {:.1} mm (RMS): its stated \
             error of {sd_mm} mm per axis does not explain it",
            pairs[k].name, rest.rms_mm
        ),
        None => {
            let worst = pairs.iter().max_by(|a, b| a.off().norm().total_cmp(&b.off().norm()))?;
            let worst = spread.map(|_| format!(", {} by {:.1} mm", worst.name, worst.off().norm())).unwrap_or_default();
            let rms_mm = found.rms_mm;
            let apart = apart_at(&pairs, scan).map_or_else(
                || format!("{rms_mm:.1} mm"),
                |mm| format!("{mm:.1} mm at the scan (mean), {rms_mm:.1} mm at the {word}s"),
            );
            format!(
                "{word}s and surface contradict each other by {apart}: so far (RMS) do the {} {word}s lie from where {reference} {puts} \
                 them{worst}; their stated error of {sd_mm} mm per axis and the spread of the registration explain {explained_mm:.1} mm",
                pairs.len()
            )
        }
    };
    let remedy = format!(
        "locate the {word}s again, and check the stylus' tip, the names and that plan and surface are of one CT; state their error \
         (`rules.landmarks`) if it is larger"
    );
    Some(Reason::new("landmarks_contradict", Answer::Doubtful, text, remedy))
}

/// How far apart the fit of the landmarks and the registration of the surface put the scan, mm; none with fewer than three landmarks.
fn apart_at(pairs: &[Pair<'_>], scan: &[Point3<f64>]) -> Option<f64> {
    let (planned, carried): (Vec<_>, Vec<_>) = pairs.iter().map(|pair| (pair.planned, pair.carried)).unzip();
    let t = kabsch(&planned, &carried).ok().filter(|_| !scan.is_empty())?;
    Some(scan.iter().map(|p| (t * p - p).norm()).sum::<f64>() / scan.len() as f64)
}

/// Distance of a landmark from where the fit of the others puts it, mm.
fn off_the_others(left_out: &Pair<'_>, rest: &[&Pair<'_>]) -> Option<f64> {
    let (planned, carried): (Vec<_>, Vec<_>) = rest.iter().map(|pair| (pair.planned, pair.carried)).unzip();
    Some((kabsch(&planned, &carried).ok()? * left_out.carried - left_out.planned).norm())
}

/// The misfit of landmarks against the registration, whose spread they share, or, without one, against their own rigid fit; `None` if
/// too few are left.
fn misfit(pairs: &[&Pair<'_>], spread: Option<&Spread>, sd_mm: f64) -> Option<Misfit> {
    let n = pairs.len();
    let (off, covariance, dof) = match spread {
        Some(_) if n == 0 => return None,
        Some(spread) => {
            let mut levers = DMatrix::zeros(3 * n, 6);
            for (k, pair) in pairs.iter().enumerate() {
                let mut lever = Matrix3x6::identity();
                lever.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(pair.carried - spread.centre).cross_matrix());
                levers.fixed_view_mut::<3, 6>(3 * k, 0).copy_from(&lever);
            }
            let covariance = DMatrix::from_column_slice(6, 6, spread.covariance.as_slice());
            let shared = product(&product(&levers, &covariance), &levers.transpose());
            (pairs.iter().map(|pair| pair.off()).collect::<Vec<_>>(), shared, 3 * n)
        }
        None if n < N_ALONE - 1 => return None,
        None => {
            let (planned, carried): (Vec<_>, Vec<_>) = pairs.iter().map(|pair| (pair.planned, pair.carried)).unzip();
            let t = kabsch(&planned, &carried).ok()?;
            let off = planned.iter().zip(&carried).map(|(planned, carried)| t * carried - planned);
            (off.collect(), DMatrix::zeros(3 * n, 3 * n), 3 * n - 6)
        }
    };
    let covariance = covariance + DMatrix::identity(3 * n, 3 * n) * sd_mm.powi(2);
    let stacked = DVector::from_iterator(3 * n, off.iter().flat_map(|off| off.iter().copied()));
    let squares = stacked.dot(&covariance.clone().cholesky()?.solve(&stacked));
    let own = |k: usize| {
        let block = covariance.fixed_view::<3, 3>(3 * k, 3 * k).into_owned();
        Some(off[k].dot(&block.cholesky()?.solve(&off[k])))
    };
    let worst = (0..n).filter_map(own).fold(0.0, f64::max);
    let limit = |dof: usize, p: f64| ChiSquared::new(dof as f64).ok().map(|of| of.inverse_cdf(1.0 - p));
    let share = (squares / limit(dof, LEVEL / 2.0)?).max(worst / limit(3, LEVEL / 2.0 / n as f64)?);
    let explained_mm = (covariance.trace() / n as f64).sqrt();
    let rms_mm = (off.iter().map(Vector3::norm_squared).sum::<f64>() / n as f64).sqrt();
    Some(Misfit { rms_mm, share, explained_mm })
}

#[cfg(test)]
mod tests;
