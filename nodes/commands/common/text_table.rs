//! Aligned columns of text: names to the left, numbers to the right.

use std::fmt::Write as _;

/// A table with a title and an indent of two.
pub(crate) struct TextTable {
    title: String,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl TextTable {
    /// An empty table; `header` names the columns after the first.
    pub(crate) fn new(title: impl Into<String>, header: &[&str]) -> Self {
        Self { title: title.into(), header: header.iter().map(|&h| h.into()).collect(), rows: Vec::new() }
    }

    /// Adds a row: its name, then one cell for each column.
    pub(crate) fn row(&mut self, name: impl Into<String>, cells: impl IntoIterator<Item = String>) {
        let mut row = vec![name.into()];
        row.extend(cells);
        self.rows.push(row);
    }

    /// Whether the table has no rows.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The table's title.
    pub(crate) fn title(&self) -> &str {
        &self.title
    }

    /// Adds below each row its cells in an earlier table, if they differ. If each table has a single row, their names may
    /// differ.
    pub(crate) fn beside(&mut self, earlier: &Self) {
        let alone = self.rows.len() == 1 && earlier.rows.len() == 1;
        let mut rows = Vec::new();
        for row in std::mem::take(&mut self.rows) {
            let was = earlier.rows.iter().find(|was| was[0] == row[0]).or(earlier.rows.first().filter(|_| alone));
            let was = was.filter(|was| **was != row).map(|was| {
                let name = if was[0] == row[0] { "  was".into() } else { format!("  was {}", was[0]) };
                std::iter::once(name).chain(was[1..].iter().cloned()).collect()
            });
            rows.extend([row].into_iter().chain(was));
        }
        self.rows = rows;
    }

    /// Formats the lines. A cell beyond the last column is a remark, aligned left at the end.
    pub(crate) fn lines(&self) -> String {
        let name_width = self.rows.iter().map(|r| 2 + width(&r[0])).chain([width(&self.title)]).max().unwrap_or(0);
        let mut widths: Vec<usize> = self.header.iter().map(|h| width(h)).collect();
        for row in &self.rows {
            for (column, cell) in widths.iter_mut().zip(&row[1..]) {
                *column = (*column).max(width(cell));
            }
        }
        let mut out = String::new();
        line(&mut out, &self.title, name_width, &self.header, &widths);
        for row in &self.rows {
            line(&mut out, &format!("  {}", row[0]), name_width, &row[1..], &widths);
        }
        out
    }
}

fn line(out: &mut String, name: &str, name_width: usize, cells: &[String], widths: &[usize]) {
    let mut text = name.to_owned();
    text.extend(std::iter::repeat_n(' ', name_width.saturating_sub(width(name))));
    for (k, cell) in cells.iter().enumerate() {
        match widths.get(k) {
            Some(&column) => {
                text.extend(std::iter::repeat_n(' ', 2 + column.saturating_sub(width(cell))));
                text.push_str(cell);
            }
            None => {
                let _ = write!(text, "  {cell}");
            }
        }
    }
    out.push_str(text.trim_end());
    out.push('\n');
}

fn width(text: &str) -> usize {
    text.chars().count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stand_left_numbers_right_and_a_remark_at_the_end() {
        let mut table = TextTable::new("laser points", &["x", "mm"]);
        table.row("P1", ["-1.25".into(), "3".into(), "in ct".into()]);
        table.row("P10", ["10.50".into(), "-44".into()]);
        let expected = "laser points      x   mm\n  P1          -1.25    3  in ct\n  P10         10.50  -44\n";
        assert_eq!(table.lines(), expected);
    }

    #[test]
    fn what_a_row_was_stands_below_it_where_it_was_other() {
        let table = |rows: &[(&str, &str)]| {
            let mut table = TextTable::new("icp", &["mm"]);
            rows.iter().for_each(|(name, cell)| table.row(*name, [(*cell).to_owned()]));
            table
        };
        let mut now = table(&[("P1", "1.0"), ("P2", "2.5"), ("P3", "3.0")]);
        now.beside(&table(&[("P1", "1.0"), ("P2", "2.0")]));
        assert_eq!(now.lines(), "icp       mm\n  P1     1.0\n  P2     2.5\n    was  2.0\n  P3     3.0\n");
        let mut now = table(&[("converged", "1.0")]);
        now.beside(&table(&[("not converged", "2.0")]));
        assert!(now.lines().contains("    was not converged  2.0\n"), "{}", now.lines());
    }
}
