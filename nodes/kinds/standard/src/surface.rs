//! Surfaces of bone and phantom, and the CT surface prepared for registration.

pub mod any;
pub mod ct;
pub mod file;
pub mod prepare;
pub mod prepare_any;
pub mod prepare_cloud;
pub mod simulated;
pub mod simulated_phantom;
