//! More repeats for a sweep that has ended.

use super::*;

/// A sweep with a draw and this many repeats.
fn repeats(n: usize) -> String {
    let sweep = SIX.replace("repeat = 3", &format!("repeat = {n}\ntwice = 0.2"));
    graph(
        "sweep-growth",
        &format!("{sweep}[sweep.draw]\nstamp = {{ key = \"scan.calls[0].stamp_ns\", integers = [1, 9] }}\n"),
    )
}

impl Desk {
    fn set_repeats(&self, n: usize) {
        fs::write(&self.graph, repeats(n)).unwrap();
    }

    /// All files of a sweep but its description.
    fn files(&self, out: &str) -> Vec<(String, String)> {
        let read =
            |path: PathBuf| (path.file_name().unwrap().to_str().unwrap().to_owned(), fs::read_to_string(path).unwrap());
        let runs = fs::read_dir(self.path(out).join(RUNS_DIR)).unwrap().map(|entry| entry.unwrap().path());
        let runs = runs.filter(|path| path.is_file()).map(read);
        let mut files: Vec<_> = runs.chain([RUNS, POINTS].map(|name| read(self.path(out).join(name)))).collect();
        files.sort();
        files
    }

    /// Resumes the sweep, and writes the tables.
    fn resumed(&self, out: &str) -> SweepCounts {
        let sweep = self.check();
        let folder = sweep.resume(&self.path(out), &options(2, true)).unwrap();
        let swept = sweep.run(&folder, &options(2, true), &()).unwrap();
        folder.write_tables().unwrap();
        assert_eq!(Folder::open(&self.path(out)).unwrap().hash(), sweep.hash().to_string());
        swept
    }
}

#[test]
fn a_sweep_with_more_repeats_runs_the_new_ones_and_has_the_files_of_one_that_had_them_at_once() {
    let desk = Desk::new(&repeats(7));
    desk.sweep("whole", &options(2, true));
    desk.set_repeats(2);
    desk.sweep("grown", &options(2, true));
    fs::remove_file(desk.path("grown/runs/000001.json")).unwrap();
    desk.set_repeats(3);
    let swept = desk.resumed("grown");
    assert_eq!((swept.n_before, swept.n_run), (3, 3), "the one that was missing, and one for each value");
    desk.set_repeats(7);
    assert_eq!(desk.resumed("grown").n_run, 8);
    assert_eq!(desk.files("grown"), desk.files("whole"));
    let about = Folder::open(&desk.path("grown")).unwrap().about;
    assert_eq!((&about["grown"][0]["repeat"], &about["grown"][1]["repeat"]), (&json!(2), &json!(3)));
    assert!(about["runs_in"].is_null() && !desk.path("grown/runs.before").exists());
    assert_eq!(desk.resumed("grown").n_run, 0, "it is whole now");
}

#[test]
fn a_sweep_that_was_stopped_while_it_was_renumbered_has_lost_nothing() {
    let desk = Desk::new(&repeats(4));
    desk.sweep("whole", &options(2, true));
    let checked = desk.check();
    for stop in 0..4 {
        let out = format!("cut{stop}");
        desk.set_repeats(2);
        desk.sweep(&out, &options(2, true));
        desk.set_repeats(4);
        let (dir, mut folder) = (desk.path(&out), Folder::open(&desk.path(&out)).unwrap());
        if stop == 0 {
            // Some files are renumbered; nothing says so yet.
            fs::create_dir(dir.join("runs.grown")).unwrap();
            fs::copy(dir.join("runs/000001.json"), dir.join("runs.grown/000003.json")).unwrap();
            assert_eq!(Folder::open(&dir).unwrap().runs().unwrap(), [0, 1, 2, 3]);
        } else {
            checked.grow(&mut folder, 2, &Json::Null).unwrap();
        }
        if stop >= 2 {
            fs::rename(dir.join("runs"), dir.join("runs.before")).unwrap();
        }
        if stop == 3 {
            fs::rename(dir.join("runs.grown"), dir.join("runs")).unwrap();
        }
        if stop > 0 {
            assert_eq!(Folder::open(&dir).unwrap().runs().unwrap(), [0, 1, 4, 5], "stopped after step {stop}");
        }
        assert_eq!(desk.resumed(&out).n_before, 4, "stopped after step {stop}");
        assert_eq!(desk.files(&out), desk.files("whole"), "stopped after step {stop}");
        assert!(!dir.join("runs.grown").exists() && !dir.join("runs.before").exists());
    }
}

#[test]
fn a_process_of_the_smaller_sweep_writes_no_run_into_the_grown_one() {
    let desk = Desk::new(&repeats(2));
    let before = desk.check();
    let folder = before.begin(&desk.path("out"), &options(1, true)).unwrap();
    desk.set_repeats(3);
    desk.check().resume(&desk.path("out"), &options(1, true)).unwrap();
    let message = before.run(&folder, &options(1, true), &()).unwrap_err().to_string();
    assert!(message.contains("another process has given it more repeats"), "{message}");
}

#[test]
fn fewer_repeats_and_other_changes_are_refused_by_name_and_parts_grow() {
    let desk = Desk::new(&repeats(3));
    desk.sweep("whole", &options(2, true));
    let part = SweepOptions { shard: Some(Shard { index: 1, of: 2 }), ..options(1, true) };
    desk.sweep("part", &part);
    desk.set_repeats(2);
    let refused =
        |out: &str, options: &SweepOptions| desk.check().resume(&desk.path(out), options).unwrap_err().to_string();
    let message = refused("whole", &options(1, true));
    assert!(message.contains("its table [sweep] differs: its repeat is 3, not 2;"), "{message}");
    desk.set_repeats(5);
    // The runs of a part get their new numbers, too.
    let n_runs = Folder::open(&desk.path("part")).unwrap().runs().unwrap().len();
    let grown = desk.check().resume(&desk.path("part"), &part).unwrap();
    assert_eq!((grown.runs().unwrap().len(), &grown.about["shard"]), (n_runs, &"1/2".into()));
    fs::write(&desk.graph, repeats(5).replace("[false, true]", "[true, false]")).unwrap();
    assert!(refused("whole", &options(1, true)).contains("its table [sweep] differs"), "{message}");
    fs::write(&desk.graph, repeats(5).replace("kind  = \"toy.add\"", "kind  = \"toy.add\"\nsleep_us = 1")).unwrap();
    let message = refused("whole", &options(1, true));
    assert!(message.contains("sleep_us: it 0, the other 1") && !message.contains("[sweep]"), "{message}");
}
