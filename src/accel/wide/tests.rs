use super::super::Accel;
use super::super::grid::Grid;
use super::*;
use crate::geometry::NONE;
use crate::scene::generate::icosphere::icosphere;
use crate::scene::mesh::Sphere;
use glam::DVec3;
use proptest::prelude::*;

/// Triangles and spheres with many coincidences: coordinates from a coarse lattice.
fn soup() -> impl Strategy<Value = Surfaces> {
    let coordinate = || prop_oneof![(-4i8..=4).prop_map(|c| f32::from(c) / 4.0), -1.0f32..1.0];
    let point = || prop::array::uniform3(coordinate());
    let thin = (point(), point(), prop_oneof![Just(1e-7f32), Just(1e-3)])
        .prop_map(|(a, b, width)| [a, b, [a[0] + width, a[1] - width, a[2] + 0.5 * width]]);
    let triangle = prop_oneof![4 => prop::array::uniform3(point()), 1 => thin];
    let sphere = (point(), prop_oneof![Just(0.25f32), 0.01f32..0.5])
        .prop_map(|(center, radius)| Sphere { center, radius });
    (prop::collection::vec(triangle, 0..60), prop::collection::vec(sphere, 0..10)).prop_map(
        |(triangles, spheres)| Surfaces {
            positions: triangles.concat().into(),
            triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            spheres: spheres.into(),
            ..Surfaces::default()
        },
    )
}

/// Trees of all kinds: as they are usually built, and with as many cuts as can be.
fn trees(surfaces: &Surfaces) -> Vec<(&'static str, Wide)> {
    vec![
        ("balanced", Wide::build(surfaces, BuildPreset::Balanced)),
        ("best", Wide::build(surfaces, BuildPreset::Best)),
        ("shredded", shredded(surfaces)),
    ]
}

fn shredded(surfaces: &Surfaces) -> Wide {
    let ids = solid(surfaces);
    if ids.is_empty() {
        return Wide::default();
    }
    let boxes: Vec<Aabb> = ids.iter().map(|&id| bounds(surfaces, id)).collect();
    let cuts = Cuts { more: 20 * ids.len(), fewest: 2, of_root: 0.0, of_node: 0.0 };
    Wide::of(&spatial::build(surfaces, &ids, &boxes, cuts, in_a_leaf(surfaces)), &ids, surfaces)
}

/// Ways that lie in a triangle's plane but for a little, over its inside and out over an edge.
fn grazing(surfaces: &Surfaces, tilt: f64) -> Vec<Ray> {
    let triangles = (0..surfaces.triangles.len().min(12) as u32).map(|id| surfaces.triangle(id));
    triangles
        .map(|corners| corners.map(|v| DVec3::from(v.map(f64::from))))
        .flat_map(|[a, b, c]| {
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let across = |from: DVec3, over: DVec3, lift: f64| {
                let origin = over + 3.0 * (from - over) + lift * tilt * normal;
                let direction = over - origin;
                Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE }
            };
            let middle = (a + b + c) / 3.0;
            [
                across(a, middle, 1.0),
                across(0.5 * (a + b), c, -1.0),
                across(b, 0.9 * a + 0.1 * c, 2.0),
                across(b, c, 1.0),
            ]
        })
        .filter(|ray| ray.direction != DVec3::ZERO)
        .collect()
}

/// Every way to trace at every level that the processor has.
fn modes() -> impl Iterator<Item = (Level, Traversal)> {
    let levels = Level::ALL.into_iter().filter(|level| level.is_available());
    levels.flat_map(|level| Traversal::ALL.into_iter().map(move |traversal| (level, traversal)))
}

fn direction() -> impl Strategy<Value = [f64; 3]> {
    let component = || prop_oneof![Just(0.0), Just(-0.0), Just(1.0), Just(-0.5), Just(1e-310), -1.0f64..1.0];
    prop::array::uniform3(component()).prop_filter("a direction", |d| d.iter().any(|c| c.abs() > 1e-3))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn answers_exactly_as_brute_force(
        surfaces in soup(),
        origin in prop::array::uniform3(prop_oneof![(-8i8..=8).prop_map(|c| f64::from(c) / 4.0), -3.0f64..3.0]),
        directions in prop::collection::vec(direction(), 8),
        far in prop_oneof![Just(1.0), Just(1e6)],
        tilt in prop_oneof![Just(1e-17), Just(1e-15), Just(1e-12), Just(1e-9), Just(1e-6)],
    ) {
        let mut rays = grazing(&surfaces, tilt);
        for d in directions {
            let ray = Ray {
                origin: DVec3::from(origin) * far,
                direction: if far > 1.0 { DVec3::from(d) - DVec3::from(origin) * far } else { DVec3::from(d) },
                t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE,
            };
            if ray.direction == DVec3::ZERO {
                continue;
            }
            rays.push(ray);
            let truth = Accel::Brute.closest(&surfaces, &ray);
            if truth.is_hit() {
                rays.push(Ray { t_min: truth.t, first_id: truth.primitive + 1, ..ray });
                rays.push(Ray { t_max: truth.t, ..ray });
                if truth.t > 1e-300 {
                    rays.push(Ray { t_max: truth.t.next_down(), ..ray });
                }
                let spawned = Ray { origin: ray.origin + ray.direction * truth.t, direction: DVec3::from(origin) - ray.direction, start: truth.primitive, ..ray };
                if spawned.direction != DVec3::ZERO {
                    rays.push(spawned);
                }
            }
        }
        let truth: Vec<Answer> = rays.iter().map(|ray| Accel::Brute.closest(&surfaces, ray)).collect();
        let hits: Vec<bool> = truth.iter().map(Answer::is_hit).collect();
        for density in [0.01, 1.0, 300.0] {
            let grid = Accel::Grid(Grid::build(&surfaces, density));
            for (ray, truth) in rays.iter().zip(&truth) {
                prop_assert_eq!(&grid.closest(&surfaces, ray), truth, "grid of {} {:?}", density, ray);
                prop_assert_eq!(grid.occluded(&surfaces, ray), truth.is_hit());
            }
            let mut answers = vec![Answer::MISS; rays.len()];
            let Accel::Grid(grid) = &grid else { unreachable!() };
            grid.trace(Level::chosen(), &surfaces, &(rays.as_slice(), false), &mut answers);
            prop_assert_eq!(&answers, &truth, "grid of {}", density);
        }
        let mut answers = vec![Answer::MISS; rays.len()];
        for ((name, wide), (level, traversal)) in
            trees(&surfaces).iter().flat_map(|tree| modes().map(move |mode| (tree, mode)))
        {
            wide.trace_at(level, traversal, &surfaces, &(rays.as_slice(), false), &mut answers);
            for (index, (answer, truth)) in answers.iter().zip(&truth).enumerate() {
                prop_assert_eq!(answer, truth, "{} {:?} {:?} {:?}", name, level, traversal, rays[index]);
            }
            wide.trace_rays(level, &surfaces, &rays, true, &mut answers);
            prop_assert_eq!(answers.iter().map(Answer::is_hit).collect::<Vec<_>>(), hits.clone(), "{} {:?}", name, level);
        }
    }
}

/// Rays from near one point towards one another's neighbourhood: packets, aimed at vertices and edges too.
fn beam(surfaces: &Surfaces, from: DVec3, towards: DVec3, spread: f64, jitters: &[[i8; 3]]) -> Vec<Ray> {
    let corner = |index: usize| surfaces.positions.get(index).map(|&v| DVec3::from(v.map(f64::from)));
    jitters
        .iter()
        .enumerate()
        .map(|(index, jitter)| {
            let aside = DVec3::from(jitter.map(f64::from)) / 64.0;
            let at = match index % 4 {
                0 => towards + aside * spread,
                1 => corner(3 * (index / 4)).unwrap_or(towards),
                2 => {
                    0.5 * (corner(3 * (index / 4)).unwrap_or(towards)
                        + corner(3 * (index / 4) + 1).unwrap_or(towards))
                }
                _ => towards + aside * spread * 0.01,
            };
            // Half of the beams leave one point.
            let origin = if spread < 0.5 { from } else { from + aside * 0.1 };
            Ray { origin, direction: at - origin, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE }
        })
        .filter(|ray| ray.direction != DVec3::ZERO)
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn packets_answer_exactly_as_brute_force(
        surfaces in soup(),
        from in prop::array::uniform3(prop_oneof![(-12i8..=12).prop_map(|c| f64::from(c) / 4.0), -3.0f64..3.0]),
        towards in prop::array::uniform3(-0.5f64..0.5),
        spread in prop_oneof![Just(0.1), Just(0.4), Just(1.0), Just(2.0)],
        jitters in prop::collection::vec(prop::array::uniform3(-64i8..64), 20..150),
        far in prop_oneof![Just(1.0), Just(1.0), Just(1e4), Just(1e8)],
    ) {
        let mut rays = beam(&surfaces, DVec3::from(from) * far, DVec3::from(towards), spread, &jitters);
        let closest: Vec<Answer> = rays.iter().map(|ray| Accel::Brute.closest(&surfaces, ray)).collect();
        // From what they hit to a light at the first origin, as shadow rays go.
        let light = DVec3::from(from);
        let spawned: Vec<Ray> = rays.iter().zip(&closest).filter(|(_, hit)| hit.is_hit()).map(|(ray, hit)| {
            let origin = ray.origin + ray.direction * hit.t;
            Ray { origin, direction: light + DVec3::splat(0.125) - origin, t_max: 1.0, start: hit.primitive, ..*ray }
        }).filter(|ray| ray.direction != DVec3::ZERO).collect();
        let limited: Vec<Ray> = rays.iter().zip(&closest).map(|(ray, hit)| Ray { t_max: hit.t, ..*ray }).collect();
        let beyond: Vec<Ray> = rays.iter().zip(&closest).filter(|(_, hit)| hit.is_hit()).map(|(ray, hit)| {
            Ray { t_min: hit.t, first_id: hit.primitive + 1, ..*ray }
        }).collect();
        rays.extend(spawned);
        rays.extend(limited);
        rays.extend(beyond);
        let truth: Vec<Answer> = rays.iter().map(|ray| Accel::Brute.closest(&surfaces, ray)).collect();
        let mut answers = vec![Answer::MISS; rays.len()];
        let levels = || Level::ALL.into_iter().filter(|level| level.is_available());
        for (density, level) in [0.05, 3.0, 300.0].into_iter().flat_map(|density| levels().map(move |level| (density, level))) {
            let grid = Grid::build(&surfaces, density);
            grid.trace(level, &surfaces, &(rays.as_slice(), false), &mut answers);
            for (index, (answer, truth)) in answers.iter().zip(&truth).enumerate() {
                prop_assert_eq!(answer, truth, "grid of {} {:?} {:?}", density, level, rays[index]);
            }
            grid.trace(level, &surfaces, &(rays.as_slice(), true), &mut answers);
            for (index, (answer, truth)) in answers.iter().zip(&truth).enumerate() {
                prop_assert_eq!(answer.is_hit(), truth.is_hit(), "grid of {} {:?} {:?}", density, level, rays[index]);
            }
        }
        for ((name, wide), level) in trees(&surfaces).iter().flat_map(|tree| levels().map(move |level| (tree, level))) {
            wide.trace_rays(level, &surfaces, &rays, false, &mut answers);
            for (index, (answer, truth)) in answers.iter().zip(&truth).enumerate() {
                prop_assert_eq!(answer, truth, "{} {:?} {:?}", name, level, rays[index]);
            }
            wide.trace_rays(level, &surfaces, &rays, true, &mut answers);
            for (index, (answer, truth)) in answers.iter().zip(&truth).enumerate() {
                prop_assert_eq!(answer.is_hit(), truth.is_hit(), "{:?} {:?}", level, rays[index]);
            }
        }
    }
}

/// A ball of small triangles and some that go right across it.
fn sphere_with_sails() -> Surfaces {
    let mesh = icosphere(5, DVec3::ZERO, 1.0);
    let (mut positions, mut triangles) = (mesh.positions, mesh.triangles);
    for sail in 0..20 {
        let turn = sail as f32 / 10.0 - 1.0;
        let first = positions.len() as u32;
        positions.extend([[-2.0, turn, -1.0], [2.0, -turn, -turn], [turn, 1.5, 2.0]]);
        triangles.push([first, first + 1, first + 2]);
    }
    Surfaces { positions: positions.into(), triangles: triangles.into(), ..Surfaces::default() }
}

#[test]
fn no_more_leaves_than_allowed_and_each_primitive_in_one_at_least() {
    let surfaces = sphere_with_sails();
    let ids = solid(&surfaces);
    let boxes: Vec<Aabb> = ids.iter().map(|&id| bounds(&surfaces, id)).collect();
    for more in [0, 7, 500] {
        let cuts = Cuts { more, ..Cuts::usual(ids.len()) };
        let leaves = spatial::build(&surfaces, &ids, &boxes, cuts, 1).nodes.len() / 2 + 1;
        assert!(leaves <= ids.len() + more, "{leaves} of {}", ids.len() + more);
        assert_eq!(leaves > ids.len(), more > 0, "sails are cut if they may be");
    }
    let wide = Wide::build(&surfaces, BuildPreset::Best);
    let mut seen = vec![0; surfaces.len()];
    let leaves = wide.tree.nodes.iter().flat_map(|node| node.children);
    for child in leaves.filter(|&child| child & tree::LEAF != 0 && child != tree::EMPTY) {
        let ids = &wide.tree.blocks[tree::block_number(child) as usize].ids[..(child & 7) as usize + 1];
        for (lane, &id) in ids.iter().enumerate() {
            assert!(!ids[..lane].contains(&id), "{id} is twice in a block");
            seen[id as usize] += 1;
        }
    }
    assert!(seen.iter().all(|&count| count >= 1) && seen.iter().any(|&count| count > 1));
}

#[test]
fn a_cell_of_very_many_primitives_takes_no_memory_for_most_of_them() {
    let surfaces = sphere_with_sails();
    let grid = Grid::build(&surfaces, 1e-9);
    assert_eq!(grid.lattice.counts, [1; 3]);
    let rays: Vec<Ray> = (0..64)
        .map(|k| {
            let aside = DVec3::new(f64::from(k % 8), f64::from(k / 8), 0.0) / 32.0;
            let (origin, direction) = (DVec3::new(0.1, 0.2, -5.0), aside + DVec3::new(-0.1, -0.1, 1.0));
            Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE }
        })
        .collect();
    let mut answers = vec![Answer::MISS; rays.len()];
    grid.trace(Level::chosen(), &surfaces, &(rays.as_slice(), false), &mut answers);
    for (answer, ray) in answers.iter().zip(&rays) {
        assert_eq!(*answer, Accel::Brute.closest(&surfaces, ray));
    }
    SCRATCH.with_borrow(|scratch| {
        let kept = scratch.gathered.as_ref().expect("the rays are a packet").view().blocks.len();
        assert!((1..1000).contains(&kept), "{kept} blocks of {}", surfaces.len() / 8);
    });
}

#[test]
fn primitives_without_an_order_make_no_deep_tree() {
    // All in one place, and one within the other: nothing tells them apart.
    let alike = [[[-1.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]]; 3000];
    let nested: Vec<_> =
        (0..3000).map(|k| alike[0].map(|v| v.map(|c| c * libm::exp2(-(k as f64) / 50.0) as f32))).collect();
    for triangles in [alike.to_vec(), nested] {
        let surfaces = Surfaces {
            positions: triangles.concat().into(),
            triangles: (0..3000).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Surfaces::default()
        };
        for preset in [BuildPreset::Fast, BuildPreset::Balanced, BuildPreset::Best] {
            let wide = Wide::build(&surfaces, preset);
            assert!(wide.tree.stack_size < 8 * 100, "{preset:?}: {}", wide.tree.stack_size);
        }
    }
}

#[test]
fn any_number_of_threads_builds_the_same_tree() {
    let surfaces = sphere_with_sails();
    for preset in [BuildPreset::Fast, BuildPreset::Balanced, BuildPreset::Best] {
        let built = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Wide::build(&surfaces, preset)).tree
        };
        let (one, three) = (built(1), built(3));
        assert_eq!(bytemuck::cast_slice::<_, u8>(&one.nodes), bytemuck::cast_slice::<_, u8>(&three.nodes));
        assert_eq!(bytemuck::cast_slice::<_, u8>(&one.blocks), bytemuck::cast_slice::<_, u8>(&three.blocks));
    }
}

#[test]
fn every_primitive_lies_in_one_block_and_in_all_boxes_above() {
    let mesh = icosphere(4, DVec3::new(3.0, -1.0, 0.5), 2.0);
    let surfaces = Surfaces {
        positions: mesh.positions.into(),
        triangles: mesh.triangles.into(),
        ..Surfaces::default()
    };
    let wide = Wide::build(&surfaces, BuildPreset::Balanced);
    let (mut seen, mut waiting) =
        (vec![0; surfaces.len()], vec![(0u32, [f32::NEG_INFINITY; 3], [f32::INFINITY; 3])]);
    while let Some((index, low, high)) = waiting.pop() {
        let node = &wide.tree.nodes[index as usize];
        for lane in (0..tree::WIDTH).filter(|&lane| node.children[lane] != tree::EMPTY) {
            let below: [f32; 3] = std::array::from_fn(|axis| node.planes[axis][lane]);
            let above: [f32; 3] = std::array::from_fn(|axis| node.planes[axis + 3][lane]);
            assert!((0..3).all(|axis| below[axis] >= low[axis] && above[axis] <= high[axis]));
            let child = node.children[lane];
            if child & tree::LEAF == 0 {
                waiting.push((child, below, above));
                continue;
            }
            let block = &wide.tree.blocks[tree::block_number(child) as usize];
            for &id in &block.ids[..(child & 7) as usize + 1] {
                seen[id as usize] += 1;
                let corners = surfaces.triangle(id);
                assert!(
                    corners
                        .iter()
                        .all(|v| (0..3).all(|axis| v[axis] >= below[axis] && v[axis] <= above[axis]))
                );
            }
        }
    }
    assert!(seen.iter().all(|&count| count == 1));
}

#[test]
fn nothing_is_hit_where_nothing_is() {
    let empty = Surfaces::default();
    let flat = Surfaces {
        positions: vec![[0.0; 3]; 3].into(),
        triangles: vec![[0, 1, 2]].into(),
        ..Surfaces::default()
    };
    let ray = Ray {
        origin: DVec3::ZERO,
        direction: DVec3::X,
        t_min: 0.0,
        t_max: f64::INFINITY,
        first_id: 0,
        start: NONE,
    };
    for surfaces in [empty, flat] {
        let accel = Accel::Bvh(Wide::build(&surfaces, BuildPreset::Fast));
        assert!(!accel.closest(&surfaces, &ray).is_hit());
    }
}

#[test]
fn levels_are_named_and_never_above_what_there_is() {
    for level in Level::ALL {
        let found = Level::named(level.name()).unwrap();
        assert!(found <= level && found.is_available());
    }
    assert!(Level::named("sse9").is_err());
}
