//! The slide profile: the residual along the bone and around it.

use crate::{
    chart::{Axis, Chart, Mark, Series},
    format::number,
    html::Page,
    run_folder::RunFolder,
};
use osteoflow_algorithms::slide::{SlideProfile, SlideReport};

/// The kind whose report has the profile.
const KIND: &str = "refine.slide";

/// Draws both profiles, if the graph has them.
pub(super) fn profile(page: &mut Page, run: &RunFolder) {
    let Some(node) = run.node_of_kind(KIND) else { return };
    match run.value::<SlideReport>(&format!("{node}.report")) {
        Ok(report) => draw(page, &report),
        Err(why) => page.missing("The slide profile", &why),
    }
}

fn draw(page: &mut Page, report: &SlideReport) {
    let panel = |title: &str, unit: &str, profile: &SlideProfile, one: f64| Chart {
        title: title.into(),
        about: format!("The RMS residual at {} offsets.", profile.offsets.len()),
        x: Axis::Linear(format!("offset from the result ({unit})")),
        y: Axis::Linear("residual (mm)".into()),
        series: series(profile, one, report.residual_mm),
        note: String::new(),
    };
    let charts = [
        panel("Along the bone", "mm", &report.along, 1.0),
        panel("Around the bone", "\u{b0}", &report.around, 1_f64.to_radians()),
    ];
    let caption = format!(
        "The residual along the bone and around it, with the other five motions fitted at each offset. Dots: where it cannot be \
         told from the result. {}.",
        report.modes.join("; ")
    );
    page.charts("slide", &charts, &caption);
}

/// The profile, and the part of it that cannot be told from the result.
fn series(profile: &SlideProfile, one: f64, residual_mm: f64) -> Vec<Series> {
    let points: Vec<(f64, f64)> =
        profile.offsets.iter().zip(&profile.residual_mm).map(|(offset, residual)| (offset / one, *residual)).collect();
    let [low, high] = profile.interval;
    let within = profile.offsets.iter().zip(&points).filter(|(offset, _)| (low..=high).contains(*offset));
    let dots = within.map(|(_, (x, y))| (*x, *y, format!("{}: {} mm", number(*x), number(*y)))).collect();
    vec![
        Series::unnamed(0, vec![Mark::Line(points), Mark::Reach(vec![(0.0, 0.0), (0.0, residual_mm)])]),
        Series::unnamed(1, vec![Mark::Dots(dots)]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile(half: f64) -> SlideProfile {
        SlideProfile {
            offsets: vec![-half, -half / 2.0, 0.0, half / 2.0, half],
            others: vec![0.0; 5],
            residual_mm: vec![0.4, 0.1, 0.08, 0.12, 0.3],
            excess_mm: vec![0.39, 0.06, 0.0, 0.09, 0.29],
            interval: [-half * 0.6, half * 0.3],
            is_undetermined: false,
        }
    }

    #[test]
    fn both_profiles_are_drawn_with_the_part_that_cannot_be_told_from_the_result() {
        let (along, around) = (profile(30.0), profile(1.0));
        let dots = |profile: &SlideProfile, one: f64| match &series(profile, one, 0.08)[1].marks[..] {
            [Mark::Dots(dots)] => dots.iter().map(|dot| dot.0).collect::<Vec<_>>(),
            other => panic!("{other:?}"),
        };
        assert_eq!(dots(&along, 1.0), [-15.0, 0.0]);
        let degrees = dots(&around, 1_f64.to_radians());
        assert!((degrees[0] + 28.65).abs() < 0.01 && degrees[1] == 0.0, "{degrees:?}");
        let report = SlideReport {
            determined: true,
            modes: vec!["slides along the bone".into(), "turns about the bone".into()],
            axis: [0.0, 0.0, 1.0],
            middle_mm: [0.0; 3],
            radius_mm: 6.0,
            moved_along_mm: 0.0,
            moved_turn_rad: 0.0,
            moved_mm: 0.0,
            residual_mm: 0.08,
            sigma_mm: 0.08,
            noise_mm: 0.05,
            n_cells: 30,
            along,
            around,
            runner_up: None,
        };
        let mut page = Page::new("", true);
        draw(&mut page, &report);
        let html = page.finish("").0;
        for text in ["Along the bone", "Around the bone", "slides along the bone; turns about the bone.", "SIMULATED"] {
            assert!(html.contains(text), "{text} is missing:\n{html}");
        }
    }
}
