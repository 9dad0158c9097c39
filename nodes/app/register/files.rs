//! The files that `register` writes: the pose in several forms, and the moved source with its residuals.

use super::RegisterRequest;
use crate::app::{
    error::UsageError,
    files::{check_new, write_new},
};
use anyhow::{Context, Result};
use osteoflow_algorithms::{metrics::distance_outside, target::Target};
use osteoflow_formats::{
    Space, durable,
    write::{Precision, ending, write_cloud},
};
use osteoflow_geometry::{
    Cloud,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_standard::parts;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// The form of a pose in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// The 4 × 4 matrix as text.
    Text,
    /// The whole answer.
    Json,
    /// An ITK transform, as 3D Slicer opens.
    Itk,
    /// A scene of 3D Slicer.
    Scene,
}

/// The name of the column of residuals in the moved source.
pub(super) const RESIDUAL: &str = "residual_mm";

/// The endings under which the moved source can be written with its residuals.
const MOVED: [&str; 3] = ["ply", "pcd", "csv"];

/// Files to write.
#[derive(Debug, Clone)]
pub(super) struct OutFiles {
    /// A folder to make first.
    folder: Option<PathBuf>,
    poses: Vec<(PathBuf, Form)>,
    /// The moved source.
    pub(super) source: Option<PathBuf>,
    /// Every step.
    trace: Option<PathBuf>,
}

impl OutFiles {
    /// The files of a request, none of which exists yet.
    pub(super) fn of(request: &RegisterRequest) -> Result<Self> {
        let (source, trace) = (request.write_source.clone(), request.trace.clone());
        let mut all = Self { folder: None, poses: Vec::new(), source, trace };
        if let Some(out) = &request.out {
            match out.extension() {
                Some(_) => all.poses.push((out.clone(), form_of(out)?)),
                None => {
                    all.folder = Some(out.clone());
                    all.poses.push((out.join("pose.txt"), Form::Text));
                    all.poses.push((out.join("pose.json"), Form::Json));
                    all.poses.push((out.join("pose.tfm"), Form::Itk));
                    all.source.get_or_insert_with(|| out.join("source.ply"));
                }
            }
        }
        if let Some(file) = all.source.as_deref().filter(|file| !MOVED.contains(&ending(file).as_str())) {
            let message = format!("{} cannot be written: end it with .ply, .pcd or .csv", file.display());
            usage!("--write-source: {message}");
        }
        all.all().try_for_each(|file| check_new(file).and_then(|()| all.check_writable(file)))?;
        Ok(all)
    }

    /// Makes and removes a file where `file` is to be, before anything is computed.
    fn check_writable(&self, file: &Path) -> Result<()> {
        let mut folder = file.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
        if self.folder.as_deref() == Some(folder) {
            // It is made, with those above it.
            folder = folder.ancestors().find(|above| above.exists()).unwrap_or(Path::new("."));
        }
        let there = folder.join(file.file_name().unwrap_or_default());
        durable::Part::new(&there).map(drop).with_context(|| format!("{} cannot be written", file.display()))
    }

    /// The files that can be written: without the transform of a folder if the space of a file is not known.
    ///
    /// # Errors
    /// The transform was asked for by its name.
    pub(super) fn with_known_spaces(&self, names: [&PathBuf; 2], spaces: [Space; 2]) -> Result<Self> {
        let unknown = names.into_iter().zip(spaces).filter(|(_, space)| *space == Space::Unknown);
        let unknown: Vec<String> = unknown.map(|(name, _)| name.display().to_string()).collect();
        let mut files = self.clone();
        if unknown.is_empty() {
            return Ok(files);
        }
        if files.folder.is_some() {
            files.poses.retain(|(_, form)| *form != Form::Itk);
        }
        let lps = |(_, form): &&(PathBuf, Form)| matches!(form, Form::Itk | Form::Scene);
        let Some((file, _)) = files.poses.iter().find(lps) else { return Ok(files) };
        usage!(
            "{}: a .{} is always LPS, and {}; give --space LPS, as 3D Slicer takes such files, or --space RAS",
            file.display(),
            ending(file),
            match &unknown[..] {
                [one] => format!("{one} does not state the space of its numbers"),
                both => format!("{} do not state the space of their numbers", both.join(" and ")),
            }
        );
    }

    /// Every file, in the order in which they are written.
    pub(super) fn all(&self) -> impl Iterator<Item = &PathBuf> {
        self.poses.iter().map(|(file, _)| file).chain(&self.source).chain(&self.trace)
    }

    /// Writes the poses, each with the bytes that `bytes_of` gives, the moved source and the steps; returns what their readers should
    /// know.
    pub(super) fn write(
        &self,
        bytes_of: impl Fn(Form, &Path) -> Result<Vec<u8>>,
        moved: Option<&Cloud>,
        steps: impl Fn() -> String,
    ) -> Result<Vec<String>> {
        if let Some(folder) = &self.folder {
            fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
        }
        let mut notes = Vec::new();
        for (file, form) in &self.poses {
            write_new(file, bytes_of(*form, file)?)?;
        }
        if let (Some(file), Some(moved)) = (&self.source, moved) {
            let told = write_cloud(file, moved, Space::Unknown, Precision::Single)?;
            notes.extend(told.into_iter().map(|note| format!("{}: {note}", file.display())));
        }
        self.trace.iter().try_for_each(|file| write_new(file, steps()))?;
        Ok(notes)
    }
}

fn form_of(file: &Path) -> Result<Form> {
    match ending(file).as_str() {
        "txt" => Ok(Form::Text),
        "json" => Ok(Form::Json),
        "tfm" => Ok(Form::Itk),
        "mrb" => Ok(Form::Scene),
        other => {
            let message = "no pose is written so; end it with .txt (the matrix), .json (the whole answer), .tfm or .mrb (3D Slicer), \
                           or name a folder";
            Err(UsageError(format!("{}: .{other}: {message}", file.display())).into())
        }
    }
}

/// The space in which the numbers of a file are once read, LPS where the file states one; `option` is for those that do not.
pub(super) fn space_of(stated: Space, option: Option<Space>) -> Space {
    match stated {
        Space::Lps | Space::Ras => Space::Lps,
        Space::Unknown => option.unwrap_or_default(),
    }
}

/// The source moved to the target, with each point's distance from its surface, positive outside, mm, and whether it belongs to the
/// bone: 1 for the points of `cropped` whose distance is among those of the inliers.
pub(super) fn moved_source(
    target: &Target,
    source: &Cloud,
    t_target_source: &Isometry3<f64>,
    cropped: Option<&Cloud>,
    inliers_mm: Option<[f64; 2]>,
) -> Result<Cloud> {
    let moved = source.transformed(target.frame.clone(), t_target_source);
    let residuals: Vec<f64> = moved.points().iter().map(|point| residual(target, point)).collect();
    // A crop keeps the order.
    let mut kept = cropped.unwrap_or(source).points().iter().peekable();
    let of_kept = |(point, residual): (&Point3<f64>, &f64)| match kept.next_if(|next| *next == point) {
        Some(_) => *residual,
        None => f64::NAN,
    };
    let of_kept: Vec<f64> = source.points().iter().zip(&residuals).map(of_kept).collect();
    Ok(parts::with_on_bone(moved.with_extra(RESIDUAL, residuals)?, &of_kept, inliers_mm)?)
}

fn residual(target: &Target, point: &Point3<f64>) -> f64 {
    if let Some(distance_mm) = target.mesh().and_then(|mesh| distance_outside(point, mesh)) {
        return distance_mm;
    }
    let Some((index, distance_mm)) = target.nearest(point, f64::INFINITY) else { return f64::NAN };
    // Across the surface where the normal is known: samples lie apart.
    target.normals().map_or(distance_mm, |normals| (point - target.points()[index]).dot(&normals[index]))
}
