//! docs/compared.md: the tasks of the page, done with each program that is on this machine; others are skipped by name.

use crate::clients::python;
use crate::common::{program, root, skips_slow};
use std::process::Command;

/// `UPDATE=1` writes the table of the page, with the times of this machine.
#[test]
fn the_three_tasks_are_done_with_the_programs_that_are_here() {
    if skips_slow("the_three_tasks_are_done_with_the_programs_that_are_here") {
        return;
    }
    let is_update = std::env::var_os("UPDATE").is_some();
    let mut script = Command::new(python());
    script.current_dir(root()).arg("tests/compared/run.py").arg(if is_update { "--write" } else { "--check" });
    script.env("OSTEOFLOW_PROGRAM", program()).env("PYTHONDONTWRITEBYTECODE", "1");
    let output = match script.output() {
        Ok(output) => output,
        Err(error) => return println!("skipped: compared: {}: {error}", python().display()),
    };
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    if output.status.code() == Some(2) {
        return println!("skipped: compared: {}", said.trim());
    }
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
}

/// The page names the scripts with which it was done, and has a row for each program.
#[test]
fn the_page_of_the_comparison_names_its_scripts() {
    let page = std::fs::read_to_string(root().join("docs/compared.md")).unwrap();
    for entry in std::fs::read_dir(root().join("tests/compared")).unwrap() {
        let name = entry.unwrap().file_name().to_string_lossy().into_owned();
        assert!(name == "__pycache__" || page.contains(&name), "docs/compared.md does not name tests/compared/{name}");
    }
    for program in ["Osteoflow", "Open3D", "CloudCompare", "3D Slicer", "evo", "Rerun"] {
        assert!(page.contains(&format!("| {program} ")), "docs/compared.md has no row of {program}");
    }
}
