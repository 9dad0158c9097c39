use super::{
    sifted::PoseStreamParams,
    topics::{Constants, TransformFilter, last_part},
    unstamped::Unstamped,
};
use osteoflow_node::{DeclaredPort, ParamError, schemars::JsonSchema, serde::Deserialize};
use std::collections::BTreeMap;

/// The messages that one port of `acquire.mcap`, `acquire.mcap_live` and `acquire.foxglove_ws` reads; `type` is the payload it gives.
///
/// `geometry/Cloud` from `foxglove.PointCloud` and `sensor_msgs/PointCloud2`; `geometry/Pose` from
/// `foxglove.FrameTransform(s)`, `tf2_msgs/TFMessage`, `geometry_msgs/TransformStamped` and poses in a frame
/// (`foxglove.PoseInFrame`, `geometry_msgs/PoseStamped`); `geometry/Points`, one point at a time, from poses in a frame;
/// `geometry/Image` from `foxglove.RawImage`, `foxglove.CompressedImage` (JPEG, PNG), `sensor_msgs/Image` and `sensor_msgs/CompressedImage` with
/// the `foxglove.CameraCalibration` or `sensor_msgs/CameraInfo` of `calibration`, and with it `geometry/Cloud` from a depth image, too;
/// `geometry/Region` and `report/Flag` from `metadata`, which a bridge sends when it greets, and `present`; a flag that nothing states from
/// `default`.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PortParams {
    /// Its topic.
    pub topic: Option<String>,
    /// Several topics, merged in the order of sensor time; from a bridge, of arrival.
    pub topics: Vec<String>,
    /// Names: one for each of `topics`; with one topic, one for each message in order. Default: the topic's name.
    pub labels: Vec<String>,
    /// Whether the topic may be missing: the port then gives one empty. false: an error, or a warning of a bridge, which may
    /// advertise it later.
    pub optional: bool,
    /// The transforms that the port takes.
    #[serde(flatten)]
    pub transforms: TransformFilter,
    /// When poses are lost.
    #[serde(flatten)]
    pub stream: PoseStreamParams,
    /// The stamp of messages that have none: `refuse`, an error, or `publish_time`. `refuse`: if a pose moves, the time of
    /// publishing pairs them wrongly; if none moves, it is used, with a note.
    pub unstamped: Unstamped,
    /// The metadata record with the region of interest, or with `key`; such as `procedure`.
    pub metadata: Option<String>,
    /// The key of that record whose value `true` sets a flag; another value, or no key, unsets it.
    pub key: Option<String>,
    /// The value of a `report/Flag` that neither `metadata` with `key` nor `present` states. Unset: no; a flag of a bridge
    /// needs one of the three.
    pub default: Option<bool>,
    /// The topic with the calibration of the images' camera: of their size and frame, and the same in all messages. Its
    /// distortion is undone: `plumb_bob`, `rational_polynomial`, `equidistant`.
    pub calibration: Option<String>,
    /// Whether the images are rectified: `P` of the calibration is then their camera, and `D` is not used. Unset: no, and a
    /// topic with `rect` in its name whose calibration has a distortion is an error.
    pub rectified: Option<bool>,
    /// Depth of one step of a depth image. Unset: 1 for integers and 1000 for floats (REP 118 of ROS).
    #[schemars(range(min = 1e-6, max = 1000.0))]
    pub depth_unit_mm: Option<f64>,
    /// A topic; a flag says whether the recording has messages on it, or the bridge advertises it.
    pub present: Option<String>,
}

impl PortParams {
    /// The parameters of a port.
    ///
    /// # Errors
    /// [`ParamError`] if no topic can fill it.
    pub(super) fn of(declared: &DeclaredPort) -> Result<Self, ParamError> {
        let params: Self = declared.params()?;
        let topics = params.topics();
        match declared.payload.name {
            "geometry/Region" | "report/Flag" if !topics.is_empty() => {
                return Err(declared.refused("topic", "no topic states a region or a flag; remove it"));
            }
            "geometry/Region" | "report/Flag" => return Ok(params),
            "geometry/Image" => drop(params.calibration(declared)?),
            "geometry/Cloud" | "geometry/Pose" | "geometry/Points" => {}
            other => {
                let given = "topics give geometry/Cloud, Image, Pose, Points, Region and report/Flag";
                return Err(declared.refused("type", format!("{given}, but not {other}")));
            }
        }
        if topics.is_empty() {
            return Err(declared.refused("topic", "neither topic nor topics is given"));
        }
        if params.stream.lost_after_ms.is_some() && topics.iter().all(|(topic, _)| Constants::are_on(topic)) {
            let message = format!("{} holds for good, so nothing on it is lost; remove lost_after_ms", topics[0].0);
            return Err(declared.refused("lost_after_ms", message));
        }
        Ok(params)
    }

    /// The topic of the camera of images.
    pub(super) fn calibration(&self, declared: &DeclaredPort) -> Result<&str, ParamError> {
        let message =
            "images need calibration, the topic of their camera's foxglove.CameraCalibration or sensor_msgs/CameraInfo";
        self.calibration.as_deref().ok_or_else(|| declared.refused("calibration", message))
    }

    /// Whether no topic of the port has constants.
    pub(super) fn is_timed(declared: &DeclaredPort) -> bool {
        let params = declared.params::<Self>();
        params.is_ok_and(|params| !params.read_topics().iter().any(|topic| Constants::are_on(topic)))
    }

    /// The label of the message of `topic` that comes after `index` others on it.
    pub(super) fn label(&self, topic: &str, index: usize) -> Option<&str> {
        let by_topic = self.topics().into_iter().find(|(named, _)| *named == topic).and_then(|(_, label)| label);
        by_topic.or_else(|| self.labels.get(index).map(String::as_str))
    }

    /// Whether a topic is one of those that the port names.
    pub(super) fn names(&self, topic: &str) -> bool {
        self.topics().iter().any(|(named, _)| *named == topic)
    }

    /// Whether a flag is set, from whether the topic of `present` is there and from a record of metadata.
    pub(super) fn flag(
        &self,
        is_present: impl FnOnce(&str) -> bool,
        record: Option<&BTreeMap<String, String>>,
    ) -> bool {
        if let Some(topic) = &self.present {
            return is_present(topic);
        }
        let value = self.key.as_ref().and_then(|key| record?.get(key));
        value.map_or(self.default.unwrap_or(false), |value| value == "true")
    }

    /// All topics of the port, each with the label of its messages if labels are by topic.
    pub(crate) fn topics(&self) -> Vec<(&str, Option<&str>)> {
        match &self.topic {
            Some(topic) => vec![(topic, None)],
            None => {
                let label = |i: usize| self.labels.get(i).map(String::as_str);
                self.topics.iter().enumerate().map(|(i, topic)| (topic.as_str(), label(i))).collect()
            }
        }
    }

    /// The topics whose messages the port may need: with `/tf`, `/tf_static` beside it.
    pub(super) fn read_topics(&self) -> Vec<String> {
        let mut topics: Vec<String> = self.topics().into_iter().map(|(topic, _)| topic.to_owned()).collect();
        let beside = |topic: &String| (last_part(topic) == "tf").then(|| format!("{topic}_static"));
        let statics: Vec<String> = topics.iter().filter_map(beside).filter(|name| !topics.contains(name)).collect();
        topics.extend(statics);
        topics
    }
}
