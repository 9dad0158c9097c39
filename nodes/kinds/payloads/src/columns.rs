//! Columns of geometry as columns of a view and back, sharing the bytes.

use bytemuck::Pod;
use osteoflow_geometry::Column as Values;
use osteoflow_node::{Buffer, Column, ColumnType, Name, View, ViewError};
use std::{marker::PhantomData, sync::Arc};

struct Bytes<T>(Values<T>);

impl<T: Pod> AsRef<[u8]> for Bytes<T> {
    fn as_ref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }
}

/// Rows over bytes that were checked to be aligned and whole.
struct Rows<T>(Buffer, PhantomData<T>);

impl<T: Pod> AsRef<[T]> for Rows<T> {
    fn as_ref(&self) -> &[T] {
        bytemuck::cast_slice((*self.0).as_ref())
    }
}

/// A view's column that shares the values.
pub(crate) fn to_column<T: Pod + Send + Sync>(name: impl Into<Name>, kind: ColumnType, values: &Values<T>) -> Column {
    let width = (size_of::<T>() / kind.size()) as u32;
    Column::new(name, kind, width, Arc::new(Bytes(values.clone())))
}

/// The values of a view's column; shares the bytes if they are aligned.
pub(crate) fn from_column<T: Pod + Send + Sync>(view: &View, name: &str) -> Result<Values<T>, ViewError> {
    let column = view.column(name)?;
    Ok(match column.rows_of::<T>()? {
        std::borrow::Cow::Borrowed(_) => Values::from_owner(Arc::new(Rows(column.data.clone(), PhantomData))),
        std::borrow::Cow::Owned(rows) => rows.into(),
    })
}
