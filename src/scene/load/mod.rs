//! Scene files in, [`Scene`](super::Scene) out: one file per format.

mod locate;
mod mtl;
mod mtl_material;
pub mod obj;
mod obj_lines;
pub mod texture;
