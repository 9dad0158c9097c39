//! Simulated devices whose errors are known, and parts that they scan.

use osteoflow_geometry::{
    Mesh, SurfaceOrigin,
    nalgebra::{Isometry3, Point3, Vector3},
};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng as _, SeedableRng},
};
use std::f64::consts::TAU;

/// What a device does wrong.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Device {
    pub(crate) noise_mm: f64,
    pub(crate) patch_mm: f64,
    pub(crate) length_mm: f64,
    pub(crate) mean_bias_mm: f64,
    pub(crate) bias_mm: f64,
    pub(crate) scale: f64,
    pub(crate) outliers: f64,
}

/// A camera.
pub(crate) const CAMERA: Device = Device {
    noise_mm: 0.15,
    patch_mm: 0.3,
    length_mm: 5.0,
    mean_bias_mm: 0.4,
    bias_mm: 0.25,
    scale: 1.01,
    outliers: 0.03,
};

/// What is scanned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    Knob,
    Ball,
    Plane,
}

/// Radius of the ball.
pub(crate) const BALL_MM: f64 = 30.0;

/// Radius and height along the axis of a turned part.
const KNOB: [(f64, f64); 7] =
    [(0.0, 0.0), (28.0, 0.0), (40.0, 20.0), (40.0, 35.0), (25.0, 50.0), (12.0, 70.0), (0.0, 75.0)];

/// A turned part, not quite round.
pub(crate) fn knob() -> Mesh {
    const N: usize = 40;
    let at = |k: usize, turn: usize| {
        let (r, z) = KNOB[k];
        let (sin, cos) = (TAU * turn as f64 / N as f64).sin_cos();
        // Not quite round, so that a turn is held.
        Point3::new(1.3 * r * cos, r * sin, z)
    };
    let vertices: Vec<_> = (0..KNOB.len()).flat_map(|k| (0..N).map(move |turn| at(k, turn))).collect();
    let index = |k: usize, turn: usize| (k * N + turn % N) as u32;
    let faces = (0..KNOB.len() - 1).flat_map(|k| {
        (0..N).flat_map(move |turn| {
            let [a, b, c, d] = [index(k, turn), index(k, turn + 1), index(k + 1, turn + 1), index(k + 1, turn)];
            [[a, b, c], [a, c, d]]
        })
    });
    Mesh::new("part", SurfaceOrigin::Exact, vertices, faces.collect::<Vec<_>>()).unwrap()
}

/// Random numbers of a seed.
pub(crate) struct Rng(pub(crate) ChaCha8Rng);

impl Rng {
    pub(crate) fn seeded(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() as f64 + 0.5) / 2_f64.powi(64)
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.between(0.0, 1.0).ln()).sqrt();
        radius * (TAU * self.between(0.0, 1.0)).cos()
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal())
    }
}

/// A smooth random function with the covariance exp(-h² / length²).
struct Field(Vec<(Vector3<f64>, f64)>);

impl Field {
    fn new(length_mm: f64, rng: &mut Rng) -> Self {
        Self((0..150).map(|_| (rng.vector() * 2_f64.sqrt() / length_mm, rng.between(0.0, TAU))).collect())
    }

    fn at(&self, p: &Point3<f64>) -> f64 {
        (2.0 / self.0.len() as f64).sqrt()
            * self.0.iter().map(|(wave, phase)| (wave.dot(&p.coords) + phase).cos()).sum::<f64>()
    }
}

fn surface_point(shape: Shape, mesh: &Mesh, rng: &mut Rng) -> (Point3<f64>, Vector3<f64>) {
    match shape {
        Shape::Knob => loop {
            // By area.
            let face = rng.between(0.0, mesh.faces().len() as f64) as usize;
            let area = mesh.area_vector(face);
            if area.norm() < rng.between(0.0, 160.0) {
                continue;
            }
            let [a, b, c] = mesh.corners(face);
            let (mut v, mut w): (f64, f64) = (rng.between(0.0, 1.0), rng.between(0.0, 1.0));
            if v + w > 1.0 {
                (v, w) = (1.0 - v, 1.0 - w);
            }
            return (a + (b - a) * v + (c - a) * w, area.normalize());
        },
        Shape::Ball => {
            let normal = rng.vector().normalize();
            (Point3::from(normal * BALL_MM), normal)
        }
        Shape::Plane => {
            let mut side = || rng.between(-50.0, 50.0);
            (Point3::new(side(), side(), 0.0), Vector3::z())
        }
    }
}

/// A scan, in a frame of its own, its viewpoint there, and its pose.
pub(crate) fn scan(
    shape: Shape,
    mesh: &Mesh,
    device: &Device,
    n: usize,
    rng: &mut Rng,
) -> (Vec<Point3<f64>>, Point3<f64>, Isometry3<f64>) {
    let mut to_sensor = rng.vector().normalize();
    to_sensor.z = 0.5 + to_sensor.z.abs();
    let field = Field::new(device.length_mm, rng);
    let bias_mm = device.mean_bias_mm + device.bias_mm * rng.normal();
    let mut points = Vec::new();
    while points.len() < n {
        let (at, normal) = surface_point(shape, mesh, rng);
        if normal.dot(&to_sensor) < 0.25 {
            continue;
        }
        let mut mm = bias_mm + device.patch_mm * field.at(&at) + device.noise_mm * rng.normal();
        if rng.between(0.0, 1.0) < device.outliers {
            mm += rng.between(3.0, 8.0);
        }
        points.push(Point3::from(at.coords * device.scale) + normal * mm);
    }
    let t_scan_part = Isometry3::new(rng.vector() * 100.0, rng.vector());
    let eye = t_scan_part * Point3::from(to_sensor.normalize() * 400.0);
    (points.iter().map(|p| t_scan_part * p).collect(), eye, t_scan_part.inverse())
}
