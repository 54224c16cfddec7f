//! An array that grows in a file without a name: its pages are the system's to write out and take back, so that it may be
//! larger than memory. It ends with the process.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::marker::PhantomData;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use bytemuck::Pod;
use memmap2::MmapMut;

use super::mapped;

/// The most bytes that the file grows by beyond what is asked for.
const LARGEST_STEP: usize = 64 << 20;
static ZEROS: [u8; 1 << 16] = [0; 1 << 16];

pub struct Spill<T> {
    file: File,
    /// The whole file; `None` while it is empty.
    map: Option<MmapMut>,
    /// Elements in use.
    length: usize,
    elements: PhantomData<T>,
}

impl<T: Pod> Spill<T> {
    /// An empty array on the disk that `folder` is on.
    pub fn new(folder: &Path) -> io::Result<Self> {
        Ok(Spill { file: nameless(folder)?, map: None, length: 0, elements: PhantomData })
    }

    /// Appends zeros; returns them, to be filled.
    ///
    /// # Errors
    /// A full disk.
    pub fn grow(&mut self, added: usize) -> io::Result<&mut [T]> {
        let first = self.length;
        let needed = added
            .checked_add(first)
            .and_then(|length| length.checked_mul(size_of::<T>()))
            .ok_or(io::ErrorKind::OutOfMemory)?;
        let capacity = self.map.as_ref().map_or(0, |map| map.len());
        if needed > capacity {
            let target = needed.saturating_add(needed.min(LARGEST_STEP));
            // Written, not only claimed: a page that the disk has no place for would end the process when it is touched.
            let mut missing = target - capacity;
            while missing > 0 {
                let part = missing.min(ZEROS.len());
                self.file.write_all(&ZEROS[..part])?;
                missing -= part;
            }
            self.map = Some(mapped::read_write(&self.file, target)?);
        }
        self.length += added;
        Ok(&mut self.as_mut_slice()[first..])
    }

    pub fn as_slice(&self) -> &[T] {
        let bytes = self.length * size_of::<T>();
        self.map.as_ref().map_or(&[], |map| bytemuck::cast_slice(&map[..bytes]))
    }

    pub fn as_mut_slice(&mut self) -> &mut [T] {
        let bytes = self.length * size_of::<T>();
        self.map.as_mut().map_or(&mut [], |map| bytemuck::cast_slice_mut(&mut map[..bytes]))
    }
}

/// A new file that no other process can open, and that is gone when it is closed.
fn nameless(folder: &Path) -> io::Result<File> {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    loop {
        let number = COUNTER.fetch_add(1, Ordering::Relaxed);
        let path = folder.join(format!(".heliostat-{}-{number}.spill", std::process::id()));
        match OpenOptions::new().read(true).write(true).create_new(true).open(&path) {
            Ok(file) => return std::fs::remove_file(&path).map(|()| file),
            // Left by a killed process of the same number, or another host's.
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
            Err(error) => return Err(error),
        }
    }
}
