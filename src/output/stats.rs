//! What a render cost: seconds, rays, tiles and bytes of every rank. Knows nothing of how they were
//! measured.

use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::file;
use crate::cluster::exchange::ExchangeStats;
use crate::error::Result;
use crate::render::metric::ErrorReached;

/// Wall seconds of one rank's phases.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseSeconds {
    pub load: f64,
    pub build: f64,
    pub broadcast: f64,
    /// Until this rank's last unit was done; waiting for the others is not in it.
    pub trace: f64,
    pub gather: f64,
    pub write: f64,
}

/// Rays by what they ask for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RayCounts {
    pub camera: u64,
    pub reflection: u64,
    pub refraction: u64,
    pub shadow: u64,
    /// Rays that estimate the cost of tiles and give no pixel.
    pub prepass: u64,
}

impl RayCounts {
    /// Rays of all kinds.
    pub fn sum(&self) -> u64 {
        self.camera + self.reflection + self.refraction + self.shadow + self.prepass
    }
}

impl std::ops::AddAssign for RayCounts {
    fn add_assign(&mut self, other: Self) {
        self.camera += other.camera;
        self.reflection += other.reflection;
        self.refraction += other.refraction;
        self.shadow += other.shadow;
        self.prepass += other.prepass;
    }
}

/// One rank's part; travels to rank 0.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RankStats {
    pub rank: u32,
    pub threads: u32,
    pub seconds: PhaseSeconds,
    pub rays: RayCounts,
    pub tiles: u64,
    pub bytes_sent: u64,
    /// Where the rank had a part of the scene only.
    pub part: Option<PartStats>,
}

/// A rank's part of a divided scene, and the rays that travelled.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartStats {
    /// Primitives that the rank had; those at borders several ranks have.
    pub primitives: u64,
    pub scene_bytes: u64,
    pub accel_bytes: u64,
    /// Primitives that the rank had only as every rank had them, and their share of the bytes.
    pub replicated: u64,
    pub replicated_bytes: u64,
    /// How often a ray was put to the part: over all ranks and divided by their rays, hops per ray.
    pub asked: u64,
    pub exchange: ExchangeStats,
}

impl fmt::Display for RankStats {
    /// One line: what this rank did.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let PhaseSeconds { load, build, broadcast, trace, gather, write } = self.seconds;
        write!(
            f,
            "rank {}: {} threads, {} tiles, {} rays, {} bytes sent; seconds: load {load:.3}, build {build:.3}, \
             broadcast {broadcast:.3}, trace {trace:.3}, gather {gather:.3}, write {write:.3}",
            self.rank,
            self.threads,
            self.tiles,
            self.rays.sum(),
            self.bytes_sent
        )
    }
}

/// Sums over all ranks, and what follows from them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Totals {
    pub ranks: u32,
    pub threads: u32,
    pub rays: RayCounts,
    pub all_rays: u64,
    pub tiles: u64,
    pub bytes_sent: u64,
    /// Wall seconds of the whole job on rank 0.
    pub seconds: f64,
    /// The longest trace of any rank.
    pub trace_seconds: f64,
    /// Million rays of all kinds a second of `trace_seconds`; 0 where that is 0.
    pub mrays_per_second: f64,
    /// Parts that a ray was put to, on the mean; 0 where all ranks have all.
    pub hops_per_ray: f64,
    /// How often a ray was sent to another rank, on the mean; 0 where all ranks have all.
    pub forwards_per_ray: f64,
    /// Longest over mean trace seconds: 1 is perfect balance, the number of ranks none at all.
    pub imbalance: f64,
}

/// Everything that `--stats` writes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stats {
    pub width: u32,
    pub height: u32,
    pub spp: u32,
    /// Where variances were asked for.
    pub error: Option<ErrorReached>,
    pub totals: Totals,
    pub ranks: Vec<RankStats>,
}

impl Stats {
    /// Sums up the ranks of a job that took `seconds` on rank 0. Ranks are put in order.
    pub fn new(width: u32, height: u32, spp: u32, seconds: f64, mut ranks: Vec<RankStats>) -> Self {
        ranks.sort_by_key(|rank| rank.rank);
        let mut rays = RayCounts::default();
        ranks.iter().for_each(|rank| rays += rank.rays);
        let trace_seconds = ranks.iter().map(|rank| rank.seconds.trace).fold(0.0, f64::max);
        let mean = ranks.iter().map(|rank| rank.seconds.trace).sum::<f64>() / ranks.len().max(1) as f64;
        let parts = || ranks.iter().filter_map(|rank| rank.part.as_ref());
        let asked: u64 = parts().map(|part| part.asked).sum();
        let sent: u64 = parts().map(|part| part.exchange.sent).sum();
        let ratio = |a: f64, b: f64, otherwise: f64| if b > 0.0 { a / b } else { otherwise };
        let totals = Totals {
            ranks: ranks.len() as u32,
            threads: ranks.iter().map(|rank| rank.threads).sum(),
            rays,
            all_rays: rays.sum(),
            tiles: ranks.iter().map(|rank| rank.tiles).sum(),
            bytes_sent: ranks.iter().map(|rank| rank.bytes_sent).sum(),
            seconds,
            trace_seconds,
            mrays_per_second: ratio(rays.sum() as f64 / 1e6, trace_seconds, 0.0),
            hops_per_ray: ratio(asked as f64, rays.sum() as f64, 0.0),
            forwards_per_ray: ratio(sent as f64, rays.sum() as f64, 0.0),
            imbalance: ratio(trace_seconds, mean, 1.0),
        };
        Stats { width, height, spp, error: None, totals, ranks }
    }

    /// Writes indented JSON, whole or not at all.
    pub fn write(&self, path: &Path) -> Result<()> {
        file::write_whole(path, |writer| file::json(writer, self))
    }
}

/// The summary for people: three lines without a closing newline.
impl fmt::Display for Stats {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Totals { ranks, threads, rays, tiles, bytes_sent, .. } = self.totals;
        let totals = &self.totals;
        writeln!(
            f,
            "{} × {}, {} spp: {:.2} s, of which {:.2} s tracing at {:.2} Mray/s",
            self.width, self.height, self.spp, totals.seconds, totals.trace_seconds, totals.mrays_per_second
        )?;
        writeln!(
            f,
            "rays: {} camera, {} reflection, {} refraction, {} shadow, {} prepass",
            rays.camera, rays.reflection, rays.refraction, rays.shadow, rays.prepass
        )?;
        if let Some(error) = &self.error {
            writeln!(
                f,
                "error after {:.1} spp: RMSE {:.3e} (95 %: below {:.3e}), relMSE {:.3e} (below {:.3e})",
                error.spp, error.rmse, error.rmse_at_most, error.rel_mse, error.rel_mse_at_most
            )?;
        }
        write!(
            f,
            "{}, {}, {}, {bytes_sent} bytes sent, imbalance {:.3}",
            counted(ranks.into(), "rank"),
            counted(threads.into(), "thread"),
            counted(tiles, "tile"),
            totals.imbalance
        )
    }
}

fn counted(count: u64, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rank(rank: u32, trace: f64) -> RankStats {
        RankStats {
            rank,
            threads: 2,
            seconds: PhaseSeconds { load: 0.5, trace, write: 0.125, ..PhaseSeconds::default() },
            rays: RayCounts {
                camera: 1_000_000,
                reflection: 10,
                refraction: 20,
                shadow: 999_960,
                prepass: 10,
            },
            tiles: 5 + u64::from(rank),
            bytes_sent: 100,
            part: None,
        }
    }

    #[test]
    fn totals_are_the_sums() {
        let stats = Stats::new(640, 480, 4, 5.0, vec![rank(1, 4.0), rank(0, 2.0)]);
        assert_eq!(stats.ranks[0].rank, 0);
        let totals = &stats.totals;
        assert_eq!((totals.ranks, totals.threads, totals.tiles, totals.bytes_sent), (2, 4, 11, 200));
        assert_eq!((totals.all_rays, totals.rays.refraction), (4_000_000, 40));
        assert_eq!((totals.trace_seconds, totals.mrays_per_second, totals.hops_per_ray), (4.0, 1.0, 0.0));
        assert_eq!(totals.imbalance, 4.0 / 3.0);
        let summary = stats.to_string();
        assert!(summary.contains("5.00 s, of which 4.00 s tracing at 1.00 Mray/s"), "{summary}");
        assert!(
            summary.ends_with("2 ranks, 4 threads, 11 tiles, 200 bytes sent, imbalance 1.333"),
            "{summary}"
        );
        assert_eq!(summary.lines().count(), 3);
    }

    #[test]
    fn hops_are_those_of_all_ranks() {
        let part = |asked, sent| {
            let exchange = ExchangeStats { sent, ..ExchangeStats::default() };
            Some(PartStats { asked, exchange, ..PartStats::default() })
        };
        let ranks = vec![
            RankStats { part: part(3_000_000, 1_000_000), ..rank(0, 1.0) },
            RankStats { part: part(1_000_000, 0), ..rank(1, 1.0) },
        ];
        let totals = Stats::new(1, 1, 1, 1.0, ranks).totals;
        assert_eq!((totals.hops_per_ray, totals.forwards_per_ray), (1.0, 0.25));
    }

    #[test]
    fn nothing_measured_divides_by_nothing() {
        for ranks in [vec![], vec![RankStats::default()]] {
            let totals = Stats::new(1, 1, 1, 0.0, ranks).totals;
            assert_eq!((totals.mrays_per_second, totals.imbalance), (0.0, 1.0));
        }
    }

    #[test]
    fn rank_part_travels_as_bytes() {
        let sent = rank(3, 1.5);
        let bytes = bincode::serde::encode_to_vec(&sent, bincode::config::legacy()).unwrap();
        let (got, length): (RankStats, usize) =
            bincode::serde::decode_from_slice(&bytes, bincode::config::legacy()).unwrap();
        assert_eq!((got, length), (sent, bytes.len()));
    }

    #[test]
    fn json_holds_totals_and_ranks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stats.json");
        Stats::new(640, 480, 4, 5.0, vec![rank(0, 2.0), rank(1, 4.0)]).write(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.ends_with("}\n") && text.lines().count() > 30);
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["width"], 640);
        assert_eq!(json["totals"]["rays"]["camera"], 2_000_000);
        assert_eq!(json["ranks"][1]["seconds"]["trace"], 4.0);
        assert_eq!(json["ranks"][1]["rays"]["shadow"], 999_960);
    }
}
