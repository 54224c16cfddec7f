//! The space of a scene cut into voxels, and which rank has what is in them.

use serde::{Deserialize, Serialize};

use super::lattice::Lattice;

/// A block that has nothing, in [`Voxels::owners`].
pub const NOBODY: u32 = u32::MAX;
/// A block that every rank has, in [`Voxels::owners`].
pub const EVERYBODY: u32 = u32::MAX - 1;

/// The space of a scene in voxels, and whose they are: what every rank knows of all.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Voxels {
    pub lattice: Lattice,
    /// Of each block of voxels the bits of those that hold something.
    pub occupied: Vec<u64>,
    /// Of each block the rank that holds all that reaches into its voxels, [`NOBODY`] or [`EVERYBODY`].
    pub owners: Vec<u32>,
}
