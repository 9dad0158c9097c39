//! The time of [`osteoflow::library::register`] called from Rust, for `nodes/python/compare_speed.py`.
//!
//! `register_case CASE THREADS` reads `source.ply`, `target.ply` and `init.txt` of the folder CASE. For each line on stdin it
//! registers once, with the options that the script gives to Python, and prints one line of JSON: the time of the call in
//! ms, and its answer.

use anyhow::{Context, Result, anyhow, bail};
use osteoflow::{
    app::{Content, read},
    library::{self, RegisterInputs},
};
use std::{
    env,
    io::{Write, stdin, stdout},
    path::PathBuf,
    sync::Arc,
    time::Instant,
};

/// The options of `osteoflow.register(target, source, init, workers=THREADS, verdict=False, cache=False)`.
fn options(threads: &str) -> Vec<String> {
    let words = [
        "--no-verdict",
        "--no-cache",
        "--target-points=150000",
        "--unit-mm=1.0",
        "--workers",
        threads,
        "target",
        "source",
    ];
    words.map(String::from).into()
}

fn main() -> Result<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [case, threads] = &arguments[..] else { bail!("register_case CASE THREADS") };
    let case = PathBuf::from(case);
    let shape = |name: &str| match read(&case.join(name), 1.0, "file", None, None) {
        Ok(Content::Shape(shape)) => Ok(shape),
        other => Err(anyhow!("{name}: {other:?}")),
    };
    let (target, source) = (shape("target.ply")?, shape("source.ply")?);
    let Ok(Content::Pose(init, _)) = read(&case.join("init.txt"), 1.0, "file", None, None) else {
        bail!("init.txt is no pose")
    };
    let options = options(threads);
    for line in stdin().lines() {
        line?;
        let began = Instant::now();
        let inputs = RegisterInputs { target: Some(target.clone()), source: Some(source.clone()), init: Some(init) };
        let told = library::register(&options, inputs, false, false, &Arc::default());
        let ms = began.elapsed().as_secs_f64() * 1e3;
        let mut told = told.map_err(|error| anyhow!("{error:?}"))?;
        told["whole_ms"] = ms.into();
        writeln!(stdout(), "{told}").context("stdout is closed")?;
    }
    Ok(())
}
