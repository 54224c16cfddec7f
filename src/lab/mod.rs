//! Experiments on the renderer: what is claimed of it is tried here. What is measured is the renderer's own code, never a copy of it.

pub mod aim;
pub mod builds;
pub mod dyadic;
pub mod error_curve;
mod footing;
pub mod judge;
pub mod kernels;
pub mod ladder;
pub mod meshes;
mod plain_grid;
pub mod prediction;
pub mod probe;
pub mod referee;
mod spheres;
pub mod strategies;
pub mod stress;
pub mod tally;
