//! Faults of the camera since its calibration; its z is the optical axis, its x runs along the bone.

use super::super::effect::{Effect, turned};
use super::super::sound::{Site, direction, normal};
use osteoflow_geometry::nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Distance from the lens to the bone, and half of a usual field of view, mm.
const DISTANCE_MM: f64 = 200.0;
const HALF_MM: f64 = 50.0;

fn off_axis(p: &Point3<f64>) -> [f64; 2] {
    [p.x / HALF_MM, p.y / HALF_MM]
}

/// Size: depth at 50 mm off the axis, mm.
pub(super) fn plane(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
    let common = normal(rng);
    Effect::Camera(Box::new(move |size, p| {
        let [x, y] = off_axis(p);
        p.coords.normalize() * (size * (cos * x + sin * y + 0.5 * common))
    }))
}

/// A bend about a centre of its own, with a tilt. Size: depth at 50 mm from the centre, mm.
pub(super) fn bend(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
    let (other, tilt) = (rng.random_range(-1.0..1.0), [normal(rng), normal(rng)]);
    let centre = [0.4 * normal(rng), 0.4 * normal(rng)];
    Effect::Camera(Box::new(move |size, p| {
        let [x, y] = off_axis(p);
        let [u, v] = [x - centre[0], y - centre[1]];
        let [along, aside] = [cos * u + sin * v, cos * v - sin * u];
        let bent = along * along + other * aside * aside;
        p.coords.normalize() * (size * (bent + 0.4 * (tilt[0] * x + tilt[1] * y)))
    }))
}

/// Size: percent.
pub(super) fn scale(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let sign = if rng.random() { 0.01 } else { -0.01 };
    Effect::Camera(Box::new(move |size, p| p.coords * (size * sign)))
}

/// Size: root of the sum of the squares of the three excesses, percent.
pub(super) fn axes(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let excess = direction(rng) / 100.0;
    Effect::Camera(Box::new(move |size, p| p.coords.component_mul(&excess) * size))
}

/// Size: displacement off the axis at 50 mm, percent.
pub(super) fn radial(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let sign = if rng.random() { 0.01 } else { -0.01 };
    let centre = [10.0 * normal(rng), 10.0 * normal(rng)];
    Effect::Camera(Box::new(move |size, p| {
        let off = Vector3::new(p.x - centre[0], p.y - centre[1], 0.0) * (DISTANCE_MM / p.z);
        off * (size * sign * off.norm_squared() / HALF_MM.powi(2))
    }))
}

/// Camera and its marker move against each other. Size: shift, mm, with up to 0.3 degrees for each mm about the lens.
pub(super) fn drift(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let (way, axis, deg_per_mm) = (direction(rng), direction(rng), rng.random_range(0.0..0.3));
    Effect::Camera(Box::new(move |size, p| {
        way * size + turned(&axis, (size * deg_per_mm).to_radians(), &Point3::origin(), p)
    }))
}
