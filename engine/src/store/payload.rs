//! Payloads in the store: the message of an item, as in a recording, without number and stamp.

use super::{Entry, Key, Store, StoreError};
use crate::recording::codec::{self, CodecError, RecordedItem};
use osteoflow_container::Segments;
use osteoflow_node::{Body, Item, Payload, PayloadType, PortPayload, Value};
use std::ops::Range;

/// The bytes of a payload: name and version of its type, and its view. Columns stay where they are.
pub(crate) fn message(value: &Value) -> Segments {
    codec::parts_on(PortPayload::Any, &Item { number: 0, stamp_ns: 0, body: Body::Value(value.clone()) })
}

/// The payload of a message, over the entry's bytes; `None` if it is of another type or version.
pub(crate) fn payload_of(message: RecordedItem, ty: &'static PayloadType) -> Option<Value> {
    let is_of = message.payload.is_some_and(|(name, version)| name == ty.name && version == ty.version);
    let view = message.body.ok().filter(|_| is_of)?;
    ty.from_view(&view).ok()
}

/// The item in a part of an entry; its columns lie in the entry's bytes.
///
/// # Errors
/// [`CodecError`] if the bytes are damaged, or the entry does not have the part.
pub(crate) fn decode(entry: &Entry, range: Range<usize>) -> Result<RecordedItem, CodecError> {
    let short = CodecError::Short { needed: range.end as u64, left: entry.bytes().len() };
    let (start, bytes) = (range.start, entry.bytes().get(range).ok_or(short)?);
    codec::decode_borrowed(bytes, &|rows| entry.part(start + rows.start..start + rows.end))
}

impl Store {
    /// The payload under the key; its columns lie in the entry's bytes. `None` also if it is of another type or version.
    pub fn load<T: Payload<By>, By: 'static>(&self, key: &Key) -> Option<T> {
        let entry = self.get(key)?;
        let message = decode(&entry, 0..entry.bytes().len()).ok()?;
        payload_of(message, PayloadType::of::<T, By>())?.get::<T>().cloned()
    }

    /// Keeps a payload under the key.
    ///
    /// # Errors
    /// As [`Store::put`].
    pub fn save<T: Payload<By>, By: 'static>(&self, key: &Key, payload: &T) -> Result<(), StoreError> {
        let message = message(&Value::new(payload.clone()));
        self.put(key, &message.slices().collect::<Vec<_>>())
    }
}
