//! Records that wait, the newest on top: some in memory, the oldest in a file that nobody else sees. Knows nothing of what they are.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};

use bytemuck::Pod;

use crate::error::{Error, Result};

/// A stack of records of which at most about `limit` are held in memory.
pub struct Pile<T> {
    records: Vec<T>,
    limit: usize,
    spill: Option<Spill>,
    spilled: u64,
}

/// The file that the oldest records are in, as a stack of runs.
struct Spill {
    file: File,
    /// Records of each run, the oldest first.
    runs: Vec<usize>,
    len: usize,
}

impl<T: Pod> Pile<T> {
    pub fn new(limit: usize) -> Self {
        Pile { records: Vec::new(), limit: limit.max(2), spill: None, spilled: 0 }
    }

    /// All records, in memory or not.
    pub fn len(&self) -> usize {
        self.records.len() + self.spill.as_ref().map_or(0, |spill| spill.len)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Records in memory.
    pub fn held(&self) -> usize {
        self.records.len()
    }

    /// Records that ever went to the file.
    pub fn spilled(&self) -> u64 {
        self.spilled
    }

    /// Puts records on top.
    ///
    /// # Errors
    /// A temporary file that can't be written.
    pub fn push(&mut self, records: &[T]) -> Result<()> {
        // In pieces, so that not even for a moment more than the limit is here.
        for piece in records.chunks((self.limit / 2).max(1)) {
            if self.records.len() + piece.len() > self.limit {
                self.put_away()?;
            }
            self.records.extend_from_slice(piece);
        }
        Ok(())
    }

    /// Moves up to `count` records from the top to the end of `taken`.
    ///
    /// # Errors
    /// A temporary file that can't be read.
    pub fn take(&mut self, count: usize, taken: &mut Vec<T>) -> Result<()> {
        let mut left = count;
        while left > 0 && !self.is_empty() {
            if self.records.is_empty() {
                self.bring_back()?;
            }
            let from = self.records.len().saturating_sub(left);
            left -= self.records.len() - from;
            taken.extend(self.records.drain(from..));
        }
        if self.records.capacity() > 4 * self.limit {
            self.records.shrink_to(self.limit);
        }
        Ok(())
    }

    /// Writes all that is in memory into the file.
    fn put_away(&mut self) -> Result<()> {
        if self.records.is_empty() {
            return Ok(());
        }
        if self.spill.is_none() {
            let file = tempfile::tempfile().map_err(spill_error)?;
            self.spill = Some(Spill { file, runs: Vec::new(), len: 0 });
        }
        if let Some(spill) = &mut self.spill {
            let end = spill.len * size_of::<T>();
            spill.file.seek(SeekFrom::Start(end as u64)).map_err(spill_error)?;
            spill.file.write_all(bytemuck::cast_slice(&self.records)).map_err(spill_error)?;
            spill.runs.push(self.records.len());
            spill.len += self.records.len();
        }
        self.spilled += self.records.len() as u64;
        self.records.clear();
        Ok(())
    }

    /// Reads the newest run back.
    fn bring_back(&mut self) -> Result<()> {
        let Some(spill) = &mut self.spill else { return Ok(()) };
        let Some(count) = spill.runs.pop() else { return Ok(()) };
        spill.len -= count;
        let begin = spill.len * size_of::<T>();
        self.records.resize(count, T::zeroed());
        spill.file.seek(SeekFrom::Start(begin as u64)).map_err(spill_error)?;
        spill.file.read_exact(bytemuck::cast_slice_mut(&mut self.records)).map_err(spill_error)?;
        spill.file.set_len(begin as u64).map_err(spill_error)
    }
}

fn spill_error(source: std::io::Error) -> Error {
    Error::Write {
        path: std::env::temp_dir(),
        source,
        mend: "give rays more memory with --ray-memory, or set TMPDIR to a folder with room for waiting rays"
            .into(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn gives_back_what_it_was_given_and_holds_no_more_than_its_limit(
            limit in 2usize..20,
            steps in prop::collection::vec((any::<bool>(), 0usize..50), 0..60),
        ) {
            let mut pile = Pile::new(limit);
            let mut inside = std::collections::BTreeSet::<u64>::new();
            let mut next = 0u64;
            for (is_push, count) in steps {
                if is_push {
                    let records: Vec<u64> = (next..next + count as u64).collect();
                    next += count as u64;
                    inside.extend(&records);
                    pile.push(&records).unwrap();
                } else {
                    let mut taken = Vec::new();
                    pile.take(count, &mut taken).unwrap();
                    prop_assert_eq!(taken.len(), count.min(inside.len()));
                    for record in taken {
                        prop_assert!(inside.remove(&record), "{record} was given twice");
                    }
                }
                prop_assert_eq!(pile.len(), inside.len());
                prop_assert!(pile.held() <= limit, "{} of {limit}", pile.held());
            }
        }
    }

    #[test]
    fn the_newest_come_first() {
        let mut pile = Pile::new(4);
        pile.push(&[1u32, 2, 3, 4, 5, 6, 7, 8, 9]).unwrap();
        assert!(pile.spilled() > 0);
        let mut taken = Vec::new();
        pile.take(1, &mut taken).unwrap();
        assert_eq!(taken, [9]);
    }
}
