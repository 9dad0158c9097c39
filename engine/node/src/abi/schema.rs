//! Payload types across the boundary: name, version, and what their views hold.
#![allow(unsafe_code, reason = "reads what the other side describes")]

use super::{AbiError, Part, Payload, Text, part, raw};
use crate::{ColumnType, PayloadType, Shape};
use serde::{Deserialize, Serialize};

/// A payload's description as it crosses; made once for each type, and kept for good.
pub fn describe(ty: &PayloadType) -> &'static Payload {
    let parts: Vec<Part> = ty.schema.iter().map(part_of).collect();
    let n_parts = parts.len() as u64;
    Box::leak(Box::new(Payload {
        name: Text::of(ty.name),
        parts: Vec::leak(parts).as_ptr(),
        n_parts,
        version: ty.version,
        flags: 0,
    }))
}

fn part_of(part: &crate::Part) -> Part {
    let (shape, width, type_) = match part.shape {
        Shape::Bool => (part::BOOL, 0, 0),
        Shape::Int => (part::INT, 0, 0),
        Shape::Float => (part::FLOAT, 0, 0),
        Shape::Floats(n) => (part::FLOATS, n, 0),
        Shape::FloatList => (part::FLOAT_LIST, 0, 0),
        Shape::Text => (part::TEXT, 0, 0),
        Shape::Column { kind, width } => (part::COLUMN, width, kind as u32),
    };
    let words = |text: &'static str| if text.is_empty() { Text::NONE } else { Text::of(text) };
    Part {
        name: Text::of(part.name),
        unit: words(part.unit),
        doc: words(part.doc),
        shape,
        width,
        type_,
        flags: if part.optional { part::OPTIONAL } else { 0 },
    }
}

/// A payload as the other side describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PayloadAbout {
    /// Its name.
    pub name: String,
    /// The version of its view.
    pub version: u32,
    /// What its view holds; the texts are kept for good.
    pub schema: Vec<crate::Part>,
}

/// What the other side says of a payload.
///
/// # Errors
/// [`AbiError`] for what is no description.
///
/// # Safety
/// `payload` is one of the other side: what its pointers lead to stays as it is meanwhile.
pub unsafe fn read(payload: &Payload, part_size: u32) -> Result<PayloadAbout, AbiError> {
    // SAFETY: as the caller vouches.
    let name = unsafe { raw::needed(payload.name, "the name of a payload") }?;
    // SAFETY: as the caller vouches.
    let parts = unsafe { raw::entries(payload.parts, payload.n_parts, part_size, &format!("the parts of {name}")) }?;
    // SAFETY: as the caller vouches.
    let schema = parts.iter().map(|part| unsafe { read_part(part, name) }).collect::<Result<_, _>>()?;
    Ok(PayloadAbout { name: name.into(), version: payload.version, schema })
}

/// # Safety
/// As for [`read`].
unsafe fn read_part(part: &Part, payload: &str) -> Result<crate::Part, AbiError> {
    let kept = |text: &str| -> &'static str { String::leak(text.to_owned()) };
    // SAFETY: as the caller vouches.
    let name = unsafe { raw::needed(part.name, &format!("the name of a part of {payload}")) }?;
    // SAFETY: as the caller vouches.
    let text = |text| unsafe { raw::text(text, &format!("a text of part \"{name}\" of {payload}")) };
    let code = |what: &str, code| AbiError::Code(format!("the {what} of part \"{name}\" of {payload}"), code);
    let shape = match part.shape {
        part::BOOL => Shape::Bool,
        part::INT => Shape::Int,
        part::FLOAT => Shape::Float,
        part::FLOATS if part.width > 0 => Shape::Floats(part.width),
        part::FLOAT_LIST => Shape::FloatList,
        part::TEXT => Shape::Text,
        part::COLUMN if part.width > 0 => {
            let kind = u8::try_from(part.type_).ok().and_then(ColumnType::from_code);
            Shape::Column { kind: kind.ok_or_else(|| code("type", part.type_))?, width: part.width }
        }
        part::FLOATS | part::COLUMN => return Err(code("width", part.width)),
        unknown => return Err(code("shape", unknown)),
    };
    Ok(crate::Part {
        name: kept(name),
        shape,
        optional: part.flags & part::OPTIONAL != 0,
        unit: kept(text(part.unit)?.unwrap_or_default()),
        doc: kept(text(part.doc)?.unwrap_or_default()),
    })
}
