//! The figures of a sweep: lines over numeric factors, boxes over other factors, scatter plots over draws.

use super::{Setting, SweepResults, label as quoted, number_of, setting_name};
use crate::{
    chart::{Axis, COLOURS, Chart, Mark, N_COLOURS, Series, Tukey, axis_label, share_axes},
    degrees::shown_unit,
    format::number,
    html::Page,
    summary::{self, Pairs, word},
};
use osteoflow_engine::sweep::{Column, Distribution, Done, Draw, Factor};
use osteoflow_statistics::{counted, pearson};
use serde_json::Value as Json;

/// Maximum number of figures of one kind; a note says how many were left out.
const MAX_FIGURES: usize = 24;
/// Maximum number of settings side by side.
const MAX_SETTINGS: usize = 30;
/// Maximum number of columns to plot a draw against.
const MAX_PER_DRAW: usize = 6;
/// Maximum number of panels in a figure.
const MAX_PANELS: usize = 6;

/// A figure for each numeric column.
pub(super) fn columns(page: &mut Page, sweep: &SweepResults) {
    let columns = sweep.numeric();
    let settings = sweep.settings();
    let layout = numeric_factor(sweep).and_then(|factor| Layout::of(sweep, factor, &settings));
    for column in columns.iter().take(MAX_FIGURES) {
        let all: Vec<f64> = settings.iter().flat_map(|setting| values(setting, column)).collect();
        if all.len() > 1 && all.iter().all(|value| *value == all[0]) {
            page.text(&format!("{} is {} in each of {} runs.", axis_label(&column.name), number(all[0]), all.len()));
            continue;
        }
        let (charts, caption) = match &layout {
            Some(layout) => against(column, layout),
            None if settings.len() <= MAX_SETTINGS => side_by_side(column, &settings),
            None => {
                page.missing(
                    &axis_label(&column.name),
                    &format!("{} settings are too many to show side by side", settings.len()),
                );
                continue;
            }
        };
        let with: Vec<_> = sweep.runs.iter().filter(|run| number_of(run, column).is_some()).collect();
        let of = summary::units_of(&sweep.spec, &with).map_or(Json::Null, |units| summary::levels(&units));
        let caption = format!("{caption} n = {} runs in all, of {}.", all.len(), summary::units(&of));
        page.charts(&format!("column-{}", column.name), &charts, &caption);
    }
    if columns.len() > MAX_FIGURES {
        page.text(&format!("{} more columns are in runs.csv.", columns.len() - MAX_FIGURES));
    }
}

/// The numeric factor with the most values, at least three, that is not a unit; the number of a bone is a name.
fn numeric_factor(sweep: &SweepResults) -> Option<&Factor> {
    let numeric = sweep.varied().into_iter().filter(|factor| {
        factor.levels.len() >= 3
            && factor.levels.iter().all(|level| level.label.is_number())
            && !sweep.spec.units.contains(&factor.name)
    });
    // Among equals, the first in the graph file.
    numeric.reduce(|best, factor| if factor.levels.len() > best.levels.len() { factor } else { best })
}

/// Lines and panels of a figure of columns over a factor.
struct Layout<'a> {
    x: &'a Factor,
    /// Panels by title, each with its lines; a single panel has no title.
    panels: Vec<(String, Vec<Line<'a>>)>,
    /// The factors whose values are pooled in each line.
    pooled: Vec<String>,
}

/// A line by its name, with its settings.
type Line<'a> = (String, Vec<&'a Setting<'a>>);

impl<'a> Layout<'a> {
    /// One line for each setting of the other factors if the colours suffice; otherwise one line for each value of another factor
    /// and one panel for each setting of the rest or, if there are too many panels, the rest pooled.
    fn of(sweep: &SweepResults, x: &'a Factor, settings: &'a [Setting<'a>]) -> Option<Self> {
        let varied = sweep.varied();
        let others: Vec<&str> = varied.iter().map(|f| f.name.as_str()).filter(|name| *name != x.name).collect();
        let lines = by(settings.iter().collect(), &others);
        if lines.len() <= N_COLOURS {
            return Some(Self { x, panels: vec![(String::new(), lines)], pooled: Vec::new() });
        }
        let few = varied.iter().filter(|f| f.name != x.name && f.levels.len() <= N_COLOURS);
        let line = few.reduce(|best, f| if f.levels.len() > best.levels.len() { f } else { best })?;
        let rest: Vec<&str> = others.into_iter().filter(|name| *name != line.name).collect();
        let panels = by(settings.iter().collect(), &rest);
        let lined = |(title, settings)| (title, by(settings, &[&line.name]));
        Some(match panels.len() {
            0..=MAX_PANELS => Self { x, panels: panels.into_iter().map(lined).collect(), pooled: Vec::new() },
            _ => Self {
                x,
                panels: vec![(String::new(), by(settings.iter().collect(), &[&line.name]))],
                pooled: rest.into_iter().map(axis_label).collect(),
            },
        })
    }
}

/// Groups settings by their values of these factors, in order.
fn by<'a>(settings: Vec<&'a Setting<'a>>, names: &[&str]) -> Vec<Line<'a>> {
    let mut groups: Vec<Line<'a>> = Vec::new();
    for setting in settings {
        let values: Vec<_> = setting.values.iter().filter(|(name, _)| names.contains(name)).copied().collect();
        let name = if values.is_empty() { String::new() } else { setting_name(&values) };
        match groups.iter_mut().find(|(known, _)| *known == name) {
            Some((_, group)) => group.push(setting),
            None => groups.push((name, vec![setting])),
        }
    }
    groups
}

fn values(setting: &Setting<'_>, column: &Column) -> Vec<f64> {
    setting.runs.iter().filter_map(|run| number_of(run, column)).collect()
}

/// Median and quartiles over the values of a factor, in one chart or in panels with common axes.
fn against(column: &Column, layout: &Layout<'_>) -> (Vec<Chart>, String) {
    let Layout { x: factor, panels: parts, pooled } = layout;
    let series = |lines: &[Line<'_>]| -> Vec<Series> {
        let lines = lines.iter().enumerate();
        lines.map(|(colour, (name, settings))| line(column, factor, name, settings, colour)).collect()
    };
    let (what, label) = (axis_label(&column.name), axis_label(&factor.name));
    let chart = |(title, lines): &(String, Vec<Line<'_>>)| Chart {
        title: if title.is_empty() { format!("{what} against {label}") } else { title.clone() },
        about: format!("Medians with quartiles of {} for each value of {}.", column.name, factor.name),
        x: axis(&factor.name, factor.levels.iter().filter_map(|level| level.label.as_f64())),
        y: Axis::Linear(what.clone()),
        series: series(lines),
        note: if title.is_empty() { String::new() } else { format!("{what} against {label}") },
    };
    let mut charts: Vec<Chart> = parts.iter().map(chart).collect();
    share_axes(&mut charts);
    let mut caption = format!("{what} against {label}: median (line) and quartiles (band) over the runs");
    if !pooled.is_empty() {
        caption += &format!(" with all values of {} pooled", pooled.join(", "));
    }
    if charts.len() > 1 {
        caption += "; the panels share their axes";
    }
    (charts, caption + ".")
}

/// Median and quartiles of these settings over a factor.
fn line(column: &Column, factor: &Factor, name: &str, settings: &[&Setting<'_>], colour: usize) -> Series {
    let place = |setting: &Setting<'_>| {
        setting.values.iter().find(|(name, _)| *name == factor.name).and_then(|(_, value)| value.as_f64())
    };
    let mut places: Vec<f64> = settings.iter().filter_map(|setting| place(setting)).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    let tukey = |x: &f64| {
        let there = settings.iter().filter(|setting| place(setting) == Some(*x));
        Some((*x, Tukey::of(&there.flat_map(|setting| values(setting, column)).collect::<Vec<_>>())?))
    };
    let boxes: Vec<(f64, Tukey)> = places.iter().filter_map(tukey).collect();
    let tip = |x: f64, t: &Tukey| {
        let [q1, q3] = t.quartiles.map(number);
        format!("{} = {x}: median {}, quartiles {q1} and {q3}, n = {}", factor.name, number(t.median), t.values.len())
    };
    let marks = vec![
        Mark::Band(boxes.iter().map(|(x, t)| (*x, t.quartiles[0], t.quartiles[1])).collect()),
        Mark::Line(boxes.iter().map(|(x, t)| (*x, t.median)).collect()),
        Mark::Dots(boxes.iter().map(|(x, t)| (*x, t.median, tip(*x, t))).collect()),
    ];
    Series { name: name.to_owned(), colour, marks }
}

/// A logarithmic axis if the values are spaced by ratios rather than differences: 100, 1000, 10,000.
fn axis(name: &str, values: impl Iterator<Item = f64>) -> Axis {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    let is_log = low > 0.0 && high / low >= 20.0;
    if is_log { Axis::Log(axis_label(name)) } else { Axis::Linear(axis_label(name)) }
}

/// A box for each setting.
fn side_by_side(column: &Column, settings: &[Setting<'_>]) -> (Vec<Chart>, String) {
    let marks = settings.iter().enumerate().filter_map(|(k, setting)| {
        let tukey = Tukey::of(&values(setting, column))?;
        Some(Series::unnamed(0, vec![Mark::Box(k as f64, if settings.len() < 3 { 0.12 } else { 0.3 }, tukey)]))
    });
    let chart = Chart {
        title: axis_label(&column.name),
        about: format!("A box of {} for each of {} settings.", column.name, settings.len()),
        x: Axis::Categories { label: setting_label(settings), names: settings.iter().map(Setting::short).collect() },
        y: Axis::Linear(axis_label(&column.name)),
        series: marks.collect(),
        note: String::new(),
    };
    let caption = "by setting: median and quartiles, whiskers to the last run within 1.5 interquartile ranges";
    (vec![chart], format!("{} of each run, {caption}.", axis_label(&column.name)))
}

/// Differences of the pairs of each comparison, by the highest unit.
pub(super) fn differences(page: &mut Page, sweep: &SweepResults) {
    let all = summary::pairs(&sweep.spec, &sweep.runs);
    let all = all.iter().enumerate().flat_map(|(k, pairs)| pairs.columns.iter().map(move |column| (k, pairs, *column)));
    for (k, pairs, column) in all.take(MAX_FIGURES) {
        difference(page, sweep, &format!("difference-{}-{}", k + 1, column.name), pairs, column);
    }
}

/// A dot for each pair, and a bar for the mean of each unit.
fn difference(page: &mut Page, sweep: &SweepResults, name: &str, pairs: &Pairs<'_>, column: &Column) {
    let unit = sweep.spec.units[0].as_str();
    let mut units: Vec<(String, Vec<(f64, String)>)> = Vec::new();
    for (first, second) in &pairs.runs {
        let (Some(a), Some(b)) = (number_of(first, column), number_of(second, column)) else { continue };
        let of = second.value(unit).map(word).unwrap_or_default();
        let pair = (b - a, format!("runs {} and {}: {}", first.run, second.run, number(b - a)));
        match units.iter_mut().find(|(known, _)| *known == of) {
            Some((_, pairs)) => pairs.push(pair),
            None => units.push((of, vec![pair])),
        }
    }
    let n = format!("{}, {}", counted(units.len(), unit), counted(units.iter().map(|of| of.1.len()).sum(), "pair"));
    match units.len() {
        0 => return,
        1..=MAX_SETTINGS => {}
        _ => units = vec![(format!("each {unit}"), units.into_iter().flat_map(|(_, pairs)| pairs).collect())],
    }
    let what = format!("{}, {} minus {}", axis_label(&column.name), pairs.second, pairs.first);
    let chart = Chart {
        title: what.clone(),
        about: format!("The difference of each pair of runs in {}, by {unit}.", column.name),
        x: Axis::Categories { label: unit.to_owned(), names: units.iter().map(|(name, _)| name.clone()).collect() },
        y: Axis::Linear(format!("difference of {}", axis_label(&column.name))),
        series: units.iter().enumerate().map(|(k, (_, pairs))| Series::spread(0, k, pairs)).collect(),
        note: String::new(),
    };
    let caption = format!("{what}: a dot is a pair of runs that differ in nothing else, a bar a mean. n = {n}.");
    page.charts(name, &[chart], &caption);
}

/// The factor's name, if only one is varied.
fn setting_label(settings: &[Setting<'_>]) -> String {
    match settings.first().map(|setting| setting.values.as_slice()) {
        Some([]) | None => "setting".into(),
        Some(values) => values.iter().map(|(name, _)| axis_label(name)).collect::<Vec<_>>().join(", "),
    }
}

/// Boxes of the values at points by axis, with the settings side by side.
pub(super) fn points(page: &mut Page, sweep: &SweepResults) {
    let all = sweep.point_values();
    let settings = sweep.settings();
    for measure in sweep.spec.points.iter().take(MAX_FIGURES) {
        if settings.len() > MAX_SETTINGS {
            let why =
                format!("{} settings are too many to show side by side; points.csv has the values", settings.len());
            page.missing(&axis_label(&measure.name), &why);
            continue;
        }
        let own: Vec<_> = all.iter().filter(|(_, value)| value.measure == measure.name).collect();
        if own.is_empty() {
            page.missing(&axis_label(&measure.name), "no run has values at its points");
            continue;
        }
        let of = |setting: Option<&Setting<'_>>, axis: &str| -> Vec<f64> {
            let wanted = |run: usize| setting.is_none_or(|setting| setting.runs.iter().any(|of| of.run == run));
            let values = own.iter().filter(|(run, v)| v.axis == axis && wanted(run.run));
            values.map(|(_, v)| v.value * shown_unit(&measure.name).1).collect()
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
            false => (setting_label(&settings), settings.iter().map(Setting::short).collect::<Vec<_>>()),
        };
        let n_points = own.iter().map(|(run, v)| (run.run, &v.point)).collect::<std::collections::BTreeSet<_>>().len();
        let n_runs = own.iter().map(|(run, _)| run.run).collect::<std::collections::BTreeSet<_>>().len();
        let chart = Chart {
            title: format!("{} by axis", axis_label(&measure.name)),
            about: format!("Boxes of the signed values of {} along {}.", measure.name, measure.axes.join(", ")),
            x: Axis::Categories { label, names },
            y: Axis::Linear(axis_label(&measure.name)),
            series: series.collect(),
            note: String::new(),
        };
        let axes = measure.axes.iter().enumerate().map(|(k, axis)| format!("{axis} ({})", COLOURS[k % N_COLOURS]));
        let caption = format!(
            "{} at the points, signed, along {}: n = {n_points} points of {n_runs} runs; points of one run are not independent.",
            axis_label(&measure.name),
            axes.collect::<Vec<_>>().join(", "),
        );
        page.charts(&format!("points-{}", measure.name), &[chart], &caption);
    }
}

/// Scatter plots of each drawn number against columns that it may affect.
pub(super) fn draws(page: &mut Page, sweep: &SweepResults) {
    let numeric = sweep.numeric();
    let along: Vec<_> = numeric.iter().filter(|column| column.name.ends_with("_z_mm")).copied().collect();
    let columns = if along.is_empty() { numeric } else { along };
    let mut left_out = 0;
    for draw in &sweep.spec.draws {
        if matches!(draw.distribution, Distribution::Choice(_)) {
            continue;
        }
        for column in columns.iter().take(MAX_PER_DRAW) {
            scatter(page, sweep, draw, column);
        }
        left_out += columns.len().saturating_sub(MAX_PER_DRAW);
    }
    if left_out > 0 {
        page.text(&format!("{left_out} more pairs of a drawn number and a column are in runs.csv."));
    }
}

/// Each column of errors against each column of times: a dot for each run, coloured by setting, and the medians of the settings.
pub(super) fn times(page: &mut Page, sweep: &SweepResults) {
    let (times, others): (Vec<_>, Vec<_>) = sweep.numeric().into_iter().partition(|column| column.is_time());
    let settings = sweep.settings();
    for time in &times {
        for column in others.iter().take(MAX_PER_DRAW) {
            against_time(page, &settings, time, column);
        }
        if others.len() > MAX_PER_DRAW {
            page.text(&format!("{} more columns against {} are in runs.csv.", others.len() - MAX_PER_DRAW, time.name));
        }
    }
}

fn against_time(page: &mut Page, settings: &[Setting<'_>], time: &Column, column: &Column) {
    let pairs = |setting: &Setting<'_>| -> Vec<(f64, f64, String)> {
        let pair = |run: &&Done| Some((number_of(run, time)?, number_of(run, column)?, format!("run {}", run.run)));
        setting.runs.iter().filter_map(pair).collect()
    };
    let all: Vec<_> = settings.iter().map(pairs).collect();
    let x = axis(&time.name, all.iter().flatten().map(|p| p.0));
    let y = axis(&column.name, all.iter().flatten().map(|p| p.1));
    let series = settings.iter().zip(&all).enumerate().filter_map(|(k, (setting, pairs))| {
        let of = |value: fn(&(f64, f64, String)) -> f64| Tukey::of(&pairs.iter().map(value).collect::<Vec<_>>());
        let (time, error) = (of(|p| p.0)?.median, of(|p| p.1)?.median);
        let tip = format!("{}: medians of {} runs, {} and {}", setting.name, pairs.len(), number(time), number(error));
        let name = if settings.len() > 1 { setting.name.clone() } else { String::new() };
        Some(Series {
            name,
            colour: k % N_COLOURS,
            marks: vec![Mark::Dots(pairs.clone()), Mark::Dots(vec![(time, error, tip)])],
        })
    });
    let title = format!("{} against {}", axis_label(&column.name), axis_label(&time.name));
    let about = format!("A scatter of {} over {}, a dot for each run.", column.name, time.name);
    let chart = Chart { title: title.clone(), about, x, y, series: series.collect(), note: String::new() };
    let n: usize = all.iter().map(Vec::len).sum();
    let caption = format!("{title}, a dot for each run: n = {n} runs. Times are of this machine and its load.");
    page.charts(&format!("time-{}-{}", time.name, column.name), &[chart], &caption);
}

/// A panel for each setting, with common axes: in one panel, dots would hide each other.
fn scatter(page: &mut Page, sweep: &SweepResults, draw: &Draw, column: &Column) {
    let settings = sweep.settings();
    let groups: Vec<(String, Vec<_>)> = match settings.len() <= MAX_PANELS {
        true => settings.iter().map(|s| (s.name.clone(), s.runs.clone())).collect(),
        false => {
            let all = format!("all {} settings", settings.len());
            vec![(all, settings.iter().flat_map(|s| s.runs.clone()).collect())]
        }
    };
    let label = axis_label(&draw.name);
    let (mut correlations, mut charts) = (Vec::new(), Vec::new());
    let one = settings.len() <= 1;
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
        let correlation = match pearson(&x, &y, 0.95) {
            Ok(found) => format!("r = {:.2}, n = {} runs", found.r, found.n).replace('-', "\u{2212}"),
            Err(why) => format!("no correlation: {why}"),
        };
        correlations.push(if one {
            correlation.clone()
        } else {
            format!("{}: {correlation}", quoted(&name.as_str().into()))
        });
        charts.push(Chart {
            title: if one { format!("{} against {label}", axis_label(&column.name)) } else { name },
            about: format!("A scatter of {} over {}, a dot for each run.", column.name, draw.name),
            x: match draw.distribution {
                Distribution::LogUniform(_) => Axis::Log(label.clone()),
                _ => Axis::Linear(label.clone()),
            },
            y: Axis::Linear(axis_label(&column.name)),
            series: vec![Series::unnamed(colour, vec![Mark::Dots(pairs)])],
            note: correlation,
        });
    }
    share_axes(&mut charts);
    let mut caption = format!(
        "{} of each run against the drawn {label}, with Pearson's correlation: {}. Runs on one {} are not independent, \
         so the correlation has no interval here.",
        axis_label(&column.name),
        correlations.join("; "),
        sweep.spec.units.first().map_or("unit", String::as_str),
    );
    if charts.len() > 1 {
        caption += " The panels share their axes.";
    }
    page.charts(&format!("scatter-{}-{}", column.name, draw.name), &charts, &caption);
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_engine::sweep::Done;
    use serde_json::json;

    /// A sweep over `n` words, `sides` sides and three numbers, with a column that grows with the number.
    fn swept(n: usize, sides: usize) -> SweepResults {
        let levels = |labels: Vec<Json>| -> Vec<Json> {
            labels.into_iter().map(|label| json!({ "label": label, "sets": ["a.b=1"] })).collect()
        };
        let words: Vec<Json> = (0..n).map(|k| format!("{k} mm, here").into()).collect();
        let sides: Vec<Json> = (0..sides).map(|k| format!("side {k}").into()).collect();
        let numbers: Vec<Json> = [0.0, 10.0, 20.0, 30.0].map(Json::from).into();
        let mut runs = Vec::new();
        for word in &words {
            for side in &sides {
                for number in &numbers {
                    let values = [("stripped", word), ("side", side), ("first_mm", number)];
                    runs.push(Done {
                        run: runs.len(),
                        seed: 1,
                        values: values.map(|(name, value)| (name.to_owned(), value.clone())).into_iter().collect(),
                        sets: Vec::new(),
                        status: "complete".into(),
                        reason: None,
                        warnings: Vec::new(),
                        results: json!({ "tre_mm": number }),
                        twice: None,
                        asked: None,
                    });
                }
            }
        }
        let spec = json!({
            "repeat": 1, "repeat_name": "procedure", "same_seed": false, "units": ["procedure"], "pair": [], "draws": [],
            "factors": [
                { "name": "stripped", "levels": levels(words) }, { "name": "side", "levels": levels(sides) },
                { "name": "first_mm", "levels": levels(numbers) },
            ],
            "columns": [{ "name": "tre_mm", "path": "tre_mm" }], "points": [], "limits": [], "compare": [],
        });
        SweepResults { spec: serde_json::from_value(spec).unwrap(), about: Json::Null, runs }
    }

    fn drawn(n: usize, sides: usize) -> (String, String) {
        let mut page = Page::new("", true);
        columns(&mut page, &swept(n, sides));
        let svg = page.figures.first().map(|figure| figure.svg.clone()).unwrap_or_default();
        (svg, page.finish("").0)
    }

    #[test]
    fn a_column_with_one_value_has_a_sentence_instead_of_a_figure() {
        let mut sweep = swept(2, 2);
        sweep.runs.iter_mut().for_each(|run| run.results["tre_mm"] = 7.into());
        let mut page = Page::new("", true);
        columns(&mut page, &sweep);
        assert!(page.figures.is_empty() && page.finish("").0.contains("tre (mm) is 7 in each of 16 runs"));
        sweep.runs[3].results["tre_mm"] = 8.into();
        let mut page = Page::new("", true);
        columns(&mut page, &sweep);
        assert_eq!(page.figures.len(), 1, "one run differs");
    }

    #[test]
    fn differences_are_second_minus_first_of_runs_that_differ_in_nothing_else_by_unit_and_in_degrees() {
        // Two sides, on 3 units and with 4 numbers each.
        let mut sweep = swept(3, 2);
        sweep.spec.units = vec!["stripped".into(), "procedure".into()];
        sweep.spec.columns[0].name = "tilt_rad".into();
        let compare = json!({ "factor": "side", "to": "side 1", "margins": [] });
        sweep.spec.compare = vec![serde_json::from_value(compare).unwrap()];
        for (k, run) in sweep.runs.iter_mut().enumerate() {
            // The second is greater by 1, 2 and 3 degrees on the three units, whatever the number.
            let more = if run.values["side"] == "side 0" { k / 8 + 1 } else { 0 };
            run.results["tre_mm"] = (10.0 * (k % 4) as f64 + more as f64).to_radians().into();
        }
        // A pair without its second run.
        sweep.runs[0].status = "refused".into();
        let shown = |sweep: &SweepResults| {
            let mut page = Page::new("", true);
            differences(&mut page, sweep);
            (page.figures.first().map(|figure| (figure.name.clone(), figure.svg.clone())), page.finish("").0)
        };
        let (figure, html) = shown(&sweep);
        let (name, svg) = figure.unwrap();
        assert_eq!(name, "difference-1-tilt_rad");
        assert!(html.contains("tilt (\u{b0}), side 0 minus side 1:"), "{html}");
        assert!(html.contains("n = 3 strippeds, 11 pairs."), "{html}");
        let dots = svg.split("<circle").skip(1).map(|dot| dot.split(": ").nth(1).unwrap().split('<').next().unwrap());
        let dots: Vec<f64> = dots.map(|text| text.parse::<f64>().unwrap().round()).collect();
        assert_eq!(dots, [vec![1.0; 3], vec![2.0; 4], vec![3.0; 4]].concat(), "{svg}");
        assert_eq!(svg.matches("<path class=\"line c0\"").count(), 3, "a mean for each unit");
        // More units than an axis can name are pooled, and still counted.
        let mut many = swept(MAX_SETTINGS + 1, 2);
        (many.spec.units, many.spec.compare) = (sweep.spec.units.clone(), sweep.spec.compare.clone());
        let (figure, html) = shown(&many);
        assert_eq!(figure.unwrap().1.matches("<path class=\"line c0\"").count(), 1);
        assert!(html.contains("n = 31 strippeds, 124 pairs."), "{html}");
    }

    #[test]
    fn many_settings_are_lines_of_one_factor_in_panels_of_the_rest() {
        let (svg, html) = drawn(7, 3);
        assert!(html.contains("the panels share their axes"), "{html}");
        assert_eq!(svg.matches("<path class=\"line c").count(), 7 * 3, "a line for each word on each side");
        assert_eq!(svg.matches(">first (mm)<").count(), 3, "an axis for each panel");
        assert_eq!(svg.matches("font-weight: 600\">side 2<").count(), 1, "a panel says its side");
    }

    #[test]
    fn too_many_panels_are_pooled_and_the_caption_says_so() {
        let (svg, html) = drawn(7, 9);
        assert_eq!(svg.matches("<path class=\"line c").count(), 7, "a line for each word");
        assert!(html.contains("with all values of side pooled"), "{html}");
    }

    #[test]
    fn few_settings_have_a_line_each() {
        let (svg, html) = drawn(2, 3);
        assert_eq!(svg.matches("<path class=\"line c").count(), 6);
        assert!(!html.contains("panels"));
        assert!(svg.contains("stripped = \u{201c}0 mm, here\u{201d}, side = side 0"), "{svg}");
    }
}
