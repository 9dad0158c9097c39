//! Finds a plugin that writes into what it was lent: copies of the heads and columns before a firing are compared after it.
#![allow(unsafe_code, reason = "reads the memory that a plugin was lent")]

use super::host::LentValue;
use osteoflow_node::abi;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether firings of plugins are checked.
static CHECKED: AtomicBool = AtomicBool::new(false);

/// Checks every firing of a plugin from now on. A firing after which lent memory has changed is an error that names input
/// and column. Each firing copies its inputs.
pub fn check_lent_memory() {
    CHECKED.store(true, Ordering::Relaxed);
}

/// The inputs of a firing, copied before it.
pub(super) struct Copies(Vec<Copied>);

/// Lent memory, and its content when it was copied.
struct Copied {
    port: usize,
    /// `None` for the head.
    column: Option<String>,
    data: *const u8,
    bytes: Vec<u8>,
    n_rows: usize,
}

impl Copies {
    /// Copies what a firing lends, by input; nothing unless firings are checked.
    pub(super) fn of<'a>(lent: impl Iterator<Item = (usize, &'a LentValue)>) -> Self {
        if !CHECKED.load(Ordering::Relaxed) {
            return Self(Vec::new());
        }
        Self(
            lent.filter_map(|(port, lent)| Some((port, lent.abi_view()?)))
                .flat_map(|(port, view)| copied(port, view))
                .collect(),
        )
    }

    /// The input and column that differ from their copy, with the first row.
    pub(super) fn changed(&self, names: impl Fn(usize) -> String) -> Option<String> {
        let (copy, at) = self.0.iter().find_map(|copy| Some((copy, copy.first_change()?)))?;
        let input = names(copy.port);
        let place = match &copy.column {
            Some(name) => format!("column \"{name}\", row {}", at * copy.n_rows / copy.bytes.len()),
            None => "the head".into(),
        };
        Some(format!("it wrote into input \"{input}\", {place}: lent memory is read-only, so copy what you change"))
    }
}

impl Copied {
    fn first_change(&self) -> Option<usize> {
        // SAFETY: the view is lent until after the comparison, and its memory was readable when it was copied.
        let now = unsafe { std::slice::from_raw_parts(self.data, self.bytes.len()) };
        if now == self.bytes {
            return None;
        }
        now.iter().zip(&self.bytes).position(|(now, before)| now != before)
    }
}

fn copied(port: usize, view: abi::View) -> Vec<Copied> {
    let copy = |column, data: *const u8, n_bytes: usize, n_rows| {
        // SAFETY: the program made the view, with pointers to as many bytes.
        let bytes =
            if n_bytes == 0 { Vec::new() } else { unsafe { std::slice::from_raw_parts(data, n_bytes) }.to_vec() };
        Copied { port, column, data, bytes, n_rows }
    };
    // SAFETY: as above.
    let columns = match view.n_columns {
        0 => &[],
        n => unsafe { std::slice::from_raw_parts(view.columns, n as usize) },
    };
    let head = copy(None, view.head.cast(), view.head_size as usize, 1);
    let columns = columns.iter().map(|column| {
        // SAFETY: the program made the name.
        let name = unsafe { abi::text(column.name, "a column") }.ok().flatten().unwrap_or_default().to_owned();
        copy(Some(name), column.data.cast(), (column.n_rows * column.stride) as usize, column.n_rows as usize)
    });
    std::iter::once(head).chain(columns).filter(|copy| !copy.bytes.is_empty()).collect()
}
