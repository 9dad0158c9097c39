use super::{schema::Files, wires};
use crate::{fault::Fault, plugin::Known};

/// The state of one check: the known kinds, and the faults found so far.
pub(super) struct Check<'r> {
    pub(super) known: &'r Known,
    pub(super) files: Files,
    pub(super) names: wires::Names,
    pub(super) faults: Vec<Fault>,
}

impl<'r> Check<'r> {
    pub(super) fn new(known: &'r Known, files: Files, mut faults: Vec<Fault>) -> Self {
        faults.extend(known.faults());
        Self { known, files, names: wires::Names::default(), faults }
    }
}
