//! Axis-aligned boxes.

use glam::Vec3;

/// A box, empty where `min` is above `max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Its lowest corner.
    pub min: Vec3,
    /// Its highest corner.
    pub max: Vec3,
}

impl Aabb {
    /// The box of no points.
    pub const EMPTY: Aabb = Aabb { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box that holds these points.
    #[inline]
    pub fn around(points: impl IntoIterator<Item = Vec3>) -> Aabb {
        points.into_iter().fold(Aabb::EMPTY, Aabb::with)
    }

    /// Its longest side.
    #[inline]
    pub fn extent(self) -> f32 {
        (self.max - self.min).max_element()
    }

    /// The smallest box that holds both.
    pub fn union(self, other: Aabb) -> Aabb {
        Aabb { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The smallest box that holds this one and `point`.
    pub fn with(self, point: Vec3) -> Aabb {
        self.union(Aabb { min: point, max: point })
    }

    /// Its middle.
    pub fn centre(self) -> Vec3 {
        // Half of each, so that the sum cannot overflow.
        self.min * 0.5 + self.max * 0.5
    }

    /// Half of its surface; 0 where it is empty.
    pub fn half_area(self) -> f32 {
        let d = (self.max - self.min).max(Vec3::ZERO);
        (d.x + d.y) * d.z + d.x * d.y
    }
}
