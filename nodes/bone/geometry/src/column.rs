use std::{fmt, ops::Deref, sync::Arc};

/// An immutable slice of values that clones cheaply, owned by Rust or by a foreign buffer.
///
/// The owner is dropped with the last clone, so a foreign buffer travels with its release function.
pub struct Column<T> {
    owner: Arc<dyn AsRef<[T]> + Send + Sync>,
}

impl<T> Column<T> {
    /// A column that keeps `owner` alive and shows its slice.
    pub fn from_owner(owner: Arc<dyn AsRef<[T]> + Send + Sync>) -> Self {
        Self { owner }
    }

    /// The owner, to be shared with a view of the same bytes.
    pub fn owner(&self) -> &Arc<dyn AsRef<[T]> + Send + Sync> {
        &self.owner
    }
}

impl<T: Send + Sync + 'static> From<Vec<T>> for Column<T> {
    fn from(values: Vec<T>) -> Self {
        Self { owner: Arc::new(values) }
    }
}

impl<T: Send + Sync + 'static> FromIterator<T> for Column<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        Vec::from_iter(values).into()
    }
}

impl<T> Clone for Column<T> {
    fn clone(&self) -> Self {
        Self { owner: self.owner.clone() }
    }
}

impl<T> Deref for Column<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        (*self.owner).as_ref()
    }
}

impl<T: PartialEq> PartialEq for Column<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T> fmt::Debug for Column<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Column({} values)", self.len())
    }
}
