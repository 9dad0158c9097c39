//! The heads of `osteoflow_geometry.h` lie as the schemas of the payloads say, in C and in C++: the golden file, and the
//! assertions that the header makes with it. `UPDATE=1` rewrites the two texts; a changed line is a changed payload, whose
//! version then rises.

use osteoflow_node::{ColumnType, EntryType, PayloadType, Registry, abi};
use std::{fmt::Write, fs, path::Path, process::Command};

const BEGIN: &str = "/* begin of layout */\n";
const END: &str = "/* end of layout */\n";

/// Payloads whose struct is not called after them: `osteoflow_text` is taken.
const OTHER_NAMES: [(&str, &str); 1] = [("report/Text", "words")];

fn path(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("include").join(name)
}

fn types() -> Vec<&'static PayloadType> {
    let mut registry = Registry::default();
    osteoflow_payloads::register(&mut registry);
    registry.payload_types().collect()
}

/// The struct of a payload's head. The reports of algorithms are JSON, each of a form of its own.
fn name_of(ty: &PayloadType) -> String {
    let (_, last) = ty.name.split_once('/').unwrap();
    let is_json = matches!(ty.schema, [part] if part.name == "json" && part.ty == EntryType::Text);
    let other = OTHER_NAMES.iter().find(|(payload, _)| *payload == ty.name).map(|(_, name)| (*name).to_owned());
    let own = if is_json { "json".into() } else { last.to_lowercase() };
    format!("osteoflow_{}", other.unwrap_or(own))
}

/// What the header writes of a column: name, type and width.
fn column(name: &str, kind: ColumnType, width: u32) -> String {
    let c = match kind {
        ColumnType::F64 => "double",
        ColumnType::F32 => "float",
        ColumnType::I64 => "int64_t",
        ColumnType::U32 => "uint32_t",
        ColumnType::U8 => "uint8_t",
    };
    format!("{}: {c}[{width}]", name.replace('*', "NAME"))
}

/// For each payload: struct and version, size and offsets of the head, and the columns.
fn layout() -> String {
    let mut rows = String::new();
    for ty in types() {
        let name = name_of(ty);
        writeln!(rows, "{} {} {name}", ty.name, ty.version).unwrap();
        writeln!(rows, "  {name} {}", abi::head_size(ty.schema)).unwrap();
        for (field, at) in abi::head_offsets(ty.schema) {
            writeln!(rows, "  {name}.{field} {at}").unwrap();
        }
        for part in ty.schema {
            if let EntryType::Column { kind, width } = part.ty {
                let optional = if part.optional { ", optional" } else { "" };
                writeln!(rows, "  {}{optional}", column(part.name, kind, width)).unwrap();
            }
        }
    }
    rows
}

/// The assertions of the header, one set for each struct.
fn assertions() -> String {
    let mut checks: Vec<String> = Vec::new();
    for ty in types() {
        let name = name_of(ty);
        let mut own = format!("OSTEOFLOW_ASSERT(sizeof({name}) == {});\n", abi::head_size(ty.schema));
        for (field, at) in abi::head_offsets(ty.schema) {
            writeln!(own, "OSTEOFLOW_ASSERT(offsetof({name}, {field}) == {at});").unwrap();
        }
        if !checks.contains(&own) {
            checks.push(own);
        }
    }
    checks.concat()
}

#[test]
#[cfg(target_pointer_width = "64")]
fn the_heads_of_the_payloads_lie_in_c_as_their_schemas_and_the_golden_file_say() {
    let golden = fs::read_to_string(path("layout.txt")).unwrap_or_default();
    let header = fs::read_to_string(path("osteoflow_geometry.h")).unwrap();
    let (before, rest) = header.split_once(BEGIN).unwrap();
    let (given, after) = rest.split_once(END).unwrap();
    if std::env::var_os("UPDATE").is_some() {
        fs::write(path("layout.txt"), layout()).unwrap();
        fs::write(path("osteoflow_geometry.h"), [before, BEGIN, &assertions(), END, after].concat()).unwrap();
        return;
    }
    assert_eq!(layout(), golden, "a payload has changed: raise its version, and see the diff after UPDATE=1");
    assert_eq!(given, assertions(), "the header asserts another layout");
}

#[test]
fn the_header_names_every_payload_its_version_and_its_columns() {
    let header = fs::read_to_string(path("osteoflow_geometry.h")).unwrap();
    for ty in types() {
        let name = name_of(ty);
        let is_report = name == "osteoflow_json" && ty.name != "report/Json";
        let (text, version) = (name.to_uppercase(), if is_report { 1 } else { ty.version });
        let defines = format!("#define {text} \"{}\"\n#define {text}_VERSION {version}\n", ty.name);
        let Some((before, _)) = header.split_once(&defines) else {
            assert!(is_report && ty.version == 1, "the header lacks\n{defines}");
            continue;
        };
        let comment = before.rsplit("/*").next().unwrap();
        for part in ty.schema {
            if let EntryType::Column { kind, width } = part.ty {
                let column = format!("\n * {}", column(part.name, kind, width));
                let line = comment.split_once(&column).map(|(_, rest)| rest.lines().next().unwrap_or_default());
                let line = line.unwrap_or_else(|| panic!("the comment of {text} lacks a line{column}"));
                assert_eq!(line.contains("optional"), part.optional, "{text}{column}");
            }
        }
    }
}

#[test]
fn the_header_compiles_as_c11_and_as_cpp11_and_its_assertions_hold() {
    let node = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../engine/node/include");
    for (compiler, standard, language) in [("cc", "-std=c11", "c"), ("c++", "-std=c++11", "c++")] {
        let strict = ["-pedantic", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-x", language, "-I"];
        let compiled =
            Command::new(compiler).arg(standard).args(strict).arg(&node).arg(path("osteoflow_geometry.h")).output();
        match compiled {
            Ok(output) => assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr)),
            Err(error) => println!("skipped: there is no {compiler} here: {error}"),
        }
    }
}
