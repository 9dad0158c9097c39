//! Advice that can be taken: each option and key that a message of the verdict or of a registration names is one that its command takes.

use crate::common::{osteoflow, root};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

/// Where the messages are.
const SOURCES: [&str; 8] = [
    "nodes/bone/algorithms/src/trust",
    "nodes/bone/algorithms/src/coarse",
    "nodes/bone/algorithms/src/coarse.rs",
    "nodes/bone/algorithms/src/icp",
    "nodes/kinds/standard/src/verdict",
    "nodes/kinds/standard/src/coarse",
    "nodes/kinds/standard/src/icp",
    "nodes/kinds/standard/src/icp.rs",
];
/// Commands that a message may name before an option.
const COMMANDS: [&str; 3] = ["register", "view", "convert"];
/// Nodes and tables by which a message names a key.
const BEGINNINGS: [&str; 11] =
    ["rules", "examine", "errors", "verdict", "bone", "scan", "crop", "ct_surface", "coarse", "icp", "plan"];

/// The texts in quotation marks in the sources, without comments and tests.
fn literals() -> Vec<String> {
    fn read(path: &Path, all: &mut Vec<String>) {
        if path.is_dir() {
            let mut inside: Vec<_> = fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()).collect();
            inside.retain(|path| !path.ends_with("tests") && !path.ends_with("tests.rs"));
            inside.sort();
            return inside.iter().for_each(|path| read(path, all));
        }
        let text = fs::read_to_string(path).unwrap();
        let own = text.split("#[cfg(test)]").next().unwrap();
        // Examples of graphs are checked where they are printed.
        let parts = own.split("r#\"").enumerate();
        let own: String =
            parts.map(|(k, part)| if k == 0 { part } else { part.split_once("\"#").unwrap().1 }).collect();
        let code: Vec<&str> = own.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
        let mut chars = code.join("\n").chars().collect::<Vec<_>>().into_iter().peekable();
        while chars.find(|c| *c == '"').is_some() {
            let mut literal = String::new();
            while let Some(c) = chars.next().filter(|c| *c != '"') {
                match (c, chars.peek()) {
                    ('\\', Some('\n')) => while chars.next_if(|c| c.is_whitespace()).is_some() {},
                    ('\\', _) => literal.extend(chars.next()),
                    _ => literal.push(c),
                }
            }
            all.push(literal);
        }
    }
    let mut all = Vec::new();
    SOURCES.iter().map(|path| root().join(path)).filter(|path| path.exists()).for_each(|path| read(&path, &mut all));
    all
}

/// The words of a text that consist of these characters, each with what is before and after it.
fn words(text: &str, is_of_word: impl Fn(char) -> bool) -> Vec<(&str, &str, &str)> {
    let mut all = Vec::new();
    let mut from = 0;
    while let Some(begin) = text[from..].find(&is_of_word).map(|at| from + at) {
        let end = text[begin..].find(|c| !is_of_word(c)).map_or(text.len(), |at| begin + at);
        all.push((&text[..begin], &text[begin..end], &text[end..]));
        from = end;
    }
    all
}

/// The options that a text names, each with the command that it names last before it.
fn options(text: &str) -> Vec<(Option<&'static str>, String)> {
    let all = words(text, |c| c.is_ascii_lowercase() || c == '-').into_iter();
    let named = all.filter(|(_, word, _)| word.len() > 3 && word.starts_with("--"));
    named
        .map(|(before, word, _)| {
            let last = COMMANDS.into_iter().filter_map(|command| Some((before.rfind(command)?, command))).max();
            (last.map(|(_, command)| command), word.to_owned())
        })
        .collect()
}

/// The keys that a text names, each with the values that it may have.
fn keys(text: &str) -> Vec<(String, Vec<String>)> {
    let some = ["true", "0.25", "\"never\"", "\"laser\"", "[0.0, 0.0, 500.0]", "{}"].map(String::from).to_vec();
    let all = words(text, |c| c.is_ascii_lowercase() || c == '_' || c == '.').into_iter();
    all.filter_map(|(_, word, after)| {
        let word = word.trim_end_matches('.');
        let value: String =
            after.strip_prefix(" = ")?.chars().take_while(|c| c.is_alphanumeric() || *c == '.').collect();
        let is_value = ["true", "false"].contains(&value.as_str()) || value.parse::<f64>().is_ok();
        is_value.then(|| (word.to_owned(), vec![value.trim_end_matches('.').to_owned()]))
    })
    .chain(words(text, |c| c.is_ascii_lowercase() || c == '_' || c == '.').into_iter().filter_map(
        |(_, word, after)| {
            let word = word.trim_end_matches('.');
            let is_key = word.split_once('.').is_some_and(|(first, _)| BEGINNINGS.contains(&first));
            (is_key && !after.starts_with(" = t") && !after.starts_with(" = f"))
                .then(|| (word.to_owned(), some.clone()))
        },
    ))
    .collect()
}

fn help(command: &str) -> BTreeSet<String> {
    let output = osteoflow().args([command, "--help"]).output().unwrap();
    options(&String::from_utf8(output.stdout).unwrap()).into_iter().map(|(_, option)| option).collect()
}

/// Whether `view` knows an option: given without its value, the value is what it misses.
fn view_takes(option: &str) -> bool {
    let output = osteoflow().args(["view", "BONE", "SCAN", option]).output().unwrap();
    !String::from_utf8(output.stderr).unwrap().contains("unexpected argument")
}

/// Whether a shipped graph takes a key with one of these values, at the node that the message means.
fn is_taken(key: &str, values: &[String]) -> bool {
    let places = ["", "verdict.", "plan.", "bone.", "scan."].map(|node| format!("{node}{key}"));
    let takes = |graph: &str, set: String| {
        osteoflow().args(["check", graph, "--set", &set]).current_dir(root()).output().unwrap().status.success()
    };
    ["graphs/two_files.toml", "graphs/fibula_recorded.toml"]
        .into_iter()
        .any(|graph| places.iter().any(|place| values.iter().any(|value| takes(graph, format!("{place}={value}")))))
}

#[test]
fn every_option_and_key_that_a_message_of_the_verdict_advises_is_taken_by_its_command() {
    let known: BTreeMap<&str, BTreeSet<String>> =
        COMMANDS.into_iter().map(|command| (command, help(command))).collect();
    let registry = osteoflow_standard::registry();
    let (mut n_options, mut tried, mut wrong) = (0, BTreeMap::new(), Vec::new());
    for text in literals() {
        for (command, option) in options(&text) {
            n_options += 1;
            match command {
                // `view BONE SCAN` says the same, and takes the same, which its help leaves to that of `register`.
                Some("register") if !view_takes(&option) => wrong.push(format!("view has no {option}: {text}")),
                Some(command) if known[command].contains(&option) => {}
                Some(command) => wrong.push(format!("{command} has no {option}: {text}")),
                None => wrong.push(format!("{option} is of no command: {text}")),
            }
        }
        for (key, values) in keys(&text).into_iter().filter(|(key, _)| registry.kind(key).is_none()) {
            let taken = *tried.entry((key.clone(), values.clone())).or_insert_with(|| is_taken(&key, &values));
            if !taken {
                wrong.push(format!("no graph takes {key} = {values:?}: {text}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let all: Vec<&String> = tried.keys().map(|(key, _)| key).collect();
    assert!(n_options >= 12 && all.len() >= 10, "{n_options} options and the keys {all:?}");
    // What does not exist is noticed, in a message of several lines, too.
    assert_eq!(options("crop it (register: --box, --no-such)").pop(), Some((Some("register"), "--no-such".into())));
    assert!(!known["register"].contains("--no-such") && known["register"].contains("--box"));
    assert!(!view_takes("--no-such") && view_takes("--box"));
    let [(key, values)] = &keys("set rules.no_such = true")[..] else { panic!("one key") };
    assert!(!is_taken(key, values) && is_taken("rules.attitude_stated", &["true".into()]));
}
