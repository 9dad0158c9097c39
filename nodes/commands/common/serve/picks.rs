//! What was picked on the page, saved as files: a plan, or the same points on the bone and on the scan.

use osteoflow_algorithms::coarse;
use osteoflow_formats::{
    Space,
    picked_points::{write_mrk_json, write_planes_mrk_json, write_roi_mrk_json},
    plan_file::{parse_plan, plan_json, read_plan, write_plan},
    region_file::{parse_region, write_region},
};
use osteoflow_geometry::{NamedPoint, Points, Shape, SurgicalPlan};
use osteoflow_viewer::Door;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Longest body: a plan has a few kilobytes.
const MAX_BYTES: usize = 1 << 20;
/// Number of points that a registration needs.
const N_NEEDED: usize = 3;
/// Two points nearer than this are the same, mm: below what can be aimed at on a screen.
const SAME_PLACE_MM: f64 = 0.01;
/// Residual above which picked pairs are doubted, mm: twice what careful picks leave.
const DOUBTED_FRE_MM: f64 = 3.0;
/// The file of a region.
const REGION: &str = "region.json";
/// Longest name of a point or a plane.
const MAX_NAME: usize = 100;

/// Keys of a plan that the page does not show, by what they are. The anatomy is one, but for a tip that was picked.
const UNSEEN: [(&str, &[&str]); 4] = [
    ("anatomy", &["malleolus_tip", "proximal", "lateral", "posterior"]),
    ("axes", &["pca_axes_columns_xyz", "pca_axes_centre"]),
    ("phantom marker pose", &["phantom_marker_in_phantom"]),
    ("nominal camera marker pose", &["camera_marker_nominal_C_T_Mc"]),
];

/// The file of the plan that the procedure was made for, beside the one that was picked.
const MADE_FOR: &str = "made_for.json";

/// What is known of the plan that is shown.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Known<'a> {
    /// It, with what the page does not see of it.
    pub(crate) plan: Option<&'a SurgicalPlan>,
    /// The plan that the procedure was made for, if it is another one.
    pub(crate) made_for: Option<&'a SurgicalPlan>,
}

impl<'a> Known<'a> {
    /// The plan for which whatever is shown was measured.
    fn procedure(self) -> Option<&'a SurgicalPlan> {
        self.made_for.or(self.plan)
    }
}

/// Saves what was picked.
#[derive(Debug, Clone)]
pub(crate) struct Picks {
    folder: PathBuf,
}

impl Picks {
    /// Saves into folders in this one, which is made when it is needed.
    pub(crate) fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// The folder.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The answer to the page's question where picks are saved, what is known of the plan that it does not see, and which picks
    /// (`plan`, `pairs`) the graph is run with once they are saved.
    pub(crate) fn describe(&self, known: Option<&SurgicalPlan>, runs: &[&str]) -> Value {
        json!({ "folder": self.folder.display().to_string(), "plan": known.map(plan_json), "runs": runs })
    }

    /// Writes the plan or the pairs that were picked into a new folder. What the plan of the page lacks is taken from the one that is
    /// known.
    ///
    /// # Errors
    /// A sentence for the user: what is wrong with the picks, or why they cannot be written.
    pub(crate) fn save(&self, what: Door, body: &[u8], known: Known<'_>) -> Result<Value, String> {
        if body.len() > MAX_BYTES {
            return Err(format!("{} bytes are too long for picks; at most {MAX_BYTES} are taken", body.len()));
        }
        let text = std::str::from_utf8(body).map_err(|_| "the picks are no UTF-8".to_owned())?;
        match what {
            Door::SavePlan => self.save_plan(text, known),
            Door::SavePairs => self.save_pairs(text),
            _ => Err("this cannot be saved; there are plan and pairs".into()),
        }
    }

    fn save_plan(&self, text: &str, known: Known<'_>) -> Result<Value, String> {
        let path = Path::new("the picked plan");
        let read = parse_plan(path, text).map_err(|error| error.to_string())?;
        if !read.unread.is_empty() {
            return Err(format!("the picked plan has unknown keys: {}; nothing was saved", read.unread.join(", ")));
        }
        let Ok(Value::Object(given)) = serde_json::from_str(text) else {
            return Err("the picked plan is no JSON object".into());
        };
        let SurgicalPlan { landmarks, assessment, planes, .. } = &read.plan;
        check_landmarks(&landmarks.points)?;
        let all: Vec<&NamedPoint> = landmarks.points.iter().chain(&*assessment.points).collect();
        check_names(all.iter().map(|point| &*point.name))?;
        check_names(planes.planes.iter().map(|plane| &*plane.name))?;
        check_places(&all)?;

        let (merged, notes) = merged(&given, &read.plan, known.plan);
        // What is written is what was read of it, to the last digit of the points.
        let text = serde_json::to_string_pretty(&merged).map_err(|error| error.to_string())? + "\n";
        let again = parse_plan(path, &text).map_err(|error| error.to_string())?;
        if (&again.plan.landmarks, &again.plan.assessment) != (landmarks, assessment) {
            return Err("the plan would not be read back as it is; nothing was saved".into());
        }
        let planes: Vec<_> =
            planes.planes.iter().filter_map(|plane| Some((plane.name.clone(), *plane.isometry()?))).collect();
        let mut files = Vec::new();
        let folder = self.fill(|folder| {
            let mut file = |name: &str| {
                let path = folder.join(name);
                files.push(path.display().to_string());
                path
            };
            let plan = file("plan.json");
            fs::write(&plan, &text).map_err(|error| format!("{} cannot be written: {error}", plan.display()))?;
            read_plan(&plan).map_err(|error| error.to_string())?;
            for (name, points) in [("landmarks", landmarks), ("assessment", assessment)] {
                if !points.points.is_empty() {
                    let path = file(&format!("{name}.mrk.json"));
                    write_mrk_json(&path, &points.points, Space::Lps).map_err(|error| error.to_string())?;
                }
            }
            if !planes.is_empty() {
                write_planes_mrk_json(&file("planes.mrk.json"), &planes).map_err(|error| error.to_string())?;
            }
            if let Some(made_for) = known.procedure() {
                write_plan(&file(MADE_FOR), made_for).map_err(|error| error.to_string())?;
            }
            Ok(())
        })?;
        let counts = format!(
            "{} landmarks, {} assessment points and {} planes",
            landmarks.points.len(),
            assessment.points.len(),
            planes.len()
        );
        let mut message = format!("{counts} are saved in {}", folder.display());
        for note in notes.iter().chain(&read.notes) {
            message += &format!("; {note}");
        }
        let made_for = known.procedure().map(|_| folder.join(MADE_FOR).display().to_string());
        let plan = folder.join("plan.json").display().to_string();
        Ok(json!({ "files": files, "message": message, "plan": plan, "made_for": made_for }))
    }

    /// Writes a region that was drawn by hand into a new folder, one of a single box for 3D Slicer, too; returns its file.
    ///
    /// # Errors
    /// A sentence for the user: what is wrong with the region, or why it cannot be written.
    pub(crate) fn save_region(&self, text: &str) -> Result<PathBuf, String> {
        let region = parse_region(Path::new("the drawn region"), text).map_err(|error| error.to_string())?;
        let folder = self.fill(|folder| {
            let written =
                write_region(&folder.join(REGION), &region).and_then(|()| match (&region.keep[..], &region.cut[..]) {
                    ([Shape::Box { min, max }], []) => {
                        write_roi_mrk_json(&folder.join("region.mrk.json"), "region", min, max)
                    }
                    _ => Ok(()),
                });
            written.map_err(|error| error.to_string())
        })?;
        absolute(&folder.join(REGION))
    }

    fn save_pairs(&self, text: &str) -> Result<Value, String> {
        let pairs: Pairs = serde_json::from_str(text).map_err(|error| format!("these are no picked pairs: {error}"))?;
        let [bone, scan] = [pairs.bone, pairs.scan].map(|picked| {
            picked.into_iter().map(|p| NamedPoint::new(p.name.as_str(), p.position.into())).collect::<Vec<_>>()
        });
        for (side, points) in [("bone", &bone), ("scan", &scan)] {
            if points.len() < N_NEEDED {
                let message = format!("{} points are picked on the {side}; {N_NEEDED} pairs are needed", points.len());
                return Err(message);
            }
            check_names(points.iter().map(|point| &*point.name))?;
            check_places(&points.iter().collect::<Vec<_>>())?;
        }
        let fit = coarse::three_point(&bone, &scan).map_err(|error| in_words(&error.to_string()))?;
        let mut files = Vec::new();
        let folder = self.fill(|folder| {
            for (name, points) in [("bone_points.mrk.json", &bone), ("scan_points.mrk.json", &scan)] {
                let path = folder.join(name);
                files.push(path.display().to_string());
                write_mrk_json(&path, points, Space::Lps).map_err(|error| error.to_string())?;
            }
            Ok(())
        })?;
        let fre_mm = fit.report.fre_mm;
        let mut message = format!(
            "{} pairs are saved in {}; they fit each other to {fre_mm:.2} mm (RMS)",
            bone.len(),
            folder.display()
        );
        if fre_mm > DOUBTED_FRE_MM {
            let side = fit.report.sides.iter().max_by(|a, b| a.difference_mm.abs().total_cmp(&b.difference_mm.abs()));
            let side = side.map(|s| {
                format!(
                    ": {} to {} is {:.1} mm on the bone and {:.1} mm on the scan",
                    s.from, s.to, s.target_mm, s.source_mm
                )
            });
            message += &format!(", which is much{}; were two points exchanged?", side.unwrap_or_default());
        }
        Ok(json!({ "files": files, "message": message, "fre_mm": fre_mm }))
    }

    /// Makes a new folder and fills it; it is removed if that fails.
    fn fill(&self, write: impl FnOnce(&Path) -> Result<(), String>) -> Result<PathBuf, String> {
        let refused = |error: io::Error| {
            format!("{} cannot be written: {error}; name another folder with --picks DIR", self.folder.display())
        };
        fs::create_dir_all(&self.folder).map_err(refused)?;
        let mut n = 1;
        let folder = loop {
            let folder = self.folder.join(format!("picks-{n}"));
            match fs::create_dir(&folder) {
                Ok(()) => break folder,
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => n += 1,
                Err(error) => return Err(refused(error)),
            }
        };
        if let Err(message) = write(&folder) {
            // The folder is ours and new.
            let _ = fs::remove_dir_all(&folder);
            return Err(message);
        }
        Ok(folder)
    }
}

/// The path from the root, as a graph is given it.
pub(crate) fn absolute(path: &Path) -> Result<PathBuf, String> {
    std::path::absolute(path).map_err(|error| format!("{} has no path: {error}", path.display()))
}

/// Points of the same names on the bone and on the scan, each in its own frame, mm.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pairs {
    bone: Vec<Pick>,
    scan: Vec<Pick>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pick {
    name: String,
    position: [f64; 3],
}

/// The picked plan with what it lacks, and what there is to say about it.
fn merged(given: &Map<String, Value>, picked: &SurgicalPlan, known: Option<&SurgicalPlan>) -> (Value, Vec<String>) {
    let mut plan = plan_json(picked);
    let known = known.map(plan_json).unwrap_or_default();
    let mut missing = Vec::new();
    for (what, keys) in UNSEEN {
        for key in keys {
            let value = given.get(*key).filter(|value| !value.is_null()).or(known.get(key));
            if let (true, Some(value)) = (plan[*key].is_null(), value) {
                plan[*key] = value.clone();
            }
        }
        if keys.iter().any(|key| plan[*key].is_null()) {
            missing.push(what);
        }
    }
    let notes = (!missing.is_empty()).then(|| {
        format!(
            "the plan gives no {}, which is not known here; a graph that needs it refuses this plan",
            missing.join(", ")
        )
    });
    (plan, notes.into_iter().collect())
}

fn check_landmarks(landmarks: &[NamedPoint]) -> Result<(), String> {
    if landmarks.len() < N_NEEDED {
        let n = landmarks.len();
        return Err(format!("{n} landmarks are picked; {N_NEEDED} are needed, such as P1, P2 and P3"));
    }
    let all: Vec<&NamedPoint> = landmarks.iter().collect();
    check_places(&all)?;
    // What registers by them is asked itself.
    coarse::three_point(landmarks, landmarks).map(|_| ()).map_err(|error| in_words(&error.to_string()))
}

/// A message of the registration in the words of who picks.
fn in_words(message: &str) -> String {
    message
        .replace("the target points", "the points on the bone")
        .replace("the source points", "the points on the scan")
}

fn check_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), String> {
    let mut seen = Vec::new();
    for name in names {
        if name.trim().is_empty() || name.chars().count() > MAX_NAME || name.chars().any(char::is_control) {
            return Err(format!("\"{}\" is no name; use 1 to {MAX_NAME} printable characters", name.escape_debug()));
        }
        if seen.contains(&name) {
            return Err(format!("the name {name} is given twice; name each once"));
        }
        seen.push(name);
    }
    Ok(())
}

fn check_places(points: &[&NamedPoint]) -> Result<(), String> {
    for (k, a) in points.iter().enumerate() {
        if !a.position.iter().all(|c| c.is_finite()) {
            return Err(format!("{} is not finite", a.name));
        }
        if let Some(b) = points[..k].iter().find(|b| (a.position - b.position).norm() < SAME_PLACE_MM) {
            return Err(format!("{} and {} are at the same place; move or delete one of them", b.name, a.name));
        }
    }
    Ok(())
}

/// What is known of the plan of a bone besides its wires, if its landmarks are those that `shown` has.
pub(crate) fn if_the_same(plan: SurgicalPlan, shown: &Points) -> Option<SurgicalPlan> {
    let is_same = plan.landmarks.points.len() == shown.points.len()
        && plan.landmarks.points.iter().zip(&*shown.points).all(|(a, b)| a.name == b.name && a.position == b.position);
    is_same.then_some(plan)
}

#[cfg(test)]
mod tests;
