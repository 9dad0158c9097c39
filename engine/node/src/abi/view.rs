//! Views across the boundary: lent without a copy, and taken over without one.
#![allow(unsafe_code, reason = "hands buffers over, each with the function that releases it")]

use super::{AbiError, Column, Owner, Text, head, raw};
use crate::{Buffer, Name, Part, View, ViewError};
use std::{ffi::c_void, ptr, sync::Arc};

/// A view made ready to cross: what it points to lives as long as this.
pub struct Lent {
    head: head::Words,
    columns: Vec<Column>,
    /// What the pointers lead to: texts, lists and buffers, which stay where they are when this moves.
    _view: View,
}

// SAFETY: nothing of it changes once it is made, and buffers may be used and released from any thread.
unsafe impl Send for Lent {}
// SAFETY: as above.
unsafe impl Sync for Lent {}

impl Lent {
    /// A view whose columns are lent: whoever wants to keep one holds its owner.
    ///
    /// # Errors
    /// [`ViewError`] if the view is not one of the schema.
    pub fn new(view: View, schema: &[Part]) -> Result<Self, ViewError> {
        Self::with(view, schema, |buffer| Owner {
            self_: ptr::from_ref(buffer).cast_mut().cast(),
            hold: Some(hold),
            release: Some(release),
        })
    }

    /// A view whose columns are given away: whoever takes it releases each.
    ///
    /// # Errors
    /// [`ViewError`] if the view is not one of the schema.
    pub fn given(view: View, schema: &[Part]) -> Result<Self, ViewError> {
        Self::with(view, schema, |buffer| Owner { self_: token(buffer), hold: None, release: Some(release) })
    }

    fn with(mut view: View, schema: &[Part], owner: impl Fn(&Buffer) -> Owner) -> Result<Self, ViewError> {
        view.columns.iter_mut().for_each(align);
        let head = head::write(&view, schema)?;
        let columns = view.columns.iter().map(|column| {
            let row = column.kind.size() as u64 * u64::from(column.width);
            Column {
                name: Text::of(&column.name),
                data: column.bytes().as_ptr().cast(),
                n_rows: column.rows() as u64,
                stride: row,
                type_: column.kind as u32,
                width: column.width,
                owner: owner(&column.data),
            }
        });
        Ok(Self { columns: columns.collect(), head, _view: view })
    }

    /// The view as it crosses.
    pub fn view(&self) -> super::View {
        super::View {
            head: self.head.as_ptr().cast(),
            head_size: (self.head.len() * 8) as u64,
            columns: self.columns.as_ptr(),
            n_columns: self.columns.len() as u64,
        }
    }
}

/// A column's rows lie aligned to its values on the other side; they nearly always do.
fn align(column: &mut crate::Column) {
    if !(column.bytes().as_ptr() as usize).is_multiple_of(column.kind.size()) {
        let words: Vec<u64> = bytemuck::pod_collect_to_vec(&padded(column.bytes()));
        column.data = Arc::new(Words { words, n_bytes: column.bytes().len() });
    }
}

fn padded(bytes: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    out.resize(bytes.len().next_multiple_of(8), 0);
    out
}

struct Words {
    words: Vec<u64>,
    n_bytes: usize,
}

impl AsRef<[u8]> for Words {
    fn as_ref(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.n_bytes]
    }
}

fn token(buffer: &Buffer) -> *mut c_void {
    Box::into_raw(Box::new(buffer.clone())).cast()
}

/// Of a lent column: `lent` is the place of its buffer.
unsafe extern "C" fn hold(lent: *mut c_void) -> *mut c_void {
    // SAFETY: the header has it called with the column's own pointer while the view is lent.
    token(unsafe { &*lent.cast::<Buffer>() })
}

unsafe extern "C" fn release(held: *mut c_void) {
    // SAFETY: the header has it called once with what `token` gave.
    drop(unsafe { Box::from_raw(held.cast::<Buffer>()) });
}

/// How the columns of a view come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Lent: what is kept is held.
    Lent,
    /// Given away: what is not kept is released.
    Given,
}

/// Bytes of the other side.
struct Foreign {
    data: *const u8,
    n_bytes: usize,
    _held: Held,
}

// SAFETY: the header has published rows unchanging, and `release` called from any thread.
unsafe impl Send for Foreign {}
// SAFETY: as above.
unsafe impl Sync for Foreign {}

impl AsRef<[u8]> for Foreign {
    fn as_ref(&self) -> &[u8] {
        // SAFETY: the other side keeps them where they are until `_held` is released.
        unsafe { std::slice::from_raw_parts(self.data, self.n_bytes) }
    }
}

/// A token that is released with the last use of the rows.
struct Held {
    token: *mut c_void,
    release: Option<unsafe extern "C" fn(*mut c_void)>,
}

impl Drop for Held {
    fn drop(&mut self) {
        if let Some(release) = self.release {
            // SAFETY: called once, with the token that the owner gave for it.
            unsafe { release(self.token) };
        }
    }
}

impl Held {
    /// # Safety
    /// The owner is one of a column that has just crossed.
    unsafe fn of(owner: &Owner, origin: Origin) -> Self {
        let token = match (origin, owner.hold) {
            // SAFETY: the header has it called with the owner's own pointer while the view is lent.
            (Origin::Lent, Some(hold)) => unsafe { hold(owner.self_) },
            _ => owner.self_,
        };
        Self { token, release: owner.release }
    }
}

/// A view that is crossing: from here on its columns are released, whatever becomes of it.
pub struct Crossing<'a> {
    head: (*const c_void, u64),
    columns: Vec<(&'a Column, Held)>,
}

impl<'a> Crossing<'a> {
    /// Takes hold of the columns.
    ///
    /// # Errors
    /// [`AbiError`] if the list of columns leads nowhere.
    ///
    /// # Safety
    /// `view` is one of the other side, as the header says: what is neither null nor unaligned leads to as much as its
    /// length says, and stays there during `'a`, and rows until they are released.
    pub unsafe fn new(view: &super::View, origin: Origin) -> Result<Self, AbiError> {
        // SAFETY: as the caller vouches.
        let columns = unsafe { raw::list(view.columns, view.n_columns, "the list of columns") }?;
        // SAFETY: they have just crossed.
        let columns = columns.iter().map(|column| (column, unsafe { Held::of(&column.owner, origin) }));
        Ok(Self { head: (view.head, view.head_size), columns: columns.collect() })
    }

    /// The view, over the same rows.
    ///
    /// # Errors
    /// [`ViewError`] if a pointer is null or unaligned, a length impossible, a code unknown, or the head too short.
    pub fn take(self, schema: &'static [Part]) -> Result<View, ViewError> {
        let invalid = |error: AbiError| ViewError::Invalid(error.to_string());
        // SAFETY: as the caller of `new` vouches.
        let head = unsafe { head::read(self.head.0, self.head.1, schema) }?;
        let mut out = View { head, columns: Vec::with_capacity(self.columns.len()) };
        for (column, held) in self.columns {
            // SAFETY: as the caller of `new` vouches.
            let name = unsafe { raw::needed(column.name, "the name of a column") }.map_err(invalid)?;
            // SAFETY: as the caller of `new` vouches.
            let taken = unsafe { take_column(column, name, held) }.map_err(invalid)?;
            // The schema's own text where it has it: names of columns need no memory then.
            let known = schema.iter().find(|part| part.name == name).map(|part| Name::Borrowed(part.name));
            out.columns.push(crate::Column { name: known.unwrap_or_else(|| Name::Owned(name.into())), ..taken });
        }
        Ok(out)
    }
}

/// # Safety
/// As for [`Crossing::new`].
unsafe fn take_column(column: &Column, name: &str, held: Held) -> Result<crate::Column, AbiError> {
    let what = || format!("column \"{name}\"");
    let code = u8::try_from(column.type_).ok().and_then(crate::ColumnType::from_code);
    let kind = code.ok_or_else(|| AbiError::Code(format!("the type of {}", what()), column.type_))?;
    let row = kind.size() as u64 * u64::from(column.width);
    let too_long = || AbiError::Length(what(), column.n_rows);
    if row == 0 {
        return Err(AbiError::Code(format!("the width of {}", what()), column.width));
    }
    if column.stride < row && column.n_rows > 1 {
        return Err(AbiError::Stride { what: what(), stride: column.stride, row });
    }
    let n_bytes = column.n_rows.checked_mul(column.stride.max(row)).filter(|n| *n <= isize::MAX as u64);
    let n_bytes = n_bytes.ok_or_else(too_long)? as usize;
    let data: Buffer = if column.n_rows == 0 {
        Arc::new([0_u8; 0])
    } else if column.data.is_null() {
        return Err(AbiError::Null(format!("the rows of {}", what())));
    } else if !(column.data as usize).is_multiple_of(kind.size()) {
        return Err(AbiError::Unaligned(what()));
    } else if column.stride == row || column.n_rows == 1 {
        let n_bytes = (column.n_rows * row) as usize;
        Arc::new(Foreign { data: column.data.cast(), n_bytes, _held: held })
    } else {
        let end = n_bytes - (column.stride - row) as usize;
        // SAFETY: as the caller vouches; the last row ends with its last value.
        let all = unsafe { std::slice::from_raw_parts(column.data.cast::<u8>(), end) };
        let rows = all.chunks(column.stride as usize).flat_map(|chunk| &chunk[..row as usize]);
        Arc::new(rows.copied().collect::<Vec<u8>>())
    };
    Ok(crate::Column::new("", kind, column.width, data))
}
