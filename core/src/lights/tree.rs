//! A hierarchy of lights, descended at random by what each half may do to the point in hand (Conty Estevez & Kulla 2018,
//! "Importance Sampling of Many Lights with Adaptive Tree Splitting", with the bounds of Pharr, Jakob & Humphreys 2023, §12.6.3).
//! It knows of boxes, cones and brightness; what shines, it does not know.

use super::list::Reach;
use crate::bvh::Aabb;
use glam::Vec3;
use std::f32::consts::PI;

/// Candidate planes an axis when a node is split.
const BINS: usize = 12;
/// Below this depth nodes are halved, whatever it costs: so that no input makes the tree deep.
const DEPTH_MAX: u32 = 40;

/// A binary tree over lights.
pub struct LightTree {
    nodes: Vec<Node>,
    /// The node of each light.
    leaves: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    lobe: Lobe,
    /// The second child (the first follows its parent), or the light.
    next: u32,
    parent: u32,
    is_leaf: bool,
}

/// A [`Reach`] as the descent wants it: the ball around its box, and the sine beside the cosine.
#[derive(Clone, Copy, Debug)]
struct Lobe {
    centre: Vec3,
    radius2: f32,
    axis: Vec3,
    cos_normals: f32,
    sin_normals: f32,
    cos_emission: f32,
    intensity: f32,
}

impl LightTree {
    /// Builds a tree over at least one light.
    pub fn new(lights: &[Reach]) -> Self {
        let mut tree = Self { nodes: Vec::with_capacity(2 * lights.len()), leaves: vec![0; lights.len()] };
        let mut order: Vec<u32> = (0..lights.len() as u32).collect();
        tree.build(lights, &mut order, 0, 0);
        tree
    }

    /// Appends the subtree over the lights `order`.
    fn build(&mut self, lights: &[Reach], order: &mut [u32], parent: u32, depth: u32) {
        let index = self.nodes.len() as u32;
        if let [light] = *order {
            self.leaves[light as usize] = index;
            self.nodes.push(Node { lobe: Lobe::new(&lights[light as usize]), next: light, parent, is_leaf: true });
            return;
        }
        let middle = if depth < DEPTH_MAX { split(lights, order) } else { None };
        let middle = middle.unwrap_or(order.len() / 2);
        let reach = union_of(order.iter().map(|&i| lights[i as usize]));
        self.nodes.push(Node { lobe: Lobe::new(&reach), next: 0, parent, is_leaf: false });
        let (first, second) = order.split_at_mut(middle);
        self.build(lights, first, index, depth + 1);
        self.nodes[index as usize].next = self.nodes.len() as u32;
        self.build(lights, second, index, depth + 1);
    }

    /// A light for the random number `u` at a point with a normal, and its probability; none where none can shine. What is left
    /// of `u` is a fresh number.
    #[inline(always)]
    pub fn sample(&self, u: &mut f32, position: Vec3, normal: Vec3) -> Option<(u32, f32)> {
        let mut index = 0;
        let mut probability = 1.0;
        loop {
            let node = &self.nodes[index as usize];
            if node.is_leaf {
                return Some((node.next, probability));
            }
            let share = self.share_of_first(index, position, normal)?;
            if *u < share {
                *u /= share;
                probability *= share;
                index += 1;
            } else {
                *u = ((*u - share) / (1.0 - share)).min(1.0 - 0.5 * f32::EPSILON);
                probability *= 1.0 - share;
                index = node.next;
            }
        }
    }

    /// The probability of [`LightTree::sample`] to give `light`.
    #[inline(always)]
    pub fn probability(&self, light: u32, position: Vec3, normal: Vec3) -> f32 {
        let mut index = self.leaves[light as usize];
        let mut probability = 1.0;
        while index != 0 && probability > 0.0 {
            let parent = self.nodes[index as usize].parent;
            let Some(share) = self.share_of_first(parent, position, normal) else { return 0.0 };
            probability *= if index == parent + 1 { share } else { 1.0 - share };
            index = parent;
        }
        probability
    }

    /// The probability of an inner node's first child; none where neither can shine.
    #[inline(always)]
    fn share_of_first(&self, index: u32, position: Vec3, normal: Vec3) -> Option<f32> {
        let first = self.nodes[index as usize + 1].lobe.importance(position, normal);
        let second = self.nodes[self.nodes[index as usize].next as usize].lobe.importance(position, normal);
        let sum = first + second;
        (sum > 0.0).then(|| first / sum)
    }
}

impl Lobe {
    fn new(reach: &Reach) -> Self {
        let Reach { bounds, axis, cos_normals, cos_emission, intensity } = *reach;
        let size2 = (bounds.max - bounds.min).length_squared();
        Self {
            centre: bounds.centre(),
            // A point gets a ball too, so that the point itself has an importance.
            radius2: (0.25 * size2).max(f32::MIN_POSITIVE),
            axis,
            cos_normals,
            sin_normals: sine(cos_normals),
            cos_emission,
            intensity,
        }
    }

    /// About the irradiance that it may cause at a point, up to a factor; zero only where it causes none. Lights behind the
    /// surface count like those before it, since the surface may transmit.
    #[inline(always)]
    fn importance(&self, position: Vec3, normal: Vec3) -> f32 {
        let towards = position - self.centre;
        let distance2 = towards.length_squared();
        if distance2 <= self.radius2 {
            // Within the ball anything may be near, and anywhere.
            return self.intensity / self.radius2;
        }
        let inverse2 = 1.0 / distance2;
        let w = towards * inverse2.sqrt();
        // The angle that the ball fills.
        let sin2_ball = (self.radius2 * inverse2).min(1.0);
        let ball = ((1.0 - sin2_ball).sqrt(), sin2_ball.sqrt());
        // The least angle between a normal and a direction to the point.
        let cos_axis = self.axis.dot(w);
        let to_cone = less((cos_axis, sine(cos_axis)), (self.cos_normals, self.sin_normals));
        let (cos, _) = less(to_cone, ball);
        let cos_surface = normal.dot(w).abs();
        let (cos_surface, _) = less((cos_surface, sine(cos_surface)), ball);
        let shines = cos >= self.cos_emission && cos > 0.0;
        if shines { self.intensity * cos * cos_surface * inverse2 } else { 0.0 }
    }
}

impl Reach {
    /// The smallest bounds that hold both, about.
    fn union(&self, other: &Self) -> Self {
        let (axis, cos_normals) = union_of_cones((self.axis, self.cos_normals), (other.axis, other.cos_normals));
        Self {
            bounds: self.bounds.union(other.bounds),
            axis,
            cos_normals,
            cos_emission: self.cos_emission.min(other.cos_emission),
            intensity: self.intensity + other.intensity,
        }
    }

    /// Its part in the cost of a split (Conty Estevez & Kulla 2018, eq. 1 and 2): brightness times area times the solid angle
    /// that is shone into.
    fn cost(&self) -> f32 {
        let normals = libm::acosf(self.cos_normals.clamp(-1.0, 1.0));
        let reach = (normals + libm::acosf(self.cos_emission)).min(PI);
        let (sin, cos) = (libm::sinf(normals), self.cos_normals);
        let angles = 2.0 * PI * (1.0 - cos)
            + 0.5 * PI * (2.0 * reach * sin - libm::cosf(normals - 2.0 * reach) - 2.0 * normals * sin + cos);
        let size = (self.bounds.max - self.bounds.min).length_squared();
        // Points have no area, yet far points shall not be joined: the diagonal stands in for it.
        self.intensity * angles * (self.bounds.half_area() + 1e-3 * size)
    }
}

/// √(1 − x²).
#[inline(always)]
fn sine(cosine: f32) -> f32 {
    (1.0 - cosine * cosine).max(0.0).sqrt()
}

/// Cosine and sine of max(0, a − b), of the cosines and sines of two angles in [0, π]. Selected, not branched: which angle is
/// larger is as good as random.
#[inline(always)]
fn less(a: (f32, f32), b: (f32, f32)) -> (f32, f32) {
    let (cos, sin) = (a.0 * b.0 + a.1 * b.1, a.1 * b.0 - a.0 * b.1);
    let none = a.0 >= b.0;
    (if none { 1.0 } else { cos }, if none { 0.0 } else { sin })
}

fn union_of(reaches: impl Iterator<Item = Reach>) -> Reach {
    #[allow(clippy::expect_used)] // a node has lights
    reaches.reduce(|a, b| a.union(&b)).expect("no empty node")
}

/// The smallest cone that holds two; all directions if none smaller does.
fn union_of_cones(a: (Vec3, f32), b: (Vec3, f32)) -> (Vec3, f32) {
    let (wide, narrow) = if a.1 <= b.1 { (a, b) } else { (b, a) };
    let half = |cos: f32| libm::acosf(cos.clamp(-1.0, 1.0));
    let between = half(wide.0.dot(narrow.0));
    if between + half(narrow.1) <= half(wide.1) {
        return wide;
    }
    let joined = 0.5 * (half(wide.1) + between + half(narrow.1));
    let across = wide.0.cross(narrow.0);
    if joined >= PI || across.length_squared() < 1e-12 {
        return (wide.0, -1.0);
    }
    // Turn the wide cone's axis towards the narrow one's; a little wider against rounding.
    let (sin, cos) = libm::sincosf(joined - half(wide.1));
    let side = across.cross(wide.0).normalize();
    ((wide.0 * cos + side * sin).normalize(), libm::cosf((joined + 1e-4).min(PI)))
}

/// Reorders lights so that those before the returned index make the first child: the cheapest of the planes across all axes;
/// none if no plane parts them.
fn split(lights: &[Reach], order: &mut [u32]) -> Option<usize> {
    let centre = |i: u32| lights[i as usize].bounds.centre();
    let centres = Aabb::around(order.iter().map(|&i| centre(i)));
    let size = centres.max - centres.min;
    let largest = size.max_element();
    let bin_of = |i: u32, axis: usize| {
        let at = (centre(i)[axis] - centres.min[axis]) / size[axis] * BINS as f32;
        (at as usize).min(BINS - 1)
    };
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in (0..3).filter(|&axis| size[axis] > 0.0) {
        let mut bins: [Option<Reach>; BINS] = [None; BINS];
        for &i in order.iter() {
            let bin = &mut bins[bin_of(i, axis)];
            let reach = lights[i as usize];
            *bin = Some(bin.map_or(reach, |b| b.union(&reach)));
        }
        for plane in 1..BINS {
            let side = |bins: &[Option<Reach>]| bins.iter().flatten().copied().reduce(|a, b| a.union(&b));
            let (Some(below), Some(above)) = (side(&bins[..plane]), side(&bins[plane..])) else { continue };
            // Thin boxes are better cut across (their factor k_r).
            let cost = (below.cost() + above.cost()) * largest / size[axis];
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, plane));
            }
        }
    }
    let (_, axis, plane) = best?;
    order.sort_by_key(|&i| bin_of(i, axis) >= plane);
    Some(order.partition_point(|&i| bin_of(i, axis) < plane))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::warp::uniform_sphere;
    use glam::Vec2;

    /// Lights of all kinds, scattered by a low-discrepancy sequence.
    fn lights(count: u32) -> Vec<Reach> {
        let fraction = |i: u32, step: f64| (f64::from(i) * step).fract() as f32;
        (0..count)
            .map(|i| {
                let at = Vec3::new(fraction(i, 0.8191725), fraction(i, 0.6710436), fraction(i, 0.5497005)) * 10.0;
                let axis = uniform_sphere(Vec2::new(fraction(i, 0.7548777), fraction(i, 0.5698403)));
                let (cos_normals, cos_emission) = [(1.0, 0.0), (-1.0, 0.0), (0.8, 0.0), (0.9, 1.0)][i as usize % 4];
                let size = Vec3::splat(0.3) * (i % 3) as f32;
                let bounds = Aabb { min: at, max: at + size };
                Reach { bounds, axis, cos_normals, cos_emission, intensity: 0.1 + (i % 7) as f32 }
            })
            .collect()
    }

    fn points() -> impl Iterator<Item = (Vec3, Vec3)> {
        (0..60u16).map(|i| {
            let u = Vec2::new(f32::from(i) / 60.0, f32::from(i * 17 % 60) / 60.0);
            let along = f32::from(i * 7 % 60) / 60.0;
            (uniform_sphere(u) * 20.0 * along + Vec3::splat(5.0), uniform_sphere(Vec2::new(along, u.x)))
        })
    }

    /// The probabilities of all lights are those of the samples: exactly the numbers that `sample` returns, and as frequent as
    /// they say; and they sum to one, less what descends to where no light can shine.
    #[test]
    fn probabilities_sum_to_one_and_are_those_of_samples() {
        for count in [1, 2, 33, 500] {
            let lights = lights(count);
            let tree = LightTree::new(&lights);
            for (position, normal) in points() {
                let probability: Vec<f32> = (0..count).map(|i| tree.probability(i, position, normal)).collect();
                let mut seen = vec![0.0; count as usize];
                let n = 4096u16;
                let mut found = 0.0;
                for i in 0..n {
                    let u = (f32::from(i) + 0.5) / f32::from(n);
                    let Some((light, p)) = tree.sample(&mut u.clone(), position, normal) else { continue };
                    found += 1.0 / f32::from(n);
                    assert!(
                        (p - probability[light as usize]).abs() <= 1e-5 * p,
                        "{p}, {}",
                        probability[light as usize]
                    );
                    seen[light as usize] += 1.0 / f32::from(n);
                }
                let sum: f32 = probability.iter().sum();
                assert!(
                    (sum - found).abs() < 0.01,
                    "{count} lights: the sum is {sum}, {found} of the samples are there"
                );
                for (p, seen) in probability.iter().zip(seen) {
                    // Each light owns one interval of u, so a count is off by two at most, besides rounding.
                    assert!((p - seen).abs() < 3.0 / f32::from(n), "{p} is seen as {seen}");
                }
            }
        }
    }

    /// What is inside a node's bounds can never shine where the node cannot: a node's importance is zero only where that of
    /// all its lights is.
    #[test]
    fn no_light_is_forgotten() {
        let lights = lights(200);
        let tree = LightTree::new(&lights);
        let mut culled = 0;
        for (position, normal) in points() {
            for (i, light) in lights.iter().enumerate() {
                if Lobe::new(light).importance(position, normal) > 1e-6 {
                    assert!(tree.probability(i as u32, position, normal) > 0.0, "light {i} at {position}");
                } else {
                    culled += 1;
                }
            }
        }
        assert!(culled > 1000, "only {culled} lights cannot shine: the test tells little");
    }
}
