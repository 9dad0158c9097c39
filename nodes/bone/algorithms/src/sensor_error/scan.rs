//! One scan on the part.

use crate::Refusal;
use crate::downsample::thinned;
use crate::kabsch::centroid;
use crate::median::median;
use crate::mesh_query::MeshQuery;
use crate::nearest::Nearest;
use crate::sensor_noise::{NoisePatch, noise_patches};
use crate::trust::{MEDIAN_SIGMAS, Residual, SurfaceError};
use nalgebra::{Isometry3, Matrix3, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

type Row = SVector<f64, 8>;
type Square = SMatrix<f64, 8, 8>;

/// Number of points that a fit takes, and at most looked at for outliers.
const N_FITTED: usize = 1000;
const N_EXAMINED: usize = 20_000;
/// Fewest points of the part: some for each stretch.
const MIN_FITTED: usize = 100;
/// Points off by more than this many standard deviations are outliers.
const GATE_SIGMAS: f64 = 4.0;
/// A scan with more outliers is of another thing, or holds its surroundings.
const MAX_OFF: f64 = 0.3;
/// Standard deviation from a plane or ball, as a share of the scan's radius, above which the scan is of another shape.
const MAX_BENT: f64 = 0.03;
/// A fitted ball differs by at most this share from the stated radius, or a scale from 1.
const MAX_SCALED: f64 = 0.1;
/// Places around which the part turns by more lie at an edge of it: cosine of 20 degrees.
const EDGE_COS: f64 = 0.94;
/// Neighbours whose noise is measured, few, so that what they share stays out; the median of their mean squares, as a share of its mean.
const N_NEIGHBOURS: usize = 12;
const MEDIAN_SHARE: f64 = 0.893;
/// Mean distance of the pairs that tell the shared error, and its least length, mm.
const APART_MM: f64 = 1.0;
const MIN_LENGTH_MM: f64 = 2.0;
/// Neighbours of a point, and how far aside of it their middle is at the border of a scan, as a share of their mean distance.
const N_AROUND: usize = 24;
const ASIDE: f64 = 0.45;
/// Points this many spacings from the border count as near it.
const NEAR_SPACINGS: f64 = 3.0;
/// Stretches of a scan that are taken for independent where there are too few scans.
const N_STRETCHES: usize = 6;

/// What is scanned.
pub enum Part {
    /// Any shape, of closed or open triangles.
    Mesh(MeshQuery),
    /// A plane.
    Plane,
    /// A ball, by its radius, mm.
    Ball(f64),
}

impl Part {
    /// Whether turn, shift, offset and scale are unknown: of a plane offset and shift are one, of a ball offset and scale.
    fn unknown(&self) -> Row {
        Row::from(match self {
            Self::Mesh(_) => [1.0; 8],
            Self::Plane => [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0],
            Self::Ball(_) => [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0],
        })
    }

    fn residual(&self, point: Point3<f64>) -> Option<Residual> {
        let (foot, normal) = match self {
            Self::Mesh(mesh) => mesh.closest_point(&point).map(|closest| (closest.point, closest.normal))?,
            Self::Plane => (Point3::new(point.x, point.y, 0.0), Vector3::z()),
            Self::Ball(radius_mm) => {
                let normal = point.coords.try_normalize(1e-9)?;
                (Point3::from(normal * *radius_mm), normal)
            }
        };
        let signed_mm = (point - foot).dot(&normal);
        let aside_mm = ((point - foot).norm_squared() - signed_mm * signed_mm).max(0.0).sqrt();
        Some(Residual { point, normal, signed_mm, aside_mm })
    }

    /// The pose of plane or ball among the points.
    fn start(&self, points: &[Point3<f64>], given: &Isometry3<f64>) -> Isometry3<f64> {
        let middle = centroid(points);
        let scatter: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
        match self {
            Self::Mesh(_) => *given,
            Self::Plane => {
                let eigen = scatter.symmetric_eigen();
                let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
                let turn = UnitQuaternion::rotation_between(&normal, &Vector3::z());
                let turn =
                    turn.unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
                turn * Translation3::from(-middle.coords)
            }
            Self::Ball(_) => {
                // |p|² = 2 p·c + const, about the middle.
                let square = |p: &Point3<f64>| (p - middle).norm_squared();
                let mean = points.iter().map(square).sum::<f64>() / points.len() as f64;
                let b: Vector3<f64> = points.iter().map(|p| (p - middle) * (square(p) - mean)).sum();
                let centre = scatter.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * b / 2.0);
                Isometry3::translation(-(middle.x + centre.x), -(middle.y + centre.y), -(middle.z + centre.z))
            }
        }
    }
}

/// A number of one scan with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
}

impl Estimate {
    fn over(self, by: f64) -> Self {
        Self { value: self.value / by, sd: self.sd / by }
    }
}

/// Noise at a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct NoiseAt {
    point: Point3<f64>,
    pub(super) square: f64,
    /// From the sensor; NaN if it is unknown where that stood.
    pub(super) distance_mm: f64,
    /// Of the surface to the line of sight.
    pub(super) tilt_deg: f64,
}

/// Squares of noise and level, mm², and the share of outliers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stretch {
    pub(super) noise: f64,
    pub(super) level: f64,
    pub(super) outliers: f64,
}

/// How one scan differs from the part.
#[derive(Debug, Clone)]
pub struct ScanErrors {
    /// The pose, scan to part.
    pub t_part_scan: Isometry3<f64>,
    /// What pose, offset and scale leave.
    pub on: Vec<Residual>,
    /// That of outliers.
    pub off: Vec<Residual>,
    /// Offset of all points along the normal, positive outward, mm, where the part holds it.
    pub bias: Option<Estimate>,
    /// Size of the scan over that of the part, less 1, where the part holds it.
    pub scale: Option<Estimate>,
    /// The error by its noise and level.
    pub error: SurfaceError,
    /// Shares of outliers and of other points that lie near the scan's border.
    pub near_border: [f64; 2],
    pub(super) noise: Vec<NoiseAt>,
    /// Share of the shared error's variance that the fit and the distance between points leave.
    left_share: f64,
}

impl ScanErrors {
    /// Fits a scan to the part, from a pose near the right one (of a mesh); the sensor stood at `viewpoint`.
    ///
    /// # Errors
    /// [`Refusal`] if the scan is not of this part, or has too few points.
    ///
    /// # Source
    /// Least squares with correlated errors: the covariance of the fit is `(X'X)⁻¹ X'ΣX (X'X)⁻¹`, with a Gaussian covariance.
    pub fn of(
        points: &[Point3<f64>],
        part: &Part,
        start: &Isometry3<f64>,
        viewpoint: Option<Point3<f64>>,
    ) -> Result<Self, Refusal> {
        let some = thinned(points, N_FITTED);
        let mut pose = part.start(&some, start);
        let unknown = part.unknown();
        let (mut x, mut on) = (Row::zeros(), Vec::new());
        let (mut middle, mut radius_mm, mut gate_mm) = (Point3::origin(), 1.0, f64::INFINITY);
        for _ in 0..50 {
            let all: Vec<Residual> = some.par_iter().filter_map(|p| part.residual(pose * p)).collect();
            if gate_mm.is_infinite() {
                middle = centroid(&all.iter().map(|at| at.point).collect::<Vec<_>>());
                radius_mm = (all.iter().map(|at| (at.point - middle).norm_squared()).sum::<f64>()
                    / all.len().max(1) as f64)
                    .sqrt();
            }
            let left = |at: &Residual| at.signed_mm - row(at, &middle, radius_mm, &unknown).dot(&x);
            gate_mm = GATE_SIGMAS * sigma(all.iter().map(left)).max(1e-6);
            on = all.iter().filter(|at| left(at).abs() <= gate_mm).copied().collect();
            let rows: Vec<Row> = on.iter().map(|at| row(at, &middle, radius_mm, &unknown)).collect();
            let g: Row = rows.iter().zip(&on).fold(Row::zeros(), |sum, (row, at)| sum + row * at.signed_mm);
            x = inverse(&rows).0 * g;
            let (turn, shift) = (Vector3::new(x[0], x[1], x[2]) / radius_mm, Vector3::new(x[3], x[4], x[5]));
            pose = Translation3::from(middle.coords + shift)
                * UnitQuaternion::new(turn)
                * Translation3::from(-middle.coords)
                * pose;
            // Turn and shift are now in the pose.
            x.fixed_rows_mut::<6>(0).fill(0.0);
            if turn.norm() * radius_mm + shift.norm() < 1e-6 {
                break;
            }
        }
        if on.len() < MIN_FITTED {
            return Err(Refusal::of(format!("{} of its points lie on the part, too few to tell errors", on.len())));
        }
        let left =
            |at: Residual| Residual { signed_mm: at.signed_mm - row(&at, &middle, radius_mm, &unknown).dot(&x), ..at };
        let rows: Vec<Row> = on.iter().map(|at| row(at, &middle, radius_mm, &unknown)).collect();
        let on: Vec<Residual> = on.into_iter().map(left).collect();
        let sigma_mm = sigma(on.iter().map(|at| at.signed_mm));
        let is_bent = !matches!(part, Part::Mesh(_)) && sigma_mm > MAX_BENT * radius_mm;
        if is_bent {
            return Err(Refusal::of(format!(
                "it is off by {sigma_mm:.2} mm over {radius_mm:.0} mm: it is of another shape than --part states"
            )));
        }
        let (covariance, held) = inverse(&rows);
        let first = SurfaceError::new(&on);
        let shared = shared(&rows, &on, first.length_mm);
        // The fit takes what it can of an error that neighbours share.
        let taken = ((covariance * shared).trace() / on.len() as f64).clamp(0.0, 0.8);
        let left_share = (1.0 - taken) * correlation(APART_MM, first.length_mm);
        let error = SurfaceError { level_mm: first.level_mm / left_share.sqrt(), ..first };
        let white = covariance * error.noise_mm.powi(2);
        let covariance = covariance * shared * covariance * error.level_mm.powi(2) + white;
        let estimate =
            |k: usize| (held[k] > 0.999).then(|| Estimate { value: x[k], sd: covariance[(k, k)].max(0.0).sqrt() });
        let (bias, mut scale) = (estimate(6), estimate(7).map(|of| of.over(radius_mm)));
        if let Part::Ball(ball_mm) = part {
            scale = bias.map(|of| of.over(*ball_mm));
        }
        if let Some(scale) = scale.filter(|scale| scale.value.abs() - 2.0 * scale.sd > MAX_SCALED) {
            let times = 1.0 + scale.value;
            return Err(Refusal::of(format!(
                "it is {times:.2} times as large as the part: another part, or another unit"
            )));
        }
        let all: Vec<Residual> =
            thinned(points, N_EXAMINED).par_iter().filter_map(|p| part.residual(pose * p)).map(left).collect();
        let (on, off): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|at| at.signed_mm.hypot(at.aside_mm) <= GATE_SIGMAS * sigma_mm);
        let share = off.len() as f64 / (on.len() + off.len()) as f64;
        if share > MAX_OFF {
            let percent = 100.0 * share;
            return Err(Refusal::of(format!("{percent:.0} % of its points lie off the part; crop it to the part")));
        }
        let noise_at = |patch: NoisePatch| {
            let Residual { point, normal, .. } = part.residual(pose * patch.place)?;
            let sight = viewpoint.map_or_else(|| Vector3::repeat(f64::NAN), |eye| pose * patch.place - pose * eye);
            let tilt_deg = sight.normalize().dot(&normal).abs().min(1.0).acos().to_degrees();
            // An edge of the part is no noise.
            let u = normal.cross(&Vector3::new(normal.y, -normal.z, normal.x)).normalize() * patch.reach_mm;
            let around = [u, -u, u.cross(&normal), normal.cross(&u)].map(|aside| part.residual(point + aside));
            let is_flat = around.iter().flatten().all(|at| at.normal.dot(&normal) > EDGE_COS);
            let square = patch.square / MEDIAN_SHARE;
            is_flat.then_some(NoiseAt { point, square, distance_mm: sight.norm(), tilt_deg })
        };
        let noise: Vec<NoiseAt> =
            noise_patches(points, N_NEIGHBOURS).into_iter().flatten().filter_map(noise_at).collect();
        let near_border = near_border(&on, &off);
        let mut errors = Self { t_part_scan: pose, on, off, bias, scale, error, near_border, noise, left_share };
        errors.error.noise_mm = errors.stretch(|_| true).noise.sqrt();
        Ok(errors)
    }

    /// Errors of the points for which `is_in` holds, as squares, mm².
    pub(super) fn stretch(&self, is_in: impl Fn(&Point3<f64>) -> bool) -> Stretch {
        let on: Vec<Residual> = self.on.iter().filter(|at| is_in(&at.point)).copied().collect();
        let n_off = self.off.iter().filter(|at| is_in(&at.point)).count() as f64;
        let error = SurfaceError::new(&on);
        let mut squares: Vec<f64> = self.noise.iter().filter(|at| is_in(&at.point)).map(|at| at.square).collect();
        // Where points are too sparse for patches, what neighbours do not share.
        let noise = if squares.is_empty() { error.noise_mm.powi(2) } else { median(&mut squares) };
        let level = error.level_mm.powi(2) / self.left_share;
        Stretch { noise, level, outliers: n_off / (on.len() as f64 + n_off).max(1.0) }
    }

    /// Stretches along its longest side, which share little.
    pub(super) fn stretches(&self) -> Vec<Stretch> {
        let along = |k: usize| {
            let mut values: Vec<f64> = self.on.iter().map(|at| at.point[k]).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let longest = [0, 1, 2].map(along).into_iter().enumerate();
        let length = |values: &[f64]| values[values.len() - 1] - values[0];
        let Some((k, values)) = longest.max_by(|(_, a), (_, b)| length(a).total_cmp(&length(b))) else {
            return Vec::new();
        };
        let cut = |i: usize| match i {
            0 => f64::NEG_INFINITY,
            N_STRETCHES => f64::INFINITY,
            i => values[i * values.len() / N_STRETCHES],
        };
        (0..N_STRETCHES).map(|i| self.stretch(|p| (cut(i)..cut(i + 1)).contains(&p[k]))).collect()
    }
}

/// What the unknowns add to a residual: turn and shift of the scan, offset, scale.
fn row(at: &Residual, middle: &Point3<f64>, radius_mm: f64, unknown: &Row) -> Row {
    let arm = (at.point - middle) / radius_mm;
    let (turn, n) = (arm.cross(&at.normal), at.normal);
    Row::from([-turn.x, -turn.y, -turn.z, -n.x, -n.y, -n.z, 1.0, arm.dot(&n)]).component_mul(unknown)
}

/// The inverse of the normal matrix without its nullspace, and how much of each unknown is not in that.
fn inverse(rows: &[Row]) -> (Square, Row) {
    let eigen = rows.iter().map(|row| row * row.transpose()).sum::<Square>().symmetric_eigen();
    let least = 1e-9 * eigen.eigenvalues.max();
    let kept = || eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues).filter(|(_, value)| **value > least);
    let inverse = kept().map(|(column, value)| column * column.transpose() / *value).sum();
    (inverse, kept().map(|(column, _)| column.component_mul(&column)).sum())
}

/// The correlation of errors that fall to 37 % over `length_mm`.
fn correlation(apart_mm: f64, length_mm: f64) -> f64 {
    (-(apart_mm / length_mm.max(MIN_LENGTH_MM)).powi(2)).exp()
}

/// `X'RX` with the correlations R of the errors.
fn shared(rows: &[Row], on: &[Residual], length_mm: f64) -> Square {
    let one = |i: usize| {
        let share = |j: usize| rows[j] * correlation((on[i].point - on[j].point).norm(), length_mm);
        rows[i] * (0..rows.len()).map(share).sum::<Row>().transpose()
    };
    let parts: Vec<Square> = (0..rows.len()).into_par_iter().map(one).collect();
    parts.into_iter().sum()
}

/// The robust standard deviation about zero.
fn sigma(left: impl Iterator<Item = f64>) -> f64 {
    median(&mut left.map(f64::abs).collect::<Vec<_>>()) / MEDIAN_SIGMAS
}

/// Shares of the outliers, and of the other points, that lie near the border of the scan.
fn near_border(on: &[Residual], off: &[Residual]) -> [f64; 2] {
    let feet: Vec<Point3<f64>> = on.iter().map(|at| at.point - at.normal * at.signed_mm).collect();
    let tree = Nearest::new(&feet);
    let around = |(at, foot): (&Residual, &Point3<f64>)| {
        let near = tree.nearest_n(foot, N_AROUND);
        let mean = near.iter().map(|(i, _)| feet[*i] - foot).sum::<Vector3<f64>>() / near.len().max(1) as f64;
        let far_mm = near.iter().map(|(_, square)| square.sqrt()).sum::<f64>() / near.len().max(1) as f64;
        (
            (mean - at.normal * mean.dot(&at.normal)).norm() > ASIDE * far_mm,
            near.get(1).map_or(0.0, |(_, square)| square.sqrt()),
        )
    };
    let around: Vec<(bool, f64)> = on.par_iter().zip(&feet).map(around).collect();
    let reach_mm = NEAR_SPACINGS * median(&mut around.iter().map(|(_, mm)| *mm).collect::<Vec<_>>());
    let border: Vec<Point3<f64>> = around.iter().zip(&feet).filter(|((is, _), _)| *is).map(|(_, foot)| *foot).collect();
    let border = Nearest::new(&border);
    [off, on].map(|of| {
        let is_near = |at: &&Residual| {
            border
                .nearest(&(at.point - at.normal * at.signed_mm))
                .is_some_and(|(_, square)| square <= reach_mm * reach_mm)
        };
        of.iter().filter(is_near).count() as f64 / of.len().max(1) as f64
    })
}
