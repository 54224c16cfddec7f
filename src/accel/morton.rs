//! The place of a point along a Morton curve (Morton 1966, "A Computer Oriented Geodetic Data Base and a New Technique in File Sequencing").

/// Of a place of 21 bits an axis.
pub fn morton(place: [u32; 3]) -> u64 {
    let spread = |x: u32| {
        let mut x = u64::from(x) & 0x1f_ffff;
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(place[0]) | spread(place[1]) << 1 | spread(place[2]) << 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_morton_code_interleaves_bits() {
        assert_eq!(morton([1, 0, 0]), 1);
        assert_eq!(morton([0, 3, 0]), 0b010_010);
        assert_eq!(morton([2, 0, 1]), 0b001_100);
        assert_eq!(morton([0x1f_ffff; 3]), (1 << 63) - 1);
        for bit in 0..21 {
            assert_eq!(morton([1 << bit, 0, 0]), 1 << (3 * bit));
        }
        assert_eq!(morton([1 << 21, 0, 0]), 0);
    }
}
