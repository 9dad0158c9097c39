//! The kind `send.openigtlink`.

mod outlet;

use crate::{
    acquire::{network::Role, openigtlink::is_host_port},
    output::NoOutputs,
};
use osteoflow_algorithms::trust::{Answer, Verdict};
use osteoflow_formats::{
    Space,
    openigtlink::{
        Affine, Body, Cells, EncodeError, Fiducial, Message, Metadata, PolyData, Status, device_name, device_word,
    },
};
use osteoflow_geometry::{
    Frame, PlanePlace, Planes, Points, Pose, StampNs,
    nalgebra::{Isometry3, Point3, Translation3},
};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, ParamError, params, schemars::JsonSchema, serde::Deserialize,
};
use outlet::{Outlet, Task, status};
use std::time::Duration;

/// The registration, the planes, the laser points and the stylus tip over OpenIGTLink, for 3D Slicer and SlicerIGT.
///
/// Planes and registration are sent only while the verdict is trusted, and unknown planes never; a STATUS says why. Coordinates
/// in `ct` are turned to RAS, and their frame is called `Ras`; other frames are sent as they are. A run without a folder, such
/// as a replay, sends nothing. docs/use/openigtlink.md lists the devices and states.
#[derive(Describe)]
#[describe(example = r#"
kind = "send.openigtlink"
in   = { planes = "planes.planes", registration = "planes_at_scan.t_ct_world", points = "laser_points.points", verdict = "verdict.verdict" }
address = "127.0.0.1:18945"
"#)]
pub struct OpenIgtLink {
    params: Params,
    outlet: Option<Outlet>,
    /// The stamp of the planes that were sent last.
    sent_ns: Option<StampNs>,
    /// What is sent once.
    said: Said,
}

/// The last of what is sent when it changes.
#[derive(Default)]
struct Said {
    status: Option<(u16, String)>,
    registration: Option<Pose>,
    points: Option<Points>,
    n_dropped: u64,
}

/// Parameters of [`OpenIgtLink`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Where receivers connect, or the receiver. 127.0.0.1:18945: beside the port of a PLUS server.
    #[param("127.0.0.1:18945")]
    pub address: String,
    /// `server` listens for receivers; `client` connects to one, and again when it is lost. `server`: 3D Slicer is a client,
    /// and there may be several.
    #[param(Role::Server)]
    pub role: Role,
    /// Largest rate of planes and tip, by their stamps. 20: a tracker's, and enough for a screen.
    #[param(20.0, 0.1..=1000.0)]
    pub rate_hz: f64,
    /// Whether planes and registration of a doubtful verdict are sent, too. false: a STATUS says why not. Those of a refused
    /// one never are.
    pub send_doubtful: bool,
    /// Edge of the square that shows each plane as a POLYDATA. 60: wider than a fibula; 0: transforms alone.
    #[param(60.0, 0.0..=1000.0)]
    pub plane_size_mm: f64,
    /// Time of this machine without new planes after which a STATUS calls those shown old. 1: twenty samples of a tracker.
    #[param(1.0, 0.1..=3600.0)]
    pub stale_after_s: f64,
}

/// Inputs of [`OpenIgtLink`].
#[derive(Inputs)]
pub struct In {
    /// The planes as they move; each sample fires the node.
    planes: Option<Planes>,
    /// The registration, such as `t_ct_world`.
    #[port(join = "once")]
    registration: Option<Pose>,
    /// Points that do not move, such as those under the laser.
    #[port(join = "once")]
    points: Option<Points>,
    /// The tip of the stylus: a list of one point.
    #[port(join = "latest")]
    tip: Option<Points>,
    /// The verdict on the registration. Without one neither planes nor registration are sent.
    #[port(join = "once")]
    verdict: Option<Verdict>,
}

impl Node for OpenIgtLink {
    const KIND: &'static str = "send.openigtlink";
    type Params = Params;
    type Inputs = In;
    type Outputs = NoOutputs;

    fn new(params: Params) -> Result<Self, ParamError> {
        if !is_host_port(&params.address) {
            let message = format!("\"{}\" is not HOST:PORT, such as 127.0.0.1:18945", params.address);
            return Err(ParamError::new("address", message));
        }
        Ok(Self { params, outlet: None, sent_ns: None, said: Said::default() })
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        if ctx.out_dir().is_none() {
            return Ok(NoOutputs {});
        }
        if self.outlet.is_none() {
            self.outlet = Some(Outlet::open(self.params.role, &self.params.address).map_err(NodeError::new)?);
        }
        let (stamp_ns, lost) = (ctx.stamp_ns(), ctx.absent_reason("planes").map(str::to_owned));
        for task in self.tasks(i, stamp_ns, lost.as_deref())? {
            if let Some(outlet) = &mut self.outlet {
                outlet.put(task);
            }
        }
        let n_dropped = self.outlet.as_ref().map_or(0, |outlet| outlet.n_dropped);
        if n_dropped > 0 && self.said.n_dropped == 0 {
            self.said.n_dropped = n_dropped;
            ctx.warn("planes come faster than they can be sent; some are not sent");
        }
        Ok(NoOutputs {})
    }
}

impl OpenIgtLink {
    /// What is to be sent at a firing.
    fn tasks(&mut self, i: In, stamp_ns: StampNs, lost: Option<&str>) -> Result<Vec<Task>, NodeError> {
        let period_ns = 1e9 / self.params.rate_hz;
        // Samples of a tracker at that rate jitter a little.
        let is_due = self.sent_ns.is_none_or(|sent| (stamp_ns - sent) as f64 > 0.9 * period_ns || stamp_ns < sent);
        let mut tasks = Vec::new();
        let withheld = withheld(i.verdict.as_ref(), self.params.send_doubtful);
        let may_send = |frame: &Frame| withheld.is_none() || Space::of(frame) != Space::Lps;
        if let Some(points) = i.points.filter(|points| may_send(&points.frame))
            && self.said.points.as_ref() != Some(&points)
        {
            tasks.push(Task::Send { message: fiducials("Points", &points, points.stamp_ns)?, lasts: true });
            self.said.points = Some(points);
        }
        if let Some(tip) = i.tip.filter(|tip| is_due && may_send(&tip.frame)) {
            tasks.push(Task::Send { message: fiducials("StylusTip", &tip, tip.stamp_ns)?, lasts: false });
            self.sent_ns = Some(stamp_ns);
        }
        let (code, name, why) = match (&withheld, &i.planes) {
            (Some((code, name, why)), _) => (*code, *name, why.clone()),
            (None, None) => (Status::NOT_READY, "no planes", lost.unwrap_or("no planes came").to_owned()),
            (None, Some(planes)) => match unknown(planes) {
                Some(why) => (Status::NOT_READY, "planes unknown", why),
                None => (Status::OK, "planes sent", sentence(i.verdict.as_ref())),
            },
        };
        let is_sent = withheld.is_none();
        if let Some(registration) = i.registration.filter(|_| is_sent)
            && self.said.registration.as_ref() != Some(&registration)
        {
            let message = transform(&registration, i.verdict.as_ref())?;
            tasks.push(Task::Send { message, lasts: true });
            self.said.registration = Some(registration);
        }
        match &i.planes {
            Some(planes) if code == Status::OK => {
                if is_due {
                    for message in self.planes(planes, i.verdict.as_ref())? {
                        tasks.push(Task::Send { message, lasts: false });
                    }
                    self.sent_ns = Some(stamp_ns);
                    tasks.push(Task::Fresh(Duration::from_secs_f64(self.params.stale_after_s)));
                }
            }
            _ => tasks.push(Task::Withheld),
        }
        if self.said.status.as_ref().is_none_or(|(c, w)| (*c, w) != (code, &why)) {
            tasks.push(Task::Send { message: status(code, name, &why), lasts: true });
            self.said.status = Some((code, why));
        }
        Ok(tasks)
    }

    fn planes(&self, planes: &Planes, verdict: Option<&Verdict>) -> Result<Vec<Message>, NodeError> {
        let mut messages = Vec::new();
        for plane in &*planes.planes {
            let Some(t_frame_plane) = plane.isometry() else { continue };
            let name = Frame::from(plane.name.clone());
            let pose = Pose::new(&planes.frame, &name, *t_frame_plane).at(planes.stamp_ns);
            messages.push(transform(&pose, verdict)?);
            if self.params.plane_size_mm > 0.0 {
                messages.push(square(&pose, self.params.plane_size_mm)?);
            }
        }
        Ok(messages)
    }
}

/// Why neither planes nor registration are sent: code, name and sentence of the STATUS.
fn withheld(verdict: Option<&Verdict>, send_doubtful: bool) -> Option<(u16, &'static str, String)> {
    let verdict = match verdict {
        None => return Some((Status::NOT_READY, "no verdict", "there is no verdict on the registration".into())),
        Some(verdict) => verdict,
    };
    match verdict.answer {
        Answer::Trusted => None,
        Answer::Doubtful if send_doubtful => None,
        Answer::Doubtful => {
            Some((Status::DISABLED, "doubtful", format!("the registration is doubtful: {}", verdict.sentence)))
        }
        Answer::Refused => {
            Some((Status::DISABLED, "refused", format!("the registration is refused: {}", verdict.sentence)))
        }
    }
}

fn sentence(verdict: Option<&Verdict>) -> String {
    verdict.map(|verdict| format!("{}: {}", verdict.answer.name(), verdict.sentence)).unwrap_or_default()
}

/// Why planes are unknown, if any is.
fn unknown(planes: &Planes) -> Option<String> {
    let mut reasons = planes.planes.iter().filter_map(|plane| match &plane.place {
        PlanePlace::Unknown(reason) => Some(format!("{}: {reason}", plane.name)),
        PlanePlace::Known(_) => None,
    });
    reasons.next().or_else(|| planes.planes.is_empty().then(|| "there are no planes".into()))
}

/// The rotation of coordinates in `frame` to those that are sent, and their name: RAS for `ct`.
fn sent_frame(frame: &Frame) -> (Isometry3<f64>, Frame) {
    match Space::of(frame) {
        Space::Lps => (Isometry3::from_parts(Translation3::identity(), Space::Ras.turn()), "ras".into()),
        _ => (Isometry3::identity(), frame.clone()),
    }
}

/// A pose as PLUS sends it.
fn transform(pose: &Pose, verdict: Option<&Verdict>) -> Result<Message, NodeError> {
    let ((turn_to, to), (turn_from, from)) = (sent_frame(&pose.to), sent_frame(&pose.from));
    let isometry = turn_to * pose.isometry * turn_from.inverse();
    let mut metadata = vec![Metadata::new("TransformValid", "True"), Metadata::new("TransformStatus", "OK")];
    metadata.extend(verdict.map(|verdict| Metadata::new("Verdict", verdict.answer.name())));
    let message =
        Message::new(device_name(to.as_str(), from.as_str()), pose.stamp_ns, Body::Transform(Affine::of(&isometry)));
    checked(message.extended(0, metadata))
}

/// A plane as a square about its origin.
fn square(pose: &Pose, size_mm: f64) -> Result<Message, NodeError> {
    let (turn, to) = sent_frame(&pose.to);
    let half = size_mm / 2.0;
    let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
    let points = corners.map(|(x, y)| single(&(turn * pose.isometry * Point3::new(x, y, 0.0)))).into();
    let polygons = Cells::new([[0, 1, 2, 3]]);
    let data = PolyData { points, polygons, ..PolyData::default() };
    let metadata = vec![Metadata::new("Frame", to.as_str())];
    let name = device_word(pose.from.as_str());
    checked(Message::new(name, pose.stamp_ns, Body::PolyData(data)).extended(0, metadata))
}

fn fiducials(device: &str, points: &Points, stamp_ns: StampNs) -> Result<Message, NodeError> {
    let (turn, frame) = sent_frame(&points.frame);
    let fiducials = points.points.iter().map(|p| Fiducial::new(&*p.name, single(&(turn * p.position)))).collect();
    let metadata = vec![Metadata::new("Frame", frame.as_str())];
    checked(Message::new(device, stamp_ns, Body::Points(fiducials)).extended(0, metadata))
}

/// The message, if it can be sent.
fn checked(message: Message) -> Result<Message, NodeError> {
    let error = |error: EncodeError| NodeError::new(format!("{}: {error}; use a shorter name", message.device));
    message.to_bytes().map_err(error)?;
    Ok(message)
}

fn single(point: &Point3<f64>) -> [f32; 3] {
    [0, 1, 2].map(|k| point[k] as f32)
}

#[cfg(test)]
mod tests;
