use crate::{Column, Frame, StampNs, TooFar, first_not_unit};
use nalgebra::{Isometry3, Point3, Vector3};
use std::sync::Arc;

/// A surface as a camera saw it: `n` finite points in mm, with optional normals and named extra columns.
///
/// A cheap handle: clones share the columns. The `viewpoint` is the sensor's pose in the cloud's own frame (camera x
/// right, y down, z forward); it is carried along by [`Cloud::transformed`] and [`Cloud::selected`], so the
/// camera's view of the cloud is known after it has been moved.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// The frame of the coordinates.
    pub frame: Frame,
    /// The time at which it was taken.
    pub stamp_ns: StampNs,
    /// The subject, if a stream carries several: `P1` for the scan with the laser on P1.
    pub label: Option<Arc<str>>,
    /// `t_frame_sensor`: the pose of the sensor that took it, where known.
    pub viewpoint: Option<Isometry3<f64>>,
    points: Column<Point3<f64>>,
    normals: Option<Column<Vector3<f64>>>,
    extras: Vec<(Arc<str>, Column<f64>)>,
}

/// Invalid columns of a cloud: which point or value, and what is wrong with it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CloudError(String);

impl Cloud {
    /// A cloud of `points` in `frame`, without normals or a viewpoint.
    ///
    /// # Errors
    /// [`CloudError`] if a coordinate is NaN, infinite, or beyond [`FARTHEST_MM`](crate::FARTHEST_MM).
    pub fn new(frame: impl Into<Frame>, points: impl Into<Column<Point3<f64>>>) -> Result<Self, CloudError> {
        let (frame, points) = (frame.into(), points.into());
        if let Some((index, far)) = TooFar::first(&points) {
            return Err(CloudError(match far.value_mm.is_finite() {
                true => format!("point {index}: {far}"),
                false => format!("point {index} is not finite; a reader drops and counts such points"),
            }));
        }
        Ok(Self { frame, stamp_ns: 0, label: None, viewpoint: None, points, normals: None, extras: Vec::new() })
    }

    /// Sets the stamp.
    pub fn at(mut self, stamp_ns: StampNs) -> Self {
        self.stamp_ns = stamp_ns;
        self
    }

    /// Sets the viewpoint.
    pub fn seen_from(mut self, t_frame_sensor: Isometry3<f64>) -> Self {
        self.viewpoint = Some(t_frame_sensor);
        self
    }

    /// Sets the label.
    pub fn labelled(mut self, label: impl Into<Arc<str>>) -> Self {
        self.label = Some(label.into());
        self
    }

    /// Sets the unit normals.
    ///
    /// # Errors
    /// [`CloudError`] if there is not one for each point, or the length of one is farther than
    /// [`EXACT_ROTATION`](crate::EXACT_ROTATION) from 1.
    pub fn with_normals(mut self, normals: impl Into<Column<Vector3<f64>>>) -> Result<Self, CloudError> {
        let normals = normals.into();
        self.check_length("normals", normals.len())?;
        if let Some((index, length)) = first_not_unit(&normals) {
            return Err(CloudError(format!("normal {index} has length {length} instead of 1")));
        }
        self.normals = Some(normals);
        Ok(self)
    }

    /// Adds a named column, such as `intensity`.
    ///
    /// # Errors
    /// [`CloudError`] if there is not one value for each point.
    pub fn with_extra(mut self, name: impl Into<Arc<str>>, values: impl Into<Column<f64>>) -> Result<Self, CloudError> {
        let (name, values) = (name.into(), values.into());
        self.check_length(&name, values.len())?;
        self.extras.push((name, values));
        Ok(self)
    }

    /// The cloud without its named columns.
    pub fn without_extras(mut self) -> Self {
        self.extras.clear();
        self
    }

    /// The points, `n`, mm.
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// The points as a column that can be shared.
    pub fn point_column(&self) -> &Column<Point3<f64>> {
        &self.points
    }

    /// Unit normals, one for each point, where known.
    pub fn normals(&self) -> Option<&[Vector3<f64>]> {
        self.normals.as_deref()
    }

    /// The normals as a column that can be shared.
    pub fn normal_column(&self) -> Option<&Column<Vector3<f64>>> {
        self.normals.as_ref()
    }

    /// Further columns by name, in the order in which they were added.
    pub fn extras(&self) -> &[(Arc<str>, Column<f64>)] {
        &self.extras
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The cloud in frame `to`, moved by `t_to_frame`; normals and viewpoint go along, extra columns stay. `O(n)`.
    pub fn transformed(&self, to: impl Into<Frame>, t_to_frame: &Isometry3<f64>) -> Cloud {
        self.transformed_each(to, t_to_frame, |_| t_to_frame)
    }

    /// The cloud in frame `to`, each point moved by a motion of its own, and the viewpoint by `t_to_frame`. `O(n)`.
    pub fn transformed_each<'t>(
        &self,
        to: impl Into<Frame>,
        t_to_frame: &Isometry3<f64>,
        each: impl Fn(usize) -> &'t Isometry3<f64>,
    ) -> Cloud {
        Cloud {
            frame: to.into(),
            stamp_ns: self.stamp_ns,
            label: self.label.clone(),
            viewpoint: self.viewpoint.map(|v| t_to_frame * v),
            points: self.points.iter().enumerate().map(|(k, p)| each(k) * p).collect(),
            normals: self.normals.as_ref().map(|n| n.iter().enumerate().map(|(k, n)| each(k) * n).collect()),
            extras: self.extras.clone(),
        }
    }

    /// The points at `indices`, in that order, with their normals and extra columns.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn selected(&self, indices: &[usize]) -> Cloud {
        Cloud {
            frame: self.frame.clone(),
            stamp_ns: self.stamp_ns,
            label: self.label.clone(),
            viewpoint: self.viewpoint,
            points: indices.iter().map(|&i| self.points[i]).collect(),
            normals: self.normals.as_ref().map(|n| indices.iter().map(|&i| n[i]).collect()),
            extras: self
                .extras
                .iter()
                .map(|(name, values)| (name.clone(), indices.iter().map(|&i| values[i]).collect()))
                .collect(),
        }
    }

    fn check_length(&self, name: &str, found: usize) -> Result<(), CloudError> {
        if found == self.len() {
            return Ok(());
        }
        Err(CloudError(format!("column \"{name}\" has {found} values for {} points", self.len())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_that_is_not_finite_makes_no_cloud() {
        let points = vec![Point3::origin(), Point3::new(0.0, f64::NAN, 0.0)];
        assert!(Cloud::new("camera", points).unwrap_err().to_string().starts_with("point 1 is not finite"));
    }

    #[test]
    fn a_point_beyond_ten_kilometres_makes_no_cloud() {
        let error = Cloud::new("camera", vec![Point3::origin(), Point3::new(0.0, 1e45, 0.0)]).unwrap_err();
        assert_eq!(error.to_string(), format!("point 1: {}", TooFar { value_mm: 1e45 }));
    }

    #[test]
    fn a_normal_that_is_not_of_length_1_is_refused_by_its_index() {
        let cloud = Cloud::new("camera", vec![Point3::origin(); 2]).unwrap();
        for bad in [Vector3::zeros(), Vector3::x() * 1.0005, Vector3::x() * f64::INFINITY, Vector3::x() * f64::NAN] {
            let error = cloud.clone().with_normals(vec![Vector3::z(), bad]).unwrap_err();
            assert!(error.to_string().starts_with("normal 1 has length"), "{bad}: {error}");
        }
        // Single precision.
        let third = Vector3::repeat(f64::from((1.0_f32 / 3.0).sqrt()));
        assert!(cloud.with_normals(vec![third; 2]).is_ok());
    }

    #[test]
    fn moving_a_cloud_moves_its_normals_and_viewpoint_and_keeps_its_extra_columns() {
        let turn = Isometry3::new(Vector3::new(5.0, 0.0, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
        let cloud = Cloud::new("camera", vec![Point3::new(1.0, 0.0, 0.0)])
            .unwrap()
            .with_normals(vec![Vector3::x()])
            .unwrap()
            .with_extra("intensity", vec![7.0])
            .unwrap()
            .seen_from(Isometry3::identity());
        let moved = cloud.transformed("world", &turn);
        assert!((moved.points()[0] - Point3::new(5.0, 1.0, 0.0)).norm() < 1e-12);
        assert!((moved.normals().unwrap()[0] - Vector3::y()).norm() < 1e-12);
        assert_eq!(moved.viewpoint, Some(turn));
        assert_eq!(&*moved.extras()[0].1, &[7.0]);
        assert_eq!(moved.selected(&[0, 0]).len(), 2);
    }
}
