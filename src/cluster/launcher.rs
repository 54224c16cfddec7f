//! What the launcher's environment says about this job. Must not know MPI itself: it works in builds without.

use crate::error::Error;

/// A process that some launcher started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Launch {
    /// How many processes the launcher says it started; a bare PMIx launcher doesn't say.
    pub size: Option<usize>,
    /// Which of them this one is, where the launcher says.
    pub rank: Option<usize>,
    /// The variable that told, for messages.
    pub variable: &'static str,
}

/// The launcher that started this process, by its variables; `None` for a plain run.
///
/// The order matters: `mpirun` inside a Slurm job leaves both its own variables and Slurm's, and the inner
/// launcher's count. `SLURM_NTASKS` tells nothing: a plain run inside an allocation has it too.
pub fn detect(env: impl Fn(&str) -> Option<String>) -> Option<Launch> {
    let number = |name: &str| env(name).and_then(|text| text.trim().parse::<usize>().ok());
    let sized = [
        ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"),
        ("PMI_SIZE", "PMI_RANK"),
        ("SLURM_STEP_NUM_TASKS", "SLURM_PROCID"),
    ];
    for (size, rank) in sized {
        if let Some(count) = number(size).filter(|&count| count > 0) {
            return Some(Launch { size: Some(count), rank: number(rank), variable: size });
        }
    }
    for variable in ["PMIX_RANK", "PMI_RANK"] {
        if let Some(rank) = number(variable) {
            return Some(Launch { size: None, rank: Some(rank), variable });
        }
    }
    None
}

impl Launch {
    /// Whether this process speaks for all of them while they can't talk to each other.
    pub fn speaks(&self) -> bool {
        self.rank.is_none_or(|rank| rank == 0)
    }

    /// An error where MPI sees other processes than the launcher started.
    #[cfg_attr(not(feature = "mpi"), allow(dead_code))]
    pub fn check_world_size(&self, world: usize) -> Result<(), Error> {
        match self.size {
            Some(size) if size != world => Err(Error::launch(
                format!(
                    "the launcher started {size} processes ({}={size}), but MPI sees {world} in this job, so each \
                     would render the whole image",
                    self.variable
                ),
                "use the mpirun (or srun --mpi=…) of the MPI that this program was built with, or rebuild with \
                 the launcher's MPI first in PATH",
            )),
            _ => Ok(()),
        }
    }

    /// The error of a build that can't talk to the other processes.
    #[cfg_attr(feature = "mpi", allow(dead_code))]
    pub fn refused_without_mpi(&self) -> Error {
        let count = self.size.map_or("several".into(), |size| size.to_string());
        Error::launch(
            format!(
                "a launcher started {count} processes ({} is set), but this build has no MPI",
                self.variable
            ),
            "build it with `--features mpi`, or start one process without the launcher",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detect_in(variables: &[(&str, &str)]) -> Option<Launch> {
        detect(|name| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_string()))
    }

    #[test]
    fn a_plain_run_has_no_launcher() {
        assert_eq!(detect_in(&[]), None);
        assert_eq!(detect_in(&[("SLURM_NTASKS", "8"), ("SLURM_PROCID", "0")]), None);
        assert_eq!(detect_in(&[("PMI_SIZE", "many")]), None);
    }

    #[test]
    fn the_inner_launcher_counts() {
        let launch = detect_in(&[
            ("SLURM_STEP_NUM_TASKS", "2"),
            ("SLURM_PROCID", "1"),
            ("OMPI_COMM_WORLD_SIZE", "8"),
            ("OMPI_COMM_WORLD_RANK", "5"),
        ])
        .unwrap();
        assert_eq!((launch.size, launch.rank), (Some(8), Some(5)));
        assert!(!launch.speaks());
    }

    #[test]
    fn each_launcher_is_seen() {
        let size_and_rank = |variables| detect_in(variables).map(|l| (l.size, l.rank));
        assert_eq!(size_and_rank(&[("PMI_SIZE", "3"), ("PMI_RANK", "2")]), Some((Some(3), Some(2))));
        let slurm = [("SLURM_STEP_NUM_TASKS", "4"), ("SLURM_PROCID", "3"), ("PMIX_RANK", "3")];
        assert_eq!(size_and_rank(&slurm), Some((Some(4), Some(3))));
        assert_eq!(size_and_rank(&[("PMIX_RANK", "1")]), Some((None, Some(1))));
    }

    #[test]
    fn a_mismatch_names_both_numbers() {
        let launch = detect_in(&[("PMI_SIZE", "4"), ("PMI_RANK", "0")]).unwrap();
        assert!(launch.check_world_size(4).is_ok());
        let text = launch.check_world_size(1).unwrap_err().to_string();
        assert!(text.contains("4 processes") && text.contains("sees 1"), "{text}");
        assert!(launch.refused_without_mpi().to_string().contains("--features mpi"));
    }
}
