//! The files that `register` writes: the pose in several forms, and the moved source with its residuals.

use super::{Register, SpaceOption, inputs::Inputs, refuse_existing, write_new};
use crate::app::UsageError;
use anyhow::{Context, Result};
use osteoflow_algorithms::target::Target;
use osteoflow_formats::{Space, pose_file::itk_text, write::write_cloud};
use osteoflow_geometry::{
    Cloud,
    nalgebra::{Isometry3, Point3},
};
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
}

/// The name of the column of residuals in the moved source.
pub(super) const RESIDUAL: &str = "residual_mm";

/// The endings under which the moved source can be written with its residuals.
const MOVED: [&str; 3] = ["ply", "pcd", "csv"];

/// Files to write.
pub(super) struct OutFiles {
    /// A folder to make first.
    folder: Option<PathBuf>,
    pub(super) poses: Vec<(PathBuf, Form)>,
    /// The moved source.
    pub(super) source: Option<PathBuf>,
}

impl OutFiles {
    /// The files that `asked` names, none of which exists yet.
    pub(super) fn of(asked: &Register) -> Result<Self> {
        let mut files = Self { folder: None, poses: Vec::new(), source: asked.write_source.clone() };
        if let Some(out) = &asked.out {
            match out.extension() {
                Some(_) => files.poses.push((out.clone(), form_of(out)?)),
                None => {
                    files.folder = Some(out.clone());
                    files.poses.push((out.join("pose.txt"), Form::Text));
                    files.poses.push((out.join("pose.json"), Form::Json));
                    files.poses.push((out.join("pose.tfm"), Form::Itk));
                    files.source.get_or_insert_with(|| out.join("source.ply"));
                }
            }
        }
        if let Some(file) = files.source.as_deref().filter(|file| !MOVED.contains(&ending(file).as_str())) {
            let message = format!("{} cannot be written: end it with .ply, .pcd or .csv", file.display());
            return Err(UsageError(format!("--write-source: {message}")).into());
        }
        files.poses.iter().map(|(file, _)| file).chain(&files.source).try_for_each(|file| refuse_existing(file))?;
        Ok(files)
    }

    /// Leaves out the transform of a folder if the space of a file is not known.
    ///
    /// # Errors
    /// The transform was asked for by its name.
    pub(super) fn check_space(&mut self, asked: &Register, inputs: &Inputs) -> Result<()> {
        let spaces = inputs.spaces(asked.space);
        let unknown = [(&asked.target, spaces[0]), (&asked.source, spaces[1])]
            .map(|(file, space)| (space == Space::Unknown).then(|| file.display().to_string()));
        let unknown: Vec<String> = unknown.into_iter().flatten().collect();
        if unknown.is_empty() {
            return Ok(());
        }
        if self.folder.is_some() {
            self.poses.retain(|(_, form)| *form != Form::Itk);
        }
        let Some((file, _)) = self.poses.iter().find(|(_, form)| *form == Form::Itk) else { return Ok(()) };
        let message = format!(
            "{}: a .tfm is always LPS, and {}; give --space LPS, as 3D Slicer takes such files, or --space RAS",
            file.display(),
            match &unknown[..] {
                [one] => format!("{one} does not state the space of its numbers"),
                both => format!("{} do not state the space of their numbers", both.join(" and ")),
            }
        );
        Err(UsageError(message).into())
    }

    /// Every file, in the order in which they are written.
    pub(super) fn all(&self) -> impl Iterator<Item = &PathBuf> {
        self.poses.iter().map(|(file, _)| file).chain(&self.source)
    }

    /// Writes the poses, each with the text that `text_of` gives, and the moved source.
    pub(super) fn write(&self, text_of: impl Fn(Form) -> String, moved: Option<&Cloud>) -> Result<()> {
        if let Some(folder) = &self.folder {
            fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
        }
        for (file, form) in &self.poses {
            write_new(file, &text_of(*form))?;
        }
        if let (Some(file), Some(moved)) = (&self.source, moved) {
            write_cloud(file, moved, Space::Unknown)?;
        }
        Ok(())
    }
}

fn form_of(file: &Path) -> Result<Form> {
    match ending(file).as_str() {
        "txt" => Ok(Form::Text),
        "json" => Ok(Form::Json),
        "tfm" => Ok(Form::Itk),
        other => {
            let message = "no pose is written so; end it with .txt (the matrix), .json (the whole answer) or .tfm (3D Slicer), or \
                           name a folder";
            Err(UsageError(format!("{}: .{other}: {message}", file.display())).into())
        }
    }
}

fn ending(file: &Path) -> String {
    file.extension().map(|end| end.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// The pose as an ITK transform, in LPS; `spaces` are those of the numbers of target and source.
pub(super) fn itk_file(t_target_source: &Isometry3<f64>, spaces: [Space; 2], comments: &[String]) -> String {
    let [target, source] = spaces.map(Space::turn);
    itk_text(&(target * t_target_source * source), comments)
}

/// The space in which the numbers of a file are once read, LPS where the file states one; `option` is for those that do not.
pub(super) fn space_of(stated: Space, option: Option<SpaceOption>) -> Space {
    match (stated, option) {
        (Space::Lps | Space::Ras, _) => Space::Lps,
        (Space::Unknown, option) => option.map_or(Space::Unknown, Into::into),
    }
}

/// The source moved to the target, with each point's distance from its surface, positive outside, mm.
pub(super) fn moved_source(target: &Target, source: &Cloud, t_target_source: &Isometry3<f64>) -> Result<Cloud> {
    let moved = source.transformed(target.frame.clone(), t_target_source);
    let residuals: Vec<f64> = moved.points().iter().map(|point| residual(target, point)).collect();
    Ok(moved.with_extra(RESIDUAL, residuals)?)
}

fn residual(target: &Target, point: &Point3<f64>) -> f64 {
    if let Some(closest) = target.mesh().and_then(|mesh| mesh.closest_point(point)) {
        let outward = (point - closest.point).dot(&closest.normal);
        return closest.distance_mm.copysign(outward);
    }
    let Some((index, distance_mm)) = target.nearest(point, f64::INFINITY) else { return f64::NAN };
    // Across the surface where the normal is known: samples lie apart.
    target.normals().map_or(distance_mm, |normals| (point - target.points()[index]).dot(&normals[index]))
}
