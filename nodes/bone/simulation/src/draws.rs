//! One stream of random numbers for each error term, so that switching one off does not change the others.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// The random terms of a procedure. The discriminant selects the stream: it never changes and is never reused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Term {
    Setup = 0,
    CameraMarkerMounting = 1,
    DepthNoise = 2,
    DepthBias = 3,
    Dropout = 4,
    Patches = 5,
    Thinning = 6,
    LaserAim = 7,
    TrackerPlacement = 8,
    TrackerNoise = 9,
    TrackerLoss = 10,
    TrackerDrift = 11,
    PhantomPrint = 12,
    StylusCalibration = 13,
    StylusTouch = 14,
    PalpationBias = 15,
    PalpationTouch = 16,
    PalpationPlace = 17,
    BoneMotion = 18,
    MotionBetweenScans = 19,
    CtNoise = 20,
    CameraMotionBetweenScans = 21,
    #[cfg(test)]
    SmoothError = 22,
    RulerShared = 23,
    RulerEach = 24,
    Periosteum = 25,
    BloodPools = 26,
    Specular = 27,
    MarkerSlip = 28,
    CheckPlace = 29,
    CheckPrint = 30,
    CheckReading = 31,
    CtBumps = 32,
    LaserBeam = 33,
    Pivoting = 34,
    StylusAttitude = 35,
    BoneWarp = 36,
    CameraMarkerKnock = 37,
    PhantomMarkerCad = 38,
    TissueLumps = 39,
    TissueSurface = 40,
    ImageNoise = 41,
    ImageGlare = 42,
    ImageReflection = 43,
    CameraSpeed = 44,
    SurfaceError = 45,
    EdgeOutliers = 46,
    TrackerRepeats = 47,
    BoneSpeed = 48,
    Carry = 49,
    Saw = 50,
}

/// The stream of `term`; `item` distinguishes scans, markers or placements.
pub(crate) fn stream(seed: u64, term: Term, item: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((term as u64) << 32 | item);
    rng
}

/// A standard normal number.
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample(StandardNormal)
}

/// Three standard normal numbers.
pub(crate) fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let x = normal(rng);
    let y = normal(rng);
    Vector3::new(x, y, normal(rng))
}

/// A uniformly distributed unit vector.
pub(crate) fn direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    loop {
        if let Some(unit) = normal3(rng).try_normalize(1e-6) {
            return unit;
        }
    }
}

/// A uniformly distributed rotation.
pub(crate) fn attitude(rng: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
    let v = normal3(rng);
    let w = normal(rng);
    UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, v.x, v.y, v.z))
}

/// A small motion, normally distributed with these standard deviations along and about each axis.
pub(crate) fn small_motion(rng: &mut ChaCha8Rng, translation_mm: f64, rotation_rad: f64) -> Isometry3<f64> {
    let translation = normal3(rng) * translation_mm;
    Isometry3::new(translation, normal3(rng) * rotation_rad)
}
