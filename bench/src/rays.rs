//! Rays against triangles alone, on one thread: kernels that trace them all, and triangles and rays as files of other tracers.

use glam::Vec3;
use std::f32::consts::TAU;
use tilecast_core::bvh::simd::{Kernel, Lanes};
use tilecast_core::bvh::{Ray, TriangleBvh, TriangleHit};

/// Rays handed over at once.
const BATCH: usize = 256;

/// Closest hits of all rays, one by one or many at once: how many, and the sum of t.
pub struct AllClosest<'a>(pub &'a TriangleBvh, pub &'a [Ray], pub bool);

impl Kernel for AllClosest<'_> {
    type Output = (usize, f64);

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> (usize, f64) {
        let AllClosest(mesh, rays, many) = self;
        let mut all = (0, 0.0);
        let mut add = |hit: Option<TriangleHit>| {
            if let Some(hit) = hit {
                all.0 += 1;
                all.1 += f64::from(hit.t);
            }
        };
        if many {
            let mut hits = [None; BATCH];
            for rays in rays.chunks(BATCH) {
                mesh.closest_many(lanes, rays, &mut hits[..rays.len()]);
                hits[..rays.len()].iter().for_each(|&hit| add(hit));
            }
        } else {
            rays.iter().for_each(|ray| add(mesh.closest(lanes, ray)));
        }
        all
    }
}

/// How many of all rays are occluded, one by one or many at once.
pub struct AllOccluded<'a>(pub &'a TriangleBvh, pub &'a [Ray], pub bool);

impl Kernel for AllOccluded<'_> {
    type Output = usize;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> usize {
        let AllOccluded(mesh, rays, many) = self;
        if !many {
            return rays.iter().filter(|ray| mesh.occluded(lanes, ray)).count();
        }
        let mut occluded = [false; BATCH];
        let mut count = 0;
        for rays in rays.chunks(BATCH) {
            mesh.occluded_many(lanes, rays, &mut occluded[..rays.len()]);
            count += occluded[..rays.len()].iter().filter(|&&o| o).count();
        }
        count
    }
}

/// Little-endian f32 triples.
pub fn vectors(bytes: &[u8]) -> Vec<Vec3> {
    bytes
        .chunks_exact(12)
        .map(|b| Vec3::from_array([0, 4, 8].map(|i| f32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]))))
        .collect()
}

/// The inverse of [`vectors`].
pub fn bytes<'a>(vectors: impl IntoIterator<Item = &'a Vec3>) -> Vec<u8> {
    vectors.into_iter().flat_map(Vec3::to_array).flat_map(f32::to_le_bytes).collect()
}

/// The hierarchy over triangles given as three vertices each.
pub fn hierarchy(triangles: &[[Vec3; 3]]) -> TriangleBvh {
    TriangleBvh::build(triangles.len() as u32, |i| triangles[i as usize])
}

/// The radii of a torus around z, and the height of the waves on it.
const TORUS: (f32, f32, f32) = (1.0, 0.4, 0.02);

/// A closed mesh of `count` triangles or a few more: a torus with waves, the same whatever the count, in quadrilaterals about
/// as long as wide.
pub fn torus(count: u32) -> Vec<[Vec3; 3]> {
    let (major, minor, height) = TORUS;
    let around = (f64::from(count / 2) * f64::from(minor / major)).sqrt().ceil() as u32;
    let along = (count / 2).div_ceil(around);
    let at = |i: u32, k: u32| {
        // Whoever goes round comes back to the same bits.
        let (u, v) = (TAU * (i % along) as f32 / along as f32, TAU * (k % around) as f32 / around as f32);
        let radius = minor + height * (31.0 * u).sin() * (13.0 * v).sin();
        let out = major + radius * v.cos();
        Vec3::new(out * u.cos(), out * u.sin(), radius * v.sin())
    };
    let quads = (0..along).flat_map(|i| (0..around).map(move |k| (i, k)));
    quads
        .flat_map(|(i, k)| {
            let [a, b, c, d] = [at(i, k), at(i + 1, k), at(i + 1, k + 1), at(i, k + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

/// Rays of a pinhole camera that looks at the torus, row by row of a square picture.
pub fn primary(side: u32) -> Vec<Ray> {
    let (eye, half) = (Vec3::new(0.0, -2.2, 1.6), 0.55);
    let forward = -eye.normalize();
    let right = forward.cross(Vec3::Z).normalize();
    let up = right.cross(forward);
    let across = |i: u32| half * (2.0 * (i as f32 + 0.5) / side as f32 - 1.0);
    let pixels = (0..side).flat_map(|y| (0..side).map(move |x| (x, y)));
    pixels.map(|(x, y)| ray(eye, (forward + across(x) * right - across(y) * up).normalize())).collect()
}

/// Rays from within the torus, from anywhere on its middle line and in all directions alike: none like the one before.
pub fn incoherent(count: u32) -> Vec<Ray> {
    // Halton's sequence, three bases.
    let radical = |base: u32, mut i: u32| {
        let (mut value, mut digit) = (0.0, 1.0);
        while i > 0 {
            digit /= f64::from(base);
            value += digit * f64::from(i % base);
            i /= base;
        }
        value as f32
    };
    let one = |i| {
        let [along, z, turn] = [2, 3, 5].map(|base| radical(base, i));
        let (y, x) = (TAU * along).sin_cos();
        let (z, (sin, cos)) = (1.0 - 2.0 * z, (TAU * turn).sin_cos());
        let flat = (1.0 - z * z).max(0.0).sqrt();
        ray(TORUS.0 * Vec3::new(x, y, 0.0), Vec3::new(flat * cos, flat * sin, z))
    };
    (1..=count).map(one).collect()
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_max: f32::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tilecast_core::bvh::simd::Isa;

    /// All rays from within meet the mesh, some of those from without; and files give back what was put in.
    #[test]
    fn the_torus_is_closed_and_seen() {
        let triangles = torus(10_000);
        assert!((10_000..10_400).contains(&triangles.len()), "{}", triangles.len());
        let mesh = hierarchy(&triangles);
        let (inside, outside) = (incoherent(2000), primary(32));
        for many in [false, true] {
            assert_eq!(Isa::detect().dispatch(AllClosest(&mesh, &inside, many)).0, 2000);
            assert_eq!(Isa::detect().dispatch(AllOccluded(&mesh, &inside, many)), 2000);
            let seen = Isa::detect().dispatch(AllClosest(&mesh, &outside, many)).0;
            assert!((300..1000).contains(&seen), "{seen} of 1024");
        }
        assert_eq!(vectors(&bytes(triangles.as_flattened())), triangles.as_flattened());
    }
}
