//! A tree of bounding spheres over triangles, so that the referee need not look at what is far from a ray. Its margins are
//! wide: it may offer too much, never too little.

use glam::DVec3;

const LEAF: usize = 4;

#[derive(Debug)]
struct Node {
    center: DVec3,
    radius: f64,
    /// Of a leaf the range in `order`; of an inner node the index of its second child, the first following it.
    first: u32,
    count: u32,
}

#[derive(Debug, Default)]
pub struct SphereTree {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

impl SphereTree {
    pub fn build(triangles: &[[[f32; 3]; 3]]) -> Self {
        let mut tree = SphereTree { nodes: Vec::new(), order: (0..triangles.len() as u32).collect() };
        let middles: Vec<DVec3> =
            triangles.iter().map(|t| (point(t[0]) + point(t[1]) + point(t[2])) / 3.0).collect();
        if !triangles.is_empty() {
            tree.split(triangles, &middles, 0, triangles.len());
        }
        tree
    }

    fn split(&mut self, triangles: &[[[f32; 3]; 3]], middles: &[DVec3], first: usize, end: usize) {
        let ids = &self.order[first..end];
        let corners = || ids.iter().flat_map(|&id| triangles[id as usize]).map(point);
        let low = corners().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
        let center = (low + high) / 2.0;
        let radius = corners().map(|corner| corner.distance(center)).fold(0.0, f64::max) * (1.0 + 1e-9);
        let node = self.nodes.len();
        self.nodes.push(Node { center, radius, first: first as u32, count: (end - first) as u32 });
        if end - first <= LEAF {
            return;
        }
        let size = (high - low).to_array();
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
        let half = (end - first) / 2;
        self.order[first..end].select_nth_unstable_by(half, |&a, &b| {
            middles[a as usize][axis].total_cmp(&middles[b as usize][axis]).then(a.cmp(&b))
        });
        self.split(triangles, middles, first, first + half);
        self.nodes[node].first = self.nodes.len() as u32;
        self.nodes[node].count = 0;
        self.split(triangles, middles, first + half, end);
    }

    /// Offers every triangle that comes within `margin` of the half line from `origin` along the unit vector `forward`.
    pub fn near_line(&self, origin: DVec3, forward: DVec3, margin: f64, mut offer: impl FnMut(u32)) {
        let mut waiting = vec![0u32];
        while let Some(index) = waiting.pop() {
            let Some(node) = self.nodes.get(index as usize) else { continue };
            let from = node.center - origin;
            let reach = node.radius + margin + 1e-12 * from.abs().max_element();
            let along = from.dot(forward);
            if along < -reach || (from - forward * along).length() > reach {
                continue;
            }
            if node.count == 0 {
                waiting.extend([node.first, index + 1]);
            } else {
                let range = node.first as usize..(node.first + node.count) as usize;
                self.order[range].iter().copied().for_each(&mut offer);
            }
        }
    }
}

fn point(p: [f32; 3]) -> DVec3 {
    DVec3::from(p.map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::icosphere::icosphere;

    #[test]
    fn nothing_near_is_left_out() {
        let mesh = icosphere(3, DVec3::new(0.1, 0.2, 0.3), 1.0);
        let triangles: Vec<_> =
            mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize])).collect();
        let tree = SphereTree::build(&triangles);
        for (index, triangle) in triangles.iter().enumerate() {
            let target = (point(triangle[0]) + point(triangle[1]) + point(triangle[2])) / 3.0;
            let origin = DVec3::new(3.0, -5.0, 1e6);
            let mut offered = Vec::new();
            tree.near_line(origin, (target - origin).normalize(), 0.0, |id| offered.push(id));
            assert!(offered.contains(&(index as u32)), "{index}");
            assert!(offered.len() < 200, "{} of {}", offered.len(), triangles.len());
        }
    }
}
