//! What happens across a triangle: Phong, Gouraud and flat shading, textures, vertex colours; and the image's floor
//! and background.

use glam::DVec3;
use heliostat::scene::light::LightShape;
use heliostat::scene::mesh::Mesh;
use heliostat::scene::{Color, Light, Material, Shading, Texture};

use crate::tiny::*;

const CORNERS: [DVec3; 3] =
    [DVec3::new(-1.0, 0.0, 1.0), DVec3::new(2.0, 0.0, 1.5), DVec3::new(0.25, 0.0, -1.75)];
const WEIGHTS: [f64; 3] = [0.25, 0.3, 0.45];
const EYE: DVec3 = DVec3::new(1.0, 3.0, 2.0);
const LAMP: DVec3 = DVec3::new(-0.5, 2.0, -1.0);
const MATERIAL: Material = Material { kd: [0.6, 0.5, 0.4], ks: [0.25, 0.5, 0.75], shininess: 9.5, ..BLACK };

fn hit() -> DVec3 {
    CORNERS[0] * WEIGHTS[0] + CORNERS[1] * WEIGHTS[1] + CORNERS[2] * WEIGHTS[2]
}

fn normals() -> [DVec3; 3] {
    let stored = [v(-0.3, 1.0, 0.2), v(0.4, 1.0, 0.1), v(0.1, 1.0, -0.5)].map(DVec3::normalize);
    // As f32 holds them.
    stored.map(|n| DVec3::from(n.to_array().map(|c| f64::from(c as f32))))
}

fn triangle() -> Mesh {
    let single = |p: DVec3| p.to_array().map(|c| c as f32);
    Mesh {
        positions: CORNERS.map(single).to_vec(),
        triangles: vec![[0, 1, 2]],
        normals: normals().map(single).to_vec(),
        ..Mesh::default()
    }
}

fn seen(mesh: Mesh, shading: Shading, light: &Light) -> Tiny {
    let mut tiny = Tiny::new(EYE, hit());
    tiny.mesh(mesh, &MATERIAL, shading);
    tiny.light(light);
    tiny
}

/// Each vertex's light, interpolated; `strength` is what the light has left there.
fn gouraud(normals: [DVec3; 3], light: &Light, strength: impl Fn(DVec3) -> f64) -> Color {
    (0..3).fold([0.0; 3], |total, k| {
        let at_vertex = Around::new(CORNERS[k], normals[k], LAMP, EYE).phong(&MATERIAL, light);
        sum(total, scaled(at_vertex, strength(CORNERS[k]) * WEIGHTS[k]))
    })
}

#[test]
fn phong_interpolates_normals_gouraud_light_and_flat_nothing() {
    let light = Light { falloff: Some([0.0, 0.0, 0.5]), ..point_light(LAMP) };
    let strength = |at: DVec3| 2.0 / (LAMP - at).length_squared();
    let [a, b, c] = normals();
    let blend = a * WEIGHTS[0] + b * WEIGHTS[1] + c * WEIGHTS[2];
    let at_hit =
        |normal| scaled(Around::new(hit(), normal, LAMP, EYE).phong(&MATERIAL, &light), strength(hit()));
    let (phong, flat) = (at_hit(blend), at_hit(DVec3::Y));
    let gouraud = gouraud(normals(), &light, strength);
    for (shading, expected) in [(Shading::Phong, phong), (Shading::Gouraud, gouraud), (Shading::Flat, flat)] {
        assert_color(seen(triangle(), shading, &light).color(), expected);
    }
    assert!((phong[0] - flat[0]).abs() > 1e-3 && (phong[0] - gouraud[0]).abs() > 1e-3);
}

#[test]
fn gouraud_sees_lights_at_vertices_but_shadows_at_the_hit() {
    let light = point_light(LAMP);
    let expected = gouraud(normals(), &light, |_| 1.0);
    let between = |at: DVec3| LAMP * 0.5 + at * 0.5;
    let mut tiny = seen(triangle(), Shading::Gouraud, &light);
    CORNERS.iter().for_each(|&corner| tiny.patch(between(corner).to_array(), 0.03125, &BLACK));
    assert_color(tiny.color(), expected);
    let mut tiny = seen(triangle(), Shading::Gouraud, &light);
    tiny.patch(between(hit()).to_array(), 0.03125, &BLACK);
    assert_eq!(tiny.color(), [0.0; 3]);
}

#[test]
fn gouraud_interpolates_a_spot_whose_cone_ends_inside_the_triangle() {
    for target in [CORNERS[0], hit()] {
        let direction = (target - LAMP).normalize();
        let cosine = |at: DVec3| (at - LAMP).normalize().dot(direction);
        let shape = LightShape::Spot { position: LAMP, direction, cos_inner: 0.995, cos_outer: 0.99 };
        let strength = |at: DVec3| if cosine(at) > 0.995 { 1.0 } else { 0.0 };
        let lit = CORNERS.map(strength);
        assert!(lit == [1.0, 0.0, 0.0] && cosine(hit()) < 0.99 || lit == [0.0; 3], "{lit:?}");
        let light = shining(shape);
        assert_color(
            seen(triangle(), Shading::Gouraud, &light).color(),
            gouraud(normals(), &light, strength),
        );
    }
}

#[test]
fn gouraud_turns_its_normals_from_behind() {
    let mut mesh = triangle();
    mesh.triangles = vec![[0, 2, 1]];
    let light = point_light(LAMP);
    assert_color(seen(mesh, Shading::Gouraud, &light).color(), gouraud(normals(), &light, |_| 1.0));
    let mut mesh = triangle();
    mesh.normals.iter_mut().for_each(|normal| *normal = normal.map(|c| -c));
    assert_color(seen(mesh, Shading::Gouraud, &light).color(), gouraud(normals(), &light, |_| 1.0));
}

#[test]
fn one_vertex_normal_beyond_the_horizon_is_interpolated_as_it_is() {
    // At a sharp edge a vertex normal may point behind one of its faces; turned for that face alone it would tear the
    // shading apart along the edge.
    let mut mesh = triangle();
    let beyond = v(0.8, -0.3, -0.2).normalize().to_array().map(|c| c as f32);
    mesh.normals[0] = beyond;
    let stored = [DVec3::from(beyond.map(f64::from)), normals()[1], normals()[2]];
    let light = point_light(v(3.0, 2.0, -1.0));
    let blend = stored[0] * WEIGHTS[0] + stored[1] * WEIGHTS[1] + stored[2] * WEIGHTS[2];
    let around = Around::new(hit(), blend, v(3.0, 2.0, -1.0), EYE);
    assert_color(seen(mesh.clone(), Shading::Phong, &light).color(), around.phong(&MATERIAL, &light));
    // Where the light is on the other side the vertex beyond the horizon is dark, and counts as such.
    let lamp = v(-1.5, 2.0, 0.5);
    let light = point_light(lamp);
    assert!(stored[0].dot(lamp - CORNERS[0]) < 0.0);
    let lit = (1..3).fold([0.0; 3], |total, k| {
        let at_vertex = Around::new(CORNERS[k], stored[k], lamp, EYE).phong(&MATERIAL, &light);
        sum(total, scaled(at_vertex, WEIGHTS[k]))
    });
    assert_color(seen(mesh, Shading::Gouraud, &light).color(), lit);
}

#[test]
fn gouraud_seen_by_parallel_rays_has_one_view_direction() {
    let light = point_light(LAMP);
    let mut tiny = seen(triangle(), Shading::Gouraud, &light);
    tiny.header.camera =
        heliostat::scene::Camera::orthographic(EYE, hit(), DVec3::Y, 1.0).expect("a sound camera");
    let to_viewer = (EYE - hit()).normalize();
    let expected = (0..3).fold([0.0; 3], |total, k| {
        let around = Around { to_viewer, ..Around::new(CORNERS[k], normals()[k], LAMP, EYE) };
        sum(total, scaled(around.phong(&MATERIAL, &light), WEIGHTS[k]))
    });
    assert_color(tiny.color(), expected);
}

#[test]
fn textures_multiply_kd_and_ka_and_vertex_colors_kd_alone() {
    let material = Material { ka: [0.5, 0.25, 1.0], emission: [0.125; 3], ..MATERIAL };
    let linear = |code: f64| libm::pow((code / 255.0 + 0.055) / 1.055, 2.4);
    let texel = [linear(200.0), linear(120.0), linear(60.0)];
    let painted = [[1.0, 0.5, 0.25], [0.25, 1.0, 0.5], [0.5, 0.75, 2.0f32]];
    let paint =
        [0, 1, 2].map(|k| (0..3).map(|vertex| WEIGHTS[vertex] * f64::from(painted[vertex][k])).sum::<f64>());
    let light = point_light(LAMP);
    for (textured, colored) in [(false, false), (true, false), (false, true), (true, true)] {
        let mut tiny = Tiny::new(EYE, hit());
        let mut mesh = triangle();
        let mut expected = material.clone();
        let mut material = material.clone();
        if textured {
            let texture = Texture { width: 1, height: 1, texels: vec![[200, 120, 60]].into() };
            material.texture = Some(tiny.builder.texture(texture));
            mesh.uvs = vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
            expected.kd = product(expected.kd, texel);
            expected.ka = product(expected.ka, texel);
        }
        if colored {
            mesh.colors = painted.to_vec();
            expected.kd = product(expected.kd, paint);
        }
        tiny.mesh(mesh, &material, Shading::Flat);
        tiny.header.ambient = [0.2, 0.4, 0.1];
        tiny.light(&light);
        let lit = Around::new(hit(), DVec3::Y, LAMP, EYE).phong(&expected, &light);
        let unlit = sum(product(expected.ka, [0.2, 0.4, 0.1]), expected.emission);
        assert_color(tiny.color(), sum(lit, unlit));
    }
}

#[test]
fn a_texture_is_linear_between_texel_centers() {
    for (x, z) in [(0.0, 0.0), (-3.7, 2.2), (7.5, -7.5)] {
        let mut tiny = Tiny::new(v(1.0, 5.0, 2.0), v(x, 0.0, z));
        tiny.map(0.0);
        assert_place(mapped(tiny.color()), [x, z]);
    }
}

#[test]
fn the_floor_blends_after_all_else_and_nothing_is_clamped() {
    for (color, floor) in [([0.0, 0.5, 3.0], 0.0), ([0.0, 0.5, 3.0], 0.2), ([0.25, 1.0, 2.0], 1.0)] {
        let blended = color.map(|c| (1.0 - floor) * c + floor);
        let mut surface = Tiny::new(EYE, hit());
        surface.level(0.0, &glowing(color));
        surface.header.ambient_floor = floor;
        assert_color(surface.color(), blended);
        let mut sky = Tiny::new(EYE, hit());
        sky.level(5.0, &BLACK);
        sky.header.background = color;
        sky.header.ambient_floor = floor;
        assert_color(sky.color(), blended);
    }
}
