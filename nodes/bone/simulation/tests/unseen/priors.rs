//! All causes at once, each drawn from its stated prior.
//!
//! The only place that knows the judge's parameters, by the names of their fields. Where one is renamed or added, this list
//! follows. What each cause displaces is as the list of causes of docs/method/trust.md has it.

use super::effect::{Effect, Field, Profile, turned};
use super::faults::{Claim, Part};
use super::sound::{Site, normal};
use osteoflow_algorithms::trust::{NuisanceParams, PredictParams};
use osteoflow_geometry::nalgebra::{Matrix3, Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::FRAC_PI_2;

/// Half waves along the scan and waves around the bone of a smooth error of the surface.
const SMOOTH: [[f64; 2]; 8] =
    [[1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [0.0, 2.0], [1.0, 2.0], [2.0, 2.0]];

/// Half waves along the scan of the camera's depth.
const DEPTH: std::ops::RangeInclusive<u32> = 2..=15;

/// A cause with its drawn sizes in its effect.
fn cause(name: &'static str, effect: Effect) -> Part {
    const CLAIMS: &[Claim] = &[];
    Part { name, effect, size: 1.0, half_wrong: 1.0, claims: CLAIMS }
}

/// A displacement in proportion to the size.
fn field(at: impl Fn(&Point3<f64>) -> Vector3<f64> + Send + Sync + 'static) -> Field {
    Box::new(move |size, p| at(p) * size)
}

/// Position along the bone, from -1 at one end of the scan to 1 at the other.
fn share(site: &Site, p: &Point3<f64>) -> f64 {
    2.0 * (site.height_mm(p) - site.centre_mm()) / site.length_mm()
}

fn vector(rng: &mut ChaCha8Rng, sd: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| sd * normal(rng))
}

/// The CT's causes, the plan's and the marker's.
fn in_ct(rng: &mut ChaCha8Rng, site: &Site, priors: &NuisanceParams) -> Vec<Part> {
    let centre = site.middle(site.centre_mm());
    let linear = |matrix: Matrix3<f64>| Effect::Ct(field(move |p| matrix * (p - centre)));
    let (along, lateral, posterior) = (site.along, site.lateral, site.posterior);
    let strain = |of: Vector3<f64>, to: Vector3<f64>| to * of.transpose();
    let mut percent = |of: f64| of / 100.0 * normal(rng);
    let stretch = strain(along, along) * percent(priors.stretch_percent);
    let growth = Matrix3::identity() * percent(priors.stretch_percent);
    let six = [
        (along, along),
        (lateral, lateral),
        (posterior, posterior),
        (along, lateral),
        (along, posterior),
        (lateral, posterior),
    ];
    let affine: Matrix3<f64> = six.map(|(of, to)| strain(of, to) * percent(priors.affine_percent)).into_iter().sum();
    let shear = strain(Vector3::y(), Vector3::z()) * (priors.shear_deg.to_radians() * normal(rng));
    let aside = lateral * (priors.bend_mm * normal(rng)) + posterior * (priors.bend_mm * normal(rng));
    let at = site.clone();
    let bend = field(move |p| aside * share(&at, p).powi(2));
    let (at, rad) = (site.clone(), priors.twist_deg.to_radians() * normal(rng));
    let twist = field(move |p| turned(&along, rad * share(&at, p), &centre, p));
    let (at, step, place_mm) =
        (site.clone(), vector(rng, priors.step_mm), rng.random_range(site.window_mm[0]..site.window_mm[1]));
    let step = field(move |p| if at.height_mm(p) > place_mm { step } else { Vector3::zeros() });
    let (at, turns) = (site.clone(), [0, 1].map(|_| vector(rng, priors.beyond_deg.to_radians())));
    let beyond = field(move |p| {
        let end = usize::from(share(&at, p) > 0.0);
        let is_beyond = share(&at, p).abs() > 1.0;
        let turn = turns[end];
        if is_beyond { turned(&turn, turn.norm(), &at.middle(at.window_mm[end]), p) } else { Vector3::zeros() }
    });
    let plan = vector(rng, priors.plan_mm);
    let of_bone = [("bend", bend), ("twist", twist), ("step", step), ("bone beyond the scan", beyond)];
    let of_bone = of_bone.map(|(name, field)| cause(name, Effect::Ct(field)));
    let of_voxels = [("stretch", stretch), ("growth", growth), ("affine", affine), ("shear", shear)];
    let of_voxels = of_voxels.map(|(name, matrix)| cause(name, linear(matrix)));
    let plan = cause("plan", Effect::Plan(field(move |_| plan)));
    let marker = cause("marker", Effect::Marker(vector(rng, priors.slip_mm), Vector3::zeros()));
    of_voxels.into_iter().chain(of_bone).chain([plan, marker]).collect()
}

/// Causes on the surface and on the bone.
fn on_surface(rng: &mut ChaCha8Rng, site: &Site, priors: &NuisanceParams) -> Vec<Part> {
    let at = site.clone();
    let offset_mm = priors.offset_mm * normal(rng);
    let waves = SMOOTH.map(|wave| {
        let [cos, sin] = [0, 1].map(|_| priors.smooth_mm * normal(rng));
        (wave, cos, if wave[1] > 0.0 { sin } else { 0.0 })
    });
    let smooth = move |p: &Point3<f64>| -> f64 {
        let (phase, angle) = (FRAC_PI_2 * (share(&at, p).clamp(-1.0, 1.0) + 1.0), at.around(p) - at.view_rad);
        let one = |&([half_waves, around], cos, sin): &([f64; 2], f64, f64)| {
            (half_waves * phase).cos() * (cos * (around * angle).cos() + sin * (around * angle).sin())
        };
        waves.iter().map(one).sum()
    };
    // A film is not negative.
    let mut film = || priors.film_mm * normal(rng).abs();
    let (even_mm, along_mm, around_mm) = (film(), film(), film());
    let [at, to] = [(); 2].map(|()| site.clone());
    let along: Profile = Box::new(move |p| along_mm * 0.5 * (1.0 + share(&at, p).clamp(-1.0, 1.0)));
    let around: Profile = Box::new(move |p| around_mm * 0.5 * (1.0 + (to.around(p) - to.view_rad).sin()));
    vec![
        cause("offset", Effect::Surface(Box::new(move |_| offset_mm))),
        cause("smooth", Effect::Surface(Box::new(smooth))),
        cause("film", Effect::Film(Box::new(move |_| even_mm))),
        cause("film along", Effect::Film(along)),
        cause("film around", Effect::Film(around)),
    ]
}

/// The camera's causes, and its field; its z is the optical axis, its x runs along the bone.
fn of_camera(rng: &mut ChaCha8Rng, site: &Site, priors: &NuisanceParams) -> Vec<Part> {
    /// Half of the width of a bone, mm.
    const HALF_WIDTH_MM: f64 = 6.0;
    let half_mm = site.length_mm() / 2.0;
    let mut percent = || priors.camera_percent / 100.0 * normal(rng);
    let (scale, depth, tilts) = (percent(), percent(), [percent(), percent()]);
    let bends = [(1.0, 0.0), (0.0, 1.0), (FRAC_PI_2 / 2.0).sin_cos(), (-FRAC_PI_2 / 2.0).sin_cos()];
    let bends = bends.map(|way| (way, priors.field_mm * normal(rng)));
    let waves = DEPTH.map(|half_waves| {
        let sd_mm = priors.field_mm * f64::from(*DEPTH.start()) / f64::from(half_waves);
        (f64::from(half_waves), sd_mm * normal(rng), sd_mm * normal(rng))
    });
    let waves: Vec<(f64, f64, f64)> = waves.collect();
    let along_view = |mm: Profile| Effect::Camera(field(move |p| Vector3::new(0.0, 0.0, mm(p))));
    let bend = move |p: &Point3<f64>| -> f64 {
        bends.iter().map(|((x, y), mm)| mm * ((x * p.x + y * p.y) / half_mm).powi(2)).sum()
    };
    let waved = move |p: &Point3<f64>| -> f64 {
        let phase = FRAC_PI_2 * ((p.x / half_mm).clamp(-1.0, 1.0) + 1.0);
        let across = (p.y / HALF_WIDTH_MM).clamp(-1.0, 1.0);
        waves.iter().map(|(half_waves, even, odd)| (half_waves * phase).cos() * (even + odd * across)).sum()
    };
    vec![
        cause("scale of the camera", Effect::Camera(field(move |p| p.coords * scale))),
        cause("depth of the camera", along_view(Box::new(move |p| p.z * depth))),
        cause("tilt of the depth", along_view(Box::new(move |p| tilts[0] * p.x + tilts[1] * p.y))),
        cause("bend of the depth", along_view(Box::new(bend))),
        cause("field", along_view(Box::new(waved))),
    ]
}

/// Every cause that has a prior in the judge's parameters, each drawn from it: a normal distribution, a half-normal one of films.
pub(super) fn causes_from_priors(rng: &mut ChaCha8Rng, site: &Site) -> Vec<Part> {
    let priors = PredictParams::default().nuisances;
    let mut causes = in_ct(rng, site, &priors);
    causes.extend(on_surface(rng, site, &priors));
    causes.extend(of_camera(rng, site, &priors));
    causes
}
