//! What the messages of a port hold, whether a recording gives them all or a bridge one by one.

use super::{
    topic_params::PortParams,
    topics::{Constants, FrameNames, TransformFilter, last_part},
    unstamped::{MissingStamps, without_publish_time},
};
use osteoflow_formats::{
    LostPose, PoseError, Sign, Spellings,
    mcap_read::Message,
    message_read::{
        Calibration, MessageError, MessageKind, TipRead, is_image, is_sensor_frame, read_calibration, read_cloud,
        read_cloud_head, read_depth, read_image, read_image_head, read_pose_in_frame,
    },
    without_slash,
};
use osteoflow_geometry::{Corrections, Frame, NamedPoint, Nearest, Points, Pose, StampNs};
use osteoflow_node::{DeclaredPort, Emission, ParamError};
use std::{collections::BTreeMap, sync::Arc};

/// What all ports of a source met.
#[derive(Clone, Default)]
pub(super) struct Findings {
    /// The corrections of rotations by topic.
    pub(super) corrections: BTreeMap<String, Corrections>,
    pub(super) frames: FrameNames,
    /// What the user should know.
    pub(super) notes: Vec<String>,
    /// Signs that what comes is wrong.
    pub(super) signs: Vec<Sign>,
    /// The names of its frames.
    pub(super) spellings: Spellings,
    /// Messages without a stamp.
    pub(super) stamps: MissingStamps,
}

impl Findings {
    /// The name of a frame in the graph, if it is another.
    fn renamed(&mut self, frame: &Frame) -> Option<Frame> {
        let plain = self.spellings.take(frame);
        self.frames.of(&plain).or_else(|| (plain != *frame).then_some(plain))
    }

    pub(super) fn rename(&mut self, frames: [&mut Frame; 2]) {
        for frame in frames {
            if let Some(renamed) = self.renamed(frame) {
                *frame = renamed;
            }
        }
    }
}

/// A port that reads topics.
pub(crate) struct TopicPort {
    pub(super) declared: DeclaredPort,
    pub(super) params: PortParams,
    /// The camera of its images, from the first calibration on.
    camera: Option<Arc<Calibration>>,
    /// By topic.
    constants: BTreeMap<String, Constants>,
    n_messages: BTreeMap<String, usize>,
}

/// What a message holds, before the rest of its stream is known.
pub(super) enum Item {
    /// A cloud or an image, and its stamp.
    Scan(StampNs, Scan),
    /// A tracked pose.
    Pose(Nearest<Pose>),
    /// A transform that holds for good.
    Constant(Pose),
    /// A tool that was not seen.
    Lost(LostPose),
    /// A transform whose rotation is none.
    NotRigid(PoseError),
    /// A located point, and the number of messages before it on its topic.
    Tip(usize, TipRead),
}

impl Item {
    /// The frames to and from of a transform.
    pub(super) fn frames_mut(&mut self) -> Option<[&mut Frame; 2]> {
        match self {
            Self::Pose(Nearest { value: Pose { to, from, .. }, .. })
            | Self::Constant(Pose { to, from, .. })
            | Self::Lost(LostPose { to, from, .. })
            | Self::NotRigid(PoseError::NotRigid { to, from, .. }) => Some([to, from]),
            _ => None,
        }
    }
}

impl TopicPort {
    /// # Errors
    /// [`ParamError`] if no topic can fill the port.
    pub(super) fn new(declared: &DeclaredPort) -> Result<Self, ParamError> {
        let (camera, constants, n_messages) = Default::default();
        Ok(Self { declared: declared.clone(), params: PortParams::of(declared)?, camera, constants, n_messages })
    }

    /// Takes the camera of the images from a message.
    ///
    /// # Errors
    /// It is no calibration, or that of another camera.
    pub(super) fn calibrate(&mut self, message: &Message, found: &mut Findings) -> Result<(), String> {
        let read = read_calibration(message, self.params.rectified.unwrap_or(false));
        let read = read.map_err(|error| error.to_string())?;
        match &self.camera {
            Some(first) if **first != read => Err("it differs from the first one, but a port has one camera".into()),
            Some(_) => Ok(()),
            None => {
                found.notes.extend(read.note());
                self.camera = Some(Arc::new(read));
                Ok(())
            }
        }
    }

    /// The topic of the calibration that has to come before a message.
    pub(super) fn lacks_calibration(&self, message: &Message) -> Option<&str> {
        let topic = self.params.calibration.as_deref();
        topic.filter(|_| self.camera.is_none() && self.has_image(&message.schema_name))
    }

    /// Whether the port takes messages of a schema for images.
    pub(super) fn has_image(&self, schema_name: &str) -> bool {
        match self.declared.payload.name {
            "geometry/Image" => true,
            "geometry/Cloud" => is_image(schema_name),
            _ => false,
        }
    }

    /// The items of the next message of `topic`, frames by their names in the graph.
    ///
    /// # Errors
    /// Why it cannot be read.
    pub(super) fn take(&mut self, topic: &str, message: &Message, found: &mut Findings) -> Result<Vec<Item>, String> {
        let n_messages = self.n_messages.entry(topic.into()).or_default();
        let index = *n_messages;
        *n_messages += 1;
        match self.declared.payload.name {
            "geometry/Pose" => {
                let filter = self.params.transforms.clone();
                let mut items = self.transforms(topic, message, &filter, found)?;
                items.iter_mut().filter_map(Item::frames_mut).for_each(|frames| found.rename(frames));
                Ok(items)
            }
            "geometry/Points" => {
                let tip = read_pose_in_frame(without_publish_time(message));
                let mut tip = tip.map_err(|error| error.to_string())?;
                tip.stamp_ns = self.stamp(topic, message, tip.stamp_ns, found);
                Ok(vec![Item::Tip(index, tip)])
            }
            _ => Ok(vec![self.scan((topic, index), message, found)?]),
        }
    }

    /// The stamp of a message, as read from [`without_publish_time`].
    fn stamp(&self, topic: &str, message: &Message, read_ns: StampNs, found: &mut Findings) -> StampNs {
        found.stamps.stamp((&self.declared.name, topic), message, read_ns, self.params.unstamped)
    }

    /// The frames that a port of poses leads to and from, if transforms of this message may have to be joined for it.
    pub(super) fn joins(&self, message: &Message) -> Option<(String, String)> {
        let TransformFilter { parent, child } = &self.params.transforms;
        let is_pose = MessageKind::of(&message.schema_name) == Some(MessageKind::Pose);
        let [parent, child] = [parent, child].map(|name| name.as_deref().map(|name| without_slash(name).to_owned()));
        parent.zip(child).filter(|_| !is_pose)
    }

    /// The transforms of a message that pass a filter, frames by their names in the source.
    pub(super) fn transforms(
        &mut self,
        topic: &str,
        message: &Message,
        filter: &TransformFilter,
        found: &mut Findings,
    ) -> Result<Vec<Item>, String> {
        let is_constant = Constants::are_on(topic);
        let encoded = if is_constant { message.into() } else { without_publish_time(message) };
        let read = filter.poses(topic, encoded, &mut found.spellings).map_err(|error| error.to_string())?;
        let mut items = Vec::new();
        for read in read {
            match read {
                Ok(nearest) if is_constant => {
                    let pose = found.corrections.entry(topic.into()).or_default().take(nearest);
                    let tell = |sign| found.signs.push(("static_changes", format!("topic {topic}: {sign}")));
                    let constants = self.constants.entry(topic.into()).or_default();
                    items.extend(constants.take(pose, tell).map(Item::Constant));
                }
                Err(error) if is_constant => return Err(error.to_string()),
                Ok(mut nearest) => {
                    found.corrections.entry(topic.into()).or_default().add(nearest.correction);
                    nearest.value.stamp_ns = self.stamp(topic, message, nearest.value.stamp_ns, found);
                    found.stamps.track(topic, &nearest.value);
                    items.push(Item::Pose(nearest));
                }
                Err(PoseError::Lost(mut lost)) => {
                    lost.stamp_ns = self.stamp(topic, message, lost.stamp_ns, found);
                    items.push(Item::Lost(lost));
                }
                Err(error @ PoseError::NotRigid { .. }) => items.push(Item::NotRigid(error)),
            }
        }
        Ok(items)
    }

    /// The cloud or image of a message, which is decoded when it is due.
    fn scan(&self, (topic, index): (&str, usize), message: &Message, found: &mut Findings) -> Result<Item, String> {
        let encoded = without_publish_time(message);
        let (frame, stamp_ns, camera) = if self.has_image(&message.schema_name) {
            let camera = self.camera(topic)?;
            let (frame, stamp_ns) = read_image_head(encoded).map_err(|error| error.to_string())?;
            (frame, stamp_ns, Some(camera))
        } else {
            let head = read_cloud_head(encoded).map_err(|error| error.to_string())?;
            found.corrections.entry(topic.into()).or_default().add(head.correction);
            (head.frame, head.stamp_ns, None)
        };
        let stamp_ns = self.stamp(topic, message, stamp_ns, found);
        let scan = Scan {
            message: message.clone(),
            camera,
            is_picture: self.declared.payload.name == "geometry/Image",
            depth_unit_mm: self.params.depth_unit_mm,
            label: self.params.label(topic, index).unwrap_or(last_part(topic)).into(),
            frame: found.renamed(&frame),
        };
        Ok(Item::Scan(stamp_ns, scan))
    }

    /// The camera of the images of `topic`.
    fn camera(&self, topic: &str) -> Result<Arc<Calibration>, String> {
        let named = self.params.calibration(&self.declared).map_err(|error| error.message)?;
        let camera = self.camera.clone().ok_or_else(|| format!("no calibration came on {named}"))?;
        let distortion = camera.intrinsics.distortion.name();
        match (distortion, self.params.rectified) {
            (Some(name), None) if last_part(topic).contains("rect") => Err(format!(
                "it is rectified by its name, and its calibration has a distortion ({name}), which would be undone twice; set rectified = \
                 true if its images are rectified, false if they are not"
            )),
            _ => Ok(camera),
        }
    }

    /// A located point of `topic`, with the label or number of its place.
    pub(super) fn point(&self, topic: &str, index: usize, tip: &TipRead, found: &mut Findings) -> Points {
        let numbered = || format!("{}_{}", last_part(topic), index + 1);
        let name = self.params.label(topic, index).map_or_else(numbered, str::to_owned);
        let mut point = NamedPoint::new(name, tip.position);
        point.stamp_ns = tip.stamp_ns;
        Points::new(found.renamed(&tip.frame).unwrap_or_else(|| tip.frame.clone()), vec![point])
    }
}

/// A cloud or an image that is not decoded yet.
pub(super) struct Scan {
    message: Message,
    /// Of images.
    camera: Option<Arc<Calibration>>,
    /// Whether an image is given as it is, not the cloud of its depths.
    is_picture: bool,
    depth_unit_mm: Option<f64>,
    pub(super) label: Arc<str>,
    /// The name of its frame in the graph, if that is another.
    frame: Option<Frame>,
}

impl Scan {
    /// Decodes it; also gives what the user should know.
    pub(super) fn emission(self) -> Result<(Emission, Vec<String>), MessageError> {
        let Self { message, camera, is_picture, depth_unit_mm, label, frame } = self;
        let read = match camera {
            Some(camera) if is_picture => {
                let mut image = read_image(&message, &camera)?.labelled(label);
                image.frame = frame.unwrap_or(image.frame);
                return Ok((Emission::value(image), Vec::new()));
            }
            Some(camera) => read_depth(&message, &camera, depth_unit_mm)?,
            None => read_cloud(&message)?,
        };
        let dropped = (read.n_dropped > 0).then(|| {
            let (n, all) = (read.n_dropped, read.n_points_in_message);
            format!("{n} of {all} points are NaN or infinite and were left out")
        });
        let mut cloud = read.cloud.labelled(label);
        if let Some(frame) = frame {
            cloud.viewpoint = cloud.viewpoint.filter(|_| is_sensor_frame(frame.as_str()));
            cloud.frame = frame;
        }
        Ok((Emission::value(cloud), dropped.into_iter().chain(read.notes).collect()))
    }
}
