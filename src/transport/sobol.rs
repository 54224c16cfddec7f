//! Points of the Owen-scrambled Sobol sequence in four dimensions: the numbers of `sobol_burley::sample_4d` (Burley 2020, "Practical Hash-based
//! Owen Scrambling"), from tables in place of a loop over the bits of the index.

use std::sync::LazyLock;

use sobol_burley::parts::{Int4, hash, hash_int4, owen_scramble_int4_rev, owen_scramble_rev, sobol_rev};

/// Bits of an index that count, and of them those that one look into a table takes.
const BITS: u32 = 16;
const BYTE: u32 = 8;

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
pub fn point(index: u32, seed: u32) -> [f32; 4] {
    let shuffled = owen_scramble_rev(index.reverse_bits(), hash(seed ^ 0x79c6_8e4a));
    let [upper, lower] = &*TABLES;
    let [a, b, c, d] = upper[(shuffled >> (u32::BITS - BYTE)) as usize];
    let [e, f, g, h] = lower[(shuffled >> (u32::BITS - BITS)) as usize & 0xff];
    let bits: Int4 = [a ^ e, b ^ f, c ^ g, d ^ h].into();
    let seed: Int4 = [seed.wrapping_mul(0x9c8f_2d3b); 4].into();
    let scramble = seed ^ [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8].into();
    owen_scramble_int4_rev(bits, hash_int4(scramble)).reverse_bits().to_f32_norm()
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
