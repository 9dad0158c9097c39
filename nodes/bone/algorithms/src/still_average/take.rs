//! How markers moved while something was measured, for what judges it later.

use super::StillReport;
use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3};
use osteoflow_geometry::StampNs;
use serde::{Deserialize, Serialize};

/// Fewer samples do not tell motion from noise.
const MIN_SAMPLES: usize = 3;

/// Samples that end earlier after a scan say nothing about the time after it, s.
const MIN_AFTER_S: f64 = 0.1;

/// How the markers moved while a scan was taken or a point was touched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TakeMotion {
    /// The scan or the point, such as `P1`.
    pub what: String,
    /// The markers by which it was carried, in the time before it.
    pub markers: Vec<MarkerMotion>,
    /// The same markers in the time after it, where that was looked at.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub after: Vec<MarkerMotion>,
    /// The markers of which too few samples show whether they moved, before it and after it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unseen: Vec<String>,
    /// Where the bone's marker was in the world, if the bone has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bone: Option<BonePose>,
}

/// A pose of the bone's marker in the world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BonePose {
    /// Its origin, mm.
    pub position_mm: [f64; 3],
    /// Its rotation, a unit quaternion.
    pub rotation_xyzw: [f64; 4],
}

impl BonePose {
    /// As a motion.
    pub fn isometry(&self) -> Isometry3<f64> {
        let [x, y, z, w] = self.rotation_xyzw;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Isometry3::from_parts(self.position_mm.into(), rotation)
    }
}

/// How one marker moved, and how that displaces what it carries if its poses are late.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MarkerMotion {
    /// The name of the marker: `camera`, `bone` or `stylus`.
    pub marker: String,
    /// Number of samples.
    pub n: usize,
    /// Time from the first sample to the last, s.
    pub span_s: f64,
    /// Motion over that time, mm.
    pub moved_mm: f64,
    /// Motion that the noise explains, mm.
    pub explained_mm: f64,
    /// Rotation over that time, rad.
    pub moved_rad: f64,
    /// Rotation that the noise explains, rad.
    pub explained_rad: f64,
    /// The marker's origin in the frame of what is carried, mm.
    pub at_mm: [f64; 3],
    /// Shift over that time of what is carried, at the marker's origin, mm: what the noise explains is zero.
    pub shift_mm: [f64; 3],
    /// Turn over that time of what is carried, rad: what the noise explains is zero.
    pub turn_rad: [f64; 3],
    /// The largest distance between two poses of one stamp in the stream so far, mm.
    pub contradiction_mm: f64,
    /// The largest angle between two poses of one stamp in the stream so far, rad.
    pub contradiction_rad: f64,
}

/// Whether a marker carries its data with it, or is the frame in which they are seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carries {
    /// The data move with the marker: the camera's, the stylus'.
    Data,
    /// The data are expressed in the marker's frame: the bone's.
    Frame,
}

impl MarkerMotion {
    /// The motion of a marker at `origin`, in the frame that its poses lead to.
    pub fn new(marker: &str, carries: Carries, origin: &Point3<f64>, still: &StillReport) -> Self {
        // A frame that moves on takes its data back.
        let sign = if carries == Carries::Data { 1.0 } else { -1.0 };
        let significant = |moved: f64, explained: f64, line: &[f64; 3]| {
            if moved > explained { (Vector3::from(*line) * sign).into() } else { [0.0; 3] }
        };
        Self {
            marker: marker.to_owned(),
            n: still.n,
            span_s: still.span_s,
            moved_mm: still.moved_mm,
            explained_mm: still.explained_mm,
            moved_rad: still.moved_rad,
            explained_rad: still.explained_rad,
            at_mm: origin.coords.into(),
            shift_mm: significant(still.moved_mm, still.explained_mm, &still.shift_mm),
            turn_rad: significant(still.moved_rad, still.explained_rad, &still.turn_rad),
            contradiction_mm: still.contradiction_mm,
            contradiction_rad: still.contradiction_rad,
        }
    }

    /// In another frame.
    fn carried(mut self, t: &Isometry3<f64>) -> Self {
        self.at_mm = (t * Point3::from(self.at_mm)).coords.into();
        self.shift_mm = (t * Vector3::from(self.shift_mm)).into();
        self.turn_rad = (t * Vector3::from(self.turn_rad)).into();
        self
    }

    /// Displacement of a point over the time of the samples.
    pub(crate) fn displacement(&self, point: &Point3<f64>) -> Vector3<f64> {
        Vector3::from(self.shift_mm) + Vector3::from(self.turn_rad).cross(&(point - Point3::from(self.at_mm)))
    }

    /// Whether it moved by more than noise explains.
    pub(crate) fn is_significant(&self) -> bool {
        self.shift_mm != [0.0; 3] || self.turn_rad != [0.0; 3]
    }
}

impl TakeMotion {
    /// What no marker carries.
    pub fn new(what: impl Into<String>) -> Self {
        Self { what: what.into(), markers: Vec::new(), after: Vec::new(), unseen: Vec::new(), bone: None }
    }

    /// Also carried by another marker.
    #[must_use]
    pub fn by(mut self, marker: Option<MarkerMotion>) -> Self {
        self.markers.extend(marker);
        self
    }

    /// With the motion of a marker in the time after the stamp of the scan, in the frame that the marker's poses lead to; `motion` is of
    /// the window that ends last in that time.
    #[must_use]
    pub fn followed_by(
        mut self,
        marker: &str,
        carries: Carries,
        stamp_ns: StampNs,
        motion: Option<&StillReport>,
    ) -> Self {
        let before = self.markers.iter().find(|before| before.marker == marker);
        let is_seen = |n: usize| n >= MIN_SAMPLES;
        let after = motion.filter(|motion| {
            let until_s = (motion.until_ns - stamp_ns) as f64 / 1e9;
            is_seen(motion.n) && until_s >= MIN_AFTER_S
        });
        if before.is_none_or(|before| !is_seen(before.n)) || after.is_none() {
            self.unseen.push(marker.to_owned());
        }
        let world = self.bone.as_ref().map_or_else(Isometry3::identity, |bone| bone.isometry().inverse());
        self.after.extend(
            after.map(|motion| MarkerMotion::new(marker, carries, &motion.at_mm.into(), motion).carried(&world)),
        );
        self
    }

    /// While the bone's marker was at this pose in the world.
    #[must_use]
    pub fn on_bone(self, t_world_bone_marker: Option<&Isometry3<f64>>) -> Self {
        let bone = t_world_bone_marker.map(|t| BonePose {
            position_mm: t.translation.vector.into(),
            rotation_xyzw: (t.rotation.coords * 1.0_f64.copysign(t.rotation.w)).into(),
        });
        Self { bone, ..self }
    }

    /// In another frame.
    #[must_use]
    pub fn carried(self, t: &Isometry3<f64>) -> Self {
        let carried = |markers: Vec<MarkerMotion>| markers.into_iter().map(|marker| marker.carried(t)).collect();
        Self { markers: carried(self.markers), after: carried(self.after), ..self }
    }
}
