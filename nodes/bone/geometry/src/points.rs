use crate::{Frame, StampNs};
use nalgebra::{Isometry3, Point3};
use std::sync::Arc;

/// A point with a name, such as the landmark P1 or the assessment point M3.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedPoint {
    /// The landmark's name.
    pub name: Arc<str>,
    /// Its position, mm.
    pub position: Point3<f64>,
    /// When it was located; 0 for a planned point.
    pub stamp_ns: StampNs,
    /// The confidence of the detector, 0 to 1, if it has one.
    pub confidence: Option<f64>,
}

impl NamedPoint {
    /// A planned point: no time, no confidence.
    pub fn new(name: impl Into<Arc<str>>, position: Point3<f64>) -> Self {
        Self { name: name.into(), position, stamp_ns: 0, confidence: None }
    }
}

/// Named points in one frame, in order. A cheap handle.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    /// The frame of the positions.
    pub frame: Frame,
    /// The time at which the list was complete; 0 for planned points.
    pub stamp_ns: StampNs,
    /// The points, in their order.
    pub points: Arc<[NamedPoint]>,
}

impl Points {
    /// Points in `frame`, stamped with the latest of their times.
    pub fn new(frame: impl Into<Frame>, points: impl Into<Arc<[NamedPoint]>>) -> Self {
        let points = points.into();
        let stamp_ns = points.iter().map(|p| p.stamp_ns).max().unwrap_or(0);
        Self { frame: frame.into(), stamp_ns, points }
    }

    /// The first point of that name.
    pub fn get(&self, name: &str) -> Option<&NamedPoint> {
        self.points.iter().find(|p| &*p.name == name)
    }

    /// The positions, in order.
    pub fn positions(&self) -> Vec<Point3<f64>> {
        self.points.iter().map(|p| p.position).collect()
    }

    /// The points in frame `to`, moved by `t_to_frame`.
    pub fn transformed(&self, to: impl Into<Frame>, t_to_frame: &Isometry3<f64>) -> Points {
        Points {
            frame: to.into(),
            stamp_ns: self.stamp_ns,
            points: self.points.iter().map(|p| NamedPoint { position: t_to_frame * p.position, ..p.clone() }).collect(),
        }
    }
}
