//! Which blocks of voxels are worth a copy on every rank: those that rays come to most, for what they hold. Knows no rank.

use std::cmp::Reverse;

use super::partition::Survey;
use crate::geometry::{Prepared, Ray};

/// The part of rays that is taken to go on through an occupied voxel; it holds some four primitives.
const THROUGH: f64 = 0.5;
/// The part of a ray that is no longer followed.
const FAINT: f64 = 1.0 / 256.0;

impl Survey {
    /// Of each block how many of these rays will come to its voxels, about: what lies in a voxel is taken to stop some of them.
    pub fn heat(&self, rays: &[Ray]) -> Vec<f64> {
        let mut heat = vec![0.0; self.occupied.len()];
        for ray in rays.iter().filter(|ray| self.lattice.serves(ray.origin.to_array())) {
            let prepared = Prepared::new(ray);
            let mut left = 1.0;
            self.lattice.walk(
                &prepared,
                |block| self.occupied[block],
                |_, block| {
                    heat[block] += left;
                    left *= THROUGH;
                    (left > FAINT).then_some(prepared.t_max)
                },
            );
        }
        heat
    }

    /// The blocks of most heat for each of their primitives that together have no more than `most` of these, ascending. One that is too large leaves its room to the next.
    pub fn hottest(&self, heat: &[f64], most: u64) -> Vec<usize> {
        let mut blocks: Vec<usize> = (0..self.occupied.len()).filter(|&block| heat[block] > 0.0).collect();
        // Positive numbers are ordered as their bits are; of equals the first block is first.
        blocks.sort_by_key(|&block| Reverse((heat[block] / f64::from(self.entries[block])).to_bits()));
        let mut left = most;
        blocks.retain(|&block| match left.checked_sub(self.entries[block].into()) {
            Some(rest) => {
                left = rest;
                true
            }
            None => false,
        });
        blocks.sort_unstable();
        blocks
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::NONE;
    use crate::scene::Surfaces;
    use crate::scene::mesh::Sphere;

    /// Balls in a row, the one at x holding the next so many ever smaller ones.
    fn row(counts: &[u32]) -> Surfaces {
        let ball =
            |x: usize, n: u32| Sphere { center: [10.0 * x as f32, 0.0, 0.0], radius: 1e-3 / (n + 1) as f32 };
        let balls = counts.iter().enumerate().flat_map(|(x, &count)| (0..count).map(move |n| ball(x, n)));
        Surfaces { spheres: balls.collect::<Vec<_>>().into(), ..Surfaces::default() }
    }

    fn upwards(x: f64) -> Ray {
        let origin = DVec3::new(x, -5.0, 0.0);
        Ray { origin, direction: DVec3::Y, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE }
    }

    #[test]
    fn hot_blocks_are_those_that_rays_come_to_and_fit() {
        let counts = [5, 50, 7, 7, 5];
        let survey = Survey::new(&row(&counts), 1);
        // None comes to the ball at 30.
        let rays: Vec<Ray> = [vec![0.0; 4], vec![10.0; 60], vec![20.0; 9], vec![40.0; 2]]
            .concat()
            .into_iter()
            .map(upwards)
            .collect();
        let heat = survey.heat(&rays);
        let block_at = |x: f64| {
            let heat = survey.heat(&[upwards(x)]);
            heat.iter().position(|&heat| heat > 0.0).expect("a ball is met")
        };
        let [first, large, third, cold, last] = [0.0, 10.0, 20.0, 30.0, 40.0].map(block_at);
        assert_eq!(heat[cold], 0.0);
        assert!(heat[large] > heat[third] && heat[third] > heat[first] && heat[first] > heat[last]);
        let entries =
            |blocks: &[usize]| -> u64 { blocks.iter().map(|&b| u64::from(survey.entries[b])).sum() };
        let hottest = |most: u64| survey.hottest(&heat, most);
        assert!(hottest(0).is_empty() && hottest(4).is_empty());
        for most in 0..80 {
            let chosen = hottest(most);
            assert!(entries(&chosen) <= most && chosen.is_sorted() && !chosen.contains(&cold), "{most}");
            assert_eq!(chosen, hottest(most), "{most}");
        }
        // By heat for each primitive: 9 / 7 of the third, 60 / 50 of the large one, 4 / 5 of the first, 2 / 5 of the last.
        assert!(hottest(7).contains(&third));
        let fits = hottest(20);
        assert!(fits.contains(&third) && fits.contains(&first) && !fits.contains(&large), "{fits:?}");
        assert!([first, large, third, last].iter().all(|block| hottest(1000).contains(block)));
    }
}
