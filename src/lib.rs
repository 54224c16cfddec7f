//! heliostat: a distributed-memory parallel ray tracer.

pub mod error;
pub mod output;
pub mod scene;
pub mod settings;
