//! Pivot and hand-eye calibrations from simulated logs: sound ones, and each kind of fault in sizes that are drawn. The table of
//! docs/method/calibration.md is of `SLOW_TESTS`; else a few logs of each kind.

mod hand_eye;
mod pivot;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, Normal, UnitSphere};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Logs of each kind; the seeds of the long run played no part in choosing a limit.
fn seeds() -> std::ops::Range<u64> {
    if is_slow() { 71_000..71_200 } else { 0..12 }
}

fn is_slow() -> bool {
    std::env::var_os("SLOW_TESTS").is_some()
}

/// What a kind of log should come to.
#[derive(Clone, Copy, PartialEq)]
enum Expected {
    /// Right, and no sign.
    Sound,
    /// Right, with a sign or not.
    Right,
    /// A sign of one of these rules, or a refusal with one of these words, unless the answer is right.
    Cause(&'static [&'static str]),
    /// Nothing in the log shows it.
    Unseen,
}

/// What a calibration of one log gave.
struct Outcome {
    /// Error and radius of the interval, mm, if there is an answer.
    error: Option<(f64, f64)>,
    /// Rules of the signs, or the refusal.
    said: Vec<String>,
}

impl Outcome {
    fn is_right(&self) -> bool {
        self.error.is_some_and(|(mm, radius_mm)| mm < radius_mm.max(1.0))
    }

    fn names(&self, causes: &[&str]) -> bool {
        self.said.iter().any(|said| causes.iter().any(|cause| said.contains(cause)))
    }
}

/// Counts of the outcomes of a kind.
struct Row {
    kind: &'static str,
    expected: Expected,
    outcomes: Vec<(u64, Outcome)>,
}

impl Row {
    fn of(kind: &'static str, expected: Expected, log: impl Fn(u64) -> Outcome) -> Self {
        Self { kind, expected, outcomes: seeds().map(|seed| (seed, log(seed))).collect() }
    }

    fn count(&self, is: impl Fn(&Outcome) -> bool) -> usize {
        self.outcomes.iter().filter(|(_, outcome)| is(outcome)).count()
    }

    /// Whether the outcome is no fault of the calibration.
    fn is_good(&self, o: &Outcome) -> bool {
        match self.expected {
            Expected::Sound => o.is_right() && o.said.is_empty(),
            Expected::Right => o.is_right(),
            Expected::Cause(causes) => o.names(causes) || o.is_right(),
            Expected::Unseen => o.said.is_empty(),
        }
    }

    fn n_within(&self) -> usize {
        self.count(|o| o.error.is_some_and(|(mm, radius_mm)| mm <= radius_mm))
    }

    /// Of the long run one of forty may come out otherwise, as a cause may hide in the noise, and one of ten where an interval of 90 % is
    /// above 1 mm; the intervals hold for nine of ten but for three standard deviations.
    fn check(&self) {
        let bad = self.outcomes.iter().filter(|(_, o)| !self.is_good(o));
        let bad: Vec<String> = bad.map(|(seed, o)| format!("seed {seed}: {:?} {:?}", o.error, o.said)).collect();
        let n = self.outcomes.len();
        let most = match (is_slow(), self.expected) {
            (false, _) => 0,
            (true, Expected::Right) => n / 10,
            (true, _) => n / 40,
        };
        assert!(bad.len() <= most, "{}: {}", self.kind, bad.join("\n"));
        if is_slow() && matches!(self.expected, Expected::Sound | Expected::Right) {
            let least = 0.9 * n as f64 - 3.0 * (0.09 * n as f64).sqrt();
            assert!(
                self.n_within() as f64 >= least,
                "{}: {} of {n} are within the interval",
                self.kind,
                self.n_within()
            );
        }
    }

    /// Whether all its logs are refused, or else are told by a sign, by their cause: such kinds are listed, not counted.
    fn is_always(&self, is_refused: bool) -> bool {
        let Expected::Cause(causes) = self.expected else { return false };
        self.outcomes.iter().all(|(_, o)| o.error.is_none() == is_refused && o.names(causes))
    }

    fn cells(&self) -> String {
        let with = |o: &Outcome| o.error.is_some();
        let silent = |o: &Outcome| o.said.is_empty();
        let cause = match self.expected {
            Expected::Cause(causes) => self.count(|o| o.names(causes)).to_string(),
            _ => String::new(),
        };
        let n_answers = self.count(with);
        let coverage = if matches!(self.expected, Expected::Sound | Expected::Right) && n_answers > 0 {
            let mut radii: Vec<f64> = self.outcomes.iter().filter_map(|(_, o)| Some(o.error?.1)).collect();
            radii.sort_by(f64::total_cmp);
            format!("{:.1} % ({:.2} mm)", 100.0 * self.n_within() as f64 / n_answers as f64, radii[radii.len() / 2])
        } else {
            String::new()
        };
        format!(
            "| {} | {} | {} | {} | {} | {} | {} |",
            self.kind,
            self.count(|o| with(o) && silent(o) && o.is_right()),
            self.count(|o| with(o) && !silent(o)),
            self.count(|o| !with(o)),
            cause,
            self.count(|o| with(o) && silent(o) && !o.is_right()),
            coverage
        )
    }
}

/// Checks the rows and, of the long run, compares the table of the page with them; `UPDATE` writes it.
fn compare(name: &str, rows: &[Row]) {
    let mut table = String::from(
        "| Logs | Right, silent | Told | Refused | By its cause | Wrong and silent | Within the interval (median radius) |\n|---|---|---|---|---|---|---|\n",
    );
    let counted = rows.iter().filter(|row| !row.is_always(true) && !row.is_always(false));
    counted.for_each(|row| writeln!(table, "{}", row.cells()).unwrap());
    for (is_refused, done) in [(true, "refused"), (false, "told")] {
        let kinds: Vec<_> = rows.iter().filter(|row| row.is_always(is_refused)).map(|row| row.kind).collect();
        if !kinds.is_empty() {
            writeln!(table, "\nAlways {done}, by its cause: {}.", kinds.join("; ")).unwrap();
        }
    }
    println!("{table}");
    rows.iter().for_each(Row::check);
    if !is_slow() {
        return;
    }
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../docs/method/calibration.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let mark = format!("<!-- {name} -->\n");
    let start = page.find(&mark).unwrap() + mark.len();
    let end = start + page[start..].find("<!-- end -->").unwrap();
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(path, format!("{}{table}{}", &page[..start], &page[end..])).unwrap();
        return;
    }
    assert_eq!(
        &page[start..end],
        table,
        "`UPDATE=1 SLOW_TESTS=1 cargo test --release -p osteoflow-algorithms --test suite calibrations::` writes it"
    );
}

/// Random numbers of a log.
struct Draws(ChaCha8Rng);

impl Draws {
    fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.0.random::<f64>()
    }

    fn index(&mut self, n: usize) -> usize {
        self.0.random_range(0..n)
    }

    fn normal(&mut self, sd: f64) -> f64 {
        Normal::new(0.0, sd).unwrap().sample(&mut self.0)
    }

    fn normals(&mut self, sd: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal(sd))
    }

    fn direction(&mut self) -> Vector3<f64> {
        Vector3::from(UnitSphere.sample(&mut self.0))
    }

    fn turn_deg(&mut self, from: f64, to: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(self.direction() * self.within(from, to).to_radians())
    }

    /// A measured pose: errors in its own axes.
    fn measured(&mut self, t: &Isometry3<f64>, mm: f64, deg: f64) -> Isometry3<f64> {
        t * Isometry3::new(self.normals(mm), self.normals(deg.to_radians()))
    }
}

/// As a reader of x, y, z, w reads a quaternion in the order w, x, y, z.
fn w_first(t: &Isometry3<f64>) -> Isometry3<f64> {
    let q = t.rotation.coords;
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[2], q[3], q[0], q[1]));
    Isometry3::from_parts(t.translation, rotation)
}

fn transposed(t: &Isometry3<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(t.translation, t.rotation.inverse())
}

/// In a left-handed frame: y is opposite.
fn mirrored(t: &Isometry3<f64>) -> Isometry3<f64> {
    let q = t.rotation.coords;
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[3], -q[0], q[1], -q[2]));
    Isometry3::from_parts(mirrored_place(t).translation, rotation)
}

/// The place alone is mirrored.
fn mirrored_place(t: &Isometry3<f64>) -> Isometry3<f64> {
    let [x, y, z]: [f64; 3] = t.translation.vector.into();
    Isometry3::from_parts(Translation3::new(x, -y, z), t.rotation)
}

fn scaled(t: &Isometry3<f64>, scale: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(t.translation.vector * scale), t.rotation)
}
