//! Messages to the payloads of declared ports.

use super::images::{Camera, Refusal, camera_of};
use crate::acquire::network::{Port, PortItems, StreamParams};
use osteoflow_formats::{
    Space,
    message_read::is_sensor_frame,
    openigtlink::{Affine, Body, Fiducial, Message, PolyData, Position, device_name},
};
use osteoflow_geometry::{
    Cloud, Frame, Mesh, NamedPoint, Nearest, Points, Pose, Region, StampNs, SurfaceOrigin, TooFar,
    nalgebra::{Isometry3, Point3, Quaternion, Translation3},
    nearest_rotation,
};
use osteoflow_node::{DeclaredPort, ParamError, schemars::JsonSchema, serde::Deserialize};
use osteoflow_payloads::{Flag, Text as TextPayload};

/// Largest deviation of a rotation that is not reported: single precision leaves 2e-7.
const SINGLE_PRECISION: f64 = 1e-6;
/// A cloud that is smaller than this is probably in metres.
const SMALLEST_CLOUD_MM: f64 = 2.0;

/// The messages that one port of `acquire.openigtlink` reads; `type` is the payload it gives, `frame`, `to` and `from` its
/// frames, which OpenIGTLink does not state.
///
/// `geometry/Pose` from TRANSFORM, POSITION and the tools of TDATA; `geometry/Cloud` from IMAGE (three components of floating point,
/// which are coordinates, or one of depth), POLYDATA and POINT; `geometry/Image` from IMAGE of 8 bits; `geometry/Mesh` from POLYDATA; `geometry/Points` from POINT and POSITION; `geometry/Region` from a POINT with two corners; `report/Text` from
/// STRING and STATUS; `report/Flag` from the STRING `true` or `false`.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PortParams {
    /// Its device. Default for a pose: its frames as PLUS writes them, `CameraMarkerToWorld`.
    pub device: Option<String>,
    /// Several devices, merged in the order of arrival.
    pub devices: Vec<String>,
    /// The axes of coordinates in the frame `ct`: `lps`, as in a graph, or `ras`, as 3D Slicer sends. Required if a frame is
    /// `ct`, refused elsewhere.
    pub space: Option<PatientSpace>,
    /// Whether a pose that is exactly the identity means that the tool is lost, as some trackers send it. Unset: yes; a
    /// constant may need false.
    pub identity_is_lost: Option<bool>,
    /// The camera of a depth image or a picture, which PLUS does not send: fx, fy, cx, cy, px; (0, 0) is the centre of the top
    /// left pixel. Not for a point image.
    pub intrinsics: Vec<f64>,
    /// Coefficients of that camera's distortion, in OpenCV's order; it is undone. Empty: none.
    pub distortion: Vec<f64>,
    /// Their model: `plumb_bob` (k1, k2, p1, p2, k3), `rational_polynomial` (and k4, k5, k6), `equidistant` (a fisheye: k1, k2,
    /// k3, k4). Unset: `plumb_bob`.
    pub distortion_model: Option<String>,
    /// Depth of one step of a depth image: 0.1 for Revopoint, 1 for Kinect and RealSense by default. Required for depth.
    #[schemars(range(min = 1e-6, max = 1000.0))]
    pub depth_unit_mm: Option<f64>,
    /// Whether the matrix of an IMAGE moves the points of its pixels. false: a point image and the rays of a camera are in the
    /// camera's coordinates, and PLUS sends spacings or a pose of the image in the matrix.
    pub use_matrix: bool,
    /// The frame of coordinates.
    pub frame: Option<String>,
    /// The frame that a pose leads to.
    pub to: Option<String>,
    /// The frame that a pose leads from.
    pub from: Option<String>,
    /// What a port of every source over a network has.
    #[serde(flatten)]
    pub stream: StreamParams,
}

/// Axes of a patient's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PatientSpace {
    /// x to the left, y to posterior.
    Lps,
    /// x to the right, y to anterior.
    Ras,
}

/// What this protocol knows of a port.
pub(crate) struct Content {
    identity_is_lost: bool,
    /// The rotation of coordinates in `ct` to LPS.
    turn: Isometry3<f64>,
    pub(super) frame: Frame,
    to: Frame,
    from: Frame,
    pub(super) camera: Camera,
}

/// The payloads of ports that read a type of message.
pub(super) fn payloads_of(type_name: &str) -> &'static [&'static str] {
    match type_name {
        "TRANSFORM" | "TDATA" => &["geometry/Pose"],
        "POSITION" => &["geometry/Pose", "geometry/Points"],
        "POINT" => &["geometry/Points", "geometry/Cloud", "geometry/Region"],
        "POLYDATA" => &["geometry/Cloud", "geometry/Mesh"],
        "IMAGE" => &["geometry/Cloud", "geometry/Image"],
        "STRING" => &["report/Text", "report/Flag"],
        "STATUS" => &["report/Text"],
        _ => &[],
    }
}

impl Content {
    /// The port that a graph declares.
    ///
    /// # Errors
    /// [`ParamError`] if no message can fill it.
    pub(super) fn port(declared: &DeclaredPort) -> Result<Port<Self>, ParamError> {
        let fault = |key: &str, message: String| Err(declared.refused(key, message));
        let params: PortParams = declared.params()?;
        let payload = declared.payload.name;
        let needed: &[_] = match payload {
            "geometry/Pose" => &[("to", &params.to), ("from", &params.from)],
            "geometry/Cloud" | "geometry/Points" | "geometry/Mesh" | "geometry/Region" | "geometry/Image" => {
                &[("frame", &params.frame)]
            }
            "report/Text" | "report/Flag" => &[],
            other => {
                let message = "OpenIGTLink gives geometry/Pose, Cloud, Image, Mesh, Points, Region, report/Text and Flag, but not";
                return fault("type", format!("{message} {other}"));
            }
        };
        if let Some((key, _)) = needed.iter().find(|(_, frame)| frame.is_none()) {
            return fault(key, format!("{key} is not given, and no message of OpenIGTLink states it"));
        }
        let camera = Self::camera(declared, &params)?;
        let [frame, to, from] =
            [params.frame, params.to, params.from].map(|name| Frame::from(name.unwrap_or_default()));
        let is_ct = [&frame, &to, &from].iter().any(|frame| Space::of(frame) == Space::Lps);
        let turn = match (is_ct, params.space) {
            (true, Some(PatientSpace::Ras)) => Isometry3::from_parts(Translation3::identity(), Space::Ras.turn()),
            (true, Some(PatientSpace::Lps)) | (false, None) => Isometry3::identity(),
            (true, None) => {
                let message = "the frame ct is LPS, and OpenIGTLink does not say its axes; set space = \"ras\", as 3D Slicer sends, \
                               or \"lps\"";
                return fault("space", message.into());
            }
            (false, Some(_)) => return fault("space", "space is for coordinates in ct alone; remove it".into()),
        };
        let mut devices = params.devices;
        devices.extend(params.device);
        if devices.is_empty() && payload == "geometry/Pose" {
            devices.push(device_name(to.as_str(), from.as_str()));
        }
        if devices.is_empty() && params.stream.default.is_none() {
            return fault("device", "neither device nor devices is given".into());
        }
        if let Some(device) = devices.iter().find(|device| device.len() > 20) {
            let n = device.len();
            let sent = "bytes, and OpenIGTLink sends 20 at most; set device to the name as sent";
            return fault("device", format!("device \"{device}\" has {n} {sent}"));
        }
        let swapped = device_name(from.as_str(), to.as_str());
        if payload == "geometry/Pose" && devices.contains(&swapped) {
            let message = format!("{swapped} takes coordinates to {from}, but the port is to {to}; swap to and from");
            return fault("to", message);
        }
        let identity_is_lost = params.identity_is_lost.unwrap_or(true);
        Ok(Port::new(declared, params.stream, devices, Self { identity_is_lost, turn, frame, to, from, camera }))
    }

    /// The camera of a port's images.
    fn camera(declared: &DeclaredPort, params: &PortParams) -> Result<Camera, ParamError> {
        let (payload, &PortParams { depth_unit_mm, use_matrix, .. }) = (declared.payload.name, params);
        let model = params.distortion_model.as_deref();
        let intrinsics = camera_of(&params.intrinsics, model, &params.distortion);
        let intrinsics = intrinsics.map_err(|(key, message)| declared.refused(key, message))?;
        if payload == "geometry/Image" && intrinsics.is_none() {
            let message = "intrinsics are not given, and no IMAGE has them; set intrinsics = [fx, fy, cx, cy] in pixels of the image as \
                           sent";
            return Err(declared.refused("intrinsics", message));
        }
        let given = [
            ("intrinsics", intrinsics.is_some() && payload != "geometry/Image"),
            ("depth_unit_mm", depth_unit_mm.is_some()),
            ("use_matrix", use_matrix),
        ];
        if let Some((key, _)) = given.iter().find(|(_, is_given)| *is_given && payload != "geometry/Cloud") {
            let message = format!(
                "intrinsics, depth_unit_mm and use_matrix are for images, and the port is of {payload}; remove them"
            );
            return Err(declared.refused(key, message));
        }
        if depth_unit_mm.is_some_and(|unit_mm| !(unit_mm.is_finite() && unit_mm > 0.0)) {
            return Err(declared.refused("depth_unit_mm", "depth_unit_mm is not a positive length"));
        }
        Ok(Camera { intrinsics, depth_unit_mm, use_matrix, ..Camera::default() })
    }
}

impl Port<Content> {
    /// The items of a message of `device`; `None` if its type is none that the port reads. `tool` is the matrix of a tool of a
    /// TDATA.
    pub(super) fn read(
        &mut self,
        message: &Message,
        device: &str,
        tool: Option<&Affine>,
        stamp_ns: StampNs,
    ) -> Option<PortItems> {
        let rigid = |affine: &Affine| affine.rigid().map_err(|error| error.to_string());
        let items = match (self.payload, &message.body) {
            ("geometry/Pose", Body::Transform(affine)) => self.pose(message, device, stamp_ns, rigid(affine)),
            ("geometry/Pose", Body::Tracking(_)) => self.pose(message, device, stamp_ns, rigid(tool?)),
            ("geometry/Pose", Body::Positions(positions)) => self.pose(message, device, stamp_ns, position(positions)),
            ("geometry/Cloud", Body::PolyData(data)) => self.cloud(data.points.iter().copied(), device, stamp_ns),
            ("geometry/Cloud", Body::Points(points)) => {
                self.cloud(points.iter().map(|point| point.position), device, stamp_ns)
            }
            ("geometry/Cloud" | "geometry/Image", Body::Image(image)) => {
                let is_picture = self.payload == "geometry/Image";
                let read = if is_picture { Self::picture } else { Self::image_cloud };
                match read(self, image, device, stamp_ns) {
                    Err(Refusal::Graph(fault)) => {
                        return Some(PortItems::fault(format!("port \"{}\": {fault}", self.name)));
                    }
                    Err(Refusal::Message(reason)) => Err(reason),
                    Ok(items) => Ok(items),
                }
            }
            ("geometry/Mesh", Body::PolyData(data)) => self.mesh(data, stamp_ns),
            ("geometry/Points", Body::Points(points)) => self.points(points, device, stamp_ns),
            ("geometry/Points", Body::Positions(positions)) => {
                let fiducials: Vec<_> = positions.iter().map(|p| Fiducial::new(p.name.as_str(), p.position)).collect();
                self.points(&fiducials, device, stamp_ns)
            }
            ("geometry/Region", Body::Points(points)) => self.region(points, stamp_ns),
            ("report/Text", Body::Text(text)) => Ok(PortItems::value(stamp_ns, TextPayload(text.as_str().into()))),
            ("report/Text", Body::Status(status)) => {
                let text = format!("{} {}: {}", status.code, status.name, status.message);
                Ok(PortItems::value(stamp_ns, TextPayload(text.into())))
            }
            ("report/Flag", Body::Text(text)) => match text.trim() {
                "true" => Ok(PortItems::value(stamp_ns, Flag(true))),
                "false" => Ok(PortItems::value(stamp_ns, Flag(false))),
                other => Err(format!("\"{other}\" is neither true nor false")),
            },
            _ => return None,
        };
        let number = self.n_messages + 1;
        let refused = |reason| PortItems::refused(stamp_ns, format!("{device}, message {number}: {reason}"));
        Some(items.unwrap_or_else(refused))
    }

    fn pose(
        &mut self,
        message: &Message,
        device: &str,
        stamp_ns: StampNs,
        rigid: Result<Nearest<Isometry3<f64>>, String>,
    ) -> Result<PortItems, String> {
        if let Some(lost) = lost(message, device) {
            return Ok(PortItems::empty(stamp_ns, format!("{device} is lost: {lost}")));
        }
        let Nearest { value: isometry, correction } = rigid?;
        let Content { identity_is_lost, turn, to, from, .. } = &self.content;
        if *identity_is_lost && isometry == Isometry3::identity() {
            let remedy = "if that is its pose, set identity_is_lost = false";
            return Ok(PortItems::empty(stamp_ns, format!("{device} is lost: it is the identity; {remedy}")));
        }
        let is_ct = |frame| Space::of(frame) == Space::Lps;
        // The turn by half is its own inverse.
        let isometry = if is_ct(to) { turn * isometry } else { isometry };
        let isometry = if is_ct(from) { isometry * turn } else { isometry };
        let (pose, mut out) = (Pose::new(to, from, isometry).at(stamp_ns), PortItems::default());
        // A time of arrival is no stamp that two messages share by intent.
        if message.stamp_ns == 0 || !self.is_repeat(device, &pose, &mut out) {
            self.put_pose(device, pose, correction, SINGLE_PRECISION, &mut out);
        }
        Ok(out)
    }

    fn cloud(
        &self,
        points: impl Iterator<Item = [f32; 3]>,
        device: &str,
        stamp_ns: StampNs,
    ) -> Result<PortItems, String> {
        let (mut n_all, mut kept) = (0, Vec::new());
        for point in points {
            n_all += 1;
            kept.extend(finite(point.map(f64::from)));
        }
        if kept.is_empty() {
            return Err(format!("none of {n_all} points is finite"));
        }
        let n_dropped = n_all - kept.len();
        let mut out = self.cloud_of(kept, n_all, device, stamp_ns)?;
        if n_dropped > 0 && out.notes.is_empty() {
            out.notes.push(format!("{device}: {n_dropped} of {n_all} points are NaN or infinite and were left out"));
        }
        Ok(out)
    }

    /// The cloud of the points that were left of `n_all`.
    pub(super) fn cloud_of(
        &self,
        mut kept: Vec<Point3<f64>>,
        n_all: usize,
        device: &str,
        stamp_ns: StampNs,
    ) -> Result<PortItems, String> {
        let Content { turn, frame, .. } = &self.content;
        kept.iter_mut().for_each(|point| *point = turn * *point);
        let Some(first) = kept.first() else { return Err(format!("none of {n_all} points is left")) };
        let mut note = None;
        let is_small = kept.iter().all(|point| (point - first).norm() < SMALLEST_CLOUD_MM);
        if n_all > 1 && is_small {
            note = Some(format!("{device}: {n_all} points within {SMALLEST_CLOUD_MM} mm; is the cloud in metres?"));
        }
        let mut cloud = Cloud::new(frame, kept).map_err(|error| error.to_string())?.at(stamp_ns);
        cloud = cloud.labelled(self.label(device).unwrap_or(device));
        if is_sensor_frame(frame.as_str()) {
            cloud = cloud.seen_from(Isometry3::identity());
        }
        Ok(PortItems { notes: note.into_iter().collect(), ..PortItems::value(stamp_ns, cloud) })
    }

    fn mesh(&self, data: &PolyData, stamp_ns: StampNs) -> Result<PortItems, String> {
        let turned = |point: &[f32; 3]| finite(point.map(f64::from)).map(|p| self.content.turn * p);
        let vertices: Option<Vec<_>> = data.points.iter().map(turned).collect();
        let vertices = vertices.ok_or("a vertex is not finite")?;
        let corners =
            |cell: &[u32]| (1..cell.len().saturating_sub(1)).map(|k| [cell[0], cell[k], cell[k + 1]]).collect();
        let faces: Vec<[u32; 3]> = data.polygons.iter().flat_map(|cell| -> Vec<_> { corners(cell) }).collect();
        let mesh = Mesh::new(&self.content.frame, SurfaceOrigin::User, vertices, faces);
        Ok(PortItems::value(stamp_ns, mesh.map_err(|error| error.to_string())?))
    }

    fn points(&self, fiducials: &[Fiducial], device: &str, stamp_ns: StampNs) -> Result<PortItems, String> {
        let named = fiducials.iter().enumerate().map(|(k, fiducial)| {
            let position = near(fiducial.position).map_err(|why| format!("point {}: {why}", k + 1))?;
            let own = (!fiducial.name.is_empty()).then_some(fiducial.name.as_str());
            let name = self.label(device).filter(|_| fiducials.len() == 1).or(own).unwrap_or(device);
            let mut point = NamedPoint::new(name, self.content.turn * position);
            point.stamp_ns = stamp_ns;
            Ok(point)
        });
        let points = named.collect::<Result<Vec<_>, String>>()?;
        if points.is_empty() {
            return Err("it has no points".into());
        }
        Ok(PortItems::value(stamp_ns, Points::new(&self.content.frame, points)))
    }

    fn region(&self, corners: &[Fiducial], stamp_ns: StampNs) -> Result<PortItems, String> {
        let [a, b] = corners else {
            return Err(format!("a region is two opposite corners, and {} points came", corners.len()));
        };
        let Content { turn, frame, .. } = &self.content;
        let corner = |c: &Fiducial| near(c.position).map(|at| turn * at).map_err(|why| format!("a corner: {why}"));
        let (a, b) = (corner(a)?, corner(b)?);
        Ok(PortItems::value(stamp_ns, Region { frame: frame.clone(), min: a.inf(&b), max: a.sup(&b) }))
    }
}

/// The pose of a POSITION.
fn position(positions: &[Position]) -> Result<Nearest<Isometry3<f64>>, String> {
    let [Position { position, quaternion, .. }] = positions else {
        return Err(format!("a pose is one position, and {} came", positions.len()));
    };
    let Some([x, y, z, w]) = quaternion.map(|q| q.map(f64::from)) else {
        return Err("it has no orientation; a pose needs one".into());
    };
    let rotation = nearest_rotation(Quaternion::new(w, x, y, z)).map_err(|error| error.to_string())?;
    let at = near(*position).map_err(|why| format!("the position: {why}"))?;
    Ok(rotation.map(|rotation| Isometry3::from_parts(at.coords.into(), rotation)))
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
    let point = finite(point.map(f64::from)).ok_or("it is not finite")?;
    TooFar::check(point.coords.as_slice()).map_err(|far| far.to_string())?;
    Ok(point)
}

pub(super) fn finite(point: [f64; 3]) -> Option<Point3<f64>> {
    point.iter().all(|c| c.is_finite()).then(|| Point3::from(point))
}
