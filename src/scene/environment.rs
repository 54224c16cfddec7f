//! Light from infinitely far, as an image of all directions around.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::Color;

/// Radiance by direction: columns go around +y from +z over +x, rows from +y down to -y.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Environment {
    pub width: u32,
    pub height: u32,
    /// Linear RGB, `texels[y * width + x]`, >= 0.
    pub texels: Vec<[f32; 3]>,
    /// Multiplies all texels.
    pub scale: f64,
    /// In radians about +y.
    pub rotation: f64,
}

impl Environment {
    /// Radiance that comes from a unit direction, bilinear between texels.
    pub fn radiance(&self, direction: DVec3) -> Color {
        let [u, v] = self.place(direction);
        let (x, y) = (u * f64::from(self.width) - 0.5, v * f64::from(self.height) - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let texel = |x: f64, y: f64| {
            let column = (x as i64).rem_euclid(i64::from(self.width)) as usize;
            let row = (y as i64).clamp(0, i64::from(self.height) - 1) as usize;
            self.texels[row * self.width as usize + column].map(f64::from)
        };
        let (a, b) = (texel(x0, y0), texel(x0 + 1.0, y0));
        let (c, d) = (texel(x0, y0 + 1.0), texel(x0 + 1.0, y0 + 1.0));
        std::array::from_fn(|k| {
            self.scale * ((a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy)
        })
    }

    /// The unit square's point of a unit direction.
    fn place(&self, direction: DVec3) -> [f64; 2] {
        let around = (libm::atan2(direction.x, direction.z) - self.rotation) / TAU;
        let down = libm::acos(direction.y.clamp(-1.0, 1.0)) / PI;
        [around - around.floor(), down]
    }
}

/// Chooses directions by how much light comes from them.
#[derive(Clone, Debug, Default)]
pub struct EnvironmentTable {
    /// `rows[y]`: the share of all light that rows 0 ..= y send.
    rows: Vec<f64>,
    /// `columns[y * width + x]`: the share of row y's light that its columns 0 ..= x send.
    columns: Vec<f64>,
    /// Mean luminance over all directions.
    pub mean: f64,
}

impl EnvironmentTable {
    pub fn new(environment: &Environment) -> Self {
        let (width, height) = (environment.width as usize, environment.height as usize);
        let brightness = |x: usize, y: usize| {
            let [r, g, b] = environment.texels[y * width + x].map(f64::from);
            r + g + b
        };
        // The most that a texel shows of its neighbours: wherever light comes from there is a chance to choose it.
        let most = |x: usize, y: usize| {
            let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
            rows.flat_map(|y| [(x + width - 1) % width, x, (x + 1) % width].map(|x| brightness(x, y)))
                .fold(0.0, f64::max)
        };
        let (mut rows, mut columns) = (Vec::with_capacity(height), Vec::with_capacity(width * height));
        let (mut light, mut sky, mut all) = (0.0, 0.0, 0.0);
        for y in 0..height {
            let solid = band(y, height);
            let first = columns.len();
            let mut sum = 0.0;
            for x in 0..width {
                sum += most(x, y);
                columns.push(sum);
                all += brightness(x, y) * solid;
            }
            columns[first..].iter_mut().for_each(|share| *share /= sum.max(f64::MIN_POSITIVE));
            light += sum * solid;
            sky += solid * width as f64;
            rows.push(light);
        }
        rows.iter_mut().for_each(|share| *share /= light.max(f64::MIN_POSITIVE));
        EnvironmentTable { rows, columns, mean: all / sky / 3.0 * environment.scale }
    }

    /// A unit direction chosen by two numbers in [0, 1), and its density over solid angle; `None` of a black environment.
    pub fn choose(&self, environment: &Environment, [u, v]: [f64; 2]) -> Option<(DVec3, f64)> {
        let (width, height) = (environment.width as usize, environment.height as usize);
        let (y, v) = pick(&self.rows, v)?;
        let (x, u) = pick(&self.columns[y * width..][..width], u)?;
        // Evenly over the solid angle of the texel.
        let (top, bottom) = (edge(y, height), edge(y + 1, height));
        let cosine = top + (bottom - top) * v;
        let sine = ((1.0 - cosine) * (1.0 + cosine)).max(0.0).sqrt();
        let around = (x as f64 + u) / width as f64 * TAU + environment.rotation;
        let (sin, cos) = libm::sincos(around);
        Some((DVec3::new(sine * sin, cosine, sine * cos), self.density(environment, x, y)))
    }

    /// The density with which a unit direction is chosen.
    pub fn pdf(&self, environment: &Environment, direction: DVec3) -> f64 {
        let [u, v] = environment.place(direction);
        let texel = |x: f64, n: u32| ((x * f64::from(n)) as u32).min(n - 1) as usize;
        self.density(environment, texel(u, environment.width), texel(v, environment.height))
    }

    fn density(&self, environment: &Environment, x: usize, y: usize) -> f64 {
        let (width, height) = (environment.width as usize, environment.height as usize);
        let chance = share(&self.rows, y) * share(&self.columns[y * width..][..width], x);
        chance * width as f64 / (TAU * band(y, height))
    }
}

/// Cosine of the polar angle where row y begins.
fn edge(y: usize, height: usize) -> f64 {
    libm::cos(y as f64 / height as f64 * PI)
}

/// How far row y reaches in the cosine of the polar angle.
fn band(y: usize, height: usize) -> f64 {
    edge(y, height) - edge(y + 1, height)
}

fn share(sums: &[f64], index: usize) -> f64 {
    sums[index] - if index == 0 { 0.0 } else { sums[index - 1] }
}

/// The first place whose sum is above u, and where within its share u lies, in [0, 1). `None` where all shares are 0.
#[inline]
pub(super) fn pick(sums: &[f64], u: f64) -> Option<(usize, f64)> {
    let last = *sums.last()?;
    // What rounding left above the last sum falls to the last one that has a share.
    let u = if u < last { u } else { last.next_down() };
    // A few are counted sooner than halved.
    let index = if sums.len() <= 8 {
        sums.iter().map(|&sum| usize::from(sum <= u)).sum()
    } else {
        sums.partition_point(|&sum| sum <= u)
    };
    let share = share(sums, index.min(sums.len() - 1));
    if share <= 0.0 || index == sums.len() {
        return None;
    }
    let below = if index == 0 { 0.0 } else { sums[index - 1] };
    Some((index, ((u - below) / share).min(1.0f64.next_down())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment() -> Environment {
        let (width, height) = (16, 8);
        let texels = (0..width * height).map(|i| match i {
            37 => [50.0, 40.0, 30.0],
            _ if i / width > 4 => [0.0; 3],
            _ => [0.1 + (i % 5) as f32, 0.2, 0.3],
        });
        Environment { width, height, texels: texels.collect(), scale: 2.0, rotation: 0.7 }
    }

    #[test]
    fn chosen_directions_integrate_the_light_and_have_the_density_that_is_told() {
        let environment = environment();
        let table = EnvironmentTable::new(&environment);
        let n = 2000;
        let (mut chosen, mut even, mut total) = (0.0, 0.0, 0.0);
        for i in 0..n * n {
            let [u, v] = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
            let (direction, pdf) = table.choose(&environment, [u, v]).unwrap();
            assert!((direction.length() - 1.0).abs() < 1e-12);
            let again = table.pdf(&environment, direction);
            assert!((again / pdf - 1.0).abs() < 1e-9, "{again} {pdf}");
            chosen += environment.radiance(direction)[0] / pdf;
            // By itself: evenly over the sphere.
            let (z, around) = (1.0 - 2.0 * u, TAU * v);
            let r = (1.0 - z * z).sqrt();
            let direction = DVec3::new(r * libm::sin(around), z, r * libm::cos(around));
            even += environment.radiance(direction)[0] * 4.0 * PI;
            total += table.pdf(&environment, direction) * 4.0 * PI;
        }
        let count = f64::from(n * n);
        assert!((chosen / even - 1.0).abs() < 2e-3, "{chosen} {even}");
        assert!((total / count - 1.0).abs() < 2e-3, "{}", total / count);
    }

    #[test]
    fn light_has_a_chance_wherever_it_comes_from() {
        let environment = environment();
        let table = EnvironmentTable::new(&environment);
        for i in 0..10_000 {
            let [u, v] = [i % 100, i / 100].map(|k| (f64::from(k) + 0.5) / 100.0);
            let (z, around) = (1.0 - 2.0 * u, TAU * v);
            let r = (1.0 - z * z).sqrt();
            let direction = DVec3::new(r * libm::sin(around), z, r * libm::cos(around));
            let shines = environment.radiance(direction) != [0.0; 3];
            assert!(!shines || table.pdf(&environment, direction) > 0.0, "{direction}");
        }
        let black = Environment { texels: vec![[0.0; 3]; 128], ..environment };
        assert!(EnvironmentTable::new(&black).choose(&black, [0.5, 0.5]).is_none());
    }
}
