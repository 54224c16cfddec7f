//! Writing sections one after the other.

use std::io::{self, Seek, SeekFrom, Write};

use bytemuck::Pod;

use super::{ALIGNMENT, BYTE_ORDER, MAGIC, Preamble, Section, VERSION};
use crate::wire;

/// Bytes that are summed and written at once: few enough to be still in the cache.
const STEP: usize = 1 << 20;

/// Writes a file of named arrays. A file without its [`finish`](HelioWriter::finish) can't be read, so write it under a temporary
/// name, for instance by [`write_whole`](crate::output::file::write_whole).
///
/// ```
/// # use heliostat::scene::helio::{HelioFile, HelioWriter};
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("a.helio");
/// heliostat::output::file::write_whole(&path, |out| {
///     let mut writer = HelioWriter::new(out)?;
///     writer.section("index.starts", &[0u64, 7, 9])?;
///     writer.finish()
/// })?;
/// let starts = HelioFile::open(&path)?.section::<u64>("index.starts")?;
/// assert_eq!(starts[..], [0, 7, 9]);
/// # Ok::<(), heliostat::error::Error>(())
/// ```
pub struct HelioWriter<W: Write + Seek> {
    out: W,
    /// Bytes written.
    offset: u64,
    sections: Vec<Section>,
}

impl<W: Write + Seek> HelioWriter<W> {
    /// Begins a file at the start of `out`.
    pub fn new(mut out: W) -> io::Result<Self> {
        out.write_all(&[0; size_of::<Preamble>()])?;
        Ok(HelioWriter { out, offset: size_of::<Preamble>() as u64, sections: Vec::new() })
    }

    /// Adds an array.
    ///
    /// # Errors
    /// A failed write, or a name that is taken.
    pub fn section<T: Pod>(&mut self, name: &str, elements: &[T]) -> io::Result<()> {
        const { assert!(size_of::<T>() > 0 && align_of::<T>() as u64 <= ALIGNMENT) };
        if self.sections.iter().any(|section| section.name == name) {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, format!("two sections `{name}`")));
        }
        self.align()?;
        let offset = self.offset;
        let mut checksum = crc32fast::Hasher::new();
        for step in bytemuck::cast_slice::<T, u8>(elements).chunks(STEP) {
            checksum.update(step);
            self.out.write_all(step)?;
            self.offset += step.len() as u64;
        }
        self.sections.push(Section {
            name: name.into(),
            offset,
            element_bytes: size_of::<T>() as u64,
            count: elements.len() as u64,
            checksum: checksum.finalize(),
        });
        Ok(())
    }

    /// Writes the table, and the preamble that leads to it.
    ///
    /// # Errors
    /// A failed write, or far too many sections.
    pub fn finish(mut self) -> io::Result<()> {
        self.align()?;
        let table = wire::pack(&self.sections).map_err(|error| io::Error::other(error.to_string()))?;
        self.out.write_all(&table)?;
        let mut preamble = Preamble {
            magic: MAGIC,
            version: VERSION,
            byte_order: BYTE_ORDER,
            file_bytes: self.offset + table.len() as u64,
            table_offset: self.offset,
            table_bytes: table.len() as u64,
            table_checksum: crc32fast::hash(&table),
            checksum: 0,
            unused: [0; 2],
        };
        preamble.checksum = preamble.own_checksum();
        self.out.seek(SeekFrom::Start(0))?;
        self.out.write_all(bytemuck::bytes_of(&preamble))?;
        self.out.flush()
    }

    fn align(&mut self) -> io::Result<()> {
        let gap = self.offset.next_multiple_of(ALIGNMENT) - self.offset;
        self.out.write_all(&[0; ALIGNMENT as usize][..gap as usize])?;
        self.offset += gap;
        Ok(())
    }
}
