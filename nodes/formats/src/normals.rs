use nalgebra::Vector3;
use osteoflow_geometry::{ROUNDED_ROTATION, direction};

/// The normals of a file or message, scaled to length 1.
///
/// A normal is a direction: scaling it moves nothing, so any length but zero is taken. Lengths that rounding does not explain
/// are reported.
#[derive(Default)]
pub(crate) struct NormalReader {
    normals: Vec<Vector3<f64>>,
    n_bad: usize,
    n_scaled: usize,
    shortest: f64,
    longest: f64,
}

impl NormalReader {
    pub(crate) fn push(&mut self, normal: Vector3<f64>) {
        let Ok(unit) = direction(normal) else {
            self.n_bad += 1;
            return;
        };
        let length = normal.norm();
        if (length - 1.0).abs() > ROUNDED_ROTATION {
            let is_first = self.n_scaled == 0;
            self.shortest = if is_first { length } else { self.shortest.min(length) };
            self.longest = if is_first { length } else { self.longest.max(length) };
            self.n_scaled += 1;
        }
        self.normals.push(unit.into_inner());
    }

    /// The normals, if all could be read, and what was done to them, one sentence each.
    pub(crate) fn finish(self) -> (Option<Vec<Vector3<f64>>>, Vec<String>) {
        let n = self.normals.len() + self.n_bad;
        if self.n_bad > 0 {
            let note =
                format!("{} of {n} normals are zero or not finite, so the cloud goes without normals", self.n_bad);
            return (None, vec![note]);
        }
        let note = (self.n_scaled > 0).then(|| {
            let Self { n_scaled, shortest, longest, .. } = self;
            format!("{n_scaled} of {n} normals have lengths from {shortest:.3e} to {longest:.3e} and were scaled to 1")
        });
        (Some(self.normals), note.into_iter().collect())
    }
}
