//! What a fault does: to the CT, to its surface, to the plan, to the camera's points, to what covers the bone, or to a marker.

use super::sound::{Site, normal, stream};
use osteoflow_geometry::nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Unit, UnitQuaternion, Vector3};
use osteoflow_geometry::{NamedPoint, Plane, Planes, Points};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Displacement of a point for a size, mm: exactly zero for size zero.
pub(super) type Field = Box<dyn Fn(f64, &Point3<f64>) -> Vector3<f64> + Send + Sync>;
/// A number at a point, for size one.
pub(super) type Profile = Box<dyn Fn(&Point3<f64>) -> f64 + Send + Sync>;

pub(super) enum Effect {
    /// From the bone to its image in the CT, with the plan; both in frame `ct`.
    Ct(Field),
    /// The CT's surface alone, along its normals.
    Surface(Profile),
    /// The plan alone.
    Plan(Field),
    /// The camera's points, frame `camera`.
    Camera(Field),
    /// The camera's points of the bone and not the laser's holes, frame `camera`: a scan that takes time.
    Sweep(Field),
    /// Thickness of what covers the bone, frame `ct`.
    Film(Profile),
    /// Motion of the bone's marker on the bone between scan and use, in the marker's frame: shift and turn in degrees.
    Marker(Vector3<f64>, Vector3<f64>),
}

/// A sum of cosine waves along and around a bone of RMS one.
pub(super) struct Modes(Vec<Mode>);

struct Mode {
    amplitude: f64,
    per_mm: f64,
    around: f64,
    phase: f64,
}

impl Modes {
    /// Up to `n` modes with wavelengths of this range along the bone and up to `most_around` waves around it.
    pub(super) fn drawn(rng: &mut ChaCha8Rng, n: usize, wavelength_mm: [f64; 2], most_around: i32) -> Self {
        let mode = |_| {
            let wavelength_mm = log_uniform(rng, wavelength_mm);
            let around = f64::from(rng.random_range(-most_around..=most_around));
            Mode { amplitude: normal(rng), per_mm: TAU / wavelength_mm, around, phase: TAU * rng.random::<f64>() }
        };
        let mut modes: Vec<Mode> = (0..n).map(mode).collect();
        let rms = (modes.iter().map(|mode| mode.amplitude.powi(2)).sum::<f64>() / 2.0).sqrt();
        modes.iter_mut().for_each(|mode| mode.amplitude /= rms);
        Self(modes)
    }

    pub(super) fn at(&self, height_mm: f64, around: f64) -> f64 {
        let wave = |mode: &Mode| mode.amplitude * (mode.per_mm * height_mm + mode.around * around + mode.phase).cos();
        self.0.iter().map(wave).sum()
    }

    /// A bound of the sum.
    pub(super) fn most(&self) -> f64 {
        self.0.iter().map(|mode| mode.amplitude.abs()).sum()
    }
}

pub(super) fn log_uniform(rng: &mut ChaCha8Rng, [min, max]: [f64; 2]) -> f64 {
    min * (max / min).powf(rng.random::<f64>())
}

/// A direction across the bone.
pub(super) fn across(rng: &mut ChaCha8Rng, site: &Site) -> Vector3<f64> {
    site.way(TAU * rng.random::<f64>())
}

pub(super) fn smoothstep(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Displacement by a turn about an axis through a point.
pub(super) fn turned(axis: &Vector3<f64>, rad: f64, pivot: &Point3<f64>, point: &Point3<f64>) -> Vector3<f64> {
    let off = point - pivot;
    Rotation3::from_axis_angle(&Unit::new_normalize(*axis), rad) * off - off
}

/// A motion of the plan by displacements in turn; a plane keeps its points.
pub(super) fn moved_points(points: &Points, sizes: &[(f64, &Field)]) -> Points {
    let one = |p: &NamedPoint| NamedPoint { position: moved(&p.position, sizes), ..p.clone() };
    Points::new(&points.frame, points.points.iter().map(one).collect::<Vec<_>>())
}

pub(super) fn moved(point: &Point3<f64>, sizes: &[(f64, &Field)]) -> Point3<f64> {
    sizes.iter().fold(*point, |point, (size, field)| point + field(*size, &point))
}

pub(super) fn moved_planes(planes: &Planes, sizes: &[(f64, &Field)]) -> Planes {
    let one = |plane: &Plane| {
        let place =
            sizes.iter().fold(*plane.isometry().unwrap(), |place, (size, field)| moved_plane(&place, *size, field));
        Plane::new(plane.name.clone(), place)
    };
    Planes::new(&planes.frame, planes.planes.iter().map(one).collect::<Vec<_>>())
}

fn moved_plane(place: &Isometry3<f64>, size: f64, field: &Field) -> Isometry3<f64> {
    const STEP_MM: f64 = 1e-2;
    let origin = Point3::from(place.translation.vector);
    let column = |k: usize| {
        let step = Vector3::ith(k, STEP_MM);
        (field(size, &(origin + step)) - field(size, &(origin - step))) / (2.0 * STEP_MM)
    };
    let change = Matrix3::from_columns(&[column(0), column(1), column(2)]);
    let shifted = (origin + field(size, &origin)).into();
    if change == Matrix3::zeros() {
        return Isometry3::from_parts(shifted, place.rotation);
    }
    let normal = place * Vector3::z();
    let inverse = (Matrix3::identity() + change).try_inverse().unwrap_or_else(Matrix3::identity);
    let image = inverse.transpose() * normal;
    // By arctangent, as the cosine of a small angle may be rounded to more than one.
    let axis = normal.cross(&image);
    let rad = axis.norm().atan2(normal.dot(&image));
    let turn =
        Unit::try_new(axis, 0.0).map_or_else(UnitQuaternion::identity, |a| UnitQuaternion::from_axis_angle(&a, rad));
    Isometry3::from_parts(shifted, turn * place.rotation)
}

/// The random numbers of a fault, by its family or kind.
pub(super) fn fault_stream(seed: u64, number: u64) -> ChaCha8Rng {
    stream(seed, 100 + number)
}
