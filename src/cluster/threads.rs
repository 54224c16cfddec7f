//! How many threads a rank computes with. Knows processors and neighbours, nothing of the work.

use std::num::NonZeroUsize;

use super::{Comm, share};
use crate::error::{Error, Result};

/// The environment variable by which each node can have its own number.
pub const VARIABLE: &str = "HELIOSTAT_THREADS";

/// Collective: this rank's number of threads.
///
/// `flag` if given, else `HELIOSTAT_THREADS` of this rank's own environment, else the processors this rank may run
/// on, divided among the ranks of the same machine that may run on exactly the same ones. At least 1.
///
/// Errors: on every rank, a variable of any rank that is no positive number.
pub fn choose(comm: &dyn Comm, flag: Option<NonZeroUsize>) -> Result<usize> {
    let variable = std::env::var(VARIABLE).ok();
    // Neighbours may lack the variable, and then count on every rank to take part.
    let fair = fair_share(comm)?;
    let explicit = share::agreed(comm, explicit(flag, variable.as_deref()))?;
    Ok(explicit.unwrap_or(fair))
}

fn explicit(flag: Option<NonZeroUsize>, variable: Option<&str>) -> Result<Option<usize>> {
    if let Some(threads) = flag {
        return Ok(Some(threads.get()));
    }
    let Some(text) = variable.map(str::trim).filter(|text| !text.is_empty()) else { return Ok(None) };
    match text.parse::<NonZeroUsize>() {
        Ok(threads) => Ok(Some(threads.get())),
        Err(_) => Err(Error::usage(
            VARIABLE,
            format!("\"{text}\" is no number of threads"),
            "give 1 or more, or unset it",
        )),
    }
}

fn fair_share(comm: &dyn Comm) -> Result<usize> {
    let processors = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    if comm.size() == 1 {
        return Ok(processors);
    }
    let Some(own_place) = place_of_this_process() else {
        let (rank, size) = comm.node_local();
        // `node_local` is collective, so all ranks of a job must be on systems of one kind.
        return Ok(part(processors, rank, size));
    };
    let gathered = comm.gather(own_place.as_bytes());
    let mut neighbours = Vec::new();
    if let Some(places) = gathered {
        neighbours = among_neighbours(&places);
    }
    share::Share::new(comm).array(&mut neighbours)?;
    let [rank, size] = neighbours[comm.rank()];
    Ok(part(processors, rank as usize, size as usize))
}

/// For each rank, its place among the ranks of the same place, and their number.
fn among_neighbours(places: &[Vec<u8>]) -> Vec<[u32; 2]> {
    let mut seen = std::collections::HashMap::<&[u8], u32>::new();
    let ranks: Vec<u32> = places
        .iter()
        .map(|place| {
            let count = seen.entry(place).or_default();
            *count += 1;
            *count - 1
        })
        .collect();
    places.iter().zip(ranks).map(|(place, rank)| [rank, seen[place.as_slice()]]).collect()
}

/// The part of `processors` that the `rank`-th of `size` equals gets; what doesn't divide goes to the first.
fn part(processors: usize, rank: usize, size: usize) -> usize {
    (processors / size + usize::from(rank < processors % size)).max(1)
}

/// The running kernel and the processors that it lets this process run on. Equal texts mean the same processors.
/// The kernel's boot id tells machines apart where host names may not (containers, clones).
fn place_of_this_process() -> Option<String> {
    let machine = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    Some(format!("{} {}", machine.trim(), allowed_processors(&status)?))
}

fn allowed_processors(status: &str) -> Option<&str> {
    status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:")).map(str::trim)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::comm::{Solo, memory};

    #[test]
    fn the_flag_beats_the_variable_beats_the_processors() {
        assert_eq!(explicit(NonZeroUsize::new(3), Some("5")).unwrap(), Some(3));
        assert_eq!(explicit(None, Some(" 5 ")).unwrap(), Some(5));
        assert_eq!(explicit(None, Some("")).unwrap(), None);
        assert_eq!(explicit(None, None).unwrap(), None);
        for wrong in ["0", "-1", "two", "1.5"] {
            let error = explicit(None, Some(wrong)).unwrap_err();
            assert!(error.to_string().contains(wrong) && error.exit_code() == 2, "{error}");
        }
    }

    #[test]
    fn only_ranks_of_the_same_processors_divide_them() {
        let places = ["a 0-7", "a 0-7", "b 0-7", "a 0-7", "a 8-15"].map(|place| place.as_bytes().to_vec());
        assert_eq!(among_neighbours(&places), [[0, 3], [1, 3], [0, 1], [2, 3], [0, 1]]);
    }

    #[test]
    fn parts_add_up_and_are_never_nothing() {
        for (processors, size) in [(8, 3), (7, 2), (64, 64), (5, 1)] {
            assert_eq!((0..size).map(|rank| part(processors, rank, size)).sum::<usize>(), processors);
        }
        assert_eq!(part(2, 3, 4), 1);
    }

    #[test]
    fn the_kernel_names_the_processors() {
        let status = "Name:\tx\nCpus_allowed:\tff\nCpus_allowed_list:\t0-3,6\nMems_allowed:\t1\n";
        assert_eq!(allowed_processors(status), Some("0-3,6"));
        assert_eq!(allowed_processors("Name:\tx\n"), None);
    }

    #[test]
    fn ranks_of_one_process_share_its_processors() {
        let processors = std::thread::available_parallelism().unwrap().get();
        assert_eq!(fair_share(&Solo::new()).unwrap(), processors);
        let ranks: Vec<_> = memory::group(processors + 1)
            .into_iter()
            .map(|comm| std::thread::spawn(move || fair_share(&comm).unwrap()))
            .collect();
        for rank in ranks {
            assert_eq!(rank.join().unwrap(), 1);
        }
    }
}
