//! The page: sections, figures, tables and views in one file that needs no network.

use crate::{
    cell::Cell,
    chart::{self, Chart, RESEARCH},
    format::number,
    modules,
    paths::Paths,
    scene::Scene,
    summary::{TableRow, under_heads},
};
use osteoflow_draw::xml::escape;
use osteoflow_engine::run::{Answer, Verdict};
use serde_json::{Map, Value as Json, json};
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");

/// Prefix of the file names of views.
pub(crate) const VIEW: &str = "view-";

/// A figure, to be written as a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Its name, without extension.
    pub name: String,
    /// The SVG text.
    pub svg: String,
    /// The numbers of a chart as CSV; empty for other drawings.
    pub csv: String,
}

/// Number of assumptions that are shown at once, as by `osteoflow run`.
const N_ASSUMED: usize = 3;

/// The frame of a view.
struct View {
    aspect: f64,
    legend: String,
    /// What there is where no view can be drawn.
    instead: String,
    /// Whether it has the views of the live page, and the verdict.
    has_sides: bool,
}

/// Buttons of a view: key, title and word.
const BUTTONS: [(&str, &str, &str); 3] =
    [("+", "nearer (+)", "+"), ("-", "farther (-)", "\u{2212}"), ("0", "as at first (0)", "reset")];
/// Those of the view that the live page has, too.
const SIDES: [(&str, &str, &str); 5] = [
    ("1", "key 1", "scanned side"),
    ("2", "key 2", "lateral"),
    ("3", "key 3", "anterior"),
    ("4", "key 4", "along the bone"),
    ("g", "key g", "see-through bone"),
];
const HOW: &str =
    "Drag to turn, Shift and drag to move, click and scroll to zoom; arrow keys, + and \u{2212} do the same.";

/// A page under construction.
#[derive(Debug, Default)]
pub(crate) struct Page {
    title: String,
    simulated: bool,
    body: String,
    contents: Vec<(String, String)>,
    n_figures: usize,
    n_tables: usize,
    /// What the views show.
    views: Vec<Json>,
    /// Data that several views share, by name.
    shared: Map<String, Json>,
    /// The verdict by which views draw planes.
    judged: Json,
    pub(crate) figures: Vec<Figure>,
    /// What the page does not show.
    paths: Paths,
}

impl Page {
    pub(crate) fn new(title: &str, simulated: bool) -> Self {
        Self { title: title.into(), simulated, ..Self::default() }
    }

    /// Shows these paths by their names alone.
    pub(crate) fn hide(&mut self, paths: Paths) {
        self.paths = paths;
    }

    fn words(&self) -> &'static str {
        match self.simulated {
            true => "<span class=\"mark\">SIMULATED</span> research use only",
            false => "research use only",
        }
    }

    pub(crate) fn simulated(&self) -> bool {
        self.simulated
    }

    /// Begins a section.
    pub(crate) fn section(&mut self, title: &str) {
        let id: String =
            title.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' }).collect();
        let _ = writeln!(self.body, "<h2 id=\"{id}\">{}</h2>", escape(title));
        self.contents.push((id, title.into()));
    }

    /// Sets the verdict by which the views draw planes, as in `results.json`.
    pub(crate) fn judge(&mut self, verdict: &Json) {
        self.judged = verdict.clone();
    }

    /// The verdict on the results: a shape and a colour for its answer, its reasons and what it assumes.
    pub(crate) fn verdict(&mut self, verdict: &Verdict) {
        let answer = verdict.answer();
        // Readable without colours: a tick in a circle, an exclamation mark in a triangle, a cross in an octagon, as on the live page.
        let shape = match answer {
            Answer::Trusted => "<circle cx=\"12\" cy=\"12\" r=\"10\"/><path d=\"M7 12.5l3.5 3.5L17 8.5\"/>",
            Answer::Doubtful => "<path d=\"M12 2.5L22.5 21h-21z\"/><path d=\"M12 9v6M12 17.5v1\"/>",
            Answer::Refused => "<path d=\"M8 2h8l6 6v8l-6 6H8l-6-6V8z\"/><path d=\"M7.5 7.5l9 9M16.5 7.5l-9 9\"/>",
        };
        let name = answer.name();
        let mut against: Vec<_> = verdict.against().collect();
        let mut sentence = verdict.sentence();
        // A sentence that is made of the first reason gives way to the reason with its remedy, as on the live page.
        if let Some(first) = verdict.first().filter(|first| sentence.starts_with(&first.reason)) {
            against.retain(|reason| !std::ptr::eq(*reason, first));
            sentence = first.to_string();
        }
        let _ = writeln!(
            self.body,
            "<section class=\"verdict {name}\" aria-label=\"verdict\"><p class=\"answer\"><svg viewBox=\"0 0 24 24\" \
             role=\"img\" aria-label=\"{name}\">{shape}</svg><b>{name}</b> {}</p>",
            escape(&sentence)
        );
        if !against.is_empty() {
            self.body.push_str("<ul>");
            for reason in against {
                let remedy = match reason.remedy.as_str() {
                    "" => String::new(),
                    remedy => format!("<br><span class=\"remedy\">{}</span>", escape(remedy)),
                };
                let (rule, text) = (escape(&reason.rule.replace('_', " ")), escape(&reason.reason));
                let _ = write!(self.body, "<li><b>{rule}</b> ({}): {text}{remedy}</li>", reason.answer);
            }
            self.body.push_str("</ul>\n");
        }
        let assumed: Vec<_> = verdict.assumptions().map(escape).collect();
        if !assumed.is_empty() {
            let list = |all: &[String]| all.iter().map(|text| format!("<li>{text}</li>")).collect::<String>();
            // The most critical come first.
            let (first, rest) = assumed.split_at(assumed.len().min(N_ASSUMED));
            let _ = write!(self.body, "<p class=\"assumed\">Assumed:</p><ul class=\"assumed\">{}</ul>", list(first));
            if !rest.is_empty() {
                let n = rest.len();
                let _ = write!(
                    self.body,
                    "<details><summary>{n} more</summary><ul class=\"assumed\">{}</ul></details>",
                    list(rest)
                );
            }
            self.body.push('\n');
        }
        self.body.push_str("</section>\n");
    }

    /// What is wrong with the files that the page is made from.
    pub(crate) fn fault(&mut self, what: &str) {
        let _ = writeln!(self.body, "<p class=\"banner\"><b>NOT SOUND.</b> {}</p>", escape(what));
    }

    /// A paragraph of plain text.
    pub(crate) fn text(&mut self, words: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escape(words));
    }

    /// A notice that something cannot be shown, with the reason.
    pub(crate) fn missing(&mut self, what: &str, why: &str) {
        let why = escape(why.trim_end_matches('.'));
        let _ = writeln!(self.body, "<p class=\"missing\"><b>{}</b> is not shown: {why}.</p>", escape(what));
    }

    /// Preformatted text in a collapsed box.
    pub(crate) fn folded(&mut self, title: &str, text: &str) {
        let (title, text) = (escape(title), escape(text));
        let _ = writeln!(self.body, "<details><summary>{title}</summary><pre>{text}</pre></details>");
    }

    /// Preformatted text.
    pub(crate) fn code(&mut self, text: &str) {
        let _ = writeln!(self.body, "<pre>{}</pre>", escape(text));
    }

    /// A table in a collapsed box.
    pub(crate) fn folded_table(&mut self, title: &str, caption: &str, head: &[&str], rows: &[Vec<Cell>]) {
        let _ = writeln!(self.body, "<details><summary>{}</summary>", escape(title));
        self.table(caption, head, rows);
        self.body.push_str("</details>\n");
    }

    /// A drawing, which is also written as a file.
    pub(crate) fn figure(&mut self, name: &str, svg: String, caption: &str) {
        self.n_figures += 1;
        let inside = within_page(&svg);
        let _ = writeln!(
            self.body,
            "<figure id=\"figure-{}\"><div class=\"drawing\">{inside}</div><figcaption><b>Figure {}.</b> {} <span \
             class=\"words\">{}</span></figcaption></figure>",
            self.n_figures,
            self.n_figures,
            escape(caption),
            self.words()
        );
        self.figures.push(Figure { name: name.into(), svg, csv: String::new() });
    }

    /// Charts below one another as one figure, which is also written as a file, as are their numbers.
    pub(crate) fn charts(&mut self, name: &str, charts: &[Chart], caption: &str) {
        self.figure(name, chart::svg(charts, self.simulated), caption);
        // Paths are hidden as they stand in HTML.
        let hidden = self.paths.hidden(&escape(&chart::csv(charts)));
        let entities = [("&quot;", "\""), ("&lt;", "<"), ("&gt;", ">"), ("&amp;", "&")];
        let csv = entities.iter().fold(hidden, |csv, (entity, of)| csv.replace(entity, of));
        if let Some(figure) = self.figures.last_mut() {
            figure.csv = csv;
        }
    }

    /// Adds data that views share, once, and returns its name.
    pub(crate) fn share(&mut self, data: Json) -> String {
        if let Some((name, _)) = self.shared.iter().find(|(_, known)| **known == data) {
            return name.clone();
        }
        let name = self.shared.len().to_string();
        self.shared.insert(name.clone(), data);
        name
    }

    /// A view of a scene; a drawing from its initial viewpoint is also written as a file.
    pub(crate) fn view(&mut self, name: &str, scene: &Scene, caption: &str) {
        let name = format!("{VIEW}{name}");
        let instead = format!("figures/{name}.svg shows the view from one side.");
        let shown = View { aspect: scene.aspect, legend: scene.legend_html(), instead, has_sides: false };
        self.view_box(&shown, scene.json(), caption);
        self.figures.push(Figure { name, svg: scene.svg(caption, self.simulated), csv: String::new() });
    }

    /// What the live page shows of the run; `drawing` is its drawing on paper.
    pub(crate) fn picture(&mut self, picture: Json, drawing: Option<(&str, &Scene)>, legend: String, caption: &str) {
        let instead = match drawing {
            Some((name, _)) => format!("figures/{VIEW}{name}.svg shows the scan on the bone from one side."),
            None => "It has no drawing.".into(),
        };
        self.view_box(&View { aspect: 1.6, legend, instead, has_sides: true }, json!({ "picture": picture }), caption);
        if let Some((name, scene)) = drawing {
            let svg = scene.svg(caption, self.simulated);
            self.figures.push(Figure { name: format!("{VIEW}{name}"), svg, csv: String::new() });
        }
    }

    fn view_box(&mut self, view: &View, content: Json, caption: &str) {
        self.n_figures += 1;
        let (n, scene) = (self.n_figures, self.views.len());
        self.views.push(content);
        let button = |(key, title, word): &(&str, &str, &str)| {
            format!("<button type=\"button\" data-do=\"{key}\" title=\"{title}\">{word}</button>")
        };
        let sides = match view.has_sides {
            true => &SIDES[..],
            false => &[],
        };
        let buttons: String = sides.iter().chain(&BUTTONS).map(button).collect();
        let judged = if view.has_sides { "<div class=\"judged\"></div>" } else { "" };
        let (about, instead) = (escape(caption), escape(&view.instead));
        let _ = writeln!(
            self.body,
            "<figure id=\"figure-{n}\"><div class=\"view\" data-scene=\"{scene}\" style=\"aspect-ratio: {}\"><div \
             class=\"holder\" data-about=\"{about}\"></div><div class=\"bar\">{buttons}</div><div \
             class=\"scale\"><i></i><span></span></div><p class=\"fallback\" data-instead=\"{instead}\" hidden></p>\
             <noscript><p class=\"fallback\">The view needs JavaScript. {instead}</p></noscript></div>{judged}{}<details \
             class=\"layers\"><summary>Shown</summary><ul></ul></details><figcaption><b>Figure {n}.</b> {about} <span \
             class=\"how\">{HOW}</span> <span class=\"words\">{}</span></figcaption></figure>",
            view.aspect,
            view.legend,
            self.words(),
        );
    }

    /// A table with right-aligned numbers.
    pub(crate) fn table(&mut self, caption: &str, head: &[impl AsRef<str>], rows: &[Vec<Cell>]) {
        if rows.is_empty() {
            return;
        }
        self.n_tables += 1;
        let _ = write!(
            self.body,
            "<div class=\"wide\"><table><caption><b>Table {}.</b> {} <span class=\"words\">{}</span></caption><thead><tr>",
            self.n_tables,
            escape(caption),
            self.words()
        );
        for (k, word) in head.iter().enumerate() {
            let right = rows.iter().any(|row| matches!(row.get(k), Some(Cell::Number(_))));
            let class = if right { " class=\"n\"" } else { "" };
            let _ = write!(self.body, "<th scope=\"col\"{class}>{}</th>", self.cell(word.as_ref()));
        }
        self.body.push_str("</tr></thead><tbody>");
        for row in rows {
            self.body.push_str("<tr>");
            for cell in row {
                let _ = match cell {
                    Cell::Number(value) => {
                        write!(self.body, "<td class=\"n\" title=\"{value}\">{}</td>", number(*value))
                    }
                    Cell::Word(word) => write!(self.body, "<td>{}</td>", self.cell(word)),
                    Cell::Code(word) => write!(self.body, "<td><code>{}</code></td>", self.cell(word)),
                };
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</tbody></table></div>\n");
    }

    /// The text of a cell, whose words may be wrapped after dots, underscores and slashes, and after 16 letters. Paths are hidden
    /// before, as they are not found any more between these places.
    fn cell(&self, word: &str) -> String {
        let (mut out, mut n_letters, mut in_entity, mut previous) = (String::new(), 0, false, ' ');
        for c in self.paths.hidden(&escape(word)).chars() {
            out.push(c);
            in_entity = c == '&' || (in_entity && c != ';');
            n_letters = if c.is_whitespace() { 0 } else { n_letters + 1 };
            let separates = n_letters > 3 && "._/".contains(c) && !previous.is_ascii_digit();
            if !in_entity && (separates || n_letters >= 16 && !c.is_ascii_digit()) {
                out.push_str("<wbr>");
                n_letters = 0;
            }
            previous = c;
        }
        out
    }

    /// A table of rows with different columns.
    pub(crate) fn rows(&mut self, caption: &str, rows: &[TableRow]) {
        let (heads, cells) = under_heads(rows);
        self.table(caption, &heads, &cells);
    }

    /// Completes the page and returns it with its figures.
    pub(crate) fn finish(mut self, subtitle: &str) -> (String, Vec<Figure>) {
        self.body = self.paths.hidden(&self.body);
        self.figures.iter_mut().for_each(|figure| figure.svg = self.paths.hidden(&figure.svg));
        let title = escape(&self.title);
        let simulated = match self.simulated {
            true => "<p class=\"banner\"><b>SIMULATED.</b> What is registered here was computed, not measured.</p>",
            false => "",
        };
        let contents: String =
            self.contents.iter().map(|(id, title)| format!("<a href=\"#{id}\">{}</a> ", escape(title))).collect();
        let scripts = if self.views.is_empty() {
            String::new()
        } else {
            let data = json!({ "views": self.views, "shared": self.shared, "verdict": self.judged });
            let packed = |id: &str, text: &str| format!("<script type=\"text/plain\" id=\"{id}\">{text}</script>\n");
            let [modules, data] = [packed("modules", &modules::packed()), packed("data", &modules::pack(&data))];
            format!("{modules}{data}<script>\n{}</script>\n", modules::LOADER)
        };
        // Nothing may be fetched, whatever the page contains: its modules have addresses within it.
        let policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' blob:; img-src data:";
        let html = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta \
             http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\n<meta name=\"viewport\" \
             content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n<link \
             rel=\"icon\" href=\"data:,\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<header>\n\
             <h1>{title}</h1>\n<p class=\"subtitle\">{}</p>\n{simulated}<p class=\"research\">Research software, not a \
             medical device: {RESEARCH}.</p>\n<nav aria-label=\"sections\">{contents}</nav>\n</header>\n<main>\n{}</main>\n\
             {scripts}</body>\n</html>\n",
            escape(subtitle),
            self.body
        );
        (html, self.figures)
    }
}

/// The drawing with its style rules limited to itself, as they would otherwise apply to the whole page.
fn within_page(svg: &str) -> String {
    match (svg.find("<style>"), svg.find("</style>")) {
        (Some(from), Some(to)) if from < to => {
            let class = if svg.contains("class=\"chart\"") { "chart" } else { "graph" };
            let rules = &svg[from + "<style>".len()..to];
            // Nested rules apply inside the outer selector only.
            let svg =
                format!("{}<style>.drawn-{class} {{ {rules} }}</style>{}", &svg[..from], &svg[to + "</style>".len()..]);
            format!("<div class=\"drawn-{class}\">{svg}</div>")
        }
        _ => svg.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn long_words_of_a_table_may_be_wrapped_and_neither_numbers_nor_entities_nor_short_words_nor_intervals() {
        let breakable = |text: &str| Page::default().cell(text);
        for whole in ["", "plane1", "mm", "12345.678", "point, mean", "\u{2212}0.112345\u{a0}to\u{a0}0.156789"] {
            assert_eq!(breakable(whole), whole);
        }
        assert_eq!(breakable("icp.point_to_plane"), "icp.<wbr>point_<wbr>to_plane");
        assert_eq!(breakable("Donaudampfschifffahrt"), "Donaudampfschiff<wbr>fahrt");
        assert_eq!(breakable("Donaudampfsch&fahrt"), "Donaudampfsch&amp;<wbr>fahrt");
        assert_eq!(breakable("0123456789abcdef0123"), "0123456789abcdef<wbr>0123");
    }

    #[test]
    fn a_path_in_a_table_is_hidden_though_it_may_be_wrapped() {
        let mut page = Page::new("", false);
        page.hide(Paths::of(
            &json!({ "file": "/home/jane_doe_1950/her_left_leg/scan.ply" }),
            std::path::Path::new("run"),
        ));
        let path = "/home/jane_doe_1950/her_left_leg/scan.ply";
        page.table(path, &[path, "b"], &[vec![Cell::word(path), Cell::Code(format!("read {path}"))]]);
        let (html, _) = page.finish("");
        let text = html.replace("<wbr>", "");
        assert!(text.contains("<td>scan.ply</td><td><code>read scan.ply</code>"), "{text}");
        assert!(!text.contains("jane_doe") && !text.contains("left_leg"), "{text}");
    }

    #[test]
    fn a_path_in_the_table_of_a_chart_is_hidden_and_what_is_escaped_in_html_stands_as_it_is() {
        let mut page = Page::new("", false);
        page.hide(Paths::of(&json!({ "file": "/home/jane & john/scan.ply" }), std::path::Path::new("run")));
        page.charts(
            "a",
            &[Chart {
                title: "a < b & \"c\" &lt;".into(),
                about: String::new(),
                x: chart::Axis::Categories { label: "file".into(), names: vec!["/home/jane & john/scan.ply".into()] },
                y: chart::Axis::Linear("TRE (mm)".into()),
                series: vec![chart::Series::unnamed(0, vec![chart::Mark::Line(vec![(0.0, 0.5)])])],
                note: String::new(),
            }],
            "",
        );
        let csv = &page.finish("").1[0].csv;
        assert_eq!(csv, "panel,series,mark,tooltip,file,TRE (mm)\n\"a < b & \"\"c\"\" &lt;\",,line,,scan.ply,0.5\n");
    }

    #[test]
    fn nothing_in_the_data_ends_its_script() {
        let mut page = Page::new("a <b>", true);
        page.picture(json!({ "x": "</script><script>alert(1)</script>" }), None, String::new(), "</script>");
        page.text("<img src=x>");
        let (html, _) = page.finish("");
        assert_eq!(html.matches("</script>").count(), 3, "the modules, the data and the loader");
        assert!(!html.contains("<img") && html.contains("a &lt;b&gt;"));
    }

    #[test]
    fn a_verdict_has_a_word_and_a_shape_for_its_answer_and_its_reasons_and_assumptions() {
        let mut shapes = Vec::new();
        for answer in Answer::ALL {
            let reason = json!({
                "rule": "landmark_order", "answer": answer.name(), "reason": "P1 < P2", "remedy": "aim again",
            });
            let verdict = json!({ "answer": answer.name(), "reasons": [reason], "assumptions": ["the bone is rigid"] });
            let mut page = Page::new("", false);
            page.verdict(&Verdict::read(&verdict).unwrap());
            let shown = page.body;
            let assumed = "Assumed:</p><ul class=\"assumed\"><li>the bone is rigid</li></ul>";
            assert!(shown.contains(&format!("<b>{answer}</b>")) && shown.contains(assumed), "{shown}");
            let told = ["P1 &lt; P2", "aim again"].map(|text| shown.matches(text).count());
            assert_eq!(told, [usize::from(answer > Answer::Trusted); 2], "{shown}");
            let shape = shown.split_once("<svg").and_then(|(_, rest)| rest.split_once("</svg>")).unwrap().0;
            shapes.push(shape.split_once("\">").unwrap().1.to_owned());
        }
        shapes.dedup();
        assert_eq!(shapes.len(), 3, "each answer has its own shape");
    }
}
