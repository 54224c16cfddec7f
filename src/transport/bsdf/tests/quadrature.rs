//! Integrals over the sphere of directions, by adaptive Gauss-Legendre cells.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

/// Red, green, blue and the density: what is integrated at once.
pub type Four = [f64; 4];

const NODES: [[f64; 2]; 5] = [
    [-0.906179845938664, 0.236926885056189],
    [-0.538469310105683, 0.478628670499366],
    [0.0, 0.568888888888889],
    [0.538469310105683, 0.478628670499366],
    [0.906179845938664, 0.236926885056189],
];

/// Polar coordinates; the polar angle is π tⁿ.
#[derive(Clone, Copy)]
pub struct Polar {
    x: DVec3,
    y: DVec3,
    axis: DVec3,
    power: i32,
}

/// `[t low, t high, φ low, φ high]`.
pub type Cell = [f64; 4];

impl Polar {
    /// For a lobe that is narrow around `axis`.
    pub fn about(axis: DVec3) -> Self {
        let (x, y) = axis.any_orthonormal_pair();
        Polar { x, y, axis, power: 3 }
    }

    /// For a wide lobe: the horizon, where densities end, is between cells.
    pub fn upright() -> Self {
        Polar { x: DVec3::X, y: DVec3::Y, axis: DVec3::Z, power: 1 }
    }

    /// `[t, φ]` of a direction, t in [0, 1], φ in [0, 2π).
    pub fn coordinates(&self, direction: DVec3) -> [f64; 2] {
        let [x, y, z] = [self.x, self.y, self.axis].map(|axis| axis.dot(direction));
        let phi = libm::atan2(y, x);
        [
            libm::pow(libm::atan2(libm::hypot(x, y), z) / PI, 1.0 / f64::from(self.power)),
            if phi < 0.0 { phi + TAU } else { phi },
        ]
    }

    /// The integral over solid angle of a cell.
    pub fn integral(&self, cell: Cell, tolerance: f64, f: &impl Fn(DVec3) -> Four) -> Four {
        self.refined(cell, self.rule(cell, f), tolerance, 14, f)
    }

    pub fn over_sphere(&self, f: impl Fn(DVec3) -> Four) -> Four {
        let mut sum = [0.0; 4];
        for cell in self.cells(12, 12) {
            sum = added(sum, self.integral(cell, 1e-7, &f));
        }
        sum
    }

    pub fn cells(&self, rings: usize, sectors: usize) -> impl Iterator<Item = Cell> {
        let edge = |i: usize, n: usize| i as f64 / n as f64;
        (0..rings * sectors).map(move |number| {
            let (ring, sector) = (number / sectors, number % sectors);
            let (low, high) = (edge(sector, sectors) * TAU, edge(sector + 1, sectors) * TAU);
            [edge(ring, rings), edge(ring + 1, rings), low, high]
        })
    }

    fn refined(
        &self,
        cell: Cell,
        whole: Four,
        tolerance: f64,
        depth: u32,
        f: &impl Fn(DVec3) -> Four,
    ) -> Four {
        let [t0, t1, p0, p1] = cell;
        let (t, p) = (0.5 * (t0 + t1), 0.5 * (p0 + p1));
        let quarters = [[t0, t, p0, p], [t0, t, p, p1], [t, t1, p0, p], [t, t1, p, p1]];
        let parts = quarters.map(|quarter| self.rule(quarter, f));
        let sum = parts.into_iter().fold([0.0; 4], added);
        if depth == 0 || (0..4).all(|k| (sum[k] - whole[k]).abs() <= tolerance) {
            return sum;
        }
        let mut result = [0.0; 4];
        for (quarter, part) in quarters.into_iter().zip(parts) {
            result = added(result, self.refined(quarter, part, tolerance, depth - 1, f));
        }
        result
    }

    fn rule(&self, [t0, t1, p0, p1]: Cell, f: &impl Fn(DVec3) -> Four) -> Four {
        let (half_t, half_p) = (0.5 * (t1 - t0), 0.5 * (p1 - p0));
        let azimuths = NODES.map(|[node, weight]| {
            let (sine, cosine) = libm::sincos(p0 + half_p * (1.0 + node));
            (self.x * cosine + self.y * sine, weight * half_p)
        });
        let mut sum = [0.0; 4];
        for [node, weight] in NODES {
            let t = t0 + half_t * (1.0 + node);
            let slope = PI * (1..self.power).fold(1.0, |product, _| product * t);
            let (sine, cosine) = libm::sincos(slope * t);
            let area = weight * half_t * sine * slope * f64::from(self.power);
            for (across, weight) in azimuths {
                let value = f(across * sine + self.axis * cosine);
                sum = added(sum, value.map(|v| v * (area * weight)));
            }
        }
        sum
    }
}

fn added(a: Four, b: Four) -> Four {
    std::array::from_fn(|k| a[k] + b[k])
}
