//! Time of a firing in a process of its own, beside the same node in this one: the median of 1,000 firings.
//!
//! `cargo bench -p osteoflow --bench apart`. docs/project/performance.md has the figures.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed bench, with its line")]

#[path = "../../tests/common/apart.rs"]
mod apart;
#[allow(dead_code, reason = "tests use the rest")]
#[path = "../../engine/tests/plugins/build.rs"]
mod build;

fn main() {
    let us = |time: std::time::Duration| time.as_secs_f64() * 1e6;
    for case in apart::measure(1_000).into_iter().flatten() {
        let apart::Case { name, here, apart } = &case;
        println!("{name}: {:.1} us here, {:.1} us apart, {:.1} us more", us(*here), us(*apart), us(case.more()));
    }
}
