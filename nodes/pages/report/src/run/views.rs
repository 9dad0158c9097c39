//! Views of a run in three dimensions: scan on the surface, points, cuts.

use super::{
    fine, fragments,
    picture::{Picture, RESIDUAL_MM},
    registered,
};
use crate::{
    cell::Cell,
    chart::{Axis, Chart, Mark, Series},
    format::number,
    html::Page,
    run_folder::RunFolder,
    scene::{self, BLUE, BONE, ELLIPSOID, ORANGE, Scene, packed},
};
use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::{
    axes::principal_axes,
    mesh_query::MeshQuery,
    metrics::{CutReport, CutsReport, TrePoint, TreReport},
};
use osteoflow_geometry::{Axes, Cloud, Mesh, Planes, Points, Pose};
use osteoflow_statistics::quantile;
use rayon::prelude::*;

/// Factor by which errors are enlarged.
const ENLARGED: f64 = 20.0;

/// The view of the registered scan.
pub(super) const SCAN: &str = "The scan on the CT surface";
/// The view of the planes.
pub(super) const CUTS: &str = "Planned against executed cuts";

/// Outlines farther from the plane's origin belong to another cut, mm.
const REACH_MM: f64 = 60.0;

/// The surface that the scan is registered to, if it is a mesh.
fn bone(run: &RunFolder) -> Result<Mesh, String> {
    let node = fine(run).ok_or("the graph has no fine registration (a node with source, target and init)")?;
    let target = run.wire_into(node, "target").ok_or("its target is not wired")?;
    let (prepared, _) = target.rsplit_once('.').ok_or("its target is not wired")?;
    run.input::<Mesh>(prepared, "mesh").map_err(|why| match run.wire_into(prepared, "mesh") {
        Some(_) => why,
        None => format!("the target comes from {target}, which is not made from a mesh"),
    })
}

/// Adds the bone to the scene; its data are written to the page only once.
fn with_bone(page: &mut Page, scene: &mut Scene, bone: &Mesh) {
    let shared = page.share(packed::surface(bone));
    scene.shared_mesh("CT surface", &shared, bone, BONE);
    scene.key(BONE, "CT surface");
}

/// What the live page shows at the end of the run, and the distances of the scan from the surface.
pub(super) fn scan(page: &mut Page, run: &RunFolder, refused: Option<&str>) {
    let registered = refused.map_or_else(|| residuals(run), |why| Err(why.into()));
    let mut words = registered.as_ref().map_or_else(|_| AT_ITS_END.into(), |scan| scan.caption.clone());
    match Picture::of(page, run) {
        Ok(picture) => {
            picture.thinned.iter().for_each(|thinned| words += &format!(" {thinned}"));
            let drawing = registered.as_ref().ok().map(|scan| ("residuals", &scan.drawing));
            let has_errors = refused.is_none() && run.results.pointer("/verdict/predicted/points/0").is_some();
            page.picture(picture.json, drawing, key_of_picture(has_errors), &words);
        }
        Err(why) => page.missing(PICTURE, &why),
    }
    match registered {
        Ok(scan) => histogram(page, &scan.values),
        Err(why) => page.missing(SCAN, &why),
    }
}

const PICTURE: &str = "What the live page shows of the run";
const AT_ITS_END: &str = "The run at its end, as the live page shows it.";

/// The colours of scans, and of the ellipsoids of predicted errors.
fn key_of_picture(has_errors: bool) -> String {
    let mut key = Scene::looking(&[], Vector3::x(), Vector3::z());
    key.ramp("distance of the scan from the bone, grey: none within 5 mm", RESIDUAL_MM);
    if has_errors {
        key.key(
            ELLIPSOID,
            "predicted error: ellipsoid that holds the point with 90 %, true to scale, seen through the bone",
        );
    }
    key.legend_html()
}

/// The registered scan on the CT surface.
struct Scan {
    drawing: Scene,
    caption: String,
    /// Signed distances from the surface, mm.
    values: Vec<f64>,
}

/// The scan on the CT surface, each point coloured by its distance outside (orange) or inside (blue).
fn residuals(run: &RunFolder) -> Result<Scan, String> {
    let bone = bone(run)?;
    let node = registered(run).ok_or("the graph has no fine registration")?;
    let scan: Cloud = run.input(node, "source")?;
    let pose: Pose = run.value(&format!("{node}.t_target_source"))?;
    let t = pose.expect(&bone.frame, &scan.frame).map_err(|e| e.to_string())?;
    let points: Vec<Point3<f64>> = scan.points().iter().map(|p| t * p).collect();
    let query = MeshQuery::new(&bone);
    query.prepare();
    let signed = |p: &Point3<f64>| {
        let at = query.closest_point(p)?;
        let out = (p - at.point).dot(&at.normal);
        Some((at.distance_mm * out.signum(), at.normal))
    };
    let distances: Vec<_> = points.par_iter().map(signed).collect();
    let (mut shown, mut values, mut facing) = (Vec::new(), Vec::new(), Vector3::zeros());
    for (point, (value, normal)) in points.iter().zip(distances).filter_map(|(p, distance)| Some((*p, distance?))) {
        shown.push(point);
        values.push(value);
        facing += normal;
    }
    if values.is_empty() {
        return Err("the surface cannot be searched".into());
    }
    let along = principal_axes(&bone).columns.column(2).into_owned();
    let mut scene = Scene::looking(&shown, along, facing);
    scene.drawn_mesh(&bone, BONE);
    scene.key(BONE, "CT surface");
    scene.drawn_points(&shown, &values, RESIDUAL_MM, 0.2);
    scene.ramp("scan, signed distance from the surface", RESIDUAL_MM);
    let n = values.len();
    let mean = values.iter().sum::<f64>() / n as f64;
    let rms = (values.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
    let caption = format!(
        "The scan on the CT surface after registration: {n} points, coloured by their signed distance from the surface, \
         positive outside the bone (mean {} mm, RMS {} mm). Values beyond {} mm have the end colours. A residual at the surface \
         is not the error of the registration: a slide along the bone is hardly visible here.",
        number(mean),
        number(rms),
        number(RESIDUAL_MM),
    );
    Ok(Scan { drawing: scene, caption, values })
}

fn histogram(page: &mut Page, values: &[f64]) {
    let mut sorted = values.to_vec();
    let [low, high] = [0.001, 0.999].map(|q| quantile(&mut sorted, q));
    const N: usize = 60;
    let width = ((high - low) / N as f64).max(1e-9);
    let mut counts = [0usize; N];
    for value in values {
        let at = ((value - low) / width).floor();
        if (0.0..N as f64).contains(&at) {
            counts[at as usize] += 1;
        }
    }
    let share = |k: usize| 100.0 * counts[k] as f64 / values.len() as f64;
    let mut steps = vec![(low, 0.0)];
    steps.extend((0..N).flat_map(|k| [(low + k as f64 * width, share(k)), (low + (k + 1) as f64 * width, share(k))]));
    steps.push((low + N as f64 * width, 0.0));
    let band = steps.iter().map(|(x, y)| (*x, 0.0, *y)).collect();
    let chart = Chart {
        title: "Signed distance of the scan from the CT surface".into(),
        about: format!("A histogram of {} distances.", values.len()),
        x: Axis::Linear("signed distance, positive outside the bone (mm)".into()),
        y: Axis::Linear("points (%)".into()),
        series: vec![Series::unnamed(0, vec![Mark::Band(band), Mark::Line(steps)])],
        note: format!("n = {} points", values.len()),
    };
    let n = values.len();
    let caption =
        format!("Distribution of the signed distances of the scan's points from the CT surface: n = {n} points.");
    page.charts("residuals", &[chart], &caption);
}

/// The assessment points as registered and as measured. Of refused results, only the errors are shown.
pub(super) fn assessment(page: &mut Page, run: &RunFolder, refused: Option<&str>) {
    const WHAT: &str = "Registered against measured points";
    let mut any = false;
    for (kind, name, source) in [
        ("metrics.tre_measured", "measured", "measured by stylus"),
        ("metrics.tre_true", "true", "at their true positions"),
    ] {
        let Some(node) = run.node_of_kind(kind) else { continue };
        any = true;
        let gathered = || -> Result<_, String> {
            let report: TreReport = run.value(&format!("{node}.report"))?;
            let planned: Points = run.input(node, "planned")?;
            Ok((report, planned, axes(run, node)?))
        };
        match gathered() {
            Ok((report, planned, axes)) => {
                errors(page, &report, name, source);
                let first = name == "measured" || run.node_of_kind("metrics.tre_measured").is_none();
                if let (true, Some(why)) = (first, refused) {
                    page.missing(WHAT, why);
                } else if first {
                    points(page, run, (&report, &planned, &axes), source);
                }
            }
            Err(why) => page.missing(WHAT, &why),
        }
    }
    if !any {
        page.missing(WHAT, "the graph has no node metrics.tre_measured or metrics.tre_true");
    }
}

/// The axes of a metrics node's errors: its own input, otherwise those of its bone.
fn axes(run: &RunFolder, node: &str) -> Result<Axes, String> {
    if run.wire_into(node, "axes").is_some() {
        return run.input(node, "axes");
    }
    if run.wire_into(node, "bone").is_none() {
        return Err(format!("the axes of {node} are unknown"));
    }
    Ok(principal_axes(&run.input::<Mesh>(node, "bone")?))
}

/// Registered points in blue and measured points in orange, in CT coordinates.
fn points(page: &mut Page, run: &RunFolder, (report, planned, axes): (&TreReport, &Points, &Axes), source: &str) {
    let mut pairs = Vec::new();
    for point in &report.points {
        let Some(at) = planned.get(&point.name) else { continue };
        // The error is the registered position minus the measured one; both are in the bone's frame.
        let error = axes.columns * Vector3::new(point.x, point.y, point.z);
        pairs.push((point, at.position, error));
    }
    let planned_at: Vec<_> = pairs.iter().map(|(_, at, _)| *at).collect();
    let measured_at: Vec<_> = pairs.iter().map(|(_, at, error)| at + error).collect();
    let middle = nalgebra::Vector3::from(axes.centre.coords);
    let outwards = planned_at.iter().map(|p| p.coords - middle).sum::<Vector3<f64>>();
    let mut scene = Scene::looking(&planned_at, axes.columns.column(2).into_owned(), outwards);
    match bone(run) {
        Ok(bone) if bone.frame == planned.frame => with_bone(page, &mut scene, &bone),
        Ok(_) => {}
        Err(why) => page.missing("The bone behind the points", &why),
    }
    let far: Vec<_> = pairs.iter().flat_map(|(_, at, error)| [*at, at + error * ENLARGED]).collect();
    scene.lines("errors", &far, ORANGE);
    scene.points("planned", &planned_at, 0.6, BLUE);
    scene.points("measured", &measured_at, 0.6, ORANGE);
    for (point, at, _) in &pairs {
        scene.tag("names", at, &format!("{} {} mm", point.name, number(point.norm)));
    }
    scene.key(BLUE, "planned");
    scene.key(ORANGE, &format!("{source}, transformed to CT by the registration"));
    let caption = format!(
        "Assessment points in CT: planned (blue) and {source} (orange), transformed to CT by the registration; n = {} points, \
         mean error {} mm. Lines show the errors enlarged {ENLARGED} times.",
        report.n,
        number(report.mean_abs.norm)
    );
    page.view("points", &scene, &caption);
}

/// The error at each point along each axis, as a figure and a table.
fn errors(page: &mut Page, report: &TreReport, name: &str, source: &str) {
    type Component = fn(&TrePoint) -> f64;
    let axes: [(&str, Component); 4] = [("x", |p| p.x), ("y", |p| p.y), ("z", |p| p.z), ("norm", |p| p.norm)];
    let series = axes.iter().enumerate().map(|(k, (_, of))| {
        let dot = |point: &TrePoint| (of(point), format!("{}: {} mm", point.name, number(of(point))));
        Series::spread(k, k, &report.points.iter().map(dot).collect::<Vec<_>>())
    });
    let chart = Chart {
        title: format!("Target registration error, {name}"),
        about: format!(
            "The signed errors of {} points along each axis of the bone, their norms, and the means.",
            report.n
        ),
        x: Axis::Categories {
            label: "axis of the bone; z runs along it".into(),
            names: axes.iter().map(|(name, _)| (*name).into()).collect(),
        },
        y: Axis::Linear("error (mm)".into()),
        series: series.collect(),
        note: format!("n = {} points of one procedure", report.n),
    };
    let caption = format!(
        "Target registration error against points {source}: where the registration puts each of the {} points minus where \
         it is, signed, along the axes of the bone, and the norm. A dot is a point, a bar the mean.",
        report.n
    );
    page.charts(&format!("tre-{name}"), &[chart], &caption);
    let head = ["point", "x (mm)", "y (mm)", "z (mm)", "norm (mm)"];
    let numbers = |values: [f64; 4]| values.map(Cell::Number);
    let row = |name: &str, values| [Cell::word(name)].into_iter().chain(numbers(values)).collect::<Vec<_>>();
    let mut rows: Vec<_> = report.points.iter().map(|p| row(&p.name, [p.x, p.y, p.z, p.norm])).collect();
    for (name, s) in
        [("mean, signed", &report.mean_signed), ("mean of absolute values", &report.mean_abs), ("RMS", &report.rms)]
    {
        rows.push(row(name, [s.x, s.y, s.z, s.norm]));
    }
    let caption = format!("Target registration error, {name}: n = {} points of one procedure on one bone.", report.n);
    page.table(&caption, &head, &rows);
}

/// Planned planes, and the cuts that the registration would lead to.
pub(super) fn cuts(page: &mut Page, run: &RunFolder) {
    let Some(node) = fragments::node(run) else { return page.missing(CUTS, fragments::NO_NODE) };
    let gathered = || -> Result<_, String> {
        let planned: Planes = run.input(node, "planes")?;
        let slip = fragments::slip(run, node, &planned)?;
        Ok((bone(run)?, planned, slip))
    };
    let (bone, planned, slip) = match gathered() {
        Ok(gathered) => gathered,
        Err(why) => return page.missing(CUTS, &why),
    };
    let executed = planned.transformed(&planned.frame, &slip);
    let corners: Vec<_> = planned
        .planes
        .iter()
        .chain(executed.planes.iter())
        .filter_map(|plane| plane.isometry())
        .flat_map(scene::square)
        .collect();
    let along = principal_axes(&bone).columns.column(2).into_owned();
    let mut scene = Scene::looking(&corners, along, Vector3::zeros());
    with_bone(page, &mut scene, &bone);
    for (layer, planes, colour) in [("planned", &planned, BLUE), ("executed", &executed, ORANGE)] {
        let known = planes.planes.iter().filter_map(|plane| Some((plane, *plane.isometry()?)));
        // One name for both.
        let named = known.map(|(plane, t)| (if colour == BLUE { &*plane.name } else { "" }, t));
        let named: Vec<_> = named.collect();
        scene.planes(layer, &named, colour);
        let outlines: Vec<_> = named.iter().flat_map(|(_, t)| scene::outline(&bone, t, REACH_MM)).collect();
        scene.lines(&format!("{layer}, on the bone"), &outlines, colour);
    }
    scene.key(BLUE, "planned");
    scene.key(ORANGE, "executed according to the registration");
    let caption = "Planned cuts (blue) and the cuts that the registration leads to (orange), on the CT surface: each planned \
                   plane is carried to the world by the registration and back by the true pose. Nothing was cut.";
    page.view("cuts", &scene, caption);
    let report =
        run.node_of_kind("metrics.cuts").and_then(|node| run.value::<CutsReport>(&format!("{node}.report")).ok());
    match report {
        Some(report) => cut_table(page, &report),
        None => page.text("The errors of the cuts are listed under Results."),
    }
}

fn cut_table(page: &mut Page, report: &CutsReport) {
    let head = ["plane", "offset (mm)", "tilt (\u{b0})", "roll (\u{b0})"];
    let row = |cut: &CutReport| {
        let numbers = [cut.offset_mm, cut.tilt_rad.to_degrees(), cut.roll_rad.to_degrees()].map(Cell::Number);
        [Cell::word(&cut.name)].into_iter().chain(numbers).collect::<Vec<_>>()
    };
    let rows: Vec<_> = report.cuts.iter().map(row).collect();
    page.table("Executed cuts against the planned ones, where each meets the bone's middle line.", &head, &rows);
}
