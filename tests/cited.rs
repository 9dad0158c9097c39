//! What others cite and join by: CITATION.cff, codemeta.json, the paper, and the forms for issues.

use crate::common::root;
use serde_json::Value;
use std::{collections::BTreeSet, fs, path::PathBuf};
use yaml_rust2::{Yaml, YamlLoader};

fn text(file: &str) -> String {
    fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

fn yaml(text: &str) -> Yaml {
    YamlLoader::load_from_str(text).unwrap().remove(0)
}

fn texts(list: &Yaml) -> Vec<&str> {
    list.as_vec().unwrap().iter().map(|item| item.as_str().unwrap()).collect()
}

#[test]
fn codemeta_the_citation_and_the_manifest_say_the_same() {
    let (codemeta, citation) =
        (serde_json::from_str::<Value>(&text("codemeta.json")).unwrap(), yaml(&text("CITATION.cff")));
    let manifest: toml::Table = text("Cargo.toml").parse().unwrap();
    let package = manifest["workspace"]["package"].as_table().unwrap();
    let version = env!("CARGO_PKG_VERSION");
    assert_eq!((codemeta["version"].as_str(), citation["version"].as_str()), (Some(version), Some(version)));
    assert!(citation["title"].as_str().unwrap().starts_with(&format!("{}: ", codemeta["name"].as_str().unwrap())));
    let licences = texts(&citation["license"]);
    let of_codemeta: Vec<_> = codemeta["license"]
        .as_array()
        .unwrap()
        .iter()
        .map(|url| url.as_str().unwrap().rsplit('/').next().unwrap())
        .collect();
    assert_eq!(of_codemeta, licences);
    assert_eq!(package["license"].as_str().unwrap(), licences.join(" OR "));
    let repository = citation["repository-code"].as_str();
    assert_eq!((codemeta["codeRepository"].as_str(), package["repository"].as_str()), (repository, repository));
    let author = citation["authors"][0]["name"].as_str();
    assert_eq!((codemeta["author"][0]["name"].as_str(), package["authors"][0].as_str()), (author, author));
    let keywords: Vec<_> = codemeta["keywords"].as_array().unwrap().iter().map(|word| word.as_str().unwrap()).collect();
    assert_eq!(keywords, texts(&citation["keywords"]));
}

/// The head of the paper, and its text.
fn paper() -> (Yaml, String) {
    let paper = text("docs/paper/paper.md");
    let (head, body) = paper.strip_prefix("---\n").unwrap().split_once("\n---\n").unwrap();
    (yaml(head), body.to_owned())
}

#[test]
fn the_paper_has_the_head_the_sections_and_the_length_that_its_journal_asks_for() {
    let ((head, body), citation) = (paper(), yaml(&text("CITATION.cff")));
    assert_eq!(head["title"].as_str(), citation["title"].as_str());
    assert_eq!(head["authors"][0]["name"].as_str(), citation["authors"][0]["name"].as_str());
    assert_eq!(head["authors"][0]["affiliation"].as_i64(), head["affiliations"][0]["index"].as_i64());
    let tags: BTreeSet<_> = texts(&head["tags"]).into_iter().collect();
    assert!(texts(&citation["keywords"]).iter().all(|word| tags.contains(word)), "{tags:?}");
    let sections: Vec<_> = body.lines().filter_map(|line| line.strip_prefix("# ")).collect();
    let asked = [
        "Summary",
        "Statement of need",
        "State of the field",
        "Software design",
        "Research impact statement",
        "AI usage disclosure",
        "Acknowledgements",
        "References",
    ];
    assert_eq!(sections, asked);
    let n_words = body.split_whitespace().count();
    assert!((750..=1000).contains(&n_words), "{n_words} words");
}

#[test]
fn each_reference_of_the_paper_is_cited_and_has_a_doi() {
    let (head, body) = paper();
    let entries = text(&format!("docs/paper/{}", head["bibliography"].as_str().unwrap()));
    let mut listed = BTreeSet::new();
    for entry in entries.split("\n@").map(|entry| entry.trim_start_matches('@')) {
        let key = entry.split_once('{').unwrap().1.split_once(',').unwrap().0;
        let field = |name: &str| {
            let line = entry.lines().find(|line| line.trim_start().starts_with(&format!("{name} ")))?;
            Some(line.split_once('{').unwrap().1.trim_end_matches(',').trim_end_matches('}').to_owned())
        };
        let doi = field("doi").unwrap_or_else(|| panic!("{key} has no DOI"));
        assert!(doi.starts_with("10.") && doi.contains('/') && !doi.contains(' '), "{key}: {doi}");
        let year = field("year").unwrap();
        assert!(key.ends_with(&year) && field("author").is_some() && field("title").is_some(), "{key}: {year}");
        assert!(listed.insert(key.to_owned()), "{key} is listed twice");
    }
    let is_key = |c: char| c.is_ascii_alphanumeric();
    let cited: BTreeSet<_> =
        body.split('@').skip(1).map(|rest| rest.split(|c| !is_key(c)).next().unwrap().to_owned()).collect();
    assert_eq!(cited, listed);
}

#[test]
fn figures_of_the_paper_are_those_of_the_pages() {
    let body = paper().1.replace('\n', " ");
    for (figure, page, there) in [
        (
            "all 42 right poses were found and given, none of them trusted",
            "docs/method/real-data.md",
            "Of the poses 42 are right, all of them given, doubtful",
        ),
        (
            "none of 21 mirrored ones was trusted",
            "docs/method/real-data.md",
            "of the 7 mirrored ones of the pelvis none is trusted, and the 14 mirrored femurs are refused",
        ),
        ("9 of 226 wrong poses were trusted", "docs/method/trustbench.md", "Trusted and wrong: 9 of 226 (4.0 %)"),
        ("55 % of the right ones", "docs/method/trustbench.md", "Of right poses 87 % are given, 55 % trusted."),
    ] {
        assert!(body.contains(figure), "the paper does not say: {figure}");
        assert!(text(page).contains(there), "{page} does not say: {there}");
    }
}

fn forms() -> Vec<PathBuf> {
    let mut forms: Vec<_> =
        fs::read_dir(root().join(".github/ISSUE_TEMPLATE")).unwrap().map(|entry| entry.unwrap().path()).collect();
    forms.retain(|form| !form.ends_with("config.yml"));
    forms.sort();
    forms
}

#[test]
fn forms_for_issues_are_as_the_service_reads_them() {
    assert_eq!(forms().len(), 3);
    for file in forms() {
        let form = yaml(&fs::read_to_string(&file).unwrap());
        let name = file.display();
        assert!(form["name"].as_str().is_some() && form["description"].as_str().is_some(), "{name}");
        let mut ids = BTreeSet::new();
        for item in form["body"].as_vec().unwrap() {
            let (kind, attributes) = (item["type"].as_str().unwrap(), &item["attributes"]);
            match kind {
                "markdown" => assert!(attributes["value"].as_str().is_some(), "{name}"),
                "input" | "textarea" | "dropdown" | "checkboxes" => {
                    assert!(attributes["label"].as_str().is_some(), "{name}");
                    assert!(ids.insert(item["id"].as_str().unwrap()), "{name}: an id is given twice");
                    let has_options = attributes["options"].as_vec().is_some_and(|options| !options.is_empty());
                    assert_eq!(has_options, ["dropdown", "checkboxes"].contains(&kind), "{name}");
                }
                other => panic!("{name}: {other}"),
            }
        }
    }
}

#[test]
fn pages_and_commands_that_the_forms_name_are_there() {
    let help = String::from_utf8(crate::common::osteoflow().arg("--help").output().unwrap().stdout).unwrap();
    let manifest = |text: &str| text.contains("manifest.json");
    assert!(forms().iter().any(|file| manifest(&fs::read_to_string(file).unwrap())));
    let more = ["CODE_OF_CONDUCT.md", "ISSUE_TEMPLATE/config.yml"].map(|file| root().join(".github").join(file));
    for file in forms().into_iter().chain(more) {
        let form = fs::read_to_string(&file).unwrap();
        let name = file.display();
        for (at, _) in form.match_indices("docs/") {
            let page = form[at..].split(|c: char| !(c.is_ascii_alphanumeric() || "/-_.".contains(c))).next().unwrap();
            assert!(root().join(page).exists(), "{name}: {page}");
        }
        for command in form.split("`osteoflow ").skip(1).map(|rest| rest.split([' ', '`']).next().unwrap()) {
            let is_there = command == "--version" || help.contains(&format!("\n  {command} "));
            assert!(is_there, "{name}: osteoflow {command}");
        }
        let security = text("SECURITY.md");
        for url in form
            .split("https://github.com/osteoflow/osteoflow/security")
            .skip(1)
            .map(|rest| rest.split(['>', '\n']).next().unwrap())
        {
            assert!(security.contains(&format!("osteoflow/security{url}")), "{name}: {url}");
        }
        assert!(!form.contains("mailto:"), "{name} has an address");
    }
}
