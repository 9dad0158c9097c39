//! A recording that was opened for viewers: where its messages are, and their bytes.

use osteoflow_container::{Damage, Location, MESSAGE_HEADER_BYTES, ReadError, Reader, Record, Visitor, damage_message};
use osteoflow_engine::run::ListenedChannel;
use std::{collections::BTreeMap, fs::File, io, ops::ControlFlow, path::Path, sync::Arc};

/// A message in the file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Entry {
    pub(crate) log_time_ns: u64,
    pub(crate) channel: u16,
    /// Of its record.
    location: Location,
    n_bytes: u64,
}

/// A recording with the places of its messages, in the order of their times.
pub(crate) struct IndexedRecording {
    pub(crate) messages: Messages,
    pub(crate) entries: Vec<Entry>,
    pub(crate) channels: BTreeMap<u16, ListenedChannel>,
    /// What is wrong with the file, if it is damaged.
    pub(crate) problem: Option<String>,
}

impl IndexedRecording {
    /// Reads where the messages are. What is damaged is left out.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be read at all.
    pub(crate) fn open(path: &Path) -> Result<Self, ReadError> {
        let mut input = Reader::open(path)?;
        let mut index = Index::default();
        let end = input.read(&mut index)?;
        let problem = damage_message(&index.damages, &end);
        let Index { mut entries, channels, .. } = index;
        // Stable: messages of one time stay in the order of the file.
        entries.sort_by_key(|entry| entry.log_time_ns);
        Ok(Self { messages: Messages { input, chunk: None }, entries, channels, problem })
    }
}

/// The index of the last message of each channel.
pub(crate) fn last_of_each(entries: &[Entry]) -> BTreeMap<u16, usize> {
    entries.iter().enumerate().map(|(at, entry)| (entry.channel, at)).collect()
}

/// Reads the bytes of messages.
pub(crate) struct Messages {
    input: Reader<File>,
    /// The unpacked chunk of the last message.
    chunk: Option<(u64, Vec<u8>)>,
}

impl Messages {
    /// The data of a message.
    pub(crate) fn data(&mut self, entry: Entry) -> io::Result<Vec<u8>> {
        let head = MESSAGE_HEADER_BYTES;
        match entry.location.in_chunk {
            None => {
                let at = entry.location.offset + head;
                self.input.bytes_at(at, entry.n_bytes)
            }
            Some(at) => {
                let offset = entry.location.offset;
                if self.chunk.as_ref().is_none_or(|(known, _)| *known != offset) {
                    self.chunk = Some((offset, self.input.chunk_at(offset)?));
                }
                let records = self.chunk.as_ref().map_or(&[][..], |(_, records)| records);
                let start = usize::try_from(at + head).map_err(io::Error::other)?;
                let bytes = records.get(start..).and_then(|rest| rest.get(..entry.n_bytes as usize));
                Ok(bytes.ok_or_else(|| io::Error::other("the file has changed"))?.to_vec())
            }
        }
    }
}

/// Where the messages are.
#[derive(Default)]
struct Index {
    entries: Vec<Entry>,
    schemas: BTreeMap<u16, (String, String, Arc<[u8]>)>,
    channels: BTreeMap<u16, ListenedChannel>,
    damages: Vec<Damage>,
}

impl Visitor for Index {
    fn record(&mut self, location: Location, record: Record<'_>) -> ControlFlow<()> {
        match record {
            Record::Schema { id, name, encoding, data } => {
                self.schemas.insert(id, (name.into(), encoding.into(), data.into()));
            }
            Record::Channel(channel) => {
                let none = || (String::new(), String::new(), [].into());
                let (schema_name, schema_encoding, schema) =
                    self.schemas.get(&channel.schema_id).cloned().unwrap_or_else(none);
                self.channels.insert(
                    channel.id,
                    ListenedChannel {
                        id: channel.id,
                        topic: channel.topic,
                        encoding: channel.message_encoding,
                        schema_name,
                        schema_encoding,
                        schema,
                        metadata: channel.metadata,
                    },
                );
            }
            Record::Message(message) => self.entries.push(Entry {
                log_time_ns: message.log_time,
                channel: message.channel_id,
                location,
                n_bytes: message.data.len() as u64,
            }),
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        self.damages.push(damage);
        ControlFlow::Continue(())
    }
}
