//! The f32 filters for other structures: of a few primitives those that f64 has to look at.

use super::filter::{FilterRay, holds};
use super::lanes::{Eight, Plain};
use super::tree::{Block, WIDTH, put};
use crate::geometry::{NONE, Prepared, norm_max, round_down, round_up};
use crate::scene::Surfaces;
use crate::simd::Level;

/// A ray that sifts primitives.
pub struct Sieve {
    level: Level,
    filter: FilterRay,
    t_min: f32,
    /// Whether f32 can hold the numbers.
    holds: bool,
}

/// Primitives side by side, as in a block.
type Corners = [[[f32; WIDTH]; 3]; 3];

#[repr(align(32))]
struct Aligned(Corners);

impl Sieve {
    /// `extent` is the largest magnitude of a coordinate of the scene's box.
    pub fn new(level: Level, ray: &Prepared, extent: f64) -> Sieve {
        let length = norm_max(ray.origin) + extent;
        let filter = FilterRay::new(ray, length);
        Sieve { level, filter, t_min: round_down(ray.t_min), holds: holds(length) }
    }

    /// A bit for each of up to eight primitives, all triangles or all spheres, that the ray may meet up to `limit`.
    pub fn survivors(&self, surfaces: &Surfaces, ids: &[u32], limit: f64) -> u32 {
        let ids = &ids[..ids.len().min(WIDTH)];
        let wanted = (1u32 << ids.len()) - 1;
        let Some(&first) = ids.first().filter(|_| self.holds) else { return wanted };
        let are_spheres = surfaces.sphere_at(first).is_some();
        let mut corners = Aligned([[[0.0; WIDTH]; 3]; 3]);
        for (lane, &id) in ids.iter().enumerate() {
            put(&mut corners.0, lane, surfaces, id);
        }
        // SAFETY: these corners are aligned.
        unsafe { self.sift(&corners.0, are_spheres, limit, wanted) }
    }

    /// The same of a block, whose missing primitives are [`NONE`].
    #[inline]
    pub fn survivors_of(&self, block: &Block, are_spheres: bool, limit: f64) -> u32 {
        let wanted = (0..WIDTH).fold(0, |wanted, lane| wanted | u32::from(block.ids[lane] != NONE) << lane);
        if !self.holds {
            return wanted;
        }
        // SAFETY: a block is aligned to 64 bytes and begins with its corners.
        unsafe { self.sift(&block.corners, are_spheres, limit, wanted) }
    }

    /// # Safety
    /// The corners are aligned to 32 bytes.
    #[inline]
    unsafe fn sift(&self, corners: &Corners, are_spheres: bool, limit: f64, wanted: u32) -> u32 {
        let limit = round_up(limit);
        // SAFETY: only levels that the processor has are made sieves for; the rest is the caller's promise.
        let out = unsafe {
            match self.level {
                #[cfg(target_arch = "x86_64")]
                Level::Avx2 => self.out_avx2(corners, are_spheres, limit, wanted),
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => self.out_avx512(corners, are_spheres, limit, wanted),
                _ => self.out::<Plain>(corners, are_spheres, limit, wanted),
            }
        };
        wanted & !out
    }

    /// # Safety
    /// The processor has AVX2 and FMA; the corners are aligned to 32 bytes.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn out_avx2(&self, corners: &Corners, are_spheres: bool, limit: f32, wanted: u32) -> u32 {
        // SAFETY: the caller's promise.
        unsafe { self.out::<super::lanes::Avx2>(corners, are_spheres, limit, wanted) }
    }

    /// # Safety
    /// The processor has AVX-512 F, VL, DQ and BW; the corners are aligned to 32 bytes.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512dq,avx512bw")]
    unsafe fn out_avx512(&self, corners: &Corners, are_spheres: bool, limit: f32, wanted: u32) -> u32 {
        // SAFETY: the caller's promise.
        unsafe { self.out::<super::lanes::Avx512>(corners, are_spheres, limit, wanted) }
    }

    /// # Safety
    /// The level's instructions are there; the corners are aligned to 32 bytes.
    #[inline(always)]
    unsafe fn out<E: Eight>(&self, corners: &Corners, are_spheres: bool, limit: f32, wanted: u32) -> u32 {
        // SAFETY: axes are below 3; the rest is the caller's promise.
        unsafe {
            if are_spheres {
                self.filter.judge_spheres::<E>(corners, self.t_min, limit, wanted).judged.out
            } else {
                self.filter.judge::<E>(corners, self.t_min, limit, wanted).out
            }
        }
    }
}
