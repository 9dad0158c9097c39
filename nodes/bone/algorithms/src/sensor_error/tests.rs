//! The errors of simulated devices.

use super::{KnownPart, ScanErrors, SensorErrors, Told};
use crate::devices::{BALL_MM, CAMERA, Device, Rng, Shape, knob, scan};
use crate::mesh_query::MeshQuery;
use nalgebra::{Isometry3, Vector3};
use std::collections::BTreeMap;

fn part(shape: Shape) -> KnownPart {
    match shape {
        Shape::Knob => KnownPart::Mesh(MeshQuery::new(&knob())),
        Shape::Ball => KnownPart::Ball(BALL_MM),
        Shape::Plane => KnownPart::Plane,
    }
}

fn measured(shape: Shape, device: &Device, n_scans: usize, seed: u64) -> SensorErrors {
    let (mesh, mut rng) = (knob(), Rng::seeded(seed));
    let fit = |_| {
        let (points, eye, truth) = scan(shape, &mesh, device, 8000, &mut rng);
        let start = Isometry3::new(Vector3::new(0.6, -0.5, 0.4), Vector3::new(0.01, -0.01, 0.01)) * truth;
        ScanErrors::of(&points, &part(shape), &start, Some(eye)).unwrap()
    };
    SensorErrors::of(&(0..n_scans).map(fit).collect::<Vec<_>>()).unwrap()
}

/// How often each interval holds the truth.
fn coverage(shape: Shape, device: &Device, n_scans: usize, n_draws: u64) -> BTreeMap<&'static str, f64> {
    let mut held: BTreeMap<&str, f64> = BTreeMap::new();
    let mut means: BTreeMap<&str, [f64; 3]> = BTreeMap::new();
    for seed in 0..n_draws {
        let found = measured(shape, device, n_scans, seed);
        let is_scaled = device.scale != 1.0;
        let bias = |told| if shape == Shape::Ball && is_scaled { None } else { told };
        let values: [(&str, Option<Told>, f64); 6] = [
            ("noise", Some(found.noise_mm), device.noise_mm),
            ("patch", Some(found.patch_mm), device.patch_mm),
            ("bias", found.bias_mm, device.bias_mm),
            ("mean bias", bias(found.mean_bias_mm), device.mean_bias_mm),
            ("scale", found.scale.filter(|_| shape == Shape::Knob), device.scale),
            ("outliers", Some(found.outliers), device.outliers),
        ];
        for (name, told, truth) in values {
            let Some(told) = told else { continue };
            *held.entry(name).or_default() += f64::from(u8::from(told.holds(truth))) / n_draws as f64;
            let mean = means.entry(name).or_default();
            for (sum, of) in mean.iter_mut().zip([told.low, told.value, told.high]) {
                *sum += of / n_draws as f64;
            }
        }
    }
    println!("{shape:?} of {n_scans}: {held:.2?}, means {means:.3?}");
    held
}

#[test]
fn errors_of_known_devices_are_within_their_intervals() {
    let n_draws = if std::env::var_os("SLOW_TESTS").is_some() { 100 } else { 4 };
    let ball = Device { scale: 1.0, ..CAMERA };
    let mut all = Vec::new();
    for n_scans in [2, 3, 6] {
        for (shape, device) in [(Shape::Knob, CAMERA), (Shape::Ball, ball), (Shape::Plane, CAMERA)] {
            all.extend(coverage(shape, &device, n_scans, n_draws).into_values());
        }
    }
    let share = all.iter().sum::<f64>() / all.len() as f64;
    assert!(share > 0.85, "{share:.2} of the intervals hold the truth");
}
