//! Files as memory. The only place that maps them; knows neither formats nor elements.

use std::fs::File;
use std::io;

use memmap2::{Mmap, MmapMut, MmapOptions};

/// `bytes` of `file` from byte `offset` on, which must lie within it. They start at an address that is as aligned as `offset` is,
/// up to a page.
pub(super) fn read_only(file: &File, offset: u64, bytes: usize) -> io::Result<Mmap> {
    // SAFETY: What is read are plain numbers, of which every pattern of bits is one. Another process that writes into the file changes them
    // (the picture is wrong then), one that shortens it ends this process by SIGBUS. Heliostat does neither: it writes files
    // under a temporary name and renames them, so a file under its name is never changed in place.
    unsafe { MmapOptions::new().offset(offset).len(bytes).map(file) }
}

/// The first `bytes` of `file`, which must have them, to be read and written.
pub(super) fn read_write(file: &File, bytes: usize) -> io::Result<MmapMut> {
    // SAFETY: As above; and the files that are written so have no name, so no other process knows them.
    unsafe { MmapOptions::new().len(bytes).map_mut(file) }
}
