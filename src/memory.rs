//! Large arrays: on large pages, in memory or in files. Knows nothing of what they hold.

mod mapped;
mod spill;
mod store;

use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

use bytemuck::Pod;
use memmap2::MmapMut;

pub use store::Store;

/// An array whose length is known when it is made, and which can be filled in place.
pub trait Array<T>: Sized + DerefMut<Target = [T]> {
    /// All bytes 0; `None` if there is too little memory.
    fn zeroed(length: usize) -> Option<Self>;

    /// Readies it for being written to, which doing so would do as well, but not without memory; `None` if there is too little.
    fn make_writable(&mut self) -> Option<()> {
        Some(())
    }
}

impl<T: Pod> Array<T> for Vec<T> {
    fn zeroed(length: usize) -> Option<Self> {
        let mut array = Vec::new();
        array.try_reserve_exact(length).ok()?;
        array.resize(length, T::zeroed());
        Some(array)
    }
}

/// A fixed number of elements on pages of 2 MiB, where the system has such: random access to many of them misses the processor's table of pages less often.
pub struct HugeArray<T> {
    /// `None` if empty.
    map: Option<MmapMut>,
    elements: PhantomData<T>,
}

impl<T> Default for HugeArray<T> {
    fn default() -> Self {
        HugeArray { map: None, elements: PhantomData }
    }
}

impl<T: Pod> Array<T> for HugeArray<T> {
    fn zeroed(length: usize) -> Option<Self> {
        // Pages are aligned to 4 KiB.
        const { assert!(align_of::<T>() <= 4096) };
        let bytes = length.checked_mul(size_of::<T>())?;
        if bytes == 0 {
            return Some(HugeArray::default());
        }
        let map = MmapMut::map_anon(bytes).ok()?;
        // A hint: a system without large pages does as well, only slower.
        #[cfg(target_os = "linux")]
        let _ = map.advise(memmap2::Advice::HugePage);
        Some(HugeArray { map: Some(map), elements: PhantomData })
    }
}

impl<T: Pod> Deref for HugeArray<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        self.map.as_deref().map_or(&[], bytemuck::cast_slice)
    }
}

impl<T: Pod> DerefMut for HugeArray<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        self.map.as_deref_mut().map_or(&mut [], bytemuck::cast_slice_mut)
    }
}

impl<T: Pod> Clone for HugeArray<T> {
    /// # Panics
    /// Out of memory, as of any other container.
    fn clone(&self) -> Self {
        let mut copy = HugeArray::zeroed(self.len()).expect("memory for a copy");
        copy.copy_from_slice(self);
        copy
    }
}

impl<T> std::fmt::Debug for HugeArray<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let bytes = self.map.as_ref().map_or(0, |map| map.len());
        write!(f, "HugeArray({} elements)", bytes / size_of::<T>().max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_what_is_put_in() {
        let mut array: HugeArray<[u32; 3]> = HugeArray::zeroed(1_000_000).unwrap();
        assert_eq!((array.len(), array[999_999]), (1_000_000, [0; 3]));
        array[7] = [1, 2, 3];
        let copy = array.clone();
        assert_eq!((copy[7], copy.len()), ([1, 2, 3], array.len()));
        assert!(HugeArray::<u64>::zeroed(0).unwrap().is_empty());
        assert!(HugeArray::<u64>::default().is_empty());
        assert!(HugeArray::<u64>::zeroed(usize::MAX / 4).is_none());
    }
}
