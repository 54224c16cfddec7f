//! heliostat: a distributed-memory parallel ray tracer.

pub mod accel;
pub mod error;
pub mod geometry;
pub mod image;
pub mod output;
pub mod render;
pub mod scene;
pub mod settings;
pub mod transport;
