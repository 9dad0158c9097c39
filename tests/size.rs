//! docs/project/size.md: each part of the project has a row with its size, and grows only with its row.

use crate::common::root;
use std::{fs, process::Command};

/// Length of the longest beginning of a path that a row names: a file, or a folder with the file of its module.
fn named(row: &[&str], path: &str) -> Option<usize> {
    let begins = |of: &&str| path.strip_prefix(*of).is_some_and(|rest| rest.is_empty() || rest.starts_with(['/', '.']));
    row[1].split('`').skip(1).step_by(2).filter(begins).map(str::len).max()
}

/// What is wrong with the page, and the page with the rows lowered whose part shrank; `files` has a line `class count path` a file.
fn compared(page: &str, files: &str) -> (Vec<String>, String) {
    let (mut faults, mut lowered) = (Vec::new(), page.to_owned());
    for part in page.split("\n## ").skip(1) {
        let class = part.lines().next().unwrap().to_lowercase();
        let rows = part.lines().map(|line| line.trim_start_matches("| ").split(" | ").collect::<Vec<_>>());
        let is_row = |row: &Vec<&str>| row.get(2).is_some_and(|cell| cell.parse::<usize>().is_ok());
        let mut rows: Vec<_> = rows.filter(is_row).map(|row| (row, 0)).collect();
        for file in files.lines().filter_map(|line| line.strip_prefix(&format!("{class} "))) {
            let (count, path) = file.split_once(' ').unwrap();
            match rows.iter_mut().filter(|(row, _)| named(row, path).is_some()).max_by_key(|(row, _)| named(row, path))
            {
                Some((_, found)) => *found += count.parse::<usize>().unwrap(),
                None => faults.push(format!("{class}: no row names {path}; add it to the row of its capability")),
            }
        }
        for (row, found) in rows {
            let most: usize = row[2].parse().unwrap();
            let what_to_do = match found {
                0 => "no file is there: delete the row",
                _ if found > most => "edit the row and say why",
                _ if most > found + found / 50 + 50 => "lower the row, as UPDATE=1 does",
                _ => continue,
            };
            faults.push(format!("{class}: \"{}\" has {found}, its row {most}: {what_to_do}", row[0]));
            let (cells, less) = (row[..2].join(" | "), most.min(found.next_multiple_of(10)));
            lowered = lowered.replace(&format!("{cells} | {most} |"), &format!("{cells} | {less} |"));
        }
    }
    (faults, lowered)
}

#[test]
fn each_part_is_as_large_as_its_row_says() {
    let output = Command::new(root().join(".ci/product_lines")).arg("--files").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let path = root().join("docs/project/size.md");
    let page = fs::read_to_string(&path).unwrap();
    let (faults, lowered) = compared(&page, &String::from_utf8(output.stdout).unwrap());
    if std::env::var_os("UPDATE").is_some() && lowered != page {
        fs::write(&path, lowered).unwrap();
    }
    assert!(faults.is_empty(), "docs/project/size.md: {faults:#?}");
}

#[test]
fn a_part_that_rises_shrinks_or_has_no_row_is_a_fault_of_the_page() {
    let page = "# Size\n\n## Product\n\n| Part | Files | Lines | Why |\n|---|---|---|---|\n| One | `a`, `b/c` | 1000 | x |\n| Two | `b` | 300 | y |\n";
    let of = |a: usize, b: usize| compared(page, &format!("product {a} a/x.rs\nproduct 10 b/c.rs\nproduct {b} b/d.rs"));
    assert!(of(990, 300).0.is_empty() && of(940, 250).0.is_empty());
    assert_eq!(of(991, 300).0, ["product: \"One\" has 1001, its row 1000: edit the row and say why"]);
    let (faults, lowered) = of(900, 100);
    assert_eq!(faults.len(), 2, "{faults:?}");
    assert!(lowered.contains("`b/c` | 910 | x |") && lowered.contains("`b` | 100 | y |"), "{lowered}");
    assert!(compared(page, "product 1 ab.rs").0[0].starts_with("product: no row names ab.rs"));
}
