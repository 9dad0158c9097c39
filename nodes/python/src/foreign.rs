//! Arrays of numpy as columns, without a copy. The only module with unsafe code.
#![allow(unsafe_code, reason = "a column shows the memory of an array that it keeps alive")]

use bytemuck::Pod;
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use osteoflow_geometry::Column;
use pyo3::{exceptions::PyValueError, prelude::*};
use std::sync::Arc;

/// The memory of an array, as values of `T`.
struct Borrowed<T> {
    /// Keeps the memory alive; dropped on any thread.
    _array: Py<PyAny>,
    first: *const T,
    len: usize,
}

// SAFETY: the memory is plain numbers that nothing in this crate writes, and `Py` may be moved between threads and dropped
// on any of them. That Python does not write to an array while a function reads it is what the package asks of its callers.
unsafe impl<T: Sync> Send for Borrowed<T> {}
// SAFETY: as above; there is no interior mutability.
unsafe impl<T: Sync> Sync for Borrowed<T> {}

impl<T> AsRef<[T]> for Borrowed<T> {
    fn as_ref(&self) -> &[T] {
        // SAFETY: pointer and length come from a slice of the array, which is kept alive and, as long as a reference to it
        // exists, refuses to be resized.
        unsafe { std::slice::from_raw_parts(self.first, self.len) }
    }
}

fn borrowed<E: Element + Pod, T: Pod>(array: &Bound<'_, PyArrayDyn<E>>, what: &str) -> PyResult<Borrowed<T>> {
    let reading = array.try_readonly().map_err(|error| PyValueError::new_err(format!("{what}: {error}")))?;
    let numbers = reading.as_slice().map_err(|_| PyValueError::new_err(format!("{what} is not C-contiguous")))?;
    let values: &[T] = bytemuck::try_cast_slice(numbers)
        .map_err(|_| PyValueError::new_err(format!("{what} has shape {:?}, which is not n x 3", array.shape())))?;
    Ok(Borrowed { _array: array.clone().into_any().unbind(), first: values.as_ptr(), len: values.len() })
}

/// An array of rows of `T` as a column, without a copy.
///
/// # Errors
/// ValueError if it is not contiguous, or its rows are not as long as a `T`.
pub(crate) fn column<E: Element + Pod, T: Pod + Send + Sync>(
    array: &Bound<'_, PyArrayDyn<E>>,
    what: &str,
) -> PyResult<Column<T>> {
    let shape = array.shape();
    if shape.len() != 2 || shape[1] * size_of::<E>() != size_of::<T>() {
        let width = size_of::<T>() / size_of::<E>();
        return Err(PyValueError::new_err(format!("{what} has shape {shape:?}, but must be n x {width}")));
    }
    Ok(Column::from_owner(Arc::new(borrowed::<E, T>(array, what)?)))
}

/// The bytes of an array, without a copy.
///
/// # Errors
/// ValueError if it is not contiguous.
pub(crate) fn bytes<E: Element + Pod>(
    array: &Bound<'_, PyArrayDyn<E>>,
    what: &str,
) -> PyResult<osteoflow_node::Buffer> {
    Ok(Arc::new(borrowed::<E, u8>(array, what)?))
}
