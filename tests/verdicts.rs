//! The verdict on the results in every command that shows them. A plugin, compiled from C, gives the verdicts.

use crate::common::{build, json, osteoflow, root};
use serde_json::{Value, json};
use std::{env::consts::DLL_SUFFIX, fs, path::Path, process::Command};

/// What the plugin says, by the parameter `which` of its node.
fn verdicts() -> [Value; 4] {
    let reason = |rule: &str, answer: &str| json!({ "rule": rule, "answer": answer, "reason": format!("{rule} is odd"), "remedy": format!("look at {rule}") });
    let assessment = json!({ "mean_tre_mm": 0.5, "interval_mm": [0.25, 1.25] });
    [
        json!({
            "answer": "trusted", "sentence": "nothing is odd", "reasons": [], "assumptions": ["the bone is rigid"],
            "predicted": { "assessment": assessment },
        }),
        json!({ "answer": "doubtful", "reasons": [reason("overlap", "doubtful"), reason("rms", "doubtful")] }),
        json!({ "answer": "refused", "sentence": "two landmarks are swapped", "reasons": [reason("order", "refused")] }),
        json!({ "answer": "trusted" }),
    ]
}

const TRUSTED: &str = "judge.which=0";
const DOUBTFUL: &str = "judge.which=1";
const REFUSED: &str = "judge.which=2";
const LIE: &str = "judge.which=3";

/// A folder with the graph of the fibula, judged by the plugin.
struct Folder(tempfile::TempDir);

/// A finished command: its exit code, stdout and stderr.
struct Printed {
    code: i32,
    out: String,
    err: String,
}

impl Folder {
    /// `None` if there is no C compiler.
    fn new() -> Option<Self> {
        if let Err(error) = Command::new("cc").arg("--version").output() {
            println!("skipped: there is no C compiler here: {error}");
            return None;
        }
        let folder = Self(tempfile::tempdir().unwrap());
        let library = folder.0.path().join(format!("libjudge{DLL_SUFFIX}"));
        let literals = verdicts().map(|verdict| serde_json::to_string(&verdict.to_string()).unwrap());
        let says = format!("-DSAYS={}", literals.join(","));
        assert!(build::compile(Path::new("tests/plugins/judge.c"), &library, &[&says]), "there was a compiler");
        let base = root().join("graphs/fibula.toml");
        let graph = format!(
            "extends = {base:?}\nplugins = [\"judge\"]\n[node.judge]\nkind = \"test.judge\"\n[results]\n\
             verdict = \"judge.verdict\"\n[sweep.factor]\nwhich = {{ key = \"judge.which\", values = [0, 1, 2] }}\n\
             [sweep.columns]\ntre_mm = \"metrics.tre_true_mm.mean_abs.norm\"\nrule = \"verdict.reasons.0.rule\"\n"
        );
        fs::write(folder.0.path().join("judged.toml"), graph).unwrap();
        Some(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn command(&self, arguments: &[&str]) -> Printed {
        let output = osteoflow().args(arguments).output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Printed { code: output.status.code().unwrap(), out: text(&output.stdout), err: text(&output.stderr) }
    }

    /// Runs the graph into a folder with these settings.
    fn run(&self, into: &str, sets: &[&str], more: &[&str]) -> (Printed, Value) {
        let (graph, out) = (self.path("judged.toml"), self.path(into));
        let sets = sets.iter().flat_map(|set| ["--set", set]);
        let arguments: Vec<&str> =
            ["run", &graph, "--out", &out].into_iter().chain(sets).chain(more.iter().copied()).collect();
        let printed = self.command(&arguments);
        let results = Path::new(&out).join("results.json");
        assert!(results.is_file(), "{}", printed.err);
        (printed, json(&results))
    }
}

/// The keys of results that are poses, points or planes, and those of reports.
const WITHHELD: [&str; 3] = ["poses", "laser_points", "planes"];
const REPORTS: [&str; 3] = ["simulated", "icp", "metrics"];

#[test]
fn the_verdict_is_the_first_line_of_the_results_and_decides_what_is_left_of_them() {
    let Some(folder) = Folder::new() else { return };
    let reasons = "  - overlap is odd; look at overlap\n  - rms is odd; look at rms\n\n";
    let doubtful = "verdict  doubtful: overlap is odd; look at overlap\n  - rms is odd; look at rms\n\n".to_owned();
    let trusted = "verdict  trusted: nothing is odd\n  assumed: the bone is rigid\n\n";
    let required = "the result is doubtful, and [results] require = \"trusted\"";
    let remedy = "remove the doubts, or let doubtful results pass with require = \"doubtful\"";
    let cases: [(&[&str], i32, String, &str); 4] = [
        (&[TRUSTED], 0, trusted.into(), ""),
        (&[DOUBTFUL], 0, doubtful, ""),
        (
            &[DOUBTFUL, "results.require=trusted"],
            3,
            format!("verdict  refused: {required}; {remedy}\n{reasons}"),
            "the result is doubtful, and [results] require = \"trusted\"",
        ),
        (
            &[REFUSED],
            3,
            "verdict  refused: two landmarks are swapped\n  - order is odd; look at order\n\n".into(),
            "the result is refused",
        ),
    ];
    for (index, (sets, code, shown, refused)) in cases.iter().enumerate() {
        let (printed, results) = folder.run(&format!("run{index}"), sets, &["--no-record"]);
        assert_eq!(printed.code, *code, "{}", printed.err);
        let begins = format!("{shown}SIMULATED, ");
        assert!(printed.out.starts_with(&begins), "{}\ndoes not begin with\n{begins}", printed.out);
        let lines: Vec<_> = printed.err.lines().filter(|line| line.starts_with("refused: ")).collect();
        assert_eq!(lines.len(), usize::from(*code == 3), "{}", printed.err);
        for line in lines {
            assert!(line.ends_with(&format!("node \"judge\", item 0: {refused}")), "{line}");
        }
        let keys: Vec<_> = results.as_object().unwrap().keys().map(String::as_str).collect();
        assert_eq!(keys[..2], ["verdict", "notice"]);
        assert!(WITHHELD.iter().all(|key| keys.contains(key) == (*code == 0)), "{sets:?}: {keys:?}");
        assert!(REPORTS.iter().all(|key| keys.contains(key)), "{sets:?}: {keys:?}");
        assert_eq!(keys.contains(&"refused"), *code == 3);
        assert!(printed.out.contains("\nTRE"), "a report is shown: {}", printed.out);
        assert_eq!(printed.out.contains("laser points"), *code == 0, "{}", printed.out);
    }
    let (printed, results) = folder.run("lie", &[LIE], &["--no-record"]);
    assert_eq!((printed.code, results.get("icp")), (3, None), "{}", printed.err);
    let why = "node \"judge\", item 0: judge.verdict gives no verdict: \"reasons\" must be a list, found nothing";
    assert!(printed.err.contains(why) && !printed.out.contains("verdict"), "{}{}", printed.err, printed.out);
}

#[test]
fn colours_assumptions_and_json_are_given_where_asked_for() {
    let Some(folder) = Folder::new() else { return };
    for (which, colour) in [(TRUSTED, "\u{1b}[1;32mtrusted\u{1b}[0m"), (DOUBTFUL, "\u{1b}[1;33mdoubtful\u{1b}[0m")] {
        let (printed, _) = folder.run(which, &[which], &["--no-record", "--color", "always", "--verbose"]);
        assert!(printed.out.contains(&format!("verdict  {colour}: ")), "{}", printed.out);
        assert_eq!(printed.out.contains("\n  assumed: the bone is rigid\n"), which == TRUSTED, "{}", printed.out);
    }
    let (printed, results) = folder.run("json", &[REFUSED], &["--no-record", "--format", "json"]);
    let answer: Value = serde_json::from_str(&printed.out).unwrap();
    assert_eq!((printed.code, &answer["outcome"]["exit_code"]), (3, &3.into()));
    assert_eq!((&answer["verdict"], &answer["icp"]), (&results["verdict"], &results["icp"]));
    let remove = r#"remove=["node.verdict", "node.export", "results.verdict", "results.planes"]"#;
    let unjudged = crate::common::run("graphs/fibula.toml", &["--no-record", "--set", remove]);
    assert_eq!((unjudged.code, unjudged.results.get("verdict")), (0, None), "nothing judged it");
}

#[test]
fn a_replay_has_the_verdict_of_the_run_and_the_page_shows_no_picture_of_refused_results() {
    let Some(folder) = Folder::new() else { return };
    for (which, answer, code) in [(TRUSTED, "trusted", 0), (REFUSED, "refused", 3)] {
        let (printed, _) = folder.run(answer, &[which], &[]);
        assert_eq!(printed.code, code, "{}", printed.err);
        let dir = folder.path(answer);
        let replayed = folder.command(&["replay", &format!("{dir}/run.mcap")]);
        assert_eq!(replayed.code, code, "{}{}", replayed.out, replayed.err);
        assert!(replayed.out.contains(&format!("verdict  {answer}: ")), "{}", replayed.out);
        assert!(replayed.out.contains(", results equal"), "{}", replayed.out);

        assert_eq!(folder.command(&["report", &dir]).code, 0);
        let page = fs::read_to_string(format!("{dir}/report.html")).unwrap().replace("<wbr>", "");
        let head = page.split_once("The graph as run</h2>").unwrap().0;
        assert!(head.contains(&format!("<section class=\"verdict {answer}\"")), "{head}");
        let views = ["residuals", "points", "cuts", "fragment-in-place", "fragment-aligned"];
        for view in views.map(|view| format!("{dir}/figures/view-{view}.svg")) {
            assert_eq!(Path::new(&view).is_file(), answer == "trusted", "{view}");
        }
        let why = "is not shown: the result is refused.";
        assert_eq!(page.matches(why).count(), if answer == "refused" { 3 } else { 0 });
        assert_eq!(page.contains("two landmarks are swapped"), answer == "refused", "the reason is said");
        assert_eq!(page.contains("0.250\u{a0}to\u{a0}1.250<"), answer == "trusted", "the predicted interval");
        assert!(page.contains("figure-2") && page.contains("Convergence of the fine registration"), "how it went");
    }
}

#[test]
fn a_sweep_counts_the_verdicts_and_keeps_refused_runs_out_of_its_statistics() {
    let Some(folder) = Folder::new() else { return };
    let (graph, out) = (folder.path("judged.toml"), folder.path("swept"));
    let swept = folder.command(&["sweep", &graph, "--out", &out, "--set", "sweep.repeat=2"]);
    assert_eq!(swept.code, 0, "{}", swept.err);
    assert!(!swept.err.contains("has no value"), "{}", swept.err);
    let rows = fs::read_to_string(format!("{out}/runs.csv")).unwrap();
    let rows: Vec<_> = rows.lines().map(|row| row.splitn(9, ',').collect::<Vec<_>>()).collect();
    assert_eq!(rows[0], ["run", "which", "repeat", "seed", "status", "verdict", "tre_mm", "rule", "reason"]);
    for (row, expected) in rows[1..].iter().zip(["trusted", "trusted", "doubtful", "doubtful", "refused", "refused"]) {
        assert_eq!(row[5], expected);
        assert!(row[6].parse::<f64>().unwrap() > 0.0, "the error of every answer, mm: {row:?}");
    }
    assert_eq!([rows[1][7], rows[3][7], rows[5][7]], ["", "overlap", "order"]);
    assert!(rows[5][8].ends_with("the result is refused: order is odd; look at order\""), "{:?}", rows[5]);

    let summary = json(Path::new(&format!("{out}/summary.json")));
    assert_eq!(summary["verdicts"], json!({ "trusted": 2, "doubtful": 2, "refused": 2 }));
    let groups = summary["groups"].as_array().unwrap();
    for (group, answer) in groups.iter().zip(["trusted", "doubtful", "refused"]) {
        let counts = ["trusted", "doubtful", "refused"].map(|of| group["verdicts"][of].as_u64().unwrap());
        assert_eq!(counts.iter().sum::<u64>(), 2, "{group}");
        assert_eq!(group["verdicts"][answer], 2);
        assert_eq!(group["columns"]["tre_mm"]["n"].as_u64(), (answer != "refused").then_some(2), "{group}");
        // A setting whose runs were all refused has a row, too.
        let remark = format!("  2 {answer}\n");
        assert_eq!(swept.out.contains(&remark), answer != "trusted", "{}", swept.out);
    }
    assert!(swept.out.contains("verdicts: 2 trusted, 2 doubtful, 2 refused\n"), "{}", swept.out);

    assert_eq!(folder.command(&["report", &out]).code, 0);
    let page = fs::read_to_string(format!("{out}/report.html")).unwrap().replace("<wbr>", "");
    let table = page.split("<table>").find(|table| table.contains("Verdicts on the results")).unwrap();
    let cells = ["which", "runs", "trusted", "doubtful", "refused"].map(|head| table.find(&format!(">{head}</th>")));
    assert!(cells.iter().all(Option::is_some), "{table}");
    let compared = folder.command(&["compare", &out, &out]);
    assert_eq!(compared.code, 0, "{}", compared.err);
    assert!(!compared.out.contains("which = 2"), "refused runs are no pairs: {}", compared.out);
}
