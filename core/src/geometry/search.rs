//! What a ray hits first, and whether it hits anything: triangles, analytic shapes and instances together.

use super::{Geometry, Hit};
use crate::bvh::simd::Lanes;
use crate::bvh::{Ray, TriangleHit};

/// Rays handed over to the hierarchy at a time.
const TURNS: usize = 256;

impl Geometry {
    /// The nearest hit; of equally near ones the first primitive.
    #[inline(always)]
    pub fn closest<L: Lanes>(&self, lanes: L, ray: &Ray) -> Option<Hit> {
        self.closest_with(lanes, ray, self.bvh.closest(lanes, ray))
    }

    /// The nearest hit, that of the triangles given.
    #[inline(always)]
    fn closest_with<L: Lanes>(&self, lanes: L, ray: &Ray, triangle: Option<TriangleHit>) -> Option<Hit> {
        let hit = self.closest_of_own(lanes, ray, triangle);
        let Some(instances) = &self.instances else { return hit };
        let t_max = hit.map_or(ray.t_max, |hit| hit.t());
        let instanced = instances.closest(lanes, &Ray { t_max, ..*ray });
        instanced.filter(|other| hit.is_none_or(|hit| other.t() < hit.t())).or(hit)
    }

    /// [`Geometry::closest`] of many rays. `hits` is as long as `rays`.
    #[inline(always)]
    pub fn closest_many<L: Lanes>(&self, lanes: L, rays: &[Ray], hits: &mut [Option<Hit>]) {
        if !self.in_turns {
            for (ray, hit) in rays.iter().zip(hits) {
                *hit = self.closest(lanes, ray);
            }
            return;
        }
        let mut triangles = [None; TURNS];
        for (rays, hits) in rays.chunks(TURNS).zip(hits.chunks_mut(TURNS)) {
            let triangles = &mut triangles[..rays.len()];
            self.bvh.closest_many(lanes, rays, triangles);
            for ((ray, hit), triangle) in rays.iter().zip(hits).zip(triangles) {
                *hit = self.closest_with(lanes, ray, *triangle);
            }
        }
    }

    /// [`Geometry::occluded`] of many rays. `occluded` is as long as `rays`.
    #[inline(always)]
    pub fn occluded_many<L: Lanes>(&self, lanes: L, rays: &[Ray], occluded: &mut [bool]) {
        if !self.in_turns {
            for (ray, occluded) in rays.iter().zip(occluded) {
                *occluded = self.occluded(lanes, ray);
            }
            return;
        }
        self.bvh.occluded_many(lanes, rays, occluded);
        for (ray, occluded) in rays.iter().zip(occluded) {
            *occluded = *occluded || self.occluded_by_others(lanes, ray);
        }
    }

    /// The nearest hit that is in no instance, that of the triangles given.
    #[inline(always)]
    pub(super) fn closest_of_own<L: Lanes>(&self, lanes: L, ray: &Ray, triangle: Option<TriangleHit>) -> Option<Hit> {
        if self.analytic.is_empty() {
            return triangle.map(Hit::Triangle);
        }
        let t_max = triangle.map_or(ray.t_max, |hit| hit.t);
        let analytic = self.analytic_bvh.closest(lanes, &self.analytic, &Ray { t_max, ..*ray });
        match (triangle, analytic) {
            (Some(hit), Some((t, _))) if hit.t <= t => Some(Hit::Triangle(hit)),
            (_, Some((t, index))) => Some(Hit::Analytic { t, index }),
            (triangle, None) => triangle.map(Hit::Triangle),
        }
    }

    /// Whether anything lies on the ray.
    #[inline(always)]
    pub fn occluded<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        self.bvh.occluded(lanes, ray) || self.occluded_by_others(lanes, ray)
    }

    /// Whether anything but the geometry's own triangles lies on the ray.
    #[inline(always)]
    fn occluded_by_others<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        (!self.analytic.is_empty() && self.analytic_bvh.occluded(lanes, &self.analytic, ray))
            || self.instances.as_ref().is_some_and(|instances| instances.occluded(lanes, ray))
    }

    /// Whether anything that is in no instance lies on the ray.
    #[inline(always)]
    pub(super) fn occluded_by_own<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        self.bvh.occluded(lanes, ray)
            || (!self.analytic.is_empty() && self.analytic_bvh.occluded(lanes, &self.analytic, ray))
    }
}
