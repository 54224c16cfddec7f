//! Where data leaves: image files, comparison, progress, statistics and timelines.

pub mod image;
