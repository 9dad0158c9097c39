//! How a sensor errs, from scans of parts whose shape is known.

mod standard;

use super::{
    files::{check_new, write_new},
    register::{RegisterRequest, unit},
};
use anyhow::{Context, Result, bail};
use clap::{Args, builder::PossibleValuesParser};
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    sensor::{Sensor, SensorKind},
    sensor_error::{KnownPart, ScanErrors, SensorErrors, Told},
    trust::span,
};
use osteoflow_engine::run::Observer;
use osteoflow_formats::{
    input,
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
};
use osteoflow_geometry::{
    Cloud,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_statistics::{bland_altman, counted};
use serde_json::{Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool},
};

/// Rules of the verdict that speak of the sensor, which is measured, or of a place of the part that fits as well, with the same errors.
const NOT_AGAINST: [&str; 2] = ["sensor", "start"];
/// A mean offset that is known to no better than this, mm, is not told.
const MAX_UNKNOWN_MM: f64 = 2.0;
/// Spans of a scan as shares of its part's; units that files may be in.
const SPANS: std::ops::RangeInclusive<f64> = 0.05..=1.3;
const UNITS_MM: [f64; 5] = [10.0, 25.4, 1000.0, 0.1, 0.001];

/// What is measured, of which scans.
#[derive(Debug, Clone, Args)]
pub struct SensorRequest {
    /// The folder of the scans, each of a part and nothing else; of --standard a file of readings, or a folder of such.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,

    /// What was scanned: a surface, `plane`, or `ball:RADIUS_MM`. Of several --part, a scan's is the one with whose file's name its own begins.
    #[arg(long = "part", value_name = "FILE|plane|ball:RADIUS_MM", required_unless_present = "standard")]
    parts: Vec<String>,

    /// The kind of the sensor, for what the scans do not show. Default: depth_camera to register them, and in the profile the kind whose errors
    /// are nearest. Of a stylus the offset outward is the radius of its tip.
    #[arg(long, value_name = "KIND", value_parser = PossibleValuesParser::new(SensorKind::ALL.map(SensorKind::word)))]
    like: Option<String>,

    /// The unit of the scans in mm: 1000 for metres.
    #[arg(long, default_value_t = 1.0, value_name = "MM", value_parser = unit)]
    unit_mm: f64,

    /// Write the profile, which `register --sensor FILE` reads. Nothing is overwritten.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,

    /// Write a page with tables and pictures. Nothing is overwritten.
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,

    /// Instead of a profile, the numbers of a standard (f2554) from repeated readings of named divots, NAME,x,y,z in mm.
    #[arg(long, value_parser = ["f2554"], requires = "reference", conflicts_with_all = ["parts", "like", "out", "page"])]
    standard: Option<String>,

    /// The reference positions of the divots, NAME,x,y,z in mm.
    #[arg(long, value_name = "FILE", requires = "standard")]
    reference: Option<PathBuf>,
}

/// What was measured: lines for people, notes on them, and everything.
pub(crate) struct Measured {
    pub(crate) lines: Vec<String>,
    pub(crate) notes: Vec<String>,
    pub(crate) json: Value,
}

/// A part that was scanned, with its surface and what the names of its scans begin with.
struct Known {
    name: String,
    prefix: String,
    part: KnownPart,
    surface: Option<MeshOrCloud>,
}

impl Known {
    fn of(given: &String) -> Result<Self> {
        let (name, path) = (given.clone(), Path::new(given));
        let simple = |part| Self { name: given.clone(), prefix: String::new(), part, surface: None };
        match given.strip_prefix("ball:").map(str::parse::<f64>) {
            Some(Ok(radius_mm)) if (0.1..=1e5).contains(&radius_mm) => return Ok(simple(KnownPart::Ball(radius_mm))),
            Some(_) => usage!("--part {given}: a radius in mm is expected, such as ball:25.4"),
            None if given == "plane" => return Ok(simple(KnownPart::Plane)),
            None => {}
        }
        let surface = read_mesh_or_cloud(path, &input::read(path)?, 1.0, "ct")?;
        let MeshOrCloud::Mesh(of) = &surface else {
            usage!("--part {given}: it holds points, and a surface is needed, such as an STL of the part");
        };
        let (part, prefix) = (KnownPart::Mesh(MeshQuery::new(&of.mesh)), path.file_stem().unwrap_or_default());
        Ok(Self { name, prefix: prefix.to_string_lossy().into(), part, surface: Some(surface) })
    }

    /// The errors of a scan of it, or why it tells none.
    fn errors(
        &self,
        mut request: RegisterRequest,
        watch: (&dyn Observer, &Arc<AtomicBool>),
    ) -> Result<Result<ScanErrors, String>> {
        let Some(MeshOrCloud::Cloud(scan, _)) = &request.source.content else { bail!("a scan is points") };
        let scan: Cloud = scan.cloud.clone();
        let mut start = Isometry3::identity();
        if let Some(MeshOrCloud::Mesh(of)) = &self.surface {
            let [scan_mm, part_mm] = [scan.points(), of.mesh.vertices()].map(|points| span(points).unwrap_or(0.0));
            if !SPANS.contains(&(scan_mm / part_mm)) {
                let fits = |unit: &&f64| SPANS.contains(&(scan_mm * **unit / part_mm));
                let units: Vec<String> = UNITS_MM.iter().filter(fits).map(|unit| format!("--unit-mm {unit}")).collect();
                let spans = format!("it spans {scan_mm:.3} mm and {} {part_mm:.1} mm", self.name);
                return Ok(Err(format!("{spans}: is it of this part, and in mm? {}", units.join(" or "))));
            }
            request.target = PathBuf::from(&self.name).into();
            request.target.content.clone_from(&self.surface);
            let registration = request.check()?.run(watch.0, watch.1)?;
            let is_against = |reason: &&Value| {
                reason["answer"] != "trusted" && !NOT_AGAINST.iter().any(|rule| reason["rule"] == *rule)
            };
            let mut reasons = registration.run.results["verdict"]["reasons"].as_array().into_iter().flatten();
            let against = reasons.find(is_against).and_then(|reason| reason["reason"].as_str());
            match (registration.pose(), registration.refusal().or(against)) {
                (Some(pose), None) => start = *pose,
                (_, why) => return Ok(Err(why.unwrap_or("it has no pose").to_owned())),
            }
        }
        let is_before = |sign: f64| scan.points().iter().all(|p| p.z * sign > 0.0);
        let viewpoint = scan.viewpoint.map(|pose| pose * Point3::origin());
        let viewpoint = viewpoint.or_else(|| (is_before(1.0) || is_before(-1.0)).then(Point3::origin));
        Ok(ScanErrors::of(scan.points(), &self.part, &start, viewpoint).map_err(|why| why.to_string()))
    }
}

/// The files of a folder by name, without hidden ones; a file by itself.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    if folder.is_file() {
        return Ok(vec![folder.into()]);
    }
    let entries = fs::read_dir(folder).with_context(|| format!("{} is no folder of scans", folder.display()))?;
    let mut files = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<PathBuf>>>()?;
    files.retain(|path| path.is_file() && !name_of(path).starts_with('.'));
    files.sort();
    Ok(files)
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into()
}

impl SensorRequest {
    /// Measures, and writes the files that are named.
    pub(crate) fn run(&self, observer: &dyn Observer, cancelled: &Arc<AtomicBool>) -> Result<Measured> {
        let mut files = files_of(&self.folder)?;
        if let Some(reference) = &self.reference {
            return standard::f2554(&files, reference);
        }
        [&self.out, &self.page].into_iter().flatten().try_for_each(|file| check_new(file))?;
        let parts = self.parts.iter().map(Known::of).collect::<Result<Vec<_>>>()?;
        // A part that lies among its scans is none.
        files
            .retain(|file| parts.iter().all(|known| fs::canonicalize(&known.name).ok() != fs::canonicalize(file).ok()));
        let mut scans: Vec<(String, Cloud, ScanErrors, &str)> = Vec::new();
        let mut left_out = Vec::new();
        for path in files {
            let name = name_of(&path);
            let mut of_name: Vec<&Known> = parts.iter().filter(|known| name.starts_with(&known.prefix)).collect();
            of_name.sort_by_key(|known| known.prefix.len());
            let read = || -> Result<Result<(Cloud, ScanErrors, &str), String>> {
                let Some(known) = of_name.last().copied().or(parts.first().filter(|_| parts.len() == 1)) else {
                    return Ok(Err("its name begins with that of no --part".into()));
                };
                let (read, notes) =
                    read_mesh_or_cloud(&path, &input::read(&path)?, self.unit_mm, "camera")?.into_cloud();
                let scan = read.cloud.clone();
                if let Some((other, ..)) = scans.iter().find(|(_, other, ..)| other.points() == scan.points()) {
                    return Ok(Err(format!("it is a copy of {other}, which says nothing new")));
                }
                let mut request = RegisterRequest::new("part", &path);
                request.sensor = Some(self.like.as_deref().unwrap_or(SensorKind::DepthCamera.word()).into());
                request.source.content = Some(MeshOrCloud::Cloud(read, notes));
                Ok(known.errors(request, (observer, cancelled))?.map(|errors| (scan, errors, known.name.as_str())))
            };
            match read().unwrap_or_else(|error| Err(super::with_causes(&error))) {
                Ok((scan, errors, part)) => scans.push((name, scan, errors, part)),
                Err(why) => left_out.push(format!("left out: {name}: {why}")),
            }
        }
        let all: Vec<ScanErrors> = scans.iter().map(|(_, _, errors, _)| errors.clone()).collect();
        let Some(errors) = SensorErrors::of(&all) else {
            let (n, of) = (counted(all.len(), "scan"), self.folder.display());
            bail!("{of}: {n} can be measured by, and two are needed at least\n  {}", left_out.join("\n  "));
        };
        let n_points = counted(scans.iter().map(|(_, scan, ..)| scan.len()).sum(), "point");
        let (n, date) = (counted(errors.n_scans, "scan"), jiff::Zoned::now().date());
        let mut head = vec![
            format!(
                "How a sensor errs, by {n} with {n_points}, measured on {date}; in brackets 90 % intervals, by {}",
                errors.by
            ),
            format!("osteoflow {}", super::host::arguments().join(" ")),
        ];
        for Known { name, surface, .. } in &parts {
            let sha256 = surface.as_ref().map(|_| input::sha256(Path::new(name))).transpose()?;
            head.push(format!(
                "part {}{}",
                name_of(Path::new(name)),
                sha256.map_or_else(String::new, |digits| format!(", SHA-256 {digits}"))
            ));
        }
        let mut notes = notes(&errors);
        notes.extend(left_out);
        let of_part = |known: &Known| {
            let of: Vec<ScanErrors> =
                scans.iter().filter(|(.., part)| *part == known.name).map(|(_, _, errors, _)| errors.clone()).collect();
            SensorErrors::of(&of).map(|of| of.patch_mm.value.powi(2))
        };
        let patch_mm = new_patch_mm(&errors, &parts.iter().filter_map(of_part).collect::<Vec<_>>());
        let lines = self.lines(&errors, patch_mm, &parts);
        let comments = head.iter().chain(&notes).map(|line| format!("# {}\n", line.replace(char::is_control, " ")));
        let profile = comments.chain(lines.iter().map(|line| format!("{line}\n"))).collect::<String>();
        self.out.as_deref().map_or(Ok(()), |out| write_new(out, &profile))?;
        if let Some(page) = &self.page {
            let shown: Vec<_> = scans.iter().map(|(name, _, errors, _)| (name.as_str(), errors)).collect();
            write_new(page, osteoflow_report::of_sensor(&errors, &shown, &profile))?;
        }
        let json = json!({ "errors": errors, "profile": lines, "notes": notes });
        Ok(Measured { lines, notes, json })
    }

    /// The keys of the profile as TOML, with what is known of each.
    fn lines(&self, errors: &SensorErrors, patch_mm: f64, parts: &[Known]) -> Vec<String> {
        let stated = SensorKind::ALL.into_iter().find(|kind| self.like.as_deref() == Some(kind.word()));
        let like = stated.unwrap_or_else(|| Sensor::nearest(errors.noise_mm.value, errors.patch_mm.value));
        let is_stylus = like == SensorKind::Stylus;
        let line = |key: &str, value: f64, about: String| format!("{key} = {value:.4}  # {about}");
        let mut lines = vec![
            format!(
                "like = \"{}\"  # {}",
                like.word(),
                if stated.is_some() { "as stated" } else { "its errors are nearest" }
            ),
            line("noise_mm", errors.noise_mm.value, brackets(&errors.noise_mm)),
            line(
                "patch_mm",
                patch_mm,
                format!(
                    "95 % of new scans; mean {:.3} {}, over {:.1} mm",
                    errors.patch_mm.value,
                    brackets(&errors.patch_mm),
                    errors.length_mm
                ),
            ),
        ];
        let bias = errors.bias_mm.zip(errors.mean_bias_mm);
        if let Some((sd, mean)) = bias.filter(|(_, mean)| mean.high - mean.low < 2.0 * MAX_UNKNOWN_MM) {
            let both = format!("SD {:.3} {}, mean {:+.3} {}", sd.value, brackets(&sd), mean.value, brackets(&mean));
            lines.push(line("bias_mm", if is_stylus { sd.value } else { sd.value.hypot(mean.value) }, both));
            lines.extend(is_stylus.then(|| line("tip_radius_mm", mean.value, brackets(&mean))));
        } else {
            let is_plane = parts.iter().any(|known| matches!(known.part, KnownPart::Plane));
            let sides = "the sides that were seen do not hold it; scan more of them, or a ball";
            let why = if is_plane { "a plane does not show it" } else { sides };
            lines.push(line("bias_mm", like.sensor().bias_mm, format!("not measured, but usual: {why}")));
        }
        let [off, on] = errors.near_border.map(|share| format!("{:.0} %", 100.0 * share));
        let near =
            format!("{}; near the scan's border lie {off} of them, {on} of the others", brackets(&errors.outliers));
        lines.extend([
            line("shift_mm", 0.0, "not measured: no residual shows it".into()),
            line("outliers", errors.outliers.value, near),
        ]);
        lines
    }
}

/// What the shared error of 95 % of new scans stays below, mm, since the verdict judges each by it: of new parts, if several were scanned, by
/// the squares of theirs.
fn new_patch_mm(errors: &SensorErrors, of_parts: &[f64]) -> f64 {
    let n_units = if errors.by == "scans" { errors.n_scans } else { 6 * errors.n_scans };
    let (mean, high, n) = match bland_altman(of_parts, 0.9) {
        Ok(parts) => (parts.bias, parts.bias_interval.high, of_parts.len()),
        Err(_) => (errors.patch_mm.value.powi(2), errors.patch_mm.high.powi(2), n_units),
    };
    // An interval of the mean is narrower than one of a new value by this.
    (mean + (high - mean) * (n as f64 + 1.0).sqrt()).sqrt()
}

fn brackets(told: &Told) -> String {
    format!("[{:.3}, {:.3}]", told.low, told.high)
}

/// What to know of the numbers.
fn notes(errors: &SensorErrors) -> Vec<String> {
    let scale = errors.scale.map(|scale| {
        let size = format!("the scans are {:.4} {} times as large as the part", scale.value, brackets(&scale));
        let wrong = ": no registration is right with that; calibrate the sensor, or give the unit";
        format!("{size}{}", if scale.holds(1.0) { "" } else { wrong })
    });
    let few = (errors.by != "scans").then_some(
        "fewer than three scans: the intervals are by stretches of them, and other scans may differ by more",
    );
    let blind = errors
        .by_tilt
        .is_empty()
        .then_some("where the sensor stood is unknown, so the noise is not told by distance and tilt");
    scale.into_iter().chain([few, blind].into_iter().flatten().map(String::from)).collect()
}
