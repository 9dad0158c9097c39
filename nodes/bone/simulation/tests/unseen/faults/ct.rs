//! Faults of the CT, of its segmentation, and of the plan's header.

use super::super::effect::{Effect, Modes, across, smoothstep, turned};
use super::super::sound::{Site, direction, normal};
use osteoflow_geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// How far beyond the scan a place is drawn, mm: about as far as cuts are planned.
const BEYOND_MM: f64 = 50.0;

fn place_mm(rng: &mut ChaCha8Rng, site: &Site) -> f64 {
    rng.random_range(site.window_mm[0]..site.window_mm[1] + BEYOND_MM)
}

/// Size: RMS displacement along the surface's normals, mm.
pub(super) fn segmentation(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    surface(rng, site, [15.0, 120.0], 3)
}

/// Size: RMS displacement along the surface's normals, mm.
pub(super) fn threshold(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    surface(rng, site, [100.0, 800.0], 1)
}

fn surface(rng: &mut ChaCha8Rng, site: &Site, wavelength_mm: [f64; 2], most_around: i32) -> Effect {
    let n = rng.random_range(1..=4);
    let (modes, site) = (Modes::drawn(rng, n, wavelength_mm, most_around), site.clone());
    Effect::Surface(Box::new(move |p| modes.at(site.height_mm(p), site.around(p))))
}

/// Size: RMS length of the displacement, mm.
pub(super) fn warp(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let n = rng.random_range(1..=3);
    let fields: Vec<(Vector3<f64>, Modes)> =
        (0..n).map(|_| (direction(rng), Modes::drawn(rng, 1, [60.0, 400.0], 0))).collect();
    let (scale, site) = (1.0 / f64::from(n).sqrt(), site.clone());
    Effect::Ct(Box::new(move |size, p| {
        let height_mm = site.height_mm(p);
        fields.iter().map(|(way, modes)| way * (size * scale * modes.at(height_mm, 0.0))).sum()
    }))
}

/// What is proximal of a place, or distal of it, is turned about an axis through the bone there. Size: degrees.
pub(super) fn kink(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (place_mm, axis, is_proximal): (_, _, bool) = (place_mm(rng, site), across(rng, site), rng.random());
    let (pivot, site) = (site.middle(place_mm), site.clone());
    Effect::Ct(Box::new(move |size, p| {
        let is_turned = (site.height_mm(p) > place_mm) == is_proximal;
        if is_turned { turned(&axis, size.to_radians(), &pivot, p) } else { Vector3::zeros() }
    }))
}

/// Size: sagitta over 100 mm, mm.
pub(super) fn bend(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (place_mm, way, is_proximal): (_, _, bool) = (place_mm(rng, site), across(rng, site), rng.random());
    let site = site.clone();
    Effect::Ct(Box::new(move |size, p| {
        let beyond_mm = site.height_mm(p) - place_mm;
        let is_bent = (beyond_mm > 0.0) == is_proximal;
        if is_bent { way * (size * (beyond_mm / 50.0).powi(2)) } else { Vector3::zeros() }
    }))
}

/// Size: degrees over 100 mm.
pub(super) fn twist(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (place_mm, is_proximal): (_, bool) = (place_mm(rng, site), rng.random());
    let (pivot, site) = (site.middle(place_mm), site.clone());
    Effect::Ct(Box::new(move |size, p| {
        let beyond_mm = site.height_mm(p) - place_mm;
        let is_twisted = (beyond_mm > 0.0) == is_proximal;
        let rad = (size * beyond_mm / 100.0).to_radians();
        if is_twisted { turned(&site.along, rad, &pivot, p) } else { Vector3::zeros() }
    }))
}

/// Size: length of the bone that the CT lacks, mm.
pub(super) fn missing(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (place_mm, site) = (place_mm(rng, site), site.clone());
    Effect::Ct(Box::new(move |size, p| -site.along * (site.height_mm(p) - place_mm).clamp(0.0, size)))
}

/// The CT goes on for a while with the section of one place. Size: length by which it is longer, mm.
pub(super) fn doubled(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (place_mm, site) = (place_mm(rng, site), site.clone());
    Effect::Ct(Box::new(move |size, p| if site.height_mm(p) > place_mm { site.along * size } else { Vector3::zeros() }))
}

/// A piece that the scanned bone lacks, whose ends were joined with an angle and a step of their own. Size: its length, mm.
pub(super) fn piece(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (place_mm, axis) = (place_mm(rng, site), across(rng, site));
    let (deg_per_mm, aside) = (0.4 * normal(rng), across(rng, site) * (0.3 * normal(rng)));
    let (pivot, site) = (site.middle(place_mm), site.clone());
    Effect::Ct(Box::new(move |size, p| {
        if site.height_mm(p) <= place_mm {
            return Vector3::zeros();
        }
        (site.along + aside) * size + turned(&axis, (deg_per_mm * size).to_radians(), &pivot, p)
    }))
}

/// The leg turns about an axis beside the bone while the slices of some length are taken. Size: degrees.
pub(super) fn leg(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (place_mm, length_mm) = (place_mm(rng, site), rng.random_range(3.0..60.0));
    let (axis, pivot) = (direction(rng), site.middle(place_mm) + across(rng, site) * rng.random_range(0.0..60.0));
    let site = site.clone();
    Effect::Ct(Box::new(move |size, p| {
        let share = smoothstep((site.height_mm(p) - place_mm) / length_mm + 0.5);
        turned(&axis, (size * share).to_radians(), &pivot, p)
    }))
}

fn linear(site: &Site, matrix: Matrix3<f64>) -> Effect {
    let centre = site.middle(site.centre_mm());
    Effect::Ct(Box::new(move |size, p| matrix * (p - centre) * (size / 100.0)))
}

/// One or two axes of an oblique volume have a wrong spacing. Size: percent.
pub(super) fn spacing(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let tilt = Rotation3::new(direction(rng) * rng.random_range(0f64..45.0).to_radians());
    let mut excess = Vector3::ith(rng.random_range(0..3), 1.0);
    if rng.random() {
        excess[rng.random_range(0..3)] = rng.random_range(-1.0..1.0);
    }
    let matrix = tilt.matrix() * Matrix3::from_diagonal(&excess) * tilt.matrix().transpose();
    linear(site, matrix * sign(rng))
}

/// Planes are displaced along themselves. Size: percent.
pub(super) fn shear(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let normal = direction(rng);
    let way = normal.cross(&direction(rng)).normalize();
    linear(site, way * normal.transpose())
}

/// Size: root of the sum of the squares of all nine elements, percent.
pub(super) fn affine(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    linear(site, Matrix3::from_fn(|_, _| normal(rng)).normalize())
}

/// The plan is in the coordinates of another header, shifted along its slices or in any direction. Size: mm.
pub(super) fn header_shift(rng: &mut ChaCha8Rng, _: &Site) -> Effect {
    let way = if rng.random() { Vector3::z() } else { direction(rng) } * sign(rng);
    Effect::Plan(Box::new(move |size, _| way * size))
}

/// The plan is in the coordinates of another header, with another spacing from its first slice on. Size: percent.
pub(super) fn header_spacing(rng: &mut ChaCha8Rng, site: &Site) -> Effect {
    let (sign, first) = (sign(rng), site.tip + Vector3::z() * rng.random_range(-100.0..50.0));
    Effect::Plan(Box::new(move |size, p| Vector3::z() * (size * sign * (p.z - first.z) / 100.0)))
}

fn sign(rng: &mut ChaCha8Rng) -> f64 {
    if rng.random() { 1.0 } else { -1.0 }
}
