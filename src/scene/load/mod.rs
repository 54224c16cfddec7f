//! Scene files in, [`Scene`](super::Scene) out: one file per format.

pub mod texture;
