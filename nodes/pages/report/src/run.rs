//! The page of one run.

mod answer;
pub(crate) mod fragments;
mod picture;
mod predicted;
mod slide;
mod transforms;
mod views;

use crate::{
    Report, ReportError,
    chart::{Axis, Chart, Mark, Series, disclaimer},
    citations, diagram,
    format::number,
    html::Page,
    methods,
    paths::Paths,
    provenance,
    run_folder::RunFolder,
    tables,
};
use osteoflow_algorithms::icp::IcpTrace;
use osteoflow_draw::{Diagram, svg};
use osteoflow_engine::run::{Answer, Verdict};
use osteoflow_node::Registry;
use std::path::Path;

/// The report of a run, given its folder.
///
/// # Errors
/// If the files of the folder cannot be read. What the recording lacks is listed on the page.
pub fn of_run(dir: &Path, registry: &Registry) -> Result<Report, ReportError> {
    let run = RunFolder::open(dir, registry)?;
    let name = run.manifest["graph"]["name"].as_str().unwrap_or("run");
    let mut page = Page::new(&format!("Run of {name}"), run.is_simulated());
    page.hide(Paths::of(&run.manifest, dir));

    let fault = run.fault();
    if let Some(fault) = &fault {
        page.fault(fault);
    }
    let verdict = Verdict::of(&run.results);
    if let Some(verdict) = &verdict {
        page.verdict(verdict);
    }
    page.judge(&run.results["verdict"]);
    answer::table(&mut page, &run.results);
    outcome(&mut page, &run);
    if let Some(verdict) = &verdict {
        predicted::tables(&mut page, verdict.predicted());
    }
    // Pictures of refused results would show them as if they were right.
    let refused = verdict.as_ref().filter(|verdict| verdict.answer() == Answer::Refused);
    // The verdict above has the reason.
    let refused = refused.map(|_| "the result is refused".to_owned());

    page.section("Registration");
    views::scan(&mut page, &run, refused.as_deref());
    convergence(&mut page, &run);
    slide::profile(&mut page, &run);
    page.section("Accuracy");
    views::assessment(&mut page, &run, refused.as_deref());
    page.section("Cuts");
    match &refused {
        Some(why) => page.missing(views::CUTS, why),
        None => {
            views::cuts(&mut page, &run);
            if fragments::node(&run).is_some() {
                fragments::maps(&mut page, &run);
            }
        }
    }
    page.section("The graph as run");
    match diagram::of_manifest(&run.manifest) {
        Ok(diagram) => {
            graph(&mut page, diagram, "The graph as it ran: nodes with kinds and times, wires with numbers of items.");
        }
        Err(why) => page.missing("The graph", &why),
    }
    page.section("Results");
    tables::results(&mut page, &run.results);
    page.section("Methods");
    methods::of_run(&mut page, &run, registry);
    page.section("Provenance");
    provenance::of_run(&mut page, dir, &run.manifest);
    page.section("References");
    let kinds: Vec<&str> = run.nodes().map(|(_, kind)| kind).collect();
    let bibliography = citations::section(&mut page, &kinds, registry);

    let began =
        run.manifest["began"].as_str().map_or_else(String::new, |began| format!(", {}", provenance::date(began)));
    let (html, figures) = page.finish(&format!("{}{began}", provenance::folder_name(dir)));
    Ok(Report { html, figures, bibliography, fault })
}

/// Draws a graph with the disclaimer of all figures.
pub(crate) fn graph(page: &mut Page, mut diagram: Diagram, caption: &str) {
    diagram.notes.push(disclaimer(page.simulated()));
    page.figure("graph", svg(&diagram), caption);
}

fn outcome(page: &mut Page, run: &RunFolder) {
    let outcome = &run.manifest["outcome"];
    let status = outcome["status"].as_str().unwrap_or("unfinished");
    let is_said = Verdict::of(&run.results).is_some_and(|verdict| status == "refused" && verdict.is_judged());
    if status != "complete" && !is_said {
        let node = outcome["node"].as_str().map(|node| format!(" at node \"{node}\"")).unwrap_or_default();
        let reason = outcome["reason"].as_str().unwrap_or("the manifest gives no reason");
        page.text(&format!("The run ended as {status}{node}: {reason}."));
    }
    let warnings: Vec<_> = run.manifest["warnings"].as_array().into_iter().flatten().collect();
    for warning in warnings.iter().take(20) {
        let (node, message) =
            (warning["node"].as_str().unwrap_or("?"), warning["message"].as_str().unwrap_or_default());
        page.text(&format!("Warning of node \"{node}\": {message}."));
    }
}

/// Lower bound for plotted lengths, mm: smaller ones are rounding errors and would compress the axis.
const MIN_MM: f64 = 1e-6;

/// Residual and step of each iteration of the fine registration.
fn convergence(page: &mut Page, run: &RunFolder) {
    let Some(node) = fine(run) else { return };
    let trace = match run.value::<IcpTrace>(&format!("{node}.trace")) {
        Ok(trace) => trace,
        Err(why) => return page.missing("The convergence of the registration", &why),
    };
    let line = |of: &dyn Fn(&osteoflow_algorithms::icp::IcpStep) -> Option<f64>| {
        let points = trace.steps.iter().filter_map(|step| Some((f64::from(step.iteration), of(step)?)));
        let points: Vec<_> = points.filter(|(_, y)| *y > 0.0).collect();
        let shown = |y: f64| y.max(MIN_MM);
        let dots = points.iter().map(|(x, y)| (*x, shown(*y), format!("iteration {x}: {} mm", number(*y)))).collect();
        vec![Mark::Line(points.iter().map(|(x, y)| (*x, shown(*y))).collect()), Mark::Dots(dots)]
    };
    let series = |name: &str, colour, marks| Series { name: name.into(), colour, marks };
    let chart = Chart {
        title: "Convergence of the fine registration".into(),
        about: format!("Residual and step of {} iterations on a logarithmic axis.", trace.steps.len()),
        x: Axis::Linear("iteration".into()),
        y: Axis::Log("length (mm)".into()),
        series: vec![
            series("residual, RMS of the pairs", 0, line(&|s| Some(s.rms_mm))),
            series("step, largest movement of a point", 1, line(&|s| Some(s.step_mm))),
        ],
        note: String::new(),
    };
    let report = &run.results["icp"];
    let stopped =
        report["stop_reason"].as_str().map(|why| format!(" It stopped by its rule \"{why}\".")).unwrap_or_default();
    let caption = format!(
        "Residual of the pairs and largest movement in each of the {} iterations of {node}.{stopped}",
        trace.steps.len()
    );
    page.charts("convergence", &[chart], &caption);
}

/// The inputs of every fine registration, and of what refines one.
const REGISTRATION: [&str; 3] = ["source", "target", "init"];

/// The node of the fine registration: the first with a source, a target and an initial pose that is not the result of another.
fn fine(run: &RunFolder) -> Option<&str> {
    run.nodes_with(&REGISTRATION).find(|node| begun_from(run, node).is_none())
}

/// The node with the final registration: the one that refines the fine registration, else that itself.
fn registered(run: &RunFolder) -> Option<&str> {
    let fine = fine(run)?;
    Some(run.nodes_with(&REGISTRATION).find(|node| begun_from(run, node) == Some(fine)).unwrap_or(fine))
}

/// The registration whose result a node begins with.
fn begun_from<'a>(run: &'a RunFolder, node: &str) -> Option<&'a str> {
    let (init, _) = run.wire_into(node, "init")?.rsplit_once('.')?;
    run.nodes_with(&REGISTRATION).find(|other| *other == init)
}
