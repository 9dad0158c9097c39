//! Rows that are asked for one by one.

use super::*;

impl Desk {
    fn study(&self, out: &str, resumes: bool, options: &SweepOptions) -> Result<Study, FolderError> {
        let study = Study::open(&self.graph, &[], &registry(), &self.path(out), resumes, options.clone());
        study.unwrap_or_else(|faults| panic!("{}", faults.render(false)))
    }
}

fn ask(settings: &[&str], repeat: usize) -> Ask {
    Ask { settings: settings.iter().map(|set| (*set).to_owned()).collect(), repeat }
}

const COLUMNS: &str = "\n[sweep]\ntwice = 0\n[sweep.factor]\nnoise = { key = \"last.noise\", values = [false, true] }\n\
                       [sweep.columns]\nlast = \"values.last\"\n";

#[test]
fn nodes_that_rows_share_are_computed_once_over_all_calls() {
    let desk = Desk::new(&graph("study-shared", COLUMNS));
    let options = options(2, true);
    let mut study = desk.study("out", false, &options).unwrap();
    let first = study.run(&[ask(&["last.sleep_us=1"], 0)], &options, &()).unwrap();
    assert_eq!(n_fired("study-shared"), 1);
    let asks = [ask(&["last.sleep_us=2"], 0), ask(&["last.sleep_us=1"], 0), ask(&["last.sleep_us=2"], 1)];
    let rows = study.run(&asks, &options, &()).unwrap();
    assert_eq!(n_fired("study-shared"), 2, "once more, for the seed of the second repeat");
    assert_eq!(rows[1], first[0], "answered from the folder");
    let two = [&["last.noise=true", "last.sleep_us=3"][..], &["last.sleep_us=3", "last.noise=true"]];
    let rows_of_two = study.run(&two.map(|settings| ask(settings, 0)), &options, &()).unwrap();
    assert_eq!(rows_of_two[0], rows_of_two[1], "in any order");
    assert_eq!(rows.iter().map(|row| (row.run, row.seed)).collect::<Vec<_>>(), [(1, 7), (0, 7), (2, 8)]);
    study.close().unwrap();
    study.folder().write_tables().unwrap();
    let table = fs::read_to_string(desk.path("out").join(RUNS)).unwrap();
    let rows: Vec<_> = table.lines().map(|row| row.split(',').take(6).collect::<Vec<_>>().join(",")).collect();
    assert_eq!(rows[..2], ["run,last.sleep_us,last.noise,repeat,seed,status", "0,1,,0,7,complete"], "{table}");
    assert_eq!(rows[4], "3,3,true,0,7,complete", "{table}");
}

#[test]
fn a_row_whose_input_has_changed_is_not_answered_from_the_folder() {
    let desk = Desk::new(&graph("study-input", COLUMNS));
    let options = options(1, true);
    let mut study = desk.study("out", false, &options).unwrap();
    study.run(&[ask(&["last.sleep_us=1"], 0)], &options, &()).unwrap();
    drop(study);
    let path = desk.path("out/runs/000000.json");
    let text = fs::read_to_string(&path).unwrap();
    let mut run: Json = serde_json::from_str(&text).unwrap();
    run["asked"]["hash"] = "another".into();
    fs::write(&path, run.to_string()).unwrap();
    let mut study = desk.study("out", true, &options).unwrap();
    let error = study.run(&[ask(&["last.sleep_us=1"], 0)], &options, &()).unwrap_err().to_string();
    assert!(error.contains("an input file or a plugin of run 0 is another"), "{error}");
    fs::write(&path, text).unwrap();
    study.run(&[ask(&["last.sleep_us=1"], 0)], &options, &()).unwrap();
    fs::write(&desk.graph, graph("study-input", COLUMNS) + "# later\n").unwrap();
    let error = study.run(&[ask(&["last.sleep_us=3"], 0)], &options, &()).unwrap_err().to_string();
    assert!(error.contains("toy.toml has changed"), "{error}");
}

#[test]
fn a_stopped_call_keeps_what_has_ended_and_studies_are_not_merged_or_swept() {
    let desk = Desk::new(&graph("study-stopped", COLUMNS));
    let options = options(1, true);
    let mut study = desk.study("out", false, &options).unwrap();
    let asks = [ask(&["last.sleep_us=1"], 0), ask(&["last.sleep_us=2"], 0), ask(&["last.sleep_us=3"], 0)];
    struct Stop(std::sync::Arc<std::sync::atomic::AtomicBool>);
    impl Watcher for Stop {
        fn ended(&self, _: &Done) {
            self.0.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    }
    let stop = Stop(options.run.cancelled.clone());
    assert!(matches!(study.run(&asks, &options, &stop), Err(StudyError::Interrupted)));
    assert_eq!(study.folder().runs().unwrap(), [0]);
    let options = super::options(2, true);
    let rows = study.run(&asks, &options, &()).unwrap();
    assert_eq!(rows.iter().map(|row| row.run).collect::<Vec<_>>(), [0, 1, 2]);
    let folder = study.folder().clone();
    let message = merge(&[folder.clone(), folder], &desk.path("merged")).unwrap_err().to_string();
    assert!(message.contains("asked for one by one"), "{message}");
    let message = desk.check().resume(&desk.path("out"), &options).unwrap_err().to_string();
    assert!(message.contains("asked for one by one"), "{message}");
    desk.sweep("swept", &options);
    let message = desk.study("swept", true, &options).map(drop).unwrap_err().to_string();
    assert!(message.contains("those of a table [sweep]"), "{message}");
}
