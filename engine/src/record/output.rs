//! The file of a recording, and who listens to what is written into it.

use crate::options::{ListenedChannel, Listener};
use osteoflow_container::{MessageHeader, Segments, Writer};
use std::{collections::BTreeMap, fs::File, io, sync::Arc};

/// The schema of a channel.
pub(super) struct Schema<'a> {
    pub(super) name: &'a str,
    pub(super) encoding: &'a str,
    pub(super) data: &'a [u8],
}

/// The file, with its listener.
pub(super) struct Output {
    pub(super) file: Writer<File>,
    pub(super) listener: Option<Arc<dyn Listener>>,
}

impl Output {
    pub(super) fn add_channel(
        &mut self,
        schema: &Schema<'_>,
        topic: &str,
        encoding: &str,
        metadata: &BTreeMap<String, String>,
    ) -> io::Result<u16> {
        let schema_id = self.file.add_schema(schema.name, schema.encoding, schema.data)?;
        let id = self.file.add_channel(schema_id, topic, encoding, metadata)?;
        if let Some(listener) = &self.listener {
            listener.channel(ListenedChannel {
                id,
                topic: topic.into(),
                encoding: encoding.into(),
                schema_name: schema.name.into(),
                schema_encoding: schema.encoding.into(),
                schema: schema.data.into(),
                metadata: metadata.clone(),
            });
        }
        Ok(id)
    }

    /// Sends a message to the listener alone.
    pub(super) fn send(&self, header: MessageHeader, bytes: Vec<u8>) {
        if let Some(listener) = &self.listener {
            listener.message(header.channel_id, header.log_time, bytes);
        }
    }

    /// Writes a message of which the listener is not told, since it would take it for the last of its channel.
    pub(super) fn write_unheard(&mut self, header: MessageHeader, bytes: Vec<u8>) -> io::Result<()> {
        self.file.write_message(header, bytes.into())
    }

    pub(super) fn write_message(&mut self, header: MessageHeader, data: Segments) -> io::Result<()> {
        if let Some(listener) = &self.listener {
            let mut bytes = Vec::with_capacity(data.len());
            data.slices().for_each(|slice| bytes.extend_from_slice(slice));
            listener.message(header.channel_id, header.log_time, bytes);
        }
        self.file.write_message(header, data)
    }
}
