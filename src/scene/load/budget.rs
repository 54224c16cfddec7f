//! How much memory what is loaded may take, so that a scene beyond the machine is an error that names its line instead
//! of the end of the process. Knows no scene and no file format.

/// A bound on the bytes of what a scene file asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    bytes: Option<u64>,
}

impl Budget {
    pub const fn of_bytes(bytes: u64) -> Self {
        Budget { bytes: Some(bytes) }
    }

    /// What this machine can give now: Linux' own estimate, without a bound where there is none.
    pub fn of_machine() -> Self {
        let bytes = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| available(&text));
        Budget { bytes }
    }

    /// How many bytes there are instead, if not as many as `needed`; `None` if they are there.
    pub fn lacks(&self, needed: u64) -> Option<Shortage> {
        match self.bytes {
            Some(available) if needed > available => Some(Shortage { needed, available: Some(available) }),
            _ if reservable(needed) => None,
            _ => Some(Shortage { needed, available: None }),
        }
    }
}

/// That there is less memory than needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shortage {
    needed: u64,
    /// `None` where the system refuses without saying how much it would give.
    available: Option<u64>,
}

impl std::fmt::Display for Shortage {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        let gib = |bytes: u64| bytes as f64 / (1u64 << 30) as f64;
        write!(formatter, "about {:.1} GiB of memory, ", gib(self.needed))?;
        match self.available {
            Some(available) => write!(formatter, "but {:.1} GiB are available", gib(available)),
            None => write!(formatter, "more than this process may have"),
        }
    }
}

/// Whether the system promises so much address space, which `ulimit -v` and its like bound; none of it is touched.
fn reservable(bytes: u64) -> bool {
    usize::try_from(bytes).is_ok_and(|bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_ok())
}

/// `MemAvailable` of /proc/meminfo in bytes.
fn available(meminfo: &str) -> Option<u64> {
    let rest = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kib: u64 = rest.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_machine_says_what_it_has() {
        let text = "MemTotal:       24576000 kB\nMemFree:        1 kB\nMemAvailable:   23068672 kB\n";
        assert_eq!(available(text), Some(22 << 30));
        assert_eq!(available("MemTotal: 1 kB\n"), None);
        assert_eq!(available("MemAvailable: much\n"), None);
    }

    #[test]
    fn what_is_too_much_is_said() {
        let budget = Budget::of_bytes(3 << 29);
        assert_eq!(budget.lacks(3 << 29), None);
        let shortage = budget.lacks(1 << 33).unwrap().to_string();
        assert_eq!(shortage, "about 8.0 GiB of memory, but 1.5 GiB are available");
        let shortage = Budget { bytes: None }.lacks(1 << 62).unwrap().to_string();
        assert_eq!(shortage, "about 4294967296.0 GiB of memory, more than this process may have");
        assert_eq!(Budget::of_machine().lacks(1 << 20), None);
    }
}
