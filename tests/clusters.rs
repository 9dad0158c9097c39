//! docs/use/clusters.md: its scripts for Slurm, run with a queue of our own, give the tables of one machine.

use crate::common::{osteoflow, program, root};
use std::{
    collections::BTreeMap,
    fs,
    os::unix::fs::{PermissionsExt, symlink},
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// Runs the tasks of an array in turn, the last first, as Slurm may.
const SBATCH: &str = r#"#!/bin/bash
set -euo pipefail
while [[ $1 == --* ]]; do
    case $1 in --parsable | --dependency=afterok:7) shift ;; *) echo "sbatch: $1?" >&2; exit 1 ;; esac
done
script=$1
shift
n=$(sed -n 's/^#SBATCH --array=1-//p' "$script")
if [ -z "$n" ]; then
    bash "$script" "$@" >&2
else
    for ((task = n; task >= 1; task--)); do SLURM_ARRAY_TASK_ID=$task SLURM_CPUS_PER_TASK=1 bash "$script" "$@" >&2; done
fi
echo 7
"#;

/// Plans on small bones: 12 runs that take a few milliseconds.
const STUDY: &str = r#"
[graph]
format = 1
name   = "study"

[node.plan]
kind         = "plan.simulated"
bone.edge_mm = 5.0

[results]
landmarks = "plan.landmarks"

[sweep]
repeat = 4

[sweep.factor]
shape = { key = "plan.bone.shape_seed", values = [1, 2, 3] }

[sweep.columns]
x_mm = "landmarks.P1.position_mm.0"
"#;

/// The blocks of docs/use/clusters.md for the shell.
fn blocks() -> Vec<String> {
    let page = fs::read_to_string(root().join("docs/use/clusters.md")).unwrap();
    let blocks = page.split("```sh\n").skip(1).map(|rest| rest.split("```").next().unwrap().to_owned());
    blocks.collect()
}

/// A folder with the scripts, a study, and a queue.
struct Desk(tempfile::TempDir);

impl Desk {
    fn new(study: &str) -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        fs::create_dir(desk.path("bin")).unwrap();
        symlink(program(), desk.path("bin/osteoflow")).unwrap();
        fs::write(desk.path("bin/sbatch"), SBATCH).unwrap();
        fs::set_permissions(desk.path("bin/sbatch"), fs::Permissions::from_mode(0o755)).unwrap();
        for name in ["sweep.sbatch", "merge.sbatch"] {
            let begin = format!("#!/bin/bash\n# {name}: ");
            let of_name: Vec<_> = blocks().into_iter().filter(|block| block.starts_with(&begin)).collect();
            assert_eq!(of_name.len(), 1, "docs/use/clusters.md has {name}");
            fs::write(desk.path(name), &of_name[0]).unwrap();
        }
        fs::write(desk.path("study.toml"), study).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn bash(&self, script: &str, task: Option<u32>) -> Output {
        let path = std::env::var_os("PATH").unwrap();
        let path = std::iter::once(self.path("bin")).chain(std::env::split_paths(&path));
        let mut command = Command::new("bash");
        command.args(["-euo", "pipefail", "-c", script]).current_dir(self.0.path());
        command.env("PATH", std::env::join_paths(path).unwrap()).env("OSTEOFLOW_CACHE", "off");
        if let Some(task) = task {
            command.env("SLURM_ARRAY_TASK_ID", task.to_string());
        }
        command.output().unwrap()
    }

    fn ran(&self, script: &str, task: Option<u32>) {
        let output = self.bash(script, task);
        assert!(output.status.success(), "{script}: {}", String::from_utf8_lossy(&output.stderr));
    }

    /// The files of a sweep, except sweep.json, which names the machines, and times.
    fn files(&self, name: &str) -> BTreeMap<PathBuf, Vec<u8>> {
        let (dir, mut all) = (self.path(name), BTreeMap::new());
        for folder in [dir.clone(), dir.join("runs")] {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_file() && !path.ends_with("sweep.json") && !path.ends_with("times.csv") {
                    all.insert(path.strip_prefix(&dir).unwrap().to_owned(), fs::read(&path).unwrap());
                }
            }
        }
        all
    }

    fn assert_same(&self, name: &str, other: &str) {
        let (ours, others) = (self.files(name), self.files(other));
        assert!(ours.keys().eq(others.keys()), "{:?} and {:?}", ours.keys(), others.keys());
        for (path, bytes) in &ours {
            assert_eq!(String::from_utf8_lossy(bytes), String::from_utf8_lossy(&others[path]), "{}", path.display());
        }
        assert!(ours.contains_key(Path::new("runs.csv")) && ours.contains_key(Path::new("summary.json")));
    }
}

/// The commands that submit both scripts.
fn submit() -> String {
    let commands: Vec<_> = blocks().into_iter().filter(|block| block.contains("sbatch --parsable")).collect();
    assert_eq!(commands.len(), 1);
    commands[0].clone()
}

#[test]
fn the_job_array_and_the_merge_give_the_tables_of_one_machine_also_after_a_task_was_killed() {
    let desk = Desk::new(STUDY);
    // Task 3 was killed between its runs, task 5 before its first.
    let task = "bash sweep.sbatch study.toml study";
    desk.ran(task, Some(3));
    let runs: Vec<_> = fs::read_dir(desk.path("study.parts/3/runs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|p| p.is_file())
        .collect();
    assert_eq!(runs.len(), 12 * 3 / 8 - 12 * 2 / 8);
    fs::remove_file(&runs[0]).unwrap();
    fs::remove_file(desk.path("study.parts/3/runs.csv")).unwrap();
    fs::create_dir_all(desk.path("study.parts/5/runs")).unwrap();
    fs::write(desk.path("study.parts/5/sweep.toml"), "half").unwrap();
    desk.ran(&submit(), None);
    osteoflow().current_dir(desk.0.path()).args(["sweep", "study.toml", "--out", "alone"]).assert().success();
    desk.assert_same("study", "alone");
}

#[test]
fn a_missing_shard_and_one_of_another_graph_are_named_by_the_merge() {
    let desk = Desk::new(STUDY);
    desk.ran(&submit(), None);
    fs::rename(desk.path("study.parts/2"), desk.path("aside")).unwrap();
    let merge = |out: &str| {
        let output = desk.bash(&format!("mv study.parts {out}.parts; bash merge.sbatch {out}; "), None);
        assert_eq!(output.status.code(), Some(2));
        fs::rename(desk.path(&format!("{out}.parts")), desk.path("study.parts")).unwrap();
        String::from_utf8(output.stderr).unwrap()
    };
    let message = merge("missing");
    assert!(message.contains("2 of 12 runs are in none of the folders, the first is run 1"), "{message}");
    fs::write(desk.path("study.toml"), STUDY.replace("5.0", "4.0")).unwrap();
    desk.ran("bash sweep.sbatch study.toml study", Some(2));
    let message = merge("other");
    assert!(
        message.contains("2 holds another sweep: [node.plan] bone.edge_mm: it 4.0, the other 5.0; its hash is "),
        "{message}"
    );
    let json = fs::read_to_string(desk.path("study.parts/2/sweep.json")).unwrap();
    let mut about: serde_json::Value = serde_json::from_str(&json).unwrap();
    about["program_sha256"] = "0".into();
    fs::write(desk.path("study.parts/2/sweep.json"), about.to_string()).unwrap();
    let message = merge("build");
    assert!(message.contains("program, sha256: it 0, the other "), "{message}");
    about["engine_version"] = "0.0.9".into();
    fs::write(desk.path("study.parts/2/sweep.json"), about.to_string()).unwrap();
    let message = merge("version");
    assert!(message.contains("program, version: it 0.0.9, the other 0.2.0;"), "{message}");
}

#[test]
fn shards_without_results_or_runs_are_no_failed_jobs() {
    let graph = root().join("graphs/two_files.toml");
    let sweep = "[sweep]\n[sweep.factor]\npairs = { key = \"icp.max_pair_distance_mm\", values = [5.0, 0.001] }\n";
    let desk = Desk::new(&format!("extends = {:?}\n{sweep}[sweep.columns]\nrms_mm = \"icp.rms_mm\"\n", graph));
    desk.ran(&submit(), None);
    osteoflow().current_dir(desk.0.path()).args(["sweep", "study.toml", "--out", "alone"]).assert().success();
    desk.assert_same("study", "alone");
    let table = String::from_utf8(desk.files("study")[Path::new("runs.csv")].clone()).unwrap();
    assert!(table.contains("complete") && table.contains("refused"), "{table}");
}

#[test]
fn the_script_has_as_many_shards_as_the_array_has_tasks() {
    let blocks = blocks().concat();
    let number = |before: &str| blocks.split(before).nth(1).unwrap().split([' ', '\n']).next().unwrap().to_owned();
    assert_eq!(number("\nshards="), number("#SBATCH --array=1-"));
}
