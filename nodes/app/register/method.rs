//! The methods of a registration: the kinds `icp.*`, or a kind of a plugin.

use super::RegisterRequest;
use crate::app::{error::UsageError, program::registry};
use anyhow::Result;
use osteoflow_engine::plugin::Kinds;
use osteoflow_node::Kind;

/// Ports that a kind needs to register.
const INPUTS: [&str; 3] = ["source", "target", "init"];
/// The output with the registration.
pub(super) const POSE: &str = "t_target_source";
/// The output with the report, which a kind of a plugin may lack.
pub(super) const REPORT: &str = "report";

/// The built-in methods: what follows `icp.`, and a line about it.
pub(super) const BUILT_IN: [(&str, &str); 6] = [
    ("point_to_plane", "distances along the target's normals: few steps; the first choice"),
    ("point_to_point", "distances between points: for targets without normals; slow along a bone"),
    ("symmetric", "distances along the mean normal of both points: converges from farther away on curved bone"),
    ("generalized", "distances between flat patches at both points (GICP), for comparisons"),
    (
        "point_to_mesh",
        "distances to the target's triangles: no sampling error, several times the cost; needs a surface",
    ),
    ("published", "point-to-point that stops as in the paper, which can be read in several ways (--set reading=..)"),
];

impl RegisterRequest {
    /// Whether a built-in kind registers.
    pub(crate) fn is_built_in(&self) -> bool {
        self.plugins.files.is_empty()
    }

    /// The parameters with which the method takes all its steps on all points.
    pub(super) fn fixed(&self) -> &'static [(&'static str, &'static str)] {
        match &*self.method {
            _ if !self.is_built_in() => &[],
            "published" => &[("reading", "\"iterations\"")],
            _ => &[("stop_step_mm", "0.0"), ("stop_step_rad", "0.0"), ("stop_residual_mm", "0.0"), ("levels", "[]")],
        }
    }

    /// The kinds there are, and the name of the one that registers.
    ///
    /// # Errors
    /// [`UsageError`] if a library is refused, or has no registration, or several of which none is named.
    pub(super) fn kind(&self) -> Result<(Kinds, String)> {
        if self.is_built_in() {
            if !BUILT_IN.iter().any(|(known, _)| *known == self.method) {
                let known = BUILT_IN.map(|(known, _)| known).join(", ");
                usage!("method \"{}\" is none of {known}", self.method);
            }
            return Ok((Kinds::from(&registry()), format!("icp.{}", self.method)));
        }
        let kinds = self.plugins.kinds_apart()?;
        let known = kinds.known();
        if let Some(refused) = known.refused.iter().find(|refused| refused.is_asked()) {
            usage!("{}: {}", refused.path.display(), refused.why);
        }
        let of_plugins = known.registry.kinds().filter(|kind| known.of_kind(kind.description.kind).is_some());
        let names = of_plugins.filter(|kind| match &self.kind {
            Some(name) => kind.description.kind == name.as_str(),
            None => registers(kind),
        });
        let names: Vec<&str> = names.map(|kind| kind.description.kind).collect();
        let message = match (&names[..], &self.kind) {
            ([one], _) => {
                let one = (*one).to_owned();
                return Ok((kinds, one));
            }
            ([], Some(name)) => format!("--kind: the plugin has no kind \"{name}\"; osteoflow inspect lists its kinds"),
            ([], None) => format!(
                "--plugin: no kind of it is a registration, which has the inputs {} and the output {POSE}",
                INPUTS.join(", ")
            ),
            _ => format!("--plugin: several kinds of it register: {}; name one with --kind", names.join(", ")),
        };
        Err(UsageError(message).into())
    }
}

fn registers(kind: &Kind) -> bool {
    let has = |name: &str| kind.description.inputs.iter().any(|port| port.name == name);
    INPUTS.iter().all(|name| has(name)) && has_output(kind, POSE)
}

/// Whether a kind has an output of this name.
pub(super) fn has_output(kind: &Kind, name: &str) -> bool {
    kind.description.outputs.fixed().iter().any(|port| port.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_method_is_a_kind_that_registers_and_the_other_way_round() {
        let registry = registry();
        let kinds: Vec<_> = registry.kinds().filter(|kind| kind.description.kind.starts_with("icp.")).collect();
        assert_eq!(kinds.len(), BUILT_IN.len());
        for (name, _) in BUILT_IN {
            let kind = registry.kind(&format!("icp.{name}")).unwrap_or_else(|| panic!("no kind icp.{name}"));
            assert!(registers(kind) && has_output(kind, REPORT), "{name}");
        }
    }
}
