//! Which instructions kernels use: chosen once, at run time, so that one binary serves all processors.

use std::sync::OnceLock;

/// Instructions that the kernels use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// What every processor of the architecture has.
    Baseline,
    /// AVX2 and FMA.
    Avx2,
    /// AVX-512 F, VL, DQ and BW, on vectors of eight.
    Avx512,
}

/// Forces a lower level.
pub const LEVEL_VARIABLE: &str = "HELIOSTAT_SIMD";

impl Level {
    pub const ALL: [Level; 3] = [Level::Baseline, Level::Avx2, Level::Avx512];

    pub fn name(self) -> &'static str {
        match self {
            Level::Baseline => "baseline",
            Level::Avx2 => "avx2",
            Level::Avx512 => "avx512",
        }
    }

    /// Whether this processor has it.
    pub fn is_available(self) -> bool {
        match self {
            Level::Baseline => true,
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => {
                is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
                    && is_x86_feature_detected!("bmi1")
                    && is_x86_feature_detected!("bmi2")
                    && is_x86_feature_detected!("lzcnt")
                    && is_x86_feature_detected!("popcnt")
            }
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => {
                Level::Avx2.is_available()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512bw")
            }
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// The level of a name, as [`LEVEL_VARIABLE`] gives it: the best that there is up to that.
    ///
    /// # Errors
    /// An unknown name.
    pub fn named(name: &str) -> Result<Level, String> {
        let wanted = Level::ALL.into_iter().find(|level| level.name() == name);
        let wanted = wanted.ok_or_else(|| format!("no level is called {name:?}"))?;
        let below = Level::ALL.into_iter().filter(|level| *level <= wanted && level.is_available());
        Ok(below.max().unwrap_or(Level::Baseline))
    }

    /// The level of this process: the best that there is, or what [`LEVEL_VARIABLE`] names.
    pub fn chosen() -> Level {
        static CHOSEN: OnceLock<Level> = OnceLock::new();
        *CHOSEN.get_or_init(|| {
            let name = std::env::var(LEVEL_VARIABLE).unwrap_or_default();
            Level::named(&name).or_else(|_| Level::named(Level::Avx512.name())).unwrap_or(Level::Baseline)
        })
    }
}

/// Compiles a function of plain loops for each level, and calls the copy for the level that is chosen. Results are the same: the compiler fuses and reorders nothing.
///
/// `compiled!(fn name(argument: Type, …) = function);` makes `name` of an `#[inline(always)]` function.
macro_rules! compiled {
    ($(#[$about:meta])* $visible:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) = $function:path;) => {
        $(#[$about])*
        $visible fn $name($($argument: $type),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
                fn avx2($($argument: $type),*) {
                    $function($($argument),*)
                }
                #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq,avx512bw")]
                fn avx512($($argument: $type),*) {
                    $function($($argument),*)
                }
                match $crate::simd::Level::chosen() {
                    $crate::simd::Level::Baseline => {}
                    // SAFETY: levels that the processor lacks are never chosen.
                    $crate::simd::Level::Avx2 => return unsafe { avx2($($argument),*) },
                    // SAFETY: as above.
                    $crate::simd::Level::Avx512 => return unsafe { avx512($($argument),*) },
                }
            }
            $function($($argument),*)
        }
    };
}
pub(crate) use compiled;
