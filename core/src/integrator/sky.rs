//! The image all around a scene, met and sampled by many paths at once.

use super::rows::{Vec2s, Vec3s, WIDTH};
use super::wave::{State, Wave};
use super::{Estimator, arrive::found};
use crate::bvh::simd::{Kernel, Lanes};
use crate::lights::{Cell, Environment, Facing, Globe, LightSample, Patch, Row};
use crate::sampler::fraction;
use crate::settings::Strategy;
use crate::texture::Textures;
use crate::witness::{Cause, Event, Witness};
use crate::world::World;
use glam::Vec2;

/// Where on the image paths look, and what they see there.
pub(super) struct Skies {
    /// The path looks there at all; else the rest is meaningless.
    pub is_some: [bool; WIDTH],
    column: [i32; WIDTH],
    row: [i32; WIDTH],
    at: Vec2s,
    height: [f32; WIDTH],
    /// What chooses a column.
    strip: [u32; WIDTH],
    step: [u32; WIDTH],
    corners: [Vec3s; 4],
    heights: Vec2s,
    probability: [f32; WIDTH],
    radiance: Vec3s,
    wi: Vec3s,
    pdf: [f32; WIDTH],
}

impl Skies {
    pub const NONE: Self = Self {
        is_some: [false; WIDTH],
        column: [0; WIDTH],
        row: [0; WIDTH],
        at: Vec2s::ZERO,
        height: [0.0; WIDTH],
        strip: [0; WIDTH],
        step: [0; WIDTH],
        corners: [const { Vec3s::ZERO }; 4],
        heights: Vec2s::ZERO,
        probability: [0.0; WIDTH],
        radiance: Vec3s::ZERO,
        wi: Vec3s::ZERO,
        pdf: [0.0; WIDTH],
    };

    #[inline(always)]
    fn set_cell(&mut self, i: usize, cell: &Cell) {
        (self.column[i], self.row[i], self.height[i]) = (cell.column, cell.row, cell.height);
        self.at.set(i, cell.at);
    }

    #[inline(always)]
    fn cell(&self, i: usize) -> Cell {
        Cell { column: self.column[i], row: self.row[i], at: self.at.at(i), height: self.height[i] }
    }

    #[inline(always)]
    fn set_row(&mut self, i: usize, Row { row, at, strip, step }: Row) {
        (self.row[i], self.strip[i], self.step[i]) = (row, strip, step);
        self.at.set(i, Vec2::new(0.0, at));
    }

    #[inline(always)]
    fn row(&self, i: usize) -> Row {
        Row { row: self.row[i], at: self.at.at(i).y, strip: self.strip[i], step: self.step[i] }
    }

    #[inline(always)]
    fn set_patch(&mut self, i: usize, patch: &Patch) {
        self.corners[0].set(i, patch.corners[0]);
        self.corners[1].set(i, patch.corners[1]);
        self.corners[2].set(i, patch.corners[2]);
        self.corners[3].set(i, patch.corners[3]);
        self.heights.set(i, patch.heights);
        self.probability[i] = patch.probability;
    }

    #[inline(always)]
    fn patch(&self, i: usize) -> Patch {
        let [a, b, c, d] = &self.corners;
        let corners = [a.at(i), b.at(i), c.at(i), d.at(i)];
        Patch { corners, heights: self.heights.at(i), probability: self.probability[i] }
    }
}

/// The image, and how it is sampled.
#[derive(Clone, Copy)]
pub(super) struct Around<'a> {
    textures: &'a Textures,
    environment: &'a Environment,
    /// The probability to choose it among all lights.
    probability: f32,
    /// Its directions are sampled by BSDFs, too.
    mis: bool,
}

impl Around<'_> {
    #[inline(always)]
    fn globe(&self) -> Globe {
        self.environment.globe(self.mis)
    }
}

impl Estimator {
    #[inline(always)]
    fn around<'a>(&self, world: &'a World) -> Option<Around<'a>> {
        let (environment, probability) = world.lights.environment()?;
        Some(Around { textures: &world.textures, environment, probability, mis: self.strategy == Strategy::Mis })
    }

    /// Finds out where on the image the rays go that hit nothing, and asks for what is there. None if there are no such rays.
    #[inline(always)]
    pub(super) fn look_beyond<'a, L: Lanes>(
        &self,
        lanes: L,
        world: &'a World,
        wave: &mut Wave,
        count: usize,
    ) -> Option<Around<'a>> {
        wave.sky.is_some = [false; WIDTH];
        let around = self.around(world)?;
        let mut any = false;
        for k in 0..count {
            let i = wave.owners[k];
            let is_hidden = self.integrator.hide_emitters && wave.depth[i] == 0;
            wave.sky.is_some[i] = wave.hits[k].is_none() && !is_hidden;
            any |= wave.sky.is_some[i];
        }
        if !any {
            return None;
        }
        lanes.run(Cells(wave, around.globe()));
        for i in 0..WIDTH {
            if wave.sky.is_some[i] {
                around.environment.prefetch(around.textures, &wave.sky.cell(i), around.mis);
            }
        }
        Some(around)
    }

    /// Gains what those rays see.
    #[inline(always)]
    pub(super) fn shine_beyond<L: Lanes, W: Witness>(
        &self,
        lanes: L,
        around: Around,
        wave: &mut Wave,
        witness: &mut W,
    ) {
        lanes.run(Patches(wave, around));
        lanes.run(Radiances(wave, around.globe()));
        for i in 0..WIDTH {
            if !wave.sky.is_some[i] {
                continue;
            }
            wave.state[i] = State::End;
            let mis = self.weight_of_hit(wave.from.at(i), wave.sky.pdf[i] * around.probability);
            found(wave, i, wave.sky.radiance.at(i), mis, witness);
            witness.see(i, || Event::End(Cause::Escaped));
        }
    }

    /// Finds out which way the surfaces in hand look, as far as the image is sampled by it.
    #[inline(always)]
    pub(super) fn face_sky<L: Lanes>(&self, lanes: L, world: &World, wave: &mut Wave, count: usize) {
        let Some(around) = self.around(world).filter(|_| !self.without.environment_cosine) else { return };
        lanes.run(Facings(wave, around.environment));
        for k in 0..count {
            let i = wave.chosen[k];
            if !wave.is_diffuse[i] && wave.shadings[i].closure.transmits() {
                wave.from.facing[i] = Facing::ANY;
            }
        }
    }

    /// Samples the image for the surfaces that have chosen it as their light.
    #[inline(always)]
    pub(super) fn sample_sky<L: Lanes>(&self, lanes: L, world: &World, wave: &mut Wave) {
        let Some(around) = self.around(world) else { return };
        lanes.run(Choices(wave, around));
        lanes.run(Patches(wave, around));
        lanes.run(Directions(wave, around.globe()));
        lanes.run(SkyLights(wave));
    }
}

/// Which way surfaces look.
struct Facings<'a, 'w>(&'a mut Wave<'w>, &'a Environment);

impl Kernel for Facings<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, environment) = self;
        for i in 0..WIDTH {
            wave.from.facing[i] = environment.facing(wave.frame.n.at(i));
        }
    }
}

/// Where the rays in hand would meet the image.
struct Cells<'a, 'w>(&'a mut Wave<'w>, Globe);

impl Kernel for Cells<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, globe) = self;
        for i in 0..WIDTH {
            let cell = globe.cell(wave.direction.at(i));
            wave.sky.set_cell(i, &cell);
        }
    }
}

/// Reads what the tables have about the cells.
struct Patches<'a, 'w>(&'a mut Wave<'w>, Around<'a>);

impl Kernel for Patches<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, Around { textures, environment, mis, .. }) = self;
        for i in 0..WIDTH {
            if wave.sky.is_some[i] {
                let patch = environment.patch(textures, &wave.sky.cell(i), wave.from.facing[i], mis);
                wave.sky.set_patch(i, &patch);
            }
        }
    }
}

/// What the rays see of the image.
struct Radiances<'a, 'w>(&'a mut Wave<'w>, Globe);

impl Kernel for Radiances<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, globe) = self;
        for i in 0..WIDTH {
            let (radiance, pdf) = globe.radiance(&wave.sky.cell(i), &wave.sky.patch(i));
            wave.sky.radiance.set(i, radiance);
            wave.sky.pdf[i] = pdf;
        }
    }
}

/// Chooses cells for those who sample the image.
struct Choices<'a, 'w>(&'a mut Wave<'w>, Around<'a>);

impl Kernel for Choices<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, Around { textures, environment, mis, .. }) = self;
        for i in 0..WIDTH {
            if wave.sky.is_some[i] {
                // What the choice of the light has left of them, and the bits that floats have no room for.
                let (u, [x, y]) = (wave.lights.u.at(i), wave.numbers.light_point(i));
                let numbers = [fraction(u.x, x), fraction(u.y, y)];
                match environment.choose_row(numbers, wave.from.facing[i], mis) {
                    Some(row) => wave.sky.set_row(i, row),
                    None => wave.sky.is_some[i] = false,
                }
            }
        }
        for i in 0..WIDTH {
            if wave.sky.is_some[i] {
                let cell = environment.choose_column(wave.sky.row(i), mis);
                environment.prefetch(textures, &cell, mis);
                wave.sky.set_cell(i, &cell);
            }
        }
    }
}

/// Chooses directions within the cells.
struct Directions<'a, 'w>(&'a mut Wave<'w>, Globe);

impl Kernel for Directions<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, globe) = self;
        for i in 0..WIDTH {
            let (wi, radiance, pdf) = globe.direction(&wave.sky.cell(i), &wave.sky.patch(i));
            wave.sky.wi.set(i, wi);
            wave.sky.radiance.set(i, radiance);
            wave.sky.pdf[i] = pdf;
        }
    }
}

/// Makes light samples of those directions. (In one loop with [`Directions`] it would not become one of vectors.)
struct SkyLights<'a, 'w>(&'a mut Wave<'w>);

impl Kernel for SkyLights<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let wave = self.0;
        for i in 0..WIDTH {
            let wi = wave.sky.wi.at(i);
            let pdf = wave.sky.pdf[i] * wave.lights.probability[i];
            let shadow_ray = wave.surfaces.at(i).ray(wi, f32::INFINITY);
            let sample = LightSample { wi, weight: wave.sky.radiance.at(i) / pdf, pdf, shadow_ray };
            wave.lights.set_if(i, &sample, wave.sky.is_some[i]);
            wave.lights.is_some[i] |= wave.sky.is_some[i] & (pdf > 0.0);
        }
    }
}
