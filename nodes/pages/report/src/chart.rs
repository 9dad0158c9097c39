//! Charts as SVG text: points, lines and boxes on two axes, each with its unit.
//!
//! Charts have no dependencies, and their style classes serve paper, dark screens and the page alike.

mod axis;

pub(crate) use axis::{Axis, axis_label};

use osteoflow_draw::xml::{escape, text};
use std::fmt::Write;

/// The disclaimer on every figure.
pub const RESEARCH: &str = "research use only";

/// The disclaimer on a figure, with SIMULATED if no measured data was registered.
pub(crate) fn disclaimer(simulated: bool) -> String {
    if simulated { format!("SIMULATED \u{b7} {RESEARCH}") } else { RESEARCH.into() }
}

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 400.0;
/// Height of the plot in a panel among others.
const PANEL: f64 = 230.0;
const LEFT: f64 = 72.0;
const RIGHT: f64 = 16.0;
/// Height of a line of text below the plot.
const ROW: f64 = 18.0;
/// Mean width of a character.
const CHARACTER: f64 = 6.4;
/// Attributes of a small text that ends at its place.
const SMALL_AT_END: &str = "class=\"small\" text-anchor=\"end\"";

/// The colours of Okabe and Ito, which are safe for colour-blind readers, with a grey and a brown; lighter in dark mode.
const STYLE: &str = "\
text { font-family: system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif; font-size: 12px; fill: #24292f }
.paper { fill: #ffffff }
.small { font-size: 11px; fill: #59636e }
.axis { stroke: #57606a; stroke-width: 1; fill: none }
.grid { stroke: #d8dee4; stroke-width: 0.6 }
.zero { stroke: #8b949e; stroke-width: 1; stroke-dasharray: 4 3 }
.line { fill: none; stroke-width: 1.8 }
.band { opacity: 0.18; stroke: none }
.dot { opacity: 0.75 }
.box { fill-opacity: 0.22; stroke-width: 1.4 }
.c0 { stroke: #0072b2; fill: #0072b2 } .c1 { stroke: #d55e00; fill: #d55e00 } .c2 { stroke: #009e73; fill: #009e73 }
.c3 { stroke: #aa4499; fill: #aa4499 } .c4 { stroke: #b07d00; fill: #b07d00 } .c5 { stroke: #3a9bdc; fill: #3a9bdc }
.c6 { stroke: #59636e; fill: #59636e } .c7 { stroke: #8c564b; fill: #8c564b }
.line, .whisker { fill: none } .dot, .band { stroke: none }
@media (prefers-color-scheme: dark) {
text { fill: #e6edf3 }
.paper { fill: #0d1117 }
.small { fill: #9198a1 }
.axis { stroke: #9198a1 } .grid { stroke: #30363d } .zero { stroke: #7d8590 }
.c0 { stroke: #56b4e9; fill: #56b4e9 } .c1 { stroke: #ff8f4a; fill: #ff8f4a } .c2 { stroke: #2bc69a; fill: #2bc69a }
.c3 { stroke: #dd88cc; fill: #dd88cc } .c4 { stroke: #e6b422; fill: #e6b422 } .c5 { stroke: #9ad3f5; fill: #9ad3f5 }
.c6 { stroke: #b7c0ca; fill: #b7c0ca } .c7 { stroke: #c9978d; fill: #c9978d }
.line, .whisker { fill: none } .dot, .band { stroke: none }
}";

/// Number of colours for series.
pub(crate) const N_COLOURS: usize = 8;
/// Their names, for captions.
pub(crate) const COLOURS: [&str; N_COLOURS] =
    ["blue", "orange", "green", "purple", "ochre", "light blue", "grey", "brown"];

/// A mark of a chart.
#[derive(Debug, Clone)]
pub(crate) enum Mark {
    /// A line through points.
    Line(Vec<(f64, f64)>),
    /// A band between a lower and an upper value: `(x, low, high)`.
    Band(Vec<(f64, f64, f64)>),
    /// Points, each with its tooltip.
    Dots(Vec<(f64, f64, String)>),
    /// Tukey's box at x, with half its width in units of x.
    Box(f64, f64, Tukey),
    /// Invisible: extends the axes, so that panels share them.
    Reach(Vec<(f64, f64)>),
}

impl Mark {
    /// The places that the axes must reach.
    fn places(&self) -> Vec<(f64, f64)> {
        match self {
            Self::Reach(points) => points.clone(),
            Self::Box(at, width, tukey) => {
                let values = tukey.values.iter().chain(&tukey.whiskers);
                values.flat_map(|value| [(at - width, *value), (at + width, *value)]).collect()
            }
            mark => mark.numbers().into_iter().map(|(_, x, y, _)| (x, y)).collect(),
        }
    }

    /// The numbers that it draws: what it is, the place along x, the value along y, and the tooltip.
    fn numbers(&self) -> Vec<(&'static str, f64, f64, String)> {
        let number = |what, (x, y): (f64, f64)| (what, x, y, String::new());
        match self {
            Self::Line(points) => points.iter().map(|at| number("line", *at)).collect(),
            Self::Band(points) => {
                let ends =
                    points.iter().map(|(x, low, high)| [("lower bound", (*x, *low)), ("upper bound", (*x, *high))]);
                ends.flatten().map(|(end, at)| number(end, at)).collect()
            }
            Self::Dots(points) => points.iter().map(|(x, y, tip)| ("dot", *x, *y, tip.clone())).collect(),
            Self::Box(at, _, tukey) => {
                let Tukey { median, quartiles: [q1, q3], whiskers: [low, high], values } = tukey;
                let parts = ["lower whisker", "quartile 1", "median", "quartile 3", "upper whisker"].into_iter();
                let parts = parts.zip([low, q1, median, q3, high]);
                let parts = parts.map(|(part, value)| (part, *at, *value, format!("n = {}", values.len())));
                parts.chain(tukey.drawn().map(|value| number("dot", (*at, value)))).collect()
            }
            Self::Reach(_) => Vec::new(),
        }
    }
}

/// Tukey's box: quartiles, and whiskers to the last values within 1.5 interquartile ranges.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tukey {
    pub(crate) median: f64,
    pub(crate) quartiles: [f64; 2],
    pub(crate) whiskers: [f64; 2],
    pub(crate) values: Vec<f64>,
}

/// Maximum number of values that are all shown.
const MAX_SHOWN: usize = 24;

impl Tukey {
    /// The box of finite values; `None` without any.
    pub(crate) fn of(values: &[f64]) -> Option<Self> {
        use osteoflow_statistics::quantile;
        let mut values = values.to_vec();
        values.sort_by(f64::total_cmp);
        if values.is_empty() {
            return None;
        }
        let sorted = values.clone();
        let [q1, median, q3] = [0.25, 0.5, 0.75].map(|q| quantile(&mut values, q));
        let reach = 1.5 * (q3 - q1);
        let within = || sorted.iter().copied().filter(|v| (q1 - reach..=q3 + reach).contains(v));
        // A quartile lies between values, so there may be no value beyond it.
        let whiskers = [within().fold(q1, f64::min), within().fold(q3, f64::max)];
        Some(Self { median, quartiles: [q1, q3], whiskers, values: sorted })
    }

    /// The values to draw one by one: all if they are few, otherwise those beyond the whiskers.
    fn drawn(&self) -> impl Iterator<Item = f64> {
        let [low, high] = self.whiskers;
        let all = self.values.len() <= MAX_SHOWN;
        self.values.iter().copied().filter(move |v| all || *v < low || *v > high)
    }
}

/// Marks with one name and one colour.
#[derive(Debug, Clone)]
pub(crate) struct Series {
    /// The name in the legend; none if empty.
    pub(crate) name: String,
    /// Index of the colour.
    pub(crate) colour: usize,
    pub(crate) marks: Vec<Mark>,
}

impl Series {
    /// Marks without an entry in the legend.
    pub(crate) fn unnamed(colour: usize, marks: Vec<Mark>) -> Self {
        Self { name: String::new(), colour, marks }
    }

    /// Values with their tooltips, side by side about the `k`-th category, and a bar at their mean.
    pub(crate) fn spread(colour: usize, k: usize, values: &[(f64, String)]) -> Self {
        let (n, at) = (values.len() as f64, k as f64);
        let mean = values.iter().map(|(value, _)| value).sum::<f64>() / n;
        let aside = |i: usize| 0.36 * ((i as f64 + 0.5) / n - 0.5);
        let dots = values.iter().enumerate().map(|(i, (value, tip))| (at + aside(i), *value, tip.clone()));
        Self::unnamed(colour, vec![Mark::Line(vec![(at - 0.25, mean), (at + 0.25, mean)]), Mark::Dots(dots.collect())])
    }
}

/// A chart.
#[derive(Debug, Clone)]
pub(crate) struct Chart {
    pub(crate) title: String,
    /// A description for readers who cannot see it.
    pub(crate) about: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) series: Vec<Series>,
    /// A note above the plot.
    pub(crate) note: String,
}

impl Chart {
    /// The elements of the chart with the plot's bottom at `bottom`, and its height.
    fn inside(&self, bottom: f64, simulated: bool) -> (String, f64) {
        let (across, along): (Vec<f64>, Vec<f64>) = self.places().into_iter().unzip();
        let x = self.x.scale(&across, LEFT, WIDTH - RIGHT);
        let legend = self.legend();
        let top = legend.last().map_or(34.0, |(_, _, y)| y + ROW - 2.0);
        let words = self.x.categories();
        let wide = words.iter().map(|w| w.chars().count() as f64 * CHARACTER).fold(0.0, f64::max);
        let aslant = !words.is_empty() && wide > (WIDTH - LEFT - RIGHT) / words.len() as f64 - 6.0;
        let below = if aslant { (wide * ASLANT.1 + 14.0).min(MAX_BELOW) } else { ROW };
        let bottom = bottom + top - 34.0;
        let height = bottom + below + 2.0 * ROW + 8.0;
        let y = self.y.scale(&along, bottom, top);
        let mut out = String::new();
        // Bold letters of 13 px are wider than those of labels; a note stands at the end of the same line.
        let room = WIDTH - RIGHT - LEFT - self.note.chars().count() as f64 * CHARACTER;
        let title = shortened(&self.title, room / 1.35);
        text(&mut out, (LEFT, 18.0), "style=\"font-size: 13px; font-weight: 600\"", &title);
        text(&mut out, (WIDTH - RIGHT, height - 6.0), SMALL_AT_END, &disclaimer(simulated));
        for (series, x, y) in legend {
            let (colour, top) = (series.colour % N_COLOURS, y - 9.0);
            let _ =
                writeln!(out, "<rect class=\"box c{colour}\" x=\"{x:.1}\" y=\"{top:.1}\" width=\"12\" height=\"9\"/>");
            text(&mut out, (x + 17.0, y), "", &shortened(&series.name, WIDTH - RIGHT - x - 17.0));
        }
        self.draw_axes(&mut out, (&x, &y), (top, bottom), aslant, height);
        for series in &self.series {
            for mark in &series.marks {
                draw_mark(&mut out, mark, series.colour % N_COLOURS, &x, &y);
            }
        }
        if !self.note.is_empty() {
            text(&mut out, (WIDTH - RIGHT, 18.0), SMALL_AT_END, &self.note);
        }
        (out, height)
    }

    fn places(&self) -> Vec<(f64, f64)> {
        self.series.iter().flat_map(|series| &series.marks).flat_map(Mark::places).collect()
    }

    /// The series with names, each with the place of its entry in the legend.
    fn legend(&self) -> Vec<(&Series, f64, f64)> {
        let (mut x, mut y) = (LEFT, 36.0);
        let mut places = Vec::new();
        for series in self.series.iter().filter(|series| !series.name.is_empty()) {
            let width = 32.0 + series.name.chars().count() as f64 * CHARACTER;
            if x + width > WIDTH - RIGHT && x > LEFT {
                (x, y) = (LEFT, y + ROW);
            }
            places.push((series, x, y));
            x += width;
        }
        places
    }

    fn draw_axes(
        &self,
        out: &mut String,
        (x, y): (&axis::Scale, &axis::Scale),
        (top, bottom): (f64, f64),
        aslant: bool,
        height: f64,
    ) {
        let right = WIDTH - RIGHT;
        let line = |out: &mut String, class: &str, y: f64| {
            let _ = writeln!(out, "<path class=\"{class}\" d=\"M{LEFT} {y:.1} H{right:.1}\"/>");
        };
        for (at, word) in &y.ticks {
            let at = y.place(*at);
            line(out, "grid", at);
            text(out, (LEFT - 7.0, at + 4.0), SMALL_AT_END, word);
        }
        if y.holds(0.0) && !y.log {
            line(out, "zero", y.place(0.0));
        }
        for (at, word) in &x.ticks {
            let at = x.place(*at);
            let _ = writeln!(out, "<path class=\"axis\" d=\"M{at:.1} {bottom:.1} v5\"/>");
            let (x, y) = (at + 4.0, bottom + 15.0);
            match aslant {
                false => text(out, (at, bottom + 17.0), "class=\"small\" text-anchor=\"middle\"", word),
                true => {
                    // It ends at the tick, and begins neither left of the drawing nor below it.
                    let room = (x / ASLANT.0).min((MAX_BELOW - 14.0) / ASLANT.1);
                    let turned = format!("{SMALL_AT_END} transform=\"rotate(-30 {x:.1} {y:.1})\"");
                    text(out, (x, y), &turned, &shortened(word, room));
                }
            }
        }
        let _ = writeln!(out, "<path class=\"axis\" d=\"M{LEFT} {top:.1} V{bottom:.1} H{right:.1}\"/>");
        text(out, ((LEFT + right) / 2.0, height - ROW - 8.0), "text-anchor=\"middle\"", self.x.label());
        let level = (top + bottom) / 2.0;
        let upwards = format!("text-anchor=\"middle\" transform=\"rotate(-90 16 {level:.1})\"");
        text(out, (16.0, level), &upwards, self.y.label());
    }
}

/// Width and height of a label of length 1 that rises by 30 degrees.
const ASLANT: (f64, f64) = (0.87, 0.5);
/// Most height that labels take below a plot.
const MAX_BELOW: f64 = 190.0;

/// A text without its middle, if it is wider than its room: what names share stands at the beginning.
fn shortened(text: &str, room: f64) -> String {
    let (n, fits) = (text.chars().count(), (room / CHARACTER).max(4.0) as usize);
    if n <= fits {
        return text.to_owned();
    }
    let head = (fits - 1) / 3;
    let tail = fits - 1 - head;
    let (head, tail): (String, String) = (text.chars().take(head).collect(), text.chars().skip(n - tail).collect());
    format!("{head}\u{2026}{tail}")
}

/// Lets charts share their axes.
pub(crate) fn share_axes(charts: &mut [Chart]) {
    let all: Vec<_> = charts.iter().flat_map(Chart::places).collect();
    for chart in charts {
        chart.series.push(Series::unnamed(0, vec![Mark::Reach(all.clone())]));
    }
}

/// Draws charts below one another as one SVG file.
pub(crate) fn svg(charts: &[Chart], simulated: bool) -> String {
    let plot = if charts.len() == 1 { HEIGHT } else { PANEL };
    let (mut inside, mut height) = (String::new(), 0.0);
    for chart in charts {
        let (panel, below) = chart.inside(plot, simulated);
        let _ = writeln!(inside, "<g transform=\"translate(0 {height:.0})\">\n{panel}</g>");
        height += below.round();
    }
    let titles: Vec<&str> = charts.iter().map(|chart| chart.title.as_str()).collect();
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"chart\" width=\"{WIDTH}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\">\n<title>{}</title>\n<desc>{}</desc>\n<style>{STYLE}</style>\n\
         <rect class=\"paper\" width=\"{WIDTH}\" height=\"{height:.0}\"/>\n{inside}</svg>\n",
        escape(&titles.join("; ")),
        escape(charts.first().map_or("", |chart| &chart.about))
    )
}

/// Beginning of the heads of every table of the numbers of charts.
pub(crate) const NUMBERS: [&str; 4] = ["panel", "series", "mark", "tooltip"];

/// The numbers that charts draw, in full precision: a row for each number along y, a column for each axis with its unit.
pub(crate) fn csv(charts: &[Chart]) -> String {
    let labels = charts.iter().map(|chart| chart.x.label()).chain(charts.iter().map(|chart| chart.y.label()));
    let mut heads: Vec<&str> = labels.collect();
    heads.dedup();
    let mut rows = vec![NUMBERS.into_iter().chain(heads.iter().copied()).map(String::from).collect::<Vec<_>>()];
    for (chart, series) in charts.iter().flat_map(|chart| chart.series.iter().map(move |series| (chart, series))) {
        rows.extend(series.marks.iter().flat_map(Mark::numbers).map(|(mark, x, y, tooltip)| {
            let category = chart.x.categories().get(x.round() as usize);
            let cell = |head: &&str| match *head {
                head if head == chart.y.label() => y.to_string(),
                head if head == chart.x.label() => category.map_or_else(|| x.to_string(), Clone::clone),
                _ => String::new(),
            };
            let names = [&*chart.title, &*series.name, mark, &*tooltip].map(String::from);
            names.into_iter().chain(heads.iter().map(cell)).collect()
        }));
    }
    let mut table = csv::Writer::from_writer(Vec::new());
    // Nothing fails in memory.
    let _ = rows.iter().try_for_each(|row| table.write_record(row));
    String::from_utf8(table.into_inner().unwrap_or_default()).unwrap_or_default()
}

fn draw_mark(out: &mut String, mark: &Mark, colour: usize, x: &axis::Scale, y: &axis::Scale) {
    let _ = match mark {
        Mark::Line(points) => {
            let path = points.iter().map(|(a, b)| format!("{:.1} {:.1}", x.place(*a), y.place(*b)));
            let path = path.collect::<Vec<_>>().join(" L");
            writeln!(out, "<path class=\"line c{colour}\" d=\"M{path}\"/>")
        }
        Mark::Band(points) => {
            let upper = points.iter().map(|(a, _, b)| (a, b));
            let lower = points.iter().rev().map(|(a, b, _)| (a, b));
            let path = upper.chain(lower).map(|(a, b)| format!("{:.1} {:.1}", x.place(*a), y.place(*b)));
            let path = path.collect::<Vec<_>>().join(" L");
            writeln!(out, "<path class=\"band c{colour}\" d=\"M{path} Z\"/>")
        }
        Mark::Dots(points) => {
            for (a, b, tip) in points {
                let (cx, cy, tip) = (x.place(*a), y.place(*b), escape(tip));
                let _ = writeln!(
                    out,
                    "<circle class=\"dot c{colour}\" cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"3\"><title>{tip}</title></circle>"
                );
            }
            Ok(())
        }
        Mark::Reach(_) => Ok(()),
        Mark::Box(at, width, tukey) => {
            let (left, right, middle) = (x.place(at - width), x.place(at + width), x.place(*at));
            let [low, high] = tukey.whiskers.map(|v| y.place(v));
            let [q1, q3] = tukey.quartiles.map(|v| y.place(v));
            let (median, cap) = (y.place(tukey.median), (right - left) * 0.25);
            let _ = writeln!(
                out,
                "<g><title>n = {}, median {}, quartiles {} and {}</title><path class=\"line whisker c{colour}\" \
                 d=\"M{middle:.1} {low:.1} V{q1:.1} M{middle:.1} {q3:.1} V{high:.1} M{:.1} {low:.1} h{:.1} M{:.1} {high:.1} \
                 h{:.1}\"/><rect class=\"box c{colour}\" x=\"{left:.1}\" y=\"{q3:.1}\" width=\"{:.1}\" \
                 height=\"{:.1}\"/><path class=\"line whisker c{colour}\" style=\"stroke-width: 2.4\" d=\"M{left:.1} \
                 {median:.1} H{right:.1}\"/></g>",
                tukey.values.len(),
                crate::format::number(tukey.median),
                crate::format::number(tukey.quartiles[0]),
                crate::format::number(tukey.quartiles[1]),
                middle - cap,
                2.0 * cap,
                middle - cap,
                2.0 * cap,
                right - left,
                (q1 - q3).max(0.5),
            );
            for (k, value) in tukey.drawn().enumerate() {
                // Spread sideways by a fixed pattern, so that equal values can be seen.
                let aside = ((k * 7) % 11) as f64 / 10.0 - 0.5;
                let (cx, cy) = (middle + aside * (right - left) * 0.5, y.place(value));
                let _ = writeln!(out, "<circle class=\"dot c{colour}\" cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"2\"/>");
            }
            Ok(())
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_shows_few_values_and_of_many_those_beyond_the_whiskers() {
        let few = Tukey::of(&[1.0, 2.0, 3.0, 4.0, 100.0]).unwrap();
        assert_eq!((few.median, few.quartiles, few.whiskers), (3.0, [2.0, 4.0], [1.0, 4.0]));
        assert_eq!(few.drawn().count(), 5);
        let mut many: Vec<f64> = (0..100).map(f64::from).collect();
        many.push(1000.0);
        let many = Tukey::of(&many).unwrap();
        assert_eq!(many.drawn().collect::<Vec<_>>(), [1000.0]);
        assert_eq!(Tukey::of(&[]), None);
        let one = Tukey::of(&[2.0]).unwrap();
        assert_eq!((one.median, one.whiskers), (2.0, [2.0, 2.0]));
    }

    #[test]
    fn no_label_begins_left_of_the_drawing_or_ends_right_of_it() {
        let long = |k: usize| {
            format!("icp = icp.a_kind_with_a_very_long_name_of_its_own_{k}, noise = 0.0{k}, bone = left femur {k}")
        };
        let chart = Chart {
            title: long(0).repeat(2),
            about: String::new(),
            x: Axis::Categories { label: "setting".into(), names: (0..6).map(long).collect() },
            y: Axis::Linear("TRE (mm)".into()),
            series: vec![Series {
                name: long(1).repeat(2),
                colour: 0,
                marks: vec![Mark::Line(vec![(0.0, 0.0), (5.0, 1.0)])],
            }],
            note: String::new(),
        };
        let svg = svg(&[chart], true);
        let read = roxmltree::Document::parse(&svg).unwrap();
        let mut n_aslant = 0;
        for node in read.descendants().filter(|node| node.has_tag_name("text")) {
            let x: f64 = node.attribute("x").unwrap().parse().unwrap();
            let width = node.text().unwrap_or_default().chars().count() as f64 * CHARACTER;
            match node.attribute("transform") {
                Some(turned) if turned.starts_with("rotate(-30") => {
                    n_aslant += 1;
                    assert!(x - width * ASLANT.0 >= -CHARACTER, "{:?} begins at {}", node.text(), x - width * ASLANT.0);
                }
                Some(_) => {}
                None if node.attribute("text-anchor").is_none() && node.attribute("class").is_none() => {
                    assert!(x + width <= WIDTH, "{:?} ends at {}", node.text(), x + width);
                }
                None => {}
            }
        }
        assert_eq!(n_aslant, 6);
        assert_eq!(shortened("icp.point_to_plane, 0.05", 8.0 * CHARACTER), "ic\u{2026} 0.05".to_owned());
    }

    #[test]
    fn a_table_of_charts_has_every_number_that_is_drawn_under_the_label_of_its_axis() {
        let chart = |title: &str, x: Axis, marks: Vec<Mark>| Chart {
            title: title.into(),
            about: String::new(),
            x,
            y: Axis::Linear("TRE (mm)".into()),
            series: vec![Series { name: "a, \"b\"".into(), colour: 0, marks }],
            note: String::new(),
        };
        let names = Axis::Categories { label: "axis".into(), names: vec!["x".into(), "z".into()] };
        let values: Vec<f64> = (0..30).map(f64::from).chain([1000.0]).collect();
        let lines = vec![
            Mark::Band(vec![(0.1, 0.2, 1.0 / 3.0)]),
            Mark::Line(vec![(1e-7, -2.0)]),
            Mark::Dots(vec![(2.0, 5.0, "run 3".into())]),
            Mark::Reach(vec![(9.0, 9.0)]),
        ];
        let charts = [
            chart("one", names, vec![Mark::Box(1.2, 0.3, Tukey::of(&values).unwrap())]),
            chart("two", Axis::Log("noise (mm)".into()), lines),
        ];
        let expected = "panel,series,mark,tooltip,axis,noise (mm),TRE (mm)\n\
                        one,\"a, \"\"b\"\"\",lower whisker,n = 31,z,,0\n\
                        one,\"a, \"\"b\"\"\",quartile 1,n = 31,z,,7.5\n\
                        one,\"a, \"\"b\"\"\",median,n = 31,z,,15\n\
                        one,\"a, \"\"b\"\"\",quartile 3,n = 31,z,,22.5\n\
                        one,\"a, \"\"b\"\"\",upper whisker,n = 31,z,,29\n\
                        one,\"a, \"\"b\"\"\",dot,,z,,1000\n\
                        two,\"a, \"\"b\"\"\",lower bound,,,0.1,0.2\n\
                        two,\"a, \"\"b\"\"\",upper bound,,,0.1,0.3333333333333333\n\
                        two,\"a, \"\"b\"\"\",line,,,0.0000001,-2\n\
                        two,\"a, \"\"b\"\"\",dot,run 3,,2,5\n";
        assert_eq!(csv(&charts), expected);
    }

    #[test]
    fn a_chart_is_sound_markup_and_says_what_it_is() {
        let chart = Chart {
            title: "a < b & c".into(),
            about: "\"boxes\"".into(),
            x: Axis::Categories { label: "setting".into(), names: vec!["a".into(), "<b>".into()] },
            y: Axis::Linear("TRE (mm)".into()),
            series: vec![Series {
                name: "x".into(),
                colour: 0,
                marks: vec![
                    Mark::Box(0.0, 0.3, Tukey::of(&[0.5, -0.2, 0.1]).unwrap()),
                    Mark::Dots(vec![(1.0, 0.4, "run 3".into())]),
                    Mark::Line(vec![(0.0, 0.0), (1.0, 1.0)]),
                    Mark::Band(vec![(0.0, 0.0, 0.2), (1.0, 0.1, 0.3)]),
                ],
            }],
            note: String::new(),
        };
        let svg = svg(&[chart], true);
        let read = roxmltree::Document::parse(&svg).unwrap();
        let words: Vec<_> = read.descendants().filter_map(|node| node.text()).collect();
        for word in ["a < b & c", "TRE (mm)", "setting", "<b>", "SIMULATED \u{b7} research use only"] {
            assert!(words.contains(&word), "{word} is missing in {words:?}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }
}
