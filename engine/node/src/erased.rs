//! Nodes as the engine holds them: without their types.

use crate::{Context, Emission, Inputs, Joined, Node, NodeError, Outputs, Source};

/// A node of any kind.
pub trait AnyNode: Send {
    /// One firing: puts what [`Node::process`] answers into `out`, which holds a silent emission for each port.
    ///
    /// # Errors
    /// What the node says.
    fn fire(&mut self, joined: &Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError>;
}

/// A source of any kind.
pub trait AnySource: Send {
    /// Puts what [`Source::next`] answers into `out`, which holds a silent emission for each port; `false` at the end.
    ///
    /// # Errors
    /// What the source says.
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError>;
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
    fn fire(&mut self, joined: &Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError> {
        let inputs = N::Inputs::take(joined)?;
        self.0.process(inputs, ctx)?.put(out);
        Ok(())
    }
}

impl<S: Source> AnySource for Erased<S> {
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError> {
        Ok(self.0.next(ctx)?.map(|answer| answer.put(out)).is_some())
    }
}
