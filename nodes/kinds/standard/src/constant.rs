//! Sources of constants: each gives its items once, and ends.

use osteoflow_node::{Context, Describe, NodeError, Outputs, ParamError, Parameters, Source};
use std::path::PathBuf;

/// A source of one item on each output, which depend on its parameters and the run's seed alone.
pub(crate) trait Constant: Describe + 'static {
    /// The kind of the source.
    const KIND: &'static str;
    /// The parameters.
    type Params: Parameters + Send;
    /// The output ports.
    type Outputs: Outputs;

    /// Refuses parameters that do not fit together.
    ///
    /// # Errors
    /// As [`Source::new`].
    fn check(_params: &Self::Params) -> Result<(), ParamError> {
        Ok(())
    }

    /// As [`Source::files`].
    fn files(_params: &Self::Params) -> Vec<PathBuf> {
        Vec::new()
    }

    /// Reads or computes the items.
    ///
    /// # Errors
    /// As [`Source::next`].
    fn read(params: &Self::Params, ctx: &mut Context) -> Result<Self::Outputs, NodeError>;
}

/// The source of constants.
pub(crate) struct Once<C: Constant> {
    params: C::Params,
    is_read: bool,
}

impl<C: Constant> Describe for Once<C> {
    const DOC: &'static str = C::DOC;
    const EXAMPLE: &'static str = C::EXAMPLE;
    const LITERATURE: &'static [&'static str] = C::LITERATURE;
}

impl<C: Constant> Source for Once<C> {
    const KIND: &'static str = C::KIND;
    const CONSTANT: bool = true;
    type Params = C::Params;
    type Outputs = C::Outputs;

    fn new(params: C::Params) -> Result<Self, ParamError> {
        C::check(&params).map(|()| Self { params, is_read: false })
    }

    fn files(&self) -> Vec<PathBuf> {
        C::files(&self.params)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<C::Outputs>, NodeError> {
        if std::mem::replace(&mut self.is_read, true) {
            return Ok(None);
        }
        C::read(&self.params, ctx).map(Some)
    }
}
