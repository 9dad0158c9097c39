use super::paired::paired;
use super::quantile::quantile;
use super::{PoseErrorReport, pose_error};
use crate::Refusal;
use crate::fragment::{FaceKind, Fragment, HalfSpace, between, fragment};
use crate::kabsch::kabsch;
use crate::mesh_query::MeshQuery;
use crate::nearest::Nearest;
use crate::sample;
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Mesh, NamedPoint, Planes};
use osteoflow_node_macros::params;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Samples are the same at every call, so differences between two registrations are not due to a draw.
const SAMPLE_SEED: u64 = 1;

/// Resolution of the comparison of fragments.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct CutDifferenceParams {
    /// Spacing of the grid on which both fragments are remeshed for the comparison by vertices. 1: as bones are meshed from CT.
    #[param(1.0, 0.05..=10.0)]
    pub spacing_mm: f64,
    /// Points drawn evenly from each fragment for the distances. 1000: the standard error of their mean is a fortieth of the
    /// standard deviation.
    #[param(1000, 100..=1_000_000)]
    pub n_samples: usize,
}

/// Difference of the executed fragment from the planned one.
///
/// The executed planes are displaced in the bone by the registration's error: `S · plane` with
/// `S = t_ct_world_true · inverse(t_ct_world)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CutDifferenceReport {
    /// Volume of the planned fragment, mm³.
    pub planned_volume_mm3: f64,
    /// By the registration's true error.
    #[serde(rename = "true")]
    pub truth: CutVariant,
    /// By the error as the paper determines it, from the measured assessment points.
    pub paper: Option<CutVariant>,
    /// Reason if the latter is missing.
    pub no_paper: Option<String>,
}

/// The executed fragment against the planned one, for one estimate of the registration's error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CutVariant {
    /// The registration's error, as an angle and at the centre of the planned fragment.
    pub pose_error: PoseErrorReport,
    /// Volume of the executed fragment, mm³.
    pub executed_volume_mm3: f64,
    /// Executed minus planned volume, mm³.
    pub volume_difference_mm3: f64,
    /// Each end of the fragment.
    pub ends: Vec<EndReport>,
    /// The executed fragment in place, against the planned one: the error of the cuts.
    pub in_place: FragmentDifference,
    /// The executed fragment moved back by the inverse of the registration's error, so that its planes coincide with
    /// the planned ones: the error of its shape. This is no best fit.
    pub aligned: FragmentDifference,
}

/// Error of one end of the executed fragment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EndReport {
    /// The plane's name.
    pub name: String,
    /// Distance from the centre of the planned cut along the planned normal to the executed plane.
    pub offset_mm: f64,
    /// The offset, positive if the executed fragment is longer at this end, mm.
    pub longer_mm: f64,
    /// Angle between the planes, rad.
    pub tilt_rad: f64,
}

/// Distances between two fragments by three measures, each pooled over both directions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FragmentDifference {
    /// From each vertex to the other fragment's nearest vertex, both remeshed on one grid: their vertices are the
    /// intersections of the surface with the lines of a cubic grid along the first plane. Equal fragments have equal
    /// vertices.
    pub vertices: DistanceSummary,
    /// From points drawn evenly by area to the other fragment's closed surface; the largest distance includes the
    /// corners of the cut outlines, where it mostly occurs.
    pub surface: DistanceSummary,
    /// From points on the bone's own surface only, without the cut faces.
    pub walls: DistanceSummary,
}

/// Distances, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DistanceSummary {
    /// Number of distances.
    pub n: usize,
    /// Mean.
    pub mean_mm: f64,
    /// Standard deviation.
    pub sd_mm: f64,
    /// Root mean square.
    pub rms_mm: f64,
    /// 95th percentile.
    pub p95_mm: f64,
    /// Largest.
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

    /// The summary with the largest distance of other points taken into account.
    fn with_max(self, max_mm: f64) -> Self {
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
    /// The pose of the first plane, which is that of the grid.
    t_ct_grid: Isometry3<f64>,
    planned: Sampled,
    vertices: Vec<Point3<f64>>,
    nearest: Nearest,
}

/// A fragment with its samples.
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
        let on_wall = drawn.faces.iter().map(|&face| fragment.face_kinds[face as usize] == FaceKind::Wall).collect();
        let rim = fragment.rim();
        Self { query: MeshQuery::new(&fragment.mesh), points: drawn.points, on_wall, rim, fragment }
    }

    /// Distances of points, moved by `motion`, from the surface.
    fn distances(&self, points: &[Point3<f64>], motion: &Isometry3<f64>) -> impl Iterator<Item = f64> {
        points.iter().map(move |p| self.query.closest_point(&(motion * p)).map_or(f64::NAN, |c| c.distance_mm))
    }
}

impl<'a> PlannedFragment<'a> {
    /// Cuts the planned fragment out of the bone.
    ///
    /// # Errors
    /// [`Refusal`] if the planes are not in the bone's frame, or nothing can be cut.
    pub fn new(bone: &'a Mesh, planned: &Planes, params: &'a CutDifferenceParams) -> Result<Self, Refusal> {
        bone.frame.expect(&planned.frame, "the bone").map_err(Refusal::of)?;
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

    /// The midpoint between the centres of both cuts, mm.
    pub fn middle(&self) -> Point3<f64> {
        nalgebra::center(&self.cuts[0].point, &self.cuts[1].point)
    }

    /// The fragment that planes moved by `slip` cut out of the bone, in the bone's frame.
    ///
    /// # Errors
    /// [`Refusal`] if a moved plane misses the bone.
    pub fn executed(&self, slip: &Isometry3<f64>) -> Result<Fragment, Refusal> {
        fragment(self.bone, &self.cuts.clone().map(|cut| cut.moved(slip)))
    }

    /// The executed fragment against the planned one, for planes moved by `slip`, the inverse of the registration's
    /// error. `O(m)` for the cut, `O(n log n)` for the comparison.
    ///
    /// # Errors
    /// [`Refusal`] if a moved plane misses the bone.
    ///
    /// # Source
    /// Sections 3.2.2 and 3.2.3 of the paper; Cignoni, Rocchini and Scopigno 1998 for distances between surfaces.
    pub fn against(&self, slip: &Isometry3<f64>) -> Result<CutVariant, Refusal> {
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
                walls: DistanceSummary::of(walls).with_max(rim_mm),
                surface: DistanceSummary::of(all).with_max(rim_mm),
            }
        };
        let ends = self.cuts.iter().zip(self.normals).map(|(cut, normal)| {
            let moved = cut.moved(slip);
            // Towards the fragment: a plane further inward leaves less of it.
            let inward_mm = (moved.point - cut.point).dot(&moved.inward) / cut.inward.dot(&moved.inward);
            EndReport {
                name: cut.name.clone(),
                offset_mm: inward_mm * cut.inward.dot(&normal),
                longer_mm: -inward_mm,
                tilt_rad: cut.inward.angle(&moved.inward),
            }
        });
        let (planned_mm3, executed_mm3) =
            (self.planned.fragment.mesh.volume_mm3(), executed.fragment.mesh.volume_mm3());
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

/// The executed fragment against the planned one, by the registration's true error and by the error measured at points,
/// if known. `E = t_ct_world · inverse(t_ct_world_true)`; the planes are moved by its inverse.
///
/// # Errors
/// [`Refusal`] if frames differ, the planned fragment cannot be cut, or the truly executed planes miss the bone.
/// If only the measured error has no result, the report says why.
pub fn cut_difference(
    bone: &Mesh,
    planned: &Planes,
    error: &Isometry3<f64>,
    measured: Result<Isometry3<f64>, String>,
    params: &CutDifferenceParams,
) -> Result<CutDifferenceReport, Refusal> {
    let plan = PlannedFragment::new(bone, planned, params)?;
    let truth = plan.against(&error.inverse())?;
    let paper = measured.and_then(|error| plan.against(&error.inverse()).map_err(|why| why.to_string()));
    let (paper, no_paper) = match paper {
        Ok(variant) => (Some(variant), None),
        Err(why) => (None, Some(why)),
    };
    Ok(CutDifferenceReport { planned_volume_mm3: plan.fragment().mesh.volume_mm3(), truth, paper, no_paper })
}

/// The registration's error as the paper determines it: the rigid motion that best moves planned points onto the
/// measured points transformed by the registration, paired by name.
///
/// It includes the stylus' error; points along a shaft determine the turn about the bone least.
///
/// # Errors
/// [`Refusal`] if a point has no counterpart or the points do not determine a motion.
///
/// # Source
/// Section 3.2.2 of the paper.
pub fn error_at_points(
    planned: &[NamedPoint],
    measured: &[NamedPoint],
    t_ct_measured: &Isometry3<f64>,
) -> Result<Isometry3<f64>, Refusal> {
    let (planned, measured): (Vec<_>, Vec<_>) = paired(planned, measured)?
        .into_iter()
        .map(|(_, planned, measured)| (planned, t_ct_measured * measured))
        .unzip();
    kabsch(&measured, &planned)
}

/// Distance of each point from a closed surface, mm, negative inside.
pub fn signed_distances(points: &[Point3<f64>], surface: &MeshQuery) -> Vec<f64> {
    let signed = |p: &Point3<f64>| {
        let distance = surface.closest_point(p).map_or(f64::NAN, |closest| closest.distance_mm);
        if surface.is_inside(p) { -distance } else { distance }
    };
    points.iter().map(signed).collect()
}

/// Intersections of the surface with the lines of a cubic grid, along the axes of `t_mesh_grid` at odd halves of
/// `spacing_mm`.
///
/// Independent of the meshing; each square millimetre gets 1 to 1.7 points per squared spacing.
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
