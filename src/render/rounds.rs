//! Samples in rounds: what is taken of which pixels before the next look at the error. Decisions follow from whole blocks of the image at the ends of rounds alone, so they are
//! the same for any ranks, threads, tiles and crops.

use serde::{Deserialize, Serialize};

use crate::settings::{Crop, ImageSettings, Integrator};

/// Edge in pixels of the blocks that decide by themselves whether they are good enough; they begin at the image's upper left corner.
pub const BLOCK: u32 = 8;

/// Batches of a round: so many means tell a variance.
const BATCHES: u32 = 4;
/// Batches where a single round shall tell a variance, and the most of any round: a film has planes for each.
const MOST_BATCHES: u32 = 32;

/// Samples `first .. first + count` of each active pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Round {
    pub first: u32,
    pub count: u32,
    /// Consecutive parts of equal size, but for rounding, whose means tell a variance.
    pub batches: u32,
}

impl Round {
    /// The only round of an image whose error nobody asks for.
    pub fn all(spp: u32) -> Self {
        Round { first: 0, count: spp, batches: 1 }
    }

    /// The batch of one of the round's samples.
    #[inline]
    pub fn batch(&self, sample: u32) -> u32 {
        (u64::from(sample - self.first) * u64::from(self.batches) / u64::from(self.count)) as u32
    }
}

/// Samples of each pixel before the error is looked at for the first time. Edges of surfaces and shadows show early; paths may find a light by rare
/// chance, and who stops before is wrong.
pub fn first_look(settings: &ImageSettings) -> u32 {
    match settings.integrator {
        Integrator::Whitted => 4,
        Integrator::Path => 16,
    }
}

/// The rounds that an image may take; it ends before where it is good enough or time is over. With a time limit they begin with single samples.
pub fn schedule(settings: &ImageSettings, timed: bool) -> Vec<Round> {
    let spp = settings.spp;
    if settings.error_target.is_none() && !timed {
        let batches = if settings.variance { spp.min(MOST_BATCHES) } else { 1 };
        return vec![Round { first: 0, count: spp, batches }];
    }
    let look = first_look(settings);
    let mut rounds = Vec::new();
    let mut first = 0;
    while first < spp {
        let count = match first {
            _ if timed && first < look => first.max(1),
            0 => look,
            // 4, 8, 12, 16, 24, 32, 48, 64, 96 and so on.
            _ if first.is_power_of_two() => (first / 2).max(4),
            _ => (first / 3).max(4),
        };
        let count = count.min(spp - first);
        rounds.push(Round { first, count, batches: count.min(BATCHES) });
        first += count;
    }
    rounds
}

/// The part of the image that is sampled: what is asked for, or, where the image's error decides, all of it in the first round.
pub fn area(settings: &ImageSettings) -> Crop {
    if settings.error_target.is_none() {
        return settings.crop;
    }
    Crop { x0: 0, y0: 0, x1: settings.width, y1: settings.height }
}

/// What is asked for with the rest of the blocks that it touches.
fn touched(settings: &ImageSettings) -> Crop {
    let Crop { x0, y0, x1, y1 } = settings.crop;
    let down = |x: u32| x / BLOCK * BLOCK;
    let up = |x: u32, most: u32| x.div_ceil(BLOCK).saturating_mul(BLOCK).min(most);
    Crop { x0: down(x0), y0: down(y0), x1: up(x1, settings.width), y1: up(y1, settings.height) }
}

/// Which pixels are still sampled.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Activity {
    /// Of the whole image.
    width: u32,
    area: Option<Crop>,
    /// One bit for each pixel of the area, row by row; empty while all are.
    bits: Vec<u64>,
}

impl Activity {
    /// All pixels of an image.
    pub fn all(settings: &ImageSettings) -> Self {
        Activity { width: settings.width, ..Activity::default() }
    }

    /// The pixels of the blocks that are asked for.
    pub fn asked(settings: &ImageSettings) -> Self {
        let Crop { x0, y0, x1, y1 } = touched(settings);
        let mut activity = Activity::none(settings, area(settings));
        (y0..y1).for_each(|y| (x0..x1).for_each(|x| activity.add(x, y)));
        activity
    }

    /// No pixels yet, of a part of the image.
    pub fn none(settings: &ImageSettings, area: Crop) -> Self {
        let pixels = area.width() as usize * area.height() as usize;
        Activity { width: settings.width, area: Some(area), bits: vec![0; pixels.div_ceil(64).max(1)] }
    }

    /// Adds a pixel of the area.
    pub fn add(&mut self, x: u32, y: u32) {
        if let Some(area) = self.area {
            let place = (y - area.y0) as usize * area.width() as usize + (x - area.x0) as usize;
            self.bits[place / 64] |= 1 << (place % 64);
        }
    }

    /// Whether none is.
    pub fn is_over(&self) -> bool {
        !self.bits.is_empty() && self.bits.iter().all(|&bits| bits == 0)
    }

    /// Whether a pixel (y * width + x) of the area is.
    #[inline]
    pub fn holds(&self, pixel: u32) -> bool {
        let Some(area) = self.area else { return true };
        let (x, y) = (pixel % self.width - area.x0, pixel / self.width - area.y0);
        let place = y as usize * area.width() as usize + x as usize;
        self.bits[place / 64] >> (place % 64) & 1 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{ErrorMetric, ErrorTarget};

    fn settings(spp: u32) -> ImageSettings {
        let target = ErrorTarget { metric: ErrorMetric::Rmse, value: 0.1 };
        ImageSettings { spp, error_target: Some(target), ..ImageSettings::sized(50, 30) }
    }

    #[test]
    fn rounds_take_each_sample_once() {
        for timed in [false, true] {
            for spp in [1, 2, 7, 16, 17, 40, 1000, 65536] {
                let rounds = schedule(&settings(spp), timed);
                let mut next = 0;
                for round in &rounds {
                    assert_eq!(round.first, next);
                    next += round.count;
                    let batches: Vec<u32> = (round.first..next).map(|sample| round.batch(sample)).collect();
                    assert!(batches.is_sorted() && (1..=MOST_BATCHES).contains(&round.batches));
                    assert_eq!((batches[0], batches[batches.len() - 1]), (0, round.batches - 1));
                }
                assert_eq!(next, spp);
                assert!(rounds.len() < 40);
            }
        }
        let starts = |settings: &ImageSettings| -> Vec<u32> {
            schedule(settings, false).iter().map(|round| round.first).collect()
        };
        let whitted = settings(200);
        assert_eq!(starts(&whitted), [0, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192]);
        let path = ImageSettings { integrator: Integrator::Path, ..whitted };
        assert_eq!(starts(&path), [0, 16, 24, 32, 48, 64, 96, 128, 192]);
    }

    #[test]
    fn blocks_are_those_of_the_image() {
        let mut settings = settings(16);
        settings.crop = Crop { x0: 9, y0: 8, x1: 49, y1: 9 };
        assert_eq!(touched(&settings), Crop { x0: 8, y0: 8, x1: 50, y1: 16 });
        assert_eq!(area(&settings), Crop { x0: 0, y0: 0, x1: 50, y1: 30 });
        let mut activity = Activity::none(&settings, touched(&settings));
        assert!(activity.is_over() && !Activity::all(&settings).is_over());
        activity.add(8, 8);
        activity.add(49, 15);
        let held: Vec<(u32, u32)> = (8..16)
            .flat_map(|y| (8..50).map(move |x| (x, y)))
            .filter(|(x, y)| activity.holds(y * 50 + x))
            .collect();
        assert_eq!(held, [(8, 8), (49, 15)]);
        assert!(!activity.is_over());
    }
}
