//! The ways in which the world may depart from a rigid copy of the CT, each as displacements of the scan's points.

use crate::axes::largest_first;
use crate::kabsch::centroid;
use nalgebra::{Matrix3, Point3, Vector3};

/// The directions of a registered scan, target's frame.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::trust) struct Axes {
    /// Centroid of the scan.
    pub(in crate::trust) centre: Point3<f64>,
    /// Unit direction of its longest extent: a shaft's axis.
    pub(in crate::trust) along: Vector3<f64>,
    /// Unit direction towards the camera, perpendicular to `along`; without a camera, the mean normal of the surface.
    pub(in crate::trust) towards: Vector3<f64>,
    /// `along` x `towards`.
    pub(in crate::trust) sideways: Vector3<f64>,
    /// Half of the extent along `along`, mm.
    pub(in crate::trust) half_mm: f64,
    /// Where the camera was.
    pub(in crate::trust) camera: Option<Point3<f64>>,
}

impl Axes {
    /// The directions of a scan whose points have these normals; `None` where it has none.
    pub(in crate::trust) fn new(
        points: &[Point3<f64>],
        normals: &[Vector3<f64>],
        camera: Option<Point3<f64>>,
    ) -> Option<Self> {
        let centre = centroid(points);
        let scatter: Matrix3<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
        let ([along, ..], _) = largest_first(&scatter);
        let mean: Vector3<f64> = normals.iter().sum();
        let view = camera.map_or(mean, |camera| camera - centre);
        let towards = (view - along * view.dot(&along)).try_normalize(1e-9)?;
        let mut far: Vec<f64> = points.iter().map(|p| (p - centre).dot(&along).abs()).collect();
        far.sort_by(f64::total_cmp);
        let half_mm = far[(far.len() - 1) * 98 / 100].max(1.0);
        Some(Self { centre, along, towards, sideways: along.cross(&towards), half_mm, camera })
    }

    /// Position along the axis, from -1 at one end of the scan to 1 at the other.
    pub(super) fn along_share(&self, p: &Point3<f64>) -> f64 {
        (p - self.centre).dot(&self.along) / self.half_mm
    }
}

/// A displacement that carries points of the scan, where the bone is, to where the CT shows them; for a parameter of 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Mode {
    /// `to` for each mm along `of`: a stretch, a shear.
    Strain { of: Vector3<f64>, to: Vector3<f64> },
    /// Away from the centroid, in proportion to the distance.
    Growth,
    /// Away from the axis, in proportion to the distance.
    Across,
    /// Towards a direction by 1 mm at both ends of the scan against its middle, with the turn of the sections that goes with it.
    Bend(Vector3<f64>),
    /// A turn about the axis by 1 rad at one end and -1 rad at the other.
    Twist,
    /// Along the surface's outward normal, 1 mm everywhere.
    Offset,
    /// A film on the side that faces the camera, 1 mm where the surface faces it; from none at one end to 1 mm at the other for a
    /// ramp of 1 or -1, as thick everywhere for 0.
    Film { ramp: f64 },
    /// A film from none on one side of the bone to 1 mm on the other.
    FilmAround,
    /// Beyond a place along the axis, 1 mm towards a direction.
    Step { beyond_mm: f64, to: Vector3<f64> },
    /// Away from the camera, in proportion to the distance.
    Scale(Point3<f64>),
    /// Away from the camera along its view, in proportion to the depth.
    Depth(Point3<f64>),
}

impl Mode {
    /// The displacement at a point with this outward normal, mm.
    pub(super) fn at(&self, axes: &Axes, p: &Point3<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
        let arm = p - axes.centre;
        match *self {
            Self::Strain { of, to } => to * of.dot(&arm),
            Self::Growth => arm,
            Self::Across => arm - axes.along * axes.along.dot(&arm),
            Self::Bend(to) => {
                let s = axes.along_share(p);
                to * (s * s) - axes.along * (2.0 * s * to.dot(&arm) / axes.half_mm)
            }
            Self::Twist => axes.along.cross(&arm) * axes.along_share(p),
            Self::Offset => *normal,
            Self::Film { ramp } => {
                let thickness = if ramp == 0.0 { 1.0 } else { 0.5 * (1.0 + ramp * axes.along_share(p)) };
                -normal * (normal.dot(&axes.towards).max(0.0) * thickness)
            }
            Self::FilmAround => -normal * (0.5 * (1.0 + normal.dot(&axes.sideways))),
            Self::Step { beyond_mm, to } if arm.dot(&axes.along) > beyond_mm => to,
            Self::Step { .. } => Vector3::zeros(),
            Self::Scale(camera) => p - camera,
            Self::Depth(camera) => {
                let view = (axes.centre - camera).normalize();
                view * view.dot(&(p - camera))
            }
        }
    }

    /// Whether it displaces the planned points with the bone; else it displaces the scan alone.
    pub(super) fn moves_bone(&self) -> bool {
        !matches!(self, Self::Offset | Self::Film { .. } | Self::FilmAround | Self::Scale(_) | Self::Depth(_))
    }
}

/// A cause of error beyond the pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Cause {
    Along,
    Growth,
    Shear,
    Across,
    Bend,
    Twist,
    Offset,
    FilmAlong,
    FilmAround,
    Film,
    Step { beyond_mm: f64 },
    CameraScale,
    CameraDepth,
}

impl Cause {
    /// The name in the results.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Along => "stretch_along",
            Self::Growth => "growth",
            Self::Shear => "shear",
            Self::Across => "stretch_across",
            Self::Bend => "bend",
            Self::Twist => "twist",
            Self::Offset => "offset",
            Self::FilmAlong => "film_along",
            Self::FilmAround => "film_around",
            Self::Film => "film",
            Self::Step { .. } => "step",
            Self::CameraScale => "camera_scale",
            Self::CameraDepth => "camera_depth",
        }
    }

    /// The unit of its size, and what a parameter is multiplied by to have it.
    pub(super) fn unit(self) -> (&'static str, f64) {
        match self {
            Self::Along | Self::Growth | Self::Across | Self::CameraScale | Self::CameraDepth => ("%", 100.0),
            Self::Shear | Self::Twist => ("degrees", 1_f64.to_degrees()),
            _ => ("mm", 1.0),
        }
    }

    /// The usual size of its parameters where it is there: stretches of 3 %, tilts of a gantry of 8 degrees.
    pub(super) fn usual(self) -> f64 {
        match self {
            Self::Along | Self::Growth | Self::Across => 0.03,
            Self::CameraScale | Self::CameraDepth => 0.015,
            Self::Shear => 8_f64.to_radians(),
            Self::Twist => 3_f64.to_radians(),
            Self::Bend | Self::Offset => 0.5,
            Self::FilmAlong | Self::FilmAround | Self::Film | Self::Step { .. } => 2.0,
        }
    }

    /// The largest size that is what its name says: beyond it, tissue or another bone is explained. A slice spacing may be any.
    pub(super) fn largest(self) -> f64 {
        match self {
            Self::Along => f64::INFINITY,
            Self::Growth | Self::Across => 0.15,
            Self::CameraScale | Self::CameraDepth => 0.1,
            Self::Shear | Self::Twist => 30_f64.to_radians(),
            Self::Bend | Self::Offset | Self::Step { .. } => 10.0,
            Self::FilmAlong | Self::FilmAround | Self::Film => 5.0,
        }
    }

    /// Number of its parameters that make its size: a shear is fitted beside a stretch.
    pub(super) fn n_own(self) -> usize {
        match self {
            Self::Bend | Self::Step { .. } => 2,
            _ => 1,
        }
    }

    /// The direction in which a cause acts.
    pub(super) fn axis(self, axes: &Axes, values: Option<&[f64]>) -> Option<Vector3<f64>> {
        match (self, values) {
            (Self::Along | Self::FilmAlong | Self::Twist, _) => Some(axes.along),
            (Self::Bend | Self::Step { .. }, Some([a, b])) => {
                (axes.towards * *a + axes.sideways * *b).try_normalize(1e-12)
            }
            (Self::Shear, _) => Some(Vector3::y()),
            (Self::FilmAround, _) => Some(axes.sideways),
            (Self::Film, _) => Some(axes.towards),
            (Self::CameraDepth, _) => axes.camera.and_then(|camera| (axes.centre - camera).try_normalize(1e-9)),
            _ => None,
        }
    }

    /// The place at which a cause acts.
    pub(super) fn place(self, axes: &Axes) -> Option<Point3<f64>> {
        match self {
            Self::Step { beyond_mm } => Some(axes.centre + axes.along * beyond_mm),
            _ => None,
        }
    }

    /// Its size, from its parameters.
    pub(super) fn size(self, values: &[f64]) -> f64 {
        match (self, values) {
            (Self::Shear, [shear, ..]) => *shear,
            (_, [value]) => *value,
            _ => values.iter().map(|value| value * value).sum::<f64>().sqrt(),
        }
    }

    /// Whether it is of the camera, which a check piece tests.
    pub(super) fn is_of_camera(self) -> bool {
        matches!(self, Self::CameraScale | Self::CameraDepth)
    }

    /// Whether it is an assumption even where the data limit it: a film has any profile, and the camera's scale moves a bone at its
    /// working distance more than its size shows.
    pub(super) fn is_assumed(self) -> bool {
        matches!(
            self,
            Self::CameraScale | Self::CameraDepth | Self::Step { .. } | Self::Film | Self::FilmAlong | Self::FilmAround
        )
    }

    /// Its parameters; none where it needs a camera that is not known.
    pub(super) fn modes(self, axes: &Axes) -> Vec<Mode> {
        let (along, towards, sideways) = (axes.along, axes.towards, axes.sideways);
        match self {
            Self::Along => vec![Mode::Strain { of: along, to: along }],
            Self::Growth => vec![Mode::Growth],
            // Slices are stacked along z of the CT, and a gantry tilts about x. Up to a turn and a stretch of second order, both
            // ways to write it are one: this moves a shaft the least.
            Self::Shear => {
                let (y, z) = (Vector3::y(), Vector3::z());
                let (of, to) = if along.z.abs() >= along.y.abs() { (y, z) } else { (z, y) };
                vec![Mode::Strain { of, to }, Mode::Strain { of: along, to: along }]
            }
            Self::Across => vec![Mode::Across],
            Self::Bend => vec![Mode::Bend(towards), Mode::Bend(sideways)],
            Self::Twist => vec![Mode::Twist],
            Self::Offset => vec![Mode::Offset],
            Self::FilmAlong => vec![Mode::Film { ramp: 1.0 }],
            Self::FilmAround => vec![Mode::FilmAround],
            Self::Film => vec![Mode::Film { ramp: 0.0 }],
            Self::Step { beyond_mm } => [towards, sideways].map(|to| Mode::Step { beyond_mm, to }).to_vec(),
            Self::CameraScale => axes.camera.map(Mode::Scale).into_iter().collect(),
            Self::CameraDepth => axes.camera.map(Mode::Depth).into_iter().collect(),
        }
    }
}
