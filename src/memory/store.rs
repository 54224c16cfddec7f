//! An array that is in memory, in a part of a file that is mapped, or in a file while it grows: to its reader a slice.

use std::fs::File;
use std::io;
use std::ops::{Deref, DerefMut};
use std::path::Path;
use std::sync::Arc;

use bytemuck::Pod;
use memmap2::Mmap;

use super::spill::Spill;
use super::{Array, mapped};

/// A large array of plain numbers. Reading never copies; writing to one that is mapped copies it into memory first, as the
/// file is only read.
pub struct Store<T> {
    place: Place<T>,
}

enum Place<T> {
    Memory(Vec<T>),
    /// All of the map, which its copies share.
    File(Arc<Mmap>),
    Spill(Spill<T>),
}

impl<T: Pod> Store<T> {
    /// An empty array that grows in a nameless file on the disk of `folder`.
    pub fn spilling(folder: &Path) -> io::Result<Self> {
        Ok(Store { place: Place::Spill(Spill::new(folder)?) })
    }

    /// `count` elements of `file` from byte `offset` on.
    ///
    /// # Errors
    /// They lie beyond the end of the file, `offset` isn't a multiple of what the elements are aligned to, or the system can't map them.
    pub fn mapped(file: &File, offset: u64, count: usize) -> io::Result<Self> {
        // Pages are aligned to 4 KiB at least.
        const { assert!(size_of::<T>() > 0 && align_of::<T>() <= 4096) };
        if count == 0 {
            return Ok(Store::default());
        }
        let bytes = count.checked_mul(size_of::<T>()).ok_or(io::ErrorKind::InvalidInput)?;
        let end = offset.checked_add(bytes as u64).ok_or(io::ErrorKind::InvalidInput)?;
        if end > file.metadata()?.len() || !offset.is_multiple_of(align_of::<T>() as u64) {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        Ok(Store { place: Place::File(Arc::new(mapped::read_only(file, offset, bytes)?)) })
    }

    /// Whether this is a part of a file, shared with whoever else has mapped it.
    pub fn is_mapped(&self) -> bool {
        matches!(self.place, Place::File(_))
    }

    /// Appends `added` zeros; returns them, to be filled.
    ///
    /// # Errors
    /// Too little memory or disk.
    pub fn grow(&mut self, added: usize) -> io::Result<&mut [T]> {
        self.make_writable().ok_or(io::ErrorKind::OutOfMemory)?;
        match &mut self.place {
            Place::Spill(spill) => spill.grow(added),
            Place::Memory(array) => {
                let first = array.len();
                array.try_reserve(added)?;
                array.resize(first + added, T::zeroed());
                Ok(&mut array[first..])
            }
            Place::File(_) => unreachable!("was copied into memory"),
        }
    }

    /// Appends `source`, without copying it where there is nothing in memory yet.
    ///
    /// # Errors
    /// As [`grow`](Store::grow).
    pub fn append(&mut self, source: Vec<T>) -> io::Result<()> {
        match &mut self.place {
            Place::Memory(array) if array.is_empty() => *array = source,
            _ => self.grow(source.len())?.copy_from_slice(&source),
        }
        Ok(())
    }

    /// Its place, in memory if it was a part of a file.
    ///
    /// # Panics
    /// Out of memory, as any other container.
    fn unmapped(&mut self) -> &mut Place<T> {
        self.make_writable().expect("memory for a copy");
        &mut self.place
    }
}

impl<T> Default for Store<T> {
    fn default() -> Self {
        Store { place: Place::Memory(Vec::new()) }
    }
}

impl<T> From<Vec<T>> for Store<T> {
    fn from(array: Vec<T>) -> Self {
        Store { place: Place::Memory(array) }
    }
}

impl<T> FromIterator<T> for Store<T> {
    fn from_iter<I: IntoIterator<Item = T>>(elements: I) -> Self {
        Vec::from_iter(elements).into()
    }
}

impl<T: Pod> Array<T> for Store<T> {
    fn zeroed(length: usize) -> Option<Self> {
        Vec::zeroed(length).map(Store::from)
    }

    fn make_writable(&mut self) -> Option<()> {
        if self.is_mapped() {
            let mut copy = Vec::new();
            copy.try_reserve_exact(self.len()).ok()?;
            copy.extend_from_slice(self);
            *self = copy.into();
        }
        Some(())
    }
}

impl<T: Pod> Deref for Store<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        match &self.place {
            Place::Memory(array) => array,
            Place::File(map) => bytemuck::cast_slice(map),
            Place::Spill(spill) => spill.as_slice(),
        }
    }
}

impl<T: Pod> DerefMut for Store<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match self.unmapped() {
            Place::Memory(array) => array,
            Place::Spill(spill) => spill.as_mut_slice(),
            Place::File(_) => unreachable!("was copied into memory"),
        }
    }
}

impl<T: Pod> Clone for Store<T> {
    fn clone(&self) -> Self {
        match &self.place {
            Place::File(map) => Store { place: Place::File(map.clone()) },
            _ => self.to_vec().into(),
        }
    }
}

impl<'a, T: Pod> IntoIterator for &'a Store<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<T: Pod> AsRef<[T]> for Store<T> {
    fn as_ref(&self) -> &[T] {
        self
    }
}

impl<T: Pod + PartialEq, U: AsRef<[T]> + ?Sized> PartialEq<U> for Store<T> {
    fn eq(&self, other: &U) -> bool {
        self[..] == *other.as_ref()
    }
}

impl<T: Pod + std::fmt::Debug> std::fmt::Debug for Store<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self[..].fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn grows_alike_in_memory_and_in_a_file() {
        let folder = tempfile::tempdir().unwrap();
        for mut store in [Store::default(), Store::<[u32; 3]>::spilling(folder.path()).unwrap()] {
            assert!(store.is_empty());
            let mut expected = Vec::new();
            // Beyond the first page, the first block of zeros and the first steps.
            for (round, added) in [1, 0, 7, 5000, 1, 40_000, 3].into_iter().enumerate() {
                let tail = store.grow(added).unwrap();
                assert!(tail.len() == added && tail.iter().all(|e| *e == [0; 3]));
                tail.fill([round as u32; 3]);
                expected.extend(vec![[round as u32; 3]; added]);
                store.append(vec![[9; 3]; 2]).unwrap();
                expected.extend([[9; 3]; 2]);
                assert_eq!(store, expected);
            }
            store[4] = [8; 3];
            expected[4] = [8; 3];
            assert_eq!(store, expected);
            assert_eq!(store.clone(), expected);
            assert!(store.grow(usize::MAX / 8).is_err());
            assert_eq!(store, expected);
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "spilled files have no name");
    }

    #[test]
    fn a_part_of_a_file_is_shared_until_it_is_written_to() {
        let mut file = tempfile::tempfile().unwrap();
        let numbers: Vec<u32> = (0..5000).collect();
        file.write_all(bytemuck::cast_slice(&numbers)).unwrap();
        let store = Store::<[u32; 2]>::mapped(&file, 64, 2000).unwrap();
        assert!(store.is_mapped() && store.len() == 2000 && store[0] == [16, 17]);
        let mut copy = store.clone();
        assert!(copy.is_mapped() && copy.as_ptr() == store.as_ptr());
        copy[0] = [0, 0];
        assert!(!copy.is_mapped() && store[0] == [16, 17] && copy[1..] == store[1..]);
        let mut longer = store.clone();
        longer.grow(1).unwrap()[0] = [1, 1];
        assert_eq!((longer.len(), longer[1999], longer[2000]), (2001, store[1999], [1, 1]));
    }

    #[test]
    fn what_the_file_hasnt_got_is_refused() {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&[0; 100]).unwrap();
        assert!(Store::<u32>::mapped(&file, 64, 9).is_ok());
        assert!(Store::<u32>::mapped(&file, 64, 10).is_err());
        assert!(Store::<u32>::mapped(&file, 200, 0).unwrap().is_empty());
        assert!(Store::<u32>::mapped(&file, u64::MAX - 3, 1).is_err());
        assert!(Store::<u32>::mapped(&file, 0, usize::MAX / 2).is_err());
        assert!(Store::<u32>::mapped(&file, 2, 1).is_err());
    }
}
