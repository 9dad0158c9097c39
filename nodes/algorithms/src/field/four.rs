//! Four `f32` at once.
//!
//! parry's vector library keeps them in one register by name (SSE2 on x86-64, NEON on ARM). Left to itself, the compiler
//! takes arrays apart again where only some of the four are asked for in the end, which costs a look-up a third of its
//! speed. Sums and products alone, so every machine gives the same bits.

use parry3d_f64::glamx::Vec4;

/// A node, or what is made of nodes.
#[derive(Clone, Copy)]
pub(super) struct Four(Vec4);

impl Four {
    #[inline(always)]
    pub(super) fn new(values: [f32; 4]) -> Self {
        Self(Vec4::from_array(values))
    }

    #[inline(always)]
    pub(super) fn values(self) -> [f32; 4] {
        self.0.to_array()
    }

    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }

    #[inline(always)]
    pub(super) fn minus(self, other: Self) -> Self {
        Self(self.0 - other.0)
    }

    #[inline(always)]
    pub(super) fn times(self, factor: f32) -> Self {
        Self(self.0 * factor)
    }

    /// This, and `share` of the way `rise` on.
    #[inline(always)]
    pub(super) fn on(self, rise: Self, share: f32) -> Self {
        self.plus(rise.times(share))
    }
}
