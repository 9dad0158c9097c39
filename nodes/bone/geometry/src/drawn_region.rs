use crate::Frame;
use nalgebra::{Point2, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// A region of interest that a user drew on a cloud: what is in one of `keep` and in none of `cut`. Lengths in mm.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnRegion {
    /// The frame of the cloud that it was drawn on.
    pub frame: Frame,
    /// Number of points of that cloud, and of those inside, if known.
    pub drawn_on: Option<DrawnOn>,
    /// A point in any of them is kept; if there are none, all points are.
    pub keep: Vec<Shape>,
    /// A point in any of them is removed.
    pub cut: Vec<Shape>,
}

/// The cloud that a region was drawn on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrawnOn {
    /// Its number of points.
    pub n_points: usize,
    /// The number of its points in the region.
    pub n_inside: usize,
}

/// A shape in the coordinates of a cloud.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "lowercase", deny_unknown_fields)]
pub enum Shape {
    /// A box along the axes.
    Box {
        /// The corner with the smallest coordinates.
        min: Point3<f64>,
        /// The corner with the largest coordinates.
        max: Point3<f64>,
    },
    /// What lies between two parallel planes.
    Slab {
        /// The point of height 0.
        origin: Point3<f64>,
        /// The direction of the height.
        direction: Unit<Vector3<f64>>,
        /// The lower height.
        from: f64,
        /// The upper height.
        to: f64,
    },
    /// Balls of one radius along a stroke of a brush.
    Brush {
        /// Their centres.
        centres: Vec<Point3<f64>>,
        /// Their radius.
        radius: f64,
    },
    /// What an eye sees inside an outline; points behind it are outside.
    Outline {
        /// Where the eye is.
        eye: Point3<f64>,
        /// To the right of its image, of length 1.
        right: Vector3<f64>,
        /// Down its image, of length 1 and perpendicular to `right`.
        down: Vector3<f64>,
        /// Corners in the image of distance 1: `x / z` right, `y / z` down. The even-odd rule decides where the outline crosses
        /// itself.
        corners: Vec<Point2<f64>>,
    },
}

impl DrawnRegion {
    /// Whether the point is inside.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        let is_in = |shapes: &[Shape]| shapes.iter().any(|shape| shape.contains(point));
        (self.keep.is_empty() || is_in(&self.keep)) && !is_in(&self.cut)
    }
}

impl Shape {
    /// Whether the point is inside or on the boundary.
    pub fn contains(&self, p: &Point3<f64>) -> bool {
        match self {
            Self::Box { min, max } => (0..3).all(|k| min[k] <= p[k] && p[k] <= max[k]),
            Self::Slab { origin, direction, from, to } => {
                let height = dot(&(p - origin), direction);
                *from <= height && height <= *to
            }
            Self::Brush { centres, radius } => centres.iter().any(|centre| {
                let d = p - centre;
                dot(&d, &d) <= radius * radius
            }),
            Self::Outline { eye, right, down, corners } => {
                let d = p - eye;
                let z = dot(&d, &right.cross(down));
                z > 0.0 && encloses(corners, dot(&d, right) / z, dot(&d, down) / z)
            }
        }
    }
}

/// A dot product whose order of additions is that of the page, which counts the points inside.
fn dot(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

/// Whether a polygon encloses a point, by the even-odd rule.
pub fn encloses(polygon: &[Point2<f64>], x: f64, y: f64) -> bool {
    let before = polygon.iter().cycle().skip(polygon.len().saturating_sub(1));
    polygon.iter().zip(before).fold(false, |inside, (a, b)| {
        let crosses = (a.y > y) != (b.y > y) && x < a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y);
        inside != crosses
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Shape {
        Shape::Outline {
            eye: Point3::new(0.0, 0.0, -100.0),
            right: Vector3::x(),
            down: Vector3::y(),
            corners: [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)].map(|(x, y)| Point2::new(x, y)).to_vec(),
        }
    }

    #[test]
    fn each_shape_has_its_boundary_and_nothing_beyond() {
        let slab =
            Shape::Slab { origin: Point3::new(0.0, 0.0, 1.0), direction: Vector3::z_axis(), from: -1.0, to: 2.0 };
        let brush = Shape::Brush { centres: vec![Point3::origin(), Point3::new(9.0, 0.0, 0.0)], radius: 2.0 };
        let ball = Shape::Box { min: Point3::new(-1.0, -2.0, -3.0), max: Point3::new(1.0, 2.0, 3.0) };
        for (shape, inside, outside) in [
            (&ball, [1.0, 2.0, 3.0], [1.0, 2.1, 0.0]),
            (&slab, [50.0, 60.0, 3.0], [0.0, 0.0, 3.01]),
            (&slab, [50.0, 60.0, 0.0], [0.0, 0.0, -0.01]),
            (&brush, [11.0, 0.0, 0.0], [4.5, 0.0, 0.0]),
            (&square(), [9.9, -9.9, 0.0], [10.1, 0.0, 0.0]),
            // It widens with the distance, and has nothing behind the eye.
            (&square(), [19.0, 0.0, 100.0], [0.0, 0.0, -101.0]),
        ] {
            assert!(shape.contains(&inside.into()) && !shape.contains(&outside.into()), "{shape:?}");
        }
    }

    #[test]
    fn what_is_cut_is_removed_from_what_is_kept() {
        let ball = |x: f64| Shape::Brush { centres: vec![Point3::new(x, 0.0, 0.0)], radius: 2.0 };
        let region =
            |keep: Vec<Shape>, cut: Vec<Shape>| DrawnRegion { frame: "camera".into(), drawn_on: None, keep, cut };
        let inside = |region: DrawnRegion| [0.0, 1.5, 3.0, 9.0].map(|x| region.contains(&Point3::new(x, 0.0, 0.0)));
        assert_eq!(inside(region(vec![], vec![])), [true; 4]);
        assert_eq!(inside(region(vec![ball(0.0)], vec![])), [true, true, false, false]);
        assert_eq!(inside(region(vec![], vec![ball(3.0)])), [true, false, false, true]);
        assert_eq!(inside(region(vec![ball(0.0), ball(3.0)], vec![ball(0.5)])), [false, false, true, false]);
    }
}
