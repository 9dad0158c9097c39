use super::findings::{Finding, Findings};
use osteoflow_container::{Channel, ChunkHeader, ChunkIndex, Location, MESSAGE_HEADER_BYTES, Record, Statistics};
use std::collections::BTreeMap;

/// One sentence of these findings; `None` if there are none.
pub(crate) fn summary_of(findings: &[Finding]) -> Option<String> {
    let first = findings.first()?;
    let more = match findings.len() {
        1 => String::new(),
        n => format!(", and {} more findings", n - 1),
    };
    Some(format!("the file is not sound: {first}{more}; `osteoflow validate` lists them"))
}

/// Checks of the MCAP format: descriptions before use, and correct indexes, counts and CRCs.
#[derive(Default)]
pub(crate) struct Container {
    header: bool,
    schemas: BTreeMap<u16, (String, String)>,
    channels: BTreeMap<u16, Channel>,
    n_by_channel: BTreeMap<u16, u64>,
    n_attachments: u32,
    n_metadata: u32,
    chunks: BTreeMap<u64, ChunkHeader>,
    /// Offset of the chunk whose records are being read.
    open: Option<u64>,
    /// Earliest and latest log time of its messages, and their number by channel.
    times: Option<(u64, u64)>,
    n_in_chunk: BTreeMap<u16, u64>,
    /// Number of messages by channel in the message indexes of the current chunk.
    indexed: BTreeMap<u16, u64>,
    damaged: bool,
    /// Offset of the record that ends the data.
    data_end: Option<u64>,
    footer: Option<(u64, u64)>,
    /// Offset of the last record.
    last: u64,
    statistics: Option<Statistics>,
    /// Names of the metadata records, by offset.
    metadata: BTreeMap<u64, String>,
    n_chunk_indexes: u64,
}

impl Container {
    pub(crate) fn n_messages(&self) -> u64 {
        self.n_by_channel.values().chain(self.n_in_chunk.values()).sum()
    }

    pub(crate) fn n_chunks(&self) -> u64 {
        self.chunks.len() as u64
    }

    pub(crate) fn damage(&mut self) {
        self.damaged = true;
        self.open = None;
    }

    pub(crate) fn record(&mut self, place: Location, record: &Record<'_>, findings: &mut Findings) {
        if place.offset < self.last && !self.damaged {
            let what = "a channel is used here that only the summary describes";
            findings.add("description", Finding::new(place, what));
        }
        self.last = place.offset;
        if place.in_chunk.is_none() {
            self.top_level(place, record, findings);
        }
        let mut wrong = |what: String| findings.add("description", Finding::new(place, what));
        match record {
            Record::Schema { id: 0, .. } => wrong("a schema has the id 0, which says that there is none".into()),
            Record::Schema { id, name, encoding, .. } => {
                let schema = ((*name).to_owned(), (*encoding).to_owned());
                if self.schemas.entry(*id).or_insert_with(|| schema.clone()) != &schema {
                    wrong(format!("schema {id} is described twice, differently"));
                }
            }
            Record::Channel(channel) => {
                let (id, schema) = (channel.id, channel.schema_id);
                if schema != 0 && !self.schemas.contains_key(&schema) {
                    wrong(format!(
                        "channel {id} (\"{}\") names schema {schema}, which is not described",
                        channel.topic
                    ));
                }
                if self.channels.entry(id).or_insert_with(|| channel.clone()) != channel {
                    wrong(format!("channel {id} (\"{}\") is described twice, differently", channel.topic));
                }
            }
            Record::Message(message) => {
                let (id, time) = (message.channel_id, message.log_time);
                let of_chunk = place.in_chunk.is_some();
                let n = if of_chunk { &mut self.n_in_chunk } else { &mut self.n_by_channel }.entry(id).or_default();
                *n += 1;
                if *n == 1 && !self.channels.contains_key(&id) {
                    wrong(format!("a message of channel {id}, which is not described before it"));
                }
                if of_chunk {
                    self.times = Some(self.times.map_or((time, time), |(a, b)| (a.min(time), b.max(time))));
                }
            }
            _ => {}
        }
    }

    fn top_level(&mut self, place: Location, record: &Record<'_>, findings: &mut Findings) {
        let mut wrong = |what: String| findings.add("container", Finding::new(place, what));
        match record {
            Record::Header { .. } if self.header => wrong("a second header".into()),
            Record::Header { .. } => {}
            _ if !self.header && !self.damaged => wrong("the first record is no header".into()),
            _ => {}
        }
        self.header = true;
        match record {
            Record::MessageIndex { channel_id, entries } => {
                *self.indexed.entry(*channel_id).or_default() += entries.len() as u64;
                return self.message_index(place, *channel_id, entries, findings);
            }
            Record::Chunk(head) => {
                self.close_chunk(findings);
                self.chunks.insert(place.offset, head.clone());
                self.open = Some(place.offset);
                return;
            }
            Record::Message(_) | Record::Schema { .. } | Record::Channel(_) => {}
            Record::Attachment(_) => self.n_attachments += 1,
            Record::Metadata { name, .. } => {
                self.n_metadata += 1;
                self.metadata.insert(place.offset, (*name).into());
            }
            Record::MetadataIndex { offset, name, .. } => {
                let there = self.metadata.get(offset).is_some_and(|there| there == name);
                if !there && !self.damaged {
                    wrong(format!(
                        "the summary names the metadata record \"{name}\" at byte {offset}, where it is not"
                    ));
                }
            }
            Record::DataEnd { crc, computed } => {
                if self.data_end.replace(place.offset).is_some() {
                    wrong("a second data end".into());
                }
                // Damage within the section has been found, and changes its CRC.
                if !self.damaged {
                    check_crc("the data section", 0, *crc, *computed, findings);
                }
            }
            Record::Footer { summary_start, crc, computed } => {
                self.footer = Some((place.offset, *summary_start));
                check_crc("the summary", *summary_start, *crc, *computed, findings);
            }
            Record::Statistics(statistics) => {
                self.statistics = Some(statistics.clone());
            }
            Record::ChunkIndex(index) => {
                self.n_chunk_indexes += 1;
                self.chunk_index(place, index, findings);
            }
            Record::Header { .. } | Record::Other => {}
        }
        if !matches!(record, Record::Message(_) | Record::Schema { .. } | Record::Channel(_)) {
            self.close_chunk(findings);
        }
    }

    fn message_index(&mut self, place: Location, channel: u16, entries: &[(u64, u64)], findings: &mut Findings) {
        let mut wrong = |what: String| findings.add("index", Finding::new(place, what));
        let Some(head) = self.open.and_then(|at| self.chunks.get(&at)) else {
            if !self.damaged {
                wrong(format!("an index of channel {channel} follows no chunk"));
            }
            return;
        };
        let outside = entries.iter().find(|(_, offset)| offset.saturating_add(MESSAGE_HEADER_BYTES) > head.n_unpacked);
        if let Some((_, offset)) = outside {
            wrong(format!("an index of channel {channel} points at byte {offset} of its chunk, beyond its end"));
        }
    }

    /// Compares a chunk with its header and its message indexes.
    fn close_chunk(&mut self, findings: &mut Findings) {
        let (indexed, counts) = (std::mem::take(&mut self.indexed), std::mem::take(&mut self.n_in_chunk));
        for (id, n) in &counts {
            *self.n_by_channel.entry(*id).or_default() += n;
        }
        let times = self.times.take();
        let Some(at) = self.open.take() else { return };
        let Some(head) = self.chunks.get(&at) else { return };
        let place = Location { offset: at, in_chunk: None };
        let stored = (head.start_time, head.end_time);
        if let Some(times) = times.filter(|times| *times != stored) {
            let what = format!(
                "the chunk claims log times from {} to {}, its messages have {} to {}",
                stored.0, stored.1, times.0, times.1
            );
            findings.add("chunk times", Finding::new(place, what));
        }
        if !indexed.is_empty() && indexed != counts {
            let what = format!("its message indexes count {indexed:?} by channel, it holds {counts:?}");
            findings.add("index", Finding::new(place, what));
        }
    }

    fn chunk_index(&mut self, place: Location, index: &ChunkIndex, findings: &mut Findings) {
        let mut wrong = |what: String| findings.add("index", Finding::new(place, what));
        let Some(head) = self.chunks.get(&index.offset) else {
            if !self.damaged {
                wrong(format!("the summary names a chunk at byte {}, where none begins", index.offset));
            }
            return;
        };
        let stored = (index.start_time, index.end_time, index.length, index.n_packed, index.n_unpacked);
        let found = (head.start_time, head.end_time, head.n_record, head.n_packed, head.n_unpacked);
        if stored != found || index.compression != head.compression {
            wrong(format!("the summary tells otherwise of the chunk at byte {} than the chunk itself", index.offset));
        }
    }

    /// Compares the file with its summary; says what is missing of a damaged file.
    pub(crate) fn finish(mut self, findings: &mut Findings) -> Option<String> {
        self.close_chunk(findings);
        if let Some((at, summary_start)) = self.footer {
            let after_data = self.data_end.map(|at| at + 13);
            if summary_start != 0 && after_data.is_some_and(|data| data != summary_start) {
                let what = format!("the footer says that the summary begins at byte {summary_start}, but it does not");
                findings.add("container", Finding::new(Location { offset: at, in_chunk: None }, what));
            }
            if self.data_end.is_none() {
                findings.add("container", Finding::new(None, "the record that ends the data is missing"));
            }
        }
        if let Some(stored) = &self.statistics {
            let n_messages = self.n_messages();
            let counts = [
                ("messages", stored.n_messages, n_messages),
                ("schemas", stored.n_schemas.into(), self.schemas.len() as u64),
                ("channels", stored.n_channels.into(), self.channels.len() as u64),
                ("attachments", stored.n_attachments.into(), self.n_attachments.into()),
                ("metadata records", stored.n_metadata.into(), self.n_metadata.into()),
                ("chunks", stored.n_chunks.into(), self.chunks.len() as u64),
            ];
            for (what, stored, found) in counts.iter().filter(|(_, stored, found)| stored != found) {
                // Some writers count what has messages.
                let of_use = ["schemas", "channels"].contains(what) && stored < found;
                let kind = if of_use && !self.damaged { "habit" } else { "statistics" };
                let what = format!("the summary counts {stored} {what}, the file holds {found}");
                findings.add(kind, Finding::new(None, what));
            }
            for (id, stored) in &stored.by_channel {
                let found = self.n_by_channel.get(id).copied().unwrap_or(0);
                if *stored != found {
                    let topic = self.channels.get(id).map_or("unknown", |channel| channel.topic.as_str());
                    let what = format!("the summary counts {stored} messages of \"{topic}\", the file holds {found}");
                    findings.add("statistics", Finding::new(None, what));
                }
            }
        }
        if self.n_chunk_indexes > 0 && self.n_chunk_indexes != self.chunks.len() as u64 {
            let what =
                format!("the summary indexes {} chunks, the file holds {}", self.n_chunk_indexes, self.chunks.len());
            findings.add("statistics", Finding::new(None, what));
        }
        self.damaged.then(|| match &self.statistics {
            Some(stored) => {
                let of = |stored: u64, found: u64, what: &str| {
                    format!("{} of {stored} {what}", stored.saturating_sub(found))
                };
                let messages = of(stored.n_messages, self.n_messages(), "messages");
                format!("{messages}, {}", of(stored.n_chunks.into(), self.n_chunks(), "chunks"))
            }
            None => "messages whose number is not known, as there is no summary".into(),
        })
    }
}

/// Compares the stored CRC of a section with the computed one; 0 means that the writer stored none.
fn check_crc(what: &str, start: u64, stored: u32, computed: Option<u32>, findings: &mut Findings) {
    if let Some(computed) = computed.filter(|computed| stored != 0 && *computed != stored) {
        let place = Location { offset: start, in_chunk: None };
        let what = format!("the CRC of {what} is {computed:08x}, but {stored:08x} was recorded");
        findings.add("crc", Finding::new(place, what));
    }
}
