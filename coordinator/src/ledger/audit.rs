//! Units that are done a second time by someone else, to see whether the bits agree.
//!
//! Everything of a newcomer is checked, then a share. Where two disagree a third decides; whoever stands alone is at fault.
//! What cannot be checked, because no other worker is there, counts as it is.

use super::job::UnitKey;
use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;
use std::time::Duration;
use tilecast_core::scene::Digest;
use tilecast_proto::types::{Fence, WorkerId};

/// Units of a newcomer that are all checked: one who spoils a tenth of its results passes them with a chance of 0.6 %.
pub const NEWCOMER_UNITS: u32 = 48;
/// Claims about one unit: beyond it, workers disagree so widely that people must look.
const CLAIMS_MAX: usize = 5;

/// Whom an account is kept for: a worker's process, over all its sessions.
pub type Contributor = u64;

/// The checks of one job.
#[derive(Debug, Default)]
pub(super) struct Audits {
    audits: BTreeMap<UnitKey, Audit>,
    /// Those that nobody has.
    waiting: VecDeque<UnitKey>,
}

#[derive(Debug)]
struct Audit {
    end: u32,
    claims: Vec<(Contributor, Digest)>,
    lease: Option<(WorkerId, Fence)>,
    since: Duration,
}

/// What a claim has led to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Finding {
    /// All agree.
    Agreed,
    /// A third must decide.
    Undecided,
    /// The majority is right; these are not.
    Guilty(Vec<Contributor>),
    /// No two of many agree.
    Hopeless,
}

impl Audits {
    pub fn is_empty(&self) -> bool {
        self.audits.is_empty()
    }

    /// Begins a check.
    pub fn open(&mut self, now: Duration, key: UnitKey, end: u32, claim: (Contributor, Digest)) {
        self.audits.insert(key, Audit { end, claims: vec![claim], lease: None, since: now });
        self.waiting.push_back(key);
    }

    /// A check for a worker that has not made a claim about it.
    pub fn take(&mut self, worker: WorkerId, who: Contributor, fence: Fence) -> Option<(UnitKey, Range<u32>)> {
        for _ in 0..self.waiting.len() {
            let key = self.waiting.pop_front()?;
            match self.audits.get_mut(&key) {
                // A unit that was taken out and done again may wait twice: once is enough.
                Some(audit) if audit.lease.is_some() => {}
                Some(audit) if audit.claims.iter().any(|claim| claim.0 == who) => self.waiting.push_back(key),
                Some(audit) => {
                    audit.lease = Some((worker, fence));
                    return Some((key, key.start..audit.end));
                }
                None => {}
            }
        }
        None
    }

    /// A lease of a check has ended without a claim.
    pub fn give_back(&mut self, key: UnitKey, worker: WorkerId, fence: Fence) {
        if let Some(audit) = self.audits.get_mut(&key).filter(|audit| audit.lease == Some((worker, fence))) {
            audit.lease = None;
            self.waiting.push_back(key);
        }
    }

    /// Whether this is the result that a check waits for.
    pub fn expects(&self, key: UnitKey, end: u32, worker: WorkerId, fence: Fence) -> bool {
        self.audits.get(&key).is_some_and(|audit| audit.end == end && audit.lease == Some((worker, fence)))
    }

    /// Adds a claim.
    pub fn claim(&mut self, key: UnitKey, claim: (Contributor, Digest)) -> Finding {
        let Some(audit) = self.audits.get_mut(&key) else { return Finding::Agreed };
        audit.claims.push(claim);
        audit.lease = None;
        let votes = |digest: &Digest| audit.claims.iter().filter(|(_, other)| other == digest).count();
        let right = audit.claims.iter().map(|(_, digest)| *digest).find(|digest| votes(digest) >= 2);
        let Some(right) = right else {
            if audit.claims.len() >= CLAIMS_MAX {
                self.audits.remove(&key);
                return Finding::Hopeless;
            }
            self.waiting.push_back(key);
            return Finding::Undecided;
        };
        let wrong: Vec<Contributor> =
            audit.claims.iter().filter(|(_, digest)| *digest != right).map(|(who, _)| *who).collect();
        self.audits.remove(&key);
        if wrong.is_empty() { Finding::Agreed } else { Finding::Guilty(wrong) }
    }

    /// Ends checks that only concern a contributor whose units are taken out; gives their leases.
    pub fn drop_claims(&mut self, who: Contributor) -> Vec<(WorkerId, Fence)> {
        let mut leases = Vec::new();
        self.audits.retain(|_, audit| {
            audit.claims.retain(|claim| claim.0 != who);
            if audit.claims.is_empty() {
                leases.extend(audit.lease);
            }
            !audit.claims.is_empty()
        });
        leases
    }

    /// Ends checks that nobody present could do. `present` are the contributors that are there. Those that two have
    /// disagreed about stay, until `patience` is over: gives one of them then.
    pub fn drop_hopeless(
        &mut self,
        now: Duration,
        present: impl Fn(Contributor) -> bool,
        others: usize,
        patience: Duration,
    ) -> Option<UnitKey> {
        let mut stuck = None;
        self.audits.retain(|&key, audit| {
            let claimed = audit.claims.iter().filter(|(who, _)| present(*who)).count();
            if audit.lease.is_some() || others > claimed {
                return true;
            }
            if audit.claims.len() == 1 {
                return false;
            }
            if audit.since + patience < now {
                stuck = Some(key);
            }
            true
        });
        stuck
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: UnitKey = UnitKey { tile: 3, start: 4 };

    fn audit() -> Audits {
        let mut audits = Audits::default();
        audits.open(Duration::ZERO, KEY, 8, (1, Digest([1; 32])));
        audits
    }

    #[test]
    fn nobody_checks_himself_and_the_majority_is_right() {
        let mut audits = audit();
        assert_eq!(audits.take(WorkerId(1), 1, Fence(1)), None);
        assert_eq!(audits.take(WorkerId(2), 2, Fence(2)), Some((KEY, 4..8)));
        assert!(audits.expects(KEY, 8, WorkerId(2), Fence(2)) && !audits.expects(KEY, 8, WorkerId(1), Fence(2)));
        assert_eq!(audits.claim(KEY, (2, Digest([2; 32]))), Finding::Undecided);
        assert_eq!(audits.take(WorkerId(2), 2, Fence(3)), None);
        assert_eq!(audits.take(WorkerId(3), 3, Fence(4)), Some((KEY, 4..8)));
        assert_eq!(audits.claim(KEY, (3, Digest([2; 32]))), Finding::Guilty(vec![1]));
        assert!(audits.is_empty());
    }

    /// The liar's units are done again, and checked again: what waits from before must not make it two checks at a time,
    /// each of which lets the other's result seem to be nobody's.
    #[test]
    fn a_unit_is_checked_by_one_at_a_time() {
        let mut audits = audit();
        audits.drop_claims(1);
        audits.open(Duration::ZERO, KEY, 8, (2, Digest([1; 32])));
        assert!(audits.take(WorkerId(3), 3, Fence(1)).is_some());
        assert_eq!(audits.take(WorkerId(4), 4, Fence(2)), None);
        audits.give_back(KEY, WorkerId(4), Fence(2));
        assert!(audits.expects(KEY, 8, WorkerId(3), Fence(1)), "another's lease has ended, which it does not have");
        audits.give_back(KEY, WorkerId(3), Fence(1));
        assert!(audits.take(WorkerId(4), 4, Fence(3)).is_some());
    }

    #[test]
    fn agreement_ends_a_check() {
        let mut audits = audit();
        audits.take(WorkerId(2), 2, Fence(2));
        assert_eq!(audits.claim(KEY, (2, Digest([1; 32]))), Finding::Agreed);
        assert!(audits.is_empty());
    }

    #[test]
    fn what_nobody_else_could_do_is_not_waited_for() {
        let mut audits = audit();
        audits.drop_hopeless(Duration::ZERO, |_| true, 2, Duration::ZERO);
        assert!(!audits.is_empty(), "there is another");
        audits.drop_hopeless(Duration::ZERO, |_| true, 1, Duration::ZERO);
        assert!(audits.is_empty());
    }
}
