//! Answers as text.

use nalgebra::{Isometry3, Point3, Vector3};
use std::fmt::{Debug, Display};
use std::path::Path;

/// Compares with the golden text, or writes it with `UPDATE=1`.
pub(crate) fn golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/answers").join(name).with_extension("txt");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_default();
    let mut changed = golden.lines().zip(text.lines()).filter(|(old, new)| old != new);
    if let Some((old, new)) = changed.next() {
        let n = 1 + changed.count();
        panic!("{name}: {n} lines have changed, see the diff after UPDATE=1; the first was\n{old}\nand is\n{new}");
    }
    assert_eq!(golden.lines().count(), text.lines().count(), "{name}: number of lines");
}

/// One line: a name and the fields of an answer, numbers to six digits and those below 1e-9 as 0.
pub(crate) fn line(name: impl Display, answer: &impl Debug) -> String {
    format!("{name}: {}\n", rounded(&format!("{answer:?}")))
}

/// An error as its text, an answer as one line.
pub(crate) fn outcome<T: Debug, E: Display>(name: impl Display, result: &Result<T, E>) -> String {
    match result {
        Ok(answer) => line(name, answer),
        Err(error) => format!("{name}: {error}\n"),
    }
}

/// Shift and turn of a motion.
pub(crate) fn motion(t: &Isometry3<f64>) -> ([f64; 3], [f64; 3]) {
    (t.translation.vector.into(), t.rotation.scaled_axis().into())
}

/// Number of points, mean and a sum in which each place has a weight of its own.
pub(crate) fn digest<'a>(points: impl Iterator<Item = &'a [f64; 3]>) -> (usize, [f64; 3], [f64; 3]) {
    let (mut n, mut sum, mut weighted) = (0, Vector3::zeros(), Vector3::zeros());
    for p in points {
        sum += Vector3::from(*p);
        // 0.1 to 1.06: what two points exchange does not cancel.
        weighted += Vector3::from(*p) * (0.1 + (n * 7 % 97) as f64 / 100.0);
        n += 1;
    }
    let by = (n as f64).max(1.0).recip();
    (n, (sum * by).into(), (weighted * by).into())
}

pub(crate) fn points(points: &[Point3<f64>]) -> (usize, [f64; 3], [f64; 3]) {
    digest(points.iter().map(|p| p.coords.as_ref()))
}

pub(crate) fn vectors(vectors: &[Vector3<f64>]) -> (usize, [f64; 3], [f64; 3]) {
    digest(vectors.iter().map(AsRef::as_ref))
}

/// Number of indices, their sum and a sum in which each place has a weight of its own.
pub(crate) fn indices(indices: &[usize]) -> (usize, usize, usize) {
    (indices.len(), indices.iter().sum(), indices.iter().enumerate().map(|(k, i)| (k % 97 + 1) * i).sum())
}

fn rounded(text: &str) -> String {
    let is_number = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '+' | '_');
    let mut out = String::new();
    let mut rest = text;
    while let Some(from) = rest.find(is_number) {
        let word = &rest[from..];
        let word = &word[..word.find(|c| !is_number(c)).unwrap_or(word.len())];
        out.push_str(&rest[..from]);
        let number = word.parse::<f64>().ok().filter(|x| x.is_finite() && word.contains(['.', 'e']));
        match number {
            Some(x) if x.abs() < 1e-9 => out.push('0'),
            Some(x) => out.push_str(&format!("{x:.5e}").parse::<f64>().unwrap().to_string()),
            None => out.push_str(word),
        }
        rest = &rest[from + word.len()..];
    }
    out + rest
}

#[test]
fn numbers_are_rounded_and_names_and_counts_are_not() {
    let text = rounded("P1 [1.2345678, -3e-12, 1e3] n: 1234567, x_1.5: -0.000123456789, NaN");
    assert_eq!(text, "P1 [1.23457, 0, 1000] n: 1234567, x_1.5: -0.000123457, NaN");
}
