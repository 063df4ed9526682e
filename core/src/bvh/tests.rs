//! What the traversal promises: the same bits on every path, the same hits as without a tree, no leaks, the same tree on
//! any number of threads.

use super::simd::{Isa, Kernel, Lanes};
use super::triangle::{BLOCK, Block, Blocks};
use super::{Leaf, Leaves, Ray, Slabs, TriangleBvh, TriangleHit};
use glam::{Mat3, Vec3};
use proptest::prelude::*;

type Triangle = [Vec3; 3];

/// A hash of (seed, index) as a number in -1 to 1.
fn noise(seed: u32, index: usize) -> f32 {
    let mut x = u64::from(seed) << 32 ^ (index as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for _ in 0..3 {
        x = (x ^ x >> 31).wrapping_mul(0xd6e8_feb8_6659_fd93);
    }
    (x >> 40) as f32 / (1 << 23) as f32 - 1.0
}

pub(super) fn noise3(seed: u32, index: usize) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|k| noise(seed, 3 * index + k)))
}

pub(super) fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_max: f32::INFINITY }
}

fn bvh(triangles: &[Triangle]) -> TriangleBvh {
    TriangleBvh::build(triangles.len() as u32, |i| triangles[i as usize])
}

fn bvh_of_whole(triangles: &[Triangle]) -> TriangleBvh {
    TriangleBvh::build_with(triangles.len() as u32, &|i| triangles[i as usize], 0.0)
}

/// All that can be in pieces is.
fn bvh_in_pieces(triangles: &[Triangle]) -> TriangleBvh {
    TriangleBvh::build_with(triangles.len() as u32, &|i| triangles[i as usize], f32::INFINITY)
}

/// What a ray meets: the nearest hit by the tree, whether the tree says there is any, and the nearest of all blocks without a tree.
struct Answers<'a> {
    bvh: &'a TriangleBvh,
    blocks: &'a [Block],
    ray: &'a Ray,
}

impl Answers<'_> {
    #[inline(always)]
    fn without_tree<L: Lanes, const PIECES: bool>(&self, lanes: L) -> Option<TriangleHit> {
        let slabs = Slabs::new(self.ray);
        let mut all = Blocks::<PIECES>::new(self.ray, self.blocks, self.bvh.references());
        for first in 0..self.blocks.len() as u32 {
            all.nearest(lanes, &slabs, Leaf { first, count: 1 }, f32::INFINITY);
        }
        all.nearest.hit()
    }
}

impl Kernel for Answers<'_> {
    type Output = (Option<TriangleHit>, bool, Option<TriangleHit>);

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let is_whole = self.bvh.pieces.is_empty();
        let all = if is_whole { self.without_tree::<L, false>(lanes) } else { self.without_tree::<L, true>(lanes) };
        (self.bvh.closest(lanes, self.ray), self.bvh.occluded(lanes, self.ray), all)
    }
}

/// All rays at once.
struct Many<'a>(&'a TriangleBvh, &'a [Ray]);

impl Kernel for Many<'_> {
    type Output = Vec<(Option<TriangleHit>, bool)>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let (mut hits, mut occluded) = (vec![None; self.1.len()], vec![false; self.1.len()]);
        self.0.closest_many(lanes, self.1, &mut hits);
        self.0.occluded_many(lanes, self.1, &mut occluded);
        hits.into_iter().zip(occluded).collect()
    }
}

fn bits(hit: Option<TriangleHit>) -> Option<[u32; 4]> {
    hit.map(|h| [h.t.to_bits(), h.u.to_bits(), h.v.to_bits(), h.triangle])
}

/// Every path gives the brute-force hit to the bit, with triangles whole and in pieces; returns how many rays hit.
fn agree(triangles: &[Triangle], rays: &[Ray]) -> usize {
    let blocks: Vec<Block> = (0..triangles.len())
        .step_by(BLOCK)
        .map(|at| Block::new((at..triangles.len()).map(|i| (i as u32, triangles[i]))))
        .collect();
    let in_pieces = bvh_in_pieces(triangles);
    let found = agree_without_tree(&bvh_of_whole(triangles), &blocks, rays);
    assert_eq!(agree_without_tree(&in_pieces, &in_pieces.blocks, rays), found, "pieces are missed");
    found
}

/// Every path finds in the tree what it finds in these blocks, to the bit; returns how many rays hit.
fn agree_without_tree(bvh: &TriangleBvh, blocks: &[Block], rays: &[Ray]) -> usize {
    let answers = |isa: Isa, ray| isa.dispatch(Answers { bvh, blocks, ray });
    let many: Vec<_> = Isa::available().into_iter().map(|isa| isa.dispatch(Many(bvh, rays))).collect();
    let mut found = 0;
    for (index, ray) in rays.iter().enumerate() {
        let (closest, any, brute) = answers(Isa::Portable, ray);
        assert_eq!(bits(closest), bits(brute), "{ray:?}");
        assert_eq!(any, brute.is_some(), "{ray:?}");
        found += usize::from(any);
        for (isa, many) in Isa::available().into_iter().zip(&many) {
            let (c, a) = many[index];
            assert_eq!((bits(c), a), (bits(closest), any), "many, {} {ray:?}", isa.name());
            let (c, a, b) = answers(isa, ray);
            assert_eq!((bits(c), a, bits(b)), (bits(closest), any, bits(brute)), "{} {ray:?}", isa.name());
        }
        if let Some(hit) = brute {
            assert!(hit.t > 0.0 && hit.t <= ray.t_max, "{hit:?}");
        }
    }
    found
}

/// Small triangles, slivers of 1 to 10^7, axis-aligned quads, and copies of some.
fn soup(count: usize) -> Vec<Triangle> {
    let mut triangles: Vec<Triangle> = (0..count)
        .map(|i| {
            let [p, q, r] = [0, 1, 2].map(|k| noise3(7, 3 * i + k));
            match i % 8 {
                0 => [p, p + q, p + q + r * 1e-7],
                1 => [p, p + Vec3::X * 0.3, p + Vec3::Y * 0.3],
                2 => [p, p + Vec3::Z * 0.2, p + Vec3::Y * 0.4],
                3 => [p, p + q * 1e-3, p + r * 1e-3],
                _ => [p, p + q * 0.2, p + r * 0.2],
            }
        })
        .collect();
    triangles.extend_from_within(..count / 4);
    triangles
}

/// Rays everywhere; at vertices, edges and along axes; along edges; with zeros of both signs; short ones.
fn nasty_rays(triangles: &[Triangle], count: usize) -> Vec<Ray> {
    let mut rays = Vec::new();
    for i in 0..count {
        let [a, b, c] = triangles[i * 31 % triangles.len()];
        let origin = noise3(1, i) * 2.0;
        let s = noise(2, i) * 0.5 + 0.5;
        rays.push(ray(origin, noise3(3, i)));
        rays.push(ray(origin, a - origin));
        rays.push(ray(origin, a + (b - a) * s - origin));
        rays.push(ray(a - (b - a), b - a));
        rays.push(ray(a, c - a));
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        let zero = if i % 4 < 2 { 0.0 } else { -0.0 };
        let mut axis = Vec3::splat(zero);
        axis[i % 3] = sign;
        rays.push(ray(a - axis * 3.0, axis));
        rays.push(ray((a + b + c) / 3.0 - axis * 3.0, axis));
        axis[(i + 1) % 3] = noise(4, i);
        rays.push(ray(b - axis * 2.0, axis));
        rays.push(Ray { t_max: s, ..ray(origin, (a + b + c) / 3.0 - origin) });
    }
    rays
}

fn map(triangles: &[Triangle], rays: &[Ray], scale: f32, offset: Vec3) -> (Vec<Triangle>, Vec<Ray>) {
    let point = |p: Vec3| p * scale + offset;
    let triangles = triangles.iter().map(|t| t.map(point)).collect();
    let rays =
        rays.iter().map(|r| Ray { origin: point(r.origin), direction: r.direction * scale, t_max: r.t_max }).collect();
    (triangles, rays)
}

#[test]
fn every_path_agrees_with_no_tree_at_all() {
    let triangles = soup(600);
    let rays = nasty_rays(&triangles, 400);
    assert!(bvh_in_pieces(&triangles).pieces.len() > 50, "that many pieces are tried below");
    for (scale, offset) in [
        (1.0, Vec3::ZERO),
        (1e6, Vec3::ZERO),
        (1e-6, Vec3::ZERO),
        (1.0, Vec3::new(1e3, -2e3, 5e3)),
        (1e-3, Vec3::new(1e3, 1e3, 1e3)),
        (1.0, Vec3::new(1e6, 0.0, 0.0)),
    ] {
        let (triangles, rays) = map(&triangles, &rays, scale, offset);
        let found = agree(&triangles, &rays);
        assert!(found > rays.len() / 4, "{found} hits at scale {scale}");
    }
}

#[test]
fn few_triangles_and_none() {
    let triangles = soup(10);
    let rays = nasty_rays(&triangles, 50);
    assert_eq!(agree(&[], &rays), 0);
    for count in 1..12 {
        agree(&triangles[..count], &rays);
    }
}

#[test]
fn equal_hits_go_to_the_smallest_number() {
    let triangles = vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 100];
    let down = ray(Vec3::new(0.25, 0.5, 1.0), Vec3::NEG_Z);
    assert_eq!(agree(&triangles, &[down]), 1);
    let (hit, ..) = Isa::Portable.dispatch(Answers { bvh: &bvh(&triangles), blocks: &[], ray: &down });
    let expected = TriangleHit { t: 1.0, u: 0.25, v: 0.5, triangle: 0 };
    assert_eq!(hit, Some(expected));
}

#[test]
fn rays_in_the_faces_of_boxes() {
    // A grid of unit squares in z = 0, met along its own lines from above and within its plane.
    let mut triangles = Vec::new();
    for x in 0..20_u8 {
        for y in 0..20_u8 {
            let p = Vec3::new(f32::from(x), f32::from(y), 0.0);
            triangles.push([p, p + Vec3::X, p + Vec3::X + Vec3::Y]);
            triangles.push([p, p + Vec3::X + Vec3::Y, p + Vec3::Y]);
        }
    }
    let (mut down, mut within) = (Vec::new(), Vec::new());
    for x in 0..=40_u8 {
        for zero in [0.0, -0.0] {
            let at = Vec3::new(f32::from(x) * 0.5, 7.0, 2.0);
            down.push(ray(at, Vec3::new(zero, zero, -1.0)));
            down.push(ray(at, Vec3::new(zero, -2.0, -1.0)));
            within.push(ray(Vec3::new(-1.0, at.x, zero), Vec3::new(1.0, zero, zero)));
        }
    }
    assert_eq!(agree(&triangles, &down), down.len());
    assert_eq!(agree(&triangles, &within), 0);
}

/// A closed surface: `point(u, v)` over `n` by `m` squares, both directions wrapped, or `v` pinched at its ends.
fn closed(n: usize, m: usize, wrapped: bool, point: impl Fn(usize, usize) -> Vec3) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    for i in 0..n {
        for j in 0..m {
            let [i1, j1] = [(i + 1) % n, if wrapped { (j + 1) % m } else { j + 1 }];
            let [a, b, c, d] = [point(i, j), point(i1, j), point(i1, j1), point(i, j1)];
            triangles.extend([[a, b, c], [a, c, d]].into_iter().filter(|[a, b, c]| a != b && b != c && a != c));
        }
    }
    triangles
}

fn sphere(n: usize, m: usize) -> Vec<Triangle> {
    closed(n, m, false, |i, j| {
        if j == 0 || j == m {
            return if j == 0 { Vec3::Z } else { Vec3::NEG_Z };
        }
        let (sin_p, cos_p) = libm::sincosf(i as f32 / n as f32 * std::f32::consts::TAU);
        let (sin_t, cos_t) = libm::sincosf(j as f32 / m as f32 * std::f32::consts::PI);
        Vec3::new(sin_t * cos_p, sin_t * sin_p, cos_t)
    })
}

fn torus(n: usize, m: usize) -> Vec<Triangle> {
    closed(n, m, true, |i, j| {
        let (sin_p, cos_p) = libm::sincosf(i as f32 / n as f32 * std::f32::consts::TAU);
        let (sin_t, cos_t) = libm::sincosf(j as f32 / m as f32 * std::f32::consts::TAU);
        Vec3::new((1.0 + 0.4 * cos_t) * cos_p, (1.0 + 0.4 * cos_t) * sin_p, 0.4 * sin_t)
    })
}

/// How many of `rays` leave without a hit.
struct Leaks<'a>(&'a TriangleBvh, &'a [Ray]);

impl Kernel for Leaks<'_> {
    type Output = usize;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> usize {
        self.1.iter().filter(|ray| self.0.closest(lanes, ray).is_none() || !self.0.occluded(lanes, ray)).count()
    }
}

#[test]
fn closed_surfaces_never_leak() {
    // A million rays from inside at vertices and edges, in three placements; the thin ones have long triangles, which are cut.
    let turn = Mat3::from_axis_angle(Vec3::new(0.48, 0.6, 0.64), 1.0);
    let surfaces = [
        (sphere(64, 40), 0.0, false),
        (sphere(400, 3), 0.0, true),
        (torus(50, 30), 1.0, false),
        (torus(7, 300), 1.0, true),
    ];
    for (surface, core, is_thin) in surfaces {
        for (scale, offset) in [(1.0, Vec3::ZERO), (1e4, Vec3::splat(-3e3)), (1e-3, Vec3::new(10.0, 0.0, 2.0))] {
            let triangles: Vec<Triangle> = surface.iter().map(|t| t.map(|p| turn * p * scale + offset)).collect();
            let trees = [bvh_of_whole(&triangles), bvh_in_pieces(&triangles)];
            assert_eq!(trees[1].pieces.len() > triangles.len(), is_thin, "{} pieces", trees[1].pieces.len());
            // Pieces are used where they are worth it.
            let [better, worse] = [bvh(&triangles), bvh_of_whole(&triangles)].map(|bvh| bvh.stats().sah_cost);
            assert_eq!(better < 0.9 * worse, is_thin, "{better} and {worse}");
            let rays: Vec<Ray> = (0..84_000)
                .map(|i| {
                    let [a, b, _] = triangles[i % triangles.len()];
                    // In the sphere near its centre; in the torus near its inner circle.
                    let (sin, cos) = libm::sincosf(noise(5, i) * std::f32::consts::PI);
                    let inside = Vec3::new(cos, sin, 0.0) * core + noise3(6, i) * 0.1;
                    let origin = turn * inside * scale + offset;
                    let s = [0.0, 1.0, 0.5, noise(8, i) * 0.5 + 0.5][i / triangles.len() % 4];
                    ray(origin, a + (b - a) * s - origin)
                })
                .collect();
            for bvh in trees {
                let leaks = Isa::detect().dispatch(Leaks(&bvh, &rays));
                assert_eq!(leaks, 0, "scale {scale}, {} pieces of {} triangles", bvh.pieces.len(), triangles.len());
            }
        }
    }
}

#[test]
fn the_tree_does_not_depend_on_threads() {
    let triangles = soup(150_000); // In parts.
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| bvh(&triangles))
    };
    let one = build(1);
    for threads in [2, 3, 8] {
        let other = build(threads);
        assert!(other.bvh == one.bvh, "{threads} threads");
        assert!(other.blocks.iter().map(Block::ids).eq(one.blocks.iter().map(Block::ids)));
    }
    assert!(one.stats().sah_cost > 1.0);
}

proptest! {
    #[test]
    fn any_triangles_and_rays(
        corners in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-3_i8..4)), 1..40),
        rays in prop::collection::vec((prop::array::uniform3(-4_i8..5), prop::array::uniform3(-2_i8..3)), 1..40),
    ) {
        // Small integers: rays through shared vertices, along edges and in faces are the rule here.
        let point = |p: [i8; 3]| Vec3::from_array(p.map(f32::from));
        let triangles: Vec<Triangle> = corners.into_iter().map(|t| t.map(point)).collect();
        let rays: Vec<Ray> = rays
            .into_iter()
            .filter(|(_, direction)| *direction != [0; 3])
            .map(|(origin, direction)| ray(point(origin), point(direction)))
            .collect();
        agree(&triangles, &rays);
    }
}
