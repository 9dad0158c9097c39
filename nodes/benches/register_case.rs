//! The time of a [`RegisterRequest`] called from Rust, for `nodes/python/compare_speed.py`.
//!
//! `register_case CASE THREADS` reads `source.ply`, `target.ply` and `init.txt` of the folder CASE. For each line on stdin it
//! registers once, with the options that the script gives to Python, and prints one line of JSON: the time of the call in
//! ms, and its answer.

use anyhow::{Context, Result, anyhow, bail};
use osteoflow::app::{Content, Keep, RegisterInput, RegisterRequest, read};
use std::{
    env,
    io::{Write, stdin, stdout},
    path::PathBuf,
    sync::Arc,
    time::Instant,
};

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
    let input = |content| RegisterInput { path: "memory".into(), content: Some(content) };
    // `osteoflow.register(target, source, init, workers=THREADS, verdict=False, cache=False)`.
    let request = RegisterRequest {
        target: input(target),
        source: input(source),
        init_pose: Some(init),
        workers: Some(threads.parse().context("THREADS is a number")?),
        no_verdict: true,
        keep: Keep { no_cache: true },
        ..RegisterRequest::new("target", "source")
    };
    for line in stdin().lines() {
        line?;
        let began = Instant::now();
        let answer = request.clone().check()?.register(&(), &Arc::default(), false);
        let ms = began.elapsed().as_secs_f64() * 1e3;
        let mut answer = answer.map_err(|error| anyhow!("{error:?}"))?;
        answer["whole_ms"] = ms.into();
        writeln!(stdout(), "{answer}").context("stdout is closed")?;
    }
    Ok(())
}
