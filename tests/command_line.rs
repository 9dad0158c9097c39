//! The command line: helps, exit codes, stdout and stderr.

use crate::common::osteoflow;

/// Every subcommand, with a word that its help must contain.
const COMMANDS: &[(&str, &str)] = &[
    ("run", "--no-record"),
    ("register", "--init"),
    ("sensor", "--part"),
    ("check", "--set"),
    ("expand", "extends"),
    ("inspect", "--write-docs"),
    ("graph", "mermaid"),
    ("schema", "#:schema"),
    ("record", "--wires"),
    ("replay", "--out"),
    ("digest", "sha256sum"),
    ("diff", "--tolerance"),
    ("repro", "RUST_BACKTRACE"),
    ("validate", "sound"),
    ("recover", "OUT"),
    ("sweep", "--resume"),
    ("export", "--no-data"),
    ("report", "citations.bib"),
    ("view", "--allow-origin"),
    ("compare", "paired"),
    ("info", "extent_mm"),
    ("convert", "--scale"),
    ("runs", "--format json"),
    ("simulate", "--seed"),
    ("new", "procedure"),
    ("completions", "bash"),
];

#[test]
fn every_command_has_a_help_that_teaches_with_examples() {
    let overview = osteoflow().arg("--help").assert().success();
    let overview = String::from_utf8(overview.get_output().stdout.clone()).unwrap();
    for (command, word) in COMMANDS.iter().copied() {
        assert!(overview.contains(&format!("  {command} ")), "the overview lacks {command}:\n{overview}");
        let help = osteoflow().args([command, "--help"]).assert().success();
        let help = String::from_utf8(help.get_output().stdout.clone()).unwrap();
        assert!(help.contains("Examples:"), "the help of {command} has no example:\n{help}");
        assert!(help.contains(&format!("osteoflow {command}")), "its example is of another command:\n{help}");
        assert!(help.contains(word), "the help of {command} lacks {word}:\n{help}");
    }
    let listed = overview.split("Commands:").nth(1).unwrap().split("Options:").next().unwrap();
    let n_listed = listed.lines().filter(|l| l.starts_with("  ") && !l.starts_with("   ")).count();
    assert_eq!(n_listed, COMMANDS.len() + 1, "a command without a line in COMMANDS (one more is `help`):\n{listed}");
}

#[test]
fn the_help_lists_the_exit_codes_and_says_what_it_is_not_for() {
    let printed = osteoflow().arg("--help").assert().success();
    let printed = String::from_utf8(printed.get_output().stdout.clone()).unwrap();
    for line in ["    0  done", "    2  ", "    3  ", "  130  interrupted", "not a medical device"] {
        assert!(printed.contains(line), "{printed}\nlacks {line:?}");
    }
}

#[test]
fn a_fault_of_the_command_line_is_exit_code_2_and_leaves_stdout_empty() {
    for arguments in [&["run"][..], &["fly"], &["check", "x.toml", "--colour"], &["inspect", "icp.no_such_kind"]] {
        let assert = osteoflow().args(arguments).assert().code(2);
        assert!(assert.get_output().stdout.is_empty(), "{arguments:?}");
        assert!(!assert.get_output().stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn a_missing_graph_is_a_fault_with_its_path() {
    let assert = osteoflow().args(["check", "no/such/graph.toml"]).assert().code(2);
    let printed = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(printed.contains("no/such/graph.toml"), "{printed}");
}

#[test]
fn an_unknown_kind_is_answered_with_where_to_look() {
    let assert = osteoflow().args(["inspect", "icp.no_such_kind"]).assert().code(2);
    let printed = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(printed.contains("icp.no_such_kind") && printed.contains("osteoflow inspect"), "{printed}");
}

#[test]
fn inspect_prints_the_same_as_text_and_as_json() {
    let text = osteoflow().args(["inspect", "icp.point_to_plane"]).assert().success();
    let text = String::from_utf8(text.get_output().stdout.clone()).unwrap();
    let json = osteoflow().args(["inspect", "icp.point_to_plane", "--format", "json"]).assert().success();
    let json: serde_json::Value = serde_json::from_slice(&json.get_output().stdout).unwrap();
    assert_eq!(json["kind"], "icp.point_to_plane");
    for port in json["inputs"].as_array().unwrap() {
        let name = port["name"].as_str().unwrap();
        assert!(text.contains(&format!("- `{name}` (")), "{name} is not in\n{text}");
    }
    let all = osteoflow().args(["inspect", "--format", "json"]).assert().success();
    let all: serde_json::Value = serde_json::from_slice(&all.get_output().stdout).unwrap();
    assert!(all.as_array().unwrap().iter().any(|k| k["kind"] == "acquire.mcap"));
}

#[test]
fn completions_are_scripts_for_the_shell_asked_for() {
    for (shell, word) in [("bash", "complete -F"), ("zsh", "#compdef osteoflow"), ("fish", "complete -c osteoflow")] {
        let assert = osteoflow().args(["completions", shell]).assert().success();
        let script = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
        assert!(script.contains(word), "{shell}: {}", &script[..200.min(script.len())]);
    }
}
