//! Giving every rank what rank 0 knows: first whether its work went well, then the values and arrays.
//!
//! Owns the order of a broadcast and what an error becomes. Must not know what is shared.

use bytemuck::Pod;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Comm, wire};
use crate::error::{Error, Result};
use crate::memory::Array;

/// Collective: rank 0 does `work`, and every rank learns how it went before anything else moves.
///
/// Rank 0 gets what `work` made. The others get `T::default()`, a shell to be filled by [`Share`].
/// Errors: on every rank the same one, as [`Error::Remote`], which [`finish`](super::finish) knows for shared: all
/// leave in good order, and rank 0 says it once. A single process keeps the original error.
pub fn outcome<T: Default>(comm: &dyn Comm, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let mut made = None;
    computed(comm, || work().map(|value| made = Some(value)))?;
    Ok(made.unwrap_or_default())
}

/// Collective: rank 0 does `work`, and every rank gets the value that it made, or the error, as in [`outcome`].
pub fn computed<T: Serialize + DeserializeOwned>(
    comm: &dyn Comm,
    work: impl FnOnce() -> Result<T>,
) -> Result<T> {
    if comm.size() == 1 {
        return work();
    }
    let mut told: std::result::Result<T, (String, i32)> = Err((String::new(), 0));
    if comm.rank() == 0 {
        told = work().map_err(|error| (error.to_string(), error.exit_code()));
    }
    Share::new(comm).value(&mut told)?;
    told.map_err(|(message, code)| Error::Remote { message, code })
}

/// Collective: every rank gives what came of its `own` work, and gets it back if all went well.
///
/// Errors: on every rank the first failing rank's, by its number, as in [`outcome`]. So what is wrong on all nodes is said
/// once, not by as many voices as there are ranks. A single process keeps the original error.
pub fn agreed<T>(comm: &dyn Comm, own: Result<T>) -> Result<T> {
    if comm.size() == 1 {
        return own;
    }
    let failure = own.as_ref().err().map(|error| (error.to_string(), error.exit_code()));
    let failures = comm.gather(&wire::encode(&failure)?);
    computed(comm, || {
        let failures: Vec<Option<(String, i32)>> =
            failures.unwrap_or_default().iter().map(|bytes| wire::decode(bytes)).collect::<Result<_>>()?;
        let count = failures.iter().flatten().count();
        let Some(rank) = failures.iter().position(Option::is_some) else { return Ok(()) };
        let (message, code) = failures[rank].clone().unwrap_or_default();
        let others = if count > 1 { format!(" and {} more", count - 1) } else { String::new() };
        Err(Error::Remote { message: format!("rank {rank}{others}: {message}"), code })
    })?;
    own
}

/// Fills the values of all ranks with rank 0's, one after the other. All ranks make the same calls in the same
/// order, so one function can serve as sender and receiver:
///
/// ```
/// # use heliostat::{cluster::{Comm, Solo, share::{self, Share}}, error::Result};
/// #[derive(Default)]
/// struct Cloud { name: String, points: Vec<[f32; 3]> }
///
/// fn share_cloud(cloud: &mut Cloud, share: Share) -> Result<()> {
///     share.value(&mut cloud.name)?;
///     share.array(&mut cloud.points)
/// }
///
/// fn load() -> Result<Cloud> { Ok(Cloud { name: "one".into(), points: vec![[0.0; 3]] }) }
///
/// let comm = Solo::new();
/// let mut cloud = share::outcome(&comm, load)?;
/// share_cloud(&mut cloud, Share::new(&comm))?;
/// assert_eq!(cloud.points.len(), 1);
/// # Ok::<(), heliostat::error::Error>(())
/// ```
#[derive(Clone, Copy)]
pub struct Share<'a> {
    comm: &'a dyn Comm,
}

impl<'a> Share<'a> {
    pub fn new(comm: &'a dyn Comm) -> Self {
        Share { comm }
    }

    /// Collective: replaces `value` by rank 0's. For small things; see [`array`](Share::array).
    ///
    /// Errors: one that this rank alone may have, so end the job by it.
    pub fn value<T: Serialize + DeserializeOwned>(&self, value: &mut T) -> Result<()> {
        if self.comm.size() == 1 {
            return Ok(());
        }
        let mut bytes = Vec::new();
        if self.comm.rank() == 0 {
            bytes = wire::encode(value)?;
        }
        self.comm.broadcast(&mut bytes);
        if self.comm.rank() > 0 {
            *value = wire::decode(&bytes)?;
        }
        Ok(())
    }

    /// Collective: whether all ranks say yes.
    ///
    /// Errors: one that this rank alone may have, so end the job by it.
    pub fn all(&self, own: bool) -> Result<bool> {
        let answers = self.comm.gather(&[u8::from(own)]);
        let mut all = answers.is_some_and(|answers| answers.iter().all(|answer| *answer == [1]));
        self.value(&mut all)?;
        Ok(all)
    }

    /// Collective: replaces `array` by rank 0's, of any length, as its bytes lie in memory. Other ranks receive
    /// straight into one of the right type and length.
    ///
    /// Errors: too little memory for it, or elements of another size on rank 0; end the job by it.
    pub fn array<T: Pod>(&self, array: &mut impl Array<T>) -> Result<()> {
        if self.comm.size() == 1 {
            return Ok(());
        }
        let element_bytes = size_of::<T>();
        let mut shape = (array.len() as u64, element_bytes as u64);
        self.value(&mut shape)?;
        if shape.1 != element_bytes as u64 {
            return Err(Error::launch(
                format!(
                    "rank 0 sends elements of {} bytes, this rank knows them with {element_bytes}",
                    shape.1
                ),
                "run the same build of heliostat on all nodes",
            ));
        }
        if self.comm.rank() > 0 {
            *array = zeroed_array(shape.0 as usize)?;
        }
        array.make_writable().ok_or_else(|| no_memory::<T>(shape.0 as usize))?;
        self.comm.broadcast_slice(bytemuck::cast_slice_mut(array));
        Ok(())
    }
}

fn zeroed_array<T: Pod, A: Array<T>>(length: usize) -> Result<A> {
    A::zeroed(length).ok_or_else(|| no_memory::<T>(length))
}

fn no_memory<T>(length: usize) -> Error {
    let gib = length as f64 * size_of::<T>() as f64 / (1u64 << 30) as f64;
    Error::launch(
        format!("this rank has no memory for {gib:.2} GiB of the scene"),
        "start fewer ranks per node, each with more threads",
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::cluster::comm::{Solo, memory};

    /// Runs `body` on every rank of a group and returns what they return.
    fn on_ranks<T: Send>(size: usize, body: impl Fn(&dyn Comm) -> T + Sync) -> Vec<T> {
        let body = &body;
        std::thread::scope(|scope| {
            let ranks: Vec<_> =
                memory::group(size).into_iter().map(|comm| scope.spawn(move || body(&comm))).collect();
            ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
        })
    }

    #[test]
    fn an_error_of_rank_0_is_everybodys() {
        let outcomes = on_ranks(3, |comm| {
            outcome(comm, || -> Result<u32> {
                assert_eq!(comm.rank(), 0, "only rank 0 works");
                Err(Error::usage("--width", "0 is too small", "give 1 or more"))
            })
        });
        for result in outcomes {
            let error = result.unwrap_err();
            assert!(matches!(error, Error::Remote { code: 2, .. }), "{error:?}");
            assert_eq!(error.to_string(), "--width: 0 is too small; give 1 or more");
        }
    }

    #[test]
    fn a_single_process_keeps_the_error_itself() {
        let error = outcome(&Solo::new(), || Err::<(), _>(Error::usage("-o", "no", "yes"))).unwrap_err();
        assert!(matches!(error, Error::Usage { .. }));
    }

    #[test]
    fn a_good_outcome_gives_shells_and_a_computed_value_is_everywhere() {
        assert_eq!(on_ranks(3, |comm| outcome(comm, || Ok(7)).unwrap()), [7, 0, 0]);
        assert_eq!(on_ranks(3, |comm| computed(comm, || Ok("seven".to_string())).unwrap()), ["seven"; 3]);
    }

    #[test]
    fn an_error_of_any_rank_is_everybodys_once() {
        let told = |failing: &'static [usize]| {
            on_ranks(3, move |comm| {
                let wrong = failing.contains(&comm.rank());
                agreed(comm, if wrong { Err(Error::usage("-o", "no", "yes")) } else { Ok(comm.rank()) })
                    .map_err(|error| (error.exit_code(), error.to_string()))
            })
        };
        assert_eq!(told(&[]), [Ok(0), Ok(1), Ok(2)]);
        assert_eq!(told(&[2]), vec![Err((2, "rank 2: -o: no; yes".to_string())); 3]);
        assert_eq!(told(&[0, 1, 2]), vec![Err((2, "rank 0 and 2 more: -o: no; yes".to_string())); 3]);
    }

    #[test]
    fn all_say_yes_or_one_says_no() {
        let answers = |no: &'static [usize]| {
            on_ranks(3, move |comm| Share::new(comm).all(!no.contains(&comm.rank())).unwrap())
        };
        assert_eq!(answers(&[]), [true; 3]);
        for no in [&[0][..], &[2], &[0, 1, 2]] {
            assert_eq!(answers(no), [false; 3]);
        }
        assert!(Share::new(&Solo::new()).all(true).unwrap());
    }

    #[test]
    fn elements_of_another_size_are_refused() {
        let results = on_ranks(2, |comm| match comm.rank() {
            0 => Share::new(comm).array(&mut vec![[1u8; 12]]),
            _ => Share::new(comm).array(&mut Vec::<[u8; 16]>::new()),
        });
        assert!(results[0].is_ok());
        assert!(results[1].as_ref().unwrap_err().to_string().contains("12 bytes"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn arrays_arrive_whole_and_aligned(
            points in proptest::collection::vec(any::<[f64; 3]>(), 0..40),
            indices in proptest::collection::vec(any::<u32>(), 0..40),
            size in 1usize..4,
            chunk in 1usize..100,
        ) {
            let bits = |points: &[[f64; 3]]| points.iter().map(|p| p.map(f64::to_bits)).collect::<Vec<_>>();
            on_ranks(size, |comm| {
                comm.set_chunk_bytes(chunk);
                let share = Share::new(comm);
                let (mut p, mut i) = (Vec::new(), vec![1, 2, 3]);
                if comm.rank() == 0 {
                    (p, i) = (points.clone(), indices.clone());
                }
                share.array(&mut p).unwrap();
                share.array(&mut i).unwrap();
                assert_eq!(bits(&p), bits(&points));
                assert_eq!(i, indices);
            });
        }
    }
}
