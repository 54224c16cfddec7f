//! Local illumination: Phong, "Illumination for Computer Generated Pictures", 1975; Gouraud's interpolation, 1971.
//!
//! I = ka·Ia + Σ over lights (kd (L·N) Id + ks (R·V)^α Is); the specular term only where L·N > 0. A light behind
//! the geometric normal gives nothing either.

use glam::DVec3;

use super::surface::{Interaction, Vertex};
use super::{BLACK, add, is_black, scaled, times};
use crate::scene::light::Arrival;
use crate::scene::{Color, Light, Shading};

/// The view of a hit that illumination needs.
pub struct View {
    /// Where the ray came from.
    pub eye: DVec3,
    /// Unit vector to the viewer.
    pub to_viewer: DVec3,
    /// Whether all eye rays are parallel, so that V is the same everywhere.
    pub parallel: bool,
}

/// What one light adds if nothing is in the way.
pub fn illuminate(
    hit: &Interaction,
    light: &Light,
    arrival: &Arrival,
    view: &View,
    world_unit: f64,
) -> Color {
    if arrival.to_light.dot(hit.geometric) <= 0.0 {
        return BLACK;
    }
    let matt = times(times(hit.material.kd, hit.diffuse_tint), light.diffuse);
    let glossy = times(hit.material.ks, light.specular);
    // The power is by far the dearest part of it.
    let shininess = (!is_black(glossy)).then_some(hit.material.shininess);
    let [diffuse, specular] = match hit.shading {
        Shading::Gouraud => {
            let [u, v, w] = hit.weights;
            let at = |vertex: usize| at_vertex(&hit.vertices[vertex], shininess, light, view, world_unit);
            let ([a, i], [b, j], [c, k]) = (at(0), at(1), at(2));
            [(a * u + b * v) + c * w, (i * u + j * v) + k * w]
        }
        Shading::Phong | Shading::Flat if arrival.strength <= 0.0 => return BLACK,
        Shading::Phong | Shading::Flat => {
            let [diffuse, specular] = factors(arrival.to_light, hit.normal, view.to_viewer, shininess);
            [diffuse * arrival.strength, specular * arrival.strength]
        }
    };
    add(scaled(matt, diffuse), scaled(glossy, specular))
}

/// L·N, and R·V where that is positive; 0 where light doesn't come from the normal's side.
#[inline(always)]
pub(super) fn cosines(to_light: DVec3, normal: DVec3, to_viewer: DVec3) -> [f64; 2] {
    let inverse = to_light.length_recip();
    let l = to_light * inverse;
    let cosine = l.dot(normal);
    let highlight = (normal * (2.0 * cosine) - l).dot(to_viewer);
    let is_lit = (inverse > 0.0) & (inverse < f64::INFINITY) & (cosine > 0.0);
    [if is_lit { cosine } else { 0.0 }, if is_lit & (highlight > 0.0) { highlight } else { 0.0 }]
}

/// L·N and (R·V)^α; the latter is 0 without an exponent.
fn factors(to_light: DVec3, normal: DVec3, to_viewer: DVec3, shininess: Option<f64>) -> [f64; 2] {
    let [cosine, highlight] = cosines(to_light, normal, to_viewer);
    let power = shininess.filter(|_| highlight > 0.0).map_or(0.0, |shininess| power(highlight, shininess));
    [cosine, power]
}

/// An exponent that is a whole number, as most are, and below 2^13.
pub(super) fn whole(exponent: f64) -> Option<u32> {
    let bits = exponent as u32;
    (f64::from(bits) == exponent && bits < 1 << BITS).then_some(bits)
}

const BITS: u32 = 13;

/// x^α for x > 0.
fn power(x: f64, exponent: f64) -> f64 {
    match whole(exponent) {
        Some(bits) => whole_power(x, u64::from(bits)),
        None => libm::pow(x, exponent),
    }
}

/// x^α for x > 0 and α < 2^13, by squares and products, which take a fraction of the time of `pow` and are off by less than α ulps.
#[inline(always)]
pub(super) fn whole_power(x: f64, exponent: u64) -> f64 {
    let (mut result, mut square) = (1.0, x);
    for bit in 0..BITS {
        result = if exponent >> bit & 1 == 1 { result * square } else { result };
        square *= square;
    }
    result
}

/// Both factors at a vertex, times what arrives there.
fn at_vertex(
    vertex: &Vertex,
    shininess: Option<f64>,
    light: &Light,
    view: &View,
    world_unit: f64,
) -> [f64; 2] {
    let arrival = light.arrival(vertex.position, world_unit);
    let to_viewer = if view.parallel {
        view.to_viewer
    } else {
        (view.eye - vertex.position).try_normalize().unwrap_or(view.to_viewer)
    };
    let [diffuse, specular] = factors(arrival.to_light, vertex.normal, to_viewer, shininess);
    [diffuse * arrival.strength, specular * arrival.strength]
}

/// ka·Ia plus the surface's own emission: what needs no light ray.
pub fn unshadowed(hit: &Interaction, ambient: Color) -> Color {
    add(times(times(hit.material.ka, hit.ambient_tint), ambient), hit.emission())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_those_of_libm() {
        for exponent in [0.0, 1.0, 2.0, 7.0, 80.0, 1000.0, 4096.0, 8191.0, 0.5, 12.25, 9000.0] {
            for x in [1e-3, 0.3, 0.75, 0.999, 1.0] {
                let (own, expected) = (power(x, exponent), libm::pow(x, exponent));
                assert!(
                    (own - expected).abs() <= exponent * f64::EPSILON * expected + 1e-300,
                    "{x}^{exponent}"
                );
            }
        }
    }
}
