use crate::{Emission, OutputPorts, Outputs};
use schemars::JsonSchema;
use std::marker::PhantomData;

/// The `Outputs` of a source whose ports the graph declares; `P` are the parameters of a port.
///
/// Ports are numbered as in [`crate::Context::declared`]; those without an answer stay silent.
pub struct Declared<P> {
    answers: Vec<(usize, Emission)>,
    params: PhantomData<P>,
}

impl<P> Declared<P> {
    /// An answer on one port.
    pub fn one(port: usize, emission: Emission) -> Self {
        Self { answers: vec![(port, emission)], params: PhantomData }
    }

    /// Adds an answer on another port.
    pub fn and(mut self, port: usize, emission: Emission) -> Self {
        self.answers.push((port, emission));
        self
    }
}

impl<P: JsonSchema + Send> Outputs for Declared<P> {
    fn ports() -> OutputPorts {
        OutputPorts::Declared { schema: schemars::schema_for!(P).to_value() }
    }

    fn put(self, out: &mut [Emission]) {
        for (port, emission) in self.answers {
            out[port] = emission;
        }
    }
}
