//! Many paths at once, laid out for loops over all of them.

use super::coats::Coats;
use super::reuse::{Groups, Seat};
use super::rows::{
    Frames, LightSamples, NONE, Numbers, Origins, Samples, Stem, Surfaces, Triangles, Vec2s, Vec3s, WIDTH,
};
use super::sky::Skies;
use super::{Roulette, Tag, Tally};
use crate::bsdf::{Closure, Diffuse};
use crate::bvh::Ray;
use crate::frame::Frame;
use crate::geometry::Hit;
use crate::lights::Facing;
use crate::sampler::Samplers;
use crate::shading::Shading;
use crate::witness::{Event, Witness};
use glam::Vec3;

/// Where a path is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum State {
    /// There is none.
    Idle,
    /// A ray is to be followed.
    Ray,
    /// At a surface that is to scatter it.
    Surface,
    /// At its end: its radiance is known.
    End,
}

/// When paths end. It lies with them, since compilers make vectors of loops only where there is one thing to point at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rules {
    /// After the first scattering.
    pub is_direct: bool,
    /// After the first that is not into finitely many directions.
    pub is_whitted: bool,
    pub max_depth: u32,
    pub roulette: Roulette,
}

/// [`WIDTH`] paths as far as they have come. What is meaningless in a path's state may be anything.
pub(super) struct Wave<'w> {
    pub rules: Rules,
    pub tally: Tally,
    pub state: [State; WIDTH],
    pub tags: [Tag; WIDTH],
    pub radiance: Vec3s,
    /// Where paths are reused: their groups, and where each path belongs.
    pub groups: Option<Groups<'w>>,
    pub seats: [Seat; WIDTH],
    /// What is found now counts so much for the path's own pixel, and for all pixels that reuse it: one unless there are others.
    pub worth: Vec3s,
    pub worth_to_all: Vec3s,
    pub samplers: Samplers<WIDTH>,

    pub origin: Vec3s,
    pub direction: Vec3s,
    pub t_max: [f32; WIDTH],
    pub from: Origins,
    /// Segments so far.
    pub depth: [u32; WIDTH],
    /// f |cos θ| / p of all surfaces.
    pub throughput: Vec3s,
    /// The path's part in the sample: less than one where it branches.
    pub share: [f32; WIDTH],
    /// Product of the relative indices of refraction.
    pub eta: [f32; WIDTH],
    /// The ray in hand is the last: only what it finds shining matters.
    pub is_last: [bool; WIDTH],

    pub surfaces: Surfaces,
    pub triangles: Triangles,
    pub is_sure: [bool; WIDTH],
    /// The material looks alike from both sides but for the direction of its normal, and whether the path sees the back.
    pub is_two_sided: [bool; WIDTH],
    pub is_turned: [bool; WIDTH],
    /// The shading frame.
    pub frame: Frames,
    /// Local.
    pub wo: Vec3s,
    /// How light scatters, where that is not plainly diffuse.
    pub shadings: [Shading<'w>; WIDTH],
    pub is_diffuse: [bool; WIDTH],
    pub albedo: Vec3s,
    pub is_coat: [bool; WIDTH],
    pub coats: Coats,

    pub numbers: Numbers,
    /// The light that was chosen, or [`NONE`]; whether it is plain; and what comes from there.
    pub light: [u32; WIDTH],
    pub is_plain: [bool; WIDTH],
    pub lights: LightSamples,
    pub sky: Skies,
    pub next: Samples,
    pub survival: [f32; WIDTH],
    pub survived: [bool; WIDTH],
    pub stem: Option<Box<Stem>>,

    /// Rays on their way to the hierarchy, the paths that they belong to, and the answers.
    pub rays: [Ray; WIDTH],
    pub owners: [usize; WIDTH],
    pub hits: [Option<Hit>; WIDTH],
    pub occluded: [bool; WIDTH],
    /// Some paths, by their numbers.
    pub chosen: [usize; WIDTH],
}

impl<'w> Wave<'w> {
    /// No path; `tag` is any.
    pub fn new(rules: Rules, tag: Tag, branches: bool) -> Box<Self> {
        let triangles = || Triangles { corners: [const { Vec3s::ZERO }; 3], extra: Vec3s::ZERO, area: [0.0; WIDTH] };
        Box::new(Self {
            rules,
            tally: Tally::default(),
            state: [State::Idle; WIDTH],
            tags: [tag; WIDTH],
            radiance: Vec3s::ZERO,
            groups: None,
            seats: [Seat::NONE; WIDTH],
            worth: Vec3s::ZERO,
            worth_to_all: Vec3s::ZERO,
            samplers: Samplers::NONE,
            origin: Vec3s::ZERO,
            direction: Vec3s::ZERO,
            t_max: [0.0; WIDTH],
            from: Origins {
                position: Vec3s::ZERO,
                normal: Vec3s::ZERO,
                pdf: [0.0; WIDTH],
                facing: [Facing::ANY; WIDTH],
            },
            depth: [0; WIDTH],
            throughput: Vec3s::ZERO,
            share: [1.0; WIDTH],
            eta: [1.0; WIDTH],
            is_last: [false; WIDTH],
            surfaces: Surfaces {
                position: Vec3s::ZERO,
                error: Vec3s::ZERO,
                normal: Vec3s::ZERO,
                frame: Frames::ZERO,
                uv: Vec2s::ZERO,
                barycentric: Vec2s::ZERO,
                shape: [0; WIDTH],
                instance: [NONE; WIDTH],
                primitive: [0; WIDTH],
                light: [NONE; WIDTH],
            },
            triangles: triangles(),
            is_sure: [true; WIDTH],
            is_two_sided: [false; WIDTH],
            is_turned: [false; WIDTH],
            frame: Frames::ZERO,
            wo: Vec3s::ZERO,
            shadings: [Shading { closure: Closure::Null, frame: Frame::around(Vec3::Z), tilt: None }; WIDTH],
            is_diffuse: [false; WIDTH],
            albedo: Vec3s::ZERO,
            is_coat: [false; WIDTH],
            coats: Coats::NONE,
            numbers: Numbers {
                lobe: [0.0; WIDTH],
                direction: Vec2s::ZERO,
                light: [0.0; WIDTH],
                light_point: [[0; WIDTH]; 2],
                roulette: [0.0; WIDTH],
            },
            light: [NONE; WIDTH],
            is_plain: [false; WIDTH],
            lights: LightSamples {
                probability: [0.0; WIDTH],
                u: Vec2s::ZERO,
                is_some: [false; WIDTH],
                wi: Vec3s::ZERO,
                weight: Vec3s::ZERO,
                pdf: [0.0; WIDTH],
                origin: Vec3s::ZERO,
                direction: Vec3s::ZERO,
                t_max: [0.0; WIDTH],
                value: Vec3s::ZERO,
                bsdf_pdf: [0.0; WIDTH],
                mis: [0.0; WIDTH],
            },
            sky: Skies::NONE,
            next: Samples {
                is_some: [false; WIDTH],
                wi: Vec3s::ZERO,
                weight: Vec3s::ZERO,
                pdf: [0.0; WIDTH],
                eta: [1.0; WIDTH],
            },
            survival: [1.0; WIDTH],
            survived: [true; WIDTH],
            stem: branches.then(|| {
                Box::new(Stem { throughput: Vec3s::ZERO, eta: [1.0; WIDTH], depth: [0; WIDTH], lobe: [0.0; WIDTH] })
            }),
            rays: [Ray { origin: Vec3::ZERO, direction: Vec3::Z, t_max: 0.0 }; WIDTH],
            owners: [0; WIDTH],
            hits: [None; WIDTH],
            occluded: [false; WIDTH],
            chosen: [0; WIDTH],
        })
    }

    #[inline(always)]
    pub fn ray(&self, i: usize) -> Ray {
        Ray { origin: self.origin.at(i), direction: self.direction.at(i), t_max: self.t_max[i] }
    }

    #[inline(always)]
    pub fn set_ray(&mut self, i: usize, ray: &Ray) {
        self.origin.set(i, ray.origin);
        self.direction.set(i, ray.direction);
        self.t_max[i] = ray.t_max;
    }

    /// The local direction to the light that was sampled.
    #[inline(always)]
    pub fn towards_light(&self, i: usize) -> Vec3 {
        self.frame.at(i).to_local(self.lights.wi.at(i))
    }

    /// Keeps what is known of a diffuse surface like that of any other.
    pub fn remember_diffuse(&mut self, i: usize) {
        let closure = Closure::Diffuse(Diffuse { reflectance: self.albedo.at(i) });
        self.shadings[i] = Shading { closure, frame: self.frame.at(i), tilt: None };
    }

    #[inline(always)]
    pub fn gain(&mut self, i: usize, gained: Vec3) {
        self.radiance.set(i, self.radiance.at(i) + gained);
    }

    /// The shading frame at a surface with this frame, if the material bends nothing, and the direction back along the path.
    #[inline(always)]
    pub fn see_from(&mut self, i: usize, frame: &Frame, is_two_sided: bool) {
        let wo = -self.direction.at(i);
        let is_turned = is_two_sided & (frame.n.dot(wo) < 0.0);
        let n = if is_turned { -frame.n } else { frame.n };
        let frame = Frame { n, ..*frame };
        self.is_turned[i] = is_turned;
        self.frame.set(i, &frame);
        self.wo.set(i, frame.to_local(wo));
    }

    /// Begins a path with its camera ray.
    #[inline(always)]
    pub fn begin(&mut self, i: usize, ray: &Ray, is_last: bool) {
        self.set_ray(i, ray);
        self.from.position.set(i, ray.origin);
        self.from.normal.set(i, Vec3::ZERO);
        self.from.pdf[i] = f32::INFINITY;
        self.radiance.set(i, Vec3::ZERO);
        self.throughput.set(i, Vec3::ONE);
        self.worth.set(i, Vec3::ONE);
        self.worth_to_all.set(i, Vec3::ONE);
        self.share[i] = 1.0;
        self.eta[i] = 1.0;
        self.depth[i] = 0;
        self.is_last[i] = is_last;
        self.state[i] = State::Ray;
    }

    /// Makes ready for branches, of this share each, the paths that are at surfaces which scatter into more than finitely many
    /// directions.
    pub fn fork(&mut self, share: f32) {
        let Some(stem) = &mut self.stem else { return };
        for i in 0..WIDTH {
            if self.state[i] == State::Surface && (self.is_diffuse[i] || !self.shadings[i].closure.is_delta()) {
                self.share[i] = share;
                stem.throughput.set(i, self.throughput.at(i));
                stem.eta[i] = self.eta[i];
                stem.depth[i] = self.depth[i];
                stem.lobe[i] = self.numbers.lobe[i];
            }
        }
    }

    /// Puts the paths that branch where they forked.
    #[inline(always)]
    pub fn begin_branch(&mut self, branch: u32, of: u32, witness: &mut impl Witness) {
        let Some(stem) = &self.stem else { return };
        for i in 0..WIDTH {
            if self.state[i] == State::Idle || self.share[i] == 1.0 {
                continue;
            }
            self.throughput.set(i, stem.throughput.at(i));
            self.eta[i] = stem.eta[i];
            self.depth[i] = stem.depth[i];
            // Shifted, so that each of them is as even over [0, 1) as the first, and together they are more so.
            let lobe = stem.lobe[i] + branch as f32 * (1.0 / of as f32);
            self.numbers.lobe[i] = if lobe >= 1.0 { lobe - 1.0 } else { lobe };
            self.state[i] = State::Surface;
            witness.see(i, || Event::Branch { number: branch + 1, of });
        }
    }
}
