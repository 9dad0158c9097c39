//! Verdicts on faults that their model was not made for: a generator of faults, and a table of what is said of them.
//!
//! A case is a sound procedure (bone, window, side, plan, noise, calibration) and a fault of a family, all drawn from one seed.
//! Sizes are drawn log-uniformly from a tenth to three times a size of the kind at which about half of the answers are wrong; these
//! sizes were chosen by true errors alone, without a verdict. The judge's model is not read here; only the row of its own
//! priors takes sizes from its parameters. `OSTEOFLOW_CASES` takes the families whose names have one of these words, separated by
//! commas; the seed is hexadecimal.
//!
//! ```text
//! SLOW_TESTS=1 UNSEEN_N=40 UNSEEN_SEED=0123456789abcdef \
//!     cargo test --release -p osteoflow-simulation --test suite unseen::the_table -- --nocapture
//! ```

mod effect;
mod faults;
mod priors;
mod run;
mod sound;
mod table;

use effect::Effect;
use faults::{FAMILIES, Family, Fault, Part};
use osteoflow_geometry::nalgebra::{Point3, Vector3};
use run::{Inputs, Outcome};
use sound::Sound;

/// A sound procedure and what is wrong with it.
struct Case {
    family: Family,
    sound: Sound,
    fault: Fault,
}

impl Case {
    /// The case of a family and a seed. The sound procedure depends on the seed alone.
    fn drawn(family: Family, seed: u64) -> Self {
        let sound = Sound::drawn(seed);
        let fault = Fault::drawn(family, &sound.site, seed);
        Self { family, sound, fault }
    }

    /// With the sizes of the fault multiplied.
    fn scaled(mut self, factor: f64) -> Self {
        self.fault.parts.iter_mut().for_each(|part| part.size *= factor);
        self
    }

    /// With every part of the fault at a multiple of the size at which about half of the answers are wrong.
    fn at(mut self, times: f64) -> Self {
        self.fault.parts.iter_mut().for_each(|part| part.size = times * part.half_wrong);
        self
    }
}

/// The seed of the `k`-th case of a family, by SplitMix64.
fn seed_of(base: u64, family: Family, k: u64) -> u64 {
    let mut z = base ^ ((family as u64 + 1) << 40) ^ (k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn number(name: &str, radix: u32) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(u64::from_str_radix(&text, radix).unwrap_or_else(|_| panic!("{name} is {text}, but has to be a number")))
}

fn on_one_thread<T: Send>(what: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(what)
}

#[test]
fn the_table_of_verdicts_on_unseen_faults_is_printed() {
    if std::env::var_os("SLOW_TESTS").is_none() {
        println!("skipped: the_table_of_verdicts_on_unseen_faults_is_printed: SLOW_TESTS is not set");
        return;
    }
    let (n, base) = (number("UNSEEN_N", 10).unwrap_or(10), number("UNSEEN_SEED", 16).unwrap_or(1));
    let all: Vec<Outcome> = on_one_thread(|| {
        let words = std::env::var("OSTEOFLOW_CASES").unwrap_or_default();
        let is_wanted = |family: &&Family| words.split(',').any(|word| format!("{family:?}").contains(word));
        let cases = FAMILIES
            .iter()
            .filter(is_wanted)
            .flat_map(|&family| (0..n).map(move |k| (family, seed_of(base, family, k))));
        let judged = |(family, seed)| {
            let outcome = Inputs::of(Case::drawn(family, seed)).judged();
            println!("{}", outcome.line());
            outcome
        };
        cases.map(judged).collect()
    });
    println!("{}", table::markdown(&all, n, base));
}

/// True errors alone, by which the sizes were chosen: no verdict is asked.
#[test]
fn the_table_of_true_errors_by_kind_and_size_is_printed() {
    if std::env::var_os("SLOW_TESTS").is_none() {
        println!("skipped: the_table_of_true_errors_by_kind_and_size_is_printed: SLOW_TESTS is not set");
        return;
    }
    let (n, base) = (number("UNSEEN_N", 10).unwrap_or(10), number("UNSEEN_SEED", 16).unwrap_or(1));
    on_one_thread(|| {
        println!("| kind | size, times that at which half are wrong | wrong | of |\n|---|---|---|---|");
        for (kind, name) in faults::KINDS.iter().enumerate() {
            for times in [0.5, 1.0, 3.0] {
                let is_wrong = |k: u64| {
                    let seed = seed_of(base, Family::Sound, k);
                    let sound = Sound::drawn(seed);
                    let fault = Fault::of_kind(kind, &sound.site, seed);
                    let case = Case { family: Family::Sound, sound, fault }.at(times);
                    Inputs::of(case).registered().is_none_or(|answer| answer.errors.is_wrong())
                };
                println!("| {} | {times} | {} | {n} |", name.name, (0..n).filter(|&k| is_wrong(k)).count());
            }
        }
    });
}

#[test]
fn a_fault_of_size_zero_is_the_sound_case_bit_for_bit() {
    for family in FAMILIES {
        let without = Case { fault: Fault { parts: Vec::new() }, ..Case::drawn(family, 11) };
        let [zero, without] = [Case::drawn(family, 11).scaled(0.0), without].map(Inputs::of);
        assert!(zero.has_the_bits_of(&without), "{family:?} of size zero is not the sound case");
    }
}

#[test]
fn the_same_seed_gives_the_same_case_and_another_seed_another() {
    let family = Family::Several;
    let [a, b, other] = [5, 5, 6].map(|seed| Inputs::of(Case::drawn(family, seed)));
    assert!(a.has_the_bits_of(&b), "one seed gives two cases");
    assert!(!a.has_the_bits_of(&other), "two seeds give one case");
}

/// Bounds are a few standard deviations of what another cloud of points changes.
#[test]
fn true_errors_are_those_of_the_bone_that_was_meant() {
    let errors = |effect: Option<Effect>| {
        let parts = effect.into_iter().map(|effect| Part { name: "", effect, size: 2.0, half_wrong: 2.0, claims: &[] });
        let case = Case { fault: Fault { parts: parts.collect() }, ..Case::drawn(Family::Sound, 3) };
        Inputs::of(case).registered().unwrap().errors
    };
    let sound = errors(None);
    assert!(sound.tre_mm < 0.5 && sound.cuts_mm < 0.5 && sound.tilt_deg < 0.3, "{sound:?}");
    let (axis, pivot) = (Vector3::new(0.3, 0.9, -0.2), Point3::new(-80.0, -70.0, -900.0));
    let carried = errors(Some(Effect::Ct(Box::new(move |size, p| effect::turned(&axis, size / 50.0, &pivot, p)))));
    let change_mm = (carried.tre_mm - sound.tre_mm).abs().max((carried.cuts_mm - sound.cuts_mm).abs());
    assert!(change_mm < 0.02, "a CT in another place changes errors by {change_mm} mm");
    let shift = Vector3::new(0.0, 0.6, 0.8);
    let shifts = [Effect::Plan(Box::new(move |size, _| shift * size)), Effect::Marker(shift, Vector3::zeros())];
    for errors in shifts.map(|effect| errors(Some(effect))) {
        let off_mm = (errors.tre_mm - 2.0).abs().max((errors.cuts_mm - 2.0).abs());
        assert!(off_mm < 0.5, "a shift of 2 mm makes {errors:?}");
    }
}

#[test]
fn every_family_makes_wrong_answers_at_its_largest_size_and_right_ones_at_small_sizes() {
    for family in FAMILIES.into_iter().filter(|family| !matches!(family, Family::Sound | Family::Priors)) {
        let is_wrong = |seed: u64| {
            let case = Case::drawn(family, seed).at(faults::LARGEST);
            Inputs::of(case).registered().is_none_or(|answer| answer.errors.is_wrong())
        };
        assert!((1..=6).any(is_wrong), "no answer is wrong with {family:?} at its largest size");
        let harmless = Inputs::of(Case::drawn(family, 1).at(0.05)).registered().unwrap().errors;
        assert!(!harmless.is_wrong(), "{family:?} is wrong at half of its smallest size: {harmless:?}");
    }
}
