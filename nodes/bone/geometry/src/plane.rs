use crate::{Frame, StampNs};
use nalgebra::{Isometry3, Vector3};
use std::sync::Arc;

/// The pose of a cutting plane, or the reason why it is unknown.
#[derive(Debug, Clone, PartialEq)]
pub enum PlanePlace {
    /// `t_frame_plane`: the plane's own z axis is its normal, its origin is on it.
    Known(Isometry3<f64>),
    /// The reason, such as a lost marker; the last pose is never kept.
    Unknown(Arc<str>),
}

/// A named cutting plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// Its name in the plan.
    pub name: Arc<str>,
    /// Its pose.
    pub place: PlanePlace,
}

impl Plane {
    /// A plane of known pose.
    pub fn new(name: impl Into<Arc<str>>, t_frame_plane: Isometry3<f64>) -> Self {
        Self { name: name.into(), place: PlanePlace::Known(t_frame_plane) }
    }

    /// `t_frame_plane`, where known.
    pub fn isometry(&self) -> Option<&Isometry3<f64>> {
        match &self.place {
            PlanePlace::Known(t) => Some(t),
            PlanePlace::Unknown(_) => None,
        }
    }

    /// The unit normal in the plane's frame, where known.
    pub fn normal(&self) -> Option<Vector3<f64>> {
        self.isometry().map(|t| t * Vector3::z())
    }
}

/// Cutting planes in one frame at one time. A cheap handle.
#[derive(Debug, Clone, PartialEq)]
pub struct Planes {
    /// The frame of the planes.
    pub frame: Frame,
    /// The time at which the poses hold; 0 for planned planes.
    pub stamp_ns: StampNs,
    /// The planes, in the plan's order.
    pub planes: Arc<[Plane]>,
}

impl Planes {
    /// Planes in `frame`, without a time.
    pub fn new(frame: impl Into<Frame>, planes: impl Into<Arc<[Plane]>>) -> Self {
        Self { frame: frame.into(), stamp_ns: 0, planes: planes.into() }
    }

    /// Sets the stamp.
    pub fn at(self, stamp_ns: StampNs) -> Self {
        Self { stamp_ns, ..self }
    }

    /// The planes in frame `to`, moved by `t_to_frame`; an unknown one stays unknown.
    pub fn transformed(&self, to: impl Into<Frame>, t_to_frame: &Isometry3<f64>) -> Planes {
        let planes = self.planes.iter().map(|plane| match &plane.place {
            PlanePlace::Known(t) => Plane::new(plane.name.clone(), t_to_frame * t),
            PlanePlace::Unknown(_) => plane.clone(),
        });
        Planes { frame: to.into(), stamp_ns: self.stamp_ns, planes: planes.collect() }
    }

    /// Planes of these names in `frame`, all unknown for `reason`.
    pub fn unknown(&self, frame: impl Into<Frame>, stamp_ns: StampNs, reason: &str) -> Planes {
        let reason: Arc<str> = reason.into();
        let planes =
            self.planes.iter().map(|p| Plane { name: p.name.clone(), place: PlanePlace::Unknown(reason.clone()) });
        Planes { frame: frame.into(), stamp_ns, planes: planes.collect() }
    }
}
