//! Heads of views: the fields of a schema as a C struct (see `osteoflow_view` in the header).
#![allow(unsafe_code, reason = "reads a struct whose layout is known at run time only")]

use super::{Numbers, Text, raw};
use crate::{EntryType, Field, Name, SchemaEntry, View, ViewError};
use smallvec::SmallVec;
use std::ptr;

/// Each field of a schema with its offset in the head, in bytes.
fn offsets(schema: &[SchemaEntry]) -> impl Iterator<Item = (&SchemaEntry, usize)> {
    let mut at = 0_usize;
    schema.iter().filter_map(move |entry| {
        let (size, align) = size_of_field(entry.ty)?;
        let offset = at.next_multiple_of(align);
        at = offset + size;
        Some((entry, offset))
    })
}

/// The size of the head of a schema in bytes.
pub fn head_size(schema: &[SchemaEntry]) -> usize {
    let fields = schema.iter().filter_map(|entry| size_of_field(entry.ty));
    let align = fields.map(|(_, align)| align).max().unwrap_or(1);
    let end = offsets(schema).last().map_or(0, |(entry, at)| at + size_of_field(entry.ty).map_or(0, |(size, _)| size));
    end.next_multiple_of(align)
}

/// Name and offset in bytes of each head field of a schema.
pub fn head_offsets(schema: &[SchemaEntry]) -> Vec<(&str, usize)> {
    offsets(schema).map(|(entry, at)| (entry.name, at)).collect()
}

/// Size and alignment; `None` for a column.
fn size_of_field(ty: EntryType) -> Option<(usize, usize)> {
    Some(match ty {
        EntryType::Bool => (1, 1),
        EntryType::Int => (size_of::<i64>(), align_of::<i64>()),
        EntryType::Float => (size_of::<f64>(), align_of::<f64>()),
        EntryType::Floats(n) => (size_of::<f64>() * n as usize, align_of::<f64>()),
        EntryType::FloatList => (size_of::<Numbers>(), align_of::<Numbers>()),
        EntryType::Text => (size_of::<Text>(), align_of::<Text>()),
        EntryType::Column { .. } => return None,
    })
}

/// The bytes of a head, as aligned words; those of most payloads fit inline.
pub(super) type HeadWords = SmallVec<[u64; 12]>;

/// The head of a view. Its texts and lists point into the view.
pub(super) fn write(view: &View, schema: &[SchemaEntry]) -> Result<HeadWords, ViewError> {
    let mut head: HeadWords = smallvec::smallvec![0_u64; head_size(schema).div_ceil(8)];
    let start = head.as_mut_ptr().cast::<u8>();
    for (entry, at) in offsets(schema) {
        // SAFETY: `offsets` and `head_size` use the same layout, so each field is within the head; writes are unaligned.
        let put = unsafe { start.add(at) };
        match (entry.ty, view.field(entry.name)) {
            // SAFETY: as above, in this and the following arms.
            (EntryType::Bool, Some(Field::Bool(value))) => unsafe { put.write(u8::from(*value)) },
            (EntryType::Int, Some(Field::Int(value))) => unsafe { put.cast::<i64>().write_unaligned(*value) },
            (EntryType::Float, Some(Field::Float(value))) => unsafe { put.cast::<f64>().write_unaligned(*value) },
            (EntryType::Floats(n), Some(Field::Floats(values))) if values.len() == n as usize => {
                for (i, value) in values.iter().enumerate() {
                    // SAFETY: the field has n numbers.
                    unsafe { put.cast::<f64>().add(i).write_unaligned(*value) };
                }
            }
            (EntryType::FloatList, Some(Field::Floats(values))) => {
                // SAFETY: as above.
                unsafe { put.cast::<Numbers>().write_unaligned(Numbers::of(values)) };
            }
            // SAFETY: as above.
            (EntryType::Text, Some(Field::Text(text))) => unsafe { put.cast::<Text>().write_unaligned(Text::of(text)) },
            // SAFETY: as above.
            (EntryType::Float, None) if entry.optional => unsafe { put.cast::<f64>().write_unaligned(f64::NAN) },
            // The zeros are a null pointer.
            (EntryType::FloatList | EntryType::Text, None) if entry.optional => {}
            _ => return Err(missing(entry)),
        }
    }
    Ok(head)
}

fn missing(entry: &SchemaEntry) -> ViewError {
    ViewError::Missing { what: "field of its schema", name: entry.name.into() }
}

/// The fields of a head.
///
/// # Safety
/// If `head` is not null, it points to `size` readable bytes, and the texts and lists in it to as many bytes as they say.
pub(super) unsafe fn read(
    head: *const std::ffi::c_void,
    size: u64,
    schema: &'static [SchemaEntry],
) -> Result<Vec<(Name, Field)>, ViewError> {
    let needed = head_size(schema);
    if size < needed as u64 {
        return Err(ViewError::Invalid(format!("its head has {size} bytes, the struct of its schema has {needed}")));
    }
    if needed > 0 && head.is_null() {
        return Err(ViewError::Invalid("its head is a null pointer".into()));
    }
    let invalid = |error: super::AbiError| ViewError::Invalid(error.to_string());
    let mut fields = Vec::with_capacity(schema.len());
    for (entry, at) in offsets(schema) {
        // SAFETY: within the head, whose size was checked; reads are unaligned.
        let from = unsafe { head.cast::<u8>().add(at) };
        let what = || format!("field \"{}\"", entry.name);
        let field = match entry.ty {
            // SAFETY: as above, in this and the following arms.
            EntryType::Bool => Field::Bool(unsafe { from.read() } != 0),
            EntryType::Int => Field::Int(unsafe { from.cast::<i64>().read_unaligned() }),
            EntryType::Float => match unsafe { from.cast::<f64>().read_unaligned() } {
                value if entry.optional && value.is_nan() => continue,
                value => Field::Float(value),
            },
            EntryType::Floats(n) => {
                // SAFETY: the field has n numbers.
                let number = |i: usize| unsafe { from.cast::<f64>().add(i).read_unaligned() };
                Field::Floats((0..n as usize).map(number).collect())
            }
            EntryType::FloatList => {
                // SAFETY: as above.
                let numbers = unsafe { from.cast::<Numbers>().read_unaligned() };
                if entry.optional && ptr::eq(numbers.data, ptr::null()) {
                    continue;
                }
                // SAFETY: guaranteed by the caller.
                Field::Floats(unsafe { raw::list(numbers.data, numbers.length, &what()) }.map_err(invalid)?.to_vec())
            }
            EntryType::Text => {
                // SAFETY: as above, and guaranteed by the caller.
                let text = unsafe { raw::text(from.cast::<Text>().read_unaligned(), &what()) }.map_err(invalid)?;
                match text {
                    Some(text) => Field::Text(text.into()),
                    None if entry.optional => continue,
                    None => return Err(missing(entry)),
                }
            }
            EntryType::Column { .. } => continue,
        };
        fields.push((entry.name.into(), field));
    }
    Ok(fields)
}
