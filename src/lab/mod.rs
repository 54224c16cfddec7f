//! Experiments on the tracer itself. What is measured here is the renderer's own code, never a copy of it.

pub mod ladder;
pub mod probe;
