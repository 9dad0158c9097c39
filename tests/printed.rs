//! What README and docs say that a command prints, and their numbers, are what it prints.
//!
//! A block `console` holds commands behind `$ `, each with what it prints; those of a page are run in its order, in one folder. Another
//! block of a page stands below a comment with its command, `<!-- printed: osteoflow ... -->`, and is compared as those of a page that
//! a test follows (tests/common/page.rs). A row of a table whose numbers a run gives stands below `<!-- numbers of: GRAPH -->`, with the setting in its first
//! cell. One command writes all of them anew: `UPDATE=1 cargo test --release --test suite printed::`.

use crate::common::{
    copy_folder, osteoflow,
    page::{fits, shortened, without_progress, words},
    root, run_whole,
};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

const ADVICE: &str = "`UPDATE=1 cargo test --release --test suite printed::` writes it anew";

fn is_update() -> bool {
    std::env::var_os("UPDATE").is_some()
}

/// Held by a test that writes pages anew, as two of them write the same ones.
static WRITING: Mutex<()> = Mutex::new(());

fn writing() -> Option<MutexGuard<'static, ()>> {
    is_update().then(|| WRITING.lock().unwrap_or_else(PoisonError::into_inner))
}

/// README.md and the pages of docs/.
fn pages() -> Vec<PathBuf> {
    let mut pages = vec![root().join("README.md")];
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false if path.extension().is_some_and(|ending| ending == "md") => pages.push(path),
                false => {}
            }
        }
    }
    pages.sort();
    pages
}

/// The text between two marks behind `from`, as a range of bytes.
fn between(text: &str, from: usize, open: &str, close: &str) -> std::ops::Range<usize> {
    let start = from + text[from..].find(open).unwrap_or_else(|| panic!("no {open:?}")) + open.len();
    let end = start + text[start..].find(close).unwrap_or_else(|| panic!("no {close:?}"));
    start..end
}

/// What a command prints on stderr and stdout, in an empty folder as OUT.
fn printed(command: &str) -> Vec<String> {
    let out = tempfile::tempdir().unwrap();
    let out = out.path().display().to_string();
    let mut text = String::new();
    for part in command.split(" && ") {
        let words: Vec<String> = part.split(' ').skip(1).map(|word| word.replace("OUT", &out)).collect();
        let output = osteoflow().args(&words).output().unwrap();
        // Of several commands the last is shown.
        text = [&output.stderr, &output.stdout].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
        assert!(output.status.code().is_some_and(|code| matches!(code, 0 | 2 | 3 | 4)), "{part}: {text}");
    }
    without_progress(&text).iter().map(|line| line.replace(&out, "OUT")).collect()
}

fn name(page: &Path) -> String {
    page.strip_prefix(root()).unwrap().display().to_string()
}

#[test]
fn what_the_pages_print_is_what_the_commands_print() {
    let _writing = writing();
    const MARK: &str = "<!-- printed: ";
    let mut n_blocks = 0;
    for page in pages() {
        let mut text = fs::read_to_string(&page).unwrap();
        let mut from = 0;
        while let Some(at) = text[from..].find(MARK).map(|at| from + at) {
            let command = text[between(&text, at, MARK, " -->")].to_owned();
            let block = between(&text, at, "```text\n", "```\n");
            let stated: Vec<String> = text[block.clone()].lines().map(str::to_owned).collect();
            let now = printed(&command);
            n_blocks += 1;
            from = block.start;
            if !fits(&stated, &now) {
                assert!(is_update(), "{}: {command}: {ADVICE}\n--- now\n{}", name(&page), now.join("\n"));
                text.replace_range(block, &(shortened(&stated, &now).join("\n") + "\n"));
            }
        }
        if is_update() {
            fs::write(&page, text).unwrap();
        }
    }
    assert!(n_blocks >= 5, "{n_blocks} blocks");
}

/// A command of a block `console`, and the lines below it.
struct Typed {
    command: String,
    /// Range of its lines among those of the page.
    lines: std::ops::Range<usize>,
}

/// The commands of the blocks `console` of a page, in its order.
fn typed(lines: &[String]) -> Vec<Typed> {
    let mut all: Vec<Typed> = Vec::new();
    let mut is_open = false;
    for (k, line) in lines.iter().enumerate() {
        match (line.as_str(), line.strip_prefix("$ ")) {
            ("```console", _) => is_open = true,
            ("```", _) => is_open = false,
            (_, Some(command)) if is_open => {
                all.push(Typed { command: command.to_owned(), lines: k + 1..k + 1 });
            }
            _ if is_open => all.last_mut().expect("a command comes first").lines.end = k + 1,
            _ => {}
        }
    }
    all
}

#[test]
fn what_the_consoles_of_the_pages_show_is_what_their_commands_print() {
    let _writing = writing();
    let mut n_commands = 0;
    for page in pages() {
        let mut lines: Vec<String> = fs::read_to_string(&page).unwrap().lines().map(str::to_owned).collect();
        let all = typed(&lines);
        if all.is_empty() {
            continue;
        }
        let folder = tempfile::tempdir().unwrap();
        copy_folder(&root().join("graphs"), &folder.path().join("graphs"));
        let mut code = 0;
        let mut answers = Vec::new();
        for Typed { command, .. } in &all {
            n_commands += 1;
            if command == "echo $?" {
                answers.push(vec![code.to_string()]);
                continue;
            }
            let words = words(command);
            assert_eq!(words[0], "osteoflow", "{}: {command}", name(&page));
            let output = osteoflow().args(&words[1..]).current_dir(folder.path()).output().unwrap();
            code = output.status.code().unwrap();
            let text =
                [&output.stderr, &output.stdout].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
            answers.push(without_progress(&text));
        }
        for (Typed { command, lines: at }, now) in all.iter().zip(answers).rev() {
            let stated = &lines[at.clone()];
            // A command without an answer prepares the next.
            if stated.is_empty() || fits(stated, &now) {
                continue;
            }
            assert!(is_update(), "{}: {command}: {ADVICE}\n--- now\n{}", name(&page), now.join("\n"));
            lines.splice(at.clone(), shortened(stated, &now));
        }
        if is_update() {
            fs::write(&page, lines.join("\n") + "\n").unwrap();
        }
    }
    assert!(n_commands >= 10, "{n_commands} commands");
}

/// The cells of a row of the README's table: mean TRE, iterations and what convergence leaves, by their own words.
fn cells(results: &Value) -> [String; 3] {
    let number = |path: &str| results.pointer(path).and_then(Value::as_f64).unwrap();
    let left = results["icp"]["left_mm"].as_f64().unwrap_or_else(|| number("/icp/remaining_mm"));
    let left = if left < 0.001 { "under 0.001 mm".into() } else { format!("{left:.2} mm") };
    [
        format!("{:.2} mm", number("/metrics/tre_true_mm/mean_abs/norm")),
        format!("{:.0}", number("/icp/iterations")),
        left,
    ]
}

#[test]
fn the_numbers_of_tables_are_those_of_the_runs() {
    let _writing = writing();
    const MARK: &str = "<!-- numbers of: ";
    let mut n_rows = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        let Some(at) = text.find(MARK) else { continue };
        let graph = text[between(&text, at, MARK, " -->")].to_owned();
        let table = text[at..].find("\n| ").map(|begin| at + begin + 1).unwrap();
        let end = text[table..].find("\n\n").map_or(text.len(), |end| table + end);
        let mut rows: Vec<String> = text[table..end].lines().map(str::to_owned).collect();
        let key = rows[0].split('`').nth(1).unwrap().to_owned();
        for row in rows.iter_mut().skip(2) {
            let value = row.split('`').nth(1).unwrap().to_owned();
            let ran = run_whole(&graph, &["--no-record", "--set", &format!("{key}={value}")]);
            let now = format!("| `{value}` | {} |", cells(&ran.results).join(" | "));
            n_rows += 1;
            assert!(is_update() || *row == now, "{}: {ADVICE}\n{row}\n{now}", name(&page));
            *row = now;
        }
        if is_update() {
            fs::write(&page, format!("{}{}{}", &text[..table], rows.join("\n"), &text[end..])).unwrap();
        }
    }
    assert_eq!(n_rows, 2);
}

/// The lines that a terminal of 100 columns shows of a text.
fn screen(text: &str) -> Vec<String> {
    let shown = |line: &str| {
        let characters: Vec<char> = line.chars().collect();
        match characters.is_empty() {
            true => vec![String::new()],
            false => characters.chunks(100).map(|row| row.iter().collect()).collect::<Vec<String>>(),
        }
    };
    text.lines().flat_map(shown).collect()
}

/// A sweep of two bones and three factors.
const SWEEP: &str = r#"extends = "GRAPH"
[graph]
name = "screen"
[node.recording]
camera.n_points = 3000
[node.bone]
exact = true
[sweep]
repeat = 1
units  = ["bone", "procedure"]
limit  = { tre_mm = 1.0 }
compare = { factor = "icp", to = "icp.point_to_plane", margin = { tre_mm = 0.2 } }
[sweep.factor]
bone  = { keys = ["recording.bone.shape_seed", "plan.bone.shape_seed", "bone.bone.shape_seed"], values = [1, 2] }
icp   = { key = "icp.kind", values = ["icp.point_to_point", "icp.point_to_plane"] }
noise = { key = "recording.camera.depth_noise_mm", values = [0.05, 0.2] }
[sweep.columns]
tre_mm      = "metrics.tre_true_mm.mean_abs.norm"
measured_mm = "metrics.tre_measured_mm.mean_abs.norm"
tilt_rad    = "metrics.cuts.cuts.plane_1.tilt_rad"
[sweep.points]
tre_true_mm = { from = "metrics.tre_true_mm.points" }
"#;

#[test]
fn each_answer_fits_on_a_screen_and_begins_with_what_is_asked() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    fs::write(at("sweep.toml"), SWEEP.replace("GRAPH", &root().join("graphs/fibula.toml").display().to_string()))
        .unwrap();
    let answer = |args: &[&str]| {
        let output = osteoflow().args(args).output().unwrap();
        let text = [&output.stderr, &output.stdout].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
        assert!(output.status.success(), "{args:?}: {text}");
        let shown = screen(&text);
        assert!(shown.len() <= 40, "{args:?} takes {} lines:\n{text}", shown.len());
        (shown, text)
    };
    let (run, text) = answer(&["run", "graphs/fibula.toml", "--out", &at("a")]);
    let mean = run.iter().position(|line| line.trim_start().starts_with("mean |.|")).unwrap();
    assert!(mean < 25, "TRE ends at line {}:\n{text}", mean + 1);
    assert_eq!(text.matches("assumed: ").count(), 3, "{text}");
    for word in ["verdict  trusted", "TRE ", "planes, latest", "results.json, manifest.json, run.mcap"] {
        assert!(text.contains(word), "{word} is missing:\n{text}");
    }
    for word in ["tilt_rad", "more numbers", "warning", "metrics."] {
        assert!(!text.contains(word), "{word} is for --verbose:\n{text}");
    }
    answer(&["register", "tests/data/folder/bone.stl", "tests/data/folder/scan.ply"]);
    answer(&["register", "tests/data/folder/bone.stl", "tests/data/folder/scan.ply", "--camera", "0,0,0"]);
    answer(&["run", "graphs/fibula.toml", "--set", "icp.kind=icp.point_to_point", "--out", &at("b")]);
    let (compared, text) = answer(&["compare", &at("a"), &at("b")]);
    let kind = compared.iter().position(|line| line.contains("icp.kind") && line.contains("icp.point_to_point"));
    assert!(kind.is_some_and(|line| line < 12), "{text}");
    let tre = compared.iter().position(|line| line.trim_start().starts_with("TRE, true, mean mm"));
    assert!(tre.is_some_and(|line| line < 25), "{text}");
    let (_, text) = answer(&["sweep", &at("sweep.toml"), "--out", &at("S")]);
    assert_eq!(text.matches("95 % interval").count(), 1, "one table:\n{text}");
    assert!(text.contains("tilt_deg") && !text.contains("tilt_rad") && text.contains("2 bones"), "{text}");
    for (name, kind) in [("mine", "icp.point_to_plane"), ("theirs", "icp.point_to_point")] {
        let set = format!("sweep.factor.icp.values=[\"{kind}\"]");
        let compare = ["--set", "remove=[\"sweep.compare\"]"];
        answer(&[&["sweep", &at("sweep.toml"), "--out", &at(name), "--set", &set], &compare[..]].concat());
    }
    let folders = [at("mine"), at("theirs")];
    let output = osteoflow().args(["compare", &folders[0], &folders[1]]).output().unwrap();
    let why = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && why.contains("--by icp.kind compares"), "{why}");
    let (_, text) = answer(&["compare", &folders[0], &folders[1], "--by", "icp.kind"]);
    assert!(text.contains("icp.point_to_plane -> icp.point_to_point"), "{text}");
    assert!(text.contains("sweep.factor.icp"), "what keeps them apart is named:\n{text}");
}
