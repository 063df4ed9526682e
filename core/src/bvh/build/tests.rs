use super::super::node::Leaf;
use super::super::simd::{Lanes, Portable};
use super::super::tests::{noise3, ray};
use super::super::{Aabb, Bvh8, Leaves, Slabs};
use super::collapse::collapsed;
use super::cut::cut;
use super::parts::{Sizes, binary_tree};
use super::{Built, LeafCost};
use glam::Vec3;

fn sorted(order: &[u32]) -> Vec<u32> {
    let mut order = order.to_vec();
    order.sort_unstable();
    order
}

#[test]
fn chains_of_boxes_stay_within_the_stack() {
    // Each box ten times the last, all from the same corner: the best binary tree is a chain.
    let boxes: Vec<Aabb> =
        (0..3000).map(|i| Aabb { min: Vec3::ZERO, max: Vec3::splat(libm::exp2f(i as f32 / 24.0 - 65.0)) }).collect();
    let leaf = LeafCost { max_count: 1, block: 1, block_cost: 1.0 };
    let built = Built::new(&boxes, leaf);
    assert!(built.bvh.stack_need() <= Bvh8::STACK);
    assert!(sorted(&built.order).into_iter().eq(0..3000));
    let same = vec![boxes[0]; 1000];
    assert!(Built::new(&same, leaf).bvh.stack_need() <= Bvh8::STACK);
    let huge = boxes.iter().map(|b| Aabb { max: b.max * 1e18, ..*b });
    let built = Built::new(&huge.collect::<Vec<_>>(), leaf);
    assert!(built.bvh.stack_need() <= Bvh8::STACK);
}

/// Leaves that hold the boxes themselves: counts those shown.
struct Shown<'a> {
    order: &'a [u32],
    seen: Vec<u32>,
}

impl<L: Lanes> Leaves<L> for Shown<'_> {
    fn address(&self, leaf: Leaf) -> *const u8 {
        self.order.as_ptr().wrapping_add(leaf.first as usize).cast()
    }
    fn nearest(&mut self, _: L, _: &Slabs, leaf: Leaf, t_max: f32) -> f32 {
        self.seen.extend(&self.order[leaf.first as usize..][..leaf.count as usize]);
        t_max
    }
    fn any(&mut self, lanes: L, slabs: &Slabs, leaf: Leaf, t_max: f32) -> bool {
        self.nearest(lanes, slabs, leaf, t_max);
        false
    }
}

/// Whether the tree is built whole or in parts, and emitted whole or in branches, the smallest of which are leaves' parents. Fails where
/// trees of a part, or nodes or items of a branch, are not moved to their place.
#[test]
fn leaves_may_hold_anything() {
    let boxes: Vec<Aabb> = (0..200)
        .map(|i| {
            let p = noise3(9, i) * 10.0;
            Aabb { min: p, max: p + Vec3::splat(1.0) }
        })
        .collect();
    let leaf = LeafCost { max_count: 3, block: 1, block_cost: 1.0 };
    for (part, trees) in [(200, 1), (150, 1), (150, 8), (30, 5), (8, 100)] {
        for grain in [0, 4, 50, 200] {
            let tree = binary_tree(&boxes, Sizes { boxes: part, trees });
            shows_what_is_passed(&collapsed(tree, leaf, grain), &boxes);
        }
    }
}

/// Rays are shown every box that they pass.
fn shows_what_is_passed(built: &Built, boxes: &[Aabb]) {
    assert_eq!(sorted(&built.order), (0..boxes.len() as u32).collect::<Vec<_>>());
    let lanes = Portable;
    for i in 0..200 {
        let ray = ray(noise3(10, i) * 12.0, noise3(11, i));
        let (mut one, mut two) =
            (Shown { order: &built.order, seen: Vec::new() }, Shown { order: &built.order, seen: Vec::new() });
        built.bvh.nearest(lanes, &ray, &mut one);
        assert!(!built.bvh.any(lanes, &ray, &mut two));
        for (i, bounds) in boxes.iter().enumerate() {
            // Straight from the definition, in f64, for boxes that are clearly passed.
            let [mut near, mut far] = [0.0_f64, f64::INFINITY];
            for axis in 0..3 {
                let side = |side: f32| f64::from(side - ray.origin[axis]) / f64::from(ray.direction[axis]);
                let (a, b) = (side(bounds.min[axis]), side(bounds.max[axis]));
                (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
            }
            assert!(near > far || (one.seen.contains(&(i as u32)) && two.seen.contains(&(i as u32))));
        }
    }
}

/// Parts hold everything once, none too much and none next to nothing, whether boxes lie apart, all in one place, or all but
/// a few. Fails where a plane may leave a few on one side.
#[test]
fn parts_are_neither_large_nor_tiny() {
    let apart = |i: usize| noise3(12, i) * 10.0;
    let on_a_line = |i: usize| Vec3::X * libm::exp2f(i as f32 / 50.0);
    let all_in_one = |_: usize| Vec3::ONE;
    let few_far_off = |i: usize| if i < 10 { Vec3::splat(1000.0) } else { noise3(12, i) };
    for place in [&apart as &dyn Fn(usize) -> Vec3, &on_a_line, &all_in_one, &few_far_off] {
        let boxes: Vec<Aabb> = (0..5000).map(|i| Aabb { min: place(i), max: place(i) + Vec3::splat(0.1) }).collect();
        let mut order: Vec<u32> = (0..5000).collect();
        let parts = cut(&boxes, &mut order, 300);
        assert!(
            parts.iter().all(|part| (300 / 8..=300).contains(&part.len())),
            "{:?}",
            parts.iter().map(|part| part.len()).collect::<Vec<_>>()
        );
        assert!(sorted(&order).into_iter().eq(0..5000));
    }
}
