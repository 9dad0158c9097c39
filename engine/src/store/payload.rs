//! Payloads in the store, encoded like an item of a recording, without number and stamp.

use super::{Key, Store, StoreEntry, StoreError};
use crate::recording::codec::{self, CodecError, RecordedItem};
use osteoflow_container::Segments;
use osteoflow_node::{Body, Item, Payload, PayloadType, PortPayload, Value};
use std::ops::Range;

/// Encodes a payload: name and version of its type, and its view. Columns are not copied.
pub(crate) fn message(value: &Value) -> Segments {
    codec::parts_on(PortPayload::Any, &Item { number: 0, stamp_ns: 0, body: Body::Value(value.clone()) })
}

/// The payload of a decoded message, without copying the entry's bytes; `None` if type or version differ.
pub(crate) fn payload_of(message: RecordedItem, ty: &'static PayloadType) -> Option<Value> {
    let is_of = message.payload.is_some_and(|(name, version)| name == ty.name && version == ty.version);
    let view = message.body.ok().filter(|_| is_of)?;
    ty.from_view(&view).ok()
}

/// Decodes the item in a range of an entry; its columns borrow the entry's bytes.
///
/// # Errors
/// [`CodecError`] if the bytes are damaged, or the range is outside the entry.
pub(crate) fn decode(entry: &StoreEntry, range: Range<usize>) -> Result<RecordedItem, CodecError> {
    let Range { start, end } = range;
    let bytes = entry.bytes().get(range).ok_or_else(|| CodecError::short(end as u64, entry.bytes().len()))?;
    codec::decode_borrowed(bytes, Some(&|rows| entry.part(start + rows.start..start + rows.end)))
}

impl Store {
    /// Loads the payload of the key; its columns borrow the entry's bytes. `None` also if type or version differ.
    pub fn load<T: Payload<By>, By: 'static>(&self, key: &Key) -> Option<T> {
        let entry = self.get(key)?;
        let message = decode(&entry, 0..entry.bytes().len()).ok()?;
        payload_of(message, PayloadType::of::<T, By>())?.get::<T>().cloned()
    }

    /// Stores a payload under the key.
    ///
    /// # Errors
    /// As [`Store::put`].
    pub fn save<T: Payload<By>, By: 'static>(&self, key: &Key, payload: &T) -> Result<(), StoreError> {
        let message = message(&Value::new(payload.clone()));
        self.put(key, &message.slices().collect::<Vec<_>>())
    }
}
