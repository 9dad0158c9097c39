//! Messages to the payloads of declared ports.

use super::super::frozen::Frozen;
use osteoflow_formats::{
    Space,
    message_read::is_sensor_frame,
    openigtlink::{Affine, Body, Fiducial, Message, PolyData, Position, Text, device_name},
};
use osteoflow_geometry::{
    Cloud, Frame, Mesh, NamedPoint, Points, Pose, Region, StampNs, SurfaceOrigin, TooFar,
    nalgebra::{Isometry3, Point3, Quaternion, Translation3},
    nearest_rotation,
};
use osteoflow_node::{DeclaredPort, Emission, NodeError, schemars::JsonSchema, serde::Deserialize};
use osteoflow_payloads::{Flag, Text as TextPayload};

/// Largest deviation of a rotation that is not reported: single precision leaves 2e-7.
const SINGLE_PRECISION: f64 = 1e-6;
/// A cloud that is smaller than this is probably in metres.
const SMALLEST_CLOUD_MM: f64 = 2.0;

/// The messages that one port of `acquire.openigtlink` reads; `type` is the payload it gives, `frame`, `to` and `from` its
/// frames, which OpenIGTLink does not state.
///
/// `geometry/Pose` from TRANSFORM, POSITION and the tools of TDATA; `geometry/Cloud` from POLYDATA and POINT; `geometry/Mesh`
/// from POLYDATA; `geometry/Points` from POINT and POSITION; `geometry/Region` from a POINT with two corners; `report/Text` from
/// STRING and STATUS; `report/Flag` from the STRING `true` or `false`.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct PortParams {
    /// The device that the port reads. Default for a pose: its frames as PLUS writes them, `CameraMarkerToWorld`.
    pub device: Option<String>,
    /// Several devices, merged in the order of arrival.
    pub devices: Vec<String>,
    /// Names of clouds and points: one for each of `devices`, or, with one device, one for each message in order. Default: the
    /// device's name, or the names in a POINT.
    pub labels: Vec<String>,
    /// The axes of coordinates in the frame `ct`, which are LPS in a graph: `lps` or `ras`. 3D Slicer sends RAS. Required where a
    /// frame is `ct`, refused elsewhere.
    pub space: Option<PatientSpace>,
    /// Time of the sender without the tool, while other messages come, after which a pose is lost and the port gives an empty.
    /// Unset: never.
    #[schemars(range(min = 1.0, max = 3_600_000.0))]
    pub lost_after_ms: Option<f64>,
    /// Time for which poses may be the same to the last bit while their stamps go on; from then on the tracker is frozen, and the
    /// port gives empties with the reason until the pose changes. Unset: 2000, forty samples of a slow tracker, as a marker at rest
    /// jitters by noise. 0: never, for a constant that is sent again and again.
    #[schemars(range(min = 0.0, max = 3_600_000.0))]
    pub frozen_after_ms: Option<f64>,
    /// Whether a pose that is exactly the identity means that the tool is lost, as some trackers send it. Unset: it does; a
    /// constant of a configuration may need false.
    pub identity_is_lost: Option<bool>,
    /// What a `report/Flag` gives with the first item of another port, if its device did not come before. Unset: it waits for its
    /// device.
    pub default: Option<bool>,
    /// The frame of coordinates.
    pub frame: Option<String>,
    /// The frame that a pose leads to.
    pub to: Option<String>,
    /// The frame that a pose leads from.
    pub from: Option<String>,
}

/// Axes of a patient's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub enum PatientSpace {
    /// x to the left, y to posterior.
    Lps,
    /// x to the right, y to anterior.
    Ras,
}

/// A declared port.
pub(super) struct Port {
    pub(super) name: String,
    pub(super) payload: &'static str,
    pub(super) devices: Vec<String>,
    pub(super) lost_after_ns: Option<StampNs>,
    pub(super) default: Option<bool>,
    identity_is_lost: bool,
    frozen: Frozen,
    labels: Vec<String>,
    /// The rotation of coordinates in `ct` to LPS.
    turn: Isometry3<f64>,
    frame: Frame,
    to: Frame,
    from: Frame,
    /// Messages so far.
    n: usize,
}

/// A payload, and what the user should know of it.
pub(super) struct Given {
    pub(super) emission: Emission,
    pub(super) note: Option<String>,
}

impl Port {
    pub(super) fn new(declared: &DeclaredPort) -> Result<Self, NodeError> {
        let name = declared.name.clone();
        let fault = |message: String| NodeError::new(format!("port \"{name}\": {message}"));
        let params: PortParams = declared.params()?;
        let payload = declared.payload.name;
        let needed: &[_] = match payload {
            "geometry/Pose" => &[("to", &params.to), ("from", &params.from)],
            "geometry/Cloud" | "geometry/Points" | "geometry/Mesh" | "geometry/Region" => &[("frame", &params.frame)],
            "report/Text" | "report/Flag" => &[],
            other => {
                return Err(fault(format!(
                    "OpenIGTLink gives geometry/Pose, Cloud, Mesh, Points, Region, report/Text and Flag, but not {other}"
                )));
            }
        };
        if let Some((key, _)) = needed.iter().find(|(_, frame)| frame.is_none()) {
            return Err(fault(format!("{key} is not given, and no message of OpenIGTLink states it")));
        }
        let frame = |name: Option<String>| Frame::from(name.unwrap_or_default());
        let (frame, to, from) = (frame(params.frame), frame(params.to), frame(params.from));
        let is_ct = [&frame, &to, &from].iter().any(|frame| Space::of(frame) == Space::Lps);
        let turn = match (is_ct, params.space) {
            (true, Some(PatientSpace::Ras)) => Isometry3::from_parts(Translation3::identity(), Space::Ras.turn()),
            (true, Some(PatientSpace::Lps)) | (false, None) => Isometry3::identity(),
            (true, None) => {
                return Err(fault(
                    "the frame ct is LPS, and OpenIGTLink does not say its axes; set space = \"ras\", as 3D Slicer \
                                  sends, or \"lps\""
                        .into(),
                ));
            }
            (false, Some(_)) => return Err(fault("space is for coordinates in ct alone; remove it".into())),
        };
        let mut devices = params.devices;
        devices.extend(params.device);
        if devices.is_empty() && payload == "geometry/Pose" {
            devices.push(device_name(to.as_str(), from.as_str()));
        }
        if devices.is_empty() && params.default.is_none() {
            return Err(fault("neither device nor devices is given".into()));
        }
        if let Some(device) = devices.iter().find(|device| device.len() > 20) {
            return Err(fault(format!(
                "device \"{device}\" has {} bytes, and OpenIGTLink sends 20 at most; set device to the name as sent",
                device.len()
            )));
        }
        let swapped = device_name(from.as_str(), to.as_str());
        if payload == "geometry/Pose" && devices.contains(&swapped) {
            return Err(fault(format!(
                "{swapped} takes coordinates to {from}, but the port is to {to}; swap to and from"
            )));
        }
        let lost_after_ns = params.lost_after_ms.map(|ms| (ms * 1e6).round() as StampNs);
        Ok(Self {
            name,
            payload,
            devices,
            lost_after_ns,
            default: params.default,
            identity_is_lost: params.identity_is_lost.unwrap_or(true),
            frozen: Frozen::new(params.frozen_after_ms),
            labels: params.labels,
            turn,
            frame,
            to,
            from,
            n: 0,
        })
    }

    /// What a message of `device` gives; `None` if its type is none that the port reads. `tool` is its index in a TDATA.
    pub(super) fn give(
        &mut self,
        message: &Message,
        device: &str,
        tool: Option<usize>,
        stamp_ns: StampNs,
    ) -> Option<Given> {
        let number = self.n + 1;
        let given = match (self.payload, &message.body) {
            ("geometry/Pose", Body::Transform(affine)) => self.pose(message, device, affine, stamp_ns),
            ("geometry/Pose", Body::Tracking(tools)) => self.pose(message, device, &tools.get(tool?)?.matrix, stamp_ns),
            ("geometry/Pose", Body::Positions(positions)) => self.position(message, device, positions, stamp_ns),
            ("geometry/Cloud", Body::PolyData(data)) => self.cloud(data.points.iter().copied(), device, stamp_ns),
            ("geometry/Cloud", Body::Points(points)) => {
                self.cloud(points.iter().map(|point| point.position), device, stamp_ns)
            }
            ("geometry/Mesh", Body::PolyData(data)) => self.mesh(data),
            ("geometry/Points", Body::Points(points)) => self.points(points, device, stamp_ns),
            ("geometry/Points", Body::Positions(positions)) => {
                let fiducials: Vec<_> = positions.iter().map(|p| Fiducial::new(p.name.as_str(), p.position)).collect();
                self.points(&fiducials, device, stamp_ns)
            }
            ("geometry/Region", Body::Points(points)) => self.region(points),
            ("report/Text", Body::Text(Text(text))) => Ok(Emission::value(TextPayload(text.as_str().into())).into()),
            ("report/Text", Body::Status(status)) => {
                let text = format!("{} {}: {}", status.code, status.name, status.message);
                Ok(Emission::value(TextPayload(text.into())).into())
            }
            ("report/Flag", Body::Text(Text(text))) => match text.trim() {
                "true" => Ok(Emission::value(Flag(true)).into()),
                "false" => Ok(Emission::value(Flag(false)).into()),
                other => Err(format!("\"{other}\" is neither true nor false")),
            },
            _ => return None,
        };
        self.n += 1;
        Some(given.unwrap_or_else(|reason| {
            let reason = format!("{device}, message {number}: {reason}");
            Given { emission: Emission::Empty(reason.clone()), note: Some(reason) }
        }))
    }

    fn pose(&mut self, message: &Message, device: &str, affine: &Affine, stamp_ns: StampNs) -> Result<Given, String> {
        if let Some(lost) = lost(message, device) {
            return Ok(Given { emission: Emission::Empty(format!("{device} is lost: {lost}")), note: None });
        }
        let nearest = affine.rigid().map_err(|error| error.to_string())?;
        let correction = nearest.correction;
        let is_fine = correction.deviation <= SINGLE_PRECISION;
        let note =
            (!is_fine).then(|| format!("{device}: a rotation is rounded, and the nearest one is used: {correction}"));
        Ok(self.placed(nearest.value, device, stamp_ns, note))
    }

    fn position(
        &mut self,
        message: &Message,
        device: &str,
        positions: &[Position],
        stamp_ns: StampNs,
    ) -> Result<Given, String> {
        if let Some(lost) = lost(message, device) {
            return Ok(Given { emission: Emission::Empty(format!("{device} is lost: {lost}")), note: None });
        }
        let [Position { position, quaternion, .. }] = positions else {
            return Err(format!("a pose is one position, and {} came", positions.len()));
        };
        let Some([x, y, z, w]) = quaternion.map(|q| q.map(f64::from)) else {
            return Err("it has no orientation; a pose needs one".into());
        };
        let rotation = nearest_rotation(Quaternion::new(w, x, y, z)).map_err(|error| error.to_string())?;
        let at = near(*position).map_err(|why| format!("the position: {why}"))?;
        let isometry = Isometry3::from_parts(at.coords.into(), rotation.value);
        let correction = rotation.correction;
        let is_fine = correction.deviation <= SINGLE_PRECISION;
        let note =
            (!is_fine).then(|| format!("{device}: a rotation is rounded, and the nearest one is used: {correction}"));
        Ok(self.placed(isometry, device, stamp_ns, note))
    }

    fn placed(&mut self, isometry: Isometry3<f64>, device: &str, stamp_ns: StampNs, note: Option<String>) -> Given {
        if self.identity_is_lost && isometry == Isometry3::identity() {
            let reason =
                format!("{device} is lost: it is the identity; if that is its pose, set identity_is_lost = false");
            return Given { emission: Emission::Empty(reason), note };
        }
        if let Some(frozen) = self.frozen.take(device, &isometry, stamp_ns) {
            let note = frozen.is_first.then(|| frozen.reason.clone()).or(note);
            return Given { emission: Emission::Empty(frozen.reason), note };
        }
        let is_ct = |frame| Space::of(frame) == Space::Lps;
        // The turn by half is its own inverse.
        let isometry = if is_ct(&self.to) { self.turn * isometry } else { isometry };
        let isometry = if is_ct(&self.from) { isometry * self.turn } else { isometry };
        Given { emission: Emission::value(Pose::new(&self.to, &self.from, isometry).at(stamp_ns)), note }
    }

    fn label(&self, device: &str) -> Option<&str> {
        let index = match self.devices.len() {
            1 => self.n,
            _ => self.devices.iter().position(|known| known == device)?,
        };
        self.labels.get(index).map(String::as_str)
    }

    fn cloud(&self, points: impl Iterator<Item = [f32; 3]>, device: &str, stamp_ns: StampNs) -> Result<Given, String> {
        let (mut n_all, mut kept) = (0, Vec::new());
        for point in points {
            n_all += 1;
            kept.extend(finite(point).map(|point| self.turn * point));
        }
        let Some(first) = kept.first() else { return Err(format!("none of {n_all} points is finite")) };
        let n_dropped = n_all - kept.len();
        let mut note = (n_dropped > 0)
            .then(|| format!("{device}: {n_dropped} of {n_all} points are NaN or infinite and were left out"));
        let is_small = kept.iter().all(|point| (point - first).norm() < SMALLEST_CLOUD_MM);
        if n_all > 1 && is_small {
            note = Some(format!("{device}: {n_all} points within {SMALLEST_CLOUD_MM} mm; is the cloud in metres?"));
        }
        let mut cloud = Cloud::new(&self.frame, kept).map_err(|error| error.to_string())?.at(stamp_ns);
        cloud = cloud.labelled(self.label(device).unwrap_or(device));
        if is_sensor_frame(self.frame.as_str()) {
            cloud = cloud.seen_from(Isometry3::identity());
        }
        Ok(Given { emission: Emission::value(cloud), note })
    }

    fn mesh(&self, data: &PolyData) -> Result<Given, String> {
        let vertices: Option<Vec<_>> = data.points.iter().map(|point| finite(*point).map(|p| self.turn * p)).collect();
        let vertices = vertices.ok_or("a vertex is not finite")?;
        let corners =
            |cell: &[u32]| (1..cell.len().saturating_sub(1)).map(|k| [cell[0], cell[k], cell[k + 1]]).collect();
        let faces: Vec<[u32; 3]> = data.polygons.iter().flat_map(|cell| -> Vec<_> { corners(cell) }).collect();
        let mesh = Mesh::new(&self.frame, SurfaceOrigin::User, vertices, faces).map_err(|error| error.to_string())?;
        Ok(Emission::value(mesh).into())
    }

    fn points(&self, fiducials: &[Fiducial], device: &str, stamp_ns: StampNs) -> Result<Given, String> {
        let named = fiducials.iter().enumerate().map(|(k, fiducial)| {
            let position = near(fiducial.position).map_err(|why| format!("point {}: {why}", k + 1))?;
            let own = (!fiducial.name.is_empty()).then_some(fiducial.name.as_str());
            let name = self.label(device).filter(|_| fiducials.len() == 1).or(own).unwrap_or(device);
            let mut point = NamedPoint::new(name, self.turn * position);
            point.stamp_ns = stamp_ns;
            Ok(point)
        });
        let points = named.collect::<Result<Vec<_>, String>>()?;
        if points.is_empty() {
            return Err("it has no points".into());
        }
        Ok(Emission::value(Points::new(&self.frame, points)).into())
    }

    fn region(&self, corners: &[Fiducial]) -> Result<Given, String> {
        let [a, b] = corners else {
            return Err(format!("a region is two opposite corners, and {} points came", corners.len()));
        };
        let corner = |c: &Fiducial| near(c.position).map_err(|why| format!("a corner: {why}"));
        let (a, b) = (self.turn * corner(a)?, self.turn * corner(b)?);
        let (min, max) = (a.inf(&b), a.sup(&b));
        Ok(Emission::value(Region { frame: self.frame.clone(), min, max }).into())
    }
}

impl From<Emission> for Given {
    fn from(emission: Emission) -> Self {
        Self { emission, note: None }
    }
}

/// Why a message says that its tool is lost: the metadata that PLUS writes, `TransformStatus` and `TransformValid`, or
/// `NAMEStatus` for a tool of a TDATA; or `Status`.
fn lost(message: &Message, device: &str) -> Option<String> {
    let of_tool = format!("{device}Status");
    for key in ["TransformStatus", "Status", of_tool.as_str()] {
        if let Some(status) = message.metadata(key).filter(|status| !status.trim().eq_ignore_ascii_case("OK")) {
            return Some(format!("{key} is {status}"));
        }
    }
    let valid = message.metadata("TransformValid")?.trim();
    let is_no = ["false", "0", "no"].iter().any(|no| valid.eq_ignore_ascii_case(no));
    is_no.then(|| format!("TransformValid is {valid}"))
}

/// A usable point.
fn near(point: [f32; 3]) -> Result<Point3<f64>, String> {
    let point = finite(point).ok_or("it is not finite")?;
    TooFar::check(point.coords.as_slice()).map_err(|far| far.to_string())?;
    Ok(point)
}

fn finite(point: [f32; 3]) -> Option<Point3<f64>> {
    point.iter().all(|c| c.is_finite()).then(|| Point3::from(point.map(f64::from)))
}
