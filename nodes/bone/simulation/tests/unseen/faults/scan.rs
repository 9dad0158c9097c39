//! Faults while the scan is taken and after it: motion, what covers the bone, and a marker that moved.

use super::super::effect::{Effect, Modes, smoothstep, turned};
use super::super::sound::{Site, direction, normal};
use osteoflow_geometry::nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

const DISTANCE_MM: f64 = 200.0;

/// Course of a motion over the scan: 0 at its stamp, in the middle.
type Course = Box<dyn Fn(f64) -> f64 + Send + Sync>;

/// Motion of bone against camera by `screw`, which has a size and a share; the image is swept in a random direction.
fn swept(
    rng: &mut ChaCha8Rng,
    site: &Site,
    course: Course,
    screw: impl Fn(f64, &Point3<f64>) -> Vector3<f64> + Send + Sync + 'static,
) -> Effect {
    let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
    // The bone is about 14 mm wide in the image.
    let extent_mm = cos.abs() * site.length_mm() + sin.abs() * 14.0;
    Effect::Sweep(Box::new(move |size, p| {
        let share = ((cos * p.x + sin * p.y) / extent_mm).clamp(-0.6, 0.6);
        screw(size * course(share), p)
    }))
}

/// Even, accelerated, or at the start or end alone.
fn course(rng: &mut ChaCha8Rng) -> Course {
    let from = rng.random_range(-0.3..0.3);
    match rng.random_range(0..3) {
        0 => Box::new(|share| share),
        1 => Box::new(|share| share + 2.0 * share * share),
        _ => Box::new(move |share| smoothstep((share - from) / 0.2 + 0.5) - smoothstep(-from / 0.2 + 0.5)),
    }
}

/// Size: mm over the scan.
pub(super) fn shift(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (way, course) = (direction(rng), course(rng));
    swept(rng, site, course, move |size, _| way * size)
}

/// With up to 0.8 degrees for each mm, about an axis near the bone. Size: mm over the scan.
pub(super) fn screw(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (way, axis, course) = (direction(rng), direction(rng), course(rng));
    let deg_per_mm = rng.random_range(0.0..0.8);
    let pivot = Point3::new(30.0 * normal(rng), 10.0 * normal(rng), DISTANCE_MM);
    swept(rng, site, course, move |size, p| way * size + turned(&axis, (deg_per_mm * size).to_radians(), &pivot, p))
}

/// A hand that shakes, with up to 0.5 degrees for each mm. Size: from one end of the motion to the other, mm.
pub(super) fn shake(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (way, axis, deg_per_mm) = (direction(rng), direction(rng), rng.random_range(0.0..0.5));
    let (waves, phase) = (rng.random_range(0.4..3.0), TAU * rng.random::<f64>());
    let course: Course = Box::new(move |share| ((TAU * waves * share + phase).sin() - phase.sin()) / 2.0);
    let pivot = Point3::new(0.0, 0.0, DISTANCE_MM);
    swept(rng, site, course, move |size, p| way * size + turned(&axis, (deg_per_mm * size).to_radians(), &pivot, p))
}

/// Size: mm, with up to 0.5 degrees for each mm.
pub(super) fn slip(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let turn = direction(rng) * rng.random_range(0.0..0.5);
    Effect::Marker(direction(rng), turn)
}

/// Modes along and around, with a trend. Size: maximum thickness, mm.
pub(super) fn film(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let n = rng.random_range(1..=3);
    let (modes, trend) = (Modes::drawn(rng, n, [40.0, 500.0], 2), rng.random_range(-1.0..1.0));
    let (site, share) = (site.clone(), rng.random_range(0.0..1.0));
    Effect::Film(Box::new(move |p| {
        let height_mm = site.height_mm(p);
        let along = ((height_mm - site.centre_mm()) / site.length_mm() * 2.0).clamp(-1.0, 1.0);
        let wave = modes.at(height_mm, site.around(p)) / modes.most();
        (1.0 + (1.0 - share) * wave + share * trend * along) / 2.0
    }))
}

/// Size: maximum thickness, mm.
pub(super) fn patches(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (modes, site) = (Modes::drawn(rng, 6, [12.0, 80.0], 3), site.clone());
    let (from, width) = (rng.random_range(-1.0..1.0), rng.random_range(0.2..1.5));
    Effect::Film(Box::new(move |p| smoothstep((modes.at(site.height_mm(p), site.around(p)) - from) / width)))
}
