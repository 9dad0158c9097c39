//! Payload types across the boundary: name, version and schema.
#![allow(unsafe_code, reason = "reads what the other side describes")]

use super::{AbiError, Payload, SchemaEntry, Text, entry, raw};
use crate::{ColumnType, EntryType, PayloadType};
use serde::{Deserialize, Serialize};

/// The C description of a payload type. It is leaked, so call this once per type.
pub fn describe(ty: &PayloadType) -> &'static Payload {
    let parts: Vec<SchemaEntry> = ty.schema.iter().map(to_c).collect();
    let n_parts = parts.len() as u64;
    Box::leak(Box::new(Payload {
        name: Text::of(ty.name),
        parts: Vec::leak(parts).as_ptr(),
        n_parts,
        version: ty.version,
        flags: 0,
    }))
}

fn to_c(given: &crate::SchemaEntry) -> SchemaEntry {
    let (shape, width, type_) = match given.ty {
        EntryType::Bool => (entry::BOOL, 0, 0),
        EntryType::Int => (entry::INT, 0, 0),
        EntryType::Float => (entry::FLOAT, 0, 0),
        EntryType::Floats(n) => (entry::FLOATS, n, 0),
        EntryType::FloatList => (entry::FLOAT_LIST, 0, 0),
        EntryType::Text => (entry::TEXT, 0, 0),
        EntryType::Column { kind, width } => (entry::COLUMN, width, kind as u32),
    };
    let optional = |text: &'static str| if text.is_empty() { Text::NONE } else { Text::of(text) };
    SchemaEntry {
        name: Text::of(given.name),
        unit: optional(given.unit),
        doc: optional(given.doc),
        shape,
        width,
        type_,
        flags: if given.optional { entry::OPTIONAL } else { 0 },
    }
}

/// A payload type as the other side describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PayloadDescription {
    /// Its name.
    pub name: String,
    /// The version of the view.
    pub version: u32,
    /// The schema of the view. Its texts are leaked.
    pub schema: Vec<crate::SchemaEntry>,
}

/// Reads a description of the other side.
///
/// # Errors
/// [`AbiError`] if it is invalid.
///
/// # Safety
/// The pointers of `payload` are valid, as the header says, and their targets are not written during the call.
pub unsafe fn read(payload: &Payload, entry_size: u32) -> Result<PayloadDescription, AbiError> {
    // SAFETY: guaranteed by the caller.
    let name = unsafe { raw::required_text(payload.name, "the name of a payload") }?;
    // SAFETY: guaranteed by the caller.
    let what = format!("the schema of {name}");
    // SAFETY: guaranteed by the caller.
    let entries = unsafe { raw::entries(payload.parts, payload.n_parts, entry_size, &what) }?;
    // SAFETY: guaranteed by the caller.
    let schema = entries.iter().map(|entry| unsafe { from_c(entry, name) }).collect::<Result<_, _>>()?;
    Ok(PayloadDescription { name: name.into(), version: payload.version, schema })
}

/// # Safety
/// As for [`read`].
unsafe fn from_c(given: &SchemaEntry, payload: &str) -> Result<crate::SchemaEntry, AbiError> {
    let leak = |text: &str| -> &'static str { String::leak(text.to_owned()) };
    // SAFETY: guaranteed by the caller.
    let name = unsafe { raw::required_text(given.name, &format!("the name of an entry of {payload}")) }?;
    // SAFETY: guaranteed by the caller.
    let text = |text| unsafe { raw::text(text, &format!("a text of entry \"{name}\" of {payload}")) };
    let code = |what: &str, code| AbiError::code(format!("the {what} of entry \"{name}\" of {payload}"), code);
    let ty = match given.shape {
        entry::BOOL => EntryType::Bool,
        entry::INT => EntryType::Int,
        entry::FLOAT => EntryType::Float,
        entry::FLOATS if given.width > 0 => EntryType::Floats(given.width),
        entry::FLOAT_LIST => EntryType::FloatList,
        entry::TEXT => EntryType::Text,
        entry::COLUMN if given.width > 0 => {
            let kind = u8::try_from(given.type_).ok().and_then(ColumnType::from_code);
            EntryType::Column { kind: kind.ok_or_else(|| code("type", given.type_))?, width: given.width }
        }
        entry::FLOATS | entry::COLUMN => return Err(code("width", given.width)),
        unknown => return Err(code("shape", unknown)),
    };
    Ok(crate::SchemaEntry {
        name: leak(name),
        ty,
        optional: given.flags & entry::OPTIONAL != 0,
        unit: leak(text(given.unit)?.unwrap_or_default()),
        doc: leak(text(given.doc)?.unwrap_or_default()),
    })
}
