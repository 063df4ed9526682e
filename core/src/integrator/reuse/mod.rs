//! Paths reused: what one path finds from its second surface on counts for all pixels of a block.
//!
//! The paths of one sample of a block of pixels go as a group. From its first surface each chooses a second one, y; there the
//! group meets, every first surface x_i that sees y is connected with it, and pixel i gains, by multiple importance sampling
//! over all that might have chosen y (Bekaert, Sbert & Halton 2002, "Accelerating Path Tracing by Re-Using Paths"; balance
//! heuristic: Veach & Guibas 1995),
//!
//! ```text
//! Σ_j f(x_i → y_j) G(x_i, y_j) V(x_i, y_j) L(y_j → x_i) / Σ_k V(x_k, y_j) p(x_k → y_j) G'(x_k, y_j)
//! ```
//!
//! so that each path's way on is one sample for every pixel of the block. Direct light at x and what y emits stay each pixel's
//! own. Where y looks alike from everywhere (Lambert's), its direct light and its way on are reused together; elsewhere what
//! it does with the light and the direction that were chosen there is evaluated for each x_i, and the density of that
//! direction becomes the group's mixture.
//!
//! V is what a ray between x and y finds. For y_j and its own x_j that is asked as well: where it is blocked by rounding, pair
//! by pair, both sides of the fraction leave the pair out, and the path stays its own pixel's.

mod meeting;
mod scatterers;

use super::rows::NONE;
use super::wave::Wave;
use super::{Estimator, Tag};
use crate::bvh::simd::Lanes;
use crate::settings::{IntegratorKind, Settings, Strategy};
use crate::witness::{Event, Witness};
use crate::world::World;
use glam::Vec3;
use meeting::Meeting;

/// Pixels of a block, across and down: its place in the picture is a multiple of them. More reuse a path more often, and cost as
/// many rays to connect it.
pub(crate) const BLOCK: [u32; 2] = [4, 4];
/// Paths of a group, at most.
pub(crate) const GROUP: usize = (BLOCK[0] * BLOCK[1]) as usize;

/// The groups under way.
pub(super) struct Groups<'w> {
    groups: Vec<Group>,
    free: Vec<u32>,
    /// Those at their first surfaces, and those at their second ones.
    first: Meetings<'w>,
    second: Meetings<'w>,
}

/// Some meetings, and room for others.
#[derive(Default)]
struct Meetings<'w> {
    all: Vec<Meeting<'w>>,
    count: usize,
}

/// What is kept of a group until its last path has ended.
struct Group {
    tags: [Tag; GROUP],
    count: usize,
    under_way: usize,
    /// Each pixel's own: what is not reused.
    own: [Vec3; GROUP],
    /// Whether what a path has found since the group met is everyone's.
    is_shared: [bool; GROUP],
    found: [Vec3; GROUP],
    /// Weight of what path j found in the pixel of path k, at `[j][k]`.
    weights: [[Vec3; GROUP]; GROUP],
}

/// Where a path belongs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seat {
    /// Its group, or [`NONE`].
    group: u32,
    place: u32,
    /// Which meeting at second surfaces awaits what the path does there; none if that is known or the path's own.
    meeting: u32,
}

impl Seat {
    /// By itself.
    pub const NONE: Self = Self { group: NONE, place: 0, meeting: NONE };

    /// What is done at the surface in hand is reused, light and direction apart.
    #[inline(always)]
    pub fn is_at_meeting(self) -> bool {
        self.meeting != NONE
    }
}

impl Group {
    /// What these paths have found for the pixel of path k.
    #[inline(always)]
    fn found_for(&self, k: usize, these: impl Fn(usize) -> bool) -> Vec3 {
        let mut gained = Vec3::ZERO;
        for j in 0..self.count {
            if self.is_shared[j] && these(j) {
                gained += self.weights[j][k] * self.found[j];
            }
        }
        gained
    }
}

impl<'w> Groups<'w> {
    pub fn new() -> Self {
        Self { groups: Vec::new(), free: Vec::new(), first: Meetings::default(), second: Meetings::default() }
    }

    /// Seats a path that goes in this place of the wave: in the last group, or in one that it begins.
    pub fn seat(&mut self, slot: usize, tag: Tag, in_last: bool) -> Seat {
        if !in_last {
            self.open(tag);
        }
        let meeting = &mut self.first.all[self.first.count - 1];
        meeting.join(slot);
        let group = &mut self.groups[meeting.group as usize];
        let place = group.count;
        group.tags[place] = tag;
        group.count += 1;
        group.under_way += 1;
        Seat { group: meeting.group, place: place as u32, meeting: NONE }
    }

    fn open(&mut self, tag: Tag) {
        let id = self.free.pop().unwrap_or_else(|| {
            self.groups.push(Group {
                tags: [tag; GROUP],
                count: 0,
                under_way: 0,
                own: [Vec3::ZERO; GROUP],
                is_shared: [false; GROUP],
                found: [Vec3::ZERO; GROUP],
                weights: [[Vec3::ZERO; GROUP]; GROUP],
            });
            self.groups.len() as u32 - 1
        });
        let group = &mut self.groups[id as usize];
        (group.count, group.under_way) = (0, 0);
        group.own = [Vec3::ZERO; GROUP];
        group.is_shared = [false; GROUP];
        if self.first.count == self.first.all.len() {
            self.first.all.push(Meeting::new());
        }
        self.first.all[self.first.count].begin(id, self.first.count as u32);
        self.first.count += 1;
    }

    /// Takes what a path has found by its end; hands over what the pixels of its group gain if it was the last one.
    #[inline(always)]
    pub fn end(
        &mut self,
        Seat { group: id, place, .. }: Seat,
        radiance: Vec3,
        mut hand_over: impl FnMut(Tag, Vec3),
        witness: &mut impl Witness,
    ) {
        let (group, place) = (&mut self.groups[id as usize], place as usize);
        if group.is_shared[place] {
            group.found[place] = radiance;
        } else {
            group.own[place] += radiance;
        }
        group.under_way -= 1;
        if group.under_way > 0 {
            return;
        }
        for k in 0..group.count {
            witness.see(k, || Event::Others { gained: group.found_for(k, |j| j != k) });
            hand_over(group.tags[k], group.own[k] + group.found_for(k, |_| true));
        }
        self.free.push(id);
    }

    /// The way to the light that was sampled at a meeting is free, or it is not; what the path's own pixel gains.
    #[inline(always)]
    pub fn light(&mut self, seat: Seat, visible: bool) -> Vec3 {
        self.second.all[seat.meeting as usize].light(seat.place as usize, visible)
    }
}

/// Whether paths may be reused.
pub(crate) fn is_possible(settings: &Settings) -> bool {
    // Directions must have been chosen by the materials, and roulette must not have been played at first surfaces.
    !settings.without.path_reuse
        && settings.integrator.kind == IntegratorKind::Path
        && settings.integrator.rr_depth > 1
        && matches!(settings.strategy, Strategy::Bsdf | Strategy::Light | Strategy::Mis)
}

impl Estimator {
    /// Paths that are at surfaces have just come there: groups at their second surfaces meet, those at their first ones remember
    /// them.
    #[inline(always)]
    pub(super) fn meet<L: Lanes, W: Witness>(&self, lanes: L, world: &World, wave: &mut Wave, witness: &mut W) {
        let Some(mut groups) = wave.groups.take() else { return };
        let Groups { groups: all, first, second, .. } = &mut groups;
        for meeting in &mut second.all[..second.count] {
            let group = &mut all[meeting.group as usize];
            meeting.connect(lanes, world, wave, self.offsets, group, witness);
        }
        for meeting in &mut first.all[..first.count] {
            meeting.remember_first(wave);
        }
        wave.groups = Some(groups);
    }

    /// Paths have chosen lights and directions at second surfaces that do not look alike from everywhere.
    #[inline(always)]
    pub(super) fn reuse_choices<L: Lanes, W: Witness>(&self, lanes: L, wave: &mut Wave, count: usize, witness: &mut W) {
        let Some(mut groups) = wave.groups.take() else { return };
        let with_bsdf = self.strategy == Strategy::Mis;
        for k in 0..count {
            let i = wave.chosen[k];
            let Seat { group, meeting, .. } = wave.seats[i];
            if meeting != NONE {
                let group = &mut groups.groups[group as usize];
                groups.second.all[meeting as usize].reuse_choices(lanes, wave, i, with_bsdf, group, witness);
            }
        }
        wave.groups = Some(groups);
    }
}

/// All light that was sampled at second surfaces has come: groups part, and those at their first surfaces go on.
#[inline(always)]
pub(super) fn part(wave: &mut Wave) {
    let Some(mut groups) = wave.groups.take() else { return };
    let Groups { groups: all, second, .. } = &mut groups;
    for meeting in &second.all[..second.count] {
        meeting.part(wave, &mut all[meeting.group as usize]);
    }
    std::mem::swap(&mut groups.first, &mut groups.second);
    groups.first.count = 0;
    wave.groups = Some(groups);
}
