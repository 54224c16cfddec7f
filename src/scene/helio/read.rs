//! Opening a file and mapping its sections.

use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::{ALIGNMENT, BYTE_ORDER, MAGIC, Preamble, Section, VERSION};
use crate::error::{Error, Result};
use crate::memory::Store;
use crate::scene::files;
use crate::wire;

/// Bytes that are checked at once by one thread.
const STEP: usize = 1 << 20;

/// A file of named arrays. Open, it holds its table alone; what is in the sections is read when it is touched.
#[derive(Debug)]
pub struct HelioFile {
    path: PathBuf,
    file: File,
    sections: Vec<Section>,
    checksum: u32,
}

impl HelioFile {
    /// Opens a file and checks its table: that every section lies within the file, not what is in it.
    ///
    /// # Errors
    /// A file that can't be read, isn't of this kind, version or byte order, or was cut or damaged.
    pub fn open(path: &Path) -> Result<Self> {
        let file = files::open(path)?;
        let read = |source| Error::read(path, source);
        let bytes = file.metadata().map_err(read)?.len();
        let mut preamble = Preamble::zeroed();
        let found = usize::try_from(bytes).unwrap_or(usize::MAX).min(size_of::<Preamble>());
        (&file).read_exact(&mut bytemuck::bytes_of_mut(&mut preamble)[..found]).map_err(read)?;
        check_preamble(&preamble, bytes).map_err(|what| broken(path, what))?;

        // Within the file, so it is no longer than that.
        let mut table = vec![0; preamble.table_bytes as usize];
        (&file).seek(SeekFrom::Start(preamble.table_offset)).map_err(read)?;
        (&file).read_exact(&mut table).map_err(read)?;
        if crc32fast::hash(&table) != preamble.table_checksum {
            return Err(broken(path, "its table is damaged"));
        }
        let sections: Vec<Section> =
            wire::unpack(&table).map_err(|_| broken(path, "its table can't be read"))?;
        check_table(&sections, preamble.table_offset).map_err(|what| broken(path, what))?;
        // The table holds the sums of all sections.
        let checksum = preamble.table_checksum;
        Ok(HelioFile { path: path.into(), file, sections, checksum })
    }

    /// The path that it was opened by.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Of everything in the file: files with the same one hold the same.
    pub fn checksum(&self) -> u32 {
        self.checksum
    }

    /// A section's elements, mapped and unchecked.
    ///
    /// # Errors
    /// There is none of this name, or its elements have another size.
    pub fn section<T: Pod>(&self, name: &str) -> Result<Store<T>> {
        self.optional_section(name)?.ok_or_else(|| self.broken(format!("it has no section {name:?}")))
    }

    /// A section's elements as by [`section`](HelioFile::section), or `None` if there is none of this name.
    ///
    /// # Errors
    /// Its elements have another size.
    pub fn optional_section<T: Pod>(&self, name: &str) -> Result<Option<Store<T>>> {
        const { assert!(align_of::<T>() as u64 <= ALIGNMENT) };
        let Some(section) = self.sections.iter().find(|section| section.name == name) else {
            return Ok(None);
        };
        if section.element_bytes != size_of::<T>() as u64 {
            return Err(self.broken(format!(
                "the elements of its section {name:?} have {} bytes, not {}",
                section.element_bytes,
                size_of::<T>()
            )));
        }
        Store::mapped(&self.file, section.offset, section.count as usize)
            .map(Some)
            .map_err(|source| Error::read(&self.path, source))
    }

    /// Reads a section from first to last, in parallel: compares its checksum, and gives `check` each run of elements with the
    /// index of the first. A section that isn't there is sound.
    ///
    /// # Errors
    /// Bytes that aren't those that were written, or what `check` finds wrong.
    pub fn verify<T: Pod + Sync>(
        &self,
        name: &str,
        check: impl Fn(usize, &[T]) -> std::result::Result<(), String> + Sync,
    ) -> Result<()> {
        let Some(elements) = self.optional_section::<T>(name)? else { return Ok(()) };
        let step = STEP / size_of::<T>();
        let checked: std::result::Result<Vec<crc32fast::Hasher>, String> = elements
            .par_chunks(step)
            .enumerate()
            .map(|(index, run)| {
                let mut sum = crc32fast::Hasher::new();
                sum.update(bytemuck::cast_slice(run));
                check(index * step, run).map(|()| sum)
            })
            .collect();
        // Damage explains whatever else is wrong.
        let mut whole = crc32fast::Hasher::new();
        match &checked {
            Ok(sums) => sums.iter().for_each(|sum| whole.combine(sum)),
            Err(_) => whole.update(bytemuck::cast_slice(&elements)),
        }
        let expected = self.sections.iter().find(|section| section.name == name).map(|found| found.checksum);
        if Some(whole.finalize()) != expected {
            return Err(self.broken(format!("its section {name:?} is damaged")));
        }
        checked.map(drop).map_err(|what| self.broken(what))
    }

    /// That the file can't be used.
    pub fn broken(&self, what: impl Into<String>) -> Error {
        broken(&self.path, what)
    }
}

fn broken(path: &Path, what: impl Into<String>) -> Error {
    Error::scene(path, None, what, "convert the scene anew")
}

/// `bytes` is the length of the file.
fn check_preamble(preamble: &Preamble, bytes: u64) -> std::result::Result<(), String> {
    if preamble.magic != MAGIC {
        return Err("it is no .helio file".into());
    }
    if preamble.byte_order == BYTE_ORDER.swap_bytes() {
        return Err("it was written on a machine of another byte order".into());
    }
    if preamble.byte_order == BYTE_ORDER && preamble.version != VERSION {
        return Err(format!("it is of version {}, and this program reads {VERSION}", preamble.version));
    }
    if bytes < size_of::<Preamble>() as u64 || preamble.checksum != preamble.own_checksum() {
        return Err("its beginning is damaged".into());
    }
    if preamble.file_bytes != bytes {
        return Err(format!("it has {bytes} bytes instead of {}", preamble.file_bytes));
    }
    let end = preamble.table_offset.checked_add(preamble.table_bytes);
    if end != Some(bytes) || preamble.table_bytes > wire::MAX_PAYLOAD_BYTES as u64 {
        return Err("its table isn't at its end".into());
    }
    Ok(())
}

/// `end` is where the sections end.
fn check_table(sections: &[Section], end: u64) -> std::result::Result<(), String> {
    let mut names = HashSet::new();
    for Section { name, offset, element_bytes, count, checksum: _ } in sections {
        if !names.insert(name) {
            return Err(format!("it has two sections {name:?}"));
        }
        let last = count.checked_mul(*element_bytes).and_then(|bytes| bytes.checked_add(*offset));
        let within = last.is_some_and(|last| last <= end) && usize::try_from(*count).is_ok();
        if !within || offset % ALIGNMENT != 0 || *element_bytes == 0 {
            return Err(format!("its section {name:?} doesn't lie within it"));
        }
    }
    Ok(())
}
