//! A bone with one scan of it, the CT's surface, and starts with the ruler errors of section 3.2.3 of the paper.

use super::shared::{Shared, shared};
use osteoflow_algorithms::coarse::three_point;
use osteoflow_algorithms::landmarks::{RulerErrors, ruled};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::{sample, section};
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Unit, Vector3};
use osteoflow_geometry::{Cloud, Mesh, NamedPoint};
use osteoflow_simulation::{BoneParams, CtParams, Procedure, ProcedureParams, Subject, ct_surface};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::{collections::BTreeMap, sync::Mutex};

/// One scan of one bone.
pub(crate) struct Bench {
    pub(crate) name: String,
    pub(crate) subject: &'static Subject,
    pub(crate) source: Cloud,
    pub(crate) target: Target,
    pub(crate) truth: Isometry3<f64>,
    /// The middle of the bone in each planned cut.
    pub(crate) cuts: Vec<Point3<f64>>,
}

/// A built-in bone with its name.
pub(crate) fn built_in(shape_seed: u64) -> (String, &'static Subject) {
    let params = BoneParams { shape_seed, ..BoneParams::default() };
    (format!("built-in {shape_seed}"), super::shared::built_in(&params))
}

/// A measured bone with its name; `None`, and a line, without the development data.
pub(crate) fn measured(test: &str, name: &str) -> Option<(String, &'static Subject)> {
    super::shared::measured(test, name).map(|subject| (name.to_owned(), subject))
}

/// A target as `surface.prepare` makes it.
pub(crate) fn target_of(mesh: &Mesh, seed: u64) -> Target {
    let samples = sample::surface(mesh, 150_000, &mut ChaCha8Rng::seed_from_u64(seed));
    let target = Target::new(&mesh.frame, mesh.origin, samples.points, Some(samples.normals.into())).unwrap();
    let target = target.with_mesh(MeshQuery::new(mesh));
    target.prepare();
    target
}

impl Bench {
    pub(crate) fn new(
        (name, subject): (String, &'static Subject),
        params: &ProcedureParams,
        ct: &CtParams,
        seed: u64,
    ) -> Self {
        static TARGETS: Shared<Target> = Mutex::new(BTreeMap::new());
        let procedure = Procedure::simulate_for(subject, params, seed).unwrap();
        let target = || target_of(&ct_surface(subject.bone(), ct, seed).unwrap(), seed);
        let target = shared(&TARGETS, format!("{name}, {ct:?}, {seed}"), target).clone();
        let truth =
            procedure.truth.t_world_ct_at_scan.isometry.inverse() * procedure.truth.t_world_camera_at_scan.isometry;
        let plane = |t: Isometry3<f64>| section::middle(subject.bone(), &t, None).unwrap();
        let cuts = subject.plan.planes.planes.iter().map(|p| plane(*p.isometry().unwrap())).collect();
        Self { name, source: procedure.scan, target, truth, cuts, subject }
    }

    /// With every `every`-th point of the scan.
    pub(crate) fn thinned(self, every: usize) -> Self {
        let kept: Vec<usize> = (0..self.source.len()).step_by(every).collect();
        Self { source: self.source.selected(&kept), ..self }
    }

    /// With the middle of the scan alone, this long.
    pub(crate) fn cropped(self, length_mm: f64) -> Self {
        let middle = self.truth * self.centroid();
        let is_near = |p: &Point3<f64>| (self.truth * p - middle).dot(&self.along()).abs() <= length_mm / 2.0;
        let kept: Vec<usize> = (0..self.source.len()).filter(|&k| is_near(&self.source.points()[k])).collect();
        Self { source: self.source.selected(&kept), ..self }
    }

    /// The largest distance at the cuts between the results of two registrations, mm.
    pub(crate) fn apart_mm(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let motion = a * b.inverse();
        self.cuts.iter().map(|p| (motion * p - p).norm()).fold(0.0, f64::max)
    }

    /// The direction of the bone, proximal.
    pub(crate) fn along(&self) -> Unit<Vector3<f64>> {
        self.subject.plan.anatomy.as_ref().unwrap().proximal
    }

    /// Three-point fits of landmarks with ruler errors: the first within 10 mm along the bone, the others within 2 mm of it, the
    /// second within 3 mm across. Marks that come to lie on a line are no start and drawn anew.
    pub(crate) fn ruled_starts(&self, n: usize, seed: u64) -> Vec<Isometry3<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut within = |mm: f64| mm * (2.0 * rng.random::<f64>() - 1.0);
        let planned = &self.subject.plan.landmarks.points;
        std::iter::repeat_with(|| {
            let errors = RulerErrors {
                first_mm: within(10.0),
                second_mm: within(2.0),
                third_mm: within(2.0),
                across_mm: within(3.0),
                ..RulerErrors::default()
            };
            let marks = ruled(&self.subject.surface, planned, &self.along(), &errors).unwrap().points;
            let seen = |mark: &NamedPoint| NamedPoint::new(mark.name.clone(), self.truth.inverse() * mark.position);
            let located: Vec<NamedPoint> = marks.iter().map(seen).collect();
            three_point(planned, &located).ok()
        })
        .flatten()
        .map(|fit| fit.t_target_source)
        .take(n)
        .collect()
    }

    /// The scan's centroid, in its own frame.
    pub(crate) fn centroid(&self) -> Point3<f64> {
        let points = self.source.points();
        Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64)
    }

    /// A pose displaced along the bone (mm) and about it (rad), at the scan.
    pub(crate) fn displaced(&self, along_mm: f64, turn_rad: f64) -> Isometry3<f64> {
        let camera = self.truth * Point3::origin();
        let seen = self.truth * self.centroid();
        // About 6 mm below the surface that the camera sees.
        let middle = seen + (seen - camera).normalize() * 5.0;
        let axis = self.along();
        let turn = Isometry3::rotation(axis.into_inner() * turn_rad);
        let about = Isometry3::translation(middle.x, middle.y, middle.z);
        let shift = axis.into_inner() * along_mm;
        Isometry3::translation(shift.x, shift.y, shift.z) * about * turn * about.inverse() * self.truth
    }
}
