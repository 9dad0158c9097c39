//! A registration that may scale: a few steps on a few points, for what may contradict a calibration.

use super::pairs::{Faces, Pair, Scan, agreeing, on_faces};
use super::spread::middle;
use crate::kabsch::centroid;
use nalgebra::{Isometry3, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// Minimum RMS residual, mm, that growth by a factor of e causes, with all motions free. The blocks of a phantom give 4, the
/// faces of a cube alone none.
pub(super) const MIN_HOLD_MM: f64 = 0.5;

/// Maximum change of the logarithm of the scale in one step.
const MAX_GROWTH: f64 = 0.1;

type Row = SVector<f64, 7>;
type Square = SMatrix<f64, 7, 7>;

/// The steps: pairs have weight within a gate that narrows from `first_mm` to `last_mm`.
pub(super) struct Steps {
    /// Maximum distance of a pair, mm.
    pub(super) max_pair_mm: f64,
    pub(super) first_mm: f64,
    pub(super) last_mm: f64,
    pub(super) n: usize,
}

impl Steps {
    /// The last half has the last gate.
    fn gate_mm(&self, step: usize) -> f64 {
        let share = (2 * step) as f64 / (self.n - 1) as f64;
        self.first_mm * (self.last_mm / self.first_mm).powf(share.min(1.0))
    }
}

/// A scan as registered.
pub(super) struct Aligned {
    pub(super) t_phantom_camera: Isometry3<f64>,
    /// Scale of the scan: 1 if right, above 1 if it is too large; and its standard deviation.
    pub(super) scale: f64,
    pub(super) scale_sd: f64,
    /// The scan in its right size.
    pub(super) scan: Scan,
}

/// Registers a scan by its distances along the normals, from a pose; with the smooth error of the camera's depth, mm, its
/// scale too. `None` if the pairs do not determine that.
pub(super) fn align(
    faces: &Faces,
    scan: &Scan,
    start: &Isometry3<f64>,
    steps: &Steps,
    scaled_smooth_mm: Option<f64>,
) -> Option<Aligned> {
    let centroid = centroid(&scan.points);
    let mut at = Aligned { t_phantom_camera: *start, scale: 1.0, scale_sd: 0.0, scan: scan.clone() };
    for step in 0..steps.n {
        let gate_mm = steps.gate_mm(step);
        let on_faces = on_faces(faces, &at.scan, &at.t_phantom_camera, steps.max_pair_mm);
        let used: Vec<Pair> = agreeing(on_faces).filter(|p| p.residual_mm.abs() <= gate_mm).collect();
        let centre = at.t_phantom_camera * centroid;
        let rows: Vec<Row> = used.iter().map(|p| row(p, &centre, scaled_smooth_mm.is_some())).collect();
        let mut normal: Square = rows.iter().map(|r| r * r.transpose()).sum();
        if scaled_smooth_mm.is_none() {
            normal[(6, 6)] = used.len() as f64;
        }
        let right: Row = rows.iter().zip(&used).map(|(r, p)| r * p.residual_mm).sum();
        let inverse = normal.try_inverse()?;
        let hold_mm = (inverse[(6, 6)] * used.len() as f64).powf(-0.5);
        let delta = -(inverse * right);
        if hold_mm.is_nan() || hold_mm < MIN_HOLD_MM || !delta.iter().all(|d| d.is_finite()) {
            return None;
        }
        let (shift, turn) = (Vector3::new(delta[0], delta[1], delta[2]), Vector3::new(delta[3], delta[4], delta[5]));
        let about = Translation3::from(centre.coords)
            * UnitQuaternion::from_scaled_axis(turn)
            * Translation3::from(-centre.coords);
        at.t_phantom_camera = Translation3::from(shift) * about * at.t_phantom_camera;
        if let Some(smooth_mm) = scaled_smooth_mm {
            at.scale *= (-delta[6]).clamp(-MAX_GROWTH, MAX_GROWTH).exp();
            at.scan.points = scan.points.iter().map(|p| centroid + (p - centroid) / at.scale).collect();
            if step + 1 == steps.n {
                at.scale_sd = (inverse * middle(&used, &rows, smooth_mm) * inverse)[(6, 6)].max(0.0).sqrt();
            }
        }
    }
    Some(at)
}

/// Change of a residual with shift, turn and, if the scan scales, growth about `centre`.
fn row(pair: &Pair, centre: &Point3<f64>, scales: bool) -> Row {
    let arm = pair.phantom - centre;
    let (n, turn) = (pair.normal, arm.cross(&pair.normal));
    Row::from([n.x, n.y, n.z, turn.x, turn.y, turn.z, if scales { n.dot(&arm) } else { 0.0 }])
}
