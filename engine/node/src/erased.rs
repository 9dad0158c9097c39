//! Type-erased nodes and sources, as the engine holds them.

use crate::{
    Context, DeclaredPort, Emission, Inputs, Joined, Node, NodeError, Outputs, Source, StampNs, traits::SILENT_AFTER,
};
use std::{path::PathBuf, time::Duration};

/// A node of any kind.
pub trait AnyNode: Send {
    /// One firing: writes the result of [`Node::process`] to `out`, which holds a silent emission per port.
    ///
    /// # Errors
    /// The error of the node.
    fn fire(&mut self, joined: &mut Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError>;
}

/// A source of any kind.
pub trait AnySource: Send {
    /// Writes the result of [`Source::next`] to `out`, which holds a silent emission per port; `false` at the end.
    ///
    /// # Errors
    /// The error of the source.
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError>;

    /// See [`Source::files`].
    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    /// See [`Source::is_timed`].
    fn is_timed(&self, _port: &DeclaredPort) -> bool {
        false
    }

    /// See [`Source::max_delay_ns`].
    fn max_delay_ns(&self) -> StampNs {
        0
    }

    /// See [`Source::silent_after`].
    fn silent_after(&self) -> Duration {
        SILENT_AFTER
    }
}

/// A built node or source.
pub enum Built {
    /// Fires when its inputs join.
    Node(Box<dyn AnyNode>),
    /// Produces items by itself.
    Source(Box<dyn AnySource>),
}

pub(crate) struct Erased<N>(pub(crate) N);

impl<N: Node> AnyNode for Erased<N> {
    fn fire(&mut self, joined: &mut Joined, out: &mut [Emission], ctx: &mut Context) -> Result<(), NodeError> {
        let inputs = N::Inputs::take(joined)?;
        self.0.process(inputs, ctx)?.put(out);
        Ok(())
    }
}

impl<S: Source> AnySource for Erased<S> {
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError> {
        Ok(self.0.next(ctx)?.map(|answer| answer.put(out)).is_some())
    }

    fn files(&self) -> Vec<PathBuf> {
        self.0.files()
    }

    fn is_timed(&self, port: &DeclaredPort) -> bool {
        self.0.is_timed(port)
    }

    fn max_delay_ns(&self) -> StampNs {
        self.0.max_delay_ns()
    }

    fn silent_after(&self) -> Duration {
        self.0.silent_after()
    }
}
