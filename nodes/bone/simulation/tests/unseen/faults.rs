//! Families of faults, their kinds, and the sizes at which about half of the answers are wrong.

mod camera;
mod ct;
mod scan;

use super::effect::{Effect, fault_stream, log_uniform};
use super::priors;
use super::sound::Site;
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

/// A printed assumption covers a fault if it has one of the words and a critical size in this unit; `per_size` takes the fault's size to that
/// unit.
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

#[rustfmt::skip]
pub(super) const KINDS: [Kind; 27] = [
    Kind { family: Family::Fields, name: "field of the segmentation", half_wrong: 0.8, claims: &[claim(FIELD, "mm", 1.0)], make: ct::segmentation },
    Kind { family: Family::Fields, name: "threshold that drifts", half_wrong: 0.17, claims: &[claim(FIELD, "mm", 1.0)], make: ct::threshold },
    Kind { family: Family::Fields, name: "warp of the bone", half_wrong: 0.55, claims: &[claim(SHAPE, "mm", 1.0)], make: ct::warp },
    Kind { family: Family::Kinks, name: "kink", half_wrong: 0.8, claims: &[claim(KINK, "degrees", 1.0), claim(KINK, "mm", MM_PER_DEG), claim(BENT, "mm", MM_PER_DEG)], make: ct::kink },
    Kind { family: Family::Kinks, name: "bend from a place on", half_wrong: 0.5, claims: &[claim(BENT, "mm", 1.0)], make: ct::bend },
    Kind { family: Family::Kinks, name: "twist from a place on", half_wrong: 12.0, claims: &[claim(TWIST, "degrees", 0.5)], make: ct::twist },
    Kind { family: Family::Cuts, name: "slices missing", half_wrong: 2.0, claims: &[claim(SLICES, "mm", 1.0)], make: ct::missing },
    Kind { family: Family::Cuts, name: "slices doubled", half_wrong: 2.0, claims: &[claim(SLICES, "mm", 1.0)], make: ct::doubled },
    Kind { family: Family::Cuts, name: "piece taken out, closed askew", half_wrong: 1.2, claims: &[claim(SLICES, "mm", 1.0), claim(KINK, "mm", 1.0)], make: ct::piece },
    Kind { family: Family::Motions, name: "shift in the scan", half_wrong: 1.5, claims: &[claim(MOVED, "mm", 1.0)], make: scan::shift },
    Kind { family: Family::Motions, name: "screw in the scan", half_wrong: 1.2, claims: &[claim(MOVED, "mm", 1.0)], make: scan::screw },
    Kind { family: Family::Motions, name: "shake in the scan", half_wrong: 1.5, claims: &[claim(MOVED, "mm", 1.0)], make: scan::shake },
    Kind { family: Family::Motions, name: "turn of the leg in the CT", half_wrong: 1.0, claims: &[claim(LEG, "degrees", 1.0), claim(LEG, "mm", MM_PER_DEG)], make: ct::leg },
    Kind { family: Family::Motions, name: "marker moved after the scan", half_wrong: 1.5, claims: &[claim(MARKER, "mm", 1.0)], make: scan::slip },
    Kind { family: Family::CtMaps, name: "oblique spacing", half_wrong: 1.8, claims: &[claim(STRETCH, "%", 1.0), claim(SHEAR, "degrees", DEG_PER_PERCENT / 2.0), claim(AFFINE, "%", 1.0)], make: ct::spacing },
    Kind { family: Family::CtMaps, name: "shear", half_wrong: 1.4, claims: &[claim(SHEAR, "degrees", DEG_PER_PERCENT), claim(AFFINE, "%", 1.0)], make: ct::shear },
    Kind { family: Family::CtMaps, name: "affine map", half_wrong: 1.2, claims: &[claim(AFFINE, "%", 1.0), claim(SHEAR, "degrees", DEG_PER_PERCENT / 2.0)], make: ct::affine },
    Kind { family: Family::CameraMaps, name: "plane in depth", half_wrong: 0.6, claims: &[claim(DEPTH, "mm", 1.0), claim(DEPTH, "degrees", 1.15)], make: camera::plane },
    Kind { family: Family::CameraMaps, name: "bend in depth", half_wrong: 0.7, claims: &[claim(DEPTH, "mm", 1.0), claim(BENT, "mm", 1.0)], make: camera::bend },
    Kind { family: Family::CameraMaps, name: "scale of the camera", half_wrong: 0.75, claims: &[claim(DEPTH, "%", 1.0)], make: camera::scale },
    Kind { family: Family::CameraMaps, name: "scales of the camera's axes", half_wrong: 1.8, claims: &[claim(DEPTH, "%", 1.0)], make: camera::axes },
    Kind { family: Family::CameraMaps, name: "radial distortion", half_wrong: 10.0, claims: &[claim(DEPTH, "%", 1.0)], make: camera::radial },
    Kind { family: Family::CameraMaps, name: "drift after the calibration", half_wrong: 1.6, claims: &[claim(DEPTH, "mm", 1.0), claim(MARKER, "mm", 1.0)], make: camera::drift },
    Kind { family: Family::Films, name: "smooth film", half_wrong: 1.0, claims: &[claim(FILM, "mm", 1.0)], make: scan::film },
    Kind { family: Family::Films, name: "film in patches", half_wrong: 1.5, claims: &[claim(FILM, "mm", 1.0)], make: scan::patches },
    Kind { family: Family::Headers, name: "shift of the plan's header", half_wrong: 1.4, claims: &[claim(PLAN, "mm", 1.0)], make: ct::header_shift },
    Kind { family: Family::Headers, name: "spacing of the plan's header", half_wrong: 1.0, claims: &[claim(PLAN, "%", 1.0), claim(PLAN, "mm", 1.5)], make: ct::header_spacing },
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
