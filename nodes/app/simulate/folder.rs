//! The simulated procedure as a folder of plain files, for `acquire.folder`.

use anyhow::{Context, Result};
use osteoflow_formats::{durable, folder::FILE_NAME, poses_csv::write_poses, write::write_ply};
use osteoflow_geometry::{Cloud, Points};
use osteoflow_simulation::Procedure;
use std::{fmt::Write as _, path::Path};

/// PLY scans, `poses.csv`, stylus points as CSV, and the `procedure.toml` that assigns their roles; millimetres.
pub(super) fn write(dir: &Path, procedure: &Procedure) -> Result<()> {
    let mut toml = String::from(
        "# A simulated procedure as plain files. Lengths in mm, times on the tracker's clock.\n\
         format    = 1\ntracker   = true\nsimulated = true\nunit      = \"mm\"\n",
    );
    scan(dir, &mut toml, "[scan]", "scan.ply", &procedure.scan)?;
    for (cloud, n) in procedure.laser.iter().zip(1..) {
        scan(dir, &mut toml, "[[laser]]", &format!("laser_p{n}.ply"), cloud)?;
    }
    scan(dir, &mut toml, "[phantom_scan]", "phantom_scan.ply", &procedure.phantom_scan)?;

    let cad = std::iter::once(&procedure.t_phantom_phantom_marker);
    let tracked = [&procedure.camera_marker, &procedure.phantom_marker, &procedure.bone_marker];
    let poses: Vec<_> = cad.chain(tracked.into_iter().flatten()).cloned().collect();
    write_poses(&dir.join("poses.csv"), &poses)?;
    toml.push_str("\n[[poses]]\nfile = \"poses.csv\"\n");
    let touched = [
        ("init", &procedure.stylus_init),
        ("assessment", &procedure.stylus_assessment),
        ("palpation", &procedure.stylus_palpation),
    ];
    for (role, points) in touched {
        let file = format!("stylus_{role}.csv");
        let path = dir.join(&file);
        durable::write(&path, tips(points)).with_context(|| format!("{} cannot be written", path.display()))?;
        let frame = points.frame.as_str();
        let _ = write!(toml, "\n[[stylus]]\nrole  = \"{role}\"\nfile  = \"{file}\"\nframe = \"{frame}\"\n");
    }
    if let Some(region) = &procedure.region {
        let (min, max) = (region.min.coords.as_slice(), region.max.coords.as_slice());
        let _ = write!(toml, "\n[region]\nmin = {min:?}\nmax = {max:?}\n");
    }
    for (role, file) in [("plan", "plan.json"), ("bone", "bone.stl"), ("phantom", "phantom.stl")] {
        let _ = write!(toml, "\n[{role}]\nfile = \"{file}\"\n");
    }
    let path = dir.join(FILE_NAME);
    durable::write(&path, toml).with_context(|| format!("{} cannot be written", path.display()))
}

fn scan(dir: &Path, toml: &mut String, table: &str, file: &str, cloud: &Cloud) -> Result<()> {
    write_ply(&dir.join(file), cloud, 1.0)?;
    let label = cloud.label.as_ref().map(|label| format!("label    = \"{label}\"\n")).unwrap_or_default();
    let _ = write!(toml, "\n{table}\n{label}file     = \"{file}\"\nstamp_ns = {}\n", cloud.stamp_ns);
    Ok(())
}

fn tips(points: &Points) -> String {
    let mut csv = String::from("name,x,y,z,t_ns\n");
    for point in points.points.iter() {
        let p = point.position;
        let _ = writeln!(csv, "{},{},{},{},{}", point.name, p.x, p.y, p.z, point.stamp_ns);
    }
    csv
}
