//! A simulated procedure, and its files.

mod folder;
mod set;

use super::{error::Error, out_dir, program::NOTICE};
use anyhow::{Context, Result, anyhow};
use clap::{Args, ValueEnum};
use osteoflow_algorithms::trust::fingerprint;
use osteoflow_formats::{
    input::sha256,
    mcap_read::Attachment,
    plan_file,
    recording_write::{Stream, recording_bytes},
    write::write_stl,
};
use osteoflow_geometry::{Cloud, Points, Pose, SurfaceKey, matrix_rows};
use osteoflow_simulation::{BoneParams, CtParams, Procedure, Subject, ct_surface};
use osteoflow_standard::own_bone;
use serde_json::{Value, json};
use set::Parameters;
use std::{
    collections::BTreeMap,
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

/// Number of points that a cloud may have.
const N_POINTS: RangeInclusive<u64> = 100..=500_000;

/// The format of the streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StreamFormat {
    /// One recording, procedure.mcap.
    Mcap,
    /// PLY scans, a CSV of poses, and procedure.toml that names them.
    Folder,
}

/// A simulated procedure.
#[derive(Debug, Clone, Args)]
pub struct SimulateRequest {
    /// The random seed.
    #[arg(long, default_value_t = 42)]
    pub seed: u64,

    /// Points of each cloud.
    #[arg(long, default_value_t = 20_000, value_name = "N", value_parser = clap::value_parser!(u64).range(N_POINTS))]
    pub points: u64,

    /// Simulate on this bone: a closed surface, STL or PLY, mm, in the CT's coordinates. Needs --plan.
    #[arg(long, value_name = "FILE", requires = "plan")]
    pub bone: Option<PathBuf>,

    /// Its plan, plan.json, or its anatomy alone, also under a key named after the bone's file.
    #[arg(long, value_name = "FILE", requires = "bone")]
    pub plan: Option<PathBuf>,

    /// Change any parameter of `acquire.simulated`, TABLE.PARAMETER=VALUE; of the CT, `ct.PARAMETER`; of the bone in CT
    /// and plan alone, `ct_bone.PARAMETER`; or of a displaced plan, `displaced.along_mm` and `displaced.across_mm`; may be
    /// given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,

    /// The format of the streams.
    #[arg(id = "as", long = "as", value_enum, default_value_t = StreamFormat::Mcap, value_name = "SHAPE")]
    pub format: StreamFormat,

    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
}

impl SimulateRequest {
    /// Simulates and writes the files into a folder. `warn` takes notes on the bone.
    ///
    /// # Errors
    /// [`Error`]; of usage if a parameter is wrong or the folder is not empty.
    pub fn write(&self, dir: &Path, warn: &mut dyn FnMut(&str)) -> Result<(), Error> {
        if !N_POINTS.contains(&self.points) {
            let (min, max) = (N_POINTS.start(), N_POINTS.end());
            return Err(Error::Usage(format!("points is {}, but must be between {min} and {max}", self.points)));
        }
        self.simulate(Some(dir), warn)?;
        Ok(())
    }

    /// The procedure that README and documentation use.
    pub(crate) fn of_readme(format: StreamFormat) -> Self {
        Self { seed: 42, points: 10_000, bone: None, plan: None, sets: Vec::new(), format, force: false }
    }

    /// Simulates, and writes the files if there is a folder for them.
    pub(crate) fn simulate(&self, dir: Option<&Path>, warn: &mut dyn FnMut(&str)) -> Result<Procedure> {
        let Parameters { procedure: params, ct, ct_bone, displaced } = Parameters::new(self.points, &self.sets)?;
        if let Some(dir) = dir {
            out_dir::make_plain(dir, self.force, "name another folder, or replace what is in it with --force")?;
        }
        let subject = self.subject(&params.bone)?;
        subject.notes.iter().for_each(|note| warn(note));
        let mut procedure = Procedure::simulate_for(&subject, &params, self.seed)?;
        // The plan was made on the CT.
        let in_ct = ct_bone.map_or(Ok(subject), |bone| self.subject(&bone))?;
        procedure.plan = osteoflow_simulation::displaced(in_ct.plan.clone(), &displaced)?;
        if let Some(dir) = dir {
            self.write_files(dir, &mut procedure, &in_ct, &ct)?;
        }
        Ok(procedure)
    }

    fn write_files(&self, dir: &Path, procedure: &mut Procedure, in_ct: &Subject, ct: &CtParams) -> Result<()> {
        let (ct_surface, bone) = (ct_surface(in_ct.bone(), ct, self.seed)?, dir.join("bone.stl"));
        write_stl(&bone, &ct_surface)?;
        let points = fingerprint(ct_surface.vertices());
        procedure.plan.surface =
            Some(SurfaceKey { sha256: Some(sha256(&bone)?), frame_of_reference_uid: None, points });
        match self.format {
            StreamFormat::Mcap => write_streams(&dir.join("procedure.mcap"), procedure, self.seed)?,
            StreamFormat::Folder => folder::write(dir, procedure)?,
        }
        write_stl(&dir.join("phantom.stl"), &procedure.phantom)?;
        plan_file::write_plan(&dir.join("plan.json"), &procedure.plan)?;
        write_file(&dir.join("truth.json"), format!("{:#}\n", self.truth_json(procedure)))?;
        write_file(&dir.join("README.md"), self.readme())
    }

    fn own_bone(&self) -> Option<(&Path, &Path)> {
        self.bone.as_deref().zip(self.plan.as_deref())
    }

    /// The bone and its plan, built in or from files.
    fn subject(&self, params: &BoneParams) -> Result<Subject> {
        match self.own_bone() {
            Some((bone, plan)) => own_bone::read_altered(bone, plan, params).map_err(|error| anyhow!("{error}")),
            None => Ok(Subject::built_in(params)?),
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
        let (streams, switch) = match self.format {
            StreamFormat::Mcap => ("`procedure.mcap`: the recording, Foxglove schemas in protobuf, metres inside", ""),
            StreamFormat::Folder => {
                ("`procedure.toml` and what it names: PLY scans and `poses.csv`, millimetres", " --as folder")
            }
        };
        let (own, licence) = match self.own_bone() {
            Some((bone, plan)) => (
                format!(" --bone {} --plan {}", bone.display(), plan.display()),
                "that of the bone, which these files show",
            ),
            None => (String::new(), "CC0"),
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

fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    osteoflow_formats::durable::write(path, content).with_context(|| format!("{} cannot be written", path.display()))
}

/// The number of the landmark of a laser scan: a scan with another's label is in the other's stream.
pub(crate) fn laser_number(procedure: &Procedure, k: usize) -> usize {
    let marks = &procedure.truth.laser_marks_ct.points;
    marks.iter().position(|mark| procedure.laser[k].label.as_ref() == Some(&mark.name)).unwrap_or(k) + 1
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
    write_file(path, recording_bytes(&streams, &metadata, &[attachment])?)
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
