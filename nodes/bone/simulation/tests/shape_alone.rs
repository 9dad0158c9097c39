//! Registration by shape alone, without any start: `coarse::global`, then point-to-plane, then the verdict.
//!
//! `OSTEOFLOW_CASES` takes the bones whose names have one of these words, separated by commas.
//!
//! Each scan has its own stretch of the bone, side, noise, lost patches and pose. With `SLOW_TESTS` there are 100 of each bone
//! and surface. No threshold was chosen on the built-in bones 2 and 4 and `myosim_fibula_r`; TLEM2 and MC22 were among the
//! bones on which the verdict's were.

use crate::common::bench::{built_in, measured, target_of};
use crate::common::{data_folder, stl};
use osteoflow_algorithms::coarse::{CLEAR, GlobalParams, global};
use osteoflow_algorithms::icp::{self, IcpFit, IcpParams, IcpReport, Method};
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{Answer, Case, Convergence, Registered, Verdict, judge};
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Anatomy, Cloud, SurgicalPlan};
use osteoflow_simulation::{CtParams, Procedure, ProcedureParams, Subject, ct_surface, plan};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, UnitSphere};
use std::{cell::LazyCell, ops::ControlFlow, sync::LazyLock};

/// Mean error of the scan's points of a right registration, mm.
const RIGHT_MM: f64 = 1.5;

/// A scan fits better only with an RMS distance lower by more than this share: two ends of one registration differ by half.
const BETTER: f64 = 0.01;

const MYOSIM: &str = "myosim_fibula_r";

/// A scan of a random stretch of the bone from a random side, in a random pose.
struct Window {
    /// Lower and upper end, mm above the tip of the malleolus.
    stretch_mm: [f64; 2],
    scan: Cloud,
    t_target_scan: Isometry3<f64>,
}

impl Window {
    fn new(subject: &Subject, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let length_mm = rng.random_range(60.0..120.0);
        let from_mm = rng.random_range(5.0..240.0 - length_mm);
        let mut params = ProcedureParams::default();
        params.laser.scans = false;
        let camera = &mut params.camera;
        (camera.scan_from_mm, camera.scan_to_mm) = (from_mm, from_mm + length_mm);
        camera.view_azimuth_deg = rng.random_range(-180.0..180.0);
        camera.depth_noise_mm = rng.random_range(0.03..0.2);
        camera.n_patches = rng.random_range(0..=10);
        let procedure = Procedure::simulate_for(subject, &params, seed).unwrap();
        let (scan, truth) = (&procedure.scan, &procedure.truth);
        let t_target_camera = truth.t_world_ct_at_scan.isometry.inverse() * truth.t_world_camera_at_scan.isometry;
        let axis: [f64; 3] = UnitSphere.sample(&mut rng);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::from(axis) * rng.random_range(0.0..std::f64::consts::PI));
        let shift = Vector3::from_fn(|_, _| rng.random_range(-500.0..500.0));
        let t_scan_camera = Isometry3::from_parts(Translation3::from(shift), turn);
        let viewpoint = scan.viewpoint.unwrap_or_else(Isometry3::identity);
        let scan = scan.clone().seen_from(viewpoint).transformed("scan", &t_scan_camera);
        Self {
            stretch_mm: [from_mm, from_mm + length_mm],
            scan,
            t_target_scan: t_target_camera * t_scan_camera.inverse(),
        }
    }

    /// 80 mm or more of the shaft and malleolus, below 180 mm: the stretch of the paper and more.
    fn is_ample(&self) -> bool {
        self.stretch_mm[1] - self.stretch_mm[0] >= 80.0 && self.stretch_mm[1] < 180.0
    }

    /// Mean distance of the scan's points from where they belong, mm.
    fn error_mm(&self, t_target_scan: &Isometry3<f64>) -> f64 {
        self.apart_mm(t_target_scan, &self.t_target_scan)
    }

    /// Mean distance of the scan's points at two poses, mm.
    fn apart_mm(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let points: Vec<&Point3<f64>> = self.scan.points().iter().step_by(20).collect();
        let off = |p: &&Point3<f64>| (a * **p - b * **p).norm();
        points.iter().map(off).sum::<f64>() / points.len() as f64
    }
}

fn is_slow() -> bool {
    std::env::var_os("SLOW_TESTS").is_some()
}

/// Point-to-plane from a start.
fn registered(target: &Target, scan: &Cloud, start: &Isometry3<f64>) -> IcpFit {
    let (params, go_on) = (IcpParams::default(), &mut |_: &icp::IcpStep| ControlFlow::Continue(()));
    icp::register(Method::PointToPlane, target, scan, start, &params, go_on).unwrap()
}

/// RMS distance of the scan from the surface, each at most 2 mm.
fn capped_rms_mm(target: &Target, scan: &Cloud, t_target_scan: &Isometry3<f64>) -> f64 {
    let surface = target.mesh().unwrap();
    let points: Vec<&Point3<f64>> = scan.points().iter().step_by(20).collect();
    let square = |p: &&Point3<f64>| {
        surface.closest_point(&(t_target_scan * **p)).map_or(2.0, |closest| closest.distance_mm.min(2.0)).powi(2)
    };
    (points.iter().map(square).sum::<f64>() / points.len() as f64).sqrt()
}

/// CPU time of this thread so far, ms; none where the system does not count it.
fn cpu_ms() -> Option<f64> {
    let counted = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(counted.split(' ').next()?.parse::<f64>().ok()? / 1e6)
}

fn verdict(target: &Target, scan: &Cloud, t_target_source: &Isometry3<f64>, report: &IcpReport) -> Verdict {
    let ended = Convergence::from(report);
    let case = Case { icp: Some(&ended), ..Case::new(Registered { target, source: scan, t_target_source, at: &[] }) };
    judge(&case, &Default::default(), &Default::default(), &Default::default())
}

/// What became of the windows on one bone.
#[derive(Default)]
struct Counted {
    name: String,
    n: usize,
    right: usize,
    right_not_trusted: usize,
    wrong_flagged: usize,
    wrong_and_trusted: usize,
    /// Wrong, although the scan fits better where a registration from the true pose ends.
    missed: usize,
    ample: usize,
    ample_right: usize,
    cpu_ms: f64,
}

impl Counted {
    const HEAD: &'static str = "| bone | n | right | of these doubted | wrong, flagged | wrong and trusted | wrong, missed \
                                a better fit | right of ample windows | CPU, ms |\n\
                                | --- | --- | --- | --- | --- | --- | --- | --- | --- |";

    fn add(&mut self, window: &Window, target: &Target) {
        let name = self.name.clone();
        self.n += 1;
        self.ample += usize::from(window.is_ample());
        let before = cpu_ms();
        let fit = global(target, &window.scan, &GlobalParams::default());
        self.cpu_ms += cpu_ms().zip(before).map_or(f64::NAN, |(after, before)| after - before);
        let [from_mm, to_mm] = window.stretch_mm;
        let fit = match fit {
            Ok(fit) => fit,
            Err(error) => {
                println!("{name}, {from_mm:.0} to {to_mm:.0} mm: {error}");
                self.wrong_flagged += 1;
                return;
            }
        };
        let fine = registered(target, &window.scan, &fit.t_target_source);
        let verdict = verdict(target, &window.scan, &fine.t_target_source, &fine.report);
        let is_flagged = verdict.answer != Answer::Trusted || fit.report.clearness < CLEAR;
        let error_mm = window.error_mm(&fine.t_target_source);
        let is_right = error_mm < RIGHT_MM;
        self.right += usize::from(is_right);
        self.ample_right += usize::from(is_right && window.is_ample());
        self.right_not_trusted += usize::from(is_right && is_flagged);
        self.wrong_flagged += usize::from(!is_right && is_flagged);
        self.wrong_and_trusted += usize::from(!is_right && !is_flagged);
        let rules: Vec<&str> = verdict.reasons.iter().map(|reason| &*reason.rule).collect();
        if is_right && is_flagged {
            let clearness = fit.report.clearness;
            println!(
                "{name}, {from_mm:.0} to {to_mm:.0} mm: right, clearness {clearness:.2}, {:?} by {rules:?}",
                verdict.answer
            );
        }
        if !is_right {
            let best = registered(target, &window.scan, &window.t_target_scan).t_target_source;
            let best_mm = window.error_mm(&best);
            let [left, from_truth] = [&fine.t_target_source, &best].map(|t| capped_rms_mm(target, &window.scan, t));
            self.missed += usize::from(from_truth < (1.0 - BETTER) * left);
            println!(
                "{name}, {from_mm:.0} to {to_mm:.0} mm: off by {error_mm:.1} mm ({left:.3} mm RMS), from the true pose {best_mm:.1} mm \
                 ({from_truth:.3} mm RMS), clearness {:.2}, {:?} by {rules:?}",
                fit.report.clearness, verdict.answer
            );
        }
    }

    fn print(&self) {
        println!(
            "| {} | {} | {} | {} | {} | {} | {} | {} of {} | {:.0} |",
            self.name,
            self.n,
            self.right,
            self.right_not_trusted,
            self.wrong_flagged,
            self.wrong_and_trusted,
            self.missed,
            self.ample_right,
            self.ample,
            self.cpu_ms / self.n as f64
        );
    }
}

/// A low-polygon fibula; its axes are those of its model: forward, upward and to the right.
fn myosim() -> Option<Subject> {
    let mesh = stl(&data_folder()?.join("bones").join(format!("{MYOSIM}.stl")), "ct")?;
    let tip = *mesh.vertices().iter().min_by(|a, b| a.y.total_cmp(&b.y)).unwrap();
    let anatomy = Anatomy {
        malleolus_tip: tip,
        proximal: Vector3::y_axis(),
        lateral: Vector3::z_axis(),
        posterior: -Vector3::x_axis(),
    };
    let plan = plan(&mesh, &anatomy).unwrap();
    Some(Subject::of(mesh, SurgicalPlan { anatomy: Some(anatomy), ..plan }).unwrap())
}

fn bones(test: &str) -> Vec<(String, &'static Subject)> {
    if !is_slow() {
        return vec![built_in(4)];
    }
    let measured = ["TLEM2_CT_fibula_r", "MC22_fibula_r"].into_iter().filter_map(|name| measured(test, name));
    static MYOSIM_SUBJECT: LazyLock<Option<Subject>> = LazyLock::new(myosim);
    let low_polygon = MYOSIM_SUBJECT.as_ref().map(|subject| (MYOSIM.to_owned(), subject));
    [built_in(2), built_in(4)].into_iter().chain(measured).chain(low_polygon).collect()
}

/// Registers windows (with `SLOW_TESTS` 100 of them, else `n`) on every bone, on one thread so that its CPU time is that of the call.
fn counted(test: &str, n: u64, target: impl Fn(&Subject, u64) -> Option<Target> + Send + Sync) -> Vec<Counted> {
    let n = if is_slow() { 100 } else { n };
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    println!("{}", Counted::HEAD);
    let on_bone = |(name, subject): (String, &Subject)| {
        let exact = LazyCell::new(|| target_of(subject.bone(), 1));
        let mut counted = Counted { name, ..Counted::default() };
        for seed in 0..n {
            let window = Window::new(subject, seed);
            let own = target(subject, seed);
            let target = own.as_ref().unwrap_or_else(|| &exact);
            if own.is_some() || seed == 0 {
                // Makes what is kept with the surface, which is no part of the time of one scan.
                let _ = global(target, &window.scan.selected(&(0..300).collect::<Vec<_>>()), &GlobalParams::default());
            }
            counted.add(&window, target);
        }
        counted.print();
        counted
    };
    let words = std::env::var("OSTEOFLOW_CASES").unwrap_or_default();
    let wanted = bones(test).into_iter().filter(|(name, _)| words.split(',').any(|word| name.contains(word)));
    wanted.map(|bone| one_thread.install(|| on_bone(bone))).collect()
}

/// The sums over the bones without [`myosim`], whose 120 vertices make its shaft a row of prisms, along which a scan fits anywhere.
fn shaped<const N: usize>(counted: &[Counted], of: fn(&Counted) -> [usize; N]) -> [usize; N] {
    let shaped = counted.iter().filter(|c| c.name != MYOSIM).map(of);
    shaped.fold([0; N], |sum, one| std::array::from_fn(|k| sum[k] + one[k]))
}

/// No wrong one is trusted.
fn check(test: &str, counted: &[Counted]) {
    let [n, right] = shaped(counted, |c| [c.ample, c.ample_right]);
    let trusted: usize = counted.iter().map(|c| c.wrong_and_trusted).sum();
    println!("{test}: {right} of {n} ample windows are right, {trusted} are wrong and trusted");
    assert_eq!(trusted, 0, "wrong and trusted");
}

#[test]
fn by_shape_alone_scans_are_right_or_flagged_on_the_exact_surface() {
    let test = "by_shape_alone_scans_are_right_or_flagged_on_the_exact_surface";
    let counted = counted(test, 2, |_, _| None);
    check(test, &counted);
    let [n, right] = shaped(&counted, |c| [c.ample, c.ample_right]);
    assert!(n > 0 && 100 * right >= 99 * n, "{right} of {n} ample windows are right");
}

/// Smooth errors of 0.3 mm are as large as the shape of a shaft, so that another place can fit better than the right one. That
/// is no failure of the search: it rarely misses a place with a better fit.
#[test]
fn by_shape_alone_scans_are_right_or_flagged_on_a_surface_with_errors() {
    let test = "by_shape_alone_scans_are_right_or_flagged_on_a_surface_with_errors";
    let bumpy = CtParams { bumps_mm: 0.3, ..CtParams::default() };
    let target = |subject: &Subject, seed| target_of(&ct_surface(subject.bone(), &bumpy, seed).unwrap(), seed);
    let counted = counted(test, 1, |subject, seed| Some(target(subject, seed)));
    check(test, &counted);
    let [missed, n] = shaped(&counted, |c| [c.missed, c.n]);
    assert!(100 * missed <= n, "{missed} of {n} missed a better fit");
}
