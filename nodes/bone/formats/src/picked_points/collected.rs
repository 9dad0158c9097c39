//! The content of a file of picked points.

use crate::Space;
use nalgebra::{Isometry3, Point3, Rotation3, Vector3};
use osteoflow_geometry::{Frame, NamedPoint, Plane, TooFar};
use std::{collections::HashSet, ops::Range, sync::Arc};

/// The points, planes and boxes of a file; mm, LPS if the file states its space.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedPoints {
    /// The points, in the file's order.
    pub points: Vec<NamedPoint>,
    /// Whether the file names every point; those without a name are called by their place in the list, from "1" on.
    pub is_named: bool,
    /// Planes, `t_lps_plane`, the plane's own z axis being its normal; only Slicer's JSON has them.
    pub planes: Vec<Plane>,
    /// Boxes; only Slicer's JSON has them.
    pub rois: Vec<PickedRoi>,
    /// The lists of points that Slicer's JSON and scenes consist of.
    pub lists: Vec<PickedList>,
    /// The space that the file states.
    pub space: Space,
    /// The frame that a column `frame` states, as in the files of `output.csv`.
    pub frame: Option<Frame>,
    /// How many points were passed over because they are inactive, or their position was not set.
    pub n_skipped: usize,
    /// Changes to the content and what is doubtful, one sentence each.
    pub notes: Vec<String>,
}

/// A list of points of 3D Slicer.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedList {
    /// Its name; empty if the file gives none.
    pub name: Arc<str>,
    /// `Fiducial`, `Line`, `Curve`, `ClosedCurve` or `Angle`.
    pub kind: String,
    /// Number of points that are placed.
    pub n_points: usize,
    /// Which of [`points`](PickedPoints::points) are its own; of a scene those of fiducials only.
    pub points: Range<usize>,
}

/// A box, in general not along the axes.
#[derive(Debug, Clone, PartialEq)]
pub struct PickedRoi {
    /// Its name; `roi_1` and so on if the file gives none.
    pub name: Arc<str>,
    /// Its center, mm.
    pub center: Point3<f64>,
    /// Its axes, the columns of the rotation.
    pub axes: Rotation3<f64>,
    /// Its edges along its axes, mm.
    pub size_mm: Vector3<f64>,
}

impl PickedPoints {
    /// Multiplies all lengths, then moves everything.
    pub fn transformed(mut self, motion: &Isometry3<f64>, scale: f64) -> Self {
        self.points.iter_mut().for_each(|point| point.position = motion * (point.position * scale));
        for plane in &mut self.planes {
            if let Some(mut pose) = plane.isometry().copied() {
                pose.translation.vector *= scale;
                *plane = Plane::new(plane.name.clone(), motion * pose);
            }
        }
        for roi in &mut self.rois {
            roi.center = motion * (roi.center * scale);
            roi.axes = motion.rotation.to_rotation_matrix() * roi.axes;
            roi.size_mm *= scale;
        }
        self
    }
}

/// Points as they are read, with unique names.
#[derive(Default)]
pub(super) struct Collected {
    pub(super) points: Vec<NamedPoint>,
    names: HashSet<Arc<str>>,
    n_unnamed: usize,
    frame: Option<Frame>,
    pub(super) n_skipped: usize,
    pub(super) notes: Vec<String>,
}

impl Collected {
    /// Adds a point; without a name it is called by its place in the list.
    ///
    /// # Errors
    /// A message, if the name is there already or a number is not finite.
    pub(super) fn push(&mut self, name: &str, position: [f64; 3], space: Space) -> Result<(), String> {
        if !position.iter().all(|c| c.is_finite()) {
            return Err(format!("point \"{name}\" is at {position:?}; three finite numbers are expected"));
        }
        TooFar::check(&position).map_err(|far| format!("point \"{name}\": {far}"))?;
        let name: Arc<str> = match name.trim() {
            "" => {
                self.n_unnamed += 1;
                (self.points.len() + 1).to_string().into()
            }
            name => name.into(),
        };
        if !self.names.insert(name.clone()) {
            return Err(format!("label \"{name}\" is given twice; name each point once"));
        }
        self.points.push(NamedPoint::new(name, to_lps(position, space)));
        Ok(())
    }

    /// Takes the frame that a point states.
    ///
    /// # Errors
    /// A message, if it is another than that of the points before.
    pub(super) fn in_frame(&mut self, frame: &str) -> Result<(), String> {
        let first = self.frame.get_or_insert_with(|| frame.into());
        if first.as_str() == frame {
            return Ok(());
        }
        Err(format!("the point is in frame \"{frame}\", those before it are in \"{first}\"; a list has one frame"))
    }

    pub(super) fn finish(mut self, space: Space) -> PickedPoints {
        if self.n_unnamed > 0 && self.n_unnamed < self.points.len() {
            let (n, of) = (self.n_unnamed, self.points.len());
            self.notes.push(format!("{n} of {of} points have no name and are called by their place in the list"));
        }
        if space == Space::Ras {
            self.notes.push("the file states RAS; x and y were negated, which gives LPS".into());
        }
        if self.n_skipped > 0 {
            self.notes.push(format!("{} points are not placed or not active, and were passed over", self.n_skipped));
        }
        let is_named = self.n_unnamed == 0;
        let Self { points, frame, n_skipped, notes, .. } = self;
        let (planes, rois, lists) = Default::default();
        PickedPoints { points, is_named, planes, rois, lists, space, frame, n_skipped, notes }
    }
}

pub(super) fn to_lps([x, y, z]: [f64; 3], space: Space) -> Point3<f64> {
    let sign = space.x_y_sign();
    Point3::new(sign * x, sign * y, z)
}
