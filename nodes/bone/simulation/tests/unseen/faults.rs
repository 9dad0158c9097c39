//! Families of faults, their kinds, and the sizes at which about half of the answers are wrong.

mod camera;
mod ct;
mod scan;

use super::effect::{Effect, fault_stream, log_uniform};
use super::priors;
use super::sound::Site;
use Family::{CameraMaps, CtMaps, Cuts, Fields, Films, Headers, Kinks, Motions};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Family {
    Sound,
    Fields,
    Kinks,
    Cuts,
    Motions,
    CtMaps,
    CameraMaps,
    Films,
    Several,
    Headers,
    Priors,
}

pub(super) const FAMILIES: [Family; 11] = [
    Family::Sound,
    Family::Fields,
    Family::Kinks,
    Family::Cuts,
    Family::Motions,
    Family::CtMaps,
    Family::CameraMaps,
    Family::Films,
    Family::Several,
    Family::Headers,
    Family::Priors,
];

/// Smallest and largest size, times that at which half of the answers are wrong.
const SMALLEST: f64 = 0.1;
pub(super) const LARGEST: f64 = 3.0;
/// The same of each of several.
const EACH_OF_SEVERAL: [f64; 2] = [0.15, 0.7];

/// A printed assumption covers a fault if it has one of the words and a critical size in this unit; `per_size` takes the
/// fault's size to that unit.
pub(super) struct Claim {
    pub(super) words: &'static [&'static str],
    pub(super) unit: &'static str,
    pub(super) per_size: f64,
}

pub(super) struct Kind {
    pub(super) family: Family,
    pub(super) name: &'static str,
    /// By true errors alone, in the unit of the first claim.
    pub(super) half_wrong: f64,
    pub(super) claims: &'static [Claim],
    pub(super) make: fn(&mut ChaCha8Rng, &Site) -> Effect,
}

const fn claim(words: &'static [&'static str], unit: &'static str, per_size: f64) -> Claim {
    Claim { words, unit, per_size }
}

const FIELD: &[&str] = &["field", "surface", "segment", "threshold", "bump", "swell", "offset", "smooth"];
const SHAPE: &[&str] = &["bent", "bend", "deform", "field", "shape", "smooth"];
const KINK: &[&str] = &["kink", "part of the bone", "step", "displaced", "turned", "fracture"];
const BENT: &[&str] = &["bent", "bend"];
const TWIST: &[&str] = &["twist"];
const SLICES: &[&str] = &["slice", "step", "displaced", "part of the bone", "missing", "taken out", "length"];
const STRETCH: &[&str] = &["stretch", "spacing", "grown", "growth", "size of the CT"];
const SHEAR: &[&str] = &["shear", "gantry", "oblique", "affine"];
const AFFINE: &[&str] = &["affine", "stretch", "shear", "spacing", "grown", "growth", "oblique"];
const MOVED: &[&str] = &["move", "motion", "still", "at rest"];
const MARKER: &[&str] = &["marker"];
const LEG: &[&str] = &["leg", "during the CT", "step", "displaced", "part of the bone", "twist", "bent", "turned"];
const DEPTH: &[&str] = &["camera"];
const FILM: &[&str] = &["film", "tissue", "covers"];
const PLAN: &[&str] = &["plan", "header", "series"];

/// Degrees to mm at the end of a scan of 95 mm, against its middle, of a bone that is turned there.
const MM_PER_DEG: f64 = 0.41;
const DEG_PER_PERCENT: f64 = 0.573;

const fn kind(
    family: Family,
    name: &'static str,
    half_wrong: f64,
    make: fn(&mut ChaCha8Rng, &Site) -> Effect,
    claims: &'static [Claim],
) -> Kind {
    Kind { family, name, half_wrong, claims, make }
}

pub(super) const KINDS: [Kind; 27] = [
    kind(Fields, "field of the segmentation", 0.8, ct::segmentation, &[claim(FIELD, "mm", 1.0)]),
    kind(Fields, "threshold that drifts", 0.17, ct::threshold, &[claim(FIELD, "mm", 1.0)]),
    kind(Fields, "warp of the bone", 0.55, ct::warp, &[claim(SHAPE, "mm", 1.0)]),
    kind(
        Kinks,
        "kink",
        0.8,
        ct::kink,
        &[claim(KINK, "degrees", 1.0), claim(KINK, "mm", MM_PER_DEG), claim(BENT, "mm", MM_PER_DEG)],
    ),
    kind(Kinks, "bend from a place on", 0.5, ct::bend, &[claim(BENT, "mm", 1.0)]),
    kind(Kinks, "twist from a place on", 12.0, ct::twist, &[claim(TWIST, "degrees", 0.5)]),
    kind(Cuts, "slices missing", 2.0, ct::missing, &[claim(SLICES, "mm", 1.0)]),
    kind(Cuts, "slices doubled", 2.0, ct::doubled, &[claim(SLICES, "mm", 1.0)]),
    kind(Cuts, "piece taken out, closed askew", 1.2, ct::piece, &[claim(SLICES, "mm", 1.0), claim(KINK, "mm", 1.0)]),
    kind(Motions, "shift in the scan", 1.5, scan::shift, &[claim(MOVED, "mm", 1.0)]),
    kind(Motions, "screw in the scan", 1.2, scan::screw, &[claim(MOVED, "mm", 1.0)]),
    kind(Motions, "shake in the scan", 1.5, scan::shake, &[claim(MOVED, "mm", 1.0)]),
    kind(
        Motions,
        "turn of the leg in the CT",
        1.0,
        ct::leg,
        &[claim(LEG, "degrees", 1.0), claim(LEG, "mm", MM_PER_DEG)],
    ),
    kind(Motions, "marker moved after the scan", 1.5, scan::slip, &[claim(MARKER, "mm", 1.0)]),
    kind(
        CtMaps,
        "oblique spacing",
        1.8,
        ct::spacing,
        &[claim(STRETCH, "%", 1.0), claim(SHEAR, "degrees", DEG_PER_PERCENT / 2.0), claim(AFFINE, "%", 1.0)],
    ),
    kind(CtMaps, "shear", 1.4, ct::shear, &[claim(SHEAR, "degrees", DEG_PER_PERCENT), claim(AFFINE, "%", 1.0)]),
    kind(
        CtMaps,
        "affine map",
        1.2,
        ct::affine,
        &[claim(AFFINE, "%", 1.0), claim(SHEAR, "degrees", DEG_PER_PERCENT / 2.0)],
    ),
    kind(CameraMaps, "plane in depth", 0.6, camera::plane, &[claim(DEPTH, "mm", 1.0), claim(DEPTH, "degrees", 1.15)]),
    kind(CameraMaps, "bend in depth", 0.7, camera::bend, &[claim(DEPTH, "mm", 1.0), claim(BENT, "mm", 1.0)]),
    kind(CameraMaps, "scale of the camera", 0.75, camera::scale, &[claim(DEPTH, "%", 1.0)]),
    kind(CameraMaps, "scales of the camera's axes", 1.8, camera::axes, &[claim(DEPTH, "%", 1.0)]),
    kind(CameraMaps, "radial distortion", 10.0, camera::radial, &[claim(DEPTH, "%", 1.0)]),
    kind(
        CameraMaps,
        "drift after the calibration",
        1.6,
        camera::drift,
        &[claim(DEPTH, "mm", 1.0), claim(MARKER, "mm", 1.0)],
    ),
    kind(Films, "smooth film", 1.0, scan::film, &[claim(FILM, "mm", 1.0)]),
    kind(Films, "film in patches", 1.5, scan::patches, &[claim(FILM, "mm", 1.0)]),
    kind(Headers, "shift of the plan's header", 1.4, ct::header_shift, &[claim(PLAN, "mm", 1.0)]),
    kind(
        Headers,
        "spacing of the plan's header",
        1.0,
        ct::header_spacing,
        &[claim(PLAN, "%", 1.0), claim(PLAN, "mm", 1.5)],
    ),
];

/// One thing that is wrong.
pub(super) struct Part {
    pub(super) name: &'static str,
    pub(super) effect: Effect,
    pub(super) size: f64,
    pub(super) half_wrong: f64,
    pub(super) claims: &'static [Claim],
}

pub(super) struct Fault {
    pub(super) parts: Vec<Part>,
}

impl Kind {
    fn part(&self, rng: &mut ChaCha8Rng, site: &Site, times: f64) -> Part {
        let effect = (self.make)(rng, site);
        let (half_wrong, claims) = (self.half_wrong, self.claims);
        Part { name: self.name, effect, size: times * half_wrong, half_wrong, claims }
    }
}

impl Fault {
    pub(super) fn drawn(family: Family, site: &Site, seed: u64) -> Self {
        let rng = &mut fault_stream(seed, family as u64);
        let parts = match family {
            Family::Sound => Vec::new(),
            Family::Priors => priors::causes_from_priors(rng, site),
            Family::Several => {
                let mut kinds: Vec<&Kind> = KINDS.iter().collect();
                let n = rng.random_range(3..=5);
                let one = |_| {
                    let kind = kinds.swap_remove(rng.random_range(0..kinds.len()));
                    let times = log_uniform(rng, EACH_OF_SEVERAL);
                    kind.part(rng, site, times)
                };
                (0..n).map(one).collect()
            }
            family => {
                let kinds: Vec<&Kind> = KINDS.iter().filter(|kind| kind.family == family).collect();
                let kind = kinds[rng.random_range(0..kinds.len())];
                let times = log_uniform(rng, [SMALLEST, LARGEST]);
                vec![kind.part(rng, site, times)]
            }
        };
        Self { parts }
    }

    pub(super) fn of_kind(kind: usize, site: &Site, seed: u64) -> Self {
        let rng = &mut fault_stream(seed, 50 + kind as u64);
        Self { parts: vec![KINDS[kind].part(rng, site, 1.0)] }
    }
}
