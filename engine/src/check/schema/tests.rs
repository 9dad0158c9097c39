use super::*;
use crate::graph::{Sets, load_text};
use serde_json::json;
use std::path::Path;

/// The parameters that `text` gives by `schema`, as JSON, or each fault as `message [label] note: .. help: ..`.
fn read_table(schema: &Json, text: &str, sets: &[&str], files: Files) -> (String, Vec<PathBuf>) {
    let sets: Vec<_> = sets.iter().map(|set| (*set).to_owned()).collect();
    let mut faults = Vec::new();
    let text = format!("[graph]\nformat = 1\n[node.x]\n{text}\n");
    let graph = load_text(text, Path::new("src/check/x.toml"), &[Sets::command_line(&sets)], &mut faults);
    assert!(faults.is_empty(), "{faults:?}");
    let entry = graph.table.get("node").and_then(|nodes| nodes.value.as_table()?.get("x")).unwrap();
    let mut walker = Walker {
        root: schema,
        owner: "x".into(),
        path: "node.x".into(),
        kind: "toy",
        kind_at: None,
        files,
        faults,
        input_files: Vec::new(),
    };
    let read = walker.table(schema, entry.value.as_table().unwrap(), &entry.key_at, "", &["skipped"]);
    assert_eq!(read.is_some(), walker.n_errors() == 0);
    let read = read.map(|read| Json::Object(read).to_string());
    let lines: Vec<_> = read.into_iter().chain(walker.faults.iter().map(format_fault)).collect();
    (lines.join("\n"), walker.input_files)
}

fn format_fault(fault: &Fault) -> String {
    let label = fault.at.as_ref().map_or("", |(_, label)| label);
    let notes = fault.notes.iter().map(|note| format!(" note: {note}"));
    let help = fault.help.iter().map(|help| format!(" help: {help}"));
    format!("{} [{label}]{}", fault.message, notes.chain(help).collect::<String>())
}

/// Reads the parameter `v` of this schema.
fn read_value(schema: &Json, value: &str) -> String {
    let schema = json!({ "properties": { "v": schema }, "additionalProperties": false, "$defs": definitions() });
    let read = read_table(&schema, &format!("v = {value}"), &[], Files::Replaced).0;
    read.strip_prefix("{\"v\":").and_then(|rest| rest.strip_suffix('}')).map_or(read.clone(), str::to_owned)
}

fn definitions() -> Json {
    json!({
        "Half": { "type": "number", "maximum": 0.5, "description": "At most a half.\n\nSince 1998." },
        "Alias": { "$ref": "#/$defs/Half" },
        "Loop": { "$ref": "#/$defs/Loop" },
        "Ball": { "properties": { "shape": { "const": "ball" }, "r": { "type": "number" } }, "required": ["shape", "r"], "additionalProperties": false },
        "Box": { "properties": { "shape": { "const": "box" }, "width": { "type": "number" }, "depth": { "type": "number" } }, "required": ["shape", "width", "depth"], "additionalProperties": false },
    })
}

/// Each value of a table of cases gives this text.
fn check(cases: &[(Json, &[(&str, &str)])]) {
    for (schema, values) in cases {
        for (value, expected) in *values {
            assert_eq!(read_value(schema, value), *expected, "{value} by {schema}");
        }
    }
}

#[test]
fn whole_numbers_end_at_the_limits_of_their_format() {
    for (format, low, high) in [
        ("int8", i128::from(i8::MIN), i128::from(i8::MAX)),
        ("int16", i16::MIN.into(), i16::MAX.into()),
        ("int32", i32::MIN.into(), i32::MAX.into()),
        ("int64", i64::MIN.into(), i64::MAX.into()),
        ("uint8", 0, u8::MAX.into()),
        ("uint16", 0, u16::MAX.into()),
        ("uint32", 0, u32::MAX.into()),
        ("uint", 0, u64::MAX.into()),
        ("uint64", 0, u64::MAX.into()),
        ("uint128", 0, u64::MAX.into()),
    ] {
        let read = |n: i128| read_value(&json!({ "type": "integer", "format": format }), &n.to_string());
        assert_eq!((read(low), read(high)), (low.to_string(), high.to_string()), "{format}");
        let takes = |n: i128, why: &str| format!("x: v takes a whole number, found {n} [{why}]");
        assert_eq!(read(low - 1), takes(low - 1, "too small"), "{format}");
        assert_eq!(read(high + 1), takes(high + 1, "too large"), "{format}");
    }
}

#[test]
fn numbers_are_within_their_range() {
    check(&[
        (
            json!({ "type": "number", "minimum": 1, "maximum": 2 }),
            &[
                ("1", "1.0"),
                ("2.0", "2.0"),
                ("0.5", "x: v takes a number from 1 to 2, found 0.5 [too small]"),
                ("2.5", "x: v takes a number from 1 to 2, found 2.5 [too large]"),
                ("-inf", "x: v takes a number from 1 to 2, found -inf [not finite]"),
            ],
        ),
        (
            json!({ "type": "integer", "minimum": 1, "maximum": 2 }),
            &[
                ("1", "1"),
                ("2", "2"),
                ("0", "x: v takes a whole number from 1 to 2, found 0 [too small]"),
                ("3", "x: v takes a whole number from 1 to 2, found 3 [too large]"),
            ],
        ),
        (
            json!({ "type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1 }),
            &[
                ("0.5", "0.5"),
                ("0", "x: v takes a number above 0 and below 1, found 0 [too small]"),
                ("1", "x: v takes a number above 0 and below 1, found 1 [too large]"),
                ("-1", "x: v takes a number above 0 and below 1, found -1 [too small]"),
                ("2", "x: v takes a number above 0 and below 1, found 2 [too large]"),
            ],
        ),
        (
            json!({ "type": "number", "minimum": 1 }),
            &[("1", "1.0"), ("1e3", "1000.0"), ("0", "x: v takes a number of at least 1, found 0 [too small]")],
        ),
        (
            json!({ "type": "number", "maximum": 1 }),
            &[("1", "1.0"), ("1e3", "x: v takes a number of at most 1, found 1e3 [too large]")],
        ),
        (
            json!({ "type": "number", "minimum": 0, "exclusiveMinimum": 1, "maximum": 5, "exclusiveMaximum": 4 }),
            &[("9", "x: v takes a number above 1 and of at least 0 and below 4 and of at most 5, found 9 [too large]")],
        ),
    ]);
}

#[test]
fn a_value_of_another_type_is_refused_with_what_is_taken() {
    check(&[
        (
            json!({ "type": "integer" }),
            &[
                ("3.0", "x: v takes a whole number, found 3.0 [not a whole number] help: write v = 3"),
                ("-3.0", "x: v takes a whole number, found -3.0 [not a whole number] help: write v = -3"),
                ("3.5", "x: v takes a whole number, found 3.5 [not a whole number]"),
                ("1e15", "x: v takes a whole number, found 1e15 [not a whole number]"),
                ("-1e15", "x: v takes a whole number, found -1e15 [not a whole number]"),
                (
                    "\"3\"",
                    "x: v takes a whole number, found the text \"3\" [a text] help: write v = 3, without quotes and unit",
                ),
                ("true", "x: v takes a whole number, found true [of another type]"),
            ],
        ),
        (
            json!({ "type": "number" }),
            &[
                (
                    "\" 2.5 \"",
                    "x: v takes a number, found the text \" 2.5 \" [a text] help: write v = 2.5, without quotes and unit",
                ),
                ("\"inf\"", "x: v takes a number, found the text \"inf\" [a text]"),
                ("\"3 mm\"", "x: v takes a number, found the text \"3 mm\" [a text]"),
                ("[1]", "x: v takes a number, found a list of 1 [of another type]"),
            ],
        ),
        (
            json!({ "type": "boolean" }),
            &[("true", "true"), ("false", "false"), ("1", "x: v takes true or false, found 1 [of another type]")],
        ),
        (
            json!({ "type": "string" }),
            &[
                ("\"a\"", "\"a\""),
                ("2", "x: v takes a text, found 2 [of another type]"),
                ("{}", "x: v takes a text, found a table [of another type]"),
            ],
        ),
        (json!({ "type": "object" }), &[("1", "x: v takes a table, found 1 [of another type]")]),
        (
            json!({ "enum": ["near", "far"] }),
            &[
                ("\"far\"", "\"far\""),
                (
                    "\"nea\"",
                    "x: v takes one of \"near\", \"far\", found the text \"nea\" [not one of them] help: did you mean \"near\"?",
                ),
                ("1", "x: v takes one of \"near\", \"far\", found 1 [of another type]"),
            ],
        ),
        (
            json!({ "const": "only", "description": "No other." }),
            &[
                ("\"only\"", "\"only\""),
                (
                    "\"x\"",
                    "x: v takes \"only\", found the text \"x\" [not one of them] note: v: No other. note: \"only\": No other.",
                ),
            ],
        ),
        (
            json!({ "oneOf": [{ "const": "a", "description": "First.\n\nMore." }, { "enum": ["b", "c"] }, { "type": "null" }] }),
            &[
                ("\"c\"", "\"c\""),
                (
                    "\"other\"",
                    "x: v takes one of \"a\", \"b\", \"c\", found the text \"other\" [not one of them] note: \"a\": First.",
                ),
            ],
        ),
    ]);
}

#[test]
fn lists_have_their_lengths_and_each_item_is_read() {
    let numbers = |limits: Json| {
        let mut schema = json!({ "type": "array", "items": { "type": "number" } });
        schema.as_object_mut().unwrap().extend(limits.as_object().unwrap().clone());
        schema
    };
    check(&[
        (
            numbers(json!({})),
            &[("[]", "[]"), ("[1, 2]", "[1.0,2.0]"), ("1", "x: v takes a list, found 1 [of another type]")],
        ),
        (
            numbers(json!({ "minItems": 2, "maxItems": 3 })),
            &[
                ("[1]", "x: v takes a list of 2 to 3, found a list of 1 [1 here]"),
                ("[1, 2]", "[1.0,2.0]"),
                ("[1, 2, 3]", "[1.0,2.0,3.0]"),
                ("[1, 2, 3, 4]", "x: v takes a list of 2 to 3, found a list of 4 [4 here]"),
            ],
        ),
        (
            numbers(json!({ "minItems": 2, "maxItems": 2 })),
            &[("[]", "x: v takes a list of 2, found a list of 0 [0 here]")],
        ),
        (numbers(json!({ "minItems": 1 })), &[("[]", "x: v takes a list of at least 1, found a list of 0 [0 here]")]),
        (numbers(json!({ "maxItems": 1 })), &[("[1, 2]", "x: v takes a list of 0 to 1, found a list of 2 [2 here]")]),
        (
            numbers(json!({})),
            &[(
                "[\"3\", true]",
                "x: v[0] takes a number, found the text \"3\" [a text] help: write 3, without quotes and unit\n\
             x: v[1] takes a number, found true [of another type]",
            )],
        ),
        (
            json!({ "type": "array", "prefixItems": [{ "type": "number" }, { "type": "string" }] }),
            &[
                ("[1, \"a\"]", "[1.0,\"a\"]"),
                ("[1]", "x: v takes a list of 2, found a list of 1 [1 here]"),
                ("[1, 2]", "x: v[1] takes a text, found 2 [of another type]"),
            ],
        ),
        (json!({ "type": "array" }), &[("[1, \"a\", []]", "[1,\"a\",[]]")]),
    ]);
}

#[test]
fn a_value_without_a_schema_is_taken_as_it_is_written_if_it_is_finite() {
    check(&[(
        json!({}),
        &[
            ("true", "true"),
            ("-3", "-3"),
            ("18446744073709551615", "18446744073709551615"),
            ("18446744073709551616", "1.8446744073709552e+19"),
            ("1.5", "1.5"),
            ("\"a\"", "\"a\""),
            ("2024-01-01", "\"2024-01-01\""),
            ("{ b = [1, { c = 2.0 }] }", "{\"b\":[1,{\"c\":2.0}]}"),
            ("{ b = [1, { c = nan }] }", "x: v.b[1].c takes a finite number, found nan [not finite]"),
        ],
    )]);
}

#[test]
fn references_and_optional_types_are_followed() {
    let too_large = "x: v takes a number of at most 0.5, found 1 [too large] note: v: At most a half.";
    let optional = "x: v takes a number of at most 0.5 or true or false, found the text \"a\" [none of these]";
    check(&[
        (json!({ "$ref": "#/$defs/Alias" }), &[("0.5", "0.5"), ("1", too_large)]),
        (json!({ "anyOf": [{ "$ref": "#/$defs/Half" }, { "type": "null" }] }), &[("0.5", "0.5"), ("1", too_large)]),
        (
            json!({ "anyOf": [{ "$ref": "#/$defs/Half" }, { "type": "boolean" }, { "type": "null" }] }),
            &[("\"a\"", optional)],
        ),
        (json!({ "$ref": "#/$defs/Loop" }), &[("1", "1")]),
        (json!({ "$ref": "#/$defs/Nowhere" }), &[("1", "1")]),
        (
            json!({ "type": ["null", "boolean"] }),
            &[("true", "true"), ("1", "x: v takes true or false, found 1 [of another type]")],
        ),
        (json!({ "properties": {} }), &[("1", "x: v takes a table, found 1 [of another type]")]),
    ]);
}

#[test]
fn a_union_takes_the_first_branch_that_accepts_and_reports_the_closest_one() {
    let shapes = json!({ "oneOf": [{ "$ref": "#/$defs/Ball" }, { "$ref": "#/$defs/Box" }] });
    let lists = json!({ "anyOf": [
        { "type": "array", "prefixItems": [{ "type": "number" }, { "type": "number" }] },
        { "type": "array", "prefixItems": [{ "type": "string" }, { "type": "number" }] },
    ] });
    let kinds = json!({ "anyOf": [
        { "type": "boolean" },
        { "type": "integer" },
        { "type": "number" },
        { "enum": ["a"] },
        { "type": "string", "format": "input-path" },
        { "type": "array", "items": { "type": "boolean" } },
    ] });
    check(&[
        (
            kinds,
            &[
                ("true", "true"),
                ("2", "2"),
                ("2.5", "2.5"),
                ("\"a\"", "\"a\""),
                ("[true]", "[true]"),
                (
                    "{}",
                    "x: v takes true or false or a whole number or a number or \"a\" or the path of a file or folder or a list, found a table \
                 [none of these]",
                ),
            ],
        ),
        (json!({ "anyOf": [{ "type": "number" }, {}] }), &[("\"a\"", "\"a\"")]),
        (
            lists,
            &[
                // Two faults by the first branch, one by the second.
                ("[\"a\", \"b\"]", "x: v[1] takes a number, found the text \"b\" [a text]"),
                // One fault by either: that of the first.
                ("[true, 1]", "x: v[0] takes a number, found true [of another type]"),
            ],
        ),
        (
            shapes,
            &[
                ("{ shape = \"ball\", r = 1 }", "{\"shape\":\"ball\",\"r\":1.0}"),
                ("{ shape = \"box\", width = 1, depth = 2 }", "{\"shape\":\"box\",\"width\":1.0,\"depth\":2.0}"),
                (
                    "{ shape = \"box\", r = 1 }",
                    "x: parameter \"v.width\" is missing [needs width, a number] help: add width = ..\n\
                 x: parameter \"v.depth\" is missing [needs depth, a number] help: add depth = ..\n\
                 x: toy has no parameter \"r\" in v [unknown] note: its parameters: shape, width, depth",
                ),
                (
                    "{ shape = \"bal\", r = 1 }",
                    "x: v.shape takes one of \"ball\", \"box\", found the text \"bal\" [not one of them] help: did you mean \"ball\"?",
                ),
                ("{ r = 1 }", "x: v does not say its shape [no shape here] help: add shape = \"ball\" or \"box\""),
                ("1", "x: v takes a table with shape, one of \"ball\", \"box\", found 1 [no table]"),
            ],
        ),
    ]);
}

#[test]
fn a_table_has_its_defaults_its_required_parameters_and_no_others() {
    let schema = json!({
        "properties": {
            "gap_mm": { "type": "number", "description": "The gap." },
            "name": { "type": "string", "default": "", "description": "A name." },
            "n": { "type": "integer", "default": 3, "description": "How\nmany.\n\nMore of it." },
            "fast": { "type": "boolean", "default": true, "description": "Haste." },
            "word": { "type": "string", "default": "a", "description": "A word." },
            "list": { "type": "array", "default": [1], "description": "A list." },
            "none": { "type": ["integer", "null"], "default": null },
            "skipped": { "type": "integer", "default": 1 },
        },
        "required": ["gap_mm"],
        "x-removed": {
            "idle": { "default": 1, "warning": "idle is ignored" },
        },
        "additionalProperties": false,
    });
    let read = |text: &str| read_table(&schema, text, &[], Files::Replaced).0;
    let known = "note: its parameters: gap_mm, name, n, fast, word, list, none";
    let all = "{\"gap_mm\":2.0,\"name\":\"\",\"n\":3,\"fast\":true,\"word\":\"a\",\"list\":[1]}";
    let missing =
        "x: parameter \"gap_mm\" is missing [needs gap_mm, a number] note: gap_mm: The gap. help: add gap_mm = ..";
    let takes = |what: &str, doc: &str| format!("x: {what} takes {doc}");
    for (text, expected) in [
        ("gap_mm = 2", all.to_owned()),
        ("gap_mm = 2\nskipped = \"anything\"", all.to_owned()),
        ("", missing.to_owned()),
        ("gap_mm = 2\nidle = 1", all.to_owned()),
        ("gap_mm = 2\nidle = 2", format!("{all}\nidle is ignored [ignored]")),
        ("skipped = 1\nother = 1", format!("{missing}\nx: toy has no parameter \"other\" [unknown] {known}")),
        // One fault for a misspelt name, or one in another unit.
        ("gap_mn = 2", format!("x: toy has no parameter \"gap_mn\" [unknown] {known} help: did you mean \"gap_mm\"?")),
        ("gap_m = 2", "x: toy has no parameter \"gap_m\" [it is given in mm] help: write gap_mm = 2000.0".to_owned()),
        (
            "gap_m = nan",
            "x: toy has no parameter \"gap_m\" [it is given in mm] help: write gap_mm: the unit is part of the name"
                .to_owned(),
        ),
        (
            "gap_mm = \"2 cm\"",
            takes(
                "gap_mm",
                "a number, found the text \"2 cm\" [a text] note: gap_mm: The gap. help: write gap_mm = 20, without quotes and unit",
            ),
        ),
        ("gap_mm = 2\nname = 1", takes("name", "a text, found 1 [of another type] note: name: A name.")),
        (
            "gap_mm = 2\nn = 1.5",
            takes("n", "a whole number, found 1.5 [not a whole number] note: n: How many. (default 3)"),
        ),
        (
            "gap_mm = 2\nfast = 1",
            takes("fast", "true or false, found 1 [of another type] note: fast: Haste. (default true)"),
        ),
        (
            "gap_mm = 2\nword = 1",
            takes("word", "a text, found 1 [of another type] note: word: A word. (default \"a\")"),
        ),
        ("gap_mm = 2\nlist = 1", takes("list", "a list, found 1 [of another type] note: list: A list.")),
    ] {
        assert_eq!(read(text), expected, "{text}");
    }
    // The name that is meant is set already.
    let twice = read("gap_mm = 2\ngap_mn = 2");
    assert_eq!(twice, format!("x: toy has no parameter \"gap_mn\" [unknown] {known} help: did you mean \"gap_mm\"?"));
}

#[test]
fn a_map_takes_any_key_and_a_struct_without_parameters_none() {
    let map = json!({ "type": "object", "additionalProperties": { "type": "integer" } });
    let read = |schema: &Json, text: &str| read_table(schema, text, &[], Files::Replaced).0;
    assert_eq!(read(&map, "a = 1\nb = 2"), "{\"a\":1,\"b\":2}");
    assert_eq!(read(&map, "a = true"), "x: a takes a whole number, found true [of another type]");
    for empty in [json!({ "type": "object" }), json!({ "additionalProperties": false })] {
        assert_eq!(read(&empty, "a = 1"), "x: toy has no parameter \"a\" [unknown] note: it has no parameters here");
    }
}

#[test]
fn texts_of_the_command_line_need_no_quotes() {
    let schema = json!({ "properties": {
        "text": { "type": "string" },
        "word": { "enum": ["1", "b"] },
        "file": { "type": "string", "format": "input-path" },
        "n": { "type": "integer" },
    } });
    let read = |set: &str| read_table(&schema, "", &[&format!("x.{set}")], Files::Replaced).0;
    for (set, expected) in [
        ("text=3", "{\"text\":\"3\"}"),
        ("text=true", "{\"text\":\"true\"}"),
        ("text=2024-01-01", "{\"text\":\"2024-01-01\"}"),
        ("text=[1]", "x: text takes a text, found a list of 1 [of another type]"),
        ("text={}", "x: text takes a text, found a table [of another type]"),
        ("word=1", "{\"word\":\"1\"}"),
        ("word=777", "x: word takes one of \"1\", \"b\", found 777 [not one of them]"),
        ("n=3", "{\"n\":3}"),
    ] {
        assert_eq!(read(set), expected, "{set}");
    }
    let (_, files) = read_table(&schema, "", &["x.file=7"], Files::Replaced);
    assert!(files[0].ends_with("7"), "{files:?}");
}

#[test]
fn a_path_is_a_text_of_a_file_that_is_there_when_it_is_read() {
    let schema = json!({ "properties": { "v": { "type": "string", "format": "input-path" } } });
    let read = |path: &str, files| read_table(&schema, &format!("v = \"{path}\""), &[], files);
    let here = std::path::absolute("src/check").unwrap();
    let expected = format!("{{\"v\":\"{}\"}}", here.join("schema.rs").display());
    for (path, files) in
        [("schema.rs", Files::Needed), ("schema/../schema.rs", Files::Needed), ("./schema.rs", Files::Replaced)]
    {
        assert_eq!(read(path, files), (expected.clone(), vec![here.join("schema.rs")]), "{path}");
    }
    assert_eq!(read("gone.stl", Files::Replaced).1, [here.join("gone.stl")], "its run has another one");
    let (said, files) = read("gone.stl", Files::Needed);
    assert_eq!(
        (said, files),
        (format!("x: v: there is no file {} [relative to this file]", here.join("gone.stl").display()), Vec::new())
    );
    assert_eq!(read("", Files::Replaced).0, "x: v: an empty path names no file [empty]");
    assert_eq!(read("schema/", Files::Needed).1, [here.join("schema")], "a folder may end so");
    let file = read("schema.rs/", Files::Needed).0;
    assert_eq!(
        file,
        format!(
            "x: v: {} is a file, not a folder [ends like a folder] help: take the last / away",
            here.join("schema.rs").display()
        )
    );
}

#[test]
fn a_path_with_an_empty_default_is_required() {
    let schema = json!({ "properties": {
        "file": { "type": "string", "format": "input-path", "default": "" },
        "other": { "type": "string", "format": "input-path", "default": "a.txt" },
        "text": { "type": "string", "default": "" },
    } });
    let read = |text: &str| read_table(&schema, text, &[], Files::Replaced).0;
    let missing = "x: parameter \"file\" is missing [needs file, the path of a file or folder] help: add file = \"..\"";
    assert_eq!(read(""), missing);
    assert!(read("file = \"b\"").contains("\"other\":\"a.txt\",\"text\":\"\""), "{}", read("file = \"b\""));
}

#[cfg(unix)]
#[test]
fn a_path_through_a_link_keeps_its_dots_if_they_lead_elsewhere() {
    let dir = tempfile::tempdir().unwrap();
    let at = |path: &str| dir.path().join(path);
    std::fs::create_dir_all(at("deep/inner")).unwrap();
    std::os::unix::fs::symlink(at("deep/inner"), at("link")).unwrap();
    for file in ["a.txt", "deep/a.txt"] {
        std::fs::write(at(file), file).unwrap();
    }
    // Through the link, `..` is the folder `deep`.
    assert_eq!(files::tidy(&at("link/../a.txt")), at("link/../a.txt"));
    assert_eq!(files::tidy(&at("deep/inner/../a.txt")), at("deep/a.txt"));
    assert_eq!(files::tidy(&at("deep/../none.txt")), at("none.txt"));
}
