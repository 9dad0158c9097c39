//! Counts with their nouns.

/// `1 bone`, `3 bones`.
pub fn counted(n: usize, name: &str) -> String {
    match n {
        1 => format!("1 {name}"),
        n => format!("{n} {}", plural(name)),
    }
}

/// `bones` of `bone`, `studies` of `study`.
pub fn plural(name: &str) -> String {
    let ends = |ends: &[&str]| ends.iter().any(|end| name.ends_with(end));
    match name.strip_suffix('y') {
        Some(stem) if !ends(&["ay", "ey", "oy", "uy"]) => format!("{stem}ies"),
        _ if ends(&["s", "x", "z", "ch", "sh"]) => format!("{name}es"),
        _ => format!("{name}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_singular_and_several_are_plural() {
        assert_eq!(counted(1, "bone"), "1 bone");
        assert_eq!(counted(0, "bone"), "0 bones");
        assert_eq!(
            ["procedure", "study", "day", "batch"].map(|name| counted(3, name)),
            ["3 procedures", "3 studies", "3 days", "3 batches"]
        );
    }
}
