//! A group at its second surfaces.

use super::super::power_heuristic;
use super::super::rows::{Frames, NONE, Vec3s};
use super::super::wave::{State, Wave};
use super::scatterers::Scatterers;
use super::{GROUP, Group};
use crate::bsdf::Closure;
use crate::bvh::Ray;
use crate::bvh::simd::{Kernel, Lanes};
use crate::frame::Frame;
use crate::settings::Offsets;
use crate::shading::Shading;
use crate::surface::{SHADOW_END, offset};
use crate::witness::{Event, Witness};
use crate::world::World;
use glam::Vec3;

/// The first surfaces of a group, and what connects them with the second ones.
pub(super) struct Meeting<'w> {
    pub group: u32,
    /// Among those that are under way.
    number: u32,
    count: usize,
    /// Where the paths are in the wave.
    slots: [usize; GROUP],
    position: Vec3s<GROUP>,
    error: Vec3s<GROUP>,
    normal: Vec3s<GROUP>,
    frame: Frames<GROUP>,
    first: Scatterers,
    shadings: [Shading<'w>; GROUP],
    /// The second surface in hand.
    y: Second,
    links: Links,
    second: Scatterers,
    /// Share of each first surface in the density of each second one, at `[j][k]`.
    shares: [[f32; GROUP]; GROUP],
    /// What pixel k gains from light at second surface j if its way is free, at `[j][k]`; and whether it is.
    light: [[Vec3; GROUP]; GROUP],
    is_lit: [bool; GROUP],
}

/// A second surface.
struct Second {
    position: Vec3,
    error: Vec3,
    normal: Vec3,
    /// The shading normal on the side that the path came from.
    side: Vec3,
    /// Squared distance that `g` is relative to, so that it stays near one.
    scale: f32,
}

/// What is between all first surfaces and the second one in hand.
struct Links {
    /// Unit direction from the second surface to the first one.
    w: Vec3s<GROUP>,
    /// |cos θ| at the second surface over the squared distance, relative to the path's own; zero if that looks the other way.
    g: [f32; GROUP],
    origin: Vec3s<GROUP>,
    direction: Vec3s<GROUP>,
}

impl<'w> Meeting<'w> {
    pub fn new() -> Self {
        let frame = Frame::around(Vec3::Z);
        Self {
            group: NONE,
            number: NONE,
            count: 0,
            slots: [0; GROUP],
            position: Vec3s::ZERO,
            error: Vec3s::ZERO,
            normal: Vec3s::ZERO,
            frame: Frames::ZERO,
            first: Scatterers::new(),
            shadings: [Shading { closure: Closure::Null, frame, tilt: None }; GROUP],
            y: Second { position: Vec3::ZERO, error: Vec3::ZERO, normal: Vec3::Z, side: Vec3::Z, scale: 1.0 },
            links: Links { w: Vec3s::ZERO, g: [0.0; GROUP], origin: Vec3s::ZERO, direction: Vec3s::ZERO },
            second: Scatterers::new(),
            shares: [[0.0; GROUP]; GROUP],
            light: [[Vec3::ZERO; GROUP]; GROUP],
            is_lit: [false; GROUP],
        }
    }

    /// Empties it for a group.
    pub fn begin(&mut self, group: u32, number: u32) {
        (self.group, self.number, self.count) = (group, number, 0);
        self.first.clear();
        self.is_lit = [false; GROUP];
    }

    /// Awaits the path that goes in this place of the wave.
    pub fn join(&mut self, slot: usize) {
        self.slots[self.count] = slot;
        self.count += 1;
    }

    /// Keeps the first surfaces, where the paths have just come to them.
    #[inline(always)]
    pub fn remember_first(&mut self, wave: &Wave<'w>) {
        for k in 0..self.count {
            let i = self.slots[k];
            if wave.state[i] != State::Surface {
                continue;
            }
            if wave.is_diffuse[i] {
                self.first.set_diffuse(k, wave.wo.at(i), wave.albedo.at(i));
            } else if !wave.shadings[i].closure.is_delta() {
                self.first.set(k, wave.wo.at(i), &wave.shadings[i]);
                self.shadings[k] = wave.shadings[i];
            } else {
                continue;
            }
            self.position.set(k, wave.surfaces.position.at(i));
            self.error.set(k, wave.surfaces.error.at(i));
            self.normal.set(k, wave.surfaces.normal.at(i));
            self.frame.set(k, &wave.frame.at(i));
        }
    }

    /// Connects all first surfaces with all second ones, where the paths have just come to those.
    #[inline(always)]
    pub fn connect<L: Lanes, W: Witness>(
        &mut self,
        lanes: L,
        world: &World,
        wave: &mut Wave<'w>,
        offsets: Offsets,
        group: &mut Group,
        witness: &mut W,
    ) {
        for j in 0..self.count {
            let i = self.slots[j];
            group.is_shared[j] = false;
            if self.scatters_at_second(wave, j) && self.connect_one(lanes, world, wave, offsets, j, group) {
                if wave.is_diffuse[i] {
                    share(wave, i, group, j, witness);
                } else {
                    wave.seats[i].meeting = self.number;
                }
            }
        }
    }

    /// Whether path j is at a surface from where others may go on as well.
    #[inline(always)]
    fn scatters_at_second(&self, wave: &Wave, j: usize) -> bool {
        let i = self.slots[j];
        wave.seats[i].group == self.group
            && wave.state[i] == State::Surface
            && wave.from.pdf[i] < f32::INFINITY
            && if wave.is_diffuse[i] { wave.wo.at(i).z > 0.0 } else { !wave.shadings[i].closure.is_delta() }
    }

    /// Weighs what is found from the second surface of path j on for all pixels; whether it is for others than its own.
    #[inline(always)]
    fn connect_one<L: Lanes>(
        &mut self,
        lanes: L,
        world: &World,
        wave: &mut Wave<'w>,
        offsets: Offsets,
        j: usize,
        group: &mut Group,
    ) -> bool {
        self.see_second(wave, j);
        lanes.run(Link(self));
        self.first.evaluate(lanes, &self.shadings);
        let mut count = 0;
        for k in 0..self.count {
            let density = self.first.pdf[k] * self.links.g[k];
            if self.links.g[k] > 0.0 && (density > 0.0 || self.first.value.at(k) != Vec3::ZERO) {
                let (origin, direction) = (self.links.origin.at(k), self.links.direction.at(k));
                let t_max = SHADOW_END * offsets.shadow_share();
                (wave.rays[count], wave.owners[count]) = (Ray { origin, direction, t_max }, k);
                count += 1;
            }
        }
        wave.tally.links += count as u64;
        world.geometry.occluded_many(lanes, &wave.rays[..count], &mut wave.occluded[..count]);
        let (shares, weights) = (&mut self.shares[j], &mut group.weights[j]);
        *shares = [0.0; GROUP];
        *weights = [Vec3::ZERO; GROUP];
        let mut total = 0.0;
        for n in 0..count {
            let k = wave.owners[n];
            if !wave.occluded[n] {
                shares[k] = self.first.pdf[k] * self.links.g[k];
                weights[k] = self.first.value.at(k) * self.links.g[k];
                total += shares[k];
            }
        }
        if !(shares[j] > 0.0 && total < f32::INFINITY) {
            return false;
        }
        for k in 0..self.count {
            shares[k] /= total;
            weights[k] /= total;
        }
        true
    }

    /// Takes the second surface of path j in hand.
    #[inline(always)]
    fn see_second(&mut self, wave: &Wave, j: usize) {
        let i = self.slots[j];
        let (surfaces, n) = (&wave.surfaces, wave.frame.n.at(i));
        let position = surfaces.position.at(i);
        self.y = Second {
            position,
            error: surfaces.error.at(i),
            normal: surfaces.normal.at(i),
            side: if wave.wo.at(i).z < 0.0 { -n } else { n },
            scale: self.position.at(j).distance_squared(position),
        };
    }

    /// Evaluates what the second surface of the path at `i` does with the light and the direction chosen there, for all pixels.
    #[inline(always)]
    pub fn reuse_choices<L: Lanes, W: Witness>(
        &mut self,
        lanes: L,
        wave: &mut Wave<'w>,
        i: usize,
        with_bsdf: bool,
        group: &mut Group,
        witness: &mut W,
    ) {
        let j = wave.seats[i].place as usize;
        let frame = wave.frame.at(i);
        self.see_second(wave, j);
        lanes.run(Link(self));
        self.second.clear();
        for k in 0..self.count {
            if self.shares[j][k] > 0.0 || group.weights[j][k] != Vec3::ZERO {
                self.second.set(k, frame.to_local(self.links.w.at(k)), &wave.shadings[i]);
            }
        }
        if wave.lights.is_some[i] {
            let density = self.evaluate_second(lanes, wave, i, j, wave.towards_light(i));
            let mis = if with_bsdf { power_heuristic(wave.lights.pdf[i], density) } else { 1.0 };
            let mut all = Vec3::ZERO;
            for k in 0..self.count {
                let gained = group.weights[j][k] * self.second.value.at(k) * (wave.lights.weight.at(i) * mis);
                self.light[j][k] = gained;
                all += gained;
            }
            wave.lights.value.set(i, all);
            (wave.lights.bsdf_pdf[i], wave.lights.mis[i]) = (density, mis);
        }
        if wave.next.is_some[i] && wave.next.pdf[i] < f32::INFINITY {
            let density = self.evaluate_second(lanes, wave, i, j, frame.to_local(wave.next.wi.at(i)));
            if density > 0.0 {
                for k in 0..self.count {
                    group.weights[j][k] *= self.second.value.at(k) / density;
                }
                wave.next.weight.set(i, Vec3::ONE);
                wave.next.pdf[i] = density;
                share(wave, i, group, j, witness);
            }
        }
    }

    /// Evaluates the second surface in hand, path j's, for the local direction `wi`; the density of it in the group's mixture.
    #[inline(always)]
    fn evaluate_second<L: Lanes>(&mut self, lanes: L, wave: &Wave, i: usize, j: usize, wi: Vec3) -> f32 {
        for k in 0..GROUP {
            self.second.wi.set(k, wi);
        }
        self.second.evaluate(lanes, &wave.shadings[i..=i]);
        (0..self.count).map(|k| self.shares[j][k] * self.second.pdf[k]).sum()
    }

    /// Light comes to second surface j, or it does not; what its own pixel gains.
    pub fn light(&mut self, j: usize, visible: bool) -> Vec3 {
        self.is_lit[j] = visible;
        if visible { self.light[j][j] } else { Vec3::ZERO }
    }

    /// Gives the pixels what light has come.
    #[inline(always)]
    pub fn part(&self, wave: &mut Wave, group: &mut Group) {
        for j in 0..self.count {
            let seat = &mut wave.seats[self.slots[j]];
            if seat.group == self.group {
                seat.meeting = NONE;
            }
            if self.is_lit[j] {
                for k in 0..self.count {
                    group.own[k] += self.light[j][k];
                }
            }
        }
    }
}

/// What path j of a group finds from here on is for all pixels.
#[inline(always)]
fn share<W: Witness>(wave: &mut Wave, i: usize, group: &mut Group, j: usize, witness: &mut W) {
    let weights = &group.weights[j];
    group.is_shared[j] = true;
    group.own[j] += wave.radiance.at(i);
    wave.radiance.set(i, Vec3::ZERO);
    wave.throughput.set(i, Vec3::ONE);
    wave.worth.set(i, weights[j]);
    let mut all = Vec3::ZERO;
    for weight in weights {
        all += *weight;
    }
    wave.worth_to_all.set(i, all);
    witness.see(i, || Event::Shared { weight: weights[j] });
}

struct Link<'a, 'w>(&'a mut Meeting<'w>);

impl Kernel for Link<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let meeting = self.0;
        for k in 0..GROUP {
            let y = &meeting.y;
            let position = meeting.position.at(k);
            let d = position - y.position;
            let squared = d.length_squared();
            let w = d / squared.sqrt();
            let g = w.dot(y.normal).abs() * (y.scale / squared);
            let origin = offset(position, meeting.error.at(k), meeting.normal.at(k), -d);
            let target = offset(y.position, y.error, y.normal, d);
            meeting.links.w.set(k, w);
            meeting.links.g[k] = if w.dot(y.side) > 0.0 { g } else { 0.0 };
            meeting.links.origin.set(k, origin);
            meeting.links.direction.set(k, target - origin);
            meeting.first.wi.set(k, meeting.frame.at(k).to_local(-w));
        }
    }
}
