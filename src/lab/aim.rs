//! Rays aimed where tracers fail: at vertices and edges, along edges and axes, nearly along surfaces, from far away and from
//! within. A ray is a pure function of (seed, body, index). Knows vertices, no tracer.

use glam::DVec3;

use super::meshes::Body;

/// What a ray is aimed at, or where from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aim {
    Vertex,
    Edge,
    Interior,
    AlongEdge,
    AlongAxis,
    Grazing,
    FromWithin,
    FromVertex,
    FarVertex,
    FarEdge,
    FarInterior,
}

impl Aim {
    pub const ALL: [Aim; 11] = [
        Aim::Vertex,
        Aim::Edge,
        Aim::Interior,
        Aim::AlongEdge,
        Aim::AlongAxis,
        Aim::Grazing,
        Aim::FromWithin,
        Aim::FromVertex,
        Aim::FarVertex,
        Aim::FarEdge,
        Aim::FarInterior,
    ];
}

/// Random numbers from a counter (SplitMix64; Steele, Lea and Flood 2014).
#[derive(Clone, Debug)]
pub struct Dice(u64);

impl Dice {
    pub fn new(words: [u64; 3]) -> Self {
        let mut dice = Dice(0x243f_6a88_85a3_08d3);
        for word in words {
            dice.0 = dice.0.wrapping_add(word);
            dice.0 = dice.draw();
        }
        dice
    }

    fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.draw() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// In [-1, 1).
    fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    /// In 0 .. n.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.draw()) * n as u128) >> 64) as usize
    }

    /// A point of the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        loop {
            let v = DVec3::new(self.signed(), self.signed(), self.signed());
            if (0.01..=1.0).contains(&v.length_squared()) {
                return v.normalize();
            }
        }
    }
}

/// A body as something to aim at.
#[derive(Debug)]
pub struct Target<'a> {
    body: &'a Body,
    /// Vertices of very many triangles, which chance alone would rarely find.
    hubs: Vec<u32>,
    center: DVec3,
    /// Half the diagonal of its box.
    size: f64,
}

impl<'a> Target<'a> {
    /// `body` has at least one triangle.
    pub fn new(body: &'a Body) -> Self {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut uses = vec![0u32; body.positions.len()];
        for &vertex in body.triangles.iter().flatten() {
            let p = point(body, vertex);
            (low, high) = (low.min(p), high.max(p));
            uses[vertex as usize] += 1;
        }
        let hubs = (0..uses.len() as u32).filter(|&v| uses[v as usize] > 50).collect();
        let size = (0.5 * (high - low).length()).max(f64::from(f32::MIN_POSITIVE));
        Target { body, hubs, center: 0.5 * (low + high), size }
    }

    /// Origin and direction, of any length, of a ray in world space.
    pub fn ray(&self, aim: Aim, dice: &mut Dice) -> (DVec3, DVec3) {
        let (origin, direction) = match aim {
            Aim::Vertex => self.towards(self.outside(dice, 3.0), self.vertex(dice)),
            Aim::Edge => self.towards(self.outside(dice, 3.0), self.edge_point(dice)),
            Aim::Interior => self.towards(self.outside(dice, 3.0), self.inner_point(dice)),
            Aim::AlongEdge => self.along_edge(dice),
            Aim::AlongAxis => self.along_axis(dice),
            Aim::Grazing => self.grazing(dice),
            Aim::FromWithin => {
                let within = self.center + dice.direction() * (0.3 * self.size * dice.unit());
                self.towards(
                    within,
                    if dice.below(2) == 0 { self.vertex(dice) } else { self.edge_point(dice) },
                )
            }
            Aim::FromVertex => self.towards(self.vertex(dice), self.vertex(dice)),
            Aim::FarVertex => self.towards(self.outside(dice, 2e6), self.vertex(dice)),
            Aim::FarEdge => self.towards(self.outside(dice, 2e6), self.edge_point(dice)),
            Aim::FarInterior => self.towards(self.outside(dice, 2e6), self.inner_point(dice)),
        };
        let largest = direction.abs().max_element();
        if largest == 0.0 {
            return (origin, dice.direction());
        }
        // As cameras do, as differences of points come, or of any length.
        let scaled = match dice.below(4) {
            0 | 1 => (direction / largest).normalize(),
            2 => direction,
            _ => direction / largest * libm::exp2(40.0 * dice.signed()),
        };
        (origin, scaled)
    }

    /// A direction away from a point on a triangle.
    pub fn onward(&self, triangle: u32, from: DVec3, arriving: DVec3, dice: &mut Dice) -> DVec3 {
        let [a, b, c] = self.body.triangles[triangle as usize].map(|v| point(self.body, v));
        let cross = ((b - a) / self.size).cross((c - a) / self.size);
        let normal = cross.try_normalize().unwrap_or(DVec3::Y);
        let direction = match dice.below(8) {
            0 | 1 => dice.direction(),
            // Mirrored, and straight on.
            2 => arriving - normal * (2.0 * arriving.dot(normal)),
            3 => arriving,
            // Nearly along the surface, on either side.
            4 => {
                let aside = dice.direction().reject_from_normalized(normal);
                aside + normal * (dice.signed() * libm::exp10(-12.0 * dice.unit()))
            }
            // Along an edge's direction, lifted a little.
            5 => {
                let edge = [b - a, c - b, a - c][dice.below(3)];
                edge / self.size + normal * (dice.signed() * libm::exp10(-8.0 * dice.unit()))
            }
            6 => self.vertex(dice) - from,
            _ => {
                let mut axis = DVec3::ZERO;
                axis[dice.below(3)] = if dice.below(2) == 0 { 1.0 } else { -1.0 };
                axis
            }
        };
        direction.try_normalize().unwrap_or_else(|| dice.direction())
    }

    fn towards(&self, origin: DVec3, target: DVec3) -> (DVec3, DVec3) {
        (origin, target - origin)
    }

    fn outside(&self, dice: &mut Dice, sizes: f64) -> DVec3 {
        self.center + dice.direction() * (self.size * sizes * (0.5 + dice.unit()))
    }

    fn vertex(&self, dice: &mut Dice) -> DVec3 {
        if !self.hubs.is_empty() && dice.below(8) == 0 {
            return point(self.body, self.hubs[dice.below(self.hubs.len())]);
        }
        self.corners(dice)[dice.below(3)]
    }

    fn corners(&self, dice: &mut Dice) -> [DVec3; 3] {
        self.body.triangles[dice.below(self.body.triangles.len())].map(|v| point(self.body, v))
    }

    fn edge_point(&self, dice: &mut Dice) -> DVec3 {
        let [a, b, _] = turned(self.corners(dice), dice);
        let s = match dice.below(4) {
            0 => 0.5,
            1 => 1e-9 * dice.unit(),
            _ => dice.unit(),
        };
        a + (b - a) * s
    }

    fn inner_point(&self, dice: &mut Dice) -> DVec3 {
        let [a, b, c] = self.corners(dice);
        let (u, v) = (dice.unit(), dice.unit());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        a + (b - a) * u + (c - a) * v
    }

    fn along_edge(&self, dice: &mut Dice) -> (DVec3, DVec3) {
        let [a, b, _] = turned(self.corners(dice), dice);
        // Whole steps keep the origin on the edge's line where f64 can.
        (a - (b - a) * (1 << dice.below(4)) as f64, b - a)
    }

    fn along_axis(&self, dice: &mut Dice) -> (DVec3, DVec3) {
        const NOTHING: [f64; 6] = [0.0, -0.0, 5e-324, -5e-324, 1e-310, -1e-300];
        let axis = dice.below(3);
        let mut direction = DVec3::from(std::array::from_fn(|_| NOTHING[dice.below(6)]));
        direction[axis] = if dice.below(2) == 0 { 1.0 } else { -1.0 };
        let mut origin = if dice.below(2) == 0 { self.vertex(dice) } else { self.edge_point(dice) };
        if dice.below(3) == 0 {
            // In an axis plane instead of along an axis.
            let other = (axis + 1) % 3;
            direction[other] = dice.signed();
            origin[other] -= direction[other] * 3.0 * self.size;
        }
        origin[axis] -= direction[axis] * 3.0 * self.size;
        (origin, direction)
    }

    fn grazing(&self, dice: &mut Dice) -> (DVec3, DVec3) {
        let [a, b, c] = self.corners(dice);
        let normal = ((b - a) / self.size).cross((c - a) / self.size).try_normalize().unwrap_or(DVec3::Y);
        let aside = dice.direction().reject_from_normalized(normal);
        let direction = aside + normal * (dice.signed() * libm::exp10(-16.0 * dice.unit()));
        let (u, v) = (dice.unit(), if dice.below(2) == 0 { dice.unit() } else { 0.0 });
        let target = a + (b - a) * (u * (1.0 - v)) + (c - a) * v;
        (target - direction * (self.size * (0.5 + 2.0 * dice.unit())), direction)
    }
}

fn turned([a, b, c]: [DVec3; 3], dice: &mut Dice) -> [DVec3; 3] {
    match dice.below(3) {
        0 => [a, b, c],
        1 => [b, c, a],
        _ => [c, a, b],
    }
}

fn point(body: &Body, vertex: u32) -> DVec3 {
    DVec3::from(body.positions[vertex as usize].map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::super::meshes::body;
    use super::*;

    #[test]
    fn rays_are_finite_repeatable_and_differ() {
        for (factor, offset) in [(1.0, 0.0), (1e-12, 0.0), (1e12, 0.0), (1.0, 1e7)] {
            let body = body(0, factor, offset);
            let target = Target::new(&body);
            for (index, aim) in Aim::ALL.into_iter().enumerate() {
                let ray = |seed| target.ray(aim, &mut Dice::new([seed, 3, index as u64]));
                let (origin, direction) = ray(1);
                assert!(origin.is_finite() && direction.is_finite(), "{aim:?}");
                assert!(direction.abs().max_element() > 0.0, "{aim:?}");
                assert_eq!((origin, direction), ray(1));
                assert_ne!((origin, direction), ray(2), "{aim:?}");
            }
        }
    }
}
