//! Closed meshes in several places, and rays aimed at their vertices, edges and faces. Knows no kernel.
//!
//! Origins and directions are f32 values, so that kernels of any precision are asked about the very same ray, and every ray
//! meets the surface by its construction: it starts inside, or outside in front of a face that it goes to nearly head-on.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::scene::generate::icosphere::icosphere;

/// Where meshes of about unit size are put.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub name: &'static str,
    pub factor: f64,
    pub offset: f64,
    /// How far away rays from outside start, in sizes of the mesh.
    pub reach: f64,
}

pub const PLACES: [Place; 3] = [
    Place { name: "size 1", factor: 1.0, offset: 0.0, reach: 1.0 },
    Place { name: "size 1e-3", factor: 1e-3, offset: 0.0, reach: 1.0 },
    Place { name: "size 1, moved 1e4", factor: 1.0, offset: 1e4, reach: 1e3 },
];

const TUBE: f64 = 0.4;

/// Uniform numbers that depend on nothing but the three that name them (SplitMix64, Steele, Lea & Flood 2014).
#[derive(Clone, Debug)]
pub struct Dice(u64);

impl Dice {
    pub fn new(seed: u64, stream: u64, index: u64) -> Self {
        let mut dice = Dice(seed);
        for part in [stream, index] {
            dice = Dice(dice.next() ^ part);
        }
        dice
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    fn cube(&mut self) -> DVec3 {
        DVec3::new(self.signed(), self.signed(), self.signed())
    }
}

/// A ray whose numbers f32 can hold. It meets the surface at t = 1 at the latest, but for rounding.
#[derive(Clone, Copy, Debug)]
pub struct AimedRay {
    pub origin: [f32; 3],
    pub direction: [f32; 3],
}

/// A closed mesh in its place.
#[derive(Clone, Debug)]
pub struct Target {
    pub place: Place,
    pub triangles: Vec<[[f32; 3]; 3]>,
    /// Of which the inside is known: around the origin, or around the circle of a torus.
    torus: bool,
}

/// The meshes of a place: 320 and 576 triangles.
pub fn targets(place: Place) -> [Target; 2] {
    let sphere = icosphere(2, DVec3::ZERO, 1.0);
    let ball: Vec<_> = sphere
        .triangles
        .iter()
        .map(|t| t.map(|v| DVec3::from(sphere.positions[v as usize].map(f64::from))))
        .collect();
    [Target::new(place, &ball, false), Target::new(place, &torus(24, 12), true)]
}

/// A torus around the z axis with radii 1 and [`TUBE`], outside out.
fn torus(around: u32, across: u32) -> Vec<[DVec3; 3]> {
    let point = |i: u32, j: u32| {
        let (sin, cos) = libm::sincos(TAU * f64::from(i % around) / f64::from(around));
        let (up, out) = libm::sincos(TAU * f64::from(j % across) / f64::from(across));
        let from_axis = 1.0 + TUBE * out;
        DVec3::new(from_axis * cos, from_axis * sin, TUBE * up)
    };
    let quads = (0..around).flat_map(|i| (0..across).map(move |j| (i, j)));
    quads
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

impl Target {
    fn new(place: Place, triangles: &[[DVec3; 3]], torus: bool) -> Self {
        let moved = |p: DVec3| (p * place.factor + Self::shift(place)).to_array().map(|c| c as f32);
        Target { place, triangles: triangles.iter().map(|t| t.map(moved)).collect(), torus }
    }

    /// Not the same along all axes.
    fn shift(place: Place) -> DVec3 {
        DVec3::new(place.offset, -0.5 * place.offset, 0.25 * place.offset)
    }

    /// Ray number `index` of this mesh.
    pub fn ray(&self, seed: u64, stream: u64, index: u64) -> AimedRay {
        let mut dice = Dice::new(seed, stream, index);
        let face = self.triangles[dice.below(self.triangles.len())];
        let [a, b, c] = face.map(|v| DVec3::from(v.map(f64::from)));
        let (aim, inside) = (index % 3, (index / 3).is_multiple_of(2));
        let point = match aim {
            0 => a,
            1 => a + (b - a) * dice.unit(),
            _ => {
                let (u, v) = (dice.unit(), dice.unit());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                a + (b - a) * u + (c - a) * v
            }
        };
        let origin = if inside {
            self.core(point) + dice.cube() * (0.2 * self.place.factor)
        } else {
            let normal = (b - a).cross(c - a).normalize();
            let distance = self.place.reach * self.place.factor * (0.5 + dice.unit());
            // At most asin(0.35 * √3) off the normal: no neighbour is seen from its back.
            point + (normal + dice.cube() * 0.35) * distance
        };
        let origin = origin.to_array().map(|c| c as f32);
        let direction = point - DVec3::from(origin.map(f64::from));
        AimedRay { origin, direction: direction.to_array().map(|c| c as f32) }
    }

    /// The point of the mesh's core that is nearest to a point of its surface.
    fn core(&self, point: DVec3) -> DVec3 {
        let shift = Self::shift(self.place);
        if !self.torus {
            return shift;
        }
        let flat = (point - shift).with_z(0.0);
        shift + flat.normalize() * self.place.factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torus_is_outside_out_and_rays_start_on_both_sides() {
        let [ball, torus] = targets(PLACES[0]);
        assert_eq!((ball.triangles.len(), torus.triangles.len()), (320, 576));
        for target in [&ball, &torus] {
            for face in &target.triangles {
                let [a, b, c] = face.map(|v| DVec3::from(v.map(f64::from)));
                let outward = a - target.core(a);
                assert!((b - a).cross(c - a).dot(outward) > 0.0);
            }
            let inside = (0..600)
                .filter(|&index| {
                    let origin = DVec3::from(target.ray(1, 0, index).origin.map(f64::from));
                    let least = if target.torus { TUBE } else { 1.0 };
                    // An apothem of the coarsest polygon in them.
                    (origin - target.core(origin)).length() < 0.95 * least
                })
                .count();
            // A few that start across the torus's hole land in its far side.
            assert!(if target.torus { (300..330).contains(&inside) } else { inside == 300 }, "{inside}");
        }
    }
}
