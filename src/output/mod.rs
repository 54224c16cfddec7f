//! Where data leaves: the writing of image files, comparison, progress, statistics and timelines.
//!
//! Knows neither scenes nor MPI. Everything is written whole or not at all (`file`), and the same
//! input always gives the same bytes.

pub mod compare;
pub mod file;
pub mod flip;
pub mod heat_map;
pub mod metadata;
pub mod plot;
pub mod progress;
pub mod statistics;
pub mod stats;
pub mod student;
pub mod timeline;
pub mod write;

pub use crate::image::{read, transfer};
