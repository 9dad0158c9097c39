//! Whether a plan belongs to the surface of the run, and what a common shift of all landmarks says.

use crate::coarse::rms;
use crate::kabsch::{centroid, kabsch};
use crate::target::Target;
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_geometry::{NamedPoint, SurfaceKey};
use osteoflow_verdict::{Answer, Reason};
use serde::Deserialize;

/// Number of points that identify a surface: the ends of a bone and some places between them.
const N_POINTS: usize = 12;

/// Largest distance of such a point from the surface, mm: files round coordinates to some digits.
const SAME_SURFACE_MM: f64 = 0.05;

/// Distance of these points from the surface that another segmentation of the same CT leaves, mm. If more than half of them are
/// farther, the surface is in another place.
const ELSEWHERE_MM: f64 = 1.0;

/// Share of the landmarks' distances from the planned ones that a rigid motion may leave if it is to explain them.
const RIGID: f64 = 1.0 / 3.0;

/// Ratio of the largest two principal variances from which a surface has a direction along it.
const LONG: f64 = 4.0;

/// What a node says about the plan it gives.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct PlanReport {
    /// The surface that the plan was drawn on.
    pub surface: Option<SurfaceKey>,
    /// Whether the user has checked that the plan belongs to the surface.
    pub confirm: bool,
}

/// Reasons against a registration, and what it takes for granted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Said {
    /// Reasons against it.
    pub reasons: Vec<Reason>,
    /// Assumptions and notes, one sentence each.
    pub notes: Vec<String>,
    /// An assumption that nothing in the run would contradict.
    pub untested: Option<String>,
}

/// Points that identify a surface: up to twelve of its own, each the farthest from those before it, the first the farthest from
/// the middle. `O(n)`; ties go to the first point.
pub fn fingerprint(points: &[Point3<f64>]) -> Vec<[f64; 3]> {
    let middle = centroid(points);
    let mut distances = vec![f64::INFINITY; points.len()];
    let mut chosen: Vec<[f64; 3]> = Vec::new();
    let mut last = middle;
    while chosen.len() < N_POINTS {
        for (distance, point) in distances.iter_mut().zip(points) {
            // The middle is no point of the surface and only chooses the first.
            let to_last = (point - last).norm_squared();
            *distance = if chosen.len() < 2 { to_last } else { distance.min(to_last) };
        }
        let farther = |best: Option<usize>, k: usize| match best {
            Some(b) if distances[b] >= distances[k] => Some(b),
            _ => Some(k),
        };
        let Some(k) = (0..points.len()).fold(None, farther).filter(|k| distances[*k] > 0.0) else { break };
        last = points[k];
        chosen.push(last.into());
    }
    chosen
}

/// How a plan belongs to the surface of a run.
#[derive(Debug, Clone, PartialEq)]
enum Binding {
    /// These keys agree.
    Bound(&'static str),
    /// Nothing that both have can be compared.
    Unbound,
    /// Not this surface, but one that is nowhere farther from it than this, mm, as of another segmentation.
    Near(f64),
    /// Keys can be compared, and none agrees: in what they differ, and whether the surface is measurably elsewhere.
    Contradicted { how: String, is_elsewhere: bool },
}

impl Binding {
    fn of(plan: &SurfaceKey, surface: &SurfaceKey, target: &Target) -> Self {
        let mut differ = Vec::new();
        let mut compared = |what: &'static str, in_plan: &Option<String>, in_run: &Option<String>| {
            let (Some(a), Some(b)) = (in_plan, in_run) else { return None };
            if a == b {
                return Some(Self::Bound(what));
            }
            differ.push(format!("the plan's {what} is {}, the surface's {}", short(a), short(b)));
            None
        };
        let by_hash = compared("file hash (sha256)", &plan.sha256, &surface.sha256);
        let by_frame = compared("frame of reference", &plan.frame_of_reference_uid, &surface.frame_of_reference_uid);
        if let Some(bound) = by_hash.or(by_frame) {
            return bound;
        }
        let mut off: Vec<f64> = plan.points.iter().map(|p| distance_mm(target, &Point3::from(*p))).collect();
        off.sort_by(f64::total_cmp);
        let mut is_elsewhere = false;
        if let Some(largest) = off.last().copied() {
            if largest <= SAME_SURFACE_MM {
                return Self::Bound("points on the surface");
            }
            if largest <= ELSEWHERE_MM {
                return Self::Near(largest);
            }
            is_elsewhere = off[off.len() / 2] > ELSEWHERE_MM;
            // Between the points of a target without a mesh, its surface is not known.
            if target.mesh().is_some() || is_elsewhere {
                let n_off = off.iter().filter(|d| **d > SAME_SURFACE_MM).count();
                differ.push(format!(
                    "{n_off} of the {} points by which the plan knows its surface lie off this one, by up to {largest:.1} mm",
                    off.len()
                ));
            }
        }
        if differ.is_empty() { Self::Unbound } else { Self::Contradicted { how: differ.join("; "), is_elsewhere } }
    }
}

/// Distance of a point from the surface of a target, mm.
fn distance_mm(target: &Target, point: &Point3<f64>) -> f64 {
    match target.mesh() {
        Some(mesh) => mesh.closest_point(point).map_or(f64::INFINITY, |closest| closest.distance_mm),
        None => target.nearest(point, f64::INFINITY).map_or(f64::INFINITY, |(_, mm)| mm),
    }
}

/// The beginning of a hash; a unique identifier whole.
fn short(key: &str) -> &str {
    if key.contains('.') { key } else { key.get(..12).unwrap_or(key) }
}

/// What the plan's key and its landmarks say about whether plan and surface belong together.
///
/// `surface` is what identifies the surface of the run, `located` are the landmarks as located, carried onto the target by the
/// registration. A plan that was displaced as a whole misses all landmarks by one shift, as landmarks do that were all aimed
/// wrong alike: a bound plan decides between them.
pub fn plan_binding(
    plan: &PlanReport,
    surface: &SurfaceKey,
    target: &Target,
    planned: &[NamedPoint],
    located: &[NamedPoint],
    max_common_shift_mm: f64,
) -> Said {
    let mut said = Said::default();
    let binding = plan.surface.as_ref().map_or(Binding::Unbound, |key| Binding::of(key, surface, target));
    let shift = Shift::of(planned, located);
    let large = shift.as_ref().filter(|shift| shift.is_large(max_common_shift_mm));
    let displaced = large.filter(|shift| shift.is_common() || shift.is_turned(max_common_shift_mm));
    match &binding {
        Binding::Contradicted { how, .. } if plan.confirm => {
            said.notes.push(format!("the plan belongs to this surface, as confirm = true says, though {how}"));
        }
        Binding::Contradicted { how, is_elsewhere } => {
            let answer = if *is_elsewhere { Answer::Refused } else { Answer::Doubtful };
            let reason = format!("the plan was drawn on another surface: {how}");
            let remedy = "run with the surface that the plan was drawn on; if both are of one CT in the same coordinates, look at \
                          plan and surface together and bind it anew (osteoflow convert PLAN OUT --bind BONE)";
            said.reasons.push(Reason::new("plan", answer, reason, remedy));
        }
        Binding::Bound(by) => {
            if let Some(shift) = large {
                said.notes.push(format!(
                    "the landmarks were located {} from where they are planned; the plan is bound to this surface by its {by}, so \
                     they were aimed there, and the registration does not follow them",
                    shift.words(target)
                ));
            }
        }
        Binding::Near(mm) => said.notes.push(format!(
            "the plan was drawn on another surface of this bone, such as another segmentation of its CT: the points by which the plan \
             knows it lie up to {mm:.2} mm off this one"
        )),
        Binding::Unbound => {}
    }
    if matches!(binding, Binding::Unbound | Binding::Near(_)) {
        match (displaced, plan.confirm) {
            (Some(shift), false) => {
                let reason = format!(
                    "after the registration all landmarks lie {} off the planned ones, {}, and nothing binds the plan to this \
                     surface: either all were aimed wrong by this shift, or the plan was drawn in another series and its cuts are off \
                     by it",
                    if shift.is_common() { "the same way" } else { "as if turned" },
                    shift.words(target)
                );
                let remedy = "look at plan and surface together; then bind the plan (osteoflow convert PLAN OUT --bind BONE) or set \
                              confirm = true at its node";
                said.reasons.push(Reason::new("plan_shift", Answer::Doubtful, reason, remedy));
            }
            (Some(shift), true) => said.notes.push(format!(
                "the plan belongs to this surface, as confirm = true says, and all landmarks were aimed {} off the planned ones",
                shift.words(target)
            )),
            (None, is_confirmed) => {
                if let Some(shift) = large {
                    said.notes.push(format!(
                        "the landmarks were located {} from where they are planned, but not all the same way, as they would be if \
                         the plan were displaced",
                        shift.words(target)
                    ));
                }
                match (is_confirmed, &shift) {
                    (true, _) => said.notes.push("the plan belongs to this surface, as confirm = true says".into()),
                    (false, Some(shift)) => said.notes.push(format!(
                        "the plan was drawn on this surface, to which nothing binds it; the landmarks would show a shift of all of \
                         it beyond {max_common_shift_mm:.1} mm, and show {:.1} mm",
                        shift.mean.norm()
                    )),
                    (false, None) => {
                        let text = "the plan was drawn on this surface, to which nothing binds it, and no landmark would show that \
                                    it is displaced (osteoflow convert PLAN OUT --bind BONE)";
                        said.untested = Some(text.into());
                    }
                }
            }
        }
    }
    said
}

/// How far located landmarks are from the planned ones of the same name.
struct Shift {
    names: Vec<String>,
    shifts: Vec<Vector3<f64>>,
    mean: Vector3<f64>,
    /// RMS residual of the rigid motion that best carries the planned ones to the located ones, mm; none of fewer than three.
    rigid_rms_mm: Option<f64>,
}

impl Shift {
    /// `None` without landmarks of the same names.
    fn of(planned: &[NamedPoint], located: &[NamedPoint]) -> Option<Self> {
        let pairs = planned.iter().filter_map(|p| Some((p, located.iter().find(|l| l.name == p.name)?)));
        let pairs: Vec<(&NamedPoint, &NamedPoint)> = pairs.collect();
        let shifts: Vec<Vector3<f64>> = pairs.iter().map(|(p, l)| l.position - p.position).collect();
        let (from, to): (Vec<Point3<f64>>, Vec<Point3<f64>>) =
            pairs.iter().map(|(p, l)| (p.position, l.position)).unzip();
        let rigid_rms_mm = kabsch(&to, &from).ok().map(|t| rms(&t, &to, &from));
        let mean = shifts.iter().sum::<Vector3<f64>>() / shifts.len() as f64;
        let names = pairs.iter().map(|(p, _)| p.name.to_string()).collect();
        (!shifts.is_empty()).then_some(Self { names, shifts, mean, rigid_rms_mm })
    }

    /// Whether the landmarks are off by more than this, in the mean or one by one.
    fn is_large(&self, max_mm: f64) -> bool {
        self.mean.norm() > max_mm || self.shifts.iter().all(|shift| shift.norm() > max_mm)
    }

    /// Whether each landmark is off by at least half of the mean, the same way: one that is where it was planned excludes that the
    /// plan is displaced.
    fn is_common(&self) -> bool {
        self.shifts.iter().all(|shift| shift.dot(&self.mean) >= 0.5 * self.mean.norm_squared())
    }

    /// Whether each landmark is off by more than this, and all are as a turn of the plan would leave them.
    fn is_turned(&self, max_mm: f64) -> bool {
        let rms_mm = (self.shifts.iter().map(Vector3::norm_squared).sum::<f64>() / self.shifts.len() as f64).sqrt();
        let is_rigid = self.rigid_rms_mm.is_some_and(|left_mm| left_mm < RIGID * rms_mm);
        is_rigid && self.shifts.iter().all(|shift| shift.norm() > max_mm)
    }

    /// Size, part along the bone with its direction, and each landmark.
    fn words(&self, target: &Target) -> String {
        let along = long_axis(target.points()).map(|axis| {
            let mm = axis.dot(&self.mean);
            format!("{:.1} mm of it along the bone towards {}", mm.abs(), towards(&(axis * mm.signum())))
        });
        let along = along.unwrap_or_else(|| format!("towards {}", towards(&self.mean)));
        let each: Vec<String> =
            self.names.iter().zip(&self.shifts).map(|(name, shift)| format!("{name} {:.1}", shift.norm())).collect();
        format!("{:.1} mm on average ({along}; {} mm)", self.mean.norm(), each.join(", "))
    }
}

/// The direction along a long surface; `None` if it has none.
fn long_axis(points: &[Point3<f64>]) -> Option<Vector3<f64>> {
    let middle = centroid(points);
    let covariance: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
    let eigen = covariance.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let [first, second, _] = order;
    (eigen.eigenvalues[first] > LONG * eigen.eigenvalues[second]).then(|| eigen.eigenvectors.column(first).into())
}

/// A direction in LPS by the patient's side that it points to most.
fn towards(direction: &Vector3<f64>) -> &'static str {
    let k = direction.iamax();
    [["left", "right"], ["posterior", "anterior"], ["superior", "inferior"]][k][usize::from(direction[k] < 0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_query::MeshQuery;
    use osteoflow_geometry::{Mesh, SurfaceOrigin};

    /// A box of 20 x 16 x 300 mm about (5, 40, -800) plus a shift, with its mesh.
    fn bone(shift: [f64; 3]) -> Target {
        let corner = |k: usize| {
            let at = |bit: usize, low: f64, high: f64| if k >> bit & 1 == 1 { high } else { low };
            Point3::new(at(0, -5.0, 15.0), at(1, 32.0, 48.0), at(2, -950.0, -650.0)) + Vector3::from(shift)
        };
        let vertices: Vec<Point3<f64>> = (0..8).map(corner).collect();
        let quads: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces: Vec<[u32; 3]> = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        let mesh = Mesh::new("ct", SurfaceOrigin::Exact, vertices.clone(), faces).unwrap();
        Target::new("ct", SurfaceOrigin::Exact, vertices, None).unwrap().with_mesh(MeshQuery::new(&mesh))
    }

    fn landmarks(shifts: [[f64; 3]; 3]) -> Vec<NamedPoint> {
        let places = [[15.0, 40.0, -850.0], [15.0, 42.0, -820.0], [5.0, 48.0, -825.0]];
        (0..3)
            .map(|k| NamedPoint::new(format!("P{}", k + 1), Point3::from(places[k]) + Vector3::from(shifts[k])))
            .collect()
    }

    fn bound_to(target: &Target) -> SurfaceKey {
        SurfaceKey { points: fingerprint(target.points()), ..SurfaceKey::default() }
    }

    /// What is said of landmarks that are off by these shifts, and of a plan with this key.
    fn said(key: Option<SurfaceKey>, shifts: [[f64; 3]; 3], confirm: bool) -> Said {
        let run = SurfaceKey { sha256: Some("a".repeat(64)), ..SurfaceKey::default() };
        let plan = PlanReport { surface: key, confirm };
        plan_binding(&plan, &run, &bone([0.0; 3]), &landmarks([[0.0; 3]; 3]), &landmarks(shifts), 3.0)
    }

    #[test]
    fn a_common_shift_is_doubted_from_its_limit_unless_the_plan_is_bound_or_confirmed() {
        for (mm, is_doubted) in [(2.9, false), (3.1, true), (15.0, true)] {
            for way in [Vector3::z(), -Vector3::z(), Vector3::x(), Vector3::new(0.6, 0.0, 0.8)] {
                let shifts = [(way * mm).into(); 3];
                let [unbound, bound, confirmed] = [
                    said(None, shifts, false),
                    said(Some(bound_to(&bone([0.0; 3]))), shifts, false),
                    said(None, shifts, true),
                ];
                let rules: Vec<_> = unbound.reasons.iter().map(|r| (r.rule.as_str(), r.answer)).collect();
                let expected: &[_] = if is_doubted { &[("plan_shift", Answer::Doubtful)] } else { &[] };
                assert_eq!(rules, expected, "{mm} mm along {way:?}");
                assert_eq!((bound.reasons.len(), confirmed.reasons.len()), (0, 0));
                assert_eq!(bound.notes.len(), usize::from(is_doubted), "{:?}", bound.notes);
                assert_eq!((unbound.notes.len(), confirmed.notes.len()), (usize::from(!is_doubted), 1));
            }
        }
        let reason = &said(None, [[0.0, 0.0, 8.0]; 3], false).reasons[0].reason;
        let words = "8.0 mm on average (8.0 mm of it along the bone towards superior; P1 8.0, P2 8.0, P3 8.0 mm)";
        assert!(reason.contains(words), "{reason}");
        let across = &said(None, [[-5.0, 0.0, 0.0]; 3], false).reasons[0].reason;
        assert!(across.contains("5.0 mm on average (0.0 mm of it along the bone"), "{across}");
    }

    #[test]
    fn without_landmarks_an_unbound_plan_is_an_assumption_that_nothing_tests() {
        let run = SurfaceKey { sha256: Some("a".repeat(64)), ..SurfaceKey::default() };
        let without = |surface: Option<SurfaceKey>, confirm: bool| {
            plan_binding(&PlanReport { surface, confirm }, &run, &bone([0.0; 3]), &[], &[], 3.0)
        };
        assert!(without(None, false).untested.unwrap().contains("no landmark would show that it is displaced"));
        assert_eq!(without(None, true).untested, None);
        assert_eq!(without(Some(bound_to(&bone([0.0; 3]))), false).untested, None);
        assert_eq!(said(None, [[0.0; 3]; 3], false).untested, None);
    }

    #[test]
    fn landmarks_of_which_one_is_where_it_was_planned_exclude_a_displaced_plan() {
        let two = said(None, [[0.0, 0.0, 8.0], [0.0; 3], [0.0, 0.0, 8.0]], false);
        assert_eq!(two.reasons, []);
        assert!(two.notes[0].contains("5.3 mm on average") && two.notes[0].contains("not all the same way"), "{two:?}");
        // A plan turned about the bone's middle by 40 degrees: the shifts are not the same way, but those of one rigid motion.
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), 40.0_f64.to_radians());
        let middle = Point3::new(5.0, 40.0, 0.0);
        let turned = landmarks([[0.0; 3]; 3]).into_iter().map(|p| {
            let off = turn * (p.position - middle) - (p.position - middle);
            off.into()
        });
        let turned: Vec<[f64; 3]> = turned.collect();
        let reasons = said(None, [turned[0], turned[1], turned[2]], false).reasons;
        assert!(reasons.len() == 1 && reasons[0].reason.contains("all landmarks lie as if turned"), "{reasons:?}");
        let apart = said(None, [[0.0, 0.0, 4.0], [0.0, 0.0, -4.0], [0.0, 4.0, 0.0]], false);
        assert_eq!(apart.reasons, [], "each off by itself");
        // Aimed 1 mm off on top of the plan's shift, they still agree.
        let noisy = said(None, [[1.0, 0.0, 7.0], [0.0, 1.0, 9.0], [-1.0, 0.0, 8.0]], false);
        assert_eq!(noisy.reasons.len(), 1);
    }

    #[test]
    fn each_key_binds_alone_and_keys_of_which_none_agrees_contradict() {
        let surface = SurfaceKey {
            sha256: Some("a".repeat(64)),
            frame_of_reference_uid: Some("1.2.3".into()),
            points: Vec::new(),
        };
        let target = bone([0.0; 3]);
        let binding = |key: &SurfaceKey| Binding::of(key, &surface, &target);
        let hash = |text: &str| SurfaceKey { sha256: Some(text.repeat(64)), ..SurfaceKey::default() };
        let frame = |uid: &str| SurfaceKey { frame_of_reference_uid: Some(uid.into()), ..SurfaceKey::default() };
        assert!(matches!(binding(&hash("a")), Binding::Bound(by) if by.starts_with("file hash")));
        assert!(matches!(binding(&frame("1.2.3")), Binding::Bound("frame of reference")));
        assert!(matches!(binding(&bound_to(&target)), Binding::Bound("points on the surface")));
        let one_of_three = SurfaceKey { frame_of_reference_uid: Some("1.2.3".into()), ..hash("b") };
        assert!(matches!(binding(&one_of_three), Binding::Bound(_)));
        let Binding::Contradicted { how, is_elsewhere: false } = binding(&hash("b")) else { panic!("another file") };
        assert_eq!(how, "the plan's file hash (sha256) is bbbbbbbbbbbb, the surface's aaaaaaaaaaaa");
        // Unknown of the surface: nothing to compare.
        let unknown = SurfaceKey::default();
        assert_eq!(Binding::of(&frame("9.9"), &unknown, &target), Binding::Unbound);
        // Moved along its length, the sides of the box fall together, and its ends do not.
        assert!(matches!(binding(&bound_to(&bone([0.0, 0.0, 0.2]))), Binding::Near(mm) if (mm - 0.2).abs() < 1e-9));
        for (shift, elsewhere) in [([0.0, 0.0, 8.0], true), ([300.0, 0.0, 0.0], true)] {
            let moved = bound_to(&bone(shift));
            let Binding::Contradicted { how, is_elsewhere } = binding(&moved) else { panic!("{shift:?}") };
            assert!(is_elsewhere == elsewhere && how.contains("points by which the plan knows"), "{shift:?}: {how}");
        }
        let reasons = said(Some(hash("b")), [[0.0; 3]; 3], false).reasons;
        assert_eq!((reasons[0].rule.as_str(), reasons[0].answer), ("plan", Answer::Doubtful));
        assert_eq!(said(Some(hash("b")), [[0.0; 3]; 3], true).reasons, []);
    }

    #[test]
    fn the_fingerprint_has_the_ends_of_a_surface_and_no_point_twice() {
        let line: Vec<Point3<f64>> = (0..1001).map(|k| Point3::new(0.0, 0.0, f64::from(k) * 0.3)).collect();
        let points = fingerprint(&line);
        assert_eq!(points.len(), N_POINTS);
        let has = |z: f64| points.iter().any(|p| (p[2] - z).abs() < 1e-9);
        assert!(has(0.0) && has(300.0), "{points:?}");
        let mut heights: Vec<f64> = points.iter().map(|p| p[2]).collect();
        heights.sort_by(f64::total_cmp);
        assert!(heights.windows(2).all(|w| w[1] - w[0] > 15.0), "{heights:?}");
        assert_eq!(fingerprint(&[Point3::origin(); 5]).len(), 0);
        assert_eq!(fingerprint(&line[..3]).len(), 3);
    }
}
