//! Texts and lists behind pointers from the other side of the boundary.
//!
//! Null, alignment, impossible lengths and UTF-8 are checked. Whether a pointer is valid for its length cannot be: the
//! other side guarantees it by the contract in the header.
#![allow(unsafe_code, reason = "reads through pointers from the other side of the boundary")]

use super::{AbiError, Text};
use std::mem::MaybeUninit;

/// The entries of a list; empty if `length` is 0.
///
/// # Errors
/// [`AbiError`] naming `what` if it is null, unaligned or too long.
///
/// # Safety
/// If `data` is neither null nor unaligned, it points to `length` entries that are not written during `'a`.
pub unsafe fn list<'a, T>(data: *const T, length: u64, what: &str) -> Result<&'a [T], AbiError> {
    if length == 0 {
        return Ok(&[]);
    }
    if data.is_null() {
        return Err(AbiError::null(what));
    }
    if !data.is_aligned() {
        return Err(AbiError::unaligned(what));
    }
    let n_bytes = length.checked_mul(size_of::<T>() as u64).filter(|n| *n <= isize::MAX as u64);
    if n_bytes.is_none() {
        return Err(AbiError::length(what, length));
    }
    // SAFETY: not null, aligned, no longer than memory; the caller guarantees the entries.
    Ok(unsafe { std::slice::from_raw_parts(data, length as usize) })
}

/// A text; `None` if it is missing.
///
/// # Errors
/// [`AbiError`] naming `what` if it is too long or not UTF-8.
///
/// # Safety
/// If `text.data` is not null, it points to `text.length` bytes that are not written during `'a`.
pub unsafe fn text<'a>(text: Text, what: &str) -> Result<Option<&'a str>, AbiError> {
    if text.data.is_null() {
        return if text.length == 0 { Ok(None) } else { Err(AbiError::null(what)) };
    }
    // SAFETY: guaranteed by the caller.
    let bytes = unsafe { list(text.data, text.length, what) }?;
    std::str::from_utf8(bytes).map(Some).map_err(|_| AbiError(format!("{what} is not UTF-8 text")))
}

/// A required text.
///
/// # Errors
/// [`AbiError`] naming `what` if it is missing, too long or not UTF-8.
///
/// # Safety
/// As for [`text`].
pub unsafe fn required_text<'a>(given: Text, what: &str) -> Result<&'a str, AbiError> {
    // SAFETY: guaranteed by the caller.
    unsafe { text(given, what) }?.ok_or_else(|| AbiError::null(what))
}

/// A struct that is valid for any bytes, so that a shorter one of an older minor can be padded with zeros.
///
/// # Safety
/// Every pattern of bits is a valid value.
pub unsafe trait Plain: Copy {
    /// The size in minor 0. A smaller struct is refused.
    const MIN_SIZE: usize;
}

macro_rules! plain {
    ($($name:ident)*) => {
        $(
            // SAFETY: numbers, raw pointers, and function pointers that may be null.
            unsafe impl Plain for super::$name {
                const MIN_SIZE: usize = size_of::<super::$name>();
            }
        )*
    };
}

plain! { Kind Input Output Payload SchemaEntry Column Text Plugin }

/// The entries of a list of structs of the other side's size, truncated or padded with zeros to this side's.
///
/// # Errors
/// [`AbiError`] naming `what`, as [`list`], or if the other side's struct is smaller than in minor 0.
///
/// # Safety
/// As for [`list`], with a stride of `size` bytes.
pub unsafe fn entries<T: Plain>(data: *const T, length: u64, size: u32, what: &str) -> Result<Vec<T>, AbiError> {
    if (size as usize) < T::MIN_SIZE {
        let needed = T::MIN_SIZE;
        return Err(AbiError(format!("{what} are structs of {size} bytes, at least {needed} are needed")));
    }
    let n_bytes = length.checked_mul(size.into()).ok_or_else(|| AbiError::length(what, length))?;
    if !data.is_aligned() || !(size as usize).is_multiple_of(align_of::<T>()) {
        return Err(AbiError::unaligned(what));
    }
    // SAFETY: guaranteed by the caller; bytes need no alignment.
    let bytes = unsafe { list(data.cast::<u8>(), n_bytes, what) }?;
    Ok(bytes.chunks_exact(size as usize).map(of_bytes).collect())
}

/// The struct at the start of the bytes, padded with zeros.
fn of_bytes<T: Plain>(bytes: &[u8]) -> T {
    let mut entry = MaybeUninit::<T>::zeroed();
    let n_bytes = bytes.len().min(size_of::<T>());
    // SAFETY: both are at least that long and do not overlap, and any bits are a valid `T`.
    unsafe {
        entry.as_mut_ptr().cast::<u8>().copy_from_nonoverlapping(bytes.as_ptr(), n_bytes);
        entry.assume_init()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[repr(C)]
    #[derive(Debug, Clone, Copy, PartialEq)]
    struct Grown {
        first: u64,
        /// Added in a later minor.
        second: u32,
    }

    // SAFETY: two numbers.
    unsafe impl Plain for Grown {
        const MIN_SIZE: usize = 8;
    }

    #[test]
    fn structs_of_an_older_and_of_a_newer_minor_are_padded_or_truncated() {
        let numbers = [1_u64, 2, 3, 4, 5, 6];
        // SAFETY: the reads are within `numbers`, or refused.
        let read = |n, size| unsafe { entries::<Grown>(numbers.as_ptr().cast(), n, size, "numbers") };
        let grown = |first, second| Grown { first, second };
        assert_eq!(read(2, 8).unwrap(), [grown(1, 0), grown(2, 0)]);
        assert_eq!(read(2, 24).unwrap(), [grown(1, 2), grown(4, 5)]);
        let size = "numbers are structs of 7 bytes, at least 8 are needed";
        assert_eq!(read(1, 7), Err(AbiError(size.into())));
        assert_eq!(read(1, 20), Err(AbiError::unaligned("numbers")));
        assert_eq!(read(u64::MAX, 24), Err(AbiError::length("numbers", u64::MAX)));
    }

    #[test]
    fn invalid_pointers_are_refused_by_name() {
        // SAFETY: invalid pointers are refused before they are read.
        unsafe {
            assert_eq!(
                list::<u64>(std::ptr::null(), 3, "the ports").unwrap_err().to_string(),
                "the ports is a null pointer"
            );
            assert_eq!(list::<u64>(std::ptr::null(), 0, "the ports"), Ok(&[][..]));
            assert_eq!(list(std::ptr::without_provenance::<u64>(1), 1, "x"), Err(AbiError::unaligned("x")));
            let too_long = AbiError::length("x", u64::MAX);
            assert_eq!(list(std::ptr::dangling::<u64>(), u64::MAX, "x"), Err(too_long));
            let bytes = [0xff_u8, 0xfe];
            let no_text = AbiError("x is not UTF-8 text".into());
            assert_eq!(text(Text { data: bytes.as_ptr(), length: 2 }, "x"), Err(no_text));
            assert_eq!(text(Text::NONE, "x"), Ok(None));
            assert_eq!(text(Text::of(""), "x"), Ok(Some("")));
        }
    }
}
