use osteoflow_engine::{Faults, check};
use osteoflow_toy::stages;
use std::{fs, path::Path};

/// Compares with the golden text, or writes it with `UPDATE=1`.
pub(crate) fn compare(found: &str, golden: &Path) -> Result<(), String> {
    let found = found.replace(env!("CARGO_MANIFEST_DIR"), "$DIR");
    if std::env::var_os("UPDATE").is_some() {
        fs::write(golden, &found).unwrap();
        return Ok(());
    }
    let expected = fs::read_to_string(golden).unwrap_or_default();
    if expected == found {
        return Ok(());
    }
    Err(format!("{}: expected\n{expected}\nbut found\n{found}\n", golden.display()))
}

/// The settings in the first lines of a graph: `# --set key=value`.
fn sets(text: &str) -> Vec<String> {
    text.lines()
        .map_while(|line| line.strip_prefix("# "))
        .filter_map(|l| l.strip_prefix("--set "))
        .map(Into::into)
        .collect()
}

#[test]
fn every_broken_graph_gives_its_exact_text() {
    let registry = stages::registry();
    let mut files: Vec<_> = fs::read_dir("tests/broken").unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|ext| ext == "toml"));
    files.sort();
    assert!(files.len() >= 30, "only {} broken graphs", files.len());
    let mut wrong = String::new();
    for path in &files {
        let text = String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
        let found = match check(path, &sets(&text), &registry) {
            Ok(checked) if checked.warnings.is_empty() => "no fault\n".into(),
            Ok(checked) => format!("{}\n", Faults(checked.warnings)),
            Err(faults) => format!("{faults}\n"),
        };
        wrong += &compare(&found, &path.with_extension("txt")).err().unwrap_or_default();
    }
    assert!(wrong.is_empty(), "{wrong}");
}
