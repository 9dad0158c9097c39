use crate::{Cause, Channel, Record};
use std::collections::BTreeMap;

/// Schemas and channels that a file has described so far.
#[derive(Debug, Default)]
pub(crate) struct Descriptions {
    /// Name and encoding of each schema.
    schemas: BTreeMap<u16, (String, String)>,
    channels: BTreeMap<u16, Channel>,
    n_bytes: u64,
}

/// Bytes of the names and the metadata of all schemas and channels: no recorder describes more, and each is kept while a
/// file is read.
const MAX_BYTES: u64 = 256 << 20;

fn n_bytes(record: &Record<'_>) -> u64 {
    let n = match record {
        Record::Schema { name, encoding, data, .. } => name.len() + encoding.len() + data.len(),
        Record::Channel(channel) => {
            let metadata: usize = channel.metadata.iter().map(|(key, value)| key.len() + value.len()).sum();
            channel.topic.len() + channel.message_encoding.len() + metadata
        }
        _ => 0,
    };
    n as u64
}

impl Descriptions {
    /// Whether the channel is described.
    pub(crate) fn has_channel(&self, id: u16) -> bool {
        self.channels.contains_key(&id)
    }

    /// Whether the schema is described, or 0 for none.
    pub(crate) fn has_schema(&self, id: u16) -> bool {
        id == 0 || self.schemas.contains_key(&id)
    }

    /// Refuses a description that gives an identifier another meaning than the first one: messages would be taken for
    /// those of another topic. Metadata may differ; some writers extend it.
    pub(crate) fn check(&self, record: &Record<'_>) -> Result<(), Cause> {
        if self.n_bytes.saturating_add(n_bytes(record)) > MAX_BYTES {
            let reason = format!("the file describes schemas and channels with more than {MAX_BYTES} bytes");
            return Err(Cause::Malformed { what: "description", reason });
        }
        match record {
            Record::Schema { id, name, encoding, .. } => match self.schemas.get(id) {
                Some((known, known_encoding)) if (&**known, &**known_encoding) != (*name, *encoding) => {
                    let reason = format!(
                        "number {id} is described twice: as \"{known}\" ({known_encoding}) and as \"{name}\" ({encoding})"
                    );
                    Err(Cause::Malformed { what: "schema", reason })
                }
                _ => Ok(()),
            },
            Record::Channel(channel) => match self.channels.get(&channel.id) {
                Some(known) if meaning(known) != meaning(channel) => {
                    let text =
                        |c: &Channel| format!("\"{}\" (schema {}, {})", c.topic, c.schema_id, c.message_encoding);
                    let (id, first, second) = (channel.id, text(known), text(channel));
                    let reason = format!("number {id} is described twice: as {first} and as {second}");
                    Err(Cause::Malformed { what: "channel", reason })
                }
                _ => Ok(()),
            },
            _ => Ok(()),
        }
    }

    /// Adds a schema or channel, unless its identifier is known.
    pub(crate) fn add(&mut self, record: &Record<'_>) {
        self.n_bytes = self.n_bytes.saturating_add(n_bytes(record));
        match record {
            Record::Schema { id, name, encoding, .. } => {
                self.schemas.entry(*id).or_insert_with(|| ((*name).into(), (*encoding).into()));
            }
            Record::Channel(channel) => {
                self.channels.entry(channel.id).or_insert_with(|| channel.clone());
            }
            _ => {}
        }
    }

    /// Adds all descriptions of `other`.
    pub(crate) fn append(&mut self, mut other: Self) {
        self.n_bytes = self.n_bytes.saturating_add(other.n_bytes);
        self.schemas.append(&mut other.schemas);
        self.channels.append(&mut other.channels);
    }
}

fn meaning(channel: &Channel) -> (&str, u16, &str) {
    (&channel.topic, channel.schema_id, &channel.message_encoding)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schema(id: u16, name: &'static str, data: &'static [u8]) -> Record<'static> {
        Record::Schema { id, name, encoding: "enc", data }
    }

    fn channel(topic: &str, schema_id: u16) -> Record<'static> {
        let metadata = BTreeMap::from([("key".to_owned(), "value".to_owned())]);
        Record::Channel(Channel { id: 1, schema_id, topic: topic.into(), message_encoding: "json".into(), metadata })
    }

    #[test]
    fn a_number_that_is_described_again_keeps_its_meaning_or_is_refused_with_both() {
        let mut known = Descriptions::default();
        assert!(known.has_schema(0) && !known.has_schema(1) && !known.has_channel(1));
        for record in [schema(1, "Cloud", b"x"), channel("/scan", 1)] {
            assert_eq!(known.check(&record), Ok(()));
            known.add(&record);
            assert_eq!(known.check(&record), Ok(()), "the same again");
        }
        assert!(known.has_schema(1) && known.has_channel(1));
        let message = |record| known.check(&record).unwrap_err().to_string();
        let other = message(schema(1, "Pose", b"x"));
        assert!(other.contains("as \"Cloud\" (enc) and as \"Pose\" (enc)"), "{other}");
        let other = message(channel("/laser", 1));
        assert!(other.contains("as \"/scan\" (schema 1, json) and as \"/laser\" (schema 1, json)"), "{other}");
        assert!(message(channel("/scan", 2)).contains("(schema 2, json)"));
        let mut all = Descriptions::default();
        all.append(known);
        assert!(all.has_schema(1) && all.has_channel(1));
    }

    #[test]
    fn descriptions_count_with_their_texts_and_metadata_up_to_the_limit() {
        assert_eq!(n_bytes(&schema(1, "Cloud", b"1234567")), 5 + 3 + 7);
        assert_eq!(n_bytes(&channel("/scan", 1)), 5 + 4 + 3 + 5);
        let mut known = Descriptions { n_bytes: MAX_BYTES - 15, ..Descriptions::default() };
        assert_eq!(known.check(&schema(1, "Cloud", b"1234567")), Ok(()));
        known.add(&schema(1, "Cloud", b"1234567"));
        let message = known.check(&schema(2, "a", b"")).unwrap_err().to_string();
        assert!(message.contains("more than 268435456 bytes"), "{message}");
    }
}
