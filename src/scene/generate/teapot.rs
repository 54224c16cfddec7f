//! Newell's teapot (1975): 32 bicubic Bézier patches. Rim, body, lid and bottom are quarters of a body of revolution,
//! mirrored in x and y; handle and spout are halves, mirrored in y.

use glam::DVec3;

use crate::scene::mesh::Mesh;

/// Quads along a patch's edge: 32 * 2 * MAX_LEVEL^2 triangles.
pub const MAX_LEVEL: u32 = 2048;

/// Number of triangles of a level: at the two poles each quad is one triangle.
pub fn count(level: u32) -> u64 {
    let level = u64::from(level);
    64 * level * level - 8 * level
}

/// Radius and height of the four control circles of each patch of revolution, so that the outside lies to the left of the
/// path in the (radius, height) plane.
const PROFILES: [[[f64; 2]; 4]; 6] = [
    // Rim
    [[1.4, 2.4], [1.3375, 2.53125], [1.4375, 2.53125], [1.5, 2.4]],
    // Body
    [[1.5, 2.4], [1.75, 1.875], [2.0, 1.35], [2.0, 0.9]],
    [[2.0, 0.9], [2.0, 0.45], [1.5, 0.225], [1.5, 0.15]],
    // Bottom
    [[1.5, 0.15], [1.5, 0.075], [1.425, 0.0], [0.0, 0.0]],
    // Lid
    [[0.0, 3.15], [0.8, 3.15], [0.0, 2.85], [0.2, 2.7]],
    [[0.2, 2.7], [0.4, 2.55], [1.3, 2.55], [1.3, 2.4]],
];

/// Newell's quarter circle has its inner control points at 0.56 of the radius (0.5523 would be the closest
/// circle).
const QUARTER: f64 = 0.56;

/// ... but for the circle under the knob, whose 0.448 he rounded up.
const KNOB_CIRCLE: [f64; 2] = [0.8, 3.15];
const KNOB_QUARTER: f64 = 0.45 / 0.8;

/// Half sections of handle and spout, two patches each, along their whole length: inner edge, outer edge (x and z on the
/// mirror plane) and half width.
const HANDLE: [Section; 7] = [
    section([-1.6, 2.025], [-1.5, 2.25], 0.3),
    section([-2.3, 2.025], [-2.5, 2.25], 0.3),
    section([-2.7, 2.025], [-3.0, 2.25], 0.3),
    section([-2.7, 1.8], [-3.0, 1.8], 0.3),
    section([-2.7, 1.575], [-3.0, 1.35], 0.3),
    section([-2.5, 1.125], [-2.65, 0.9375], 0.3),
    section([-2.0, 0.9], [-1.9, 0.6], 0.3),
];
const SPOUT: [Section; 7] = [
    section([1.7, 1.425], [1.7, 0.6], 0.66),
    section([2.6, 1.425], [3.1, 0.825], 0.66),
    section([2.3, 2.1], [2.4, 2.025], 0.25),
    section([2.7, 2.4], [3.3, 2.4], 0.25),
    section([2.8, 2.475], [3.525, 2.49375], 0.25),
    section([2.9, 2.475], [3.45, 2.5125], 0.15),
    section([2.8, 2.4], [3.2, 2.4], 0.15),
];

#[derive(Clone, Copy)]
struct Section {
    inner: [f64; 2],
    outer: [f64; 2],
    half_width: f64,
}

const fn section(inner: [f64; 2], outer: [f64; 2], half_width: f64) -> Section {
    Section { inner, outer, half_width }
}

/// Control points in Newell's space (z up), `patch[row][column]`: columns turn around, rows go along, and
/// (along columns) x (along rows) points outwards.
type Patch = [[DVec3; 4]; 4];

/// The teapot with `level * level` quads per patch, 1 <= level <= MAX_LEVEL, standing on y = 0, its spout along +x. Each
/// patch has its own vertices and texture coordinates; where patches meet their positions are equal to
/// the last bit.
pub fn teapot(level: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for profile in &PROFILES {
        let patch = profile.map(revolution_row);
        for mirror in [[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]] {
            tessellate(&mut mesh, &patch, mirror, level);
        }
    }
    for sections in [&HANDLE[..4], &HANDLE[3..], &SPOUT[..4], &SPOUT[3..]] {
        let patch = [0, 1, 2, 3].map(|row| section_row(sections[row]));
        for mirror in [[1.0, 1.0], [1.0, -1.0]] {
            tessellate(&mut mesh, &patch, mirror, level);
        }
    }
    mesh
}

fn revolution_row([radius, height]: [f64; 2]) -> [DVec3; 4] {
    let quarter = if [radius, height] == KNOB_CIRCLE { KNOB_QUARTER } else { QUARTER };
    [[1.0, 0.0], [1.0, -quarter], [quarter, -1.0], [0.0, -1.0]]
        .map(|[x, y]| DVec3::new(radius * x, radius * y, height))
}

fn section_row(section: Section) -> [DVec3; 4] {
    let ([x0, z0], [x1, z1], y) = (section.inner, section.outer, -section.half_width);
    [DVec3::new(x0, 0.0, z0), DVec3::new(x0, y, z0), DVec3::new(x1, y, z1), DVec3::new(x1, 0.0, z1)]
}

/// Adds a patch, mirrored by the factors of x and y.
fn tessellate(mesh: &mut Mesh, patch: &Patch, mirror: [f64; 2], level: u32) {
    let first = mesh.positions.len() as u32;
    let reflected = mirror[0] * mirror[1] < 0.0;
    // Turns z up into y up, and -0 into 0.
    let store = |v: DVec3| [v.x * mirror[0], v.z, -v.y * mirror[1]].map(|component| (component + 0.0) as f32);
    for i in 0..=level {
        for j in 0..=level {
            let (position, normal) = evaluate(patch, [j, i], level);
            mesh.positions.push(store(position));
            mesh.normals.push(store(normal));
            mesh.uvs.push([j as f32 / level as f32, (level - i) as f32 / level as f32]);
        }
    }
    for i in 0..level {
        for j in 0..level {
            let a = first + i * (level + 1) + j;
            let (b, c, d) = (a + 1, a + level + 1, a + level + 2);
            for [p, q, r] in [[a, b, c], [b, d, c]] {
                let corner = |index: u32| mesh.positions[index as usize];
                // At a pole an edge of the patch shrinks to a point.
                if corner(p) != corner(q) && corner(q) != corner(r) && corner(r) != corner(p) {
                    mesh.triangles.push(if reflected { [p, r, q] } else { [p, q, r] });
                }
            }
        }
    }
}

/// Point and outward unit normal at (column, row) / level.
fn evaluate(patch: &Patch, [column, row]: [u32; 2], level: u32) -> (DVec3, DVec3) {
    let (across, across_slope) = (bernstein(column, level), bernstein_slope(column, level));
    let (along, along_slope) = (bernstein(row, level), bernstein_slope(row, level));
    let rows = patch.map(|points| combine(&points, &across));
    let row_slopes = patch.map(|points| combine(&points, &across_slope));
    let position = combine(&rows, &along);
    let normal = combine(&row_slopes, &along).cross(combine(&rows, &along_slope));
    // Poles are on the axis: up on the lid, down below the bottom.
    let pole = DVec3::Z * if position.z > 1.0 { 1.0 } else { -1.0 };
    (position, if normal.length() > 1e-9 { normal.normalize() } else { pole })
}

/// Symmetric in its order, so that two patches that meet find the same border even if they run along it in
/// opposite directions.
fn combine(points: &[DVec3; 4], weights: &[f64; 4]) -> DVec3 {
    (points[0] * weights[0] + points[3] * weights[3]) + (points[1] * weights[1] + points[2] * weights[2])
}

/// Bernstein polynomials of degree 3 at k / n.
fn bernstein(k: u32, n: u32) -> [f64; 4] {
    let (t, s) = parameter(k, n);
    [s * s * s, 3.0 * (s * s) * t, 3.0 * (t * t) * s, t * t * t]
}

/// Their derivatives.
fn bernstein_slope(k: u32, n: u32) -> [f64; 4] {
    let (t, s) = parameter(k, n);
    [-3.0 * (s * s), 3.0 * s * (s - 2.0 * t), 3.0 * t * (2.0 * s - t), 3.0 * (t * t)]
}

fn parameter(k: u32, n: u32) -> (f64, f64) {
    (f64::from(k) / f64::from(n), f64::from(n - k) / f64::from(n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::check;
    use std::collections::HashSet;

    #[test]
    fn counts_bounds_and_outsides() {
        for level in [1, 2, 3, 7, 10, 32] {
            let mesh = teapot(level);
            assert_eq!(mesh.positions.len() as u32, 32 * (level + 1) * (level + 1));
            assert_eq!(mesh.triangles.len() as u64, count(level));
        }
        let mesh = teapot(24);
        check::sound(&mesh);
        assert!(check::volume(&mesh) > 15.0, "{}", check::volume(&mesh));
        let bounds = mesh.positions.iter().fold(([9f32; 3], [-9f32; 3]), |(low, high), p| {
            ([0, 1, 2].map(|k| low[k].min(p[k])), [0, 1, 2].map(|k| high[k].max(p[k])))
        });
        assert_eq!(bounds.0[1], 0.0);
        assert_eq!(bounds.1[1], 3.15);
        assert_eq!(bounds.0[2], -bounds.1[2]);
        assert!((bounds.0[0] + 3.0).abs() < 0.1 && (bounds.1[0] - 3.43).abs() < 0.1, "{bounds:?}");
    }

    #[test]
    fn left_mirrors_right() {
        let mesh = teapot(9);
        let bits = |p: [f32; 3]| p.map(|c| (c + 0.0).to_bits());
        let all: HashSet<_> = mesh.positions.iter().map(|&p| bits(p)).collect();
        assert!(mesh.positions.iter().all(|&[x, y, z]| all.contains(&bits([x, y, -z]))));
    }

    #[test]
    fn patches_meet_to_the_last_bit() {
        // At level 1 handle and spout are flat, and both their sides use the same edges.
        for level in [2, 3, 8, 10] {
            // What stays open: two circles each of lid and rim, and both ends of handle and spout.
            let open = check::open_edges(&teapot(level));
            assert_eq!(open.len() as u32, 16 * level, "level {level}");
        }
    }

    #[test]
    fn poles_look_along_the_axis() {
        let mesh = teapot(5);
        for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
            match position {
                [0.0, 3.15, 0.0] => assert_eq!(*normal, [0.0, 1.0, 0.0]),
                [0.0, 0.0, 0.0] => assert_eq!(*normal, [0.0, -1.0, 0.0]),
                _ => {}
            }
        }
        let at_pole = |p: &&[f32; 3]| p[0] == 0.0 && p[2] == 0.0;
        assert_eq!(mesh.positions.iter().filter(at_pole).count(), 2 * 4 * 6);
    }
}
