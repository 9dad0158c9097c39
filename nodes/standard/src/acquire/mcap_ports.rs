use osteoflow_node::{schemars::JsonSchema, serde::Deserialize};

/// What one port of `acquire.mcap` and `acquire.mcap_live` takes from the recording; `type` says what it makes of it.
///
/// `geometry/Cloud` from `foxglove.PointCloud`; `geometry/Pose` from `foxglove.FrameTransform(s)` and
/// `foxglove.PoseInFrame`; `geometry/Points`, one point at a time, from `foxglove.PoseInFrame`; `geometry/Region` and
/// `report/Flag` from `metadata` and `present`.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct PortParams {
    /// The topic whose messages the port gives.
    pub topic: Option<String>,
    /// Several topics, given as one stream in the order of sensor time.
    pub topics: Vec<String>,
    /// Names: one for each of `topics`, or, with one topic, one for each message in order. Default: the topic's name.
    pub labels: Vec<String>,
    /// Whether a recording without the topic is taken; the port then gives one empty. false: what is named is needed.
    pub optional: bool,
    /// Only transforms with this parent frame, where a topic carries several.
    pub parent: Option<String>,
    /// Only transforms with this child frame; for `foxglove.PoseInFrame`, the name of the frame that moves.
    pub child: Option<String>,
    /// Silence after which a tracked marker counts as lost and the port gives an empty. Unset: silence says nothing.
    #[schemars(range(min = 1.0, max = 3_600_000.0))]
    pub lost_after_ms: Option<f64>,
    /// The metadata record that holds the region of interest, or the key named by `key`; such as `procedure`.
    pub metadata: Option<String>,
    /// The key of the metadata record that says yes by `true`; a record without it says no.
    pub key: Option<String>,
    /// A topic: the port says whether the recording has messages on it.
    pub present: Option<String>,
}

impl PortParams {
    /// All topics of the port, with the label that their messages get, if it is by topic.
    pub(crate) fn topics(&self) -> Vec<(&str, Option<&str>)> {
        match &self.topic {
            Some(topic) => vec![(topic, None)],
            None => {
                let label = |i: usize| self.labels.get(i).map(String::as_str);
                self.topics.iter().enumerate().map(|(i, topic)| (topic.as_str(), label(i))).collect()
            }
        }
    }
}
