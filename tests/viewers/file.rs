//! A recording as a viewer reads it.

use foxglove::{
    Decode,
    messages::{FrameTransform, PointCloud, Pose, SceneUpdate},
};
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

/// A transform at a time, mm.
#[derive(Debug, Clone)]
pub(crate) struct Edge {
    pub(crate) time_ns: u64,
    pub(crate) topic: String,
    pub(crate) parent: String,
    pub(crate) child: String,
    pub(crate) t_parent_child: Isometry3<f64>,
}

/// A message of a node.
#[derive(Debug, serde::Deserialize)]
pub(crate) struct Log {
    pub(crate) level: i32,
    pub(crate) name: String,
    pub(crate) message: String,
}

struct Message {
    topic: String,
    schema: String,
    time_ns: u64,
    data: Vec<u8>,
}

/// The messages of a file in the order of their log times, and its transforms.
pub(crate) struct File {
    messages: Vec<Message>,
    pub(crate) edges: Vec<Edge>,
}

impl File {
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let stream = mcap::MessageStream::new(&bytes).unwrap();
        let message = |message: mcap::Message<'_>| Message {
            topic: message.channel.topic.clone(),
            schema: message.channel.schema.as_ref().map(|schema| schema.name.clone()).unwrap_or_default(),
            time_ns: message.log_time,
            data: message.data.to_vec(),
        };
        Self::of_messages(stream.map(|m| message(m.unwrap())).collect())
    }

    /// Messages that a viewer has received: topic, schema, time and data.
    pub(crate) fn received(all: impl IntoIterator<Item = (String, String, u64, Vec<u8>)>) -> Self {
        let message = |(topic, schema, time_ns, data)| Message { topic, schema, time_ns, data };
        Self::of_messages(all.into_iter().map(message).collect())
    }

    fn of_messages(mut messages: Vec<Message>) -> Self {
        messages.sort_by_key(|message| message.time_ns);
        let transforms = messages.iter().filter(|message| message.schema == "foxglove.FrameTransform");
        let edges = transforms.map(|message| {
            let t = FrameTransform::decode(&message.data[..]).unwrap();
            let t_parent_child = pose(&Pose { position: t.translation, orientation: t.rotation });
            let (parent, child, topic) = (t.parent_frame_id, t.child_frame_id, message.topic.clone());
            Edge { time_ns: message.time_ns, topic, parent, child, t_parent_child }
        });
        let edges = edges.collect();
        Self { messages, edges }
    }

    /// The first and the last time of a message.
    pub(crate) fn times(&self) -> (u64, u64) {
        (self.messages[0].time_ns, self.messages[self.messages.len() - 1].time_ns)
    }

    /// The messages of a topic in JSON.
    pub(crate) fn json(&self, topic: &str) -> Vec<serde_json::Value> {
        self.of(topic).map(|message| serde_json::from_slice(&message.data).unwrap()).collect()
    }

    /// Where a frame is below the top of its chain, by the newest transform before a time, else by the first of the frame.
    pub(crate) fn t_top(&self, frame: &str, time_ns: u64) -> Isometry3<f64> {
        let (mut t, mut at) = (Isometry3::identity(), frame);
        for _ in 0..=self.edges.len() {
            let of_frame = || self.edges.iter().filter(|edge| edge.child == at);
            let Some(edge) = of_frame().rfind(|edge| edge.time_ns <= time_ns).or_else(|| of_frame().next()) else {
                return t;
            };
            (t, at) = (edge.t_parent_child * t, &edge.parent);
        }
        panic!("{frame} is in a circle")
    }

    fn of<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = &'a Message> {
        self.messages.iter().filter(move |message| message.topic == topic)
    }

    pub(crate) fn topics(&self) -> BTreeSet<String> {
        self.messages.iter().map(|message| message.topic.clone()).collect()
    }

    /// The time of the first message whose schema fits.
    pub(crate) fn first_time(&self, fits: impl Fn(&str) -> bool) -> u64 {
        self.messages.iter().find(|message| fits(&message.schema)).unwrap().time_ns
    }

    pub(crate) fn scenes(&self, topic: &str) -> Vec<(u64, SceneUpdate)> {
        self.of(topic).map(|message| (message.time_ns, SceneUpdate::decode(&message.data[..]).unwrap())).collect()
    }

    /// Time, frame and points in mm of each cloud.
    pub(crate) fn clouds(&self, topic: &str) -> Vec<(u64, String, Vec<Point3<f64>>)> {
        let cloud = |message: &Message| {
            let cloud = PointCloud::decode(&message.data[..]).unwrap();
            let at = |name: &str| cloud.fields.iter().find(|field| field.name == name).unwrap().offset as usize;
            let offsets = ["x", "y", "z"].map(at);
            let points = cloud.data.chunks_exact(cloud.point_stride as usize).map(|row| {
                let metre = |at: usize| f64::from(f32::from_le_bytes(row[at..at + 4].try_into().unwrap()));
                Point3::from(offsets.map(metre)) * 1000.0
            });
            (message.time_ns, cloud.frame_id.clone(), points.collect())
        };
        self.of(topic).map(cloud).collect()
    }

    pub(crate) fn log(&self) -> impl Iterator<Item = Log> {
        self.of("/run/log").map(|message| serde_json::from_slice(&message.data).unwrap())
    }

    /// Where a frame is below the root at a time, by the latest transform of each edge; `None` if that is not known.
    pub(crate) fn t_root(&self, frame: &str, time_ns: u64) -> Option<Isometry3<f64>> {
        let (mut t, mut at) = (Isometry3::identity(), frame);
        for _ in 0..=self.edges.len() {
            let known = self.edges.iter().filter(|edge| edge.child == at && edge.time_ns <= time_ns);
            let Some(edge) = known.max_by_key(|edge| edge.time_ns) else {
                return (at != frame || self.edges.iter().any(|edge| edge.parent == frame)).then_some(t);
            };
            (t, at) = (edge.t_parent_child * t, &edge.parent);
        }
        None
    }

    /// What is wrong with the tree of frames, and which frames that are shown do not hang on it.
    pub(crate) fn faults(&self, root: &str) -> Vec<String> {
        let mut parents: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for edge in &self.edges {
            parents.entry(&edge.child).or_default().insert(&edge.parent);
        }
        let mut faults = Vec::new();
        for (child, parents) in &parents {
            if parents.len() > 1 {
                let names: Vec<_> = parents.iter().copied().collect();
                faults.push(format!("{child} has {} parents: {}", parents.len(), names.join(", ")));
            }
        }
        let end = |frame: &str| {
            let (mut at, mut n) = (frame.to_owned(), 0);
            while let Some(parent) = parents.get(at.as_str()).and_then(|parents| parents.first()) {
                at = (*parent).to_owned();
                n += 1;
                if n > parents.len() {
                    return None;
                }
            }
            Some(at)
        };
        for &frame in parents.keys() {
            match end(frame) {
                Some(end) if end == root => {}
                Some(end) => faults.push(format!("{frame} hangs on {end}, not on {root}")),
                None => faults.push(format!("{frame} is in a circle")),
            }
        }
        let mut shown = BTreeSet::new();
        for message in &self.messages {
            match message.schema.as_str() {
                "foxglove.PointCloud" => drop(shown.insert(PointCloud::decode(&message.data[..]).unwrap().frame_id)),
                "foxglove.SceneUpdate" => {
                    let scene = SceneUpdate::decode(&message.data[..]).unwrap();
                    shown.extend(scene.entities.into_iter().map(|entity| entity.frame_id));
                }
                _ => {}
            }
        }
        let loose = shown.into_iter().filter(|frame| frame != root && !parents.contains_key(frame.as_str()));
        faults.extend(loose.map(|frame| format!("{frame} is shown, but not connected to {root}")));
        faults
    }
}

/// A pose in metres as one in mm.
pub(crate) fn pose(pose: &Pose) -> Isometry3<f64> {
    let (p, q) = (pose.position.as_ref().unwrap(), pose.orientation.as_ref().unwrap());
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
    Isometry3::from_parts(Translation3::from(Vector3::new(p.x, p.y, p.z) * 1000.0), rotation)
}

/// The middle of sorted numbers.
pub(crate) fn median(sorted: &[f64]) -> f64 {
    sorted[sorted.len() / 2]
}
