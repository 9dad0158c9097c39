//! How a sensor errs, from scans of a part whose shape is known: [`ScanErrors::of`] fits one scan, [`SensorErrors::of`] says what several
//! have in common.

mod device;
#[cfg(test)]
mod tests;

pub use device::{SensorErrors, Told};

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

/// Number of points that a fit takes, at least and at most, and that are looked at for outliers.
const N_FITTED: [usize; 2] = [100, 1000];
const N_EXAMINED: usize = 20_000;
/// Points off by more than this many standard deviations are outliers; of more than this share the scan is of other things.
const GATE_SIGMAS: f64 = 4.0;
const MAX_OFF: f64 = 0.3;
/// Standard deviation of a scan from plane or ball, as a share of its radius, and scale, less 1, above which it is of another shape.
const MAX_BENT: f64 = 0.03;
const MAX_SCALED: f64 = 0.1;
/// Neighbours whose noise is measured, few, so that what they share stays out; the median of their mean squares as a share of the mean.
const N_NEIGHBOURS: usize = 12;
const MEDIAN_SHARE: f64 = 0.893;
/// Places around which the part turns by more lie at an edge of it: cosine of 20 degrees.
const EDGE_COS: f64 = 0.94;
/// Mean distance of the pairs that tell the shared error, and its least length, mm.
const APART_MM: f64 = 1.0;
const MIN_LENGTH_MM: f64 = 2.0;
/// A point is at the border of a scan if the centroid of its neighbours is off it by this share of their mean distance; points within three
/// spacings of one are near the border.
const N_AROUND: usize = 24;
const ASIDE: f64 = 0.45;
const NEAR_SPACINGS: f64 = 3.0;

/// Turn, shift, offset and scale of a scan.
type Row = SVector<f64, 8>;
type Square = SMatrix<f64, 8, 8>;

/// What is scanned.
pub enum KnownPart {
    /// Any shape.
    Mesh(MeshQuery),
    /// A plane, whose offset is a shift.
    Plane,
    /// A ball, by its radius in mm, whose scale is an offset.
    Ball(f64),
}

impl KnownPart {
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

    /// The pose of plane or ball by its points, and which unknowns a fit has.
    fn start(&self, points: &[Point3<f64>], given: &Isometry3<f64>) -> (Isometry3<f64>, Row) {
        let middle = centroid(points);
        let scatter: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
        match self {
            Self::Mesh(_) => (*given, Row::repeat(1.0)),
            Self::Plane => {
                let eigen = scatter.symmetric_eigen();
                let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
                let turn = UnitQuaternion::rotation_between(&normal, &Vector3::z());
                let pose = turn.unwrap_or_else(UnitQuaternion::identity) * Translation3::from(-middle.coords);
                (pose, Row::from([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]))
            }
            Self::Ball(_) => {
                // |p|² = 2 p·c + const about the middle.
                let mean = scatter.trace() / points.len() as f64;
                let b: Vector3<f64> = points.iter().map(|p| (p - middle) * ((p - middle).norm_squared() - mean)).sum();
                let centre = middle + scatter.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * b / 2.0);
                let pose = Isometry3::translation(-centre.x, -centre.y, -centre.z);
                (pose, Row::from([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0]))
            }
        }
    }
}

/// How one scan differs from the part.
#[derive(Debug, Clone)]
pub struct ScanErrors {
    /// What pose, offset and scale leave, along the part's x axis, each with whether it is an outlier.
    pub residuals: Vec<(Residual, bool)>,
    /// Offset outward, mm, and scale, less 1, each with its standard deviation, where the part holds it.
    bias: Option<[f64; 2]>,
    scale: Option<[f64; 2]>,
    length_mm: f64,
    /// Share of the shared error's variance that the fit, and the distance between points, leave.
    left_share: f64,
    /// Shares of the outliers and of the others that lie near the scan's border.
    near_border: [f64; 2],
    /// Noise by place, along the part's x axis: x, square (mm²), distance to the sensor (mm), tilt to the line of sight (degrees).
    noise: Vec<[f64; 4]>,
}

impl ScanErrors {
    /// Fits a scan to the part, a mesh from a pose near the right one; the sensor stood at `viewpoint`.
    ///
    /// # Errors
    /// [`Refusal`] if the scan is not of this part, or has too few points.
    ///
    /// # Source
    /// Least squares with correlated errors: the covariance of the fit is `(X'X)⁻¹ X'ΣX (X'X)⁻¹`, that of the errors Gaussian.
    pub fn of(
        points: &[Point3<f64>],
        part: &KnownPart,
        start: &Isometry3<f64>,
        viewpoint: Option<Point3<f64>>,
    ) -> Result<Self, Refusal> {
        let some = thinned(points, N_FITTED[1]);
        let (mut pose, unknown) = part.start(&some, start);
        let middle = pose * centroid(&some);
        let radius_mm =
            (some.iter().map(|p| (pose * p - middle).norm_squared()).sum::<f64>() / some.len() as f64).sqrt();
        let row = |at: &Residual| {
            // Of the foot: the point itself has the error, which would be taken for scale.
            let (arm, n) = ((at.point - at.normal * at.signed_mm - middle) / radius_mm, at.normal);
            let turn = n.cross(&arm);
            Row::from([turn.x, turn.y, turn.z, -n.x, -n.y, -n.z, 1.0, arm.dot(&n)]).component_mul(&unknown)
        };
        let (mut x, mut on, mut rows, mut sigma_mm) = (Row::zeros(), Vec::new(), Vec::new(), 0.0);
        let left = |at: &Residual, x: &Row| at.signed_mm - row(at).dot(x);
        for _ in 0..50 {
            on = some.par_iter().filter_map(|p| part.residual(pose * p)).collect::<Vec<_>>();
            sigma_mm = median(&mut on.iter().map(|at| left(at, &x).abs()).collect::<Vec<_>>()) / MEDIAN_SIGMAS;
            on.retain(|at| left(at, &x).abs() <= (GATE_SIGMAS * sigma_mm).max(1e-6));
            rows = on.iter().map(row).collect();
            x = inverse(&rows).0 * rows.iter().zip(&on).map(|(row, at)| row * at.signed_mm).sum::<Row>();
            let (turn, shift) = (x.fixed_rows::<3>(0) / radius_mm, x.fixed_rows::<3>(3).into_owned());
            let about = Translation3::from(middle.coords + shift) * UnitQuaternion::new(turn);
            pose = about * Translation3::from(-middle.coords) * pose;
            x.fixed_rows_mut::<6>(0).fill(0.0);
            if turn.norm() * radius_mm + shift.norm() < 1e-6 {
                break;
            }
        }
        let is_bent = !matches!(part, KnownPart::Mesh(_)) && sigma_mm > MAX_BENT * radius_mm;
        if on.len() < N_FITTED[0] || is_bent {
            let (n, of) = (on.len(), "over a scan of a radius of");
            return Err(Refusal::of(format!(
                "{n} of its points lie on the part, with {sigma_mm:.2} mm {of} {radius_mm:.0} mm: another shape, or too few points"
            )));
        }
        let freed = |at: Residual| Residual { signed_mm: left(&at, &x), ..at };
        let on: Vec<Residual> = on.into_iter().map(freed).collect();
        let ((covariance, held), error) = (inverse(&rows), SurfaceError::new(&on));
        let alike = |apart_mm: f64| (-(apart_mm / error.length_mm.max(MIN_LENGTH_MM)).powi(2)).exp();
        let with_all = |i: usize| {
            let near = (0..on.len()).map(|j| rows[j] * alike((on[i].point - on[j].point).norm()));
            rows[i] * near.sum::<Row>().transpose()
        };
        let shared = (0..on.len()).into_par_iter().map(with_all).collect::<Vec<_>>().into_iter().sum::<Square>();
        // The fit takes what it can of an error that neighbours share.
        let taken = ((covariance * shared).trace() / on.len() as f64).clamp(0.0, 0.8);
        let left_share = (1.0 - taken) * alike(APART_MM);
        let level = error.level_mm.powi(2) / left_share;
        let white = covariance * error.noise_mm.powi(2);
        let covariance = covariance * shared * covariance * level + white;
        let unit = |k: usize, by: f64| (held[k] > 0.999).then(|| [x[k] / by, covariance[(k, k)].max(0.0).sqrt() / by]);
        let bias = unit(6, 1.0);
        let scale = if let KnownPart::Ball(ball_mm) = part { unit(6, *ball_mm) } else { unit(7, radius_mm) };
        if let Some([scale, _]) = scale.filter(|[scale, sd]| scale.abs() - 2.0 * sd > MAX_SCALED) {
            let times = 1.0 + scale;
            return Err(Refusal::of(format!(
                "it is {times:.2} times as large as the part: another part, or another unit"
            )));
        }
        let all = thinned(points, N_EXAMINED);
        let mut residuals: Vec<(Residual, bool)> = all
            .par_iter()
            .filter_map(|p| part.residual(pose * p))
            .map(freed)
            .map(|at| (at, at.signed_mm.hypot(at.aside_mm) > GATE_SIGMAS * sigma_mm))
            .collect();
        residuals.sort_by(|a, b| a.0.point.x.total_cmp(&b.0.point.x));
        let off = residuals.iter().filter(|(_, is_off)| *is_off).count() as f64 / residuals.len() as f64;
        if off > MAX_OFF {
            return Err(Refusal::of(format!(
                "{:.0} % of its points lie off the part; crop it to the part",
                100.0 * off
            )));
        }
        let noise_at = |patch: NoisePatch| {
            let Residual { point, normal, .. } = part.residual(pose * patch.place)?;
            let sight = viewpoint.map_or_else(|| Vector3::repeat(f64::NAN), |eye| point - pose * eye);
            let tilt_deg = sight.normalize().dot(&normal).abs().min(1.0).acos().to_degrees();
            // An edge of the part is no noise.
            let u = normal.cross(&Vector3::new(normal.y, -normal.z, normal.x)).normalize() * patch.reach_mm;
            let around = [u, -u, u.cross(&normal), normal.cross(&u)].map(|aside| part.residual(point + aside));
            let is_flat = around.iter().flatten().all(|at| at.normal.dot(&normal) > EDGE_COS);
            is_flat.then_some([point.x, patch.square / MEDIAN_SHARE, sight.norm(), tilt_deg])
        };
        let patches = noise_patches(points, N_NEIGHBOURS).unwrap_or_default();
        let mut noise: Vec<[f64; 4]> = patches.into_iter().filter_map(noise_at).collect();
        noise.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let near_border = near_border(&residuals);
        Ok(Self { residuals, bias, scale, length_mm: error.length_mm, left_share, near_border, noise })
    }
}

/// The inverse of the normal matrix without its nullspace, and how much of each unknown is not in that.
fn inverse(rows: &[Row]) -> (Square, Row) {
    let eigen = rows.iter().map(|row| row * row.transpose()).sum::<Square>().symmetric_eigen();
    let least = 1e-9 * eigen.eigenvalues.max();
    let kept = || eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues).filter(|(_, value)| **value > least);
    let inverse = kept().map(|(column, value)| column * column.transpose() / *value).sum();
    (inverse, kept().map(|(column, _)| column.component_mul(&column)).sum())
}

/// Shares of the outliers, and of the other points, that lie near the border of the scan.
fn near_border(residuals: &[(Residual, bool)]) -> [f64; 2] {
    let foot = |at: &Residual| at.point - at.normal * at.signed_mm;
    let feet: Vec<Point3<f64>> = residuals.iter().filter(|(_, is_off)| !is_off).map(|(at, _)| foot(at)).collect();
    let tree = Nearest::new(&feet);
    let around = |at: &Point3<f64>| {
        let near = tree.nearest_n(at, N_AROUND);
        let aside = near.iter().map(|(i, _)| feet[*i] - at).sum::<Vector3<f64>>().norm();
        let far_mm: f64 = near.iter().map(|(_, square)| square.sqrt()).sum();
        (aside > ASIDE * far_mm, near.get(1).map_or(0.0, |(_, square)| square.sqrt()))
    };
    let around: Vec<(bool, f64)> = feet.par_iter().map(around).collect();
    let reach_mm = NEAR_SPACINGS * median(&mut around.iter().map(|(_, mm)| *mm).collect::<Vec<_>>());
    let border: Vec<Point3<f64>> = around.iter().zip(&feet).filter(|((is, _), _)| *is).map(|(_, at)| *at).collect();
    let border = Nearest::new(&border);
    [true, false].map(|off| {
        let of: Vec<_> = residuals.iter().filter(|(_, is_off)| *is_off == off).collect();
        let is_near = |(at, _): &&&(Residual, bool)| {
            border.nearest(&foot(at)).is_some_and(|(_, square)| square <= reach_mm * reach_mm)
        };
        of.iter().filter(is_near).count() as f64 / of.len().max(1) as f64
    })
}
