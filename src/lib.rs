//! heliostat: a distributed-memory parallel ray tracer.

pub mod accel;
pub mod cli;
pub mod cluster;
pub mod error;
pub mod geometry;
pub mod image;
pub mod job;
pub mod output;
pub mod render;
pub mod scene;
pub mod settings;
pub mod transport;

pub use job::render_alone;
