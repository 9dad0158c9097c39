//! The kind `acquire.folder`.

use super::{
    playback::{Event, Playback, in_order},
    procedure_ports::{ProcedureEvents, ProcedureOut, ProcedurePort, ProcedurePorts},
    sifted::{PoseStreamParams, Sign, sifted},
};
use osteoflow_formats::{
    LostPose,
    folder::{FolderBody, FolderItem, FolderStreams, ProcedureFolder},
};
use osteoflow_geometry::{Points, Pose};
use osteoflow_node::{
    Context, Describe, Emission, FilePath, NodeError, OutputPorts, Outputs, ParamError, Source, schemars::JsonSchema,
    serde::Deserialize,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

/// The streams of a procedure stored as a folder of files, for setups without a recorder.
///
/// Its `procedure.toml` names the files: PLY scans, laser scans, a table of poses, stylus points. Without a tracker, the
/// camera's frame is the world.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.folder"
path = "procedure"
"#)]
pub struct Folder {
    params: Params,
    playback: Option<Playback<Emission>>,
}

/// Parameters of [`Folder`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// The folder with `procedure.toml`, or that file.
    pub path: FilePath,
    /// When poses are lost, and how a marker moves.
    #[serde(flatten)]
    pub stream: PoseStreamParams,
}

/// An answer on one of the ports of a procedure.
pub struct Out(ProcedureOut);

impl Outputs for Out {
    /// The ports of a procedure, without frames: only the folder says whether clouds are in the camera or in the world.
    fn ports() -> OutputPorts {
        let OutputPorts::Fixed(mut ports) = ProcedurePorts::ports() else { return ProcedurePorts::ports() };
        ports.iter_mut().for_each(|port| port.frames.frame = None);
        OutputPorts::Fixed(ports)
    }

    fn put(self, out: &mut [Emission]) {
        self.0.put(out);
    }
}

impl Source for Folder {
    const KIND: &'static str = "acquire.folder";
    type Params = Params;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, playback: None })
    }

    fn files(&self) -> Vec<PathBuf> {
        ProcedureFolder::open(self.params.path.as_ref()).map_or_else(|_| Vec::new(), |folder| folder.named_files())
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        if self.playback.is_none() {
            self.playback = Some(in_order(self.open(ctx)?));
        }
        let Some(event) = self.playback.as_mut().and_then(Iterator::next) else { return Ok(None) };
        ctx.set_stamp_ns(event.stamp_ns);
        Ok(Some(Out(ProcedureOut::new(event.port, event.body))))
    }
}

impl Folder {
    fn open(&self, ctx: &mut Context) -> Result<Vec<Event<Emission>>, NodeError> {
        let folder = ProcedureFolder::open(self.params.path.as_ref())?;
        let mut streams = folder.streams()?;
        let signs = self.sift(&mut streams.items);
        streams.notes.iter().for_each(|note| ctx.warn(note));
        signs.into_iter().for_each(|(rule, sign)| ctx.sign(rule, sign));
        streams.signs.iter().for_each(|(rule, sign)| ctx.sign(rule, sign));
        let start_ns = streams.items.iter().map(|item| item.stamp_ns).find(|&stamp_ns| stamp_ns != 0).unwrap_or(0);
        let has = |role: &str| streams.items.iter().any(|item| item.role == role);
        let region = folder.region.ok_or("procedure.toml gives no region of interest");
        let mut events = ProcedureEvents::new(start_ns, folder.simulated, has("bone_marker"), region);
        let mut needed =
            vec![(ProcedurePort::BoneMarker, "bone_marker"), (ProcedurePort::PhantomMarkerCad, "phantom_marker_cad")];
        if folder.tracked {
            needed.extend([
                (ProcedurePort::CameraMarker, "camera_marker"),
                (ProcedurePort::PhantomMarker, "phantom_marker"),
            ]);
        }
        for (port, name) in needed {
            if !has(name) {
                let reason = format!("the folder has no poses of {name}; {}", of(&streams));
                events.add(port, start_ns, Emission::Empty(reason));
            }
        }
        for port in ProcedurePort::OF_EXPERIMENTS {
            events.add(port, start_ns, Emission::Empty("a folder has no such stream".into()));
        }
        events.0.extend(streams.items.into_iter().filter_map(event));
        Ok(events.0)
    }
}

impl Folder {
    /// Takes out the poses that are no measurements, or says why they are not.
    fn sift(&self, items: &mut Vec<FolderItem>) -> Vec<Sign> {
        let mut roles: BTreeMap<String, Vec<Pose>> = BTreeMap::new();
        items.retain(|item| match &item.body {
            FolderBody::Pose(Ok(pose)) => {
                roles.entry(item.role.clone()).or_default().push(pose.clone());
                false
            }
            _ => true,
        });
        let mut signs = Vec::new();
        for (role, poses) in roles {
            let (poses, more) = sifted(poses, &self.params.stream);
            signs.extend(more);
            items.extend(poses.into_iter().map(|(pose, reason)| {
                let stamp_ns = pose.stamp_ns;
                let body = FolderBody::Pose(match reason {
                    None => Ok(pose),
                    Some(reason) => {
                        let reason = format!("no new pose: {reason}");
                        Err(LostPose { to: pose.to, from: pose.from, stamp_ns, reason })
                    }
                });
                FolderItem { role: role.clone(), stamp_ns, body }
            }));
        }
        items.sort_by_key(|item| item.stamp_ns);
        signs
    }
}

/// The poses that the folder has, in words.
fn of(streams: &FolderStreams) -> String {
    let poses = streams.items.iter().filter_map(|item| match &item.body {
        FolderBody::Pose(Ok(pose)) => Some(format!("{} -> {}", pose.to, pose.from)),
        FolderBody::Pose(Err(lost)) => Some(format!("{} -> {}", lost.to, lost.from)),
        _ => None,
    });
    let poses: BTreeSet<String> = poses.collect();
    match poses.len() {
        0 => "it has none at all".into(),
        _ => format!("it has those of {}", poses.into_iter().collect::<Vec<_>>().join(", ")),
    }
}

/// The item on the port of its role; `None` if there is no such port.
fn event(item: FolderItem) -> Option<Event<Emission>> {
    let name = match item.role.as_str() {
        "init" => "stylus_init",
        "assessment" => "stylus_assessment",
        "palpation" => "stylus_palpation",
        other => other,
    };
    let OutputPorts::Fixed(ports) = ProcedurePorts::ports() else { return None };
    let port = ports.iter().position(|p| p.name == name)?;
    let body = match item.body {
        FolderBody::Cloud(cloud) => Emission::value(cloud),
        FolderBody::Pose(Ok(pose)) => Emission::value(pose),
        FolderBody::Pose(Err(lost)) => Emission::Empty(lost.to_string()),
        FolderBody::Tip(frame, point) => Emission::value(Points::new(frame, vec![point])),
    };
    Some(Event { stamp_ns: item.stamp_ns, port, body })
}
