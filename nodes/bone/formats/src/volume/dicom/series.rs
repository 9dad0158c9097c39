//! The series of a folder, and the choice among them.

use super::image::{Found, Identity, Image, PHASES};
use crate::FileError;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Characters of a unique identifier that are shown.
const ENDING: usize = 12;
/// Planes that differ by more than this, rad, are those of two stacks; less is a fault of one.
const OTHER_PLANE: f64 = 0.035;
/// Pixels whose sizes differ by more than this share are those of two stacks.
const OTHER_SPACING: f64 = 0.01;
/// Series that are named at most.
const MAX_NAMED: usize = 20;

/// A layer and its file.
pub(super) type Layer = (PathBuf, Image);

/// Files of one series that belong together: layers of one plane and size, or pictures that are none.
pub(super) struct Series {
    identity: Identity,
    /// Which of the stacks of its series, from 1 on, where there are several.
    stack: Option<usize>,
    /// What tells it from another scan of its series, such as acquisition 2.
    phase: Option<String>,
    pub(super) layers: Vec<Layer>,
    n_files: usize,
    /// Why it is no CT, or not the one to take.
    why_not: Option<String>,
    /// A file of it that cannot be read.
    pub(super) fault: Option<FileError>,
}

/// Whether two images may be layers of one stack.
fn are_alike(a: &Image, b: &Image) -> bool {
    let turned = (a.row - b.row).norm().max((a.column - b.column).norm());
    let ratio = (0..2).map(|k| (a.spacing_mm[k] / b.spacing_mm[k] - 1.0).abs()).fold(0.0, f64::max);
    a.identity == b.identity
        && (a.n_rows, a.n_columns, a.is_localizer) == (b.n_rows, b.n_columns, b.is_localizer)
        && turned < OTHER_PLANE
        && ratio < OTHER_SPACING
}

/// The series that files belong to, by their unique identifiers, those of most layers first within each.
pub(super) fn series(files: Vec<(PathBuf, Found)>) -> Vec<Series> {
    let mut by_uid: BTreeMap<String, Vec<Series>> = BTreeMap::new();
    let mut faults: Vec<(Identity, FileError)> = Vec::new();
    let new = |identity: &Identity, why_not: Option<String>| Series {
        identity: identity.clone(),
        stack: None,
        phase: None,
        layers: Vec::new(),
        n_files: 0,
        why_not,
        fault: None,
    };
    for (path, found) in files {
        match found {
            Found::Nothing => {}
            Found::Faulty(identity, fault) => faults.push((identity, fault)),
            Found::NoLayer(identity, why) => {
                let all = by_uid.entry(identity.series_uid.clone()).or_default();
                let same = all.iter().position(|s| s.identity == identity && s.why_not.as_ref() == Some(&why));
                let at = same.unwrap_or_else(|| {
                    all.push(new(&identity, Some(why)));
                    all.len() - 1
                });
                all[at].n_files += 1;
            }
            Found::Layers(images) => {
                for image in images {
                    let all = by_uid.entry(image.identity.series_uid.clone()).or_default();
                    let same =
                        all.iter().position(|s| s.layers.first().is_some_and(|(_, first)| are_alike(first, &image)));
                    let at = same.unwrap_or_else(|| {
                        all.push(new(&image.identity, None));
                        all.len() - 1
                    });
                    all[at].n_files += usize::from(image.frame == 0);
                    all[at].layers.push((path.clone(), image));
                }
            }
        }
    }
    for all in by_uid.values_mut() {
        *all = std::mem::take(all).into_iter().flat_map(Series::phases).collect();
    }
    for (identity, fault) in faults {
        let all = by_uid.entry(identity.series_uid.clone()).or_default();
        let of_it = all.iter_mut().filter(|s| s.why_not.is_none() && s.identity == identity);
        let series = match of_it.max_by_key(|s| s.layers.len()) {
            Some(series) => series,
            None => {
                all.push(new(&identity, None));
                all.last_mut().expect("it was pushed")
            }
        };
        series.n_files += 1;
        series.fault.get_or_insert(fault);
    }
    for all in by_uid.values_mut() {
        all.sort_by_key(|s| std::cmp::Reverse(s.layers.len()));
        if all.iter().filter(|s| !s.layers.is_empty()).count() > 1 {
            (1..).zip(all.iter_mut()).for_each(|(k, s)| s.stack = Some(k));
        }
    }
    let mut all: Vec<Series> = by_uid.into_values().flatten().collect();
    leave_out(&mut all);
    all
}

/// Says of localizers and single layers that they are not the ones to take, where there are others.
fn leave_out(all: &mut [Series]) {
    let why = |s: &Series| {
        let (_, first) = s.layers.first()?;
        let normal = first.row.cross(&first.column);
        let heights = s.layers.iter().map(|(_, image)| image.height(&normal));
        let (low, high) = heights.fold((f64::MAX, f64::MIN), |(low, high), h| (low.min(h), high.max(h)));
        let why = match s.layers.len() {
            _ if first.is_localizer => "a localizer",
            1 => "one layer, which has no surface",
            _ if high - low < 1e-3 => "all its layers are at one place, as those that watch for a contrast agent",
            _ => return None,
        };
        Some(why.to_owned())
    };
    let is_left: Vec<Option<String>> = all.iter().map(|s| if s.fault.is_none() { why(s) } else { None }).collect();
    let is_main = |(s, left): (&Series, &Option<String>)| s.why_not.is_none() && left.is_none();
    if all.iter().zip(&is_left).any(is_main) {
        for (s, left) in all.iter_mut().zip(is_left) {
            s.why_not = s.why_not.take().or(left);
        }
    }
}

/// The series of a number or the ending of a unique identifier, or the only one that may be a CT; notes on what was left out.
pub(super) fn choose(
    path: &Path,
    all: Vec<Series>,
    choice: Option<&str>,
    notes: &mut Vec<String>,
) -> Result<Series, FileError> {
    let fault = |message: String| Err(FileError::content(path, "series", message));
    let list = |which: &[usize]| {
        let names: Vec<String> = which.iter().take(MAX_NAMED).map(|k| all[*k].described()).collect();
        let more = which.len().saturating_sub(MAX_NAMED);
        names.join("; ") + &if more > 0 { format!("; and {more} more") } else { String::new() }
    };
    let (taken, left): (Vec<usize>, Vec<usize>) = (0..all.len()).partition(|k| all[*k].why_not.is_none());
    let every: Vec<usize> = (0..all.len()).collect();
    let chosen = match choice.map(str::trim) {
        None => match taken[..] {
            [one] => one,
            [] => return fault(format!("no series that may be a CT; give the folder of one: {}", list(&every))),
            _ => {
                let others = if left.is_empty() { String::new() } else { format!("; no CT are: {}", list(&left)) };
                return fault(format!(
                    "{} series; choose one by its number or the ending of its identifier, --series or series = \"...\": {}{others}",
                    taken.len(),
                    list(&taken)
                ));
            }
        },
        Some(choice) => {
            let (name, stack) = match choice.split_once('#') {
                Some((name, stack)) => (name, stack.parse().ok()),
                None => (choice, None),
            };
            let of_stack = |s: &Series| stack.is_none() || s.stack == stack;
            let by_number =
                |k: &usize| all[*k].identity.series_number.is_some_and(|n| n.to_string() == name) && of_stack(&all[*k]);
            let by_ending =
                |k: &usize| !name.is_empty() && all[*k].identity.series_uid.ends_with(name) && of_stack(&all[*k]);
            // A number names a series by its number first: identifiers end in numbers too. What may be a CT comes first.
            let found = [&taken, &left].into_iter().flat_map(|which| {
                let pick = |is_it: &dyn Fn(&usize) -> bool| which.iter().copied().filter(is_it).collect::<Vec<_>>();
                [pick(&by_number), pick(&by_ending)]
            });
            let found = found.into_iter().find(|found| !found.is_empty()).unwrap_or_default();
            match found[..] {
                [one] => one,
                [] => {
                    return fault(format!(
                        "no series has the number, or an identifier that ends in, \"{}\"; there are {}",
                        choice.escape_default(),
                        list(&every)
                    ));
                }
                _ => {
                    return fault(format!(
                        "\"{}\" names {} series; give more of the identifier, or the number with its stack, such as 3#2: {}",
                        choice.escape_default(),
                        found.len(),
                        list(&found)
                    ));
                }
            }
        }
    };
    if all[chosen].layers.is_empty() && all[chosen].fault.is_none() {
        return fault(format!("no CT: {}; choose another: {}", all[chosen].described(), list(&taken)));
    }
    if choice.is_none() && !left.is_empty() {
        notes.push(format!("left out, as no CT: {}", list(&left)));
    }
    Ok(all.into_iter().nth(chosen).expect("it was found there"))
}

/// Whether two layers are at one place.
fn has_doubles(layers: &[&Layer]) -> bool {
    let Some((_, first)) = layers.first() else { return false };
    let normal = first.row.cross(&first.column);
    let mut heights: Vec<f64> = layers.iter().map(|(_, image)| image.height(&normal)).collect();
    heights.sort_by(f64::total_cmp);
    heights.windows(2).any(|pair| pair[1] - pair[0] < 1e-3)
}

impl Series {
    /// Its scans, where several cover one place and something tells them apart, so that no place is there twice in one of them.
    fn phases(self) -> Vec<Self> {
        if !has_doubles(&self.layers.iter().collect::<Vec<_>>()) {
            return vec![self];
        }
        for (k, name) in PHASES.iter().enumerate() {
            let mut scans: BTreeMap<&Option<String>, Vec<&Layer>> = BTreeMap::new();
            for layer in &self.layers {
                scans.entry(&layer.1.phase[k]).or_default().push(layer);
            }
            if scans.len() < 2 || scans.values().any(|layers| has_doubles(layers)) {
                continue;
            }
            let scan = |(phase, layers): (&Option<String>, Vec<&Layer>)| Self {
                identity: self.identity.clone(),
                stack: None,
                phase: Some(format!("{name} {}", phase.as_deref().unwrap_or("not stated"))),
                n_files: layers.len(),
                layers: layers.into_iter().cloned().collect(),
                why_not: self.why_not.clone(),
                fault: None,
            };
            return scans.into_iter().map(scan).collect();
        }
        vec![self]
    }

    /// Modality, number, identifier's ending, number of images and their size.
    pub(super) fn name(&self) -> String {
        let Identity { modality, series_uid, series_number } = &self.identity;
        let number = series_number.map_or("without number".into(), |n| n.to_string());
        let stack = self.stack.map_or(String::new(), |k| format!("#{k}"));
        // Only digits and dots are kept, so every byte is a character.
        let ending = &series_uid[series_uid.len().saturating_sub(ENDING)..];
        let uid = if series_uid.is_empty() { "none".into() } else { format!("..{ending}") };
        let n = if self.layers.is_empty() { self.n_files } else { self.layers.len() };
        let images = if n == 1 { "image" } else { "images" };
        let size = self.layers.first().map(|(_, first)| format!(" of {} x {}", first.n_columns, first.n_rows));
        let (size, phase) = (size.unwrap_or_default(), self.phase.as_ref().map_or(String::new(), |p| format!(", {p}")));
        format!("{modality} series {number}{stack}, identifier {uid}, {n} {images}{size}{phase}")
    }

    /// Its name, and why it is not taken or cannot be read.
    pub(super) fn described(&self) -> String {
        match (&self.why_not, &self.fault) {
            (Some(why), _) => format!("{} ({why})", self.name()),
            (None, Some(_)) => format!("{} (cannot be read)", self.name()),
            (None, None) => self.name(),
        }
    }

    /// The shortest that `choose` takes for it alone, among all.
    pub(super) fn choice(&self, all: &[Self]) -> String {
        let stack = self.stack.map_or(String::new(), |k| format!("#{k}"));
        let same = |s: &&Self| s.why_not.is_none() && s.identity.series_number == self.identity.series_number;
        match self.identity.series_number {
            Some(number) if all.iter().filter(same).all(|s| s.identity.series_uid == self.identity.series_uid) => {
                format!("{number}{stack}")
            }
            _ => {
                let uid = &self.identity.series_uid;
                format!("{}{stack}", &uid[uid.len().saturating_sub(ENDING)..])
            }
        }
    }

    /// Why it is not taken, if it is not.
    pub(super) fn why_not(&self) -> Option<&str> {
        self.why_not.as_deref()
    }
}
