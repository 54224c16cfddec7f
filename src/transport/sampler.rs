//! Random numbers as pure functions of (seed, pixel, sample, path, dimension): no state, so no order and no
//! borders between tiles, threads or ranks.

/// Two numbers in [0, 1) for a pixel's film position: the first two dimensions of an Owen-scrambled Sobol sequence (Burley
/// 2020, "Practical Hash-based Owen Scrambling"), scrambled anew for each pixel. `sample` < 65536.
pub fn film_position(seed: u64, pixel: u32, sample: u32) -> [f64; 2] {
    let scramble = hash(seed, u64::from(pixel)) as u32;
    [0, 1].map(|dimension| f64::from(sobol_burley::sample(sample, dimension, scramble)))
}

/// Mixes two words (the finaliser of SplitMix64; Steele, Lea and Flood 2014).
fn hash(a: u64, b: u64) -> u64 {
    let mut z = a.wrapping_add((b.wrapping_add(1)).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_a_pixel_are_stratified_and_pixels_differ() {
        for pixel in [0, 7, 1_000_000] {
            let mut cells = [0; 64];
            for sample in 0..64 {
                let [x, y] = film_position(3, pixel, sample);
                cells[(x * 8.0) as usize + 8 * (y * 8.0) as usize] += 1;
            }
            assert_eq!(cells, [1; 64], "pixel {pixel}");
        }
        assert_ne!(film_position(3, 0, 0), film_position(3, 1, 0));
        assert_ne!(film_position(3, 0, 0), film_position(4, 0, 0));
    }
}
