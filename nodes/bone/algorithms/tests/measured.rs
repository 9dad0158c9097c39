//! Readers of the measured data with known answers.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use std::path::Path;

pub(crate) fn centroid(points: &[Point3<f64>]) -> Point3<f64> {
    Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64)
}

/// The numbers of a text file, a row each, after a line.
pub(crate) fn rows(path: &Path, after: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read(path).unwrap();
    let text = String::from_utf8_lossy(&text);
    let body = if after.is_empty() { &text[..] } else { &text[text.find(after).unwrap() + after.len()..] };
    body.lines().map(|line| line.split_whitespace().filter_map(|w| w.parse().ok()).collect()).collect()
}

pub(crate) fn xyz(rows: &[Vec<f64>], unit_mm: f64) -> Vec<Point3<f64>> {
    rows.iter().filter(|row| row.len() >= 3).map(|row| Point3::new(row[0], row[1], row[2]) * unit_mm).collect()
}

/// The vertices of an ASCII PLY in metres, mm, and its triangles.
pub(crate) fn ply(path: &Path) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let head = String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned();
    let line = head.lines().find(|line| line.starts_with("element vertex ")).unwrap();
    let n: usize = line.rsplit(' ').next().unwrap().trim().parse().unwrap();
    let rows: Vec<Vec<f64>> = rows(path, "end_header").into_iter().skip(1).collect();
    let faces = rows[n..].iter().filter(|row| row.len() == 4).map(|row| [1, 2, 3].map(|k| row[k] as u32)).collect();
    (xyz(&rows[..n], 1000.0), faces)
}

/// The range scans of a `bun.conf`, each with its name, on their model, mm.
pub(crate) fn range_scans(conf: &Path) -> [(&'static str, Vec<Point3<f64>>); 3] {
    let text = std::fs::read_to_string(conf).unwrap();
    ["bun000", "bun045", "bun090"].map(|name| {
        let line = text.lines().find(|line| line.contains(name)).unwrap();
        let v: Vec<f64> = line.split_whitespace().skip(2).map(|w| w.parse().unwrap()).collect();
        // The quaternion is that of the inverse turn.
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(v[6], v[3], v[4], v[5])).inverse();
        let t = Isometry3::from_parts(Translation3::from(Vector3::new(v[0], v[1], v[2]) * 1000.0), turn);
        let (points, _) = ply(&conf.with_file_name(format!("{name}.ply")));
        (name, points.iter().map(|p| t * p).collect())
    })
}
