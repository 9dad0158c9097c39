//! The module for 3D Slicer as it is written; `python_package` runs it, beside a double of 3D Slicer.

use crate::common::{osteoflow, page::Page, root};
use std::{fs, path::Path};

/// The files below a folder, sorted.
fn files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        match path.is_dir() {
            true => found.extend(files(&path).into_iter().map(|below| format!("{name}/{below}"))),
            false => found.push(name),
        }
    }
    found.sort();
    found
}

#[test]
fn the_page_for_users_of_3d_slicer_runs_as_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let done = Page::open("docs/use/slicer.md", folder.path(), None).follow(|_| 0, |_, _, _| {});
    assert_eq!(done.len(), 1);
    assert!(folder.path().join("osteoflow-slicer/Osteoflow.py").exists());
}

#[test]
fn the_module_is_written_whole_with_graphs_that_hold_and_over_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let module = folder.path().join("module");
    osteoflow().args(["new", "slicer"]).arg(&module).assert().success();
    let source = root().join("nodes/python/slicer");
    let mut expected: Vec<String> = files(&source).into_iter().filter(|name| !name.contains("__pycache__")).collect();
    for name in &expected {
        assert_eq!(fs::read(module.join(name)).unwrap(), fs::read(source.join(name)).unwrap(), "{name}");
    }
    expected.extend(["graphs/two_files.toml", "graphs/variants/two_files_picked.toml"].map(str::to_owned));
    assert_eq!(files(&module), expected);
    // Only Osteoflow.py is at the top: 3D Slicer takes each file of Python there for a module.
    assert_eq!(expected.iter().filter(|name| name.ends_with(".py") && !name.contains('/')).count(), 1);
    let shape = [("bone", "tests/data/folder/bone.stl"), ("scan", "tests/data/folder/scan.ply")];
    let picked = [("bone_points", "bone"), ("scan_points", "scan")];
    let sets = |nodes: &[(&str, String)]| -> Vec<String> {
        nodes.iter().map(|(node, file)| format!("--set={node}.path={}", root().join(file).display())).collect()
    };
    let shape: Vec<_> = shape.map(|(node, file)| (node, file.to_owned())).into();
    let picked: Vec<_> = picked.map(|(node, of)| (node, format!("tests/data/picks/{of}_points.mrk.json"))).into();
    osteoflow().arg("check").arg(module.join("graphs/two_files.toml")).args(sets(&shape)).assert().success();
    let both = [shape, picked].concat();
    let check =
        osteoflow().arg("check").arg(module.join("graphs/variants/two_files_picked.toml")).args(sets(&both)).assert();
    check.success();
    let again = osteoflow().args(["new", "slicer"]).arg(&module).assert().code(2);
    let said = String::from_utf8_lossy(&again.get_output().stderr).into_owned();
    assert!(said.contains("name another folder"), "{said}");
    assert_eq!(files(&module), expected, "something was written");
}
