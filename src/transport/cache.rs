//! Prototype.
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use glam::DVec3;
use crate::scene::Color;
pub static TRAIN: AtomicBool = AtomicBool::new(false);
pub static CACHE: OnceLock<Cache> = OnceLock::new();
pub static READY: AtomicBool = AtomicBool::new(false);
pub const PLANE: u8 = 200;
pub struct Cache { pub lo: DVec3, pub inv: f64, pub n: usize, pub cells: Vec<[AtomicI64; 4]>, pub c: OnceLock<Vec<[f32;4]>>, pub kappa: f64, pub least: f64 }
impl Cache {
    pub fn cell(&self, p: DVec3, n: DVec3) -> usize {
        let q = (p - self.lo) * self.inv;
        let m = self.n as f64 - 1.0;
        let k = |x: f64| x.clamp(0.0, m) as usize;
        let a = n.abs();
        let axis = if a.x >= a.y && a.x >= a.z { 0 } else if a.y >= a.z { 1 } else { 2 };
        let face = axis * 2 + usize::from(n[axis] < 0.0);
        ((k(q.z) * self.n + k(q.y)) * self.n + k(q.x)) * 6 + face
    }
    pub fn add(&self, cell: usize, c: Color, count: i64) {
        for k in 0..3 { self.cells[cell][k].fetch_add((c[k] * 4294967296.0) as i64, Ordering::Relaxed); }
        if count > 0 { self.cells[cell][3].fetch_add(count, Ordering::Relaxed); }
    }
    pub fn finish(&self) {
        let mut filled = 0; let mut least = 0;
        let v: Vec<[f32;4]> = self.cells.iter().map(|c| { let n = c[3].load(Ordering::Relaxed); let s = |k: usize| (c[k].load(Ordering::Relaxed) as f64 / 4294967296.0 / n as f64) as f32;
          if n > 0 { filled += 1; }
          if n as f64 >= self.least { least += 1; [s(0), s(1), s(2), n as f32] } else { [0.0; 4] } }).collect();
        eprintln!("cells {filled} good {least}");
        let _ = self.c.set(v);
        READY.store(true, Ordering::Relaxed);
    }
}
