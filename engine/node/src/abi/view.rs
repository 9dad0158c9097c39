//! Views across the boundary, without copying columns.
#![allow(unsafe_code, reason = "passes buffers with the functions that release them")]

use super::{AbiError, Column, Owner, Text, head, raw};
use crate::{Buffer, Name, SchemaEntry, View, ViewError};
use std::{ffi::c_void, ptr, sync::Arc};

/// A view in its C form, valid as long as this value.
pub struct OutgoingView {
    head: head::HeadWords,
    columns: Vec<Column>,
    /// Owns the targets of the pointers: texts, lists and buffers, which do not move with this value.
    _view: View,
}

// SAFETY: immutable once made, and buffers may be used and released from any thread.
unsafe impl Send for OutgoingView {}
// SAFETY: as above.
unsafe impl Sync for OutgoingView {}

impl OutgoingView {
    /// Lends the columns: a receiver that keeps one calls `hold` of its owner.
    ///
    /// # Errors
    /// [`ViewError`] if the head does not match the schema.
    pub fn lent(view: View, schema: &[SchemaEntry]) -> Result<Self, ViewError> {
        Self::with(view, schema, |buffer| Owner {
            self_: ptr::from_ref(buffer).cast_mut().cast(),
            hold: Some(hold),
            release: Some(release),
        })
    }

    /// Gives the columns away: the receiver releases each.
    ///
    /// # Errors
    /// [`ViewError`] if the head does not match the schema.
    pub fn given(view: View, schema: &[SchemaEntry]) -> Result<Self, ViewError> {
        Self::with(view, schema, |buffer| Owner { self_: token(buffer), hold: None, release: Some(release) })
    }

    fn with(mut view: View, schema: &[SchemaEntry], owner: impl Fn(&Buffer) -> Owner) -> Result<Self, ViewError> {
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

    /// The C struct.
    pub fn view(&self) -> super::View {
        super::View {
            head: self.head.as_ptr().cast(),
            head_size: (self.head.len() * 8) as u64,
            columns: self.columns.as_ptr(),
            n_columns: self.columns.len() as u64,
        }
    }
}

/// Copies the rows where they are not aligned to the value type, which is rare.
fn align(column: &mut crate::Column) {
    if !(column.bytes().as_ptr() as usize).is_multiple_of(column.kind.size()) {
        let words: Vec<u64> = bytemuck::pod_collect_to_vec(&padded(column.bytes()));
        column.data = Arc::new(AlignedBytes { words, n_bytes: column.bytes().len() });
    }
}

fn padded(bytes: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    out.resize(bytes.len().next_multiple_of(8), 0);
    out
}

struct AlignedBytes {
    words: Vec<u64>,
    n_bytes: usize,
}

impl AsRef<[u8]> for AlignedBytes {
    fn as_ref(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.n_bytes]
    }
}

fn token(buffer: &Buffer) -> *mut c_void {
    Box::into_raw(Box::new(buffer.clone())).cast()
}

/// `hold` of a lent column; `lent` points to its buffer.
unsafe extern "C" fn hold(lent: *mut c_void) -> *mut c_void {
    // SAFETY: by the contract of the header, called with the `self` of a column while its view is lent.
    token(unsafe { &*lent.cast::<Buffer>() })
}

unsafe extern "C" fn release(held: *mut c_void) {
    // SAFETY: by the contract of the header, called once with a result of `token`.
    drop(unsafe { Box::from_raw(held.cast::<Buffer>()) });
}

/// Who owns the columns of an incoming view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ownership {
    /// The sender: a column that is kept must be held.
    Lent,
    /// The receiver: every column must be released.
    Given,
}

/// Bytes owned by the other side.
struct Foreign {
    data: *const u8,
    n_bytes: usize,
    _token: Token,
}

// SAFETY: by the contract of the header, rows are immutable and `release` may be called from any thread.
unsafe impl Send for Foreign {}
// SAFETY: as above.
unsafe impl Sync for Foreign {}

impl AsRef<[u8]> for Foreign {
    fn as_ref(&self) -> &[u8] {
        // SAFETY: the other side keeps the bytes alive until `_token` is released.
        unsafe { std::slice::from_raw_parts(self.data, self.n_bytes) }
    }
}

/// Keeps the rows of a column alive; released on drop.
struct Token {
    token: *mut c_void,
    release: Option<unsafe extern "C" fn(*mut c_void)>,
}

impl Drop for Token {
    fn drop(&mut self) {
        if let Some(release) = self.release {
            // SAFETY: called once, with the token of the owner.
            unsafe { release(self.token) };
        }
    }
}

impl Token {
    /// # Safety
    /// `owner` belongs to a column of a view that was just received.
    unsafe fn of(owner: &Owner, ownership: Ownership) -> Self {
        let token = match (ownership, owner.hold) {
            // SAFETY: by the contract of the header, called with the `self` of the owner while the view is lent.
            (Ownership::Lent, Some(hold)) => unsafe { hold(owner.self_) },
            _ => owner.self_,
        };
        Self { token, release: owner.release }
    }
}

/// A received view. Its columns are released on drop.
pub struct IncomingView<'a> {
    head: (*const c_void, u64),
    columns: Vec<(&'a Column, Token)>,
}

impl<'a> IncomingView<'a> {
    /// Takes ownership of the columns.
    ///
    /// # Errors
    /// [`AbiError`] if the pointer to the columns is invalid.
    ///
    /// # Safety
    /// `view` comes from the other side and follows the contract of the header: pointers that are neither null nor
    /// unaligned are valid for their length during `'a`, and rows until they are released.
    pub unsafe fn new(view: &super::View, ownership: Ownership) -> Result<Self, AbiError> {
        // SAFETY: guaranteed by the caller.
        let columns = unsafe { raw::list(view.columns, view.n_columns, "the list of columns") }?;
        // SAFETY: the view was just received.
        let columns = columns.iter().map(|column| (column, unsafe { Token::of(&column.owner, ownership) }));
        Ok(Self { head: (view.head, view.head_size), columns: columns.collect() })
    }

    /// The view, with shared rows.
    ///
    /// # Errors
    /// [`ViewError`] if a pointer is null or unaligned, a length impossible, a code unknown, or the head too short.
    pub fn take(self, schema: &'static [SchemaEntry]) -> Result<View, ViewError> {
        let invalid = |error: AbiError| ViewError::Invalid(error.to_string());
        // SAFETY: guaranteed by the caller of `new`.
        let head = unsafe { head::read(self.head.0, self.head.1, schema) }?;
        let mut out = View { head, columns: Vec::with_capacity(self.columns.len()) };
        for (column, token) in self.columns {
            // SAFETY: guaranteed by the caller of `new`.
            let name = unsafe { raw::required_text(column.name, "the name of a column") }.map_err(invalid)?;
            // SAFETY: guaranteed by the caller of `new`.
            let taken = unsafe { take_column(column, name, token) }.map_err(invalid)?;
            // Borrows the name from the schema where possible, to avoid an allocation.
            let known = schema.iter().find(|entry| entry.name == name).map(|entry| Name::Borrowed(entry.name));
            out.columns.push(crate::Column { name: known.unwrap_or_else(|| Name::Owned(name.into())), ..taken });
        }
        Ok(out)
    }
}

/// # Safety
/// As for [`IncomingView::new`].
unsafe fn take_column(column: &Column, name: &str, token: Token) -> Result<crate::Column, AbiError> {
    let what = || format!("column \"{name}\"");
    let code = u8::try_from(column.type_).ok().and_then(crate::ColumnType::from_code);
    let kind = code.ok_or_else(|| AbiError::code(format!("the type of {}", what()), column.type_))?;
    let row = kind.size() as u64 * u64::from(column.width);
    let too_long = || AbiError::length(what(), column.n_rows);
    if row == 0 {
        return Err(AbiError::code(format!("the width of {}", what()), column.width));
    }
    if column.stride < row && column.n_rows > 1 {
        let stride = column.stride;
        return Err(AbiError(format!("{} has rows of {row} bytes with a stride of {stride} bytes", what())));
    }
    let n_bytes = column.n_rows.checked_mul(column.stride.max(row)).filter(|n| *n <= isize::MAX as u64);
    let n_bytes = n_bytes.ok_or_else(too_long)? as usize;
    let data: Buffer = if column.n_rows == 0 {
        Arc::new([0_u8; 0])
    } else if column.data.is_null() {
        return Err(AbiError::null(format!("the rows of {}", what())));
    } else if !(column.data as usize).is_multiple_of(kind.size()) {
        return Err(AbiError::unaligned(what()));
    } else if column.stride == row || column.n_rows == 1 {
        let n_bytes = (column.n_rows * row) as usize;
        Arc::new(Foreign { data: column.data.cast(), n_bytes, _token: token })
    } else {
        let end = n_bytes - (column.stride - row) as usize;
        // SAFETY: guaranteed by the caller; the last row has no padding.
        let all = unsafe { std::slice::from_raw_parts(column.data.cast::<u8>(), end) };
        let rows = all.chunks(column.stride as usize).flat_map(|chunk| &chunk[..row as usize]);
        Arc::new(rows.copied().collect::<Vec<u8>>())
    };
    Ok(crate::Column::new("", kind, column.width, data))
}
