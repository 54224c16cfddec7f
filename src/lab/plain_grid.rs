//! The textbook's walk through a uniform grid (Amanatides and Woo 1987, "A Fast Voxel Traversal Algorithm for Ray Tracing"), over the same cells and lists as
//! `accel::grid`: cell after cell, t added up, every primitive of a list tested in f64. What the renderer's walk is measured against; hits at the borders of cells may get lost.

use crate::accel::grid::Grid;
use crate::geometry::{NONE, Prepared, Ray, sphere, triangle};
use crate::scene::Surfaces;

/// Whether the ray meets anything, or with `any` unset, whether there is a first hit: all that a count of hits needs.
pub fn is_hit(grid: &Grid, surfaces: &Surfaces, ray: &Ray, any: bool) -> bool {
    let lattice = &grid.lattice;
    if lattice.counts.contains(&0) {
        return false;
    }
    let ray = Prepared::new(ray);
    let (mut enter, mut exit) = (ray.t_min, ray.t_max);
    for axis in 0..3 {
        let high = lattice.low[axis] + f64::from(lattice.counts[axis]) * lattice.size[axis];
        let [first, last] = [lattice.low[axis], high].map(|c| (c - ray.origin[axis]) / ray.direction[axis]);
        enter = enter.max(first.min(last));
        exit = exit.min(first.max(last));
    }
    if enter > exit {
        return false;
    }
    let (mut cell, mut step, mut end) = ([0i64; 3], [0i64; 3], [0i64; 3]);
    let (mut next, mut apart) = ([f64::INFINITY; 3], [0.0; 3]);
    for axis in 0..3 {
        let (low, size, direction) = (lattice.low[axis], lattice.size[axis], ray.direction[axis]);
        let count = i64::from(lattice.counts[axis]);
        let at = (ray.origin[axis] + enter * direction - low) / size;
        cell[axis] = (at.floor() as i64).clamp(0, count - 1);
        (step[axis], end[axis]) = if direction > 0.0 { (1, count) } else { (-1, -1) };
        if direction != 0.0 {
            let plane = cell[axis] + i64::from(direction > 0.0);
            next[axis] = (low + plane as f64 * size - ray.origin[axis]) / direction;
            apart[axis] = size / direction.abs();
        }
    }
    let (mut t_best, mut best) = (ray.t_max, NONE);
    loop {
        let number = lattice.number(cell.map(|c| c as u32));
        for &id in &grid.primitives[grid.starts[number] as usize..grid.starts[number + 1] as usize] {
            let t = match surfaces.sphere_at(id) {
                Some(s) => sphere::first(&ray, s.center.map(f64::from), f64::from(s.radius), id),
                None => {
                    let corners = surfaces.triangle(id).map(|v| v.map(f64::from));
                    triangle::intersect(&ray, &corners).map(|hit| hit.t)
                }
            };
            if let Some(t) = t.filter(|&t| t >= ray.t_min && t <= t_best) {
                (t_best, best) = (t, id);
                if any {
                    return true;
                }
            }
        }
        let axis = (0..3).fold(0, |least, axis| if next[axis] < next[least] { axis } else { least });
        if best != NONE && t_best <= next[axis] {
            return true;
        }
        cell[axis] += step[axis];
        if cell[axis] == end[axis] {
            return best != NONE;
        }
        next[axis] += apart[axis];
    }
}
