use crate::Frame;
use nalgebra::Point3;

/// A box along the axes of `frame`, mm: the region of interest that a user drew.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// The frame whose axes the box follows.
    pub frame: Frame,
    /// The corner with the smallest coordinates.
    pub min: Point3<f64>,
    /// The corner with the largest coordinates.
    pub max: Point3<f64>,
}

impl Region {
    /// Whether the point is inside or on the boundary.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        (0..3).all(|k| self.min[k] <= point[k] && point[k] <= self.max[k])
    }
}
