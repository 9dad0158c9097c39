use super::{Fault, Severity, SourceText, Span};
use annotate_snippets::{Annotation, AnnotationKind, Group, Level, Renderer, Snippet};
use std::sync::Arc;

/// Renders one fault in the style of rustc.
pub(super) fn render(fault: &Fault, colour: bool) -> String {
    let level = match fault.severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let mut group = Group::with_title(level.primary_title(fault.message.as_str()));
    for snippet in snippets(fault) {
        group = group.element(snippet);
    }
    for note in &fault.notes {
        group = group.element(Level::NOTE.message(note.as_str()));
    }
    for help in &fault.help {
        group = group.element(Level::HELP.message(help.as_str()));
    }
    let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
    renderer.render(&[group])
}

/// A part of a text, what is said of it, and whether it is the fault.
type Place<'a> = (&'a Span, &'a str, AnnotationKind);

/// One snippet per text; the text of the fault itself comes first.
fn snippets(fault: &Fault) -> Vec<Snippet<'_, Annotation<'_>>> {
    let places = fault.at.iter().map(|place| (place, AnnotationKind::Primary));
    let places = places.chain(fault.also.iter().map(|place| (place, AnnotationKind::Context)));
    let mut texts: Vec<(&Arc<SourceText>, Vec<Place<'_>>)> = Vec::new();
    for ((span, label), kind) in places {
        match texts.iter_mut().find(|(source, _)| Arc::ptr_eq(source, &span.source)) {
            Some((_, places)) => places.push((span, label.as_str(), kind)),
            None => texts.push((&span.source, vec![(span, label.as_str(), kind)])),
        }
    }
    texts.into_iter().map(|(source, places)| snippet(source, places)).collect()
}

/// The lines of a text that are shown. Each fault of a large graph would copy all of them.
fn snippet<'a>(source: &SourceText, places: Vec<Place<'a>>) -> Snippet<'a, Annotation<'a>> {
    let ranges = places.iter().map(|(span, ..)| span.range.clone());
    let (from, to) = (ranges.clone().map(|range| range.start).min(), ranges.map(|range| range.end).max());
    let (first_line, lines) = source.lines(from.unwrap_or(0)..to.unwrap_or(0));
    let annotations: Vec<_> = places
        .into_iter()
        .map(|(span, label, kind)| kind.span(span.range.start - lines.start..span.range.end - lines.start).label(label))
        .collect();
    let path = source.name.display().to_string();
    Snippet::source(source.text[lines].to_owned()).line_start(first_line).path(path).annotations(annotations)
}
