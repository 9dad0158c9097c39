//! Compressed frames of one value per pixel, to what is stored for each pixel.

pub(super) mod jpeg_2000;
pub(super) mod jpeg_lossless;
pub(super) mod run_length;
