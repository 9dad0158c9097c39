//! Nodes as the engine holds them: without their types.

use crate::{Context, Emission, Inputs, Joined, Node, NodeError, Outputs, Source};

/// A node of any kind.
pub trait AnyNode: Send {
    /// One firing: what [`Node::process`] answers, one emission for each port.
    ///
    /// # Errors
    /// What the node says.
    fn fire(&mut self, joined: Joined, n_ports: usize, ctx: &mut Context) -> Result<Vec<Emission>, NodeError>;
}

/// A source of any kind.
pub trait AnySource: Send {
    /// What [`Source::next`] answers, one emission for each port.
    ///
    /// # Errors
    /// What the source says.
    fn next(&mut self, n_ports: usize, ctx: &mut Context) -> Result<Option<Vec<Emission>>, NodeError>;
}

/// A built node or source.
pub enum Built {
    /// Fires when its inputs join.
    Node(Box<dyn AnyNode>),
    /// Answers by itself.
    Source(Box<dyn AnySource>),
}

pub(crate) struct Erased<N>(pub(crate) N);

impl<N: Node> AnyNode for Erased<N> {
    fn fire(&mut self, joined: Joined, n_ports: usize, ctx: &mut Context) -> Result<Vec<Emission>, NodeError> {
        let inputs = N::Inputs::take(joined)?;
        Ok(self.0.process(inputs, ctx)?.put(n_ports))
    }
}

impl<S: Source> AnySource for Erased<S> {
    fn next(&mut self, n_ports: usize, ctx: &mut Context) -> Result<Option<Vec<Emission>>, NodeError> {
        Ok(self.0.next(ctx)?.map(|out| out.put(n_ports)))
    }
}
