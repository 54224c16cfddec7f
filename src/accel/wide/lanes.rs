//! Vectors of f32 at three levels of what a processor offers. The kernels are written once over [`Instructions`].
//!
//! Nothing here decides a hit: results may differ by rounding from level to level, within the bounds that the kernels allow for.

/// Some f32 side by side.
///
/// # Safety
/// Methods may be called only where the level's instructions are there, and pointers must be valid for what is said.
pub unsafe trait Vector: Copy {
    /// How many, at most 16.
    const COUNT: usize;
    /// The numbers at `from`, aligned to their size together.
    unsafe fn load(from: *const f32) -> Self;
    /// To a place aligned to their size together.
    unsafe fn store(self, to: *mut f32);
    /// Only the lanes of the mask.
    unsafe fn store_where(self, mask: u32, to: *mut f32);
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
    unsafe fn sqrt(self) -> Self;
    /// The larger magnitude, of numbers.
    unsafe fn max_abs(self, other: Self) -> Self;
    /// self * b + c, in one or two roundings.
    unsafe fn mul_add(self, b: Self, c: Self) -> Self;
    /// self * b - c, in one or two roundings.
    unsafe fn mul_sub(self, b: Self, c: Self) -> Self;
    /// c - self * b, in one or two roundings.
    unsafe fn neg_mul_add(self, b: Self, c: Self) -> Self;
    /// A bit for each lane in which self > other.
    unsafe fn gt(self, other: Self) -> u32;
    /// The largest of all lanes, of numbers.
    unsafe fn largest(self) -> f32;
    /// A bit for each of the integers at `from`, aligned as for `load`, that is `value`.
    unsafe fn same(from: *const u32, value: u32) -> u32;
}

/// Eight f32: the children of a node, the triangles of a block.
///
/// # Safety
/// As of [`Vector`]; its count is 8.
pub unsafe trait Eight: Vector {
    /// Of the eight `children` those with self <= far, in the order that `order` names (four bits each), packed at `to_children`, with self at `to_t`. Eight places are written at
    /// both. Returns a bit for each place of the order whose child is among them.
    unsafe fn pack(
        self,
        far: Self,
        order: u32,
        children: *const u32,
        to_children: *mut u32,
        to_t: *mut f32,
    ) -> u32;

    /// Writes the eight numbers at each of `rows` as columns: the first of all at `to`, aligned as for `load`, the second `stride` numbers on, aligned too.
    unsafe fn transpose(rows: [*const f32; 8], to: *mut f32, stride: usize);

    /// The same of four rows of four f64.
    unsafe fn transpose_doubles(rows: [*const f64; 4], to: *mut f64, stride: usize);
}

/// Plain arrays: the compiler makes of them what the architecture's least processor has.
#[derive(Clone, Copy)]
pub struct Plain([f32; 8]);

/// A loop over the lanes: the compiler makes vectors of it, but not of closures.
macro_rules! each_lane {
    ($lane:ident => $value:expr) => {{
        let mut result = [0.0; 8];
        for $lane in 0..8 {
            result[$lane] = $value;
        }
        Plain(result)
    }};
}

// SAFETY: needs no instructions beyond the architecture's own.
unsafe impl Vector for Plain {
    const COUNT: usize = 8;
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller gives eight numbers.
        Plain(unsafe { from.cast::<[f32; 8]>().read() })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller gives eight places.
        unsafe { to.cast::<[f32; 8]>().write(self.0) };
    }
    #[inline(always)]
    unsafe fn store_where(self, mask: u32, to: *mut f32) {
        for k in 0..8 {
            if mask >> k & 1 == 1 {
                // SAFETY: the caller gives eight places.
                unsafe { to.add(k).write(self.0[k]) };
            }
        }
    }
    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Plain([value; 8])
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
    unsafe fn sqrt(self) -> Self {
        each_lane!(k => self.0[k].sqrt())
    }
    #[inline(always)]
    unsafe fn max_abs(self, other: Self) -> Self {
        each_lane!(k => if self.0[k].abs() > other.0[k].abs() { self.0[k].abs() } else { other.0[k].abs() })
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
    unsafe fn largest(self) -> f32 {
        let mut largest = self.0[0];
        for k in 1..8 {
            largest = if self.0[k] > largest { self.0[k] } else { largest };
        }
        largest
    }
    #[inline(always)]
    unsafe fn same(from: *const u32, value: u32) -> u32 {
        let mut mask = 0;
        for k in 0..8 {
            // SAFETY: the caller gives eight integers.
            mask |= u32::from(unsafe { *from.add(k) } == value) << k;
        }
        mask
    }
}

// SAFETY: as above.
unsafe impl Eight for Plain {
    #[inline(always)]
    unsafe fn pack(
        self,
        far: Self,
        order: u32,
        children: *const u32,
        to_children: *mut u32,
        to_t: *mut f32,
    ) -> u32 {
        let (mut mask, mut count) = (0, 0);
        for place in 0..8 {
            let k = (order >> (4 * place) & 7) as usize;
            // SAFETY: the caller gives eight children and eight places.
            unsafe {
                to_children.add(count).write(*children.add(k));
                to_t.add(count).write(self.0[k]);
            }
            let is_in = self.0[k] <= far.0[k];
            mask |= u32::from(is_in) << place;
            count += usize::from(is_in);
        }
        mask
    }

    #[inline(always)]
    unsafe fn transpose(rows: [*const f32; 8], to: *mut f32, stride: usize) {
        for column in 0..8 {
            for (row, from) in rows.iter().enumerate() {
                // SAFETY: the caller gives eight numbers of each row and eight columns.
                unsafe { to.add(column * stride + row).write(*from.add(column)) };
            }
        }
    }

    #[inline(always)]
    unsafe fn transpose_doubles(rows: [*const f64; 4], to: *mut f64, stride: usize) {
        for column in 0..4 {
            for (row, from) in rows.iter().enumerate() {
                // SAFETY: the caller gives four numbers of each row and four columns.
                unsafe { to.add(column * stride + row).write(*from.add(column)) };
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512, Sixteen};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Eight, Vector};
    use std::arch::x86_64::*;

    /// For each mask of eight places the numbers of those in it, in turn, three bits each.
    static PACKED: [u32; 256] = {
        let mut table = [0; 256];
        let mut mask = 0;
        while mask < 256 {
            let (mut place, mut count) = (0, 0);
            while place < 8 {
                if mask >> place & 1 == 1 {
                    table[mask] |= place << (3 * count);
                    count += 1;
                }
                place += 1;
            }
            mask += 1;
        }
        table
    };

    /// Eight, with AVX2 and FMA.
    #[derive(Clone, Copy)]
    pub struct Avx2(__m256);

    /// Eight, with AVX-512.
    #[derive(Clone, Copy)]
    pub struct Avx512(__m256);

    /// Sixteen, with AVX-512.
    #[derive(Clone, Copy)]
    pub struct Sixteen(__m512);

    /// The three differ in the names of what they use, and in masks. What looks like closures are patterns: the compiler doesn't always inline closures into a level.
    macro_rules! vector {
        ($level:ident, $count:literal, $load:ident, $store:ident, $splat:ident, $add:ident, $sub:ident, $mul:ident, $div:ident, $min:ident, $max:ident, $fma:ident, $fms:ident, $fnma:ident, $sqrt:ident,
         abs |$abs_of:ident| $abs:expr, max_abs |$one:ident, $two:ident| $max_abs:expr, gt |$left:ident, $right:ident| $gt:expr,
         store_where |$to:ident, $mask:ident, $stored:ident| $store_where:expr, largest |$all:ident| $largest:expr, same |$from:ident, $value:ident| $same:expr) => {
            // SAFETY: every intrinsic is of AVX2 and FMA, or of AVX-512 where the level is that; the callers see to it that they are there.
            unsafe impl Vector for $level {
                const COUNT: usize = $count;
                #[inline(always)]
                unsafe fn load(from: *const f32) -> Self {
                    // SAFETY: as said above; the numbers are the caller's promise.
                    $level(unsafe { $load(from) })
                }
                #[inline(always)]
                unsafe fn store(self, to: *mut f32) {
                    // SAFETY: as said above; the places are the caller's promise.
                    unsafe { $store(to, self.0) }
                }
                #[inline(always)]
                unsafe fn store_where(self, mask: u32, to: *mut f32) {
                    // SAFETY: as said above; the places are the caller's promise.
                    unsafe {
                        let ($to, $mask, $stored) = (to, mask, self.0);
                        $store_where
                    }
                }
                #[inline(always)]
                unsafe fn splat(value: f32) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $splat(value) })
                }
                #[inline(always)]
                unsafe fn add(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $add(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn sub(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $sub(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn mul(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $mul(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn div(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $div(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn min(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $min(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn max(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $max(self.0, other.0) })
                }
                #[inline(always)]
                unsafe fn abs(self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe {
                        let $abs_of = self.0;
                        $abs
                    })
                }
                #[inline(always)]
                unsafe fn sqrt(self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $sqrt(self.0) })
                }
                #[inline(always)]
                unsafe fn max_abs(self, other: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe {
                        let ($one, $two) = (self.0, other.0);
                        $max_abs
                    })
                }
                #[inline(always)]
                unsafe fn mul_add(self, b: Self, c: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $fma(self.0, b.0, c.0) })
                }
                #[inline(always)]
                unsafe fn mul_sub(self, b: Self, c: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $fms(self.0, b.0, c.0) })
                }
                #[inline(always)]
                unsafe fn neg_mul_add(self, b: Self, c: Self) -> Self {
                    // SAFETY: as said above.
                    $level(unsafe { $fnma(self.0, b.0, c.0) })
                }
                #[inline(always)]
                unsafe fn gt(self, other: Self) -> u32 {
                    // SAFETY: as said above.
                    unsafe {
                        let ($left, $right) = (self.0, other.0);
                        $gt
                    }
                }
                #[inline(always)]
                unsafe fn largest(self) -> f32 {
                    // SAFETY: as said above.
                    unsafe {
                        let $all = self.0;
                        $largest
                    }
                }
                #[inline(always)]
                unsafe fn same(from: *const u32, value: u32) -> u32 {
                    // SAFETY: as said above; the integers are the caller's promise.
                    unsafe {
                        let ($from, $value) = (from, value);
                        $same
                    }
                }
            }
        };
    }

    macro_rules! largest_of_eight {
        ($eight:expr) => {{
            let eight = $eight;
            let four = _mm_max_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
            let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_max_ss(two, _mm_movehdup_ps(two)))
        }};
    }

    vector!(
        Avx2,
        8,
        _mm256_load_ps,
        _mm256_store_ps,
        _mm256_set1_ps,
        _mm256_add_ps,
        _mm256_sub_ps,
        _mm256_mul_ps,
        _mm256_div_ps,
        _mm256_min_ps,
        _mm256_max_ps,
        _mm256_fmadd_ps,
        _mm256_fmsub_ps,
        _mm256_fnmadd_ps,
        _mm256_sqrt_ps,
        abs | a | _mm256_andnot_ps(_mm256_set1_ps(-0.0), a),
        max_abs | a,
        b | {
            let sign = _mm256_set1_ps(-0.0);
            _mm256_max_ps(_mm256_andnot_ps(sign, a), _mm256_andnot_ps(sign, b))
        },
        gt | a,
        b | _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(a, b)) as u32,
        store_where | to,
        mask,
        a | {
            let bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let mask = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(mask as i32), bits), bits);
            // Some processors take far longer over a masked store.
            _mm256_store_ps(to, _mm256_blendv_ps(_mm256_load_ps(to), a, _mm256_castsi256_ps(mask)));
        },
        largest | a | largest_of_eight!(a),
        same | from,
        value | {
            let same = _mm256_cmpeq_epi32(_mm256_load_si256(from.cast()), _mm256_set1_epi32(value as i32));
            _mm256_movemask_ps(_mm256_castsi256_ps(same)) as u32
        }
    );

    vector!(
        Avx512,
        8,
        _mm256_load_ps,
        _mm256_store_ps,
        _mm256_set1_ps,
        _mm256_add_ps,
        _mm256_sub_ps,
        _mm256_mul_ps,
        _mm256_div_ps,
        _mm256_min_ps,
        _mm256_max_ps,
        _mm256_fmadd_ps,
        _mm256_fmsub_ps,
        _mm256_fnmadd_ps,
        _mm256_sqrt_ps,
        abs | a | _mm256_andnot_ps(_mm256_set1_ps(-0.0), a),
        max_abs | a,
        b | _mm256_range_ps::<0b1011>(a, b),
        gt | a,
        b | u32::from(_mm256_cmp_ps_mask::<_CMP_GT_OQ>(a, b)),
        store_where | to,
        mask,
        a | _mm256_mask_store_ps(to, mask as u8, a),
        largest | a | largest_of_eight!(a),
        same | from,
        value | {
            u32::from(_mm256_cmpeq_epi32_mask(
                _mm256_load_si256(from.cast()),
                _mm256_set1_epi32(value as i32),
            ))
        }
    );

    vector!(
        Sixteen,
        16,
        _mm512_load_ps,
        _mm512_store_ps,
        _mm512_set1_ps,
        _mm512_add_ps,
        _mm512_sub_ps,
        _mm512_mul_ps,
        _mm512_div_ps,
        _mm512_min_ps,
        _mm512_max_ps,
        _mm512_fmadd_ps,
        _mm512_fmsub_ps,
        _mm512_fnmadd_ps,
        _mm512_sqrt_ps,
        abs | a | _mm512_abs_ps(a),
        max_abs | a,
        b | _mm512_range_ps::<0b1011>(a, b),
        gt | a,
        b | u32::from(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b)),
        store_where | to,
        mask,
        a | _mm512_mask_store_ps(to, mask as u16, a),
        largest
            | a
            | largest_of_eight!(_mm256_max_ps(_mm512_castps512_ps256(a), _mm512_extractf32x8_ps::<1>(a))),
        same | from,
        value | {
            u32::from(_mm512_cmpeq_epi32_mask(
                _mm512_load_si512(from.cast()),
                _mm512_set1_epi32(value as i32),
            ))
        }
    );

    macro_rules! eight {
        ($level:ident, |$near:ident, $far:ident, $order:ident| $mask:expr) => {
            // SAFETY: as of its vectors.
            unsafe impl Eight for $level {
                #[inline(always)]
                unsafe fn pack(
                    self,
                    far: Self,
                    order: u32,
                    children: *const u32,
                    to_children: *mut u32,
                    to_t: *mut f32,
                ) -> u32 {
                    // SAFETY: as said above; eight children and eight places are the caller's promise; masks are below 256.
                    unsafe {
                        // Permutations take no notice of what is above three bits.
                        let fours = _mm256_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28);
                        let order = _mm256_srlv_epi32(_mm256_set1_epi32(order as i32), fours);
                        let ($near, $far, $order) = (self.0, far.0, order);
                        let mask: u32 = $mask;
                        let packed = *PACKED.get_unchecked(mask as usize);
                        let threes = _mm256_setr_epi32(0, 3, 6, 9, 12, 15, 18, 21);
                        let places = _mm256_srlv_epi32(_mm256_set1_epi32(packed as i32), threes);
                        let lanes = _mm256_permutevar8x32_epi32(order, places);
                        let children = _mm256_loadu_si256(children.cast());
                        let children = _mm256_permutevar8x32_epi32(children, lanes);
                        _mm256_storeu_si256(to_children.cast(), children);
                        _mm256_storeu_ps(to_t, _mm256_permutevar8x32_ps(self.0, lanes));
                        mask
                    }
                }

                #[inline(always)]
                unsafe fn transpose(rows: [*const f32; 8], to: *mut f32, stride: usize) {
                    // SAFETY: as said above; eight numbers of each row and eight columns are the caller's promise.
                    unsafe {
                        // Rows 0 to 3 in the lower halves, 4 to 7 in the upper ones.
                        for half in 0..2 {
                            let mut four = [_mm256_setzero_ps(); 4];
                            for row in 0..4 {
                                let low = _mm_loadu_ps(rows[row].add(4 * half));
                                let high = _mm_loadu_ps(rows[row + 4].add(4 * half));
                                four[row] = _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(low), high);
                            }
                            let (a, b) =
                                (_mm256_unpacklo_ps(four[0], four[1]), _mm256_unpacklo_ps(four[2], four[3]));
                            let (c, d) =
                                (_mm256_unpackhi_ps(four[0], four[1]), _mm256_unpackhi_ps(four[2], four[3]));
                            let to = to.add(4 * half * stride);
                            _mm256_store_ps(to, _mm256_shuffle_ps::<0x44>(a, b));
                            _mm256_store_ps(to.add(stride), _mm256_shuffle_ps::<0xee>(a, b));
                            _mm256_store_ps(to.add(2 * stride), _mm256_shuffle_ps::<0x44>(c, d));
                            _mm256_store_ps(to.add(3 * stride), _mm256_shuffle_ps::<0xee>(c, d));
                        }
                    }
                }

                #[inline(always)]
                unsafe fn transpose_doubles(rows: [*const f64; 4], to: *mut f64, stride: usize) {
                    // SAFETY: as said above; four numbers of each row and four columns are the caller's promise.
                    unsafe {
                        // Rows 0 and 1 in the lower halves, 2 and 3 in the upper ones.
                        for half in 0..2 {
                            let mut two = [_mm256_setzero_pd(); 2];
                            for row in 0..2 {
                                let low = _mm_loadu_pd(rows[row].add(2 * half));
                                let high = _mm_loadu_pd(rows[row + 2].add(2 * half));
                                two[row] = _mm256_insertf128_pd::<1>(_mm256_castpd128_pd256(low), high);
                            }
                            let to = to.add(2 * half * stride);
                            _mm256_store_pd(to, _mm256_unpacklo_pd(two[0], two[1]));
                            _mm256_store_pd(to.add(stride), _mm256_unpackhi_pd(two[0], two[1]));
                        }
                    }
                }
            }
        };
    }

    eight!(Avx2, |near, far, order| {
        let entered = _mm256_cmp_ps::<_CMP_LE_OQ>(near, far);
        _mm256_movemask_ps(_mm256_permutevar8x32_ps(entered, order)) as u32
    });
    eight!(Avx512, |near, far, order| {
        let (near, far) = (_mm256_permutevar8x32_ps(near, order), _mm256_permutevar8x32_ps(far, order));
        u32::from(_mm256_cmp_ps_mask::<_CMP_LE_OQ>(near, far))
    });
}
