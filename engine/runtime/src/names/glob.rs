//! Patterns over names.

/// Whether a wire's name matches a pattern: `*` matches any characters, `?` any single one.
pub fn fits(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<_>, Vec<_>) = (pattern.chars().collect(), name.chars().collect());
    let (mut p, mut n) = (0, 0);
    // Where to resume if the characters after the last star do not match.
    let mut retry: Option<(usize, usize)> = None;
    while n < name.len() {
        if pattern.get(p) == Some(&'*') {
            retry = Some((p, n));
            p += 1;
        } else if pattern.get(p).is_some_and(|&c| c == '?' || c == name[n]) {
            (p, n) = (p + 1, n + 1);
        } else if let Some((star, from)) = retry {
            retry = Some((star, from + 1));
            (p, n) = (star + 1, from + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|&c| c == '*')
}

#[cfg(test)]
mod tests {
    use super::fits;

    #[test]
    fn a_star_is_any_run_and_a_question_mark_any_one() {
        for (pattern, name, expected) in [
            ("icp.*", "icp.report", true),
            ("icp.*", "icp_2.report", false),
            ("*.report", "icp.report", true),
            ("*", "a.b", true),
            ("hole_?.point", "hole_2.point", true),
            ("hole_?.point", "hole_12.point", false),
            ("*a*b", "xaxbxb", true),
            ("icp", "icp.report", false),
            ("", "", true),
        ] {
            assert_eq!(fits(pattern, name), expected, "{pattern} on {name}");
        }
    }
}
