//! Experiments on the renderer: what is claimed of it is tried here. Nothing in the renderer knows this room.

pub mod aim;
pub mod dyadic;
mod footing;
pub mod judge;
pub mod meshes;
pub mod referee;
mod spheres;
pub mod stress;
pub mod tally;
