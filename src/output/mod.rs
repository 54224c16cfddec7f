//! Where data leaves: image files, comparison, progress, statistics and timelines.
//!
//! Knows neither scenes nor MPI. Everything is written whole or not at all (`file`), and the same
//! input always gives the same bytes.

pub mod compare;
pub mod exr;
mod exr_layers;
pub mod file;
pub mod flip;
mod format;
pub mod heat_map;
pub mod metadata;
pub mod pfm;
pub mod plot;
pub mod png;
pub mod progress;
pub mod read;
pub mod statistics;
pub mod stats;
pub mod timeline;
pub mod transfer;
pub mod write;
