//! Hand-eye calibration: the camera in its marker's frame, from poses of the marker and of a target that does not move.

mod late;
mod misfit;
mod signs;

use super::inliers::{N_OF_START, inliers, selected};
use super::interval::radius_90;
use crate::Refusal;
use crate::product::gram;
pub use late::{hand_eye_late, hand_eye_pairs};
use misfit::{GATE, in_scale, offsets_mm};
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Matrix3x4, Matrix4, Quaternion, Rotation3, Translation3, UnitQuaternion,
    Vector3, Vector4,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Motions by less than this say little beside their noise, radians: 3 degrees.
const LEAST_TURN_RAD: f64 = 0.052;
/// The axis of a motion by nearly half a turn has no sign, radians: 170 degrees.
const MOST_TURN_RAD: f64 = 2.967;
/// Least ratio of the second to the first singular value of the motions' axes: they are within 6 degrees of one line.
const LEAST_SPREAD: f64 = 0.1;
/// Largest number of motions; more are thinned evenly.
const N_MOTIONS: usize = 1000;
/// Unit of length of the dual quaternions, mm: a metre. In millimetres the lengths would outweigh the turns, and the rotation errs three
/// times as much.
const DUAL_UNIT_MM: f64 = 1000.0;
/// Number of parts of the poses, each of which is left out once for the predicted error.
const N_PARTS: usize = 20;
/// Least number of stations that are such parts. Without one of fewer the others do not determine the camera.
const LEAST_STATIONS: usize = 4;

/// The marker in the tracker's frame and the target in the camera's, at one time.
type Pair = (Isometry3<f64>, Isometry3<f64>);

/// A method for `A X = X B`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Rotation by least squares of the motions' rotation vectors, then translation (Park and Martin 1994).
    #[default]
    ParkMartin,
    /// Rotation by modified Rodrigues vectors, then translation (Tsai and Lenz 1989).
    TsaiLenz,
    /// Rotation and translation at once, by dual quaternions (Daniilidis 1999).
    Daniilidis,
}

impl Method {
    const ALL: [Self; 3] = [Self::ParkMartin, Self::TsaiLenz, Self::Daniilidis];
}

/// The camera in its marker's frame, and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct HandEyeFit {
    /// The camera in the frame of its marker.
    pub t_marker_camera: Isometry3<f64>,
    /// Residuals, observability and predicted error.
    pub report: HandEyeReport,
}

/// Residuals, observability and predicted error of a hand-eye calibration.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HandEyeReport {
    /// Number of pairs of poses used.
    pub n_poses: usize,
    /// Indices of the pairs that were left out, in order: the target was elsewhere, by far more than in the others.
    pub outliers: Vec<usize>,
    /// Largest distance of the target in these from its mean place in the others, mm; 0 without any.
    pub outlier_max_mm: f64,
    /// Largest such angle, radians.
    pub outlier_max_rad: f64,
    /// Scale of the target's lengths beside those of the tracker, estimated beside the pose: 1 if right, 1.05 of a board whose squares
    /// are stated 5 % too large. The pose is that of scale 1.
    pub scale: f64,
    /// Its standard deviation, by the same jackknife.
    pub scale_sd: f64,
    /// RMS distance of the target from its mean place in that scale, mm.
    pub scaled_rms_mm: f64,
    /// Distance between the camera in that scale and in scale 1, mm.
    pub scaled_off_mm: f64,
    /// Distance between the camera and its marker, mm.
    pub camera_mm: f64,
    /// Distance between the target and the origin of the tracker's frame, mm.
    pub target_mm: f64,
    /// How far the directions of the target from the camera spread (RMS), beside those of the camera from the target: less than 1 of a
    /// camera that keeps its target in view.
    pub view_ratio: f64,
    /// Number of motions between two of them that were used.
    pub n_motions: usize,
    /// RMS distance of the target from its mean place, as the calibration carries it to the tracker, mm.
    pub rms_mm: f64,
    /// Largest such distance.
    pub max_mm: f64,
    /// RMS angle of the target from its mean orientation, radians.
    pub rms_rad: f64,
    /// Ratio of the second to the first singular value of the motions' axes: 0 for turns about one axis, which leave the
    /// translation along it free; 1 for axes in all directions.
    pub axis_spread: f64,
    /// Largest angle of a motion, radians.
    pub max_turn_rad: f64,
    /// Standard deviation of the translation, RMS over its three directions, mm: from the spread of the answers without each part
    /// of the poses.
    pub translation_sd_mm: f64,
    /// Standard deviation of the rotation, RMS over its three directions, radians, likewise.
    pub rotation_sd_rad: f64,
    /// Radius about the translation of `t_camera_camera_marker` that holds its true value with a chance of 90 %, mm.
    pub error_90_mm: f64,
    /// Angle about the rotation that holds it with that chance, radians.
    pub error_90_rad: f64,
    /// Largest distance between the translations of this method and the two others, mm.
    pub others_mm: f64,
    /// Largest angle between the rotations of this method and the two others, radians.
    pub others_rad: f64,
}

/// A motion of the marker and the same motion of the camera: `a X = X b`.
struct Motion {
    a: Isometry3<f64>,
    b: Isometry3<f64>,
}

/// The camera in its marker's frame, `X = t_marker_camera`, from pairs of poses that were taken at one time each, in the order of time:
/// the marker in the tracker's frame, and a target that does not move in the camera's.
///
/// Motions are those between all pairs of poses, of at most 170 degrees. Pairs whose target is far from where the others have it are
/// left out; where none is, the answer is that of all. The predicted error is a jackknife: stations, at which the camera was held
/// still, or else parts of successive poses are left out one by one, at most twenty, so errors that neighbours share are not taken for
/// independent.
///
/// # Errors
/// [`Refusal`] if there are fewer than three poses, one is not finite, the motions turn too little or about one axis alone, fewer than
/// 60 % of the poses agree, or the target is more than 10 mm or 10 degrees RMS from one place; with the cause if another reading of the
/// poses, another scale or a camera on a stand explains them.
///
/// # Source
/// Park and Martin 1994, IEEE Trans. Robotics and Automation 10; Tsai and Lenz 1989, ibid. 5; Daniilidis 1999, Int. J. Robotics
/// Research 18. The search for outliers: least median of squares, Rousseeuw 1984.
pub fn hand_eye(
    t_world_marker: &[Isometry3<f64>],
    t_camera_target: &[Isometry3<f64>],
    method: Method,
) -> Result<HandEyeFit, Refusal> {
    let n = t_world_marker.len();
    if n < 3 || t_camera_target.len() != n {
        return Err(Refusal::of(format!(
            "{n} poses of the marker and {} of the target, at least 3 of each and as many are needed",
            t_camera_target.len()
        )));
    }
    let pairs: Vec<Pair> = t_world_marker.iter().copied().zip(t_camera_target.iter().copied()).collect();
    let is_finite = |t: &Isometry3<f64>| t.to_homogeneous().iter().all(|x| x.is_finite());
    if let Some(index) = pairs.iter().position(|(marker, target)| !is_finite(marker) || !is_finite(target)) {
        return Err(Refusal::of(format!("pose {index} is not finite; drop it before calibrating")));
    }
    let is_kept =
        if n > N_OF_START + 1 { inliers(&pairs, |used| offsets_mm(&pairs, used), &GATE) } else { vec![true; n] };
    let fit = fit(&pairs, &is_kept, method)?;
    fit.check(&pairs)?;
    Ok(fit)
}

fn fit(all: &[Pair], is_kept: &[bool], method: Method) -> Result<HandEyeFit, Refusal> {
    let pairs = selected(all, is_kept);
    let (n, motions) = (pairs.len(), motions(&pairs));
    let max_turn_rad = motions.iter().map(|m| m.a.rotation.angle()).fold(0.0, f64::max);
    let axis_spread = axis_spread(&motions);
    if motions.len() < 2 || axis_spread < LEAST_SPREAD {
        let turned = match motions.len() {
            0 | 1 => "less than 3 degrees, and about no axis that can be told".into(),
            _ => format!("up to {:.0} degrees, and about one axis alone", max_turn_rad.to_degrees()),
        };
        return Err(Refusal::of(format!(
            "the camera was turned by {turned}: its translation along that axis is left free; turn it by 30 degrees or more about two axes \
             that are far from parallel"
        )));
    }
    let fit = solution(method, &motions).ok_or_else(|| {
        Refusal::of(format!(
            "{method:?} has no answer for these motions; take another method, or turn the camera farther"
        ))
    })?;
    // A method without an answer is no measure of this one.
    let others = Method::ALL.into_iter().filter(|other| *other != method).filter_map(|other| solution(other, &motions));
    let (others_mm, others_rad) = lengths(others.map(|other| fit.inv_mul(&other)));
    let ([camera, marker, turn, scales], n_parts) = spread(&pairs, &fit, method);
    let sd = |covariance: &Matrix3<f64>| (covariance.trace() / 3.0).sqrt();
    let (scaled, scale) = with_scale(fit.rotation, &motions, true).unwrap_or((fit, 1.0));
    let in_scale = in_scale(&pairs, scale);
    let scaled_mm = offsets(&in_scale, &scaled, &home(&in_scale, &scaled)).0;
    let home = home(&pairs, &fit);
    let (mm, rad) = offsets(&pairs, &fit, &home);
    let outliers: Vec<usize> = (0..all.len()).filter(|k| !is_kept[*k]).collect();
    let (outlier_mm, outlier_rad) =
        offsets(&selected(all, &is_kept.iter().map(|is| !is).collect::<Vec<_>>()), &fit, &home);
    let max = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    Ok(HandEyeFit {
        t_marker_camera: fit,
        report: HandEyeReport {
            n_poses: n,
            outlier_max_mm: max(&outlier_mm),
            outlier_max_rad: max(&outlier_rad),
            outliers,
            scale,
            scale_sd: scales.trace().sqrt(),
            scaled_rms_mm: rms(&scaled_mm),
            scaled_off_mm: (scaled.translation.vector - fit.translation.vector).norm(),
            camera_mm: fit.translation.vector.norm(),
            target_mm: home.translation.vector.norm(),
            view_ratio: wander_rad(pairs.iter().map(|of| of.1)) / wander_rad(pairs.iter().map(|of| of.1.inverse())),
            n_motions: motions.len(),
            rms_mm: rms(&mm),
            max_mm: max(&mm),
            rms_rad: rms(&rad),
            axis_spread,
            max_turn_rad,
            translation_sd_mm: sd(&camera),
            rotation_sd_rad: sd(&turn),
            error_90_mm: radius_90(&marker, n_parts as f64 - 1.0),
            error_90_rad: radius_90(&turn, n_parts as f64 - 1.0),
            others_mm: max(&others_mm),
            others_rad: max(&others_rad),
        },
    })
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// The mean place and orientation of the target in the tracker's frame.
fn home(pairs: &[Pair], fit: &Isometry3<f64>) -> Isometry3<f64> {
    let placed: Vec<Isometry3<f64>> = pairs.iter().map(|(marker, target)| marker * fit * target).collect();
    let mean = placed.iter().map(|t| t.translation.vector).sum::<Vector3<f64>>() / pairs.len() as f64;
    Isometry3::from_parts(mean.into(), mean_rotation(&placed))
}

/// How far the target is from there at each pose, mm and radians.
fn offsets(pairs: &[Pair], fit: &Isometry3<f64>, home: &Isometry3<f64>) -> (Vec<f64>, Vec<f64>) {
    lengths(pairs.iter().map(|(marker, target)| home.inv_mul(&(marker * fit * target))))
}

/// Lengths and angles of motions, mm and radians.
fn lengths(motions: impl Iterator<Item = Isometry3<f64>>) -> (Vec<f64>, Vec<f64>) {
    motions.map(|t| (t.translation.vector.norm(), t.rotation.angle())).unzip()
}

/// RMS angle between the directions of the origins of poses and their mean, radians.
fn wander_rad(poses: impl Iterator<Item = Isometry3<f64>>) -> f64 {
    let directions: Vec<Vector3<f64>> = poses.map(|t| t.translation.vector.normalize()).collect();
    let mean: Vector3<f64> = directions.iter().sum();
    rms(&directions.iter().map(|direction| direction.angle(&mean)).collect::<Vec<_>>())
}

/// The motions between all pairs of poses, or an even thinning of them.
fn motions(pairs: &[Pair]) -> Vec<Motion> {
    let n = pairs.len();
    let step = (n * n.saturating_sub(1) / 2).div_ceil(N_MOTIONS).max(1);
    let all = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).step_by(step);
    let motion =
        |(i, j): (usize, usize)| Motion { a: pairs[j].0.inverse() * pairs[i].0, b: pairs[j].1 * pairs[i].1.inverse() };
    let is_telling =
        |m: &Motion| [&m.a, &m.b].iter().all(|t| (LEAST_TURN_RAD..MOST_TURN_RAD).contains(&t.rotation.angle()));
    all.map(motion).filter(is_telling).collect()
}

fn axis_spread(motions: &[Motion]) -> f64 {
    let sum: Matrix3<f64> =
        motions.iter().filter_map(|m| m.a.rotation.axis()).map(|axis| axis.into_inner() * axis.transpose()).sum();
    let mut values: Vec<f64> = sum.symmetric_eigenvalues().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    if values[0] > 0.0 { (values[1].max(0.0) / values[0]).sqrt() } else { 0.0 }
}

fn solution(method: Method, motions: &[Motion]) -> Option<Isometry3<f64>> {
    let pose = match method {
        Method::ParkMartin => with_scale(park_martin(motions)?, motions, false)?.0,
        Method::TsaiLenz => with_scale(tsai_lenz(motions)?, motions, false)?.0,
        Method::Daniilidis => daniilidis(motions)?,
    };
    pose.to_homogeneous().iter().all(|x| x.is_finite()).then_some(pose)
}

/// The rotation that takes the rotation vectors of `b` to those of `a` in the least-squares sense.
fn park_martin(motions: &[Motion]) -> Option<UnitQuaternion<f64>> {
    let vectors = |m: &Motion| (m.a.rotation.scaled_axis(), m.b.rotation.scaled_axis());
    let sum: Matrix3<f64> = motions.iter().map(vectors).map(|(a, b)| a * b.transpose()).sum();
    let svd = sum.svd(true, true);
    let (u, v_t) = svd.u.zip(svd.v_t)?;
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * sign * v_t)))
}

fn tsai_lenz(motions: &[Motion]) -> Option<UnitQuaternion<f64>> {
    let vector = |t: &Isometry3<f64>| {
        let angle = t.rotation.angle();
        t.rotation.axis().map_or_else(Vector3::zeros, |axis| axis.into_inner() * 2.0 * (angle / 2.0).sin())
    };
    let mut equations = DMatrix::zeros(3 * motions.len(), 3);
    let mut right = DVector::zeros(3 * motions.len());
    for (k, m) in motions.iter().enumerate() {
        let (a, b) = (vector(&m.a), vector(&m.b));
        equations.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&(a + b).cross_matrix());
        right.fixed_rows_mut::<3>(3 * k).copy_from(&(b - a));
    }
    // `tan(angle / 2)` times the axis of X.
    let solution = equations.svd(true, true).solve(&right, 1e-12).ok()?;
    let imaginary = Vector3::new(solution[0], solution[1], solution[2]);
    Some(UnitQuaternion::from_quaternion(Quaternion::from_parts(1.0, imaginary)))
}

/// The camera in its marker's frame with this rotation, and the scale of the target's lengths, which is 1 unless it is sought:
/// `(R_a - I) t - R t_b / scale = -t_a` for all motions. `None` if they do not determine it.
fn with_scale(rotation: UnitQuaternion<f64>, motions: &[Motion], is_sought: bool) -> Option<(Isometry3<f64>, f64)> {
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for m in motions {
        let turn = m.a.rotation.to_rotation_matrix().into_inner() - Matrix3::identity();
        let mut rows: Matrix3x4<f64> = turn.insert_column(3, 0.0);
        rows.set_column(3, &-(rotation * m.b.translation.vector));
        normal += rows.tr_mul(&rows);
        right -= rows.tr_mul(&m.a.translation.vector);
    }
    if !is_sought {
        right -= normal.column(3);
        normal.fill_row(3, 0.0);
        normal.fill_column(3, 0.0);
        (normal[(3, 3)], right[3]) = (1.0, 1.0);
    }
    let solution = normal.cholesky()?.solve(&right);
    let (t, scale) = (Translation3::from(solution.xyz()), 1.0 / solution[3]);
    (scale.is_finite() && scale > 0.0).then_some((Isometry3::from_parts(t, rotation), scale))
}

fn daniilidis(motions: &[Motion]) -> Option<Isometry3<f64>> {
    // Real and dual part with a real part whose scalar is positive.
    let dual = |t: &Isometry3<f64>| {
        let real = if t.rotation.w < 0.0 { -t.rotation.into_inner() } else { t.rotation.into_inner() };
        (real, Quaternion::from_parts(0.0, t.translation.vector / DUAL_UNIT_MM) * real * 0.5)
    };
    let mut equations = DMatrix::zeros(6 * motions.len(), 8);
    for (k, m) in motions.iter().enumerate() {
        let ((a, a_dual), (b, b_dual)) = (dual(&m.a), dual(&m.b));
        let mut put = |row: usize, column: usize, difference: Vector3<f64>, sum: Vector3<f64>| {
            equations.fixed_view_mut::<3, 1>(6 * k + row, column).copy_from(&difference);
            equations.fixed_view_mut::<3, 3>(6 * k + row, column + 1).copy_from(&sum.cross_matrix());
        };
        let (difference, sum) = (a.vector() - b.vector(), a.vector() + b.vector());
        put(0, 0, difference.clone_owned(), sum.clone_owned());
        put(3, 4, difference.clone_owned(), sum.clone_owned());
        put(3, 0, a_dual.vector() - b_dual.vector(), a_dual.vector() + b_dual.vector());
    }
    // The nullspace has two dimensions: the eigenvectors of the two least eigenvalues.
    let normal = gram(&equations);
    let eigen = normal.symmetric_eigen();
    let mut order: Vec<usize> = (0..8).collect();
    order.sort_by(|i, j| eigen.eigenvalues[*i].total_cmp(&eigen.eigenvalues[*j]));
    let part = |k: usize, from: usize| {
        let v = eigen.eigenvectors.column(order[k]);
        Quaternion::new(v[from], v[from + 1], v[from + 2], v[from + 3])
    };
    let (u1, v1, u2, v2) = (part(0, 0), part(0, 4), part(1, 0), part(1, 4));
    // s² u1·v1 + s (u1·v2 + u2·v1) + u2·v2 = 0 with s = λ1 / λ2.
    let (a, b, c) = (u1.dot(&v1), u1.dot(&v2) + u2.dot(&v1), u2.dot(&v2));
    let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
    let candidates =
        if a.abs() > f64::EPSILON { [(-b + root) / (2.0 * a), (-b - root) / (2.0 * a)] } else { [-c / b; 2] };
    let norm = |s: f64| s * s * u1.dot(&u1) + 2.0 * s * u1.dot(&u2) + u2.dot(&u2);
    let s = if norm(candidates[0]) >= norm(candidates[1]) { candidates[0] } else { candidates[1] };
    let scale = (1.0 / norm(s)).sqrt();
    let (real, dual) = ((u1 * s + u2) * scale, (v1 * s + v2) * scale);
    let t = dual * real.conjugate() * (2.0 * DUAL_UNIT_MM);
    Some(Isometry3::from_parts(Translation3::from(t.vector().clone_owned()), UnitQuaternion::from_quaternion(real)))
}

/// Covariances by a jackknife: of the camera in its marker's frame and of the marker in the camera's, mm², of the rotation, rad², and of
/// the scale; and the number of parts that were left out, one by one.
fn spread(pairs: &[Pair], fit: &Isometry3<f64>, method: Method) -> ([Matrix3<f64>; 4], usize) {
    let parts = parts(pairs);
    let n_parts = parts[parts.len() - 1] + 1;
    let without = |part: usize| {
        let motions = motions(&selected(pairs, &parts.iter().map(|of| *of != part).collect::<Vec<_>>()));
        let t = solution(method, &motions)?;
        let scale = with_scale(fit.rotation, &motions, true).map_or(1.0, |(_, scale)| scale);
        let turn = (fit.rotation.inverse() * t.rotation).scaled_axis();
        Some([t.translation.vector, t.inverse().translation.vector, turn, Vector3::new(scale, 0.0, 0.0)])
    };
    // Without a part the others may not determine it: nothing is known of the error then.
    let Some(found) = (0..n_parts).map(without).collect::<Option<Vec<_>>>() else {
        return ([Matrix3::from_diagonal_element(f64::INFINITY); 4], n_parts);
    };
    let of = |k: usize| {
        let mean = found.iter().map(|values| values[k]).sum::<Vector3<f64>>() / n_parts as f64;
        let sum: Matrix3<f64> = found.iter().map(|values| (values[k] - mean) * (values[k] - mean).transpose()).sum();
        sum * ((n_parts - 1) as f64 / n_parts as f64)
    };
    ([0, 1, 2, 3].map(of), n_parts)
}

/// The part of each pair: of stations, at which the camera was held still, or else of successive poses.
fn parts(pairs: &[Pair]) -> Vec<usize> {
    let mut station = 0;
    let mut of = vec![0];
    for pair in pairs.windows(2) {
        station += usize::from(pair[0].0.rotation.angle_to(&pair[1].0.rotation) > LEAST_TURN_RAD);
        of.push(station);
    }
    if station + 1 < LEAST_STATIONS {
        of = (0..pairs.len()).collect();
    }
    let n = of[of.len() - 1] + 1;
    of.iter().map(|k| k * N_PARTS.min(n) / n).collect()
}

/// The mean of rotations: the largest eigenvector of their quaternions' products.
fn mean_rotation(poses: &[Isometry3<f64>]) -> UnitQuaternion<f64> {
    let sum: Matrix4<f64> = poses.iter().map(|t| t.rotation.coords * t.rotation.coords.transpose()).sum();
    let eigen = sum.symmetric_eigen();
    let column = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    UnitQuaternion::from_quaternion(Quaternion::from(column.clone_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    /// Translation and rotation vector of `t_world_marker` and `t_camera_target`.
    const POSES: [[[f64; 6]; 2]; 12] = [
        [
            [450.500690880, -823.966225696, 858.199347271, -0.793996560, 0.256426583, -0.037139459],
            [-9.279740883, -19.838751808, 251.056042984, 0.000269154, 0.267245992, -0.244343233],
        ],
        [
            [268.004339908, -927.390799285, 990.221922753, -1.196715493, 0.956166151, -0.185362785],
            [5.315085779, 3.158478730, 246.302106711, -0.318556747, -0.453820119, -0.056913056],
        ],
        [
            [298.565282039, -782.753104035, 893.533562145, -0.768764205, 0.926629179, -0.280045056],
            [-24.523611356, 1.577697358, 277.137161115, -0.488770114, -0.093162645, 0.092776996],
        ],
        [
            [560.787477411, -806.747664205, 888.799515861, -0.717079748, -0.034928335, -0.091938848],
            [-9.212279725, 2.648685981, 226.340202018, 0.220546550, 0.472877425, -0.223850534],
        ],
        [
            [322.349148287, -911.812804141, 921.303791477, -1.093326248, 0.715797526, -0.103496829],
            [-8.574435849, -5.967556023, 257.023783290, -0.204394609, -0.230877581, -0.155979504],
        ],
        [
            [420.713951932, -941.395044534, 919.084402753, -1.261281556, 0.482775798, -0.428102157],
            [-40.645287206, -6.187876074, 231.996604557, 0.124320001, -0.275931182, 0.074694874],
        ],
        [
            [326.420186758, -992.553059327, 972.624987852, -1.342296344, 0.677997791, -0.449778923],
            [19.351403107, 3.923153493, 251.760737522, 0.015680514, -0.447579355, 0.110796066],
        ],
        [
            [424.146537269, -739.264214296, 892.304380961, -0.523649688, 0.615644025, -0.501689659],
            [-5.460999108, -3.271171541, 230.485139492, -0.317172539, 0.259110721, 0.299639606],
        ],
        [
            [306.051872331, -812.389588074, 878.098603363, -0.818035652, 0.715445336, 0.044662639],
            [-27.575881791, -16.157001873, 283.008393394, -0.373972013, 0.003785803, -0.248887428],
        ],
        [
            [480.571112751, -1063.259433345, 1007.322023595, -1.631871039, 0.283453980, -0.287834681],
            [-24.234381009, 26.750437431, 239.858185673, 0.415057719, -0.492916638, -0.129455672],
        ],
        [
            [407.788638781, -836.900708844, 857.600757615, -0.744288645, 0.551593208, -0.377111589],
            [10.758114049, 15.466645524, 266.748826473, -0.185206867, 0.129894253, 0.131353849],
        ],
        [
            [393.215451151, -784.858069634, 876.558009324, -0.755732901, 0.751888632, -0.488535107],
            [-42.132525895, 5.085372835, 250.853834536, -0.315171419, -0.003555421, 0.259205681],
        ],
    ];
    /// `cv2.calibrateHandEye` of OpenCV 4.14.0: translation and rotation vector of `t_marker_camera`; with lengths in metres, which
    /// only matters for the dual quaternions.
    const OPENCV: [(Method, [f64; 6]); 3] = [
        (Method::TsaiLenz, [34.870317393, -59.359327664, 82.156927869, 0.401739317, -0.701397989, 1.101384957]),
        (Method::ParkMartin, [34.887528648, -59.444431767, 82.114801279, 0.401254205, -0.701225544, 1.101559889]),
        (Method::Daniilidis, [34.865401110, -59.302297022, 82.176333006, 0.401658854, -0.701288185, 1.101357365]),
    ];

    fn of(row: &[f64; 6]) -> Isometry3<f64> {
        Isometry3::new(Vector3::new(row[0], row[1], row[2]), Vector3::new(row[3], row[4], row[5]))
    }

    fn truth() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(35.0, -60.0, 82.0), Vector3::new(0.4, -0.7, 1.1))
    }

    type Poses = (Vec<Isometry3<f64>>, Vec<Isometry3<f64>>);

    /// Poses whose camera turns by up to 40 degrees about `axes`, with noise of both devices, mm, and a tenth of it in degrees.
    fn poses(n: usize, axes: Vector3<f64>, noise_mm: f64, seed: u64) -> Poses {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut one = || 2.0 * rng.random::<f64>() - 1.0;
        let t_world_target = Isometry3::new(Vector3::new(500.0, -800.0, 1200.0), Vector3::new(-0.3, 0.2, 0.9));
        let mut vector = |scale: f64| Vector3::new(one(), one(), one()) * scale;
        (0..n)
            .map(|_| {
                let turn = vector(0.7).component_mul(&axes);
                let target = Isometry3::new(Vector3::new(0.0, 0.0, 250.0) + vector(30.0), turn);
                let marker = t_world_target * target.inverse() * truth().inverse();
                let wide = noise_mm * 3f64.sqrt();
                let mut noise = || Isometry3::new(vector(wide), vector((0.1 * wide).to_radians()));
                (marker * noise(), target * noise())
            })
            .unzip()
    }

    #[test]
    fn every_method_finds_the_camera_from_exact_poses() {
        let (marker, target) = poses(8, Vector3::repeat(1.0), 0.0, 1);
        for method in Method::ALL {
            let fit = hand_eye(&marker, &target, method).unwrap();
            let off = truth().inverse() * fit.t_marker_camera;
            assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-9, "{method:?}: {off}");
            let HandEyeReport { n_poses, n_motions, rms_mm, rms_rad, others_mm, translation_sd_mm, .. } = fit.report;
            assert!(n_poses == 8 && n_motions > 20, "{n_motions} motions");
            assert!(
                rms_mm < 1e-6 && rms_rad < 1e-6 && others_mm < 1e-6 && translation_sd_mm < 1e-6,
                "{:?}",
                fit.report
            );
        }
    }

    #[test]
    fn the_three_methods_agree_with_those_of_opencv() {
        let (marker, target): Poses = POSES.iter().map(|[marker, target]| (of(marker), of(target))).unzip();
        let pairs: Vec<_> = marker.iter().copied().zip(target.iter().copied()).collect();
        for (method, row) in OPENCV {
            let mut motions = motions(&pairs);
            assert_eq!(motions.len(), 66, "all of them");
            if method == Method::TsaiLenz {
                // OpenCV leaves out motions by less than 0.3 radians for this method.
                motions.retain(|motion| motion.a.rotation.angle() > 0.3);
            }
            let pose = solution(method, &motions).unwrap();
            let off = of(&row).inverse() * pose;
            // Both are least squares of the same equations.
            assert!(off.translation.vector.norm() < 1e-5 && off.rotation.angle() < 1e-7, "{method:?}: {off}");
        }
    }

    #[test]
    fn the_camera_errs_as_predicted() {
        for method in Method::ALL {
            let (mut mm, mut mm_predicted, mut rad, mut rad_predicted) = (0.0, 0.0, 0.0, 0.0);
            for seed in 0..60 {
                let (marker, target) = poses(20, Vector3::repeat(1.0), 0.1, seed);
                let HandEyeFit { t_marker_camera, report } = hand_eye(&marker, &target, method).unwrap();
                mm += (t_marker_camera.translation.vector - truth().translation.vector).norm_squared() / 180.0;
                rad += t_marker_camera.rotation.angle_to(&truth().rotation).powi(2) / 180.0;
                mm_predicted += report.translation_sd_mm.powi(2) / 60.0;
                rad_predicted += report.rotation_sd_rad.powi(2) / 60.0;
            }
            let (mm, rad) = ((mm_predicted / mm).sqrt(), (rad_predicted / rad).sqrt());
            // 180 errors, and a jackknife, which is known to be a little large.
            assert!((0.75..1.6).contains(&mm) && (0.75..1.6).contains(&rad), "{method:?}: {mm} and {rad} of the error");
        }
    }

    /// Such poses give a calibration of their own with a residual of hundreds of millimetres, which is no fault of the fit.
    #[test]
    fn poses_of_which_one_are_inverses_are_refused_and_exchanged_ones_give_the_target_in_the_tracker() {
        let inverses = |of: &[Isometry3<f64>]| of.iter().map(Isometry3::inverse).collect::<Vec<_>>();
        for (n, noise_mm) in [(4, 0.0), (4, 0.2), (20, 0.0), (20, 0.5)] {
            for seed in 0..20 {
                let (marker, target) = poses(n, Vector3::repeat(1.0), noise_mm, seed);
                let (marker_inverse, target_inverse) = (inverses(&marker), inverses(&target));
                for method in Method::ALL {
                    let right = hand_eye(&marker, &target, method).unwrap().t_marker_camera;
                    for (marker, target) in [(&marker, &target_inverse), (&marker_inverse, &target)] {
                        let error = hand_eye(marker, target, method).unwrap_err().to_string();
                        let expected = "if the poses of the marker or of the target are inverted";
                        assert!(error.contains(expected), "{n} poses, {noise_mm} mm, seed {seed}, {method:?}: {error}");
                    }
                    if noise_mm == 0.0 {
                        let exchanged = hand_eye(&target, &marker, method).unwrap().t_marker_camera;
                        let off = exchanged * marker[0] * right * target[0];
                        assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-9, "{off}");
                    }
                }
            }
        }
    }

    #[test]
    fn turns_about_one_axis_few_poses_and_numbers_that_are_not_finite_are_refused() {
        let (marker, target) = poses(12, Vector3::z(), 0.0, 2);
        let error = hand_eye(&marker, &target, Method::ParkMartin).unwrap_err().to_string();
        assert!(error.contains("about one axis alone: its translation along that axis is left free"), "{error}");
        let (marker, mut target) = poses(12, Vector3::repeat(1.0), 0.0, 2);
        let error = hand_eye(&marker[..2], &target[..2], Method::ParkMartin).unwrap_err().to_string();
        assert!(error.starts_with("2 poses of the marker and 2 of the target"), "{error}");
        target[4].translation.vector.x = f64::NAN;
        let error = hand_eye(&marker, &target, Method::ParkMartin).unwrap_err().to_string();
        assert!(error.starts_with("pose 4 is not finite"), "{error}");
        let (marker, target) = poses(12, Vector3::repeat(0.01), 0.0, 2);
        assert!(hand_eye(&marker, &target, Method::ParkMartin).is_err(), "a degree is too little");
    }
}
