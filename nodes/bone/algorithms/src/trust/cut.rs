//! A planned cut, and what a displacement of the bone does to it.

use crate::product::product;
use crate::section;
use crate::target::Target;
use nalgebra::{DMatrix, Point3, Vector3};
use osteoflow_geometry::{NamedPoint, Plane, Planes};

/// A planned cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Cut {
    /// Its name, and the middle of the bone in it.
    pub middle: NamedPoint,
    /// Its unit normal.
    pub normal: Vector3<f64>,
}

/// The tilt of a cut is that of its plane this far around its middle, mm: a displacement may change along the bone.
const AROUND_MM: f64 = 0.1;

/// What a displacement does to a cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Displaced {
    /// Along the normal, in the middle, mm.
    pub(super) offset_mm: f64,
    /// Slope of the displacement along the normal: the tilt to first order, rad.
    pub(super) slope: f64,
}

impl Cut {
    /// Two perpendicular arms from the middle, in the plane.
    fn arms(&self) -> [Vector3<f64>; 2] {
        let other = if self.normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let u = self.normal.cross(&other).normalize();
        [u * AROUND_MM, self.normal.cross(&u) * AROUND_MM]
    }

    /// The points whose displacements [`Cut::displaced`] takes: the middle, and both ends of each arm.
    pub(super) fn probes(&self) -> [Point3<f64>; 5] {
        let (middle, [u, v]) = (self.middle.position, self.arms());
        [middle, middle + u, middle - u, middle + v, middle - v]
    }

    /// What displacements of [`Cut::probes`], mm, do to the cut.
    pub(super) fn displaced(&self, [middle, u_plus, u_minus, v_plus, v_minus]: [Vector3<f64>; 5]) -> Displaced {
        let slope = |arm: Vector3<f64>, difference: Vector3<f64>| difference.dot(&self.normal) / (2.0 * arm.norm());
        let [u, v] = self.arms();
        let slope = slope(u, u_plus - u_minus).hypot(slope(v, v_plus - v_minus));
        Displaced { offset_mm: middle.dot(&self.normal).abs(), slope }
    }

    /// What parameters do to the cut, whose levers on a point have three rows: along the normal, mm, and both slopes.
    pub(super) fn levers(&self, at: &dyn Fn(&Point3<f64>) -> DMatrix<f64>) -> [DMatrix<f64>; 2] {
        let [middle, u_plus, u_minus, v_plus, v_minus] =
            self.probes().map(|p| product(&DMatrix::from_row_slice(1, 3, self.normal.as_slice()), &at(&p)));
        let [u, v] = self.arms().map(|arm| 2.0 * arm.norm());
        let mut slopes = DMatrix::zeros(2, middle.ncols());
        slopes.row_mut(0).copy_from(&((u_plus - u_minus) / u).row(0));
        slopes.row_mut(1).copy_from(&((v_plus - v_minus) / v).row(0));
        [middle, slopes]
    }

    /// What a field of displacements, mm, does to the cut.
    pub(super) fn displaced_by(&self, at: &dyn Fn(&Point3<f64>) -> Vector3<f64>) -> Displaced {
        self.displaced(self.probes().map(|p| at(&p)))
    }
}

/// The planned cuts, each with the middle of the bone in it.
pub(super) fn planned_cuts(target: &Target, planes: Option<&Planes>) -> Vec<Cut> {
    let planes = planes.map(|planes| &*planes.planes).unwrap_or_default();
    let cut = |plane: &Plane| {
        let t = plane.isometry()?;
        let on_bone = target.mesh().and_then(|mesh| section::middle(mesh.mesh(), t, None));
        let position = on_bone.unwrap_or_else(|| t * Point3::origin());
        Some(Cut { middle: NamedPoint::new(plane.name.clone(), position), normal: t * Vector3::z() })
    };
    planes.iter().filter_map(cut).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Rotation3};

    #[test]
    fn a_small_turn_tilts_a_cut_by_its_part_across_the_normal_and_a_shift_displaces_it() {
        let turn = Vector3::new(0.003, -0.004, 0.2);
        let at = Isometry3::new(Vector3::new(30.0, -20.0, 150.0), Vector3::new(0.4, 1.1, -0.6));
        let cut = Cut { middle: NamedPoint::new("a", at * Point3::origin()), normal: at * Vector3::z() };
        let of = |shift: Vector3<f64>, turn: Vector3<f64>| {
            cut.displaced_by(&|p| at * (shift + turn.cross(&(at.inverse() * p).coords)))
        };
        // A turn about the normal neither tilts nor displaces.
        let turned = of(Vector3::zeros(), turn);
        assert!((turned.slope - 0.005).abs() < 1e-12 && turned.offset_mm < 1e-12, "{turned:?}");
        let shifted = of(Vector3::new(5.0, 6.0, -0.7), Vector3::zeros());
        assert!((shifted.offset_mm - 0.7).abs() < 1e-12 && shifted.slope < 1e-12, "{shifted:?}");
        // The slope is the turn of the normal.
        let small = Vector3::new(1e-3, 2e-3, 0.0);
        let tilt = (Rotation3::new(small) * Vector3::z()).angle(&Vector3::z());
        assert!((of(Vector3::zeros(), small).slope - tilt).abs() < 1e-9, "to first order");
    }
}
