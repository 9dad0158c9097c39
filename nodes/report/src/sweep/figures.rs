//! The figures of a sweep, chosen by what it varies: a line against a number, boxes by words, a scatter against a draw.

use super::{Setting, Swept, number_of};
use crate::{
    cell::number,
    chart::{Axis, Chart, Mark, N_COLOURS, Series, Tukey, named},
    html::Page,
};
use osteoflow_engine::sweep::{Column, Distribution, Draw, Factor};
use osteoflow_statistics::pearson;
use serde_json::Value as Json;

/// More figures of one kind are left out, with a word.
const MOST_FIGURES: usize = 24;
/// More settings do not stand side by side.
const MOST_SETTINGS: usize = 30;
/// Columns that a draw is shown against.
const MOST_PER_DRAW: usize = 6;

/// A figure for each column of numbers.
pub(super) fn columns(page: &mut Page, sweep: &Swept) {
    let columns = sweep.numeric();
    let settings = sweep.settings();
    let factor = numeric_factor(sweep);
    for column in columns.iter().take(MOST_FIGURES) {
        let n: usize = settings.iter().map(|s| values(s, column).len()).sum();
        let drawn = match factor.filter(|factor| series_beside(factor, &settings) <= N_COLOURS) {
            Some(factor) => against(page, column, factor, &settings),
            None if settings.len() <= MOST_SETTINGS => side_by_side(page, column, &settings),
            None => {
                page.missing(&named(&column.name), &format!("{} settings do not stand side by side", settings.len()));
                continue;
            }
        };
        let (chart, caption) = drawn;
        page.figure(&format!("column-{}", column.name), chart.svg(), &format!("{caption} n = {n} runs in all."));
    }
    if columns.len() > MOST_FIGURES {
        page.text(&format!("{} more columns are in runs.csv.", columns.len() - MOST_FIGURES));
    }
}

/// What is varied over at least three numbers and is no unit: an axis, where a bone's number is a name.
fn numeric_factor(sweep: &Swept) -> Option<&Factor> {
    sweep.varied().into_iter().find(|factor| {
        factor.levels.len() >= 3
            && factor.levels.iter().all(|level| level.label.is_number())
            && !sweep.spec.units.contains(&factor.name)
    })
}

/// The settings beside this factor, by name, in their order.
fn beside(factor: &Factor, settings: &[Setting<'_>]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for setting in settings {
        let name = name_beside(factor, setting);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

fn name_beside(factor: &Factor, setting: &Setting<'_>) -> String {
    let rest: Vec<_> = setting.values.iter().filter(|(name, _)| *name != factor.name).copied().collect();
    if rest.is_empty() { String::new() } else { super::setting_name(&rest) }
}

fn series_beside(factor: &Factor, settings: &[Setting<'_>]) -> usize {
    beside(factor, settings).len()
}

fn values(setting: &Setting<'_>, column: &Column) -> Vec<f64> {
    setting.runs.iter().filter_map(|run| number_of(run, column)).collect()
}

/// Median and quartiles against the values of a factor.
fn against(page: &Page, column: &Column, factor: &Factor, settings: &[Setting<'_>]) -> (Chart, String) {
    let place = |setting: &Setting<'_>| {
        setting.values.iter().find(|(name, _)| *name == factor.name).and_then(|(_, value)| value.as_f64())
    };
    let series = beside(factor, settings).into_iter().enumerate().map(|(colour, name)| {
        let mut boxes: Vec<(f64, Tukey)> = settings
            .iter()
            .filter(|setting| name_beside(factor, setting) == name)
            .filter_map(|setting| Some((place(setting)?, Tukey::of(&values(setting, column))?)))
            .collect();
        boxes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let tip = |x: f64, t: &Tukey| {
            let [q1, q3] = t.quartiles.map(number);
            format!(
                "{} = {x}: median {}, quartiles {q1} and {q3}, n = {}",
                factor.name,
                number(t.median),
                t.values.len()
            )
        };
        let marks = vec![
            Mark::Band(boxes.iter().map(|(x, t)| (*x, t.quartiles[0], t.quartiles[1])).collect()),
            Mark::Line(boxes.iter().map(|(x, t)| (*x, t.median)).collect()),
            Mark::Dots(boxes.iter().map(|(x, t)| (*x, t.median, tip(*x, t))).collect()),
        ];
        Series { name, colour, marks }
    });
    let label = named(&factor.name);
    let chart = Chart {
        title: format!("{} against {}", named(&column.name), label),
        about: format!("Medians with quartiles of {} for each value of {}.", column.name, factor.name),
        x: if is_logarithmic(factor) { Axis::Log(label.clone()) } else { Axis::Linear(label.clone()) },
        y: Axis::Linear(named(&column.name)),
        series: series.collect(),
        note: String::new(),
        simulated: page.simulated(),
    };
    let caption = format!("{} against {label}: median (line) and quartiles (band) over the runs.", named(&column.name));
    (chart, caption)
}

/// Whether the values lie rather by factors than by differences: 100, 1000, 10,000.
fn is_logarithmic(factor: &Factor) -> bool {
    let values: Vec<f64> = factor.levels.iter().filter_map(|level| level.label.as_f64()).collect();
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    low > 0.0 && high / low >= 20.0
}

/// A box for each setting.
fn side_by_side(page: &Page, column: &Column, settings: &[Setting<'_>]) -> (Chart, String) {
    let marks = settings.iter().enumerate().filter_map(|(k, setting)| {
        let tukey = Tukey::of(&values(setting, column))?;
        Some(Series {
            name: String::new(),
            colour: 0,
            marks: vec![Mark::Box(k as f64, box_width(settings.len()), tukey)],
        })
    });
    let chart = Chart {
        title: named(&column.name),
        about: format!("A box of {} for each of {} settings.", column.name, settings.len()),
        x: Axis::Categories {
            label: setting_label(settings),
            names: settings.iter().map(|s| s.name.clone()).collect(),
        },
        y: Axis::Linear(named(&column.name)),
        series: marks.collect(),
        note: String::new(),
        simulated: page.simulated(),
    };
    (chart, format!("{} of each run, by setting.", named(&column.name)))
}

/// The factor, where only one is varied.
fn setting_label(settings: &[Setting<'_>]) -> String {
    match settings.first().map(|setting| setting.values.as_slice()) {
        Some([(name, _)]) => named(name),
        _ => "setting".into(),
    }
}

fn box_width(n: usize) -> f64 {
    if n < 3 { 0.12 } else { 0.3 }
}

/// Boxes by axis of what is told at points, the settings side by side.
pub(super) fn points(page: &mut Page, sweep: &Swept) {
    let all = sweep.point_values();
    let settings = sweep.settings();
    for measure in sweep.spec.points.iter().take(MOST_FIGURES) {
        if settings.len() > MOST_SETTINGS {
            let why = format!("{} settings do not stand side by side; points.csv has the values", settings.len());
            page.missing(&named(&measure.name), &why);
            continue;
        }
        let own: Vec<_> = all.iter().filter(|(_, value)| value.measure == measure.name).collect();
        if own.is_empty() {
            page.missing(&named(&measure.name), "no run says anything at its points");
            continue;
        }
        let of = |setting: Option<&Setting<'_>>, axis: &str| -> Vec<f64> {
            let wanted = |run: usize| setting.is_none_or(|setting| setting.runs.iter().any(|of| of.run == run));
            own.iter().filter(|(run, v)| v.axis == axis && wanted(run.run)).map(|(_, v)| v.value).collect()
        };
        let n_axes = measure.axes.len().max(1) as f64;
        let one = settings.len() == 1;
        let width = if one { 0.16 } else { 0.36 / n_axes };
        let series = measure.axes.iter().enumerate().map(|(k, axis)| {
            let boxes = settings.iter().enumerate().filter_map(|(s, setting)| {
                let at = if one { k as f64 } else { s as f64 + (k as f64 - (n_axes - 1.0) / 2.0) * 0.8 / n_axes };
                Some(Mark::Box(at, width, Tukey::of(&of(Some(setting), axis))?))
            });
            Series { name: if one { String::new() } else { axis.clone() }, colour: k, marks: boxes.collect() }
        });
        let (label, names) = match one {
            true => ("axis".into(), measure.axes.clone()),
            false => (setting_label(&settings), settings.iter().map(|s| s.name.clone()).collect::<Vec<_>>()),
        };
        let n_points = own.iter().map(|(run, v)| (run.run, &v.point)).collect::<std::collections::BTreeSet<_>>().len();
        let n_runs = own.iter().map(|(run, _)| run.run).collect::<std::collections::BTreeSet<_>>().len();
        let chart = Chart {
            title: format!("{} by axis", named(&measure.name)),
            about: format!("Boxes of the signed values of {} along {}.", measure.name, measure.axes.join(", ")),
            x: Axis::Categories { label, names },
            y: Axis::Linear(named(&measure.name)),
            series: series.collect(),
            note: String::new(),
            simulated: page.simulated(),
        };
        let caption = format!(
            "{} at the points, signed, along {}: n = {n_points} points of {n_runs} runs; points of one run are not independent.",
            named(&measure.name),
            measure.axes.join(", "),
        );
        page.figure(&format!("points-{}", measure.name), chart.svg(), &caption);
    }
}

/// A scatter of each drawn number against the columns that it may decide.
pub(super) fn draws(page: &mut Page, sweep: &Swept) {
    let numeric = sweep.numeric();
    let along: Vec<_> = numeric.iter().filter(|column| column.name.ends_with("_z_mm")).copied().collect();
    let columns = if along.is_empty() { numeric } else { along };
    let mut left_out = 0;
    for draw in &sweep.spec.draws {
        if matches!(draw.distribution, Distribution::Choice(_)) {
            continue;
        }
        for column in columns.iter().take(MOST_PER_DRAW) {
            scatter(page, sweep, draw, column);
        }
        left_out += columns.len().saturating_sub(MOST_PER_DRAW);
    }
    if left_out > 0 {
        page.text(&format!("{left_out} more pairs of a drawn number and a column are in runs.csv."));
    }
}

fn scatter(page: &mut Page, sweep: &Swept, draw: &Draw, column: &Column) {
    let settings = sweep.settings();
    let apart = settings.len() <= N_COLOURS;
    let groups: Vec<(String, Vec<_>)> = match apart {
        true => settings.iter().map(|s| (s.name.clone(), s.runs.clone())).collect(),
        false => vec![(String::new(), settings.iter().flat_map(|s| s.runs.clone()).collect())],
    };
    let mut told = Vec::new();
    let mut series = Vec::new();
    for (colour, (name, runs)) in groups.into_iter().enumerate() {
        let pairs: Vec<(f64, f64, String)> = runs
            .iter()
            .filter_map(|run| {
                Some((
                    run.value(&draw.name).and_then(Json::as_f64)?,
                    number_of(run, column)?,
                    format!("run {}", run.run),
                ))
            })
            .collect();
        let (x, y): (Vec<f64>, Vec<f64>) = pairs.iter().map(|(x, y, _)| (*x, *y)).unzip();
        let said = match pearson(&x, &y, 0.95) {
            Ok(found) => format!("r = {:.2}, n = {} runs", found.r, found.n).replace('-', "\u{2212}"),
            Err(why) => format!("no correlation: {why}"),
        };
        let named = if settings.len() > 1 && apart { format!("{name}: {said}") } else { said };
        told.push(named.clone());
        series.push(Series { name: named, colour, marks: vec![Mark::Dots(pairs)] });
    }
    let label = named(&draw.name);
    let chart = Chart {
        title: format!("{} against {label}", named(&column.name)),
        about: format!("A scatter of {} over {}, a dot for each run.", column.name, draw.name),
        x: match draw.distribution {
            Distribution::LogUniform(_) => Axis::Log(label.clone()),
            _ => Axis::Linear(label.clone()),
        },
        y: Axis::Linear(named(&column.name)),
        series,
        note: String::new(),
        simulated: page.simulated(),
    };
    let caption = format!(
        "{} of each run against {label} as it was drawn, with Pearson's correlation: {}. Runs on one {} are not independent, \
         so the correlation has no interval here.",
        named(&column.name),
        told.join("; "),
        sweep.spec.units.first().map_or("unit", String::as_str),
    );
    page.figure(&format!("scatter-{}-{}", column.name, draw.name), chart.svg(), &caption);
}
