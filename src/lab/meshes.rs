//! The bodies that the stress test traces: closed, outsides out, each difficult in its own way; and the places where they
//! are put. Vertices are rounded to f32 where they lie: what results is the truth, even if triangles have lost their area.

use std::collections::HashMap;
use std::f64::consts::TAU;

use glam::DVec3;

use crate::scene::generate::{cuboid::cuboid, icosphere::icosphere};
use crate::scene::mesh::Mesh;

/// A triangle mesh in world space.
#[derive(Clone, Debug, Default)]
pub struct Body {
    pub positions: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// Names of the generated bodies, in the order of [`body`].
pub const SHAPES: [&str; 10] =
    ["icosphere", "torus", "slivers", "star", "bumpy", "saddles", "shells", "box", "dust", "fans"];

/// Where bodies of about unit size are put: a name, a factor and an offset.
pub const PLACES: [(&str, f64, f64); 10] = [
    ("as it is", 1.0, 0.0),
    ("moved 1e3", 1.0, 1e3),
    ("moved 1e4", 1.0, 1e4),
    ("moved 1e5", 1.0, 1e5),
    ("moved 1e6", 1.0, 1e6),
    ("moved 1e7", 1.0, 1e7),
    ("scaled 1e-12", 1e-12, 0.0),
    ("scaled 1e-6", 1e-6, 0.0),
    ("scaled 1e6", 1e6, 0.0),
    ("scaled 1e12", 1e12, 0.0),
];

/// A generated body in the given place.
///
/// # Panics
/// If there is no such shape.
pub fn body(shape: usize, factor: f64, offset: f64) -> Body {
    // Not the same along all axes: some keep 0 within the body.
    let moved = DVec3::new(offset, -0.5 * offset, 0.0);
    let soup = soup(shape);
    let place = |p: DVec3| (p * factor + moved).to_array().map(|c| c as f32);
    Body { positions: soup.points.into_iter().map(place).collect(), triangles: soup.triangles }
}

impl Body {
    /// The edges between distinct positions that don't have as many partners the other way, in no order: where there are none the surface is closed.
    pub fn border(&self) -> Vec<[[f32; 3]; 2]> {
        let key = |index: u32| self.positions[index as usize].map(|c| (c + 0.0).to_bits());
        let mut balance: HashMap<_, i64> = HashMap::new();
        for [a, b, c] in &self.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let (from, to) = (key(*from), key(*to));
                match from.cmp(&to) {
                    std::cmp::Ordering::Less => *balance.entry((from, to)).or_default() += 1,
                    std::cmp::Ordering::Greater => *balance.entry((to, from)).or_default() -= 1,
                    std::cmp::Ordering::Equal => {}
                }
            }
        }
        let open = balance.into_iter().filter(|&(_, sum)| sum != 0);
        open.map(|((from, to), _)| [from, to].map(|bits| bits.map(f32::from_bits))).collect()
    }

    /// Whether the surface has no border.
    pub fn is_closed(&self) -> bool {
        self.border().is_empty()
    }
}

#[derive(Default)]
struct Soup {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Soup {
    fn add(&mut self, other: Soup) {
        let first = self.points.len() as u32;
        self.points.extend(other.points);
        self.triangles.extend(other.triangles.into_iter().map(|t| t.map(|v| v + first)));
    }

    fn from_mesh(mesh: Mesh) -> Self {
        let points = mesh.positions.into_iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        Soup { points, triangles: mesh.triangles }
    }

    fn map(mut self, f: impl Fn(DVec3) -> DVec3) -> Self {
        self.points.iter_mut().for_each(|p| *p = f(*p));
        self
    }
}

fn soup(shape: usize) -> Soup {
    match SHAPES[shape] {
        "icosphere" => Soup::from_mesh(icosphere(2, DVec3::ZERO, 1.0)),
        "torus" => torus(24, 12),
        "slivers" => slivers(),
        "star" => star(500),
        "bumpy" => {
            sphere(2).map(|p| p * (1.0 + 0.25 * libm::sin(7.0 * p.x) * libm::cos(9.0 * p.y + 5.0 * p.z)))
        }
        "saddles" => saddles(),
        "shells" => shells(),
        "box" => lattice_box(5),
        "dust" => dust(),
        "fans" => fans(),
        other => unreachable!("{other}"),
    }
}

fn sphere(level: u32) -> Soup {
    Soup::from_mesh(icosphere(level, DVec3::ZERO, 1.0))
}

/// A ring of radius 0.7 and thickness 0.3.
fn torus(around: u32, across: u32) -> Soup {
    let mut soup = Soup::default();
    for i in 0..around {
        let (sin, cos) = libm::sincos(TAU * f64::from(i) / f64::from(around));
        for j in 0..across {
            let (rise, out) = libm::sincos(TAU * f64::from(j) / f64::from(across));
            let r = 0.7 + 0.3 * out;
            soup.points.push(DVec3::new(r * cos, 0.3 * rise, r * sin));
            let at = |i: u32, j: u32| (i % around) * across + j % across;
            let [a, b, c, d] = [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)];
            soup.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    soup
}

/// A thin rod of long needles: rings of many corners, and from end to end triangles a million times as long as wide.
fn slivers() -> Soup {
    let corners = 64;
    let mut soup = Soup::default();
    for end in 0..2 {
        for i in 0..corners {
            let (sin, cos) = libm::sincos(TAU * f64::from(i) / f64::from(corners));
            // The farther end is a thousand times as thin.
            let r = if end == 0 { 1e-3 } else { 1e-6 };
            soup.points.push(DVec3::new(-1.0 + 2.0 * f64::from(end), r * cos, r * sin));
        }
    }
    let tips = [2 * corners, 2 * corners + 1];
    soup.points.extend([DVec3::new(-1.0001, 0.0, 0.0), DVec3::new(1.0001, 0.0, 0.0)]);
    for i in 0..corners {
        let [a, b] = [i, (i + 1) % corners];
        let [c, d] = [a + corners, b + corners];
        soup.triangles.extend([[a, b, c], [b, d, c], [tips[0], b, a], [tips[1], c, d]]);
    }
    soup
}

/// A double cone: `count` triangles around each tip, over a rim of uneven radii and heights.
fn star(count: u32) -> Soup {
    let mut soup =
        Soup { points: vec![DVec3::new(0.1, 1.0, 0.0), DVec3::new(0.0, -0.5, 0.2)], ..Soup::default() };
    for i in 0..count {
        let (sin, cos) = libm::sincos(TAU * f64::from(i) / f64::from(count));
        let r = 0.6 + 0.35 * libm::sin(f64::from(i) * 2.4);
        soup.points.push(DVec3::new(r * cos, 0.1 * libm::cos(f64::from(i) * 5.1), r * sin));
        let [a, b] = [2 + i, 2 + (i + 1) % count];
        soup.triangles.extend([[0, b, a], [1, a, b]]);
    }
    soup
}

/// A block whose top is a field of steep saddles and pits: creases of both kinds meet at every vertex.
fn saddles() -> Soup {
    let n = 12;
    let mut soup = Soup::default();
    let height = |i: u32, j: u32| {
        let border = i == 0 || j == 0 || i == n || j == n;
        let wave = libm::sin(f64::from(i * 7 + j * 3)) * libm::cos(f64::from(i * 2) - f64::from(j * 5));
        if border { 0.0 } else { 0.3 * wave }
    };
    let at = |i: u32, j: u32| j * (n + 1) + i;
    for j in 0..=n {
        for i in 0..=n {
            let place = |k: u32| 2.0 * f64::from(k) / f64::from(n) - 1.0;
            soup.points.push(DVec3::new(place(i), height(i, j), place(j)));
        }
    }
    let bottom = soup.points.len() as u32;
    soup.points.push(DVec3::new(0.0, -1.0, 0.0));
    for j in 0..n {
        for i in 0..n {
            let [a, b, c, d] = [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)];
            if (i + j) % 2 == 0 {
                soup.triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                soup.triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
    }
    for i in 0..n {
        let rim = [
            [at(i, 0), at(i + 1, 0)],
            [at(n, i), at(n, i + 1)],
            [at(i + 1, n), at(i, n)],
            [at(0, i + 1), at(0, i)],
        ];
        soup.triangles.extend(rim.map(|[a, b]| [a, b, bottom]));
    }
    soup
}

/// Nested spheres from one ulp to 1e-3 apart, with outsides alternately out and in.
fn shells() -> Soup {
    let mut soup = Soup::default();
    let mut radius = 1.0f32;
    for (index, gap) in [0.0, 0.0f32, 1e-6, 1e-5, 1e-4, 1e-3].into_iter().enumerate() {
        radius = if gap == 0.0 { radius.next_up() } else { radius + gap };
        let mut shell = sphere(1).map(|p| p * f64::from(radius));
        if index % 2 == 1 {
            shell.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        soup.add(shell);
    }
    soup
}

/// A box whose faces are n × n squares of two coplanar triangles each.
fn lattice_box(n: u32) -> Soup {
    let mut soup = Soup::default();
    let coordinate = |k: u32| f64::from(k) / f64::from(n) - 0.4;
    for axis in 0..3 {
        for side in [0, n] {
            let first = soup.points.len() as u32;
            for j in 0..=n {
                for i in 0..=n {
                    let mut p = DVec3::ZERO;
                    p[axis] = coordinate(side);
                    p[(axis + 1) % 3] = coordinate(i);
                    p[(axis + 2) % 3] = coordinate(j);
                    soup.points.push(p);
                }
            }
            for j in 0..n {
                for i in 0..n {
                    let at = |i: u32, j: u32| first + j * (n + 1) + i;
                    let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                    let pair = if side == 0 { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] };
                    soup.triangles.extend(pair);
                }
            }
        }
    }
    soup
}

/// Bodies of sizes from 1 down to 1e-30 around 0: seen from the large ones, the small ones are less than an ulp.
fn dust() -> Soup {
    let mut soup = Soup::from_mesh(cuboid(DVec3::splat(-1.0), DVec3::splat(1.0)));
    for exponent in [-3, -6, -9, -12, -15, -18, -24, -30] {
        let size = libm::exp10(f64::from(exponent));
        soup.add(sphere(1).map(|p| p * size));
    }
    soup
}

/// Many small double cones of few, uneven, often very thin triangles around their tips.
fn fans() -> Soup {
    let mut soup = Soup::default();
    let mut number = 0.0;
    // Of no order that matters, in -1 .. 1.
    let mut any = || {
        number += 1.0;
        libm::sin(number * number * 0.739 + number)
    };
    for cone in 0..60 {
        let place =
            DVec3::new(f64::from(cone % 4), f64::from(cone / 4 % 4), f64::from(cone / 16)) * 0.5 - 0.75;
        let squash =
            DVec3::new(0.1, libm::exp10(-2.0 + 2.0 * any()) * 0.1, libm::exp10(-2.0 + 2.0 * any()) * 0.1);
        let corners = 3 + cone % 6;
        let first = soup.points.len() as u32;
        soup.points.extend([
            place + squash * DVec3::new(any(), any(), 1.0),
            place - squash * DVec3::new(any(), any(), 1.0),
        ]);
        for k in 0..corners {
            let (sin, cos) = libm::sincos(TAU * (f64::from(k) + 0.4 * any()) / f64::from(corners));
            soup.points.push(place + squash * (1.5 + any()) * DVec3::new(cos, sin, 0.3 * any()));
            let [a, b] = [first + 2 + k as u32, first + 2 + ((k + 1) % corners) as u32];
            soup.triangles.extend([[first, a, b], [first + 1, b, a]]);
        }
    }
    soup
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sum of the signed volumes under the triangles.
    fn volume(body: &Body) -> f64 {
        let point = |v: u32| DVec3::from(body.positions[v as usize].map(f64::from));
        body.triangles.iter().map(|t| t.map(point)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn all_are_closed_wherever_they_are_put() {
        for (shape, name) in SHAPES.iter().enumerate() {
            for (place, factor, offset) in PLACES {
                let body = body(shape, factor, offset);
                assert!(body.is_closed(), "{name} {place}");
                assert!((100..2000).contains(&body.triangles.len()), "{name}: {}", body.triangles.len());
            }
        }
    }

    #[test]
    fn outsides_are_out() {
        for (shape, name) in SHAPES.iter().enumerate() {
            let body = body(shape, 1.0, 0.0);
            // Shells alternate: the outermost, turned in, nearly cancels the next.
            assert_eq!(volume(&body) > 0.0, *name != "shells", "{name}: {}", volume(&body));
        }
    }

    #[test]
    fn an_open_body_is_found_out() {
        let mut body = body(0, 1.0, 0.0);
        body.triangles.pop();
        assert!(!body.is_closed());
    }
}
