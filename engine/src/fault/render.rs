use super::{Fault, Severity, Span};
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

/// One snippet per text; the text of the fault itself comes first.
fn snippets(fault: &Fault) -> Vec<Snippet<'_, Annotation<'_>>> {
    let places = fault.at.iter().map(|place| (place, AnnotationKind::Primary));
    let places = places.chain(fault.also.iter().map(|place| (place, AnnotationKind::Context)));
    let mut texts: Vec<(&Span, Vec<Annotation<'_>>)> = Vec::new();
    for ((span, label), kind) in places {
        let annotation = kind.span(span.range.clone()).label(label.as_str());
        match texts.iter_mut().find(|(first, _)| Arc::ptr_eq(&first.source, &span.source)) {
            Some((_, annotations)) => annotations.push(annotation),
            None => texts.push((span, vec![annotation])),
        }
    }
    let snippet = |(span, annotations): (&Span, Vec<_>)| {
        let path = span.source.name.display().to_string();
        Snippet::source(span.source.text.clone()).path(path).annotations(annotations)
    };
    texts.into_iter().map(snippet).collect()
}
