//! The last word on a bundle's candidates: f64 decides them side by side, exactly as `geometry::triangle` does one by one.
//!
//! Whatever is out of the ordinary (a grazing ray, an edge within rounding, a start that may be in doubt, an origin that was moved) is left to the decision for single rays.

use super::bundle::{Bundle, RAYS, first_lanes, larger};
use super::questions::Batch;
use super::tree::{Block, SPHERE_CANDIDATE};
use crate::geometry::record::Answer;
use crate::geometry::start::RADIUS;
use crate::geometry::triangle::GRAZING;
use crate::geometry::{NONE, of_axis, sphere};
use crate::scene::Surfaces;
use crate::scene::mesh::{Sphere, is_guest};

/// Lanes that are decided side by side. With fewer the compiler makes no vectors of the loop.
const GROUP: usize = 16;

/// `sphere::first` of a candidate; `None` where the ray starts on that sphere or one like it, at one of its ends, or was moved.
#[inline(always)]
fn plain_sphere(
    bundle: &Bundle,
    surfaces: &Surfaces,
    lane: usize,
    (block, k): (&Block, usize),
) -> Option<f64> {
    let (exact, start) = (&bundle.exact, bundle.start[lane]);
    let center = [block.corners[0][0][k], block.corners[0][1][k], block.corners[0][2][k]];
    let radius = block.corners[1][0][k];
    let starts_on_it = start != NONE
        && (is_guest(start)
            || surfaces.sphere_at(start).is_some_and(|own| *own == Sphere { center, radius }));
    if starts_on_it || exact.moved[lane] != 0.0 {
        return None;
    }
    let [origin, direction] = exact.line(lane);
    let center = [f64::from(center[0]), f64::from(center[1]), f64::from(center[2])];
    let [near, far] = sphere::crossings(origin, direction, center, f64::from(radius))?;
    let begin = exact.t_min[lane];
    if near > begin { Some(near) } else { (near < begin && far > begin).then_some(far) }
}

/// A group's numbers.
#[inline(always)]
fn group_of<T>(numbers: &[T; RAYS], group: usize) -> &[T; GROUP] {
    &numbers.as_chunks().0[group]
}

#[inline(always)]
fn group_mut<T>(numbers: &mut [T; RAYS], group: usize) -> &mut [T; GROUP] {
    &mut numbers.as_chunks_mut().0[group]
}

/// The candidates' triangles and what becomes of them.
#[repr(C, align(64))]
pub struct Decisions {
    /// By vertex and axis.
    corners: [[[f32; RAYS]; 3]; 3],
    t: [f64; RAYS],
    /// Weights of the second and the third vertex.
    weights: [[f64; RAYS]; 2],
    /// 1 where nothing is out of the ordinary.
    is_plain: [u64; RAYS],
}

impl Decisions {
    pub fn new() -> Box<Decisions> {
        const NOTHING: [f64; RAYS] = [0.0; RAYS];
        Box::new(Decisions {
            corners: [[[0.0; RAYS]; 3]; 3],
            t: NOTHING,
            weights: [NOTHING; 2],
            is_plain: [0; RAYS],
        })
    }

    /// Answers a bundle's rays, but for those that have been contradicted.
    #[inline(always)]
    pub fn finish(&mut self, batch: &Batch, bundle: &mut Bundle, answers: &mut [Answer]) {
        let (first, count) = (bundle.first, bundle.count.min(RAYS));
        let mut candidates = 0u64;
        // Rays that ask for any hit have no candidates.
        let mut closest = first_lanes(count) & !bundle.any;
        while closest != 0 {
            let lane = closest.trailing_zeros() as usize & (RAYS - 1);
            closest &= closest - 1;
            let candidate = bundle.candidate[lane];
            if candidate != NONE {
                candidates |= 1 << lane;
                let (block, k) = batch.walked.tree.candidate(candidate);
                for vertex in 0..3 {
                    for axis in 0..3 {
                        self.corners[vertex][axis][lane] = block.corners[vertex][axis][k];
                    }
                }
            }
        }
        for (lane, answer) in answers[first..first + count].iter_mut().enumerate() {
            let primitive = if bundle.found >> lane & 1 == 1 { 0 } else { NONE };
            *answer = Answer { primitive, ..Answer::MISS };
        }
        let mut left = candidates | (bundle.decided & first_lanes(count) & !bundle.any);
        if left == 0 {
            return;
        }
        for group in 0..RAYS / GROUP {
            if candidates >> (group * GROUP) & ((1 << GROUP) - 1) != 0 {
                self.decide(bundle, batch.walked.starts_extent, group);
            }
        }
        while left != 0 {
            let lane = left.trailing_zeros() as usize & (RAYS - 1);
            left &= left - 1;
            let candidate = bundle.candidate[lane];
            if candidate == NONE {
                answers[first + lane] = bundle.answer(batch, lane);
                continue;
            }
            let (block, k) = batch.walked.tree.candidate(candidate);
            let [mut u, mut v] = [0.0; 2];
            let plain = if candidate & SPHERE_CANDIDATE == 0 {
                [u, v] = [self.weights[0][lane], self.weights[1][lane]];
                (self.is_plain[lane] == 1).then_some(self.t[lane])
            } else {
                plain_sphere(bundle, batch.walked.surfaces, lane, (block, k))
            };
            let is_within = |t: &f64| *t >= f64::from(bundle.low[lane]) && *t <= f64::from(bundle.high[lane]);
            if let Some(t) = plain.filter(is_within) {
                let (t, primitive) = (t * bundle.exact.scale[lane], block.ids[k]);
                answers[first + lane] = Answer { t, u, v, primitive, ..Answer::MISS };
            } else {
                let mut progress = bundle.progress(lane);
                bundle.settle(batch, lane, &mut progress);
                answers[first + lane] = bundle.answer(batch, lane);
            }
        }
    }

    /// `triangle::intersect` and `triangle::barycentrics`, operation by operation, for a group of lanes.
    #[inline(always)]
    fn decide(&mut self, bundle: &Bundle, starts_extent: f64, group: usize) {
        let (exact, g) = (&bundle.exact, group % (RAYS / GROUP));
        let [[x0, y0, z0], [x1, y1, z1], [x2, y2, z2]] = &self.corners;
        let ([x0, y0, z0], [x1, y1, z1]) = (
            [group_of(x0, g), group_of(y0, g), group_of(z0, g)],
            [group_of(x1, g), group_of(y1, g), group_of(z1, g)],
        );
        let ([x2, y2, z2], class) =
            ([group_of(x2, g), group_of(y2, g), group_of(z2, g)], group_of(&bundle.class, g));
        let ([ox, oy, oz], [dx, dy, dz]) = (&exact.origin, &exact.direction);
        let ([ox, oy, oz], [dx, dy, dz]) = (
            [group_of(ox, g), group_of(oy, g), group_of(oz, g)],
            [group_of(dx, g), group_of(dy, g), group_of(dz, g)],
        );
        let (moved, start) = (group_of(&exact.moved, g), group_of(&bundle.start, g));
        let [weights_v, weights_w] = &mut self.weights;
        let (weights_v, weights_w) = (group_mut(weights_v, g), group_mut(weights_w, g));
        let (t, is_plain) = (group_mut(&mut self.t, g), group_mut(&mut self.is_plain, g));
        for lane in 0..GROUP {
            let along_x = class[lane] >> 3 == 0;
            let along_y = class[lane] >> 3 == 1;
            let origin = [ox[lane], oy[lane], oz[lane]];
            let direction = [dx[lane], dy[lane], dz[lane]];
            let [x, y, z] = direction;
            let main = of_axis(along_x, along_y, [x, y, z]);
            let shear_x = of_axis(along_x, along_y, [y, z, x]) / main;
            let shear_y = of_axis(along_x, along_y, [z, x, y]) / main;
            let vertices = [
                [f64::from(x0[lane]), f64::from(y0[lane]), f64::from(z0[lane])],
                [f64::from(x1[lane]), f64::from(y1[lane]), f64::from(z1[lane])],
                [f64::from(x2[lane]), f64::from(y2[lane]), f64::from(z2[lane])],
            ];
            let mut sheared = [[0.0; 2]; 3];
            for vertex in 0..3 {
                let [x, y, z] = [
                    vertices[vertex][0] - origin[0],
                    vertices[vertex][1] - origin[1],
                    vertices[vertex][2] - origin[2],
                ];
                let first = of_axis(along_x, along_y, [y, z, x]);
                let second = of_axis(along_x, along_y, [z, x, y]);
                let main = of_axis(along_x, along_y, [x, y, z]);
                sheared[vertex] = [first - shear_x * main, second - shear_y * main];
            }
            let [[ax, ay], [bx, by], [cx, cy]] = sheared;
            let u = cx * by - cy * bx;
            let v = ax * cy - ay * cx;
            let w = bx * ay - by * ax;
            let mut e1 = [0.0; 3];
            let mut e2 = [0.0; 3];
            let mut to = [0.0; 3];
            for axis in 0..3 {
                e1[axis] = vertices[1][axis] - vertices[0][axis];
                e2[axis] = vertices[2][axis] - vertices[0][axis];
                to[axis] = vertices[0][axis] - origin[axis];
            }
            let n =
                [e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0]];
            let along = (n[0] * direction[0] + n[1] * direction[1]) + n[2] * direction[2];
            let height = (n[0] * to[0] + n[1] * to[1]) + n[2] * to[2];
            let sum = (u + v) + w;
            t[lane] = height / along;
            weights_v[lane] = v / sum;
            weights_w[lane] = w / sum;
            // Doubt as of `Start`, for whatever triangle of this part the ray starts on: all coordinates are within the reach.
            let size =
                ((e1[0].abs() + e1[1].abs()) + e1[2].abs()) * ((e2[0].abs() + e2[1].abs()) + e2[2].abs());
            let away = larger(larger(origin[0].abs(), origin[1].abs()), origin[2].abs());
            let radius = 2.0 * RADIUS * (away + starts_extent);
            let doubt_u = 2.0 * radius * ((cx - bx).abs() + (cy - by).abs());
            let doubt_v = 2.0 * radius * ((ax - cx).abs() + (ay - cy).abs());
            let doubt_w = 2.0 * radius * ((bx - ax).abs() + (by - ay).abs());
            let positive = (u > doubt_u) & (v > doubt_v) & (w > doubt_w);
            let negative = (u < -doubt_u) & (v < -doubt_v) & (w < -doubt_w);
            let upright = along.abs() > GRAZING * size;
            let clear = height.abs() > radius * size;
            let is_ours = !is_guest(start[lane]);
            let finite = (sum.abs() < f64::INFINITY) & (moved[lane] == 0.0) & is_ours;
            is_plain[lane] = u64::from((positive | negative) & upright & clear & finite);
        }
    }
}
