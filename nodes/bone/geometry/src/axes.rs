use crate::Frame;
use nalgebra::{Matrix3, Point3, Vector3};

/// A right-handed set of anatomical axes: unit columns x, y, z with z along the bone, through `centre`.
#[derive(Debug, Clone, PartialEq)]
pub struct Axes {
    /// The frame the axes are given in.
    pub frame: Frame,
    /// Their origin, mm.
    pub centre: Point3<f64>,
    /// The axes as orthonormal columns.
    pub columns: Matrix3<f64>,
}

impl Axes {
    /// The components of a vector along x, y and z.
    pub fn components(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.columns.tr_mul(vector)
    }
}
