//! MCAP recordings of any writer: every chunk compression, with or without an index, whole or damaged.
//!
//! A recording is read once, from front to back, so a truncated file gives the messages before the cut, and a damaged one
//! those before and after the damage. Messages are slices of their unpacked chunks; [`Recording::open_topics`] leaves out
//! topics that are not wanted.
//!
//! ```no_run
//! use osteoflow_formats::{message_read::read_cloud, mcap_read::Recording};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let recording = Recording::open("procedure.mcap".as_ref(), false)?;
//! for message in recording.messages("/camera/scan") {
//!     let scan = read_cloud(message)?;
//!     assert_eq!(scan.cloud.len() + scan.n_dropped, scan.n_points_in_message);
//! }
//! # Ok(())
//! # }
//! ```

mod bag;
mod error;
mod pass;

pub use error::McapError;

use crate::{FileError, input};
use bag::Bag;
use bytes::Bytes;
use osteoflow_container::Reader;
use osteoflow_geometry::StampNs;
use pass::Pass;
use std::{collections::BTreeMap, io::Cursor, path::Path, sync::Arc};

/// What a recording holds, read to its end.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    /// Metadata records by name; a name written twice is merged, the later value of a key stands.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Attached files, in file order.
    pub attachments: Vec<Attachment>,
    /// What is missing or odd, one sentence each; empty for a whole and consistent file.
    pub notes: Vec<String>,
    /// When the last message of the file was sent, on any topic, kept or not; none of a file without messages.
    pub last_publish_time_ns: Option<StampNs>,
    topics: Vec<Topic>,
    messages: BTreeMap<String, Vec<Message>>,
}

/// One topic of a recording in one encoding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// The topic's name, such as `/camera/scan`.
    pub name: String,
    /// The schema's name, such as `foxglove.PointCloud`; empty for a channel without a schema.
    pub schema_name: String,
    /// How the schema is written: `protobuf`, `jsonschema`, `ros2msg` ...
    pub schema_encoding: String,
    /// How the messages are written: `protobuf`, `json`, `cdr` ...
    pub message_encoding: String,
    /// How many messages the file holds, whether they were kept or not.
    pub n_messages: usize,
}

/// One message as it was recorded. A cheap handle.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// When the recorder wrote it.
    pub log_time_ns: StampNs,
    /// When its sender sent it.
    pub publish_time_ns: StampNs,
    /// The sender's count.
    pub sequence: u32,
    /// The schema's name, such as `foxglove.PointCloud`.
    pub schema_name: Arc<str>,
    /// How `data` is written: `protobuf`, `json` ...
    pub message_encoding: Arc<str>,
    /// The message itself: a slice of its chunk.
    pub data: Bytes,
}

/// A file that travels in a recording, such as the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Attachment {
    /// Its file name.
    pub name: String,
    /// Its media type, such as `application/json`.
    pub media_type: String,
    /// Its bytes.
    pub data: Bytes,
}

impl Recording {
    /// Reads a recording with all its messages: a file, or the folder of a ROS 2 bag, whose recordings are joined in the
    /// order of its `metadata.yaml`.
    ///
    /// With `allow_truncated`, the intact records of a damaged file are used, and [`Recording::notes`] says what is
    /// missing: a damaged chunk is left out whole, reading resumes at the next intact record, a cut ends the recording.
    /// Without it, any damage is an error. CRCs of chunks, attachments, the data section and the summary are checked where
    /// the writer stored them. `O(bytes)`.
    ///
    /// # Errors
    /// [`McapError`], naming the file, the byte and what was found there. An empty file, or one that is not an MCAP at
    /// all, is an error with `allow_truncated` too.
    pub fn open(path: &Path, allow_truncated: bool) -> Result<Self, McapError> {
        Self::open_topics(path, allow_truncated, |_| true)
    }

    /// As [`Recording::open`], but keeps only the messages of topics that `keep` wants; the others are counted.
    ///
    /// # Errors
    /// As [`Recording::open`].
    pub fn open_topics(path: &Path, allow_truncated: bool, keep: impl Fn(&str) -> bool) -> Result<Self, McapError> {
        if path.is_dir() {
            return Self::open_bag(path, allow_truncated, &keep);
        }
        let name = path.display().to_string();
        input::check(path)?;
        let reader = Reader::open(path).map_err(FileError::read(path))?;
        Pass::new(&name, allow_truncated, &keep).read(reader)
    }

    fn open_bag(folder: &Path, allow_truncated: bool, keep: &dyn Fn(&str) -> bool) -> Result<Self, McapError> {
        let Bag { files, n_messages, notes } = Bag::open(folder)?;
        let mut joined = Self { notes, ..Self::default() };
        for file in &files {
            joined.append(Self::open_topics(file, allow_truncated, keep)?);
        }
        let n_read: usize = joined.topics.iter().map(|topic| topic.n_messages).sum();
        if let Some(n) = n_messages.filter(|&n| n != n_read) {
            let folder = folder.display();
            joined.notes.push(format!("{folder}: metadata.yaml counts {n} messages, but its recordings hold {n_read}"));
        }
        Ok(joined)
    }

    /// Adds what another part of the same recording holds.
    fn append(&mut self, part: Self) {
        for (name, entries) in part.metadata {
            self.metadata.entry(name).or_default().extend(entries);
        }
        self.attachments.extend(part.attachments);
        self.notes.extend(part.notes);
        self.last_publish_time_ns = self.last_publish_time_ns.max(part.last_publish_time_ns);
        for topic in part.topics {
            self.add_topic(topic);
        }
        for (name, messages) in part.messages {
            self.messages.entry(name).or_default().extend(messages);
        }
    }

    /// Counts the messages of a topic, which may be known.
    fn add_topic(&mut self, topic: Topic) {
        let same = self.topics.iter_mut().find(|t| {
            (&t.name, &t.schema_name, &t.message_encoding) == (&topic.name, &topic.schema_name, &topic.message_encoding)
        });
        match same {
            Some(known) => known.n_messages += topic.n_messages,
            None => self.topics.push(topic),
        }
    }

    /// As [`Recording::open`], for a file already in memory; `name` stands for the path in errors.
    ///
    /// # Errors
    /// As [`Recording::open`].
    pub fn from_bytes(name: &str, bytes: &[u8], allow_truncated: bool) -> Result<Self, McapError> {
        let reader = Reader::new(Cursor::new(bytes), bytes.len() as u64);
        Pass::new(name, allow_truncated, &|_| true).read(reader)
    }

    /// The topics, in the order in which the file first describes them; one whose channels differ in schema or encoding
    /// appears once for each.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// The messages of a topic in file order, whatever their channel; none for a topic that is not there.
    pub fn messages(&self, topic: &str) -> &[Message] {
        self.messages.get(topic).map_or(&[], Vec::as_slice)
    }

    /// The first attachment of that name.
    pub fn attachment(&self, name: &str) -> Option<&Attachment> {
        self.attachments.iter().find(|a| a.name == name)
    }
}
