//! All causes at once, each drawn from its stated prior.
//!
//! The only place that knows the judge's parameters, by the names of their fields. Where one is renamed or added, this list
//! follows.

use super::effect::{self, Effect, Modes};
use super::faults::{Claim, Part};
use super::sound::{Site, direction, normal};
use osteoflow_algorithms::trust::PredictParams;
use osteoflow_geometry::nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// A cause of a size in the unit of its prior.
fn cause(name: &'static str, size: f64, effect: Effect) -> Part {
    const CLAIMS: &[Claim] = &[];
    Part { name, effect, size, half_wrong: size, claims: CLAIMS }
}

/// The CT's causes: lengths from the middle of the scan, the ends of the scan half its length away.
fn in_ct(rng: &mut ChaCha8Rng, site: &Site, params: &PredictParams) -> Vec<Part> {
    let priors = &params.nuisances;
    let centre = site.middle(site.centre_mm());
    let linear = |matrix: Matrix3<f64>| -> Effect { Effect::Ct(Box::new(move |size, p| matrix * (p - centre) * size)) };
    let along = site.along * site.along.transpose();
    let way = effect::across(rng, site);
    let wide = way * way.transpose();
    let sheared = way * site.along.transpose();
    let (stretch, shear) = (priors.stretch_percent / 100.0 * normal(rng), priors.shear_deg.to_radians() * normal(rng));
    let across = priors.stretch_percent / 100.0 * normal(rng);
    let growth = priors.stretch_percent / 100.0 * normal(rng);
    let (bent, half_mm, middle_mm) = (effect::across(rng, site), site.length_mm() / 2.0, site.centre_mm());
    let [at_bend, at_twist, at_step] = [site.clone(), site.clone(), site.clone()];
    let share = move |site: &Site, p: &_| (site.height_mm(p) - middle_mm) / half_mm;
    let bend: Effect = Effect::Ct(Box::new(move |size, p| bent * (size * share(&at_bend, p).powi(2))));
    let twist = Effect::Ct(Box::new(move |size: f64, p| {
        let turn =
            Rotation3::from_axis_angle(&Unit::new_normalize(at_twist.along), size.to_radians() * share(&at_twist, p));
        turn * (p - centre) - (p - centre)
    }));
    let (aside, place_mm) = (direction(rng), rng.random_range(site.window_mm[0]..site.window_mm[1]));
    let step = Effect::Ct(Box::new(
        move |size, p| {
            if at_step.height_mm(p) < place_mm { aside * size } else { Vector3::zeros() }
        },
    ));
    vec![
        cause("stretch", stretch, linear(along)),
        cause("stretch across", across, linear(wide)),
        cause("growth", growth, linear(Matrix3::identity())),
        cause("shear", shear, linear(sheared)),
        cause("bend", priors.bend_mm * normal(rng), bend),
        cause("twist", priors.twist_deg * normal(rng), twist),
        cause("step", priors.step_mm * normal(rng), step),
    ]
}

/// Causes on the surface, on the bone, and of the camera.
fn beside(rng: &mut ChaCha8Rng, site: &Site, params: &PredictParams) -> Vec<Part> {
    let priors = &params.nuisances;
    let modes = Modes::drawn(rng, 6, [15.0, 120.0], 3);
    let [at_field, at_along, at_around] = [site.clone(), site.clone(), site.clone()];
    let field = Effect::Surface(Box::new(move |p| modes.at(at_field.height_mm(p), at_field.around(p))));
    let along = Effect::Film(Box::new(move |p| {
        ((at_along.height_mm(p) - at_along.window_mm[0]) / at_along.length_mm()).clamp(0.0, 1.0)
    }));
    let is_turned: bool = rng.random();
    let around = Effect::Film(Box::new(move |p| {
        let off = (at_around.around(p) - at_around.view_rad + PI).rem_euclid(TAU) - PI;
        let share = (off / PI + 0.5).clamp(0.0, 1.0);
        if is_turned { 1.0 - share } else { share }
    }));
    let depth = |p: &osteoflow_geometry::nalgebra::Point3<f64>| Vector3::new(0.0, 0.0, p.z);
    vec![
        cause("offset", priors.offset_mm * normal(rng), Effect::Surface(Box::new(|_| 1.0))),
        cause("field", priors.field_mm * normal(rng), field),
        cause("film", priors.film_mm * normal(rng).abs(), Effect::Film(Box::new(|_| 1.0))),
        cause("film along", priors.film_mm * normal(rng).abs(), along),
        cause("film around", priors.film_mm * normal(rng).abs(), around),
        cause(
            "scale of the camera",
            priors.camera_percent * normal(rng),
            Effect::Camera(Box::new(|size, p| p.coords * (size / 100.0))),
        ),
        cause(
            "depth of the camera",
            priors.camera_percent * normal(rng),
            Effect::Camera(Box::new(move |size, p| depth(p) * (size / 100.0))),
        ),
    ]
}

/// Every cause that has a prior in the judge's parameters, each drawn from it: a normal distribution, a half-normal one of films.
pub(super) fn causes_from_priors(rng: &mut ChaCha8Rng, site: &Site) -> Vec<Part> {
    let params = PredictParams::default();
    let mut causes = in_ct(rng, site, &params);
    causes.extend(beside(rng, site, &params));
    causes
}
