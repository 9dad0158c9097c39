//! The surface around a hole, and the hole's centre on it.

use super::scene::Scene;
use crate::normals::plane_normal;
use nalgebra::{Matrix2, Matrix6, Point3, Vector2, Vector3, Vector6};

/// Standard deviation of the Gaussian weights of a surface patch, relative to its radius.
const WIDTH: f64 = 0.2;

/// Number of steps of the fit of a centre; each half converges in five.
const FIT_STEPS: usize = 24;

/// Weight of a present point relative to a missing one.
const PRESENT_WEIGHT: f64 = 2.0;

/// Distance from the disc, in bands, beyond which a point is missing for another reason.
const MAX_BANDS: f64 = 3.0;

/// The reference's surface around a point, as a quadratic height over its tangent plane.
pub(super) struct Patch {
    origin: Point3<f64>,
    axes: [Vector3<f64>; 3],
    height: Vector6<f64>,
}

impl Patch {
    /// `None` if too few points are within `reach_mm`.
    pub(super) fn new(scene: &Scene, origin: &Point3<f64>, reach_mm: f64) -> Option<Self> {
        let around: Vec<Point3<f64>> = scene
            .within(&scene.reference, origin, reach_mm)
            .into_iter()
            .map(|(i, _)| scene.reference.points[i])
            .collect();
        let z = plane_normal(&around)?;
        let x = z.cross(&Vector3::ith(z.iamin(), 1.0)).normalize();
        let mut patch = Self { origin: *origin, axes: [x, z.cross(&x), z], height: Vector6::zeros() };
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for point in &around {
            let [x, y, z] = patch.local(point).into();
            // A bone bends within a spot's radius more than a quadratic can follow, so near points count most.
            let weight = (-(x * x + y * y) / (2.0 * (WIDTH * reach_mm).powi(2))).exp();
            let row = monomials(x, y);
            normal += row * row.transpose() * weight;
            right += row * (z * weight);
        }
        // Regularization: curvatures that too few points determine stay flat.
        let damped = normal + Matrix6::identity() * 1e-3;
        patch.height = damped.cholesky()?.solve(&right);
        Some(patch)
    }

    /// The unit normal, either way.
    pub(super) fn normal(&self) -> &Vector3<f64> {
        &self.axes[2]
    }

    /// Coordinates along the patch's axes.
    pub(super) fn local(&self, point: &Point3<f64>) -> Vector3<f64> {
        let offset = point - self.origin;
        Vector3::from(self.axes.map(|axis| axis.dot(&offset)))
    }

    /// Where a ray meets the surface, along the patch's axes.
    ///
    /// `None` if the ray runs along it, or does not meet it within `reach_mm`, beyond which a quadratic says nothing.
    pub(super) fn hit(&self, origin: &Point3<f64>, along: &Vector3<f64>, reach_mm: f64) -> Option<Vector2<f64>> {
        const STEPS: usize = 12;
        let (start, along) = (self.local(origin), Vector3::from(self.axes.map(|axis| axis.dot(along))));
        const MIN_COS: f64 = 0.05;
        if along.z.abs() < MIN_COS {
            return None;
        }
        // Fixed point: the height at the last place is that of the plane to be met.
        let meet = |height: f64| (start + along * ((height - start.z) / along.z)).xy();
        let mut at = meet(0.0);
        for _ in 0..STEPS {
            at = meet(self.height.dot(&monomials(at.x, at.y)));
        }
        (at.norm() <= reach_mm).then_some(at)
    }

    pub(super) fn on_surface(&self, at: &Vector2<f64>) -> Point3<f64> {
        let z = self.height.dot(&monomials(at.x, at.y));
        self.origin + self.axes[0] * at.x + self.axes[1] * at.y + self.axes[2] * z
    }

    /// The point on the surface with the points `inside` closer than `inner` and those `outside` farther than `outer`,
    /// in the least-squares sense.
    ///
    /// A present point is certainly outside of the hole; a missing one may be missing for another reason, so its
    /// residual is limited to `band`, and in the second half of the steps it is ignored far beyond.
    pub(super) fn fit(
        &self,
        inside: &[Point3<f64>],
        inner: f64,
        outside: &[Point3<f64>],
        outer: f64,
        band: f64,
    ) -> Point3<f64> {
        let mut at = Vector2::zeros();
        for round in 0..FIT_STEPS {
            let centre = self.on_surface(&at);
            let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
            let mut add = |point: &Point3<f64>, limit: f64, weight: &dyn Fn(f64) -> f64| {
                let offset = point - centre;
                let distance = offset.norm();
                let (excess, weight) = (distance - limit, weight(distance - limit));
                if weight > 0.0 && distance > 0.0 {
                    let direction = Vector2::new(self.axes[0].dot(&offset), self.axes[1].dot(&offset)) / distance;
                    normal += direction * direction.transpose() * weight;
                    right += direction * (excess * weight);
                }
            };
            let missing = |excess: f64| match excess {
                e if e <= 0.0 || (round >= FIT_STEPS / 2 && e > MAX_BANDS * band) => 0.0,
                e => (band / e).min(1.0),
            };
            inside.iter().for_each(|p| add(p, inner, &missing));
            outside.iter().for_each(|p| add(p, outer, &|excess| if excess < 0.0 { PRESENT_WEIGHT } else { 0.0 }));
            // Damping: where the rim is open, the centre stays.
            let Some(inverse) = (normal + Matrix2::identity()).try_inverse() else { break };
            at += inverse * right;
        }
        self.on_surface(&at)
    }
}

fn monomials(x: f64, y: f64) -> Vector6<f64> {
    Vector6::new(1.0, x, y, x * x, x * y, y * y)
}
