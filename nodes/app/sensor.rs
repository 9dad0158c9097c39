//! How a sensor errs, from scans of parts whose shape is known.

mod standard;

use super::{
    files::{check_new, write_new},
    register::{RegisterInput, RegisterRequest},
};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    sensor::{Sensor, SensorKind},
    sensor_error::{Part, ScanErrors, SensorErrors, Told},
};
use osteoflow_engine::run::Observer;
use osteoflow_formats::{
    input,
    mesh_or_cloud::{CloudFileRead, MeshOrCloud, read_mesh_or_cloud},
};
use osteoflow_geometry::nalgebra::{Isometry3, Point3};
use osteoflow_statistics::counted;
use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool},
};

/// Rules of the verdict that speak of the sensor, which is what is measured, or of another place of the part that fits as well, where the
/// errors are the same.
const NOT_AGAINST: [&str; 2] = ["sensor", "start"];
/// Offsets that are known to no better than this, mm, tell nothing.
const MAX_BIAS_MM: f64 = 2.0;

/// What is measured, of which scans.
#[derive(Debug, Clone, Args)]
pub struct SensorRequest {
    /// The folder of the scans, each of one part and nothing else; of --standard, of CSV files with repeated readings, or one such file.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,

    /// What was scanned: a surface, `plane`, or `ball:RADIUS_MM`. Of several, which may be repeated, a scan is of the file with whose name its own begins.
    #[arg(long = "part", value_name = "FILE|plane|ball:RADIUS_MM", required_unless_present = "standard")]
    parts: Vec<String>,

    /// The kind of the sensor, from which keys are taken that the scans do not show, and by whose errors scans are registered. Default: depth_camera
    /// to register, and in the profile the kind whose errors are nearest. Of a stylus the offset outward is the radius of its tip.
    #[arg(long, value_name = "KIND", value_parser = kind)]
    like: Option<SensorKind>,

    /// The unit of the scans in mm: 1000 for metres.
    #[arg(long, default_value_t = 1.0, value_name = "MM", value_parser = super::register::unit)]
    unit_mm: f64,

    /// Write the profile, which `register --sensor FILE` reads. Nothing is overwritten.
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,

    /// Write a page with tables and pictures. Nothing is overwritten.
    #[arg(long, value_name = "FILE.html")]
    page: Option<PathBuf>,

    /// Instead of a profile, the numbers of a standard from repeated readings of named divots (NAME,x,y,z).
    #[arg(long, value_enum, value_name = "STANDARD", requires = "reference", conflicts_with_all = ["parts", "like", "out", "page"])]
    standard: Option<Standard>,

    /// The reference positions of the divots (NAME,x,y,z).
    #[arg(long, value_name = "FILE.csv", requires = "standard")]
    reference: Option<PathBuf>,
}

/// A standard of accuracy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Standard {
    /// ASTM F2554: positional accuracy of computer-assisted surgical systems.
    F2554,
}

fn kind(text: &str) -> Result<SensorKind, String> {
    let names = SensorKind::ALL.map(SensorKind::word).join(", ");
    SensorKind::ALL.into_iter().find(|kind| kind.word() == text).ok_or_else(|| format!("a sensor is one of {names}"))
}

/// What was measured.
pub(crate) struct Measured {
    /// Name and value of each number, for people.
    pub(crate) rows: Vec<(String, String)>,
    /// What to know of them.
    pub(crate) notes: Vec<String>,
    /// Everything.
    pub(crate) json: serde_json::Value,
}

/// Who watches the registrations, and may stop them.
type Watch<'a> = (&'a dyn Observer, &'a Arc<AtomicBool>);

/// A part that was scanned.
struct Known {
    /// As it was given.
    name: String,
    /// What a scan's name begins with.
    prefix: String,
    part: Part,
    /// Its surface, and how far it extends, mm.
    surface: Option<(MeshOrCloud, f64)>,
    sha256: Option<String>,
}

impl Known {
    fn of(given: &str) -> Result<Self> {
        let simple = |part| Self { name: given.into(), prefix: String::new(), part, surface: None, sha256: None };
        if given == "plane" {
            return Ok(simple(Part::Plane));
        }
        if let Some(radius) = given.strip_prefix("ball:") {
            let radius_mm: Option<f64> = radius.parse().ok().filter(|mm| (0.1..=1e5).contains(mm));
            let Some(radius_mm) = radius_mm else {
                usage!("--part {given}: a radius in mm is expected, such as ball:25.4");
            };
            return Ok(simple(Part::Ball(radius_mm)));
        }
        let path = Path::new(given);
        let read = read_mesh_or_cloud(path, &input::read(path)?, 1.0, "ct")?;
        let MeshOrCloud::Mesh(of_file) = &read else {
            usage!("--part {given}: the file holds points, but a surface is needed; export the part as STL");
        };
        let (part, span_mm) = (Part::Mesh(MeshQuery::new(&of_file.mesh)), span_mm(of_file.mesh.vertices()));
        let prefix = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self {
            name: given.into(),
            prefix,
            part,
            surface: Some((read, span_mm)),
            sha256: Some(input::sha256(path)?),
        })
    }

    /// The errors of a scan of it, or why it has none.
    fn errors(
        &self,
        path: &Path,
        scan: &CloudFileRead,
        like: SensorKind,
        watch: &Watch<'_>,
    ) -> Result<Result<ScanErrors, String>> {
        let points = scan.cloud.points();
        let start = match &self.surface {
            None => Isometry3::identity(),
            Some((surface, part_mm)) => {
                let scan_mm = span_mm(points);
                if !(0.05..=1.3).contains(&(scan_mm / part_mm)) {
                    let fits = |unit: &&f64| (0.2..=1.3).contains(&(scan_mm * *unit / part_mm));
                    let units: Vec<String> = [10.0, 25.4, 1000.0, 0.1, 1.0 / 25.4, 0.001]
                        .iter()
                        .filter(fits)
                        .map(|unit| format!("--unit-mm {unit:.4}"))
                        .collect();
                    let remedy = if units.is_empty() {
                        "is it of this part?".into()
                    } else {
                        format!("is it in another unit? try {}", units.join(" or "))
                    };
                    return Ok(Err(format!("it spans {scan_mm:.4} mm and {} {part_mm:.1} mm: {remedy}", self.name)));
                }
                match registered(&self.name, surface, path, scan, like, watch)? {
                    Ok(pose) => pose,
                    Err(why) => return Ok(Err(why)),
                }
            }
        };
        let viewpoint = scan.cloud.viewpoint.map(|pose| pose * Point3::origin()).or_else(|| {
            let is_before = |sign: f64| points.iter().all(|p| p.z * sign > 0.0);
            (is_before(1.0) || is_before(-1.0)).then(Point3::origin)
        });
        Ok(ScanErrors::of(points, &self.part, &start, viewpoint).map_err(|why| why.to_string()))
    }
}

/// The pose of a scan on a surface, or why it is not known.
fn registered(
    name: &str,
    surface: &MeshOrCloud,
    path: &Path,
    scan: &CloudFileRead,
    like: SensorKind,
    (observer, cancelled): &Watch<'_>,
) -> Result<Result<Isometry3<f64>, String>> {
    let mut request = RegisterRequest::new(name, path);
    request.target.content = Some(surface.clone());
    request.source = RegisterInput { path: path.into(), content: Some(MeshOrCloud::Cloud(scan.clone(), Vec::new())) };
    request.sensor = Some(like.word().into());
    let registration = request.check()?.run(*observer, cancelled)?;
    let against = |reason: &&serde_json::Value| {
        reason["answer"] != "trusted" && !NOT_AGAINST.iter().any(|rule| reason["rule"] == *rule)
    };
    let reasons = registration.run.results["verdict"]["reasons"].as_array();
    let first = reasons
        .into_iter()
        .flatten()
        .find(against)
        .map(|reason| reason["reason"].as_str().unwrap_or_default().to_owned());
    Ok(match (registration.pose(), registration.refusal(), first) {
        (Some(pose), _, None) => Ok(*pose),
        (_, Some(why), _) => Err(why.to_owned()),
        (_, None, why) => Err(why.unwrap_or_else(|| "it has no pose".into())),
    })
}

/// The diagonal of the box around points, mm.
fn span_mm(points: &[Point3<f64>]) -> f64 {
    let Some(first) = points.first() else { return 0.0 };
    let (low, high) = points.iter().fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
    (high - low).norm()
}

/// The files of a folder by name, without hidden ones and folders.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let cannot = || format!("{} cannot be read: a folder of scans is expected", folder.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let path = entry.with_context(cannot)?.path();
        if path.is_file() && !path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.')) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

impl SensorRequest {
    /// Measures, and writes the files that are named.
    pub(crate) fn run(&self, observer: &dyn Observer, cancelled: &Arc<AtomicBool>) -> Result<Measured> {
        if let (Some(Standard::F2554), Some(reference)) = (self.standard, &self.reference) {
            let files = if self.folder.is_dir() { files_of(&self.folder)? } else { vec![self.folder.clone()] };
            return standard::f2554(&files, reference);
        }
        [&self.out, &self.page].into_iter().flatten().try_for_each(|file| check_new(file))?;
        let parts = self.parts.iter().map(|given| Known::of(given)).collect::<Result<Vec<_>>>()?;
        let (mut scans, mut left_out): (Vec<(String, CloudFileRead, ScanErrors)>, Vec<(String, String)>) =
            Default::default();
        for path in files_of(&self.folder)? {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let of_name =
                parts.iter().filter(|known| name.starts_with(&known.prefix)).max_by_key(|known| known.prefix.len());
            let Some(known) = (if parts.len() == 1 { parts.first() } else { of_name }) else {
                left_out.push((name, "its name begins with that of no --part".into()));
                continue;
            };
            // What the scans lie beside.
            if path.file_stem().is_some_and(|stem| stem.to_string_lossy() == known.prefix) {
                continue;
            }
            let read = input::read(&path).and_then(|bytes| read_mesh_or_cloud(&path, &bytes, self.unit_mm, "camera"));
            let errors = match read.map(|read| read.into_cloud().0) {
                Err(why) => Err(why.to_string()),
                Ok(scan) => match scans.iter().find(|(_, other, _)| other.cloud.points() == scan.cloud.points()) {
                    Some((other, ..)) => Err(format!("it is a copy of {other}, which says nothing new")),
                    None => known
                        .errors(&path, &scan, self.like.unwrap_or(SensorKind::DepthCamera), &(observer, cancelled))?
                        .map(|errors| (scan, errors)),
                },
            };
            match errors {
                Ok((scan, errors)) => scans.push((name, scan, errors)),
                Err(why) => left_out.push((name, why)),
            }
        }
        let all: Vec<ScanErrors> = scans.iter().map(|(.., errors)| errors.clone()).collect();
        let listed: String = left_out.iter().fold(String::new(), |mut all, (name, why)| {
            let _ = write!(all, "\n  {name}: {why}");
            all
        });
        let Some(errors) = SensorErrors::of(&all) else {
            bail!(
                "{}: {} can be measured by, and two are needed at least; left out:{listed}",
                self.folder.display(),
                counted(all.len(), "scan")
            );
        };
        let keys = self.keys(&errors, &parts);
        let n_points: usize = scans.iter().map(|(_, scan, _)| scan.cloud.len()).sum();
        let mut head = vec![
            format!(
                "How a sensor errs, by {} with {}, measured on {}.",
                counted(errors.n_scans, "scan"),
                counted(n_points, "point"),
                jiff::Zoned::now().date()
            ),
            format!("By: {}", super::host::arguments().join(" ")),
            format!("In brackets: 90 % intervals, by {}.", errors.by),
        ];
        head.extend(parts.iter().map(|known| match &known.sha256 {
            Some(sha256) => format!("Part {}, SHA-256 {sha256}", known.name),
            None => format!("Part {}", known.name),
        }));
        head.extend(left_out.iter().map(|(name, why)| format!("Left out: {name}: {why}")));
        let comment = |text: &String| format!("# {}\n", text.replace(char::is_control, " "));
        let mut profile: String = head.iter().map(comment).collect();
        for (key, value, about) in &keys {
            let _ = writeln!(profile, "{key} = {value}  # {about}");
        }
        self.out.as_deref().map_or(Ok(()), |out| write_new(out, &profile))?;
        if let Some(page) = &self.page {
            let shown: Vec<_> = scans.iter().map(|(name, _, errors)| (name.as_str(), errors)).collect();
            write_new(page, &osteoflow_report::of_sensor(&errors, &shown, &keys, &head))?;
        }
        let mut rows: Vec<(String, String)> =
            keys.iter().map(|(key, value, about)| ((*key).to_owned(), format!("{value:<12} {about}"))).collect();
        if let Some(scale) = errors.scale {
            rows.push(("scale".into(), format!("{:<12.4} {}", scale.value, brackets(&scale))));
        }
        Ok(Measured {
            rows,
            notes: notes(&errors)
                .into_iter()
                .chain(left_out.iter().map(|(name, why)| format!("left out: {name}: {why}")))
                .collect(),
            json: serde_json::json!({ "errors": errors, "left_out": left_out }),
        })
    }

    /// The keys of the profile, their values as TOML, and what is known of them.
    fn keys(&self, errors: &SensorErrors, parts: &[Known]) -> Vec<(&'static str, String, String)> {
        let like = self.like.unwrap_or_else(|| Sensor::nearest(errors.noise_mm.value, errors.patch_mm.value));
        let is_stylus = like == SensorKind::Stylus;
        let number = |mm: f64| format!("{mm:.3}");
        let mut keys = vec![
            (
                "like",
                format!("{:?}", like.word()),
                if self.like.is_some() { "as stated" } else { "its errors are nearest" }.into(),
            ),
            ("noise_mm", number(errors.noise_mm.value), brackets(&errors.noise_mm)),
            (
                "patch_mm",
                number(errors.patch_mm.value),
                format!("{} over {:.1} mm", brackets(&errors.patch_mm), errors.length_mm),
            ),
        ];
        match (errors.bias_mm, errors.mean_bias_mm) {
            (Some(sd), Some(mean)) if mean.high - mean.low < 2.0 * MAX_BIAS_MM => {
                let about = format!(
                    "from scan to scan {:.3} {}, mean {:+.3} {}",
                    sd.value,
                    brackets(&sd),
                    mean.value,
                    brackets(&mean)
                );
                let all_mm = if is_stylus { sd.value } else { sd.value.hypot(mean.value) };
                keys.push(("bias_mm", number(all_mm), about));
                if is_stylus {
                    keys.push((
                        "tip_radius_mm",
                        number(mean.value),
                        format!("{}: the offset outward", brackets(&mean)),
                    ));
                }
            }
            _ => {
                let why = match parts.iter().any(|known| matches!(known.part, Part::Plane)) {
                    true => "a plane does not show it",
                    false => "the sides that were seen do not hold it; scan more sides, or a ball",
                };
                keys.push((
                    "bias_mm",
                    number(like.sensor().bias_mm),
                    format!("not measured, but usual for this kind: {why}"),
                ));
            }
        }
        let [of_off, of_on] = errors.near_border.map(|share| format!("{:.0} %", 100.0 * share));
        keys.extend([
            ("shift_mm", "0.0".into(), "not measured: no residual shows it".into()),
            (
                "outliers",
                format!("{:.4}", errors.outliers.value),
                format!(
                    "{}; {of_off} of them lie near the scan's border, as do {of_on} of the others",
                    brackets(&errors.outliers)
                ),
            ),
        ]);
        keys
    }
}

fn brackets(told: &Told) -> String {
    format!("[{:.3}, {:.3}]", told.low, told.high)
}

/// What to know of the numbers.
fn notes(errors: &SensorErrors) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some(scale) = errors.scale.filter(|scale| !scale.holds(1.0)) {
        let remedy = "no registration is right with it: calibrate the sensor, or give the files' unit";
        notes.push(format!(
            "the scans are {:.4} {} times as large as the part, if their offset is none: {remedy}",
            scale.value,
            brackets(&scale)
        ));
    }
    if errors.by != "scans" {
        notes.push(
            "with fewer than three scans the intervals are by stretches of them, and say little of other scans".into(),
        );
    }
    if errors.by_distance.is_empty() {
        notes.push("it is unknown where the sensor stood, so its noise is not told by distance and tilt".into());
    }
    notes
}
