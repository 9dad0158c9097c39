//! The structs of the plugin interface have the same layout in Rust, C and C++: compares sizes and offsets of the Rust side,
//! the golden file, and the assertions in the header. `UPDATE=1` rewrites the two texts; a changed line is a changed
//! interface.

use osteoflow_node::abi;
use std::{fs, path::Path, process::Command};

const BEGIN: &str = "/* begin of layout */\n";
const END: &str = "/* end of layout */\n";

fn path(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("include").join(name)
}

/// The golden text as assertions for the header.
fn assertions(layout: &str) -> String {
    let assertion = |line: &str| {
        let (what, n) = line.split_once(' ').expect("a line is a name and a number");
        match what.split_once('.') {
            None => format!("OSTEOFLOW_ASSERT(sizeof({what}) == {n});\n"),
            Some((name, field)) => {
                let field = field.trim_end_matches('_');
                format!("OSTEOFLOW_ASSERT(offsetof({name}, {field}) == {n});\n")
            }
        }
    };
    layout.lines().map(assertion).collect()
}

fn compiles(compiler: &str, arguments: &[&str], language: &str) {
    let strict = ["-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-x", language];
    match Command::new(compiler).args(arguments).args(strict).arg(path("osteoflow.h")).output() {
        Ok(output) => assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr)),
        Err(error) => println!("skipped: there is no {compiler} here: {error}"),
    }
}

#[test]
#[cfg(target_pointer_width = "64")]
fn the_layout_in_rust_and_in_c_is_that_of_the_golden_file() {
    let layout = abi::layout();
    let golden = fs::read_to_string(path("layout.txt")).unwrap_or_default();
    let header = fs::read_to_string(path("osteoflow.h")).expect("the header is there");
    let (before, rest) = header.split_once(BEGIN).expect("the header marks where the layout begins");
    let (given, after) = rest.split_once(END).expect("the header marks where the layout ends");
    let expected = assertions(&layout);
    if std::env::var_os("UPDATE").is_some() {
        fs::write(path("layout.txt"), &layout).expect("the golden file can be written");
        fs::write(path("osteoflow.h"), [before, BEGIN, &expected, END, after].concat()).expect("so can the header");
        return;
    }
    assert_eq!(layout, golden, "the interface has changed: raise its version, and see the diff after UPDATE=1");
    assert_eq!(given, expected, "the header asserts another layout");
}

#[test]
fn the_header_compiles_as_c11_and_as_cpp11_and_its_assertions_hold() {
    compiles("cc", &["-std=c11", "-pedantic"], "c");
    compiles("c++", &["-std=c++11", "-pedantic"], "c++");
}
