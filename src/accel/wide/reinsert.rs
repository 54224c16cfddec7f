//! Moves subtrees of a binary tree to where they cost less (Meister and Bittner 2018, "Parallel Reinsertion for Bounding Volume Hierarchy Optimization"), as obvhs does it.
//!
//! A tree from the top down divides large and small primitives alike by their middles; what then overlaps, as walls do with all that is before them, finds its place here.

use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;

/// Tries such a share of the nodes, of those near the root.
pub fn reinsert(binary: &mut Bvh2, share: f32) {
    // Candidates are taken from the front of the list.
    let levels;
    (binary.nodes, levels) = in_levels(&binary.nodes);
    // Its stacks hold this many pairs of nodes: paths may grow.
    binary.max_depth = binary.max_depth.max(2 * levels);
    ReinsertionOptimizer::default().run(binary, share, None);
}

/// The same tree with all nodes of a level before those of the next, and the number of levels.
fn in_levels(nodes: &[Bvh2Node]) -> (Vec<Bvh2Node>, usize) {
    let mut sorted = Vec::with_capacity(nodes.len());
    sorted.push(nodes[0]);
    let (mut level, mut levels) = (0..1, 0);
    while !level.is_empty() {
        let end = level.end;
        for at in level {
            let node: Bvh2Node = sorted[at];
            if !node.is_leaf() {
                let children = node.first_index as usize;
                sorted[at].first_index = sorted.len() as u32;
                sorted.extend_from_slice(&nodes[children..children + 2]);
            }
        }
        (level, levels) = (end..sorted.len(), levels + 1);
    }
    (sorted, levels)
}
