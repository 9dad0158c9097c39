//! The series of a folder, and the layers of one in their order.

use super::image::Image;
use crate::FileError;
use nalgebra::Vector3;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// How far a layer may be from its place in an even stack, mm: positions are rounded to a tenth by some scanners.
const MAX_OFF_MM: f64 = 0.06;
/// A layer further off than this is noted.
const NOTED_OFF_MM: f64 = 0.005;
/// Characters of a unique identifier that are shown.
const ENDING: usize = 12;

/// The images of one series.
pub(super) struct Series {
    images: Vec<(PathBuf, Image)>,
}

/// Images in the order of their positions, and the step from one to the next, mm.
pub(super) struct Layers<'a> {
    pub(super) images: Vec<&'a (PathBuf, Image)>,
    pub(super) step: Vector3<f64>,
}

/// The ending of a unique identifier.
fn ending(uid: &str) -> &str {
    // Only digits and dots are kept, so every byte is a character.
    &uid[uid.len().saturating_sub(ENDING)..]
}

/// The series chosen by number or the ending of its unique identifier, or the only one.
pub(super) fn choose(path: &Path, images: Vec<(PathBuf, Image)>, choice: Option<&str>) -> Result<Series, FileError> {
    let mut by_uid: BTreeMap<String, Series> = BTreeMap::new();
    for (file, image) in images {
        by_uid.entry(image.series_uid.clone()).or_insert(Series { images: Vec::new() }).images.push((file, image));
    }
    let all: Vec<Series> = by_uid.into_values().collect();
    let list = |series: &[&Series]| series.iter().map(|s| s.name()).collect::<Vec<_>>().join("; ");
    let every: Vec<&Series> = all.iter().collect();
    let fault = |message: String| Err(FileError::content(path, "series", message));
    let Some(choice) = choice.map(str::trim) else {
        if all.len() > 1 {
            let message = format!(
                "{} series; choose one by its number or the ending of its identifier, series = \"...\": {}",
                all.len(),
                list(&every)
            );
            return fault(message);
        }
        return Ok(all.into_iter().next().expect("there are images"));
    };
    let by_number = |s: &Series| s.images[0].1.series_number.is_some_and(|n| n.to_string() == choice);
    let by_ending = |s: &Series| !choice.is_empty() && s.images[0].1.series_uid.ends_with(choice);
    let numbered: Vec<usize> = (0..all.len()).filter(|k| by_number(&all[*k])).collect();
    let by_end: Vec<usize> = (0..all.len()).filter(|k| by_ending(&all[*k])).collect();
    // A number names a series by its number first: identifiers end in numbers too.
    let chosen = if numbered.is_empty() { by_end } else { numbered };
    match chosen[..] {
        [one] => Ok(all.into_iter().nth(one).expect("it was found there")),
        [] => fault(format!(
            "no series has the number, or an identifier that ends in, \"{}\"; there are {}",
            choice.escape_default(),
            list(&every)
        )),
        ref several => {
            let several: Vec<&Series> = several.iter().map(|k| &all[*k]).collect();
            fault(format!(
                "\"{}\" names {} series; give more of the identifier: {}",
                choice.escape_default(),
                several.len(),
                list(&several)
            ))
        }
    }
}

impl Series {
    /// Modality, number, identifier's ending, number of images and their size.
    pub(super) fn name(&self) -> String {
        let first = &self.images[0].1;
        let number = first.series_number.map_or("without number".into(), |n| n.to_string());
        let uid = if first.series_uid.is_empty() { "none".into() } else { format!("..{}", ending(&first.series_uid)) };
        let images = if self.images.len() == 1 { "image" } else { "images" };
        format!(
            "{} series {number}, identifier {uid}, {} {images} of {} x {}",
            first.modality,
            self.images.len(),
            first.n_columns,
            first.n_rows
        )
    }

    /// The images along the normal of their plane, evenly spaced.
    pub(super) fn layers(&self, path: &Path, notes: &mut Vec<String>) -> Result<Layers<'_>, FileError> {
        let (_, first) = &self.images[0];
        for (file, image) in &self.images {
            let fault = |message: String| Err(FileError::content(file, "data set", message));
            if (image.n_rows, image.n_columns) != (first.n_rows, first.n_columns) {
                return fault(format!(
                    "{} x {} pixels, but other images of the series have {} x {}; take this one out of the folder",
                    image.n_columns, image.n_rows, first.n_columns, first.n_rows
                ));
            }
            let turned = (image.row - first.row).norm().max((image.column - first.column).norm());
            if turned > 1e-4 {
                return fault(format!(
                    "its plane is turned by {:.3} degrees against other images of the series, as a localizer's is; take it out of the \
                     folder",
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
            if image.modality != first.modality {
                return fault(format!(
                    "modality {}, but other images of the series are {}",
                    image.modality, first.modality
                ));
            }
        }
        let normal = first.row.cross(&first.column);
        let height = |image: &Image| image.position.coords.dot(&normal);
        let mut images: Vec<&(PathBuf, Image)> = self.images.iter().collect();
        images.sort_by(|a, b| height(&a.1).total_cmp(&height(&b.1)).then_with(|| a.0.cmp(&b.0)));
        if images.len() == 1 {
            notes.push("one layer; a surface needs more".into());
            let thickness = first.thickness_mm.filter(|t| *t > 0.0).unwrap_or(1.0);
            return Ok(Layers { images, step: normal * thickness });
        }
        let gaps: Vec<f64> = images.windows(2).map(|w| height(&w[1].1) - height(&w[0].1)).collect();
        let mut sorted = gaps.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted[sorted.len() / 2];
        let fault = |message: String| Err(FileError::content(path, "series", message));
        let name = |k: usize| images[k].0.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let at = |k: usize| height(&images[k].1);
        if let Some(k) = gaps.iter().position(|gap| *gap < 1e-3_f64.max(0.01 * usual)) {
            return fault(format!(
                "{} and {} are both at {:.3} mm along the normal of the layers; take one out, or choose one phase of the scan",
                name(k),
                name(k + 1),
                at(k)
            ));
        }
        if let Some(k) = gaps.iter().position(|gap| *gap > 1.5 * usual) {
            let n_missing = (gaps[k] / usual).round() - 1.0;
            return fault(format!(
                "about {n_missing} of the layers are missing between {} at {:.3} mm and {} at {:.3} mm along their normal, where others \
                 are {usual:.3} mm apart; export the series again",
                name(k),
                at(k),
                name(k + 1),
                at(k + 1)
            ));
        }
        let (start, end) = (images[0].1.position, images[images.len() - 1].1.position);
        let step = (end - start) / (images.len() - 1) as f64;
        let off = |k: usize| (images[k].1.position - (start + step * k as f64)).norm();
        let worst = (0..images.len()).max_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(0);
        if off(worst) > MAX_OFF_MM {
            return fault(format!(
                "the layers are not evenly spaced: {} is {:.3} mm from its place in an even stack of {} layers, {:.3} mm apart; export \
                 the series with even spacing",
                name(worst),
                off(worst),
                images.len(),
                step.norm()
            ));
        }
        if off(worst) > NOTED_OFF_MM {
            notes.push(format!("layers are up to {:.3} mm from their places in an even stack", off(worst)));
        }
        let tilt = step.cross(&normal).norm().atan2(step.dot(&normal)).to_degrees();
        if tilt > 0.01 {
            notes.push(format!(
                "the layers are sheared by {tilt:.2} degrees (a tilted gantry); the voxels' map has it exactly"
            ));
        }
        if let Some(thickness) = first.thickness_mm.filter(|t| *t > 1.5 * step.norm() || *t < step.norm() / 1.5) {
            notes.push(format!("layers of {thickness} mm thickness are {:.3} mm apart", step.norm()));
        }
        Ok(Layers { images, step })
    }
}
