//! Matt rooms by radiosity (Goral, Torrance, Greenberg and Battaile 1984), against paths in the same rooms. Form factors are Lambert's formula averaged over
//! the patch that receives; what a pixel shows is gathered from all patches at the points that it sees.

use std::collections::BTreeMap;

use glam::DVec3;
use heliostat::scene::{Color, Scene};
use heliostat::settings::Direct;

use super::common::repository;
use super::geometry::{Rectangle, factor};
use super::judge::LIMIT;
use super::stage::Stage;
use super::text::Text;

/// A flat surface that is cut into patches at the same fractions of its edges.
#[derive(Clone, Debug)]
struct Wall {
    shape: Rectangle,
    albedo: Color,
    emission: Color,
    cuts: [Vec<f64>; 2],
}

/// A wall's part with its radiance, once that is known.
#[derive(Clone, Debug)]
struct Patch {
    shape: Rectangle,
    wall: usize,
    albedo: Color,
    emission: Color,
    radiance: Color,
}

/// Patches of a room without anything in the way.
struct Room {
    walls: Vec<Rectangle>,
    patches: Vec<Patch>,
}

/// Evenly spaced fractions.
fn even(count: u32) -> Vec<f64> {
    (0..=count).map(|i| f64::from(i) / f64::from(count)).collect()
}

impl Room {
    /// `lamps` lie in walls: the patches there are the lamps' instead.
    fn new(walls: &[Wall]) -> Self {
        let mut patches = Vec::new();
        for (number, Wall { shape, albedo, emission, cuts: [across, along] }) in walls.iter().enumerate() {
            for u in across.windows(2) {
                for v in along.windows(2) {
                    let shape = shape.part([u[0], u[1]], [v[0], v[1]]);
                    patches.push(Patch {
                        shape,
                        wall: number,
                        albedo: *albedo,
                        emission: *emission,
                        radiance: [0.0; 3],
                    });
                }
            }
        }
        Room { walls: walls.iter().map(|wall| wall.shape).collect(), patches }
    }

    /// Lets light go to and fro until it is even.
    fn solve(&mut self) {
        // Gauss and Legendre's points of order 3.
        let nodes =
            [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];
        let share = |to: &Patch, from: &Patch| {
            if to.wall == from.wall {
                return 0.0;
            }
            let polygon = from.shape.corners();
            let normal = to.shape.normal();
            let points = nodes.iter().flat_map(|&(u, a)| nodes.map(|(v, b)| ([u, v], a * b)));
            points.map(|(place, weight)| weight * factor(to.shape.point(place), normal, &polygon)).sum()
        };
        let shares: Vec<Vec<f64>> =
            self.patches.iter().map(|to| self.patches.iter().map(|from| share(to, from)).collect()).collect();
        for _ in 0..60 {
            let gathered: Vec<Color> = shares.iter().map(|row| sum(row.iter().zip(&self.patches))).collect();
            for (patch, gathered) in self.patches.iter_mut().zip(gathered) {
                patch.radiance = std::array::from_fn(|k| patch.emission[k] + patch.albedo[k] * gathered[k]);
            }
        }
    }

    /// The wall that a ray meets first, the place on it, and the radiance from there.
    fn look(&self, origin: DVec3, direction: DVec3) -> Option<(usize, [f64; 2], Color)> {
        let hits = self.walls.iter().enumerate().filter(|(_, wall)| wall.normal().dot(direction) < 0.0);
        let hits = hits.filter_map(|(number, wall)| wall.meet(origin, direction).map(|hit| (number, hit)));
        let (number, (_, place)) = hits.min_by(|(_, (a, _)), (_, (b, _))| a.total_cmp(b))?;
        let wall = &self.walls[number];
        let (point, normal) = (wall.point(place), wall.normal());
        let own = self.patches.iter().find(|patch| patch.wall == number && patch.shape.holds(point))?;
        let others = self.patches.iter().filter(|patch| patch.wall != number);
        let shares: Vec<f64> =
            others.clone().map(|patch| factor(point, normal, &patch.shape.corners())).collect();
        let gathered = sum(shares.iter().zip(others));
        Some((number, place, std::array::from_fn(|k| own.emission[k] + own.albedo[k] * gathered[k])))
    }
}

impl Rectangle {
    /// Whether a point of its plane is within it.
    fn holds(&self, point: DVec3) -> bool {
        let at = point - self.corner;
        [self.across, self.along].iter().all(|edge| (0.0..=edge.length_squared()).contains(&at.dot(*edge)))
    }
}

fn sum<'a>(shares: impl Iterator<Item = (&'a f64, &'a Patch)>) -> Color {
    shares.fold([0.0; 3], |sum, (share, patch)| std::array::from_fn(|k| sum[k] + share * patch.radiance[k]))
}

/// A perspective or, with `fov` 0, orthographic view of a square image.
struct View {
    position: DVec3,
    forward: DVec3,
    right: DVec3,
    up: DVec3,
    is_parallel: bool,
}

impl View {
    fn ray(&self, x: f64, y: f64) -> (DVec3, DVec3) {
        let aside = self.right * x + self.up * y;
        if self.is_parallel {
            (self.position + aside, self.forward)
        } else {
            (self.position, self.forward + aside)
        }
    }
}

/// Pixels by wall and quarter of it, with what radiosity says of each.
type Regions = BTreeMap<(usize, usize), Vec<(u32, Color)>>;

/// More than any wall here reflects.
const BRIGHT: f64 = 3.0;

/// What is seen of a room, but for pixels that see an edge or a lamp.
fn regions(room: &Room, view: &View, size: u32) -> Regions {
    const FINE: u32 = 3;
    let mut regions: Regions = Regions::new();
    for pixel in 0..size * size {
        // At a place in the pixel, in parts of its edge.
        let look = |x: f64, y: f64| {
            let film = |at: u32, part: f64| 2.0 * (f64::from(at) + part) / f64::from(size) - 1.0;
            let (origin, direction) = view.ray(film(pixel % size, x), -film(pixel / size, y));
            room.look(origin, direction)
        };
        let around = [0.0, 0.5, 1.0].map(|y| [0.0, 0.5, 1.0].map(|x| look(x, y)));
        let centre = |k: u32| (f64::from(k) + 0.5) / f64::from(FINE);
        let looks = (0..FINE * FINE).map(|k| look(centre(k % FINE), centre(k / FINE)));
        let Some(looks) = looks.collect::<Option<Vec<_>>>() else { continue };
        let (wall, [u, v], _) = looks[4];
        let is_plain = |look: &Option<(usize, [f64; 2], Color)>| {
            look.is_some_and(|(other, _, radiance)| other == wall && radiance[0] < BRIGHT)
        };
        if !around.as_flattened().iter().all(is_plain) || looks.iter().any(|(.., c)| c[0] > BRIGHT) {
            continue;
        }
        let quarter = usize::from(u > 0.5) + 2 * usize::from(v > 0.5);
        let mean = std::array::from_fn(|c| looks.iter().map(|(.., radiance)| radiance[c]).sum::<f64>() / 9.0);
        regions.entry((wall, quarter)).or_default().push((pixel, mean));
    }
    regions
}

/// The error that patches of constant radiance leave: stated, and seen by taking half as many along an edge.
const STATED: f64 = 0.004;

/// Compares the mean of each region and channel.
fn judge(what: &str, stage: &mut Stage, seeds: u64, regions: &Regions) {
    let images = stage.seeds(seeds);
    let (mut worst, mut worst_z): (f64, f64) = (0.0, 0.0);
    for (name, pixels) in regions {
        for channel in 0..3 {
            let count = pixels.len() as f64;
            let expected = pixels.iter().map(|(_, color)| color[channel]).sum::<f64>() / count;
            let means = images.iter().map(|image| {
                let values =
                    pixels.iter().map(|&(pixel, _)| f64::from(image.pixels[pixel as usize][channel]));
                values.sum::<f64>() / count
            });
            let found = super::judge::Estimate::of(means.collect::<Vec<_>>().into_iter());
            let off = found.mean / expected - 1.0;
            worst = if off.abs() > worst.abs() { off } else { worst };
            worst_z = worst_z.max((found.mean - expected).abs() / found.error());
            let room = STATED * expected + LIMIT * found.error();
            assert!(
                (found.mean - expected).abs() < room,
                "{what}, wall and quarter {name:?}, channel {channel}: {} ± {}, radiosity says {expected}",
                found.mean,
                found.error()
            );
            assert!(found.error() < 0.02 * expected, "{what} {name:?}: too noisy to judge");
        }
    }
    println!(
        "{what}: {} regions, worst off by {:.3} %, most standard errors {worst_z:.1}",
        regions.len(),
        100.0 * worst
    );
}

/// The five walls of scenes/cornell-path.toml and its lamp, which lies in the ceiling: 0.2 mm below it there, too little to see.
fn cornell(count: u32, scene: &Scene) -> Room {
    let [white, red, green, lamp] = &scene.header.materials[..] else { panic!("four materials") };
    let (white, red, green) = (white.kd, red.kd, green.kd);
    let (w, h, d) = (556.0, 549.0, 560.0);
    let wall = |corner, across, along, albedo| Wall {
        shape: Rectangle::new(corner, across, along),
        albedo,
        emission: [0.0; 3],
        cuts: [even(count), even(count)],
    };
    let mut walls = vec![
        wall([0.0, 0.0, 0.0], [0.0, 0.0, d], [w, 0.0, 0.0], white),
        wall([0.0, 0.0, d], [0.0, h, 0.0], [w, 0.0, 0.0], white),
        wall([w, 0.0, 0.0], [0.0, 0.0, d], [0.0, h, 0.0], red),
        wall([0.0, 0.0, 0.0], [0.0, h, 0.0], [0.0, 0.0, d], green),
        wall([0.0, h, 0.0], [w, 0.0, 0.0], [0.0, 0.0, d], white),
    ];
    // The ceiling is cut along the lamp's edges.
    let cut = |low: f64, high: f64, length: f64| {
        let side = count.div_ceil(2);
        let runs = [(0.0, low, side), (low, high, count.div_ceil(4)), (high, length, side)];
        let mut cuts = vec![0.0];
        for (from, to, count) in runs {
            cuts.extend((1..=count).map(|i| (from + (to - from) * f64::from(i) / f64::from(count)) / length));
        }
        cuts
    };
    walls[4].cuts = [cut(213.0, 343.0, w), cut(227.0, 332.0, d)];
    let mut room = Room::new(&walls);
    let middle = DVec3::new(278.0, h, 279.5);
    for patch in &mut room.patches {
        let away = (patch.shape.point([0.5, 0.5]) - middle).abs();
        if patch.wall == 4 && away.x < 65.0 && away.z < 52.5 {
            (patch.albedo, patch.emission) = (lamp.kd, lamp.emission);
        }
    }
    room.solve();
    room
}

#[test]
fn the_empty_cornell_box() {
    let size = 32;
    let text = std::fs::read_to_string(repository().join("scenes/cornell-path.toml")).unwrap();
    let (empty, _) = text.split_once("[[object]]\ntype = \"box\"").expect("the blocks come last");
    let mut stage = Stage::new(empty, &[]).sized(size, size);
    stage.image.spp = 64;
    let half = libm::tan(39.3f64.to_radians() / 2.0);
    let view = View {
        position: DVec3::new(278.0, 273.0, -800.0),
        forward: DVec3::Z,
        right: DVec3::NEG_X * half,
        up: DVec3::Y * half,
        is_parallel: false,
    };
    let fine = cornell(12, stage.scene());
    let regions = regions(&fine, &view, size);
    assert!(regions.len() >= 18, "{} regions", regions.len());
    // Halving patches tells what is left of their error.
    let coarse = self::regions(&cornell(6, stage.scene()), &view, size);
    let mut change: f64 = 0.0;
    for ((name, fine), (_, coarse)) in regions.iter().zip(&coarse) {
        let mean = |pixels: &[(u32, Color)]| {
            pixels.iter().flat_map(|(_, color)| color).sum::<f64>() / pixels.len() as f64
        };
        let off = mean(coarse) / mean(fine) - 1.0;
        assert!(off.abs() < 3.0 * STATED, "{name:?}: patches twice as large change it by {off}");
        change = change.max(off.abs());
    }
    println!("patches twice as large: {:.3} %", 100.0 * change);
    judge("Cornell box", &mut stage, 8, &regions);
    stage.image.direct = Direct::Light;
    judge("Cornell box, lights only", &mut stage, 8, &regions);
}

/// Two squares face to face. The upper one shines too.
#[test]
fn two_parallel_plates() {
    let size = 24;
    let text = Text::from_above(0.3, 0.96)
        .image(size, 16, "")
        .material("lower", "kd = [0.9, 0.6, 0.3]")
        .material("upper", "kd = [0.5, 0.7, 0.9]\nemission = [1, 2, 0.5]\nemission_side = \"front\"")
        .plane(1, "lower", "")
        .plane(1, "upper", "rotate = [180, 0, 0]\ntranslate = [0, 0.6, 0]");
    let wall = |corner, across, along, albedo, emission| Wall {
        shape: Rectangle::new(corner, across, along),
        albedo,
        emission,
        cuts: [even(14), even(14)],
    };
    let mut room = Room::new(&[
        wall([-0.5, 0.0, -0.5], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.9, 0.6, 0.3], [0.0; 3]),
        wall([-0.5, 0.6, -0.5], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.7, 0.9], [1.0, 2.0, 0.5]),
    ]);
    room.solve();
    // Opposite unit squares at 0.6 (Howell, C-11), as a check of the form factors: 0.3525... of one's light meets the other.
    let (x, h) = (1.0f64 / 0.6, (1.0f64 + 1.0 / 0.36).sqrt());
    let known = 2.0 / (std::f64::consts::PI * x * x)
        * (0.5 * libm::log((1.0 + x * x) * (1.0 + x * x) / (1.0 + 2.0 * x * x))
            + 2.0 * x * h * libm::atan(x / h)
            - 2.0 * x * libm::atan(x));
    let half = room.patches.len() / 2;
    let shares = room.patches[..half].iter().map(|to| {
        let normal = to.shape.normal();
        factor(to.shape.point([0.5, 0.5]), normal, &room.walls[1].corners())
    });
    let found = shares.sum::<f64>() / half as f64;
    assert!((found / known - 1.0).abs() < 2e-3, "{found} {known}");

    let view = View {
        position: DVec3::new(0.0, 0.3, 0.0),
        forward: DVec3::NEG_Y,
        right: DVec3::X * 0.48,
        up: DVec3::NEG_Z * 0.48,
        is_parallel: true,
    };
    let regions = regions(&room, &view, size);
    assert_eq!(regions.len(), 4);
    let mut stage = Stage::new(text, &[]);
    for direct in [Direct::Both, Direct::Light, Direct::Bsdf] {
        stage.image.direct = direct;
        judge(&format!("plates, {direct:?}"), &mut stage, 12, &regions);
    }
}
