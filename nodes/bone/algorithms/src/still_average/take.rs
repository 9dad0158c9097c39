//! How markers moved while something was measured, for what judges it later.

use super::{MarkerPath, StillReport};
use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3};
use osteoflow_geometry::StampNs;
use serde::{Deserialize, Serialize};

/// Fewer samples do not tell motion from noise.
const MIN_SAMPLES: usize = 3;

/// Samples that end earlier after a scan say nothing about the time after it, s.
const MIN_AFTER_S: f64 = 0.1;

/// Of a scan whose time is not known the motion over this time about its stamp is looked at, s: what a hand does to a scan of a second and
/// more, and not how the leg was put there.
const ABOUT_S: f64 = 1.5;

/// A shorter time has too few samples for a velocity, s.
const MIN_TIME_S: f64 = 0.5;

/// When the points of a scan were measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TakeTime {
    /// From the first point to the last, s.
    pub duration_s: f64,
    /// The middle of that time, from the scan's stamp, s; none where it is not known whether it began or ended with the stamp.
    pub middle_s: Option<f64>,
    /// The markers by whose pose at its own time each point was carried: their motion does not shear the scan.
    pub undone: Vec<String>,
}

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
    /// The markers that moved over the time of the scan, by more than noise explains: over all of it, over its first half and over its second
    /// half.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub during: Vec<Vec<MarkerMotion>>,
    /// When the points of a scan were measured, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<TakeTime>,
    /// The markers of which too few samples show whether they moved, before it and after it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unseen: Vec<String>,
    /// Where the bone's marker was in the world, if the bone has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bone: Option<BonePose>,
    /// Where the camera was whose marker carried it, in the frame that it was carried to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<BonePose>,
}

/// A pose of a marker in the world, or of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BonePose {
    /// Its origin, mm.
    pub position_mm: [f64; 3],
    /// Its rotation, a unit quaternion.
    pub rotation_xyzw: [f64; 4],
}

impl BonePose {
    /// The pose of a motion.
    pub fn new(t: &Isometry3<f64>) -> Self {
        Self {
            position_mm: t.translation.vector.into(),
            rotation_xyzw: (t.rotation.coords * 1.0_f64.copysign(t.rotation.w)).into(),
        }
    }

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
    /// How late the poses may be whose stamps look like times of arrival, s.
    #[serde(default, skip_serializing_if = "super::is_zero")]
    pub late_s: f64,
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
            late_s: still.late_s,
        }
    }

    /// In another frame.
    pub(crate) fn carried(mut self, t: &Isometry3<f64>) -> Self {
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
        Self {
            what: what.into(),
            markers: Vec::new(),
            after: Vec::new(),
            during: Vec::new(),
            time: None,
            unseen: Vec::new(),
            bone: None,
            camera: None,
        }
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

    /// With the motion of a marker over the time of the scan, in the frame that the marker's poses lead to. Without a path it is taken to have
    /// moved as before the scan.
    #[must_use]
    pub fn during(mut self, marker: &str, carries: Carries, stamp_ns: StampNs, path: Option<&MarkerPath>) -> Self {
        if self.is_undone(marker) {
            return self;
        }
        let Some(path) = path else {
            let before = self.markers.iter().find(|before| before.marker == marker && before.is_significant()).cloned();
            self.during.resize_with(self.during.len().max(usize::from(before.is_some())), Vec::new);
            self.during.first_mut().into_iter().for_each(|whole| whole.extend(before.clone()));
            return self;
        };
        let (duration_s, middle_s) =
            self.time.as_ref().map_or((ABOUT_S, 0.0), |time| (time.duration_s, time.middle_s.unwrap_or(0.0)));
        let half_s = duration_s.max(MIN_TIME_S) / 2.0;
        let halves =
            [[-half_s, 0.0], [0.0, half_s]].into_iter().filter(|_| self.time.is_some() && half_s >= MIN_TIME_S);
        for (phase, ends_s) in [[-half_s, half_s]].into_iter().chain(halves).enumerate() {
            let [from_ns, to_ns] = ends_s.map(|s| stamp_ns + ((middle_s + s) * 1e9) as StampNs);
            let moved = path.motion(from_ns, to_ns);
            let seen_s = moved.as_ref().map_or(0.0, |moved| moved.span_s);
            if phase == 0 && self.time.is_some() && seen_s < half_s {
                self.unseen.push(marker.to_owned());
            }
            let moved = moved.map(|moved| MarkerMotion::new(marker, carries, &moved.at_mm.into(), &moved));
            if let Some(moved) = moved.filter(MarkerMotion::is_significant) {
                self.during.resize_with(self.during.len().max(phase + 1), Vec::new);
                self.during[phase].push(moved);
            }
        }
        self
    }

    /// Whether each point was carried by the marker's pose at its own time.
    pub fn is_undone(&self, marker: &str) -> bool {
        self.time.as_ref().is_some_and(|time| time.undone.iter().any(|undone| undone == marker))
    }

    /// While the bone's marker was at this pose in the world.
    #[must_use]
    pub fn on_bone(self, t_world_bone_marker: Option<&Isometry3<f64>>) -> Self {
        Self { bone: t_world_bone_marker.map(BonePose::new), ..self }
    }

    /// By a camera at this pose.
    #[must_use]
    pub fn seen_from(self, t_frame_camera: &Isometry3<f64>) -> Self {
        Self { camera: Some(BonePose::new(t_frame_camera)), ..self }
    }

    /// In another frame.
    #[must_use]
    pub fn carried(self, t: &Isometry3<f64>) -> Self {
        let carried = |markers: Vec<MarkerMotion>| markers.into_iter().map(|marker| marker.carried(t)).collect();
        let during = self.during.into_iter().map(carried).collect();
        let camera = self.camera.map(|camera| BonePose::new(&(t * camera.isometry())));
        Self { markers: carried(self.markers), after: carried(self.after), during, camera, ..self }
    }
}
