//! Files of named arrays that are mapped rather than read: `.helio`. Owns their layout, which docs/helio.md describes; knows no
//! scene. What the arrays mean is the business of [`load::helio`](super::load::helio) and of whoever adds some.
//!
//! A preamble of 64 bytes, sections that each begin at a multiple of 64, the table of sections. The arrays are stored as they lie in the memory of
//! this machine, so that nothing is decoded; a file of another byte order is refused.

mod read;
mod write;

use serde::{Deserialize, Serialize};

pub use read::HelioFile;
pub use write::HelioWriter;

const MAGIC: [u8; 8] = *b"HELIOST\n";
/// Raised with every change of the layout, or of what the sections of a scene hold.
const VERSION: u32 = 3;
/// Its bytes tell the order in which the writer stored them.
const BYTE_ORDER: u32 = 0x0102_0304;
/// Every section begins at a multiple of this.
pub const ALIGNMENT: u64 = 64;

/// The first bytes of a file.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Preamble {
    magic: [u8; 8],
    version: u32,
    byte_order: u32,
    /// Of the whole file.
    file_bytes: u64,
    /// Where the table begins, and how long it is.
    table_offset: u64,
    table_bytes: u64,
    /// CRC-32 of the table.
    table_checksum: u32,
    /// CRC-32 of this preamble's bytes before.
    checksum: u32,
    unused: [u64; 2],
}

impl Preamble {
    fn own_checksum(&self) -> u32 {
        crc32fast::hash(&bytemuck::bytes_of(self)[..std::mem::offset_of!(Preamble, checksum)])
    }
}

/// A line of the table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Section {
    name: String,
    /// Of its first byte, a multiple of [`ALIGNMENT`].
    offset: u64,
    element_bytes: u64,
    /// Number of elements.
    count: u64,
    /// CRC-32 of its bytes.
    checksum: u32,
}

#[cfg(test)]
mod tests;
