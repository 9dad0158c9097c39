//! A page of the documentation that a test follows: its commands are run in the order of the page, and its printed blocks are what they print.
//!
//! A block `sh` holds commands, one a line (`\` continues a line, `#` begins a comment). A block `text` right below it is what the
//! command above printed, stdout and stderr in their order; `UPDATE=1` writes it. A line `..` of such a block stands for any lines.
//! Durations, sizes and times of day differ from run to run and are compared as if they were equal. A block `file NAME` is a file of
//! the reader's, which is written where the reader would write it.

use super::{osteoflow_to_spawn, program, root};
use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

/// A block of code: what follows the three marks, the number of its first line, and its lines.
#[derive(Clone, Debug)]
struct Block {
    kind: String,
    at: usize,
    lines: Vec<String>,
}

/// A command that has ended.
pub(crate) struct Done {
    pub(crate) command: String,
    pub(crate) code: i32,
    pub(crate) printed: String,
}

/// A page, and the folder in which a test follows it.
pub(crate) struct Page {
    name: String,
    lines: Vec<String>,
    /// The folder in which the next command is run.
    pub(crate) at: PathBuf,
    /// The interpreter of nodes in Python.
    interpreter: Option<PathBuf>,
    start: PathBuf,
    /// Arguments that a test adds to a command, so that it takes seconds.
    more: fn(&str) -> &'static [&'static str],
}

impl Page {
    /// A page by its path from the workspace's folder, which is followed in this folder.
    pub(crate) fn open(name: &str, folder: &Path, interpreter: Option<&Path>) -> Self {
        let text = fs::read_to_string(root().join(name)).unwrap();
        let lines = text.lines().map(str::to_owned).collect();
        let interpreter = interpreter.map(Path::to_owned);
        Self {
            name: name.to_owned(),
            lines,
            at: folder.to_owned(),
            interpreter,
            start: folder.to_owned(),
            more: |_| &[],
        }
    }

    /// With more arguments for some of its commands.
    pub(crate) fn adding(mut self, more: fn(&str) -> &'static [&'static str]) -> Self {
        self.more = more;
        self
    }

    fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut open: Option<Block> = None;
        for (k, line) in self.lines.iter().enumerate() {
            match (&mut open, line.strip_prefix("```")) {
                (None, Some(kind)) => open = Some(Block { kind: kind.to_owned(), at: k + 1, lines: Vec::new() }),
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (Some(block), None) => block.lines.push(line.clone()),
                (None, None) => {}
            }
        }
        blocks
    }

    /// Follows the page to its end. `expected` has the exit code of a command, and `while_served` is called with the address of the page
    /// that a command serves, before that command is interrupted.
    pub(crate) fn follow(
        &mut self,
        expected: impl Fn(&str) -> i32,
        mut while_served: impl FnMut(&str, &Path, &str),
    ) -> Vec<Done> {
        let mut all: Vec<Done> = Vec::new();
        let blocks = self.blocks();
        let mut wrong = Vec::new();
        let mut printed_blocks = Vec::new();
        for (k, block) in blocks.iter().enumerate() {
            if let Some(name) = block.kind.strip_prefix("file ") {
                fs::write(self.at.join(name), block.lines.join("\n") + "\n").unwrap();
            }
            if block.kind != "sh" {
                continue;
            }
            let mut last = None;
            for command in commands(&block.lines) {
                let done = self.run(&command, &mut while_served);
                let code = expected(&command);
                if done.code != code {
                    wrong.push(format!(
                        "{}: {command}: exit code {} instead of {code}\n{}",
                        self.name, done.code, done.printed
                    ));
                }
                last = Some(all.len());
                all.push(done);
            }
            if let (Some(next), Some(last)) = (blocks.get(k + 1), last)
                && next.kind == "text"
                && self.lines[block.at + block.lines.len() + 1..next.at - 1].iter().all(String::is_empty)
            {
                printed_blocks.push((next.clone(), all[last].printed.clone(), all[last].command.clone()));
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
        self.compare(&printed_blocks);
        all
    }

    fn compare(&self, printed_blocks: &[(Block, String, String)]) {
        let is_update = std::env::var_os("UPDATE").is_some();
        let mut lines = self.lines.clone();
        for (block, printed, command) in printed_blocks.iter().rev() {
            let now = without_progress(printed);
            if fits(&block.lines, &now) {
                continue;
            }
            assert!(
                is_update,
                "{}:{}: {command} prints something else; `UPDATE=1 cargo test --release --test suite guides::` rewrites the page\n--- now\n{printed}",
                self.name, block.at
            );
            lines.splice(block.at..block.at + block.lines.len(), shortened(&block.lines, &now));
        }
        if is_update {
            fs::write(root().join(&self.name), lines.join("\n") + "\n").unwrap();
        }
    }

    fn run(&mut self, command: &str, while_served: &mut impl FnMut(&str, &Path, &str)) -> Done {
        let words = words(command);
        let (first, rest) = (words[0].as_str(), &words[1..]);
        let done = |code, printed| Done { command: command.to_owned(), code, printed };
        match first {
            "cd" => {
                self.at = self.at.join(&rest[0]).canonicalize().unwrap_or_else(|e| panic!("{command}: {e}"));
                let start = self.start.canonicalize().unwrap();
                assert!(self.at.starts_with(&start), "{command} leaves the folder of the page");
                done(0, String::new())
            }
            // The packages are those of the interpreter of the tests.
            "python3" | "pip" if rest.iter().any(|word| word == "install") => done(0, String::new()),
            "osteoflow" => {
                let serves = rest[0] == "view" || rest.iter().any(|word| word == "--serve");
                let mut osteoflow = osteoflow_to_spawn();
                osteoflow
                    .current_dir(&self.at)
                    .args(rest)
                    .args((self.more)(command))
                    .env("OSTEOFLOW_CACHE", self.start.join("cache"));
                osteoflow.env_remove("OMP_NUM_THREADS");
                if let Some(interpreter) = &self.interpreter {
                    osteoflow.env("OSTEOFLOW_PYTHON", interpreter);
                }
                let (code, printed) =
                    if serves { self.served(command, osteoflow, while_served) } else { ended(osteoflow) };
                done(code, printed)
            }
            "python3" => {
                let mut python = Command::new(self.interpreter.as_deref().unwrap_or(Path::new("python3")));
                python
                    .current_dir(&self.at)
                    .args(rest)
                    .env("PYTHONDONTWRITEBYTECODE", "1")
                    .env("OSTEOFLOW_PROGRAM", program());
                let (code, printed) = ended(python);
                done(code, printed)
            }
            other => panic!("{}: the test cannot run `{other}` of `{command}`", self.name),
        }
    }

    /// Runs a command that serves until its run has ended, and interrupts it as a reader would.
    fn served(
        &self,
        command: &str,
        mut program: Command,
        while_served: &mut impl FnMut(&str, &Path, &str),
    ) -> (i32, String) {
        let mut child = program.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let mut said = Vec::new();
        let address = loop {
            let Some(line) = lines.next() else { return (code_of(&mut child), said.join("\n")) };
            let address =
                line.strip_prefix("page: ").and_then(|rest| rest.split_whitespace().next()).map(str::to_owned);
            said.push(line);
            if let Some(address) = address {
                break address;
            }
        };
        while_served(command, &self.at, &address);
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        said.extend(lines);
        let code = code_of(&mut child);
        (if code == 130 { 0 } else { code }, said.join("\n"))
    }
}

fn code_of(child: &mut Child) -> i32 {
    child.wait().unwrap().code().unwrap_or(-1)
}

/// The exit code of a program, and what it prints, as on a terminal.
fn ended(mut program: Command) -> (i32, String) {
    let (mut from, to) = std::io::pipe().unwrap();
    let mut child = program.stdin(Stdio::null()).stdout(to.try_clone().unwrap()).stderr(to).spawn().unwrap();
    // It holds the ends of the pipe, too.
    drop(program);
    let mut printed = String::new();
    std::io::Read::read_to_string(&mut from, &mut printed).unwrap();
    (code_of(&mut child), printed)
}

/// The commands of a block, each on one line, without comments.
fn commands(lines: &[String]) -> Vec<String> {
    let joined = lines.join("\n").replace("\\\n", " ");
    let bare = joined.lines().map(|line| line.split(" #").next().unwrap().trim());
    bare.filter(|line| !line.is_empty() && !line.starts_with('#'))
        .flat_map(|line| line.split(" && ").map(str::to_owned).collect::<Vec<_>>())
        .collect()
}

/// The words of a command, as a shell has them: quotes hold words together.
pub(crate) fn words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for c in command.chars() {
        match (quote, c) {
            (None, '\'' | '"') => quote = Some(c),
            (Some(open), c) if c == open => quote = None,
            (None, ' ') => words.push(String::new()),
            (_, c) => words.last_mut().unwrap().push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// A line without what differs from run to run: durations, sizes of files, and addresses.
fn steady(line: &str) -> String {
    const UNITS: [&str; 10] = ["ns", "µs", "ms", "s", "min", "h", "kB", "MB", "GB", "B"];
    let mut words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
    for k in 0..words.len() {
        let is_number = words[k].trim_matches(['(', ',', '~']).parse::<f64>().is_ok();
        let unit = words.get(k + 1).map(|unit| unit.trim_matches([',', ')', ';', ':', '.']).to_owned());
        if is_number && unit.is_some_and(|unit| UNITS.contains(&unit.as_str())) {
            words[k] = "#".to_owned();
        }
        if words[k].starts_with("http://127.0.0.1") || words[k].starts_with("ws://127.0.0.1") {
            words[k] = "#".to_owned();
        }
    }
    words.join(" ")
}

/// Rows of times, whose table says so in its head, `time ms`, and the line `time 609 ms: load 47.5, ..`.
fn without_times(lines: &[String]) -> Vec<String> {
    let mut is_of_times = false;
    let of_line = |line: &String| {
        let bare = steady(line);
        is_of_times = (is_of_times && !line.is_empty()) || bare.starts_with("time ms");
        if is_of_times && !bare.starts_with("time ms") || bare.starts_with("time # ms: ") {
            let number = |word: &str| word.trim_end_matches(',').parse::<f64>().is_ok();
            return bare.split(' ').map(|word| if number(word) { "#" } else { word }).collect::<Vec<_>>().join(" ");
        }
        bare
    };
    lines.iter().map(of_line).collect()
}

/// Whether two lines are the same but for the last digits of numbers, which are the processor's.
fn are_alike(a: &str, b: &str) -> bool {
    let words = |line: &str| -> Vec<String> {
        let words = line.split(|c: char| c.is_whitespace() || ",()".contains(c)).filter(|word| !word.is_empty());
        words.map(str::to_owned).collect()
    };
    let is_near = |(a, b): (&String, &String)| match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => (a - b).abs() <= 1e-4 * a.abs().max(b.abs()) + 2e-3,
        _ => a == b,
    };
    let (a, b) = (words(a), words(b));
    a.len() == b.len() && a.iter().zip(&b).all(is_near)
}

/// The lines that were printed, but for those that say how far the work is: on a fast machine there are none.
pub(crate) fn without_progress(printed: &str) -> Vec<String> {
    let shown = printed.lines().filter(|line| !line.contains(" nodes have worked, "));
    shown.map(|line| line.trim_end().to_owned()).collect()
}

/// Whether a block is what was printed; its lines `..` stand for any lines.
pub(crate) fn fits(block: &[String], printed: &[String]) -> bool {
    let (block, printed) = (without_times(block), without_times(printed));
    let begins = |lines: &[String], part: &[String]| {
        lines.len() >= part.len() && part.iter().zip(lines).all(|(a, b)| are_alike(a, b))
    };
    let mut at = 0;
    let mut parts = block.split(|line| line == "..").enumerate().peekable();
    while let Some((k, part)) = parts.next() {
        let rest = &printed[at..];
        let found = if k == 0 {
            begins(rest, part).then_some(0)
        } else if parts.peek().is_none() {
            rest.len().checked_sub(part.len()).filter(|&from| begins(&rest[from..], part))
        } else {
            (0..rest.len()).find(|&from| begins(&rest[from..], part))
        };
        let Some(found) = found else { return false };
        at += found + part.len();
    }
    block.iter().any(|line| line == "..") || at == printed.len()
}

/// What was printed, with the lines `..` of a block where they were, as far as the lines beside them are still there.
pub(crate) fn shortened(block: &[String], printed: &[String]) -> Vec<String> {
    let parts: Vec<&[String]> = block.split(|line| line == "..").collect();
    if parts.len() == 1 {
        return printed.to_vec();
    }
    // Lines before the first `..` and after the last are counted; between two of them, found by their first words.
    let n = printed.len();
    let (first, last) = (parts[0].len().min(n), parts[parts.len() - 1].len().min(n));
    let mut lines = printed[..first].to_vec();
    let head = |line: &str| line.split_whitespace().next().unwrap_or_default().to_owned();
    for part in &parts[1..parts.len() - 1] {
        lines.push("..".to_owned());
        for line in *part {
            lines.extend(printed[first..].iter().find(|found| head(found) == head(line)).cloned());
        }
    }
    lines.push("..".to_owned());
    lines.extend_from_slice(&printed[(n - last).max(first)..]);
    lines
}

#[test]
fn a_block_fits_what_was_printed_but_for_times_and_left_out_lines() {
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    let printed = lines("written after 1.06 s\nTRE 0.18 mm\n\ntime  ms\n  load  25.6\n\nend");
    for (block, does_fit) in [
        ("written after 2 s\nTRE 0.18 mm\n\ntime  ms\n  load  99\n\nend", true),
        ("written after 2 s\n..\nend", true),
        ("written after 2 s\n..\ntime ms\n  load 1\n..\nend", true),
        ("written after 2 s\nTRE 0.19 mm\n..\nend", false),
        ("written after 2 s\nTRE 0.1801 mm\n..\nend", true),
        ("written after 2 s\n..\nload 1 mm\n..\nend", false),
        ("written after 2 s\nTRE 0.18 mm", false),
        ("..\nend", true),
        ("..\nwritten after 3 s", false),
    ] {
        assert_eq!(fits(&lines(block), &printed), does_fit, "{block}");
    }
    assert!(fits(&lines("time  609 ms: load 47.5, align 3"), &lines("time  8 ms: load 1, align 0.5")));
    let cut = lines("old\n..\nTRE 9 mm\n..\nend");
    assert_eq!(shortened(&cut, &printed), lines("written after 1.06 s\n..\nTRE 0.18 mm\n..\nend"));
    assert_eq!(commands(&lines("a b \\\n  c  # why\n# no\nd && e")), ["a b    c", "d", "e"]);
    assert_eq!(words("a --set 'x=[1, 2]'  b"), ["a", "--set", "x=[1, 2]", "b"]);
}
