//! Surfaces of bone and phantom, and the CT surface prepared for registration.

pub mod any;
pub mod ct;
pub mod prepare;
pub mod simulated;
pub mod simulated_phantom;
