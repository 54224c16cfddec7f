//! heliostat: a distributed-memory parallel ray tracer.

pub mod cluster;
pub mod error;
pub mod output;
