//! The kind `acquire.poses`.

use super::{
    playback::{Event, Playback, in_order, silences},
    sifted::{self, PoseStreamParams, Sifted, Sign, sifted},
    topics::{FrameNames, TransformFilter},
};
use osteoflow_formats::{
    pose_log::{Columns, LogFormat, LogOptions, read_log},
    probe::{Kind, probe},
    without_slash,
};
use osteoflow_geometry::{Corrections, Frame, Pose, StampNs, TransformTree};
use osteoflow_node::{
    Context, Declared, DeclaredPort, Describe, Emission, FilePath, NodeError, ParamError, Source, params,
    schemars::JsonSchema, serde::Deserialize,
};
use std::collections::BTreeMap;

/// The poses of a tracker's log in the order of their stamps: `.igs.mha` of PLUS, TUM, EuRoC, KITTI, NDI, Atracsys, motion
/// capture and tables.
///
/// Each entry of `out` is a port with `type = "geometry/Pose"`, its frames, and `parent` and `child` where the log has several
/// transforms. A tool that was not seen gives an empty that says why: a status other than `OK`, missing numbers, an all-zero
/// quaternion. docs/use/formats.md has the units and senses of the formats.
#[derive(Describe)]
#[describe(example = r#"
kind = "acquire.poses"
path = "pivot.igs.mha"
frames = { Tracker = "world", Stylus = "stylus_marker" }
out.stylus = { type = "geometry/Pose", parent = "Tracker", child = "Stylus", to = "world", from = "stylus_marker" }
"#)]
pub struct Poses {
    params: Params,
    playback: Option<Playback<Emission>>,
}

/// Parameters of [`Poses`].
#[params(path)]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// The log.
    pub path: FilePath,
    /// The format; `poses` is `t_ns,parent,child,..`. Unset: recognised by the content.
    pub format: Option<LogFormat>,
    /// Millimetres in the log's unit. Unset: 1000 for TUM, EuRoC and KITTI, the stated one for motion capture, 1 for the
    /// others.
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub unit_mm: Option<f64>,
    /// The frame that the poses lead to, in TUM, EuRoC and KITTI, which name none.
    pub parent: Option<String>,
    /// The frame that moves, in the same formats.
    pub child: Option<String>,
    /// Poses per second, for KITTI, which has no stamps, and tables that count frames.
    #[schemars(range(min = 1e-3, max = 1e6))]
    pub rate_hz: Option<f64>,
    /// The `times.txt` of a KITTI trajectory: a stamp in seconds for each pose.
    pub times: Option<FilePath>,
    /// What is in the columns of a table.
    pub columns: Option<Columns>,
    /// Added to all stamps: the offset of the tracker's clock from that of other sources. 0: one clock.
    #[param(0.0, -1e10..=1e10)]
    pub stamp_offset_s: f64,
    /// Frames with another name in the graph, such as `{ Tracker = "world" }`.
    pub frames: BTreeMap<String, String>,
}

/// A port of [`Poses`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PortParams {
    /// The transform that the port takes, by the names of the log.
    #[serde(flatten)]
    pub transforms: TransformFilter,
    /// When the tool is lost.
    #[serde(flatten)]
    pub stream: PoseStreamParams,
}

impl PortParams {
    /// The parameters of a port.
    ///
    /// # Errors
    /// [`ParamError`] if no log can fill it.
    fn of(declared: &DeclaredPort) -> Result<Self, ParamError> {
        match declared.payload.name {
            "geometry/Pose" => declared.params(),
            other => Err(declared.refused("type", format!("a log gives geometry/Pose, but not {other}"))),
        }
    }
}

impl Source for Poses {
    const KIND: &'static str = "acquire.poses";
    type Params = Params;
    type Outputs = Declared<PortParams>;

    fn new(params: Params) -> Result<Self, ParamError> {
        let described = params.columns.as_ref().map_or(Ok(()), |columns| columns.check(params.rate_hz));
        described.map_err(|(key, message)| ParamError::new(format!("columns.{key}"), message))?;
        Ok(Self { params, playback: None })
    }

    fn check_ports(ports: &[DeclaredPort]) -> Result<(), ParamError> {
        ports.iter().try_for_each(|port| PortParams::of(port).map(drop))
    }

    fn is_timed(&self, _port: &DeclaredPort) -> bool {
        let Params { path, format, columns, .. } = &self.params;
        let by_columns = columns.as_ref().map(|_| LogFormat::Table);
        let found = || match probe(path.as_ref()).ok()?.kind {
            Kind::Poses(format) => Some(format),
            _ => None,
        };
        format.or(by_columns).or_else(found).is_some_and(|format| format != LogFormat::Poses)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        if self.playback.is_none() {
            self.playback = Some(in_order(self.open(ctx)?));
        }
        let Some(event) = self.playback.as_mut().and_then(Iterator::next) else { return Ok(None) };
        ctx.set_stamp_ns(event.stamp_ns);
        Ok(Some(Declared::one(event.port, event.body)))
    }
}

impl Poses {
    fn open(&self, ctx: &mut Context) -> Result<Vec<Event<Emission>>, NodeError> {
        let Params { path, format, unit_mm, parent, child, rate_hz, times, columns, stamp_offset_s, frames } =
            &self.params;
        let options = LogOptions {
            format: *format,
            unit_mm: *unit_mm,
            parent: parent.clone(),
            child: child.clone(),
            rate_hz: *rate_hz,
            times: times.as_ref().map(|times| times.as_ref().into()),
            columns: columns.clone(),
        };
        let log = read_log(path.as_ref(), &options)?;
        let name = path.as_ref().display().to_string();
        let offset_ns = (stamp_offset_s * 1e9).round() as StampNs;
        // The stamp of a constant stays.
        let shift = |stamp_ns: StampNs| if stamp_ns == 0 { 0 } else { stamp_ns.saturating_add(offset_ns) };
        let (mut streams, mut corrections): (BTreeMap<_, Stream>, _) = (BTreeMap::new(), Corrections::default());
        for read in log.poses {
            match read {
                Ok(pose) => {
                    let mut pose = corrections.take(pose);
                    pose.stamp_ns = shift(pose.stamp_ns);
                    let stream = streams.entry((pose.to.clone(), pose.from.clone())).or_default();
                    stream.poses.push(pose);
                }
                Err(mut lost) => {
                    lost.stamp_ns = shift(lost.stamp_ns);
                    let stream = streams.entry((lost.to.clone(), lost.from.clone())).or_default();
                    stream.lost.push((lost.stamp_ns, lost.to_string()));
                }
            }
        }
        let mut notes: Vec<String> = log.notes.into_iter().chain(corrections.note()).collect();
        let mut signs = Vec::new();
        let (mut events, mut frames) = (Vec::new(), FrameNames::new(frames));
        // A table that is described has poses that no port reads, and one list of names.
        streams.keys().for_each(|(to, from)| drop([frames.of(to), frames.of(from)]));
        for (port, declared) in ctx.declared().iter().enumerate() {
            let port_log = PortLog { declared, params: PortParams::of(declared)?, streams: &streams };
            let read = port_log.events(&mut frames, &mut notes, &mut signs);
            let read =
                read.map_err(|message| NodeError::new(format!("{name}: port \"{}\": {message}", declared.name)))?;
            events.extend(read.into_iter().map(|(stamp_ns, body)| Event { stamp_ns, port, body }));
        }
        notes.into_iter().for_each(|note| ctx.warn(format!("{name}: {note}")));
        signs.into_iter().chain(log.signs).for_each(|(rule, sign)| ctx.sign(rule, format!("{name}: {sign}")));
        let named = |NodeError { message }| NodeError::new(format!("{name}: {message}"));
        frames.check_met("pose").map(|()| events).map_err(named)
    }
}

/// The poses of one tool, and when it was not seen, with the reason.
#[derive(Default)]
struct Stream {
    poses: Vec<Pose>,
    lost: Vec<(StampNs, String)>,
}

/// A port over a log.
struct PortLog<'a> {
    declared: &'a DeclaredPort,
    params: PortParams,
    streams: &'a BTreeMap<(Frame, Frame), Stream>,
}

impl PortLog<'_> {
    /// What the port gives, in no order.
    fn events(
        &self,
        frames: &mut FrameNames,
        notes: &mut Vec<String>,
        signs: &mut Vec<Sign>,
    ) -> Result<Vec<(StampNs, Emission)>, String> {
        let TransformFilter { parent, child } = &self.params.transforms;
        let found: Vec<_> =
            self.streams.iter().filter(|((to, from), _)| self.params.transforms.wants(to, from)).collect();
        let (poses, lost) = match (&found[..], parent, child) {
            ([(_, stream)], ..) => {
                let (poses, more) = sifted(stream.poses.clone(), &self.params.stream);
                signs.extend(more);
                (poses, stream.lost.clone())
            }
            ([], Some(parent), Some(child)) => (self.chained(parent, child, notes, signs)?, Vec::new()),
            _ => {
                let wanted = [child, parent].map(|name| name.as_deref().unwrap_or("any"));
                let there = if found.is_empty() { "there are" } else { "several fit" };
                let pairs: Vec<_> = self.streams.keys().map(|(to, from)| format!("{from} -> {to}")).collect();
                return Err(format!(
                    "{} -> {}: {there} {}; set child and parent",
                    wanted[0],
                    wanted[1],
                    pairs.join(", ")
                ));
            }
        };
        let stamps: Vec<StampNs> =
            poses.iter().map(|(pose, _)| pose.stamp_ns).chain(lost.iter().map(|(stamp, _)| *stamp)).collect();
        let emission = |(mut pose, reason): Sifted| {
            frames.rename([&mut pose.to, &mut pose.from]);
            sifted::emission((pose, reason))
        };
        let mut events: Vec<_> = poses.into_iter().map(emission).collect();
        events.extend(lost.into_iter().map(|(stamp, reason)| (stamp, Emission::Empty(reason))));
        if let Some(lost_after_ms) = self.params.stream.lost_after_ms {
            let all = self
                .streams
                .values()
                .flat_map(|of| sifted::last_ns(&of.poses).into_iter().chain(of.lost.iter().map(|l| l.0)));
            let end_ns = all.max().unwrap_or(0);
            events.extend(silences(
                &stamps,
                (lost_after_ms * 1e6) as StampNs,
                end_ns,
                &format!("the {}", self.declared.name),
            ));
        }
        Ok(events)
    }

    /// The poses between two frames that several transforms join, or an inverse.
    fn chained(
        &self,
        parent: &str,
        child: &str,
        notes: &mut Vec<String>,
        signs: &mut Vec<Sign>,
    ) -> Result<Vec<Sifted>, String> {
        let (parent, child) = (without_slash(parent), without_slash(child));
        let mut tree = TransformTree::default();
        for ((to, from), stream) in self.streams {
            let (poses, more) = sifted(stream.poses.clone(), &self.params.stream);
            signs.extend(more);
            poses.iter().for_each(|pose| sifted::add(&mut tree, pose));
            for (stamp_ns, reason) in &stream.lost {
                tree.add(to, from, *stamp_ns, Err(format!("has no pose: {reason}")));
            }
        }
        match sifted::through(&tree, (parent, child), self.params.stream.max_gap_ms)? {
            Some((poses, joined)) => {
                notes.push(format!("port \"{}\": {}", self.declared.name, joined.note));
                Ok(poses)
            }
            None => Err(format!("no transforms lead from {child} to {parent}; there are {}", tree.pairs().join(", "))),
        }
    }
}
