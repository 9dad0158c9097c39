//! The layers of a series in their order, and the spacing of their stack.

use super::pixels::Pixels;
use super::series::{Layer, Series};
use crate::FileError;
use nalgebra::Vector3;
use std::path::Path;

/// How far a layer may be from its place in an even stack, mm: positions are rounded to a tenth by some scanners.
const MAX_OFF_MM: f64 = 0.06;
/// A layer further off than this is noted.
const NOTED_OFF_MM: f64 = 0.005;
/// Distances that differ by less than this share, or half of [`MAX_OFF_MM`], are one.
const SAME_GAP: f64 = 0.05;
/// Distances of one series that differ by less than this factor are an uneven stack, not two stacks.
const MIXED: f64 = 1.2;
/// A mixed stack may have this many voxels along it for each layer.
const MAX_PER_LAYER: f64 = 16.0;
/// The spacing of layers may be divided by up to this to find one that all of them fit.
const MAX_DIVISOR: usize = 4;

/// Layers in the order of their positions, and the stack that they are put on.
pub(super) struct Layers<'a> {
    pub(super) layers: Vec<&'a Layer>,
    /// From one voxel to the next along the stack, mm.
    pub(super) step: Vector3<f64>,
    /// Where each layer is in the stack, in steps; whole numbers count as such.
    pub(super) places: Vec<f64>,
}

impl Layers<'_> {
    /// Number of voxels along the stack.
    pub(super) fn n(&self) -> usize {
        self.places.last().map_or(0, |last| last.round() as usize + 1)
    }
}

/// A place in the stack that a message names.
struct At<'a> {
    folder: &'a Path,
    layers: &'a [&'a Layer],
    normal: Vector3<f64>,
}

impl At<'_> {
    fn mm(&self, k: usize) -> f64 {
        self.layers[k].1.height(&self.normal)
    }

    fn name(&self, k: usize) -> String {
        let (path, image) = self.layers[k];
        let name = match path.strip_prefix(self.folder) {
            Ok(inside) if inside != Path::new("") => inside.display().to_string(),
            _ => path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        };
        if image.n_frames == 1 { name } else { format!("{name}, frame {}", image.frame + 1) }
    }
}

/// The layers along the normal of their plane, on an even stack.
pub(super) fn layers<'a>(path: &Path, series: &'a Series, notes: &mut Vec<String>) -> Result<Layers<'a>, FileError> {
    check_alike(&series.layers)?;
    let first = &series.layers[0].1;
    let normal = first.row.cross(&first.column);
    let mut layers: Vec<&Layer> = series.layers.iter().collect();
    let file = |layer: &Layer| (layer.0.clone(), layer.1.frame);
    layers.sort_by(|a, b| a.1.height(&normal).total_cmp(&b.1.height(&normal)).then_with(|| file(a).cmp(&file(b))));
    let layers = without_doubles(path, layers, &normal, notes)?;
    if layers.len() == 1 {
        notes.push("one layer; a surface needs more".into());
        let thickness = first.thickness_mm.filter(|t| *t > 0.0).unwrap_or(1.0);
        return Ok(Layers { layers, step: normal * thickness, places: vec![0.0] });
    }
    let places = places(path, &At { folder: path, layers: &layers, normal }, notes)?;
    let (start, end) = (layers[0].1.position, layers[layers.len() - 1].1.position);
    let step = (end - start) / places.last().copied().unwrap_or(1.0);
    let tilt = step.cross(&normal).norm().atan2(step.dot(&normal)).to_degrees();
    if tilt > 0.01 {
        notes.push(format!(
            "the layers are sheared by {tilt:.2} degrees (a tilted gantry); the voxels' map has it exactly"
        ));
    }
    Ok(Layers { layers, step, places })
}

fn check_alike(layers: &[Layer]) -> Result<(), FileError> {
    let (_, first) = &layers[0];
    for (file, image) in layers {
        let fault = |message: String| Err(FileError::content(file, "data set", message));
        let turned = (image.row - first.row).norm().max((image.column - first.column).norm());
        if turned > 1e-4 {
            return fault(format!(
                "its plane is turned by {:.3} degrees against other images of the series; take it out of the folder",
                turned.to_degrees()
            ));
        }
        let ratio = (0..2).map(|k| (image.spacing_mm[k] / first.spacing_mm[k] - 1.0).abs()).fold(0.0, f64::max);
        if ratio > 1e-4 {
            return fault(format!(
                "pixels of {:?} mm, but other images of the series have {:?} mm; take this one out of the folder",
                image.spacing_mm, first.spacing_mm
            ));
        }
    }
    Ok(())
}

/// Layers of which each is at a place of its own: of equal ones the first is kept.
fn without_doubles<'a>(
    path: &Path,
    layers: Vec<&'a Layer>,
    normal: &Vector3<f64>,
    notes: &mut Vec<String>,
) -> Result<Vec<&'a Layer>, FileError> {
    let gaps = gaps(&layers, normal);
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let one_place = 1e-3_f64.max(0.01 * usual);
    let mut kept: Vec<&Layer> = Vec::with_capacity(layers.len());
    let mut n_doubles = 0;
    for layer in layers {
        let before = kept.last().filter(|before| layer.1.height(normal) - before.1.height(normal) < one_place);
        let Some(before) = before else {
            kept.push(layer);
            continue;
        };
        if !are_equal(before, layer)? {
            let at = At { folder: path, layers: &[before, layer], normal: *normal };
            return Err(FileError::content(
                path,
                "series",
                format!(
                    "{} and {} are both at {:.3} mm along the normal of the layers, with different pixels; put the layers of \
                     one scan into a folder of their own",
                    at.name(0),
                    at.name(1),
                    at.mm(0)
                ),
            ));
        }
        n_doubles += 1;
    }
    if n_doubles > 0 {
        notes.push(format!("{n_doubles} layers that are there twice, with equal pixels, were taken once"));
    }
    Ok(kept)
}

/// Whether two layers at one place are the same.
fn are_equal(a: &Layer, b: &Layer) -> Result<bool, FileError> {
    if (a.1.position - b.1.position).norm() > 1e-3 {
        return Ok(false);
    }
    let values = |layer: &Layer| Pixels::open(&layer.0)?.values(&layer.1, &mut Vec::new());
    Ok(values(a)? == values(b)?)
}

fn gaps(layers: &[&Layer], normal: &Vector3<f64>) -> Vec<f64> {
    layers.windows(2).map(|w| w[1].1.height(normal) - w[0].1.height(normal)).collect()
}

fn are_same(a: f64, b: f64) -> bool {
    (a - b).abs() < (SAME_GAP * a.min(b)).max(MAX_OFF_MM / 2.0)
}

/// Where each layer is, in steps of an even stack: of the layers, or, where their distance changes, of one that all fit.
fn places(path: &Path, at: &At<'_>, notes: &mut Vec<String>) -> Result<Vec<f64>, FileError> {
    let layers = at.layers;
    let gaps = gaps(layers, &at.normal);
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted[sorted.len() / 2];
    let fault = |message: String| Err(FileError::content(path, "series", message));
    let runs = runs(&gaps);
    if is_mixed(&runs) {
        return mixed(path, at, &runs, notes);
    }
    if let Some(k) = gaps.iter().position(|gap| *gap > 1.5 * usual) {
        let n_missing = (gaps[k] / usual).round() - 1.0;
        return fault(format!(
            "about {n_missing} of the layers are missing between {} at {:.3} mm and {} at {:.3} mm along their normal, where others \
             are {usual:.3} mm apart; export the series again",
            at.name(k),
            at.mm(k),
            at.name(k + 1),
            at.mm(k + 1)
        ));
    }
    let (start, end) = (layers[0].1.position, layers[layers.len() - 1].1.position);
    let step = (end - start) / (layers.len() - 1) as f64;
    let off = |k: usize| (layers[k].1.position - (start + step * k as f64)).norm();
    let worst = (0..layers.len()).max_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(0);
    if off(worst) > MAX_OFF_MM {
        return fault(format!(
            "the layers are not evenly spaced: {} is {:.3} mm from its place in an even stack of {} layers, {:.3} mm apart; export \
             the series with even spacing",
            at.name(worst),
            off(worst),
            layers.len(),
            step.norm()
        ));
    }
    if off(worst) > NOTED_OFF_MM {
        notes.push(format!("layers are up to {:.3} mm from their places in an even stack", off(worst)));
    }
    let first = &layers[0].1;
    if let Some(thickness) = first.thickness_mm.filter(|t| *t > 1.5 * step.norm() || *t < step.norm() / 1.5) {
        notes.push(format!("layers of {thickness} mm thickness are {:.3} mm apart", step.norm()));
    }
    Ok((0..layers.len()).map(|k| k as f64).collect())
}

/// Layers in a row that are equally far apart.
struct Run {
    start: usize,
    len: usize,
    gap: f64,
}

/// Whether the distance changes for stretches of layers. Between two stretches is one distance of its own, as between the middles
/// of a thin and a thick layer.
fn is_mixed(runs: &[Run]) -> bool {
    let (low, high) = runs.iter().fold((f64::MAX, 0.0_f64), |(low, high), run| (low.min(run.gap), high.max(run.gap)));
    let is_between = |k: usize| {
        let (before, after) = (k.checked_sub(1).and_then(|k| runs.get(k)), runs.get(k + 1));
        let gaps = before.zip(after).map(|(a, b)| (a.gap.min(b.gap), a.gap.max(b.gap)));
        gaps.is_some_and(|(low, high)| (low..=high).contains(&runs[k].gap))
    };
    high > MIXED * low && (0..runs.len()).all(|k| runs[k].len >= 2 || is_between(k))
}

fn runs(gaps: &[f64]) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (k, gap) in gaps.iter().enumerate() {
        match runs.last_mut().filter(|run| are_same(run.gap, *gap)) {
            Some(run) => run.len += 1,
            None => runs.push(Run { start: k, len: 1, gap: *gap }),
        }
    }
    runs
}

/// Places of layers whose distance changes along the stack, which is right only where their thickness changes with it.
fn mixed(path: &Path, at: &At<'_>, runs: &[Run], notes: &mut Vec<String>) -> Result<Vec<f64>, FileError> {
    let fault = |message: String| Err(FileError::content(path, "series", message));
    let shown = |run: &Run| {
        format!("{:.3} mm apart from {:.3} to {:.3} mm", run.gap, at.mm(run.start), at.mm(run.start + run.len))
    };
    let all = runs.iter().take(6).map(shown).collect::<Vec<_>>().join(", ");
    let finest = runs.iter().map(|run| run.gap).fold(f64::MAX, f64::min);
    // Thin layers far apart are what is left where layers are missing.
    let thickness = |run: &Run| at.layers[run.start + run.len / 2].1.thickness_mm;
    let thinnest = runs.iter().filter(|run| are_same(run.gap, finest)).find_map(thickness);
    for run in runs.iter().filter(|run| run.len >= 2 && run.gap > MIXED * finest) {
        let (Some(thick), Some(thin)) = (thickness(run), thinnest) else {
            return fault(format!(
                "the distance of the layers changes ({all}), and their SliceThickness (0018,0050) is not stated, so layers may be \
                 missing; export the series with one distance"
            ));
        };
        if thick < thin * (1.0 + 0.5 * (run.gap / finest - 1.0)) {
            return fault(format!(
                "the distance of the layers changes ({all}), but not their thickness ({thin} and {thick} mm), so layers may be \
                 missing; export the whole series again, or put the layers of one distance into a folder of their own"
            ));
        }
    }
    let heights: Vec<f64> = (0..at.layers.len()).map(|k| at.mm(k) - at.mm(0)).collect();
    let fits = |step: f64| {
        let off = |h: &f64| (h / step - (h / step).round()).abs() * step;
        heights.iter().all(|h| off(h) < MAX_OFF_MM)
    };
    let divided = (1..=MAX_DIVISOR).map(|divisor| finest / divisor as f64).find(|step| fits(*step));
    let total = heights[heights.len() - 1];
    let n_steps = (total / divided.unwrap_or(finest)).round();
    if n_steps > MAX_PER_LAYER * heights.len() as f64 {
        return fault(format!(
            "the distance of the layers changes ({all}) by too much for one stack; export the series with one distance"
        ));
    }
    let step = total / n_steps;
    let (start, end) = (at.layers[0].1.position, at.layers[at.layers.len() - 1].1.position);
    let along = (end - start) / total;
    let aside = |k: usize| (at.layers[k].1.position - (start + along * heights[k])).norm();
    if let Some(k) = (0..at.layers.len()).find(|k| aside(*k) > MAX_OFF_MM) {
        return fault(format!(
            "{} is {:.3} mm aside of the line through the first and the last layer; export the series again",
            at.name(k),
            aside(k)
        ));
    }
    notes.push(format!(
        "the layers are of different thickness ({all}); they were put on a stack of {step:.3} mm by linear interpolation, and the \
         surface is coarser where the layers are thicker"
    ));
    let place = |h: &f64| {
        let place = h / step;
        if (place - place.round()).abs() * step < MAX_OFF_MM { place.round() } else { place }
    };
    Ok(heights.iter().map(place).collect())
}
