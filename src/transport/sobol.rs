//! Points of the Owen-scrambled Sobol sequence in four dimensions: the numbers of `sobol_burley::sample_4d` (Burley 2020, "Practical Hash-based
//! Owen Scrambling"), from tables in place of a loop over the bits of the index.

use std::sync::LazyLock;

use sobol_burley::parts::{hash, owen_scramble_rev, sobol_rev, u32_to_f32_norm};

/// Bits of an index that count, and of them those that one look into a table takes.
const BITS: u32 = 16;
const BYTE: u32 = 8;

/// What tells the dimensions' scrambles apart.
const SALTS: [u32; 4] = [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8];

type Table = [[u32; 4]; 1 << BYTE];

/// The sequence's bits, reversed, for the upper and the lower byte of a reversed index. A point is the sum (exclusive or) of what each bit of its index adds.
static TABLES: LazyLock<[Table; 2]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        std::array::from_fn(|bits| {
            let index = (bits as u32) << (u32::BITS - BYTE * (byte as u32 + 1));
            std::array::from_fn(|dimension| sobol_rev(index, dimension as u32))
        })
    })
});

/// Four numbers in [0, 1) for `index` < 2^16; other seeds give other scrambles of the sequence, in another order.
#[inline]
pub fn point(index: u32, seed: u32) -> [f32; 4] {
    let [[a], [b], [c], [d]] = points([index], [seed]);
    [a, b, c, d]
}

/// As [`point`] for many side by side: `[dimension][lane]`. Loops are written so that the compiler makes vectors of them.
#[inline(always)]
pub fn points<const N: usize>(indices: [u32; N], seeds: [u32; N]) -> [[f32; N]; 4] {
    let [upper, lower] = &*TABLES;
    let mut shuffled = [0; N];
    for lane in 0..N {
        shuffled[lane] = owen_scramble_rev(indices[lane].reverse_bits(), hash(seeds[lane] ^ 0x79c6_8e4a));
    }
    let mut bits = [[0; N]; 4];
    for lane in 0..N {
        let above = &upper[(shuffled[lane] >> (u32::BITS - BYTE)) as usize];
        let below = &lower[(shuffled[lane] >> (u32::BITS - BITS)) as usize & 0xff];
        for dimension in 0..4 {
            bits[dimension][lane] = above[dimension] ^ below[dimension];
        }
    }
    let mut numbers = [[0.0; N]; 4];
    for dimension in 0..4 {
        for lane in 0..N {
            let scramble = hash(seeds[lane].wrapping_mul(0x9c8f_2d3b) ^ SALTS[dimension]);
            let scrambled = owen_scramble_rev(bits[dimension][lane], scramble);
            numbers[dimension][lane] = u32_to_f32_norm(scrambled.reverse_bits());
        }
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_crate() {
        for seed in [0, 1, 2, 0x8000_0001, u32::MAX] {
            for index in (0..1 << BITS).step_by(7).chain([65_535]) {
                assert_eq!(point(index, seed), sobol_burley::sample_4d(index, 0, seed), "{index} {seed}");
            }
        }
    }
}
