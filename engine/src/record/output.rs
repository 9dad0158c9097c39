//! The file of a recording, and who listens to what is written into it.

use crate::options::{ListenedChannel, Listener};
use osteoflow_container::{MessageHeader, Segments, Writer};
use std::{
    collections::BTreeMap,
    fs::File,
    io,
    ops::{Deref, DerefMut},
    sync::Arc,
};

/// A schema as it was added: name, encoding and data.
type Schema = (String, String, Arc<[u8]>);

/// The file, with its listener.
pub(super) struct Output {
    file: Writer<File>,
    listener: Option<Arc<dyn Listener>>,
    /// For the listener only.
    schemas: BTreeMap<u16, Schema>,
}

impl Output {
    pub(super) fn new(file: Writer<File>, listener: Option<Arc<dyn Listener>>) -> Self {
        Self { file, listener, schemas: BTreeMap::new() }
    }

    pub(super) fn add_schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> io::Result<u16> {
        let id = self.file.add_schema(name, encoding, data)?;
        if self.listener.is_some() {
            self.schemas.insert(id, (name.into(), encoding.into(), data.into()));
        }
        Ok(id)
    }

    pub(super) fn add_channel(
        &mut self,
        schema: u16,
        topic: &str,
        encoding: &str,
        metadata: &BTreeMap<String, String>,
    ) -> io::Result<u16> {
        let id = self.file.add_channel(schema, topic, encoding, metadata)?;
        if let (Some(listener), Some((name, schema_encoding, data))) = (&self.listener, self.schemas.get(&schema)) {
            listener.channel(ListenedChannel {
                id,
                topic: topic.into(),
                encoding: encoding.into(),
                schema_name: name.clone(),
                schema_encoding: schema_encoding.clone(),
                schema: data.clone(),
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

    pub(super) fn write_message(&mut self, header: MessageHeader, data: Segments) -> io::Result<()> {
        if let Some(listener) = &self.listener {
            let mut bytes = Vec::with_capacity(data.len());
            data.slices().for_each(|slice| bytes.extend_from_slice(slice));
            listener.message(header.channel_id, header.log_time, bytes);
        }
        self.file.write_message(header, data)
    }

    pub(super) fn finish(self) -> io::Result<File> {
        self.file.finish()
    }
}

impl Deref for Output {
    type Target = Writer<File>;

    fn deref(&self) -> &Writer<File> {
        &self.file
    }
}

impl DerefMut for Output {
    fn deref_mut(&mut self) -> &mut Writer<File> {
        &mut self.file
    }
}
