//! Measured scans of hip bones, with surroundings made around them: from shape alone to the verdict, as the program is used on two files.
//!
//! With `SLOW_TESTS` five starts of each, and the table of docs/method/search.md is compared with them (`UPDATE=1` writes it); `OSTEOFLOW_CASES`
//! takes those whose names, such as `specimen00_pelvis Hand 0.6`, have one of these words, separated by commas, and compares nothing.

use super::{Around, Frame, around};
use crate::common::{data, stl};
use crate::compact::{HIPS, cpu_ms, is_slow, left_mm, random_pose};
use crate::measured::{centroid, rows, xyz};
use crate::real::{HIP_RIGHT, target_of};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::coarse::{GlobalParams, global};
use osteoflow_algorithms::icp::{self, IcpParams, Method};
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{Answer, Case, Convergence, Registered, judge};
use osteoflow_geometry::{Cloud, Mesh};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, UnitSphere};
use std::{ops::ControlFlow, path::PathBuf};

/// What the search was not made with, and a second bone.
pub(crate) const KINDS: [(Around, &str); 3] =
    [(Around::Drape, "drape"), (Around::Hand, "hand"), (Around::Bone, "a second hip bone")];

/// Standard deviation of the points around, mm: about that of the ultrasound.
const NOISE_MM: f64 = 0.7;

/// A hip bone, the points of it that were measured, and the bone that lies beside it.
pub(crate) struct Hip {
    pub(crate) name: &'static str,
    pub(crate) target: Target,
    pub(crate) placed: Vec<Point3<f64>>,
    other: Mesh,
}

pub(crate) fn hips(test: &str) -> Vec<Hip> {
    let mesh = |name: &str| Some(stl(&data(test, &format!("real/hip/preoperative_{name}.stl"))?, "ct"));
    let hip = |k: usize| {
        let (name, mesh, other) = (HIPS[k], mesh(HIPS[k])?, mesh(HIPS[(k + 1) % HIPS.len()])?);
        let all = xyz(&rows(&data(test, &format!("real/hip/intraoperative_{name}.xyz"))?, ""), 1.0);
        Some(Hip { name, target: target_of(&mesh), placed: all.into_iter().step_by(2).collect(), other })
    };
    (0..HIPS.len()).map_while(hip).collect()
}

/// What came of a start.
struct Outcome {
    /// Whether the search, and whether the registration after it, is right.
    found: bool,
    right: bool,
    answer: Option<Answer>,
    search_ms: f64,
}

impl Hip {
    /// The scan with this share of its points from around the bone at a random pose, and that pose.
    pub(crate) fn scene(&self, kind: Around, share: f64, seed: u64) -> (Vec<Point3<f64>>, Isometry3<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed * 17 + 3);
        let frame = Frame::new(&self.placed, &Vector3::from(UnitSphere.sample(&mut rng)));
        let n = (share / (1.0 - share) * self.placed.len() as f64) as usize;
        let noise = Normal::new(0.0, NOISE_MM).unwrap();
        let mut points = self.placed.clone();
        let beside = around(kind, &frame, &self.other, n, &mut rng);
        points.extend(beside.into_iter().map(|p| p + Vector3::from_fn(|_, _| noise.sample(&mut rng))));
        let t_scan_truth = random_pose(&points, seed);
        (points.iter().map(|p| t_scan_truth * p).collect(), t_scan_truth)
    }

    /// The scan among surroundings, registered.
    fn outcome(&self, kind: Around, share: f64, seed: u64) -> Outcome {
        let (moved, t_scan_truth) = self.scene(kind, share, seed);
        let points: Vec<Point3<f64>> = moved.iter().map(|p| t_scan_truth.inverse() * p).collect();
        let cloud = Cloud::new("scan", moved).unwrap();
        let centre = centroid(&self.placed);
        let off = |t: &Isometry3<f64>| {
            let off = t * t_scan_truth;
            ((off * centre - centre).norm(), off.rotation.angle().to_degrees())
        };
        let is_right = |(mm, deg): (f64, f64)| mm < HIP_RIGHT.0 && deg < HIP_RIGHT.1;
        let about = format!("{}, {kind:?}, {share}, {seed}", self.name);
        let from_ms = cpu_ms();
        let fit = global(&self.target, &cloud, &GlobalParams::default());
        let search_ms = cpu_ms().zip(from_ms).map_or(f64::NAN, |(after, before)| after - before);
        let fit = match fit {
            Ok(fit) => fit,
            Err(error) => {
                println!("{about}: {error}");
                return Outcome { found: false, right: false, answer: None, search_ms };
            }
        };
        let (params, go_on) = (IcpParams::default(), &mut |_: &icp::IcpStep| ControlFlow::Continue(()));
        let end = icp::register(Method::PointToPlane, &self.target, &cloud, &fit.t_target_source, &params, go_on);
        let end = match end {
            Ok(end) => end,
            Err(error) => {
                println!("{about}: {error}");
                return Outcome { found: is_right(off(&fit.t_target_source)), right: false, answer: None, search_ms };
            }
        };
        let ended = Convergence::from(&end.report);
        let registered =
            Registered { target: &self.target, source: &cloud, t_target_source: &end.t_target_source, at: &[] };
        let case = Case { icp: Some(&ended), start: Some(&fit.report), ..Case::new(registered) };
        let verdict = judge(&case, &Default::default(), &Default::default(), &Default::default());
        let ([found_mm, found_deg], [mm, deg]) =
            (<[f64; 2]>::from(off(&fit.t_target_source)), <[f64; 2]>::from(off(&end.t_target_source)));
        let rules: Vec<&str> = verdict.reasons.iter().map(|reason| &*reason.rule).collect();
        let [left, at_truth] = [&(end.t_target_source * t_scan_truth), &Isometry3::identity()]
            .map(|by| left_mm(&self.target, &points, by));
        println!(
            "{about}: search {found_mm:.2} mm {found_deg:.2} deg, clearness {:.2}, {search_ms:.0} ms; end {mm:.2} mm {deg:.2} deg, \
             {left:.3} mm left, {at_truth:.3} mm at the truth, {:?} by {rules:?}",
            fit.report.clearness, verdict.answer
        );
        Outcome {
            found: is_right((found_mm, found_deg)),
            right: is_right((mm, deg)),
            answer: Some(verdict.answer),
            search_ms,
        }
    }
}

const HEAD: &str = "| Surroundings | Share | Starts | Found by the search | Right at the end | trusted | doubtful | refused | \
                    Wrong: trusted | doubtful | refused, none | CPU of the search, ms |\n\
                    |---|---|---|---|---|---|---|---|---|---|---|---|\n";

/// A row of the table.
fn row(what: &str, share: f64, all: &[Outcome]) -> String {
    let n = |is: &dyn Fn(&Outcome) -> bool| all.iter().filter(|outcome| is(outcome)).count();
    let answers = |right: bool| {
        let [trusted, doubtful] =
            [Answer::Trusted, Answer::Doubtful].map(|answer| n(&|o| o.right == right && o.answer == Some(answer)));
        format!("{trusted} | {doubtful} | {}", n(&|o| o.right == right) - trusted - doubtful)
    };
    let mut ms: Vec<f64> = all.iter().map(|o| o.search_ms).collect();
    ms.sort_by(f64::total_cmp);
    let (found, right) = (n(&|o| o.found), n(&|o| o.right));
    format!(
        "| {what} | {:.0} % | {} | {found} | {right} | {} | {} | {:.0} |\n",
        100.0 * share,
        all.len(),
        answers(true),
        answers(false),
        ms[ms.len() / 2]
    )
}

/// Compares the table of the page with this one but for times, or writes it with `UPDATE`.
fn compare(table: &str) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../docs/method/search.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let mark = "<!-- hips among surroundings -->\n";
    let start = page.find(mark).unwrap() + mark.len();
    let end = start + page[start..].find("<!-- end -->").unwrap();
    if std::env::var_os("UPDATE").is_some() {
        return std::fs::write(path, format!("{}{table}{}", &page[..start], &page[end..])).unwrap();
    }
    let without_times = |table: &str| -> Vec<String> {
        table.lines().map(|line| line.trim_end_matches([' ', '|']).rsplit_once('|').unwrap().0.to_owned()).collect()
    };
    assert_eq!(without_times(table), without_times(&page[start..end]), "UPDATE=1 writes docs/method/search.md");
}

/// With `SLOW_TESTS` all kinds, shares and bones from five starts; else one femur among a drape and beside a bone.
#[test]
fn hip_bones_among_surroundings_are_never_wrong_and_trusted() {
    let mut hips = hips("hip_bones_among_surroundings_are_never_wrong_and_trusted");
    let (shares, n, kinds) = if is_slow() { (&[0.3, 0.6][..], 5, 3) } else { (&[0.3][..], 1, 1) };
    hips.truncate(if is_slow() { 3 } else { 1 });
    if hips.is_empty() {
        return;
    }
    // CPU times are those of the calls.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let words = std::env::var("OSTEOFLOW_CASES").unwrap_or_default();
    let mut table = HEAD.to_owned();
    let mut wrong_and_trusted = 0;
    for hip in &hips {
        hip.target.prepare();
    }
    for ((kind, what), share) in KINDS[..kinds].iter().flat_map(|kind| shares.iter().map(move |share| (*kind, *share)))
    {
        let is_wanted =
            |hip: &&Hip| words.split(',').any(|word| format!("{} {kind:?} {share}", hip.name).contains(word));
        let wanted = hips.iter().filter(is_wanted).flat_map(|hip| (0..n).map(move |seed| (hip, seed)));
        let all: Vec<Outcome> =
            one_thread.install(|| wanted.map(|(hip, seed)| hip.outcome(kind, share, seed)).collect());
        if all.is_empty() {
            continue;
        }
        wrong_and_trusted += all.iter().filter(|o| !o.right && o.answer == Some(Answer::Trusted)).count();
        table += &row(what, share, &all);
        print!("{}", table.lines().last().map(|line| format!("{line}\n")).unwrap_or_default());
    }
    assert_eq!(wrong_and_trusted, 0, "wrong and trusted");
    if is_slow() && words.is_empty() {
        compare(&table);
    }
}
