//! The film of one job with the account of what is in it: which samples of which tile, and, where workers are checked, from
//! whom, so that what a liar brought can be taken out exactly.

use crate::ledger::audit::Contributor;
use crate::plan::Plan;
use crate::store::{Entry, Piece};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use tilecast_core::film::file::Part;
use tilecast_core::film::ranges::Ranges;
use tilecast_core::film::{Film, PixelSums, TileSums, sums};
use tilecast_core::settings::{Settings, Window};

/// Whoever brought what is not kept apart.
pub const ANYBODY: Contributor = 0;

/// See the module.
#[derive(Debug)]
pub struct Canvas {
    film: Film,
    plan: Plan,
    /// By tile, then by contributor; never empty.
    accounts: BTreeMap<(u32, Contributor), Account>,
    /// Memory for sums that are kept apart.
    apart_bytes_max: u64,
    apart_bytes: u64,
    /// Their units are not merged any more.
    banned: BTreeSet<Contributor>,
    /// Grows with every change.
    version: u64,
    /// By tile: the version that changed it last, and 0 before any did.
    changed: Vec<u64>,
}

#[derive(Debug, Default)]
struct Account {
    samples: Ranges,
    /// The sums of these samples alone; `None` for [`ANYBODY`].
    pixels: Vec<PixelSums>,
}

impl Canvas {
    /// Nothing yet. With `apart_bytes_max` 0, contributors are not kept apart.
    pub fn new(settings: &Settings, plan: Plan, apart_bytes_max: u64) -> Self {
        let film = Film::new(settings);
        let (accounts, banned, changed) = (BTreeMap::new(), BTreeSet::new(), vec![0; plan.order.len()]);
        Self { film, plan, accounts, apart_bytes_max, apart_bytes: 0, banned, version: 0, changed }
    }

    /// The sums of all.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// How many tiles it has.
    pub fn tiles(&self) -> u32 {
        self.plan.order.len() as u32
    }

    /// The pixels of tile `index`.
    pub fn tile(&self, index: u32) -> Window {
        self.plan.tile(index)
    }

    /// How often it has changed.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// The tiles that changed after version `since`, each with the version that did, in that order.
    pub fn changed_since(&self, since: u64) -> Vec<(u64, u32)> {
        let later = self.changed.iter().zip(0..).filter(|&(&version, _)| version > since);
        let mut tiles: Vec<(u64, u32)> = later.map(|(&version, tile)| (version, tile)).collect();
        tiles.sort_unstable();
        tiles
    }

    fn touch(&mut self, tile: u32) {
        self.version += 1;
        self.changed[tile as usize] = self.version;
    }

    /// Adds a unit that is not in it; `false` if its contributor was banned meanwhile, and nothing was added.
    pub fn merge(&mut self, unit: &TileSums, who: Contributor) -> bool {
        if self.banned.contains(&who) {
            return false;
        }
        let Some(tile) = self.plan.index_of(&unit.tile) else { return false };
        self.film.merge(unit);
        self.touch(tile);
        let who = self.kept_apart(tile, who, unit.pixels.len());
        let account = self.accounts.entry((tile, who)).or_default();
        account.samples.insert(unit.samples.clone());
        if who != ANYBODY {
            add(&mut account.pixels, &unit.pixels);
        }
        true
    }

    /// Takes out all that a contributor brought; says which samples of which tiles. What is not kept apart may be its work
    /// too, so where there is any, the whole tile goes.
    pub fn take_out(&mut self, who: Contributor) -> Vec<(u32, Range<u32>)> {
        self.banned.insert(who);
        let suspect: Vec<(u32, Contributor)> = match self.apart_bytes_max {
            0 => Vec::new(),
            _ => self.accounts.keys().filter(|key| key.1 == who || key.1 == ANYBODY).copied().collect(),
        };
        let mut gone = Vec::new();
        for (tile, from) in suspect {
            let Some(Account { samples, pixels }) = self.accounts.remove(&(tile, from)) else { continue };
            let window = self.plan.tile(tile);
            // What nobody in particular brought is what is left without the others.
            let pixels = if from == ANYBODY { self.unattributed(tile) } else { pixels };
            if from != ANYBODY {
                self.apart_bytes -= size_of_val(pixels.as_slice()) as u64;
            }
            self.film.remove(window, samples.as_slice(), &pixels);
            self.touch(tile);
            gone.extend(samples.as_slice().iter().map(|range| (tile, range.clone())));
        }
        gone
    }

    /// The parts of a tile.
    pub fn parts(&self, tile: u32) -> Vec<Part> {
        let window = self.plan.tile(tile);
        let part = |(&(_, contributor), account): (&(u32, Contributor), &Account)| Part {
            tile: window,
            half: self.film.half,
            samples: account.samples.clone(),
            pixels: if contributor == ANYBODY { self.unattributed(tile) } else { account.pixels.clone() },
            contributor,
        };
        self.accounts.range((tile, 0)..=(tile, u64::MAX)).map(part).collect()
    }

    /// The samples of every tile, whoever brought them.
    pub fn samples(&self) -> Vec<Ranges> {
        let mut all = vec![Ranges::default(); self.plan.order.len()];
        for ((tile, _), account) in &self.accounts {
            account.samples.as_slice().iter().for_each(|range| all[*tile as usize].insert(range.clone()));
        }
        all
    }

    /// Adds a piece of the film as it was kept; one that is there already, or cannot be of this film, changes nothing.
    pub fn restore(&mut self, piece: Piece) {
        match piece {
            Piece::Part(Part { tile, samples, pixels, contributor, .. }) => {
                let Some(index) = self.plan.index_of(&tile) else { return };
                if samples.as_slice().iter().any(|range| self.has_any(index, range)) {
                    return;
                }
                self.film.add(tile, samples.as_slice(), &pixels);
                self.touch(index);
                let who = self.kept_apart(index, contributor, pixels.len());
                let account = self.accounts.entry((index, who)).or_default();
                samples.as_slice().iter().for_each(|range| account.samples.insert(range.clone()));
                if who != ANYBODY {
                    add(&mut account.pixels, &pixels);
                }
            }
            Piece::Entry(Entry::TakenOut(who)) => {
                self.take_out(who);
                // Bans are of a coordinator's run; checks go on in the next one.
                self.banned.remove(&who);
            }
            Piece::Entry(Entry::Unit { tile, samples, contributor, sums }) => {
                let Some(index) = self.plan.index_of(&tile) else { return };
                if samples.is_empty() || self.has_any(index, &samples) {
                    return;
                }
                let Ok(pixels) = sums::decode(&sums, tile.area() as usize) else { return };
                let unit = TileSums { tile, samples, pixels };
                if unit.check() {
                    self.merge(&unit, contributor);
                }
            }
        }
    }

    /// Whether any of these samples of a tile is there.
    fn has_any(&self, tile: u32, samples: &Range<u32>) -> bool {
        self.accounts.range((tile, 0)..=(tile, u64::MAX)).any(|(_, account)| account.samples.overlaps(samples))
    }

    /// Whose account a unit goes to: its contributor's, if there is memory for it.
    fn kept_apart(&mut self, tile: u32, who: Contributor, pixels: usize) -> Contributor {
        if who == ANYBODY || self.apart_bytes_max == 0 || self.accounts.contains_key(&(tile, who)) {
            return if self.apart_bytes_max == 0 { ANYBODY } else { who };
        }
        let bytes = (pixels * size_of::<PixelSums>()) as u64;
        if self.apart_bytes + bytes > self.apart_bytes_max {
            return ANYBODY;
        }
        self.apart_bytes += bytes;
        who
    }

    /// The sums of a tile without those that are kept apart.
    fn unattributed(&self, tile: u32) -> Vec<PixelSums> {
        let mut left = self.film.tile(self.plan.tile(tile));
        for (_, account) in self.accounts.range((tile, 1)..=(tile, u64::MAX)) {
            for (mine, theirs) in left.iter_mut().zip(&account.pixels) {
                mine.remove(theirs);
            }
        }
        left
    }
}

fn add(mine: &mut Vec<PixelSums>, theirs: &[PixelSums]) {
    if mine.is_empty() {
        mine.extend_from_slice(theirs);
    } else {
        mine.iter_mut().zip(theirs).for_each(|(a, b)| a.merge(b));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ledger::tests::settings;

    fn unit(tile: u32, samples: Range<u32>, value: i128) -> TileSums {
        let mut sums = TileSums::new(plan().tile(tile), samples);
        sums.pixels.iter_mut().enumerate().for_each(|(i, pixel)| pixel.0[1][2] = value + i as i128);
        sums
    }

    fn plan() -> Plan {
        Plan::new(&settings(8, 4, 64), Some(4), std::slice::from_ref(&(0..64))).unwrap()
    }

    fn canvas(apart: u64) -> Canvas {
        Canvas::new(&settings(8, 4, 64), plan(), apart)
    }

    #[test]
    fn a_liars_units_are_taken_out_as_if_they_had_never_been_there() {
        let (mut with, mut without) = (canvas(1 << 20), canvas(1 << 20));
        for (tile, samples, value, who) in
            [(0, 0..4, 5, 7), (0, 4..8, 6, 8), (0, 8..12, 7, 7), (1, 0..4, 9, 8), (1, 8..12, 3, 7)]
        {
            assert!(with.merge(&unit(tile, samples.clone(), value), who));
            if who == 8 {
                without.merge(&unit(tile, samples, value), who);
            }
        }
        assert_eq!(with.take_out(7), [(0, 0..4), (0, 8..12), (1, 8..12)]);
        assert_eq!(with.film(), without.film());
        assert_eq!(with.samples(), without.samples());
        assert!(!with.merge(&unit(0, 0..4, 5), 7), "it is banned");
    }

    /// Whoever looks again gets what changed since, once each, and all of it however often it asks in between.
    #[test]
    fn tiles_that_change_are_told_once_in_order() {
        let mut canvas = canvas(0);
        assert!(canvas.changed_since(0).is_empty());
        canvas.merge(&unit(0, 0..4, 5), 7);
        canvas.merge(&unit(1, 0..4, 5), 7);
        canvas.merge(&unit(0, 4..8, 5), 7);
        assert_eq!(canvas.changed_since(0), [(2, 1), (3, 0)]);
        assert_eq!(canvas.changed_since(2), [(3, 0)]);
        assert!(canvas.changed_since(canvas.version()).is_empty());
    }

    /// There is memory for one account only: what else there is of a tile goes with it.
    #[test]
    fn without_memory_for_accounts_the_tile_is_done_again() {
        let mut canvas = canvas(16 * size_of::<PixelSums>() as u64);
        canvas.merge(&unit(0, 0..4, 5), 8);
        canvas.merge(&unit(0, 4..8, 6), 7);
        canvas.merge(&unit(1, 0..4, 7), 7);
        assert_eq!(canvas.take_out(7), [(0, 4..8), (1, 0..4)]);
        let mut left = super::tests::canvas(1 << 20);
        left.merge(&unit(0, 0..4, 5), 8);
        assert_eq!(canvas.film(), left.film());
    }

    #[test]
    fn parts_and_entries_may_overlap_and_count_once() {
        let mut before = canvas(1 << 20);
        let units = [(0, 0..4, 5, 7), (0, 4..8, 6, 8), (1, 0..16, 7, 7)];
        units
            .clone()
            .into_iter()
            .for_each(|(tile, samples, value, who)| _ = before.merge(&unit(tile, samples, value), who));
        let mut after = canvas(1 << 20);
        (0..2).flat_map(|tile| before.parts(tile)).for_each(|part| after.restore(Piece::Part(part)));
        for (tile, samples, value, contributor) in units {
            let TileSums { tile, samples, pixels } = unit(tile, samples, value);
            let sums = sums::encode(&pixels).into();
            after.restore(Piece::Entry(Entry::Unit { tile, samples, contributor, sums }));
        }
        assert_eq!(after.film(), before.film());
        assert_eq!(after.samples(), before.samples());
        after.restore(Piece::Entry(Entry::TakenOut(7)));
        before.take_out(7);
        assert_eq!(after.film(), before.film());
    }
}
