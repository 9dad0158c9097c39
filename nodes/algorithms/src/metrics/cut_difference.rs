use super::{MetricsError, PoseErrorReport, paired, pose_error, quantile};
use crate::fragment::{Fragment, FragmentError, HalfSpace, Part, between, fragment};
use crate::kabsch::kabsch;
use crate::mesh_query::MeshQuery;
use crate::nearest::Nearest;
use crate::sample;
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Mesh, NamedPoint, Planes};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The samples are the same at every call, so that two registrations are told apart by themselves and not by a draw.
const SAMPLE_SEED: u64 = 1;

/// How finely fragments are compared.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CutDifferenceParams {
    /// Spacing of the grid on which both fragments are meshed anew for the comparison by vertices, mm. 1: as finely as
    /// bones are meshed from CT.
    #[schemars(range(min = 0.05, max = 10.0))]
    pub spacing_mm: f64,
    /// Points drawn evenly from each fragment for the distances to the other's surface. 1000: the mean over both is then
    /// good to a fortieth of the standard deviation.
    #[schemars(range(min = 100, max = 1_000_000))]
    pub n_samples: usize,
}

impl Default for CutDifferenceParams {
    fn default() -> Self {
        Self { spacing_mm: 1.0, n_samples: 1000 }
    }
}

/// How far the fragment that is cut out differs from the planned one.
///
/// The executed planes lie in the bone where the registration's error puts them: `S · plane` with
/// `S = t_ct_world_true · inverse(t_ct_world)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CutDifferenceReport {
    /// Volume of the planned fragment, mm³.
    pub planned_volume_mm3: f64,
    /// With the registration's true error.
    #[serde(rename = "true")]
    pub truth: CutVariant,
    /// With the error as the paper has it: from the assessment points as they were measured.
    pub paper: Option<CutVariant>,
    /// Why there is no such error, where there is none.
    pub no_paper: Option<String>,
}

/// The executed fragment against the planned one, for one way to tell the registration's error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CutVariant {
    /// The registration's error, as a turn and at the middle of the planned fragment.
    pub pose_error: PoseErrorReport,
    /// Volume of the executed fragment, mm³.
    pub executed_volume_mm3: f64,
    /// Executed minus planned volume, mm³.
    pub volume_difference_mm3: f64,
    /// Each end of the fragment.
    pub ends: Vec<EndReport>,
    /// The executed fragment as it lies in the bone, against the planned one: how far the cuts are off.
    pub in_place: FragmentDifference,
    /// The executed fragment carried back by the inverse of the registration's error, so that its planes lie on the
    /// planned ones and a slip is taken out: how far its shape is off. This is no best fit.
    pub aligned: FragmentDifference,
}

/// How far one end of the executed fragment is off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EndReport {
    /// The plane's name.
    pub name: String,
    /// Way from the middle of the planned cut along the planned normal to the executed plane, mm.
    pub offset_mm: f64,
    /// The same, positive where the executed fragment is longer at this end, mm.
    pub longer_mm: f64,
    /// Angle between the planes, rad.
    pub tilt_rad: f64,
}

/// How far two fragments are apart, by three measures; each both ways, pooled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FragmentDifference {
    /// From each vertex to the other fragment's nearest vertex, both meshed anew on one grid: their vertices are where the
    /// lines of a cubic grid along the first plane meet the surface. Fragments that are alike have the same vertices.
    pub vertices: DistanceSummary,
    /// From points drawn evenly by area to the other fragment's closed surface; the largest over the corners of the cut
    /// outlines as well, where it mostly is.
    pub surface: DistanceSummary,
    /// The same, of points on the bone's own surface only, without the cut faces.
    pub walls: DistanceSummary,
}

/// Distances, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DistanceSummary {
    /// How many.
    pub n: usize,
    /// Their mean.
    pub mean_mm: f64,
    /// Their standard deviation.
    pub sd_mm: f64,
    /// Root of their mean square.
    pub rms_mm: f64,
    /// 95 percent of them are smaller.
    pub p95_mm: f64,
    /// The largest.
    pub max_mm: f64,
}

impl DistanceSummary {
    fn of(mut distances: Vec<f64>) -> Self {
        distances.sort_by(f64::total_cmp);
        let n = distances.len() as f64;
        let mean = |of: &dyn Fn(f64) -> f64| distances.iter().map(|d| of(*d)).sum::<f64>() / n;
        let mean_mm = mean(&|d| d);
        Self {
            n: distances.len(),
            mean_mm,
            sd_mm: mean(&|d| (d - mean_mm).powi(2)).sqrt(),
            rms_mm: mean(&|d| d * d).sqrt(),
            p95_mm: quantile(&distances, 0.95).unwrap_or(0.0),
            max_mm: distances.last().copied().unwrap_or(0.0),
        }
    }

    /// The same, with what lies farther off somewhere else.
    fn reaching(self, max_mm: f64) -> Self {
        Self { max_mm: self.max_mm.max(max_mm), ..self }
    }
}

/// The planned fragment, ready to be compared with executed ones.
pub struct PlannedFragment<'a> {
    bone: &'a Mesh,
    cuts: [HalfSpace; 2],
    params: &'a CutDifferenceParams,
    /// The planned normals as the plan has them.
    normals: [Vector3<f64>; 2],
    /// Where the first plane lies: the grid's own place.
    t_ct_grid: Isometry3<f64>,
    planned: Sampled,
    vertices: Vec<Point3<f64>>,
    nearest: Nearest,
}

/// A fragment with what its distances are told by.
struct Sampled {
    fragment: Fragment,
    query: MeshQuery,
    points: Vec<Point3<f64>>,
    /// Whether each point lies on the bone's own surface.
    on_wall: Vec<bool>,
    /// The corners of the cut outlines.
    rim: Vec<Point3<f64>>,
}

impl Sampled {
    fn new(fragment: Fragment, n: usize) -> Self {
        let drawn = sample::surface(&fragment.mesh, n, &mut ChaCha8Rng::seed_from_u64(SAMPLE_SEED));
        let on_wall = drawn.faces.iter().map(|&face| fragment.parts[face as usize] == Part::Wall).collect();
        let rim = fragment.rim();
        Self { query: MeshQuery::new(&fragment.mesh), points: drawn.points, on_wall, rim, fragment }
    }

    /// Distances of points, carried here by `motion`, from the surface.
    fn distances(&self, points: &[Point3<f64>], motion: &Isometry3<f64>) -> impl Iterator<Item = f64> {
        points.iter().map(move |p| self.query.closest_point(&(motion * p)).map_or(f64::NAN, |c| c.distance_mm))
    }
}

impl<'a> PlannedFragment<'a> {
    /// Cuts the planned fragment out of the bone.
    ///
    /// # Errors
    /// [`MetricsError::Frame`] if the planes do not lie in the bone's frame, [`MetricsError::Fragment`] if nothing can be
    /// cut.
    pub fn new(bone: &'a Mesh, planned: &Planes, params: &'a CutDifferenceParams) -> Result<Self, MetricsError> {
        bone.frame.expect(&planned.frame, "the bone")?;
        let cuts = between(bone, planned)?;
        let [t_ct_grid, t_ct_second] = [0, 1].map(|k| planned.planes[k].isometry().copied().unwrap_or_default());
        let normals = [t_ct_grid * Vector3::z(), t_ct_second * Vector3::z()];
        let planned = Sampled::new(fragment(bone, &cuts)?, params.n_samples);
        let vertices = on_grid(&planned.fragment.mesh, &t_ct_grid, params.spacing_mm);
        let nearest = Nearest::new(&vertices);
        Ok(Self { bone, cuts, params, normals, t_ct_grid, planned, vertices, nearest })
    }

    /// The planned fragment.
    pub fn fragment(&self) -> &Fragment {
        &self.planned.fragment
    }

    /// The middle between the middles of both cuts, mm.
    pub fn middle(&self) -> Point3<f64> {
        nalgebra::center(&self.cuts[0].point, &self.cuts[1].point)
    }

    /// The fragment that planes carried by `slip` cut out of the bone, where it lies in the bone.
    ///
    /// # Errors
    /// [`FragmentError`] if a carried plane misses the bone.
    pub fn executed(&self, slip: &Isometry3<f64>) -> Result<Fragment, FragmentError> {
        fragment(self.bone, &self.cuts.clone().map(|cut| cut.moved(slip)))
    }

    /// The executed fragment against the planned one, for planes carried by `slip`, the inverse of the registration's
    /// error. `O(m)` for the cut, `O(n log n)` for the comparison.
    ///
    /// # Errors
    /// [`MetricsError::Fragment`] if a carried plane misses the bone.
    ///
    /// # Source
    /// Sections 3.2.2 and 3.2.3 of the paper; Cignoni, Rocchini and Scopigno 1998 for distances between surfaces.
    pub fn against(&self, slip: &Isometry3<f64>) -> Result<CutVariant, MetricsError> {
        let executed = Sampled::new(self.executed(slip)?, self.params.n_samples);
        let back = slip.inverse();
        let compared = |to_plan: &Isometry3<f64>, to_executed: &Isometry3<f64>| {
            let (planned, on_wall) = (&self.planned, self.planned.on_wall.iter().chain(&executed.on_wall));
            let both = |a: &[Point3<f64>], b: &[Point3<f64>]| -> Vec<f64> {
                executed.distances(a, to_executed).chain(planned.distances(b, to_plan)).collect()
            };
            let all = both(&planned.points, &executed.points);
            let walls = all.iter().zip(on_wall).filter(|(_, wall)| **wall).map(|(d, _)| *d).collect();
            let rim_mm = both(&planned.rim, &executed.rim).into_iter().fold(0.0, f64::max);
            FragmentDifference {
                vertices: self.by_vertices(&executed.fragment.mesh, to_plan),
                walls: DistanceSummary::of(walls).reaching(rim_mm),
                surface: DistanceSummary::of(all).reaching(rim_mm),
            }
        };
        let ends = self.cuts.iter().zip(self.normals).map(|(cut, normal)| {
            let moved = cut.moved(slip);
            // Towards the fragment, so that a plane that lies further inward leaves less of it.
            let inward_mm = (moved.point - cut.point).dot(&moved.inward) / cut.inward.dot(&moved.inward);
            EndReport {
                name: cut.name.clone(),
                offset_mm: inward_mm * cut.inward.dot(&normal),
                longer_mm: -inward_mm,
                tilt_rad: cut.inward.angle(&moved.inward),
            }
        });
        let (planned_mm3, executed_mm3) = (self.planned.fragment.volume_mm3(), executed.fragment.volume_mm3());
        Ok(CutVariant {
            pose_error: pose_error(&back, &self.middle()),
            executed_volume_mm3: executed_mm3,
            volume_difference_mm3: executed_mm3 - planned_mm3,
            ends: ends.collect(),
            in_place: compared(&Isometry3::identity(), &Isometry3::identity()),
            aligned: compared(&back, slip),
        })
    }

    fn by_vertices(&self, executed: &Mesh, to_plan: &Isometry3<f64>) -> DistanceSummary {
        let t_grid_executed = to_plan.inverse() * self.t_ct_grid;
        let others: Vec<Point3<f64>> =
            on_grid(executed, &t_grid_executed, self.params.spacing_mm).iter().map(|p| to_plan * p).collect();
        let tree = Nearest::new(&others);
        let distances = |from: &[Point3<f64>], to: &Nearest| -> Vec<f64> {
            from.iter().map(|p| to.nearest(p).map_or(f64::NAN, |(_, square)| square.sqrt())).collect()
        };
        DistanceSummary::of([distances(&self.vertices, &tree), distances(&others, &self.nearest)].concat())
    }
}

/// The fragment that is cut out against the planned one, by the registration's true error and by the error as measured
/// at points, where that is known. `E = t_ct_world · inverse(t_ct_world_true)`; the planes are carried by its inverse.
///
/// # Errors
/// [`MetricsError`] if frames differ, the planned fragment cannot be cut, or the truly executed planes miss the bone.
/// Where only the measured error leads to nothing, the report says why.
pub fn cut_difference(
    bone: &Mesh,
    planned: &Planes,
    error: &Isometry3<f64>,
    measured: Result<Isometry3<f64>, String>,
    params: &CutDifferenceParams,
) -> Result<CutDifferenceReport, MetricsError> {
    let plan = PlannedFragment::new(bone, planned, params)?;
    let truth = plan.against(&error.inverse())?;
    let paper = measured.and_then(|error| plan.against(&error.inverse()).map_err(|why| why.to_string()));
    let (paper, no_paper) = match paper {
        Ok(variant) => (Some(variant), None),
        Err(why) => (None, Some(why)),
    };
    Ok(CutDifferenceReport { planned_volume_mm3: plan.fragment().volume_mm3(), truth, paper, no_paper })
}

/// The registration's error as the paper has it: the rigid motion that best carries planned points to where the
/// registration puts them as they were measured, paired by name.
///
/// The stylus' own error is in it; of points along a shaft the turn about the bone is known least.
///
/// # Errors
/// [`MetricsError`] if a point has no partner or the points fix no motion.
///
/// # Source
/// Section 3.2.2 of the paper.
pub fn error_at_points(
    planned: &[NamedPoint],
    measured: &[NamedPoint],
    t_ct_measured: &Isometry3<f64>,
) -> Result<Isometry3<f64>, MetricsError> {
    let (planned, measured): (Vec<_>, Vec<_>) = paired(planned, measured)?
        .into_iter()
        .map(|(_, planned, measured)| (planned, t_ct_measured * measured))
        .unzip();
    Ok(kabsch(&measured, &planned)?)
}

/// Distance of each point from a closed surface, mm, negative inside: what a map of two fragments is coloured by.
pub fn signed_distances(points: &[Point3<f64>], surface: &MeshQuery) -> Vec<f64> {
    let signed = |p: &Point3<f64>| {
        let distance = surface.closest_point(p).map_or(f64::NAN, |closest| closest.distance_mm);
        if surface.is_inside(p) { -distance } else { distance }
    };
    points.iter().map(signed).collect()
}

/// Where the lines of a cubic grid, laid along the axes of `t_mesh_grid` at odd halves of `spacing_mm`, meet the surface.
///
/// How the surface is meshed does not matter, and each square millimetre gets 1 to 1.7 points per squared spacing.
fn on_grid(mesh: &Mesh, t_mesh_grid: &Isometry3<f64>, spacing_mm: f64) -> Vec<Point3<f64>> {
    let t_grid_mesh = t_mesh_grid.inverse();
    let vertices: Vec<Vector3<f64>> = mesh.vertices().iter().map(|v| (t_grid_mesh * v).coords / spacing_mm).collect();
    let mut points = Vec::new();
    for face in mesh.faces() {
        let corners = face.map(|v| vertices[v as usize]);
        for axis in 0..3 {
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            let flat = corners.map(|c| [c[i], c[j]]);
            let turn =
                |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            let area = turn(flat[0], flat[1], flat[2]);
            if area == 0.0 {
                continue;
            }
            let range = |k: usize| {
                let (min, max) = flat.iter().fold((f64::MAX, f64::MIN), |(a, b), c| (a.min(c[k]), b.max(c[k])));
                (min - 0.5).ceil() as i64..=(max - 0.5).floor() as i64
            };
            for (x, y) in range(0).flat_map(|x| range(1).map(move |y| (x as f64 + 0.5, y as f64 + 0.5))) {
                let shares = [
                    turn(flat[1], flat[2], [x, y]) / area,
                    turn(flat[2], flat[0], [x, y]) / area,
                    turn(flat[0], flat[1], [x, y]) / area,
                ];
                if shares.iter().all(|share| *share >= 0.0) {
                    let at: Vector3<f64> = corners.iter().zip(shares).map(|(c, share)| c * share).sum();
                    points.push(t_mesh_grid * Point3::from(at * spacing_mm));
                }
            }
        }
    }
    points
}

#[cfg(test)]
mod tests;
