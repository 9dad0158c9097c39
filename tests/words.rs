//! How much there is to read: the length of a sentence on the first pages, the words of each, and those of all pages and the help.

use crate::{common::root, glossary::help};
use std::{collections::BTreeMap, fs, process::Command};

/// Half of the sentences of a page have at most this number of words: its reader speaks another language, and reads once.
const MEDIAN: usize = 16;
/// At most this share of a page's sentences has `LONG` words or more.
const SHARE: f64 = 0.05;
const LONG: usize = 32;
const FOLDER: &str = "docs/begin/";
/// Maximum number of words of a page of this folder, code and tables included.
const BEGIN: [(&str, usize); 10] = [
    ("can-i-trust-it.md", 1120),
    ("first-week.md", 1740),
    ("frames-and-units.md", 1640),
    ("glossary.md", 1860),
    ("own-camera.md", 1040),
    ("pictures.md", 460),
    ("register.md", 1970),
    ("viewing.md", 2220),
    ("when-a-run-fails.md", 1890),
    ("which-number.md", 1040),
];
/// Maximum number of words of README, changelog, docs and the help of all commands together.
const ALL: usize = 120_000;
/// The name of the help among the pages.
const HELP: &str = "--help";

/// The text of a page without code blocks, tables, headings, pictures, quotes and comments; a part for each paragraph or item of a list.
fn paragraphs(page: &str) -> Vec<String> {
    let (mut all, mut is_code) = (vec![String::new()], false);
    for line in page.lines().map(str::trim) {
        let is_fence = line.starts_with("```");
        is_code ^= is_fence;
        let is_other =
            is_fence || line.is_empty() || ["|", "#", "<!--", "![", "> "].iter().any(|mark| line.starts_with(mark));
        if is_code || is_other {
            all.push(String::new());
            continue;
        }
        let (marker, rest) = line.split_once(' ').unwrap_or((line, ""));
        let is_number = marker.strip_suffix('.').is_some_and(|number| number.parse::<u32>().is_ok());
        let is_item = marker == "-" || is_number;
        if is_item {
            all.push(String::new());
        }
        let paragraph = all.last_mut().unwrap();
        paragraph.push(' ');
        paragraph.push_str(if is_item { rest } else { line });
    }
    all.retain(|paragraph| !paragraph.trim().is_empty());
    all
}

/// A paragraph whose code is one word, and whose links are their texts.
fn plain(paragraph: &str) -> String {
    let without_code: String =
        paragraph.split('`').enumerate().map(|(k, part)| if k % 2 == 0 { part } else { "code" }).collect();
    let mut links = without_code.split("](");
    let mut text = links.next().unwrap().to_owned();
    for rest in links {
        text += rest.split_once(')').map_or(rest, |(_, after)| after);
    }
    text.replace(".md", "").replace(['[', ']', '*'], "")
}

/// Numbers of words of the sentences of a page.
fn sentences(page: &str) -> Vec<usize> {
    let mut lengths = Vec::new();
    for paragraph in paragraphs(page) {
        let mut n_words = 0;
        for word in plain(&paragraph).split_whitespace() {
            n_words += 1;
            if word.trim_end_matches([')', '"']).ends_with(['.', '!', '?']) {
                lengths.push(n_words);
                n_words = 0;
            }
        }
        // An item of a list or a line before a block has no full stop.
        if n_words > 0 {
            lengths.push(n_words);
        }
    }
    lengths
}

/// Median length, and the share of the sentences that are long.
fn median_and_long(lengths: &[usize]) -> (usize, f64) {
    let mut sorted = lengths.to_vec();
    sorted.sort_unstable();
    let n_long = sorted.iter().filter(|length| **length >= LONG).count();
    (sorted.get(sorted.len() / 2).copied().unwrap_or(0), n_long as f64 / sorted.len().max(1) as f64)
}

/// What is wrong with pages of these numbers of words.
fn faults(pages: &BTreeMap<String, usize>) -> Vec<String> {
    let mut faults = Vec::new();
    for (name, most) in BEGIN {
        match pages.get(&format!("{FOLDER}{name}")) {
            Some(n) if *n > most => faults.push(format!("{name} has {n} words of {most}")),
            Some(_) => {}
            None => faults.push(format!("{name} is gone")),
        }
    }
    for name in pages.keys().filter_map(|path| path.strip_prefix(FOLDER)) {
        if BEGIN.iter().all(|(known, _)| *known != name) {
            faults.push(format!("{name} has no number of words"));
        }
    }
    let is_read = |path: &str| path.starts_with("docs/") || ["README.md", "CHANGELOG.md", HELP].contains(&path);
    let all: usize = pages.iter().filter(|(path, _)| is_read(path)).map(|(_, n)| n).sum();
    if all > ALL {
        faults.push(format!("all pages and the help have {all} words of {ALL}"));
    }
    faults
}

#[test]
fn sentences_of_the_first_pages_are_short() {
    let pages = BEGIN.map(|(name, _)| format!("{FOLDER}{name}"));
    let mut n_all = 0;
    for page in pages.iter().map(String::as_str).chain(["README.md"]) {
        let lengths = sentences(&fs::read_to_string(root().join(page)).unwrap());
        n_all += lengths.len();
        let (median, long) = median_and_long(&lengths);
        assert!(
            median <= MEDIAN && long <= SHARE,
            "{page}: half of {} sentences have up to {median} words, {:.1} % {LONG} or more",
            lengths.len(),
            100.0 * long
        );
    }
    assert!(n_all > 400, "{n_all} sentences");
}

#[test]
fn pages_have_at_most_so_many_words() {
    let output = Command::new(root().join(".ci/product_lines")).arg("--files").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let files = String::from_utf8(output.stdout).unwrap();
    let rows = files.lines().filter_map(|line| line.strip_prefix("documentation ")?.split_once(' '));
    let mut pages: BTreeMap<_, _> = rows.map(|(n, path)| (path.to_owned(), n.parse().unwrap())).collect();
    assert!(pages.len() > 100, "{} pages", pages.len());
    let n_help = help().split_whitespace().count();
    assert!(n_help > 5_000, "{n_help} words of help");
    pages.insert(HELP.into(), n_help);
    let faults = faults(&pages);
    assert!(faults.is_empty(), "say it in fewer words, or raise the number and say why: {faults:#?}");
}

#[test]
fn code_links_tables_and_numbers_end_no_sentence_and_a_long_one_is_seen() {
    for (page, expected) in [
        ("One two three. Four five!", &[3, 2][..]),
        ("It is 0.5 mm off.", &[5]),
        ("Write `a.b. c` here.", &[3]),
        ("See [the page.md](x/y.md#a.b), then go on.", &[6]),
        ("**Bold.** And (a word).\n", &[1, 3]),
        ("- one two\n- three four five\n  six\n1. seven\n> quoted words\n", &[2, 4, 1]),
        (
            "# A heading. Two\n\n| a cell. | b |\n|---|---|\n\n```sh\nsome code. more\n```\n![a. picture](b.png)\n<!-- a. comment -->\n",
            &[],
        ),
        ("before a block\n\n```sh\ncode\n```\n\nafter it.", &[3, 2]),
        ("one\ntwo\nthree.", &[3]),
    ] {
        assert_eq!(sentences(page), expected, "{page:?}");
    }
    let long = "word ".repeat(40) + "end.";
    assert_eq!(sentences(&long), [41]);
    let (median, share) = median_and_long(&[sentences(&long), vec![10; 9]].concat());
    assert!(median == 10 && (share - 0.1).abs() < 1e-12, "{median}, {share}");
}

#[test]
fn a_page_that_grows_is_new_or_gone_is_a_fault() {
    let mut pages: BTreeMap<_, _> = BEGIN.map(|(name, n)| (format!("{FOLDER}{name}"), n)).into();
    assert!(faults(&pages).is_empty());
    pages.insert(format!("{FOLDER}register.md"), 1971);
    pages.insert(format!("{FOLDER}new.md"), 1);
    pages.remove(&format!("{FOLDER}viewing.md"));
    pages.insert(HELP.into(), ALL);
    pages.insert("tests/data/README.md".into(), ALL);
    let n: usize = pages.values().sum::<usize>() - ALL;
    let all = format!("all pages and the help have {n} words");
    let found = faults(&pages);
    for fault in ["register.md has 1971 words of 1970", "new.md has no number", "viewing.md is gone", &all] {
        assert!(found.iter().any(|said| said.contains(fault)), "{fault}: {found:?}");
    }
    assert_eq!(found.len(), 4, "{found:?}");
}
