mod folder;
mod openigtlink;
mod set;

use super::common::{
    exit::{Exit, UsageError},
    global::Global,
    result_table::NOTICE,
    terminal,
};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use openigtlink::{ScanType, laser_number};
use osteoflow_formats::{
    mcap_read::Attachment,
    mesh_file, plan_file,
    recording_write::{Layout, Stream, write_recording},
};
use osteoflow_geometry::{Cloud, Points, Pose, matrix_rows};
use osteoflow_simulation::{BoneParams, CtParams, Procedure, Subject, ct_surface};
use osteoflow_standard::own_bone;
use serde_json::{Value, json};
use set::Settings;
use std::{
    collections::BTreeMap,
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// Write a simulated procedure, on the built-in bone or on your own, as files that other programs can read.
///
/// A recording in Foxglove's schemas (or a folder of plain files), the CT surface, the phantom, the plan, and the ground
/// truth, with a README that explains how they were made; or the streams over OpenIGTLink, as their devices would send them.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow simulate --seed 7 --out /tmp/procedure
  osteoflow simulate --points 4000 --out /tmp/small
  osteoflow simulate --bone fibula.stl --plan anatomy.json --out /tmp/mine
  osteoflow simulate --set ct_bone.mirrored=true --set tissue.share=0.2 --out /tmp/wrong_leg
  osteoflow simulate --openigtlink 18944 --rate 10
  osteoflow run graphs/fibula_recorded.toml --set recording.path=/tmp/procedure/procedure.mcap \\
      --set bone.path=/tmp/procedure/bone.stl --set phantom.path=/tmp/procedure/phantom.stl \\
      --set plan.path=/tmp/procedure/plan.json")]
pub(crate) struct Simulate {
    /// The random seed.
    #[arg(long, default_value_t = 42)]
    seed: u64,

    /// Points of each cloud.
    #[arg(long, default_value_t = 20_000, value_name = "N", value_parser = clap::value_parser!(u64).range(100..=500_000))]
    points: u64,

    /// Simulate on this bone: a closed surface, STL or PLY, mm, in the CT's coordinates. Needs --plan.
    #[arg(long, value_name = "FILE", requires = "plan")]
    bone: Option<PathBuf>,

    /// Its plan, plan.json, or its anatomy alone, also under a key named after the bone's file.
    #[arg(long, value_name = "FILE", requires = "bone")]
    plan: Option<PathBuf>,

    /// Change any parameter of `acquire.simulated`, TABLE.PARAMETER=VALUE; of the CT, `ct.PARAMETER`; or of the bone in CT
    /// and plan alone, `ct_bone.PARAMETER`; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    /// The format of the streams.
    #[arg(long = "as", value_enum, default_value_t = StreamFormat::Mcap, value_name = "SHAPE")]
    shape: StreamFormat,

    /// Play the procedure over OpenIGTLink, as a PLUS server would: wait at this port of 127.0.0.1 for one client, send, and end.
    /// 0 is a free port, which is printed.
    #[arg(long, value_name = "PORT")]
    openigtlink: Option<u16>,

    /// The speed of --openigtlink relative to the procedure's own time.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "openigtlink", value_parser = rate)]
    rate: f64,

    /// The type of the scans of --openigtlink.
    #[arg(long, value_enum, default_value_t = ScanType::Polydata, value_name = "TYPE", requires = "openigtlink")]
    scans: ScanType,

    /// The folder to write into.
    #[arg(long, value_name = "DIR", required_unless_present = "openigtlink")]
    out: Option<PathBuf>,

    /// Replace existing files.
    #[arg(long)]
    force: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum StreamFormat {
    /// One recording, procedure.mcap.
    Mcap,
    /// PLY scans, a CSV of poses, and procedure.toml that names them.
    Folder,
}

impl Simulate {
    /// The procedure of `osteoflow new procedure`: a folder of files.
    pub(crate) fn example(out: PathBuf) -> Self {
        let shape = StreamFormat::Folder;
        Self {
            seed: 42,
            points: 10_000,
            bone: None,
            plan: None,
            sets: Vec::new(),
            shape,
            openigtlink: None,
            rate: 1.0,
            scans: ScanType::Polydata,
            out: Some(out),
            force: false,
        }
    }

    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let settings = Settings::new(self.points, &self.sets)?;
        if let Some(dir) = &self.out {
            self.make_folder(dir)?;
        }
        let Settings { procedure: params, ct, ct_bone } = settings;
        let subject = self.subject(&params.bone)?;
        for note in &subject.notes {
            writeln!(terminal::stderr(), "warning: {note}")?;
        }
        let mut procedure = Procedure::simulate_for(&subject, &params, self.seed)?;
        // The plan was made on the CT.
        let in_ct = ct_bone.map_or(Ok(subject), |bone| self.subject(&bone))?;
        procedure.plan = in_ct.plan.clone();
        if let Some(dir) = &self.out {
            self.write_files(dir, &procedure, &in_ct, &ct)?;
            if !global.quiet {
                writeln!(terminal::stderr(), "SIMULATED procedure of seed {} in {}", self.seed, dir.display())?;
            }
        }
        if let Some(port) = self.openigtlink {
            openigtlink::serve(&procedure, port, self.rate, self.scans, global)?;
        }
        Ok(Exit::Done)
    }

    fn make_folder(&self, dir: &Path) -> Result<()> {
        fs::create_dir_all(dir).with_context(|| format!("{} cannot be made a folder", dir.display()))?;
        let used = fs::read_dir(dir).with_context(|| format!("{} cannot be read", dir.display()))?.next().is_some();
        if used && !self.force {
            let message =
                format!("{} is not empty; name another folder, or replace what is in it with --force", dir.display());
            return Err(UsageError(message).into());
        }
        Ok(())
    }

    fn write_files(&self, dir: &Path, procedure: &Procedure, in_ct: &Subject, ct: &CtParams) -> Result<()> {
        match self.shape {
            StreamFormat::Mcap => write_streams(&dir.join("procedure.mcap"), procedure, self.seed)?,
            StreamFormat::Folder => folder::write(dir, procedure)?,
        }
        let ct_surface = ct_surface(in_ct.bone(), ct, self.seed)?;
        mesh_file::write_stl(&dir.join("bone.stl"), &ct_surface)?;
        mesh_file::write_stl(&dir.join("phantom.stl"), &procedure.phantom)?;
        plan_file::write_plan(&dir.join("plan.json"), &procedure.plan)?;
        write_text(&dir.join("truth.json"), &format!("{:#}\n", self.truth_json(procedure)))?;
        write_text(&dir.join("README.md"), &self.readme())
    }

    /// The bone and its plan, built in or from files.
    fn subject(&self, params: &BoneParams) -> Result<Subject> {
        match (&self.bone, &self.plan) {
            (Some(bone), Some(plan)) => {
                own_bone::read_altered(bone, plan, params).map_err(|error| anyhow::anyhow!("{error}"))
            }
            _ => Ok(Subject::built_in(params)?),
        }
    }

    /// The ground truth, with the changed parameters.
    fn truth_json(&self, procedure: &Procedure) -> Value {
        let mut truth = truth_json(procedure, self.seed);
        if !self.sets.is_empty() {
            truth["settings"] = json!(self.sets);
        }
        truth
    }

    fn readme(&self) -> String {
        let (seed, points) = (self.seed, self.points);
        let (streams, switch) = match self.shape {
            StreamFormat::Mcap => ("`procedure.mcap`: the recording, Foxglove schemas in protobuf, metres inside", ""),
            StreamFormat::Folder => {
                ("`procedure.toml` and what it names: PLY scans and `poses.csv`, millimetres", " --as folder")
            }
        };
        let (own, licence) = match (&self.bone, &self.plan) {
            (Some(bone), Some(plan)) => (
                format!(" --bone {} --plan {}", bone.display(), plan.display()),
                "that of the bone, which these files show",
            ),
            _ => (String::new(), "CC0"),
        };
        let sets: String = self.sets.iter().map(|set| format!(" --set '{set}'")).collect();
        format!(
            "# A simulated procedure\n\n\
             Made by osteoflow {} with\n\n\
             ```text\nosteoflow simulate --seed {seed} --points {points}{own}{sets}{switch} --out DIR\n```\n\n\
             - {streams}\n\
             - `bone.stl`: the surface that the simulated CT gave, frame `ct`, mm\n\
             - `phantom.stl`: the calibration phantom's CAD, frame `phantom`, mm\n\
             - `plan.json`: landmarks, assessment points, cutting planes, CAD poses, mm\n\
             - `truth.json`: what really was, for scoring, never an input; `X_T_Y` takes coordinates in Y to X\n\n\
             SIMULATED: {}. Licence: {licence}.\n",
            env!("CARGO_PKG_VERSION"),
            NOTICE
        )
    }
}

fn write_text(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("{} cannot be written", path.display()))
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (0.001..=1e9).contains(&rate) => Ok(rate),
        _ => Err("a speed is a number from 0.001 to 1e9".into()),
    }
}

/// The procedure as one recording: the topics of a real one, the plan as attachment, the region of interest as metadata.
fn write_streams(path: &Path, procedure: &Procedure, seed: u64) -> Result<()> {
    let cloud = |cloud: &Cloud| Stream::Clouds(vec![cloud.clone()]);
    let poses = |poses: &[Pose]| Stream::Transforms(poses.to_vec());
    let tips = |points: &Points| {
        Stream::Tips(points.points.iter().map(|p| (points.frame.clone(), p.stamp_ns, p.position)).collect())
    };
    let mut streams = vec![
        ("/phantom/marker_cad".to_owned(), poses(std::slice::from_ref(&procedure.t_phantom_phantom_marker))),
        ("/tracker/camera_marker".into(), poses(&procedure.camera_marker)),
        ("/tracker/phantom_marker".into(), poses(&procedure.phantom_marker)),
        ("/tracker/bone_marker".into(), poses(&procedure.bone_marker)),
        ("/camera/calibration".into(), cloud(&procedure.phantom_scan)),
        ("/camera/scan".into(), cloud(&procedure.scan)),
    ];
    let lasers = procedure.laser.iter().enumerate();
    let number = |k: usize| laser_number(procedure, k);
    streams.extend(lasers.map(|(k, scan)| (format!("/camera/laser_p{}", number(k)), cloud(scan))));
    streams.push(("/stylus/init".into(), tips(&procedure.stylus_init)));
    streams.push(("/stylus/assessment".into(), tips(&procedure.stylus_assessment)));
    streams.push(("/stylus/palpation".into(), tips(&procedure.stylus_palpation)));

    let mut about = BTreeMap::from([("simulated".to_owned(), "true".to_owned()), ("seed".into(), seed.to_string())]);
    if let Some(region) = &procedure.region {
        for (key, corner) in [("roi_camera_min_m", &region.min), ("roi_camera_max_m", &region.max)] {
            let metres = corner.coords / osteoflow_geometry::MM_PER_M;
            about.insert(key.into(), format!("{} {} {}", metres.x, metres.y, metres.z));
        }
    }
    let plan = format!("{:#}\n", plan_file::plan_json(&procedure.plan));
    let attachment =
        Attachment { name: "plan.json".into(), media_type: "application/json".into(), data: plan.into_bytes().into() };
    let metadata = BTreeMap::from([("procedure".to_owned(), about)]);
    Ok(write_recording(path, &streams, &metadata, &[attachment], &Layout::default())?)
}

/// The ground truth, under the keys of the development recordings.
fn truth_json(procedure: &Procedure, seed: u64) -> Value {
    let truth = &procedure.truth;
    let matrix = |pose: &Pose| json!(matrix_rows(&pose.isometry));
    let places =
        |points: &Points| -> Value { points.points.iter().map(|p| json!(p.position.coords.as_slice())).collect() };
    let planes = |planes: &osteoflow_geometry::Planes| -> Value {
        planes.planes.iter().filter_map(|p| Some(json!(matrix_rows(p.isometry()?)))).collect()
    };
    let t_camera_world = truth.t_world_camera_at_scan.isometry.inverse();
    json!({
        "units": "mm",
        "convention": "X_T_Y takes coordinates in Y to coordinates in X; 4 x 4, row by row",
        "simulated": true,
        "seed": seed,
        "C_T_Mc": matrix(&truth.t_camera_camera_marker),
        "P_T_Mp": matrix(&truth.t_phantom_phantom_marker),
        "C_T_P_calibration": matrix(&truth.t_camera_phantom),
        "W_T_C_scan": matrix(&truth.t_world_camera_at_scan),
        "W_T_CT": matrix(&truth.t_world_ct_at_scan),
        "CT_T_W": matrix(&truth.t_world_ct_at_scan.inverse()),
        "W_T_Mb_scan": matrix(&truth.t_world_bone_marker_at_scan),
        "CT_T_Mb": matrix(&truth.t_ct_bone_marker),
        "W_T_CT_after_motion": matrix(&truth.t_world_ct_after_motion),
        "laser_spots_CT": places(&truth.laser_spots_ct),
        "laser_spots_W": places(&truth.laser_spots_world),
        "laser_spots_C": places(&truth.laser_spots_world.transformed("camera", &t_camera_world)),
        "assessment_W_true": places(&truth.assessment_world),
        "planes_W_scan": planes(&truth.planes_world_at_scan),
        "planes_W_after_motion": planes(&truth.planes_world_after_motion),
    })
}
