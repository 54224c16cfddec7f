//! The launcher that the other MPI tests rely on, without the program: it starts as many ranks as
//! asked, binds none of them to a core, and hands an exit code on.
#![cfg(feature = "mpi")]

use std::process::{Command, Output};

/// Runs `program` on `ranks` ranks by `HELIOSTAT_TEST_MPIRUN`, the launcher's command up to `-n`.
fn launch(ranks: u32, program: &[&str]) -> Output {
    let launcher = std::env::var("HELIOSTAT_TEST_MPIRUN")
        .expect("HELIOSTAT_TEST_MPIRUN is not set; run launch/test, which sets it");
    let mut words = launcher.split_whitespace();
    Command::new(words.next().expect("HELIOSTAT_TEST_MPIRUN is empty"))
        .args(words)
        .args(["-n", &ranks.to_string()])
        .args(program)
        .output()
        .expect("the launcher starts")
}

#[test]
fn ranks_are_not_bound_to_a_core() {
    let alone = Command::new("nproc").output().expect("nproc starts");
    let alone = String::from_utf8_lossy(&alone.stdout).trim().to_string();

    for ranks in [1, 2, 4] {
        let output = launch(ranks, &["nproc"]);

        let seen = String::from_utf8_lossy(&output.stdout);
        let seen: Vec<_> = seen.split_whitespace().collect();
        assert_eq!(seen, vec![alone.as_str(); ranks as usize], "{output:?}");
    }
}

#[test]
fn exit_code_is_handed_on() {
    let output = launch(2, &["sh", "-c", "exit 7"]);

    assert_eq!(output.status.code(), Some(7), "{output:?}");
}
