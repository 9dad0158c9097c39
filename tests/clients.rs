//! Other people's programs, with which tests/clients exchanges files and streams; what is not on this machine is skipped by its name.

use crate::common::{program, root};
use std::{path::PathBuf, process::Command};

/// The Python that has the clients: of `tests/clients/install`, or `OSTEOFLOW_PYTHON`.
pub(crate) fn python() -> PathBuf {
    let installed = root().join("target/clients/bin/python");
    std::env::var_os("OSTEOFLOW_PYTHON")
        .map_or_else(|| if installed.exists() { installed } else { "python3".into() }, PathBuf::from)
}

/// `UPDATE=1` writes docs/clients.md, with the versions and differences of this machine.
#[test]
fn other_programs_read_what_is_written_and_what_they_write_is_read_with_the_same_numbers() {
    let is_update = std::env::var_os("UPDATE").is_some();
    let mut script = Command::new(python());
    script.current_dir(root()).arg("tests/clients/run.py").arg(if is_update { "--write" } else { "--check" });
    script.env("OSTEOFLOW_PROGRAM", program()).env("PYTHONDONTWRITEBYTECODE", "1");
    let output = match script.output() {
        Ok(output) => output,
        Err(error) => return println!("skipped: clients: {}: {error}", python().display()),
    };
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    if output.status.code() == Some(2) {
        return println!("skipped: clients: {}", said.trim());
    }
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(root().join("docs/clients.md")).unwrap();
    let tested =
        said.lines().filter_map(|line| line.strip_prefix("ok    ")?.split_once(": ").map(|(client, _)| client));
    for client in tested {
        // Without its version, which is that of this machine.
        let name = client.rsplit_once(' ').map_or(client, |(name, _)| name);
        assert!(page.contains(&format!("| {name} |")), "{name} has no row in docs/clients.md; UPDATE=1 writes it");
    }
}
