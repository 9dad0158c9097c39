//! Heads of views: the fields of a schema as the C struct that the header says.
#![allow(unsafe_code, reason = "reads a struct whose layout is known at run time only")]

use super::{Numbers, Text, raw};
use crate::{Field, Name, Part, Shape, View, ViewError};
use smallvec::SmallVec;
use std::ptr;

/// Where each field of a schema lies in its head, and how large the head is.
fn places(schema: &[Part]) -> impl Iterator<Item = (&Part, usize)> {
    let mut at = 0_usize;
    schema.iter().filter_map(move |part| {
        let (size, align) = size_of_field(part.shape)?;
        let place = at.next_multiple_of(align);
        at = place + size;
        Some((part, place))
    })
}

/// The size of a schema's head in bytes.
pub fn head_size(schema: &[Part]) -> usize {
    let fields = schema.iter().filter_map(|part| size_of_field(part.shape));
    let align = fields.map(|(_, align)| align).max().unwrap_or(1);
    let end = places(schema).last().map_or(0, |(part, at)| at + size_of_field(part.shape).map_or(0, |(size, _)| size));
    end.next_multiple_of(align)
}

/// Where the fields of a schema lie in its head: name and offset in bytes.
pub fn head_places(schema: &[Part]) -> Vec<(&str, usize)> {
    places(schema).map(|(part, at)| (part.name, at)).collect()
}

fn size_of_field(shape: Shape) -> Option<(usize, usize)> {
    Some(match shape {
        Shape::Bool => (1, 1),
        Shape::Int => (size_of::<i64>(), align_of::<i64>()),
        Shape::Float => (size_of::<f64>(), align_of::<f64>()),
        Shape::Floats(n) => (size_of::<f64>() * n as usize, align_of::<f64>()),
        Shape::FloatList => (size_of::<Numbers>(), align_of::<Numbers>()),
        Shape::Text => (size_of::<Text>(), align_of::<Text>()),
        Shape::Column { .. } => return None,
    })
}

/// The words of a head: those of most payloads need no memory of their own.
pub(super) type Words = SmallVec<[u64; 12]>;

/// The head of a view; its texts and lists stay where the view has them.
pub(super) fn write(view: &View, schema: &[Part]) -> Result<Words, ViewError> {
    let mut head: Words = smallvec::smallvec![0_u64; head_size(schema).div_ceil(8)];
    let start = head.as_mut_ptr().cast::<u8>();
    for (part, at) in places(schema) {
        // SAFETY: `places` and `head_size` lay out the same fields, so each lies within the head; writes need no alignment.
        let put = unsafe { start.add(at) };
        match (part.shape, view.field(part.name)) {
            // SAFETY: as above, in this and the following arms.
            (Shape::Bool, Some(Field::Bool(value))) => unsafe { put.write(u8::from(*value)) },
            (Shape::Int, Some(Field::Int(value))) => unsafe { put.cast::<i64>().write_unaligned(*value) },
            (Shape::Float, Some(Field::Float(value))) => unsafe { put.cast::<f64>().write_unaligned(*value) },
            (Shape::Floats(n), Some(Field::Floats(values))) if values.len() == n as usize => {
                for (i, value) in values.iter().enumerate() {
                    // SAFETY: there is room for n.
                    unsafe { put.cast::<f64>().add(i).write_unaligned(*value) };
                }
            }
            (Shape::FloatList, Some(Field::Floats(values))) => {
                // SAFETY: as above.
                unsafe { put.cast::<Numbers>().write_unaligned(Numbers::of(values)) };
            }
            // SAFETY: as above.
            (Shape::Text, Some(Field::Text(text))) => unsafe { put.cast::<Text>().write_unaligned(Text::of(text)) },
            // SAFETY: as above.
            (Shape::Float, None) if part.optional => unsafe { put.cast::<f64>().write_unaligned(f64::NAN) },
            // Zeros are null pointers.
            (Shape::FloatList | Shape::Text, None) if part.optional => {}
            _ => return Err(missing(part)),
        }
    }
    Ok(head)
}

fn missing(part: &Part) -> ViewError {
    ViewError::Missing { what: "field of its schema", name: part.name.into() }
}

/// The fields of a head.
///
/// # Safety
/// If `head` is not null and aligned it leads to `size` bytes, and texts and lists in it to as much as they say.
pub(super) unsafe fn read(
    head: *const std::ffi::c_void,
    size: u64,
    schema: &'static [Part],
) -> Result<Vec<(Name, Field)>, ViewError> {
    let needed = head_size(schema);
    if size < needed as u64 {
        let said = format!("its head has {size} bytes, the struct of its schema has {needed}");
        return Err(ViewError::Invalid(said));
    }
    if needed > 0 && head.is_null() {
        return Err(ViewError::Invalid("its head is a null pointer".into()));
    }
    let invalid = |error: super::AbiError| ViewError::Invalid(error.to_string());
    let mut fields = Vec::with_capacity(schema.len());
    for (part, at) in places(schema) {
        // SAFETY: within the head, whose size was looked at; reads need no alignment.
        let from = unsafe { head.cast::<u8>().add(at) };
        let what = || format!("field \"{}\"", part.name);
        let field = match part.shape {
            // SAFETY: as above, in this and the following arms.
            Shape::Bool => Field::Bool(unsafe { from.read() } != 0),
            Shape::Int => Field::Int(unsafe { from.cast::<i64>().read_unaligned() }),
            Shape::Float => match unsafe { from.cast::<f64>().read_unaligned() } {
                value if part.optional && value.is_nan() => continue,
                value => Field::Float(value),
            },
            Shape::Floats(n) => {
                // SAFETY: there are n.
                let number = |i: usize| unsafe { from.cast::<f64>().add(i).read_unaligned() };
                Field::Floats((0..n as usize).map(number).collect())
            }
            Shape::FloatList => {
                // SAFETY: as above.
                let numbers = unsafe { from.cast::<Numbers>().read_unaligned() };
                if part.optional && ptr::eq(numbers.data, ptr::null()) {
                    continue;
                }
                // SAFETY: as the caller vouches.
                Field::Floats(unsafe { raw::list(numbers.data, numbers.length, &what()) }.map_err(invalid)?.to_vec())
            }
            Shape::Text => {
                // SAFETY: as above, and as the caller vouches.
                let text = unsafe { raw::text(from.cast::<Text>().read_unaligned(), &what()) }.map_err(invalid)?;
                match text {
                    Some(text) => Field::Text(text.into()),
                    None if part.optional => continue,
                    None => return Err(missing(part)),
                }
            }
            Shape::Column { .. } => continue,
        };
        fields.push((part.name.into(), field));
    }
    Ok(fields)
}
