//! Random numbers as pure functions of (seed, pixel, sample, path, dimension): no state, so no order and no
//! borders between tiles, threads or ranks.
//!
//! Numbers come in sets of four: two for one point of the plane, and two more. The first set is the camera's (film and lens); each
//! bounce has two.

use super::sobol;
use crate::geometry::record::RayRecord;
use crate::settings::{ImageSettings, SamplerKind};
use crate::simd::compiled;

/// Samples of camera rays whose numbers are made together.
pub const LANES: usize = 32;
/// Of fewer, one by one is as fast.
const WORTH_LANES: usize = 6;

/// The sets that a bounce has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A light and a point on it; whether the path ends.
    Light,
    /// A scattered direction.
    Bsdf,
}

/// Makes the numbers of one image.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    kind: SamplerKind,
    seed: u64,
    /// Columns and rows of the cells of a pixel's samples.
    cells: [u32; 2],
    width: u32,
    /// Digits of base 4 that number the samples of a pixel, and all pixels of the image along a Morton curve.
    sample_digits: u32,
    digits: u32,
}

impl Sampler {
    pub fn new(settings: &ImageSettings) -> Self {
        let bits = |n: u32| u32::BITS - (n - 1).leading_zeros();
        let sample_digits = bits(settings.spp).div_ceil(2);
        let digits = sample_digits + bits(settings.width.max(settings.height));
        let ImageSettings { sampler: kind, seed, spp, width, .. } = *settings;
        let columns = (1..=spp.isqrt()).rev().find(|columns| spp.is_multiple_of(*columns)).unwrap_or(1);
        Sampler { kind, seed, cells: [columns, spp / columns], width, sample_digits, digits }
    }

    /// Four numbers in [0, 1) for a sample's camera ray: the film position, then the lens. `sample` < 65536.
    pub fn camera(&self, pixel: u32, sample: u32) -> [f64; 4] {
        self.set(pixel, sample, 1, 0)
    }

    /// As [`camera`](Self::camera) for the first `count` of these samples.
    ///
    /// # Panics
    /// `count` above [`LANES`].
    pub fn cameras(&self, samples: &mut Cameras, count: usize) {
        if self.kind == SamplerKind::Sobol && count >= WORTH_LANES {
            sobol_cameras(samples, self.seed);
            return;
        }
        for lane in 0..count {
            let own = self.camera(samples.pixel[lane], samples.sample[lane]);
            for number in 0..4 {
                samples.numbers[number][lane] = own[number];
            }
        }
    }

    /// Four numbers in [0, 1) for the bounce that ends this ray.
    pub fn bounce(&self, record: &RayRecord, purpose: Purpose) -> [f64; 4] {
        let set = 1 + 2 * record.bounce + purpose as u32;
        self.set(record.pixel, record.sample, record.path, set)
    }

    /// As [`bounce`](Self::bounce) for many rays side by side: `[number][lane]`.
    #[inline(always)]
    pub fn bounces<const N: usize>(&self, rays: &Branches<N>, purpose: Purpose) -> [[f64; N]; 4] {
        if self.kind != SamplerKind::Sobol {
            let mut numbers = [[0.0; N]; 4];
            self.bounces_in_turn(rays, purpose, &mut numbers);
            return numbers;
        }
        let mut scrambles = [0; N];
        for lane in 0..N {
            let set = 1 + 2 * rays.bounce[lane] + purpose as u32;
            let salt = salt(rays.path[lane], set);
            scrambles[lane] = hash(hash(self.seed, u64::from(rays.pixel[lane])), salt) as u32;
        }
        sobol_numbers(rays.sample, scrambles)
    }

    /// Kept out of the loops that are made vectors of.
    #[inline(never)]
    fn bounces_in_turn<const N: usize>(
        &self,
        rays: &Branches<N>,
        purpose: Purpose,
        numbers: &mut [[f64; N]; 4],
    ) {
        for lane in 0..N {
            let set = 1 + 2 * rays.bounce[lane] + purpose as u32;
            let own = self.set(rays.pixel[lane], rays.sample[lane], rays.path[lane], set);
            for number in 0..4 {
                numbers[number][lane] = own[number];
            }
        }
    }

    fn set(&self, pixel: u32, sample: u32, path: u64, set: u32) -> [f64; 4] {
        let pixel_hash = hash(self.seed, u64::from(pixel));
        let salt = salt(path, set);
        match self.kind {
            SamplerKind::Sobol => {
                let scramble = if salt == 0 { pixel_hash } else { hash(pixel_hash, salt) };
                let [a, b, c, d] = sobol::point(sample, scramble as u32);
                [f64::from(a), f64::from(b), f64::from(c), f64::from(d)]
            }
            SamplerKind::Independent => {
                let state = hash(hash(pixel_hash, salt), u64::from(sample));
                [0, 1, 2, 3].map(|k| unit(hash(state, k)))
            }
            SamplerKind::Stratified => {
                let key = hash(pixel_hash, salt);
                let pair = |k: u64| {
                    jittered(sample, self.cells, hash(key, k), hash(hash(key, k + 2), u64::from(sample)))
                };
                let ([a, b], [c, d]) = (pair(0), pair(1));
                [a, b, c, d]
            }
            SamplerKind::Blue => {
                let index = self.morton_index(pixel, sample);
                let key = hash(hash(self.seed, 0x626c_7565), salt);
                let pair = |k: u64| self.along_curve(index, hash(key, k));
                let ([a, b], [c, d]) = (pair(0), pair(1));
                [a, b, c, d]
            }
        }
    }

    /// The number of a sample among those of all pixels along a Morton curve.
    fn morton_index(&self, pixel: u32, sample: u32) -> u64 {
        let (x, y) = (pixel % self.width, pixel / self.width);
        (spread(x) | spread(y) << 1) << (2 * self.sample_digits) | u64::from(sample)
    }

    /// A point of the (0, 2)-sequence, whose order along the curve is permuted within every square of pixels and again within those (Ahmed and Wonka
    /// 2020, "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error via Hierarchical Ordering of Pixels").
    fn along_curve(&self, index: u64, key: u64) -> [f64; 2] {
        let mut shuffled = 0;
        for place in (0..self.digits).rev() {
            let digit = index >> (2 * place) & 3;
            let above = index >> (2 * place) >> 2;
            let order = (hash(key ^ u64::from(place) << 48, above) >> 24) % 24;
            shuffled |= u64::from(PERMUTATIONS[order as usize][digit as usize]) << (2 * place);
        }
        let points = [shuffled, second_sobol_dimension(shuffled)];
        [0, 1].map(|k| owen_scrambled(points[k], hash(key, 7 + k as u64)))
    }
}

/// Sobol's points of many samples side by side: `[number][lane]`.
#[inline(always)]
fn sobol_numbers<const N: usize>(samples: [u32; N], scrambles: [u32; N]) -> [[f64; N]; 4] {
    let points = sobol::points(samples, scrambles);
    let mut numbers = [[0.0; N]; 4];
    for number in 0..4 {
        for lane in 0..N {
            numbers[number][lane] = f64::from(points[number][lane]);
        }
    }
    numbers
}

/// Samples of camera rays side by side, and their numbers: `[number][lane]`.
#[derive(Clone, Debug, Default)]
pub struct Cameras {
    pub pixel: [u32; LANES],
    pub sample: [u32; LANES],
    pub numbers: [[f64; LANES]; 4],
}

compiled! {
    fn sobol_cameras(samples: &mut Cameras, seed: u64) = Cameras::sobol;
}

impl Cameras {
    /// Takes samples of pixels, at most so many and at most [`LANES`]; how many.
    pub fn take(&mut self, samples: &mut impl Iterator<Item = (u32, u32)>, most: usize) -> usize {
        let mut count = 0;
        for (pixel, sample) in samples.take(most.min(LANES)) {
            (self.pixel[count], self.sample[count]) = (pixel, sample);
            count += 1;
        }
        count
    }

    /// Set 0 of the first path, whose salt is 0.
    #[inline(always)]
    fn sobol(&mut self, seed: u64) {
        let mut scrambles = [0; LANES];
        for lane in 0..LANES {
            scrambles[lane] = hash(seed, u64::from(self.pixel[lane])) as u32;
        }
        self.numbers = sobol_numbers(self.sample, scrambles);
    }
}

/// What rays' numbers depend on, side by side.
#[derive(Clone, Copy, Debug)]
pub struct Branches<const N: usize> {
    pub pixel: [u32; N],
    pub sample: [u32; N],
    pub path: [u64; N],
    pub bounce: [u32; N],
}

/// What tells apart all sets but the first one: that is the camera's, on the one path there is then, and has 0.
#[inline(always)]
fn salt(path: u64, set: u32) -> u64 {
    u64::from(set) | (path - 1) << 32
}

/// The 53 upper bits as a number in [0, 1).
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
}

/// Mixes two words (the finaliser of SplitMix64; Steele, Lea and Flood 2014).
#[inline(always)]
fn hash(a: u64, b: u64) -> u64 {
    let mut z = a.wrapping_add((b.wrapping_add(1)).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A point at a random place of one of the cells that cover the unit square, each of them that of one sample. Within a column of cells no two points share
/// a part of its width, within a row none of its height (Kensler 2013, section 3).
fn jittered(index: u32, [columns, rows]: [u32; 2], key: u64, jitter: u64) -> [f64; 2] {
    let cell = permuted(index, columns * rows, key as u32);
    let (column, row) = (cell % columns, cell / columns);
    let sub_row = permuted(row, rows, (key >> 32) as u32 ^ 0x51);
    let sub_column = permuted(column, columns, (key >> 32) as u32 ^ 0xa3);
    let [jx, jy] = [jitter & 0xffff_ffff, jitter >> 32].map(|bits| bits as f64 / 4_294_967_296.0);
    let x = (f64::from(column) + (f64::from(sub_row) + jx) / f64::from(rows)) / f64::from(columns);
    let y = (f64::from(row) + (f64::from(sub_column) + jy) / f64::from(columns)) / f64::from(rows);
    [x, y]
}

/// Place `index` of a random permutation of `0 .. length` (Kensler 2013, section 3.2): a hash that maps the next power of two onto itself, walked until it comes
/// back below `length`.
fn permuted(index: u32, length: u32, key: u32) -> u32 {
    let mask = length.next_power_of_two() - 1;
    let mut i = index;
    loop {
        i ^= key;
        i = i.wrapping_mul(0xe170_893d);
        i ^= key >> 16;
        i ^= (i & mask) >> 4;
        i ^= key >> 8;
        i = i.wrapping_mul(0x0929_eb3f);
        i ^= key >> 23;
        i ^= (i & mask) >> 1;
        i = i.wrapping_mul(1 | key >> 27);
        i = i.wrapping_mul(0x6935_fa69);
        i ^= (i & mask) >> 11;
        i = i.wrapping_mul(0x74dc_b303);
        i ^= (i & mask) >> 2;
        i = i.wrapping_mul(0x9e50_1cc3);
        i ^= (i & mask) >> 2;
        i = i.wrapping_mul(0xc860_a3df);
        i &= mask;
        i ^= i >> 5;
        if i < length {
            return i.wrapping_add(key) % length;
        }
    }
}

/// Bits of a 32-bit number, each with a 0 above it.
fn spread(x: u32) -> u64 {
    let mut bits = u64::from(x);
    for (shift, mask) in [
        (16, 0x0000_ffff_0000_ffff),
        (8, 0x00ff_00ff_00ff_00ff),
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555),
    ] {
        bits = (bits | bits << shift) & mask;
    }
    bits
}

/// All permutations of four things.
const PERMUTATIONS: [[u8; 4]; 24] = permutations_of_four();

const fn permutations_of_four() -> [[u8; 4]; 24] {
    let mut all = [[0; 4]; 24];
    let (mut code, mut count) = (0, 0);
    // Of all four-digit numbers of base 4 those that have each digit.
    while code < 256 {
        let digits = [code >> 6 & 3, code >> 4 & 3, code >> 2 & 3, code & 3];
        if 1 << digits[0] | 1 << digits[1] | 1 << digits[2] | 1 << digits[3] == 15 {
            all[count] = [digits[0] as u8, digits[1] as u8, digits[2] as u8, digits[3] as u8];
            count += 1;
        }
        code += 1;
    }
    all
}

/// The second dimension of Sobol's sequence, its bits after the point from the lowest up: Σ (1 + x)^j over the bits j of the index, as a polynomial over {0, 1}. As
/// (1 + x)^32 = 1 + x^32 there, and so on for each half, the sum takes six steps.
fn second_sobol_dimension(index: u64) -> u64 {
    let mut bits = index;
    bits ^= bits >> 32;
    bits ^= (bits >> 16) & 0x0000_ffff_0000_ffff;
    bits ^= (bits >> 8) & 0x00ff_00ff_00ff_00ff;
    bits ^= (bits >> 4) & 0x0f0f_0f0f_0f0f_0f0f;
    bits ^= (bits >> 2) & 0x3333_3333_3333_3333;
    bits ^ ((bits >> 1) & 0x5555_5555_5555_5555)
}

/// A number in [0, 1) from its first 32 bits after the point, the lowest one first, scrambled by a hash that lets each bit depend only on those before it (Owen's scrambling after Laine
/// and Karras 2011; the constants are Vegdahl's, 2021).
fn owen_scrambled(bits: u64, key: u64) -> f64 {
    let mut x = bits as u32;
    let seed = key as u32;
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    f64::from(x.reverse_bits()) * (1.0 / 4_294_967_296.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [SamplerKind; 4] =
        [SamplerKind::Independent, SamplerKind::Stratified, SamplerKind::Sobol, SamplerKind::Blue];

    fn sampler(kind: SamplerKind, spp: u32, seed: u64) -> Sampler {
        Sampler::new(&ImageSettings { sampler: kind, spp, seed, ..ImageSettings::sized(64, 48) })
    }

    fn cells(points: impl Iterator<Item = [f64; 2]>, columns: u32, rows: u32) -> Vec<u32> {
        let mut cells = vec![0; (columns * rows) as usize];
        for [x, y] in points {
            assert!((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y));
            let (column, row) = ((x * f64::from(columns)) as u32, (y * f64::from(rows)) as u32);
            cells[(row * columns + column) as usize] += 1;
        }
        cells
    }

    #[test]
    fn samples_of_a_pixel_are_stratified_and_pixels_differ() {
        for kind in [SamplerKind::Sobol, SamplerKind::Blue, SamplerKind::Stratified] {
            let sampler = sampler(kind, 64, 3);
            for pixel in [0, 7, 3071] {
                for first in [0, 2] {
                    let points = || {
                        (0..64).map(|sample| sampler.camera(pixel, sample)).map(|n| [n[first], n[first + 1]])
                    };
                    let shapes: &[[u32; 2]] = match kind {
                        SamplerKind::Stratified => &[[8, 8], [64, 1], [1, 64]],
                        // The third and fourth dimension of Sobol's sequence are no (0, 2)-sequence.
                        SamplerKind::Sobol if first == 2 => &[[64, 1], [1, 64]],
                        _ => &[[8, 8], [64, 1], [16, 4], [1, 64]],
                    };
                    for &[columns, rows] in shapes {
                        assert_eq!(
                            cells(points(), columns, rows),
                            [1; 64],
                            "{kind:?}, {pixel}, {columns} x {rows}"
                        );
                    }
                }
            }
            assert_ne!(sampler.camera(0, 0), sampler.camera(1, 0));
        }
    }

    #[test]
    fn stratified_samples_of_any_number_fill_their_cells() {
        for spp in [1, 2, 5, 6, 7, 12, 30, 97] {
            let sampler = sampler(SamplerKind::Stratified, spp, 1);
            let [columns, rows] = sampler.cells;
            let points = (0..spp).map(|sample| sampler.camera(5, sample)).map(|[x, y, ..]| [x, y]);
            assert_eq!(cells(points, columns, rows), vec![1; spp as usize], "{spp}");
        }
    }

    #[test]
    fn one_sample_each_of_neighbouring_pixels_is_well_spread_in_blue() {
        let sampler = sampler(SamplerKind::Blue, 1, 9);
        for (x0, y0, size) in [(0, 0, 8), (8, 40, 8), (16, 32, 16), (44, 20, 4)] {
            let pixels = (0..size * size).map(|i| (y0 + i / size) * 64 + x0 + i % size);
            let points = pixels.map(|pixel| sampler.camera(pixel, 0)).map(|[x, y, ..]| [x, y]);
            assert_eq!(cells(points, size, size), vec![1; (size * size) as usize], "{x0}, {y0}");
        }
    }

    #[test]
    fn every_set_seed_and_path_has_its_own_numbers() {
        for kind in KINDS {
            let sampler_0 = sampler(kind, 16, 0);
            let mut seen = vec![sampler_0.camera(40, 3), sampler(kind, 16, 1).camera(40, 3)];
            for bounce in 0..5 {
                for path in [1, 2] {
                    let mut record = RayRecord::camera(glam::DVec3::ZERO, glam::DVec3::X, 40, 3, 0);
                    (record.bounce, record.path) = (bounce, path);
                    seen.push(sampler_0.bounce(&record, Purpose::Light));
                    seen.push(sampler_0.bounce(&record, Purpose::Bsdf));
                }
            }
            seen.sort_by(|a, b| a.partial_cmp(b).unwrap());
            assert!(seen.windows(2).all(|pair| pair[0] != pair[1]), "{kind:?}");
        }
    }

    /// Of every kind: means, and covariances between dimensions, sets and neighbouring pixels, of what is drawn for 64 seeds are those of independent uniform numbers, within
    /// five standard errors.
    #[test]
    fn numbers_are_uniform_and_pixels_uncorrelated() {
        for kind in KINDS {
            let mut sums = [[0.0; 12]; 12];
            let mut means = [0.0; 12];
            let mut n = 0.0;
            for seed in 0..64 {
                let sampler = sampler(kind, 4, seed);
                for pixel in (0..3000).step_by(119) {
                    let mut record = RayRecord::camera(glam::DVec3::ZERO, glam::DVec3::X, pixel, 2, 0);
                    record.bounce = 1;
                    let [a, b, c, d] = sampler.camera(pixel, 2);
                    let [e, f, g, h] = sampler.camera(pixel + 1, 2);
                    let [i, j, k, l] = sampler.bounce(&record, Purpose::Bsdf);
                    let drawn = [a, b, c, d, e, f, g, h, i, j, k, l].map(|u| u - 0.5);
                    for row in 0..12 {
                        means[row] += drawn[row];
                        for column in 0..row {
                            sums[row][column] += drawn[row] * drawn[column];
                        }
                    }
                    n += 1.0;
                }
            }
            // Neighbours in blue are spread apart on purpose: they avoid each other, and are not tested.
            let spread_apart =
                |row: usize, column: usize| kind == SamplerKind::Blue && row / 4 == 1 && column / 4 == 0;
            for row in 0..12 {
                assert!(f64::abs(means[row] / n) < 5.0 / f64::sqrt(12.0 * n), "{kind:?}, mean {row}");
                for column in (0..row).filter(|&column| !spread_apart(row, column)) {
                    let covariance = sums[row][column] / n;
                    assert!(
                        covariance.abs() < 5.0 / 12.0 / n.sqrt(),
                        "{kind:?}, {row}, {column}: {covariance}"
                    );
                }
            }
        }
    }
}
