//! Eight f32 at once, at three levels of what a processor offers. The kernels are written once over [`Lanes`].
//!
//! Nothing here decides a hit: results may differ by rounding from level to level, within the bounds that the kernels allow for.

/// Eight f32.
///
/// # Safety
/// Methods may be called only where the level's instructions are there, and pointers must be valid for what is said.
pub unsafe trait Lanes: Copy {
    /// Eight numbers at `from`, aligned to 32 bytes.
    unsafe fn load(from: *const f32) -> Self;
    unsafe fn splat(value: f32) -> Self;
    unsafe fn add(self, other: Self) -> Self;
    unsafe fn sub(self, other: Self) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn div(self, other: Self) -> Self;
    /// NaN gives `other`.
    unsafe fn min(self, other: Self) -> Self;
    /// NaN gives `other`.
    unsafe fn max(self, other: Self) -> Self;
    unsafe fn abs(self) -> Self;
    /// self * b + c, in one or two roundings.
    unsafe fn mul_add(self, b: Self, c: Self) -> Self;
    /// self * b - c, in one or two roundings.
    unsafe fn mul_sub(self, b: Self, c: Self) -> Self;
    /// c - self * b, in one or two roundings.
    unsafe fn neg_mul_add(self, b: Self, c: Self) -> Self;
    /// A bit for each lane in which self > other.
    unsafe fn gt(self, other: Self) -> u32;
    unsafe fn to_array(self) -> [f32; 8];
    /// Of the eight `children` those with self <= far, in the order that `order` names (four bits each), packed at `to_children`, with self at `to_t`.
    /// Returns their number. Eight places are written at both.
    unsafe fn pack(
        self,
        far: Self,
        order: u32,
        children: *const u32,
        to_children: *mut u32,
        to_t: *mut f32,
    ) -> usize;
}

/// Plain arrays: the compiler makes of them what the architecture's least processor has.
#[derive(Clone, Copy)]
pub struct Baseline([f32; 8]);

/// A loop over the lanes: the compiler makes vectors of it, but not of closures.
macro_rules! each_lane {
    ($lane:ident => $value:expr) => {{
        let mut result = [0.0; 8];
        for $lane in 0..8 {
            result[$lane] = $value;
        }
        Baseline(result)
    }};
}

// SAFETY: needs no instructions beyond the architecture's own.
unsafe impl Lanes for Baseline {
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller gives eight numbers.
        Baseline(unsafe { from.cast::<[f32; 8]>().read() })
    }
    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Baseline([value; 8])
    }
    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        each_lane!(k => self.0[k] + other.0[k])
    }
    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        each_lane!(k => self.0[k] - other.0[k])
    }
    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        each_lane!(k => self.0[k] * other.0[k])
    }
    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        each_lane!(k => self.0[k] / other.0[k])
    }
    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        each_lane!(k => if self.0[k] < other.0[k] { self.0[k] } else { other.0[k] })
    }
    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        each_lane!(k => if self.0[k] > other.0[k] { self.0[k] } else { other.0[k] })
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        each_lane!(k => self.0[k].abs())
    }
    #[inline(always)]
    unsafe fn mul_add(self, b: Self, c: Self) -> Self {
        each_lane!(k => self.0[k] * b.0[k] + c.0[k])
    }
    #[inline(always)]
    unsafe fn mul_sub(self, b: Self, c: Self) -> Self {
        each_lane!(k => self.0[k] * b.0[k] - c.0[k])
    }
    #[inline(always)]
    unsafe fn neg_mul_add(self, b: Self, c: Self) -> Self {
        each_lane!(k => c.0[k] - self.0[k] * b.0[k])
    }
    #[inline(always)]
    unsafe fn gt(self, other: Self) -> u32 {
        let mut mask = 0;
        for k in 0..8 {
            mask |= u32::from(self.0[k] > other.0[k]) << k;
        }
        mask
    }
    #[inline(always)]
    unsafe fn to_array(self) -> [f32; 8] {
        self.0
    }
    #[inline(always)]
    unsafe fn pack(
        self,
        far: Self,
        order: u32,
        children: *const u32,
        to_children: *mut u32,
        to_t: *mut f32,
    ) -> usize {
        let mut count = 0;
        for place in 0..8 {
            let k = (order >> (4 * place) & 7) as usize;
            // SAFETY: the caller gives eight children and eight places.
            unsafe {
                to_children.add(count).write(*children.add(k));
                to_t.add(count).write(self.0[k]);
            }
            count += usize::from(self.0[k] <= far.0[k]);
        }
        count
    }
}

#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Lanes;
    use std::arch::x86_64::*;

    /// For each mask of eight lanes the numbers of its lanes, in turn, a byte each.
    static PACKED: [u64; 256] = packed();

    const fn packed() -> [u64; 256] {
        let mut table = [0; 256];
        let mut mask = 0;
        while mask < 256 {
            let (mut lane, mut place) = (0, 0);
            while lane < 8 {
                if mask >> lane & 1 == 1 {
                    table[mask] |= (lane as u64) << (8 * place);
                    place += 1;
                }
                lane += 1;
            }
            mask += 1;
        }
        table
    }

    #[derive(Clone, Copy)]
    pub struct Avx2(__m256);

    #[derive(Clone, Copy)]
    pub struct Avx512(__m256);

    /// Both levels share what is done on 256 bits; they differ in masks and packing.
    macro_rules! lanes {
        ($level:ident, $gt:expr, $pack:expr) => {
            // SAFETY: every intrinsic is of AVX2 and FMA, or of AVX-512 where the level is that; the callers see to it that they are there.
            unsafe impl Lanes for $level {
                #[inline(always)]
                unsafe fn load(from: *const f32) -> Self {
                    // SAFETY: as said above; eight aligned numbers are the caller's promise.
                    $level(unsafe { _mm256_load_ps(from) })
                }
                #[inline(always)]
                unsafe fn splat(value: f32) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_set1_ps(value) })
                }
                #[inline(always)]
                unsafe fn add(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_add_ps(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn sub(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_sub_ps(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn mul(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_mul_ps(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn div(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_div_ps(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn min(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_min_ps(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn max(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_max_ps(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn abs(self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
                }
                #[inline(always)]
                unsafe fn mul_add(self, b: Self, c: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_fmadd_ps(self.0, b.0, c.0) })
                }
                #[inline(always)]
                unsafe fn mul_sub(self, b: Self, c: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_fmsub_ps(self.0, b.0, c.0) })
                }
                #[inline(always)]
                unsafe fn neg_mul_add(self, b: Self, c: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { _mm256_fnmadd_ps(self.0, b.0, c.0) })
                }
                #[inline(always)]
                unsafe fn gt(self, other: Self) -> u32 {
                    // SAFETY: as said above.
                    unsafe { $gt(self.0, other.0) }
                }
                #[inline(always)]
                unsafe fn to_array(self) -> [f32; 8] {
                    let mut array = [0.0; 8];
                    // SAFETY: as said above; the array has eight places.
                    unsafe { _mm256_storeu_ps(array.as_mut_ptr(), self.0) };
                    array
                }
                #[inline(always)]
                unsafe fn pack(
                    self,
                    far: Self,
                    order: u32,
                    children: *const u32,
                    to_children: *mut u32,
                    to_t: *mut f32,
                ) -> usize {
                    // SAFETY: as said above; eight children and eight places are the caller's promise.
                    unsafe {
                        let shifts = _mm256_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28);
                        let order = _mm256_srlv_epi32(_mm256_set1_epi32(order as i32), shifts);
                        let near = _mm256_permutevar8x32_ps(self.0, order);
                        let far = _mm256_permutevar8x32_ps(far.0, order);
                        let children =
                            _mm256_permutevar8x32_epi32(_mm256_loadu_si256(children.cast()), order);
                        $pack(near, far, children, to_children, to_t)
                    }
                }
            }
        };
    }

    lanes!(
        Avx2,
        |a, b| _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(a, b)) as u32,
        |near, far, children, to_children: *mut u32, to_t: *mut f32| {
            let mask = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, far)) as usize;
            let lanes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(PACKED[mask] as i64));
            _mm256_storeu_si256(to_children.cast(), _mm256_permutevar8x32_epi32(children, lanes));
            _mm256_storeu_ps(to_t, _mm256_permutevar8x32_ps(near, lanes));
            mask.count_ones() as usize
        }
    );

    lanes!(
        Avx512,
        |a, b| u32::from(_mm256_cmp_ps_mask::<_CMP_GT_OQ>(a, b)),
        |near, far, children, to_children: *mut u32, to_t: *mut f32| {
            let mask = _mm256_cmp_ps_mask::<_CMP_LE_OQ>(near, far);
            _mm256_storeu_si256(to_children.cast(), _mm256_maskz_compress_epi32(mask, children));
            _mm256_storeu_ps(to_t, _mm256_maskz_compress_ps(mask, near));
            mask.count_ones() as usize
        }
    );
}
