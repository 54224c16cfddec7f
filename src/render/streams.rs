//! Records that wait to be traced, told apart by stream: those of one go much the same way, and are traced together.

use crate::geometry::record::RayRecord;

/// Records by stream.
#[derive(Debug)]
pub struct Streams<T> {
    waiting: [Vec<T>; RayRecord::STREAMS],
}

impl<T> Default for Streams<T> {
    fn default() -> Self {
        Streams { waiting: Default::default() }
    }
}

impl<T> Streams<T> {
    #[inline]
    pub fn push(&mut self, stream: u8, record: T) {
        self.waiting[usize::from(stream)].push(record);
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn len(&self) -> usize {
        self.waiting.iter().map(Vec::len).sum()
    }

    /// Moves records to `wave` until that has `most`: the fullest stream first and its newest ones, so that few wait however deep rays go.
    pub fn take(&mut self, wave: &mut Vec<T>, most: usize) {
        while let Some(fullest) = self.waiting.iter_mut().max_by_key(|stream| stream.len())
            && !fullest.is_empty()
            && wave.len() < most
        {
            if wave.is_empty() && fullest.len() <= most {
                // All of it, without a copy.
                std::mem::swap(wave, fullest);
                continue;
            }
            let newest = fullest.len().saturating_sub(most - wave.len());
            wave.extend(fullest.drain(newest..));
        }
    }

    /// All of them.
    pub fn drain(&mut self) -> impl Iterator<Item = T> + '_ {
        self.waiting.iter_mut().flat_map(|stream| stream.drain(..))
    }
}
