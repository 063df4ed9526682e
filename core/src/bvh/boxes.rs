//! A few boxes, and whether a ray meets one of them.

use super::node::{Child, Node, WIDTH};
use super::simd::{Floats, Lanes};
use super::{Aabb, Ray, Slabs};

/// Up to eight boxes, tested at once.
#[derive(Clone, Debug)]
pub struct Boxes(Node);

impl Boxes {
    /// Around these; if there are more than eight, neighbours in the list share one.
    pub fn new(boxes: Vec<Aabb>) -> Self {
        let mut node = Node::EMPTY;
        for (slot, run) in boxes.chunks(boxes.len().div_ceil(WIDTH).max(1)).enumerate() {
            node.set(slot, run.iter().fold(Aabb::EMPTY, |all, &b| all.union(b)), Child::ROOT);
        }
        Self(node)
    }

    /// Whether the ray meets a box. It does if it meets something whose own box lies within, by the arithmetic of the hierarchy.
    #[inline(always)]
    pub fn meets<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        let (near, far) = Slabs::new(ray).node(lanes, &self.0, ray.t_max);
        near.le(far) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bvh::simd::{Isa, Kernel};
    use crate::bvh::{TriangleBvh, triangle_bounds};
    use glam::Vec3;

    struct Trace<'a>(&'a TriangleBvh, &'a Boxes, Ray);

    impl Kernel for Trace<'_> {
        type Output = (bool, bool);

        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) -> (bool, bool) {
            (self.0.occluded(lanes, &self.2), self.1.meets(lanes, &self.2))
        }
    }

    /// A ray that meets a triangle meets a box, also where triangles are flat along an axis and rays graze their edges; and most
    /// rays meet none. Fails for boxes that are not padded.
    #[test]
    fn no_hit_is_missed() {
        let fraction = |i: u32, step: f64| (f64::from(i) * step).fract() as f32;
        let corner = |i: u32| Vec3::new(fraction(i, 0.8191725), (i % 3) as f32, fraction(i, 0.5497005)) * 10.0;
        let triangles: Vec<[Vec3; 3]> =
            (0..20).map(|i| [corner(i), corner(i) + Vec3::X, corner(i) + Vec3::Z]).collect();
        let mesh = TriangleBvh::build(20, |i| triangles[i as usize]);
        let boxes = Boxes::new(triangles.iter().map(|&t| triangle_bounds(t)).collect());
        let (mut hits, mut passed) = (0, 0);
        for i in 0..20_000u32 {
            let [a, b, c] = triangles[i as usize % 20];
            let (u, v) = (fraction(i, 0.7548777) * 1.1, fraction(i, 0.5698403) * 1.1);
            let target = [a + (b - a) * u, a + (c - a) * v, a + (b - a) * u + (c - a) * v][i as usize % 3];
            let origin = Vec3::new(fraction(i, 0.6180340), fraction(i, 0.4142136), fraction(i, 0.7320508)) * 30.0;
            let ray = Ray { origin, direction: target - origin, t_max: f32::INFINITY };
            for isa in Isa::available() {
                let (hit, meets) = isa.dispatch(Trace(&mesh, &boxes, ray));
                assert!(meets || !hit, "{ray:?} on {}", isa.name());
                hits += u32::from(hit);
                passed += u32::from(!meets);
            }
        }
        assert!(hits > 5000 && passed > 100, "{hits} hits, {passed} rays pass: the test tells little");
    }
}
