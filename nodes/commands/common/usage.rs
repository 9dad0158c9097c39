//! What is likely meant by a command line that cannot be read: a tip in place of that of the parser, which only knows how names are spelled.

use crate::app::files::Data;
use clap::{
    Error,
    error::{ContextKind, ContextValue, ErrorKind},
};
use osteoflow_formats::probe::Kind;
use std::{ffi::OsString, path::Path};

/// Options of other programs, or of other commands, and what takes their place: command, option, tip. An empty command is any.
const OTHERS: [(&str, &[&str], &str); 8] = [
    (
        "register",
        &["--bone", "--target", "--scan", "--source"],
        "the two files have no options: osteoflow register BONE SCAN",
    ),
    ("register", &["--landmark", "--points"], "--landmarks BONE_POINTS SCAN_POINTS"),
    ("", &["--seed"], "--set graph.seed=7"),
    ("", &["--method", "--kind"], "--set icp.kind=icp.point_to_point"),
    ("sweep", &["--repeat", "--n", "--runs"], "--set sweep.repeat=10"),
    ("", &["--port", "--host"], "--address 8766, or --address HOST:PORT"),
    ("", &["--output", "-o", "--output-dir", "--outdir"], "--out DIR"),
    ("", &["--threads", "-j", "--jobs", "--worker"], "--workers N"),
];

/// What the standard library says of a number that cannot be read, and what is expected.
const NUMBERS: [(&str, &str); 4] = [
    ("number would be zero for non-zero type", "at least 1 is expected"),
    ("invalid digit found in string", "a whole number is expected"),
    ("invalid float literal", "a number is expected"),
    ("cannot parse integer from empty string", "a whole number is expected"),
];

/// Prints what is wrong with a command line, or the help that it asks for.
pub(crate) fn print(mut message: Error, arguments: &[OsString]) {
    let arguments: Vec<&str> = arguments.iter().filter_map(|argument| argument.to_str()).collect();
    if let Some(tip) = tip(&message, &arguments) {
        for kind in [ContextKind::SuggestedArg, ContextKind::Suggested, ContextKind::SuggestedSubcommand] {
            message.remove(kind);
        }
        // What the parser took for the way out is that of another mistake.
        message.remove(ContextKind::Usage);
        message.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    let text = message.render().to_string();
    match NUMBERS.iter().find(|(found, _)| text.contains(found)) {
        Some((found, expected)) => eprint!("{}", text.replace(found, expected)),
        None => {
            let _ = message.print();
        }
    }
}

fn tip(message: &Error, arguments: &[&str]) -> Option<String> {
    let command = arguments.get(1).copied().unwrap_or_default();
    if arguments.contains(&"=") || arguments.iter().any(|argument| argument.ends_with('=') && argument.contains('.')) {
        return Some("KEY=VALUE is one word, without spaces: --set icp.kind=icp.point_to_point".into());
    }
    let invalid = match message.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(invalid)) => invalid.as_str(),
        _ => "",
    };
    match message.kind() {
        ErrorKind::UnknownArgument if invalid.parse::<f64>().is_ok() => numbers_apart(invalid, arguments),
        ErrorKind::UnknownArgument if invalid.starts_with('-') => {
            let of = |(of, options, _): &&(&str, &[&str], &str)| {
                (of.is_empty() || *of == command) && options.contains(&invalid.split('=').next().unwrap_or(invalid))
            };
            let tip = OTHERS.iter().find(of).map(|(_, _, tip)| *tip)?;
            Some(if tip.starts_with('-') { format!("write {tip}") } else { tip.to_owned() })
        }
        ErrorKind::UnknownArgument if command == "register" => {
            Some("one scan is registered at a time; osteoflow register BONE SCAN".into())
        }
        ErrorKind::MissingRequiredArgument if command == "register" => {
            let file = arguments[2..].iter().find(|argument| !argument.starts_with('-'))?;
            let what = Data::of(Path::new(file));
            match Path::new(file).extension().is_some_and(|ending| ending == "toml") {
                true => Some(format!("{file} is a graph by its name: osteoflow run {file}")),
                false => what.map(|what| match what.kind() {
                    Some(Kind::Mesh | Kind::Ct) => format!("{file} is {what}: osteoflow register {file} SCAN"),
                    Some(Kind::Cloud) => format!("{file} is {what}: osteoflow register BONE {file}"),
                    _ => format!("{file} is {what}: osteoflow register BONE SCAN"),
                }),
            }
        }
        ErrorKind::TooFewValues | ErrorKind::WrongNumberOfValues if command == "compare" => {
            Some("name two folders of runs, or two of sweeps: osteoflow compare A B".into())
        }
        _ => None,
    }
}

/// The tip for numbers of one option that are apart: `--camera 0 0 0`.
fn numbers_apart(found: &str, arguments: &[&str]) -> Option<String> {
    let at = arguments.iter().position(|argument| *argument == found)?;
    // The first of them was taken by the option, and may be the same number.
    let option = arguments[..=at].iter().rposition(|argument| argument.starts_with("--"))?;
    let numbers: Vec<&str> =
        arguments[option + 1..].iter().copied().take_while(|word| word.parse::<f64>().is_ok()).collect();
    Some(format!("the numbers of an option are one word: {}={}", arguments[option], numbers.join(",")))
}
